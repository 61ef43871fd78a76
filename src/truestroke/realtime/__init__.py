"""The loop on hardware, in real time: `run_realtime`.

The loop has a process for itself. Recorder, watchdog, status line and server are other processes that read a ring of
shared memory: neither their work nor their failure takes time from a tick.
"""

from truestroke.realtime.ending import Cause, Outcome
from truestroke.realtime.epics import EpicsSettings
from truestroke.realtime.motion import SetPoint
from truestroke.realtime.process import RealtimeError
from truestroke.realtime.runner import run_realtime
from truestroke.realtime.settings import Axis, RealtimeSettings

__all__ = ["Axis", "Cause", "EpicsSettings", "Outcome", "RealtimeError", "RealtimeSettings", "SetPoint", "run_realtime"]
