# What `truestroke.runtime.realtime` offers: `__init__.py` reads this file, and so do type checkers.

from truestroke.runtime.realtime.coupled import couple as couple
from truestroke.runtime.realtime.ending import Cause as Cause
from truestroke.runtime.realtime.epics import EpicsSettings as EpicsSettings
from truestroke.runtime.realtime.live_page import LiveSettings as LiveSettings
from truestroke.runtime.realtime.motion import SetPoint as SetPoint
from truestroke.runtime.realtime.outcome import Outcome as Outcome
from truestroke.runtime.realtime.process import RealtimeError as RealtimeError
from truestroke.runtime.realtime.runner import run_realtime as run_realtime
from truestroke.runtime.realtime.settings import Axis as Axis
from truestroke.runtime.realtime.settings import RealtimeSettings as RealtimeSettings
