"""The loop on hardware, in real time: `run_realtime`.

The loop has a process for itself. Recorder, watchdog, status line and server are other processes that read a ring of
shared memory: neither their work nor their failure takes time from a tick.
"""

from truestroke.runtime.realtime.coupled import couple
from truestroke.runtime.realtime.ending import Cause, Outcome
from truestroke.runtime.realtime.epics import EpicsSettings
from truestroke.runtime.realtime.live_page import LiveSettings
from truestroke.runtime.realtime.motion import SetPoint
from truestroke.runtime.realtime.process import RealtimeError
from truestroke.runtime.realtime.runner import run_realtime
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings

__all__ = [
    "Axis",
    "Cause",
    "EpicsSettings",
    "LiveSettings",
    "Outcome",
    "RealtimeError",
    "RealtimeSettings",
    "SetPoint",
    "couple",
    "run_realtime",
]
