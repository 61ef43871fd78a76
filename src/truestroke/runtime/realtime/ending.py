"""Why a run ends, and what ends it."""

from enum import Enum

from truestroke.base import interrupts, system
from truestroke.base.exit_codes import ExitCode


class Cause(Enum):
    """Why a run ended; the value is the exit code of `truestroke run`."""

    FINISHED = ExitCode.OK
    ERROR = ExitCode.FAILED
    CHECK = ExitCode.CHECK
    NOT_TRACKING = ExitCode.NOT_TRACKING
    SENSOR = ExitCode.SENSOR
    OVERRUN = ExitCode.OVERRUN
    DRIVER = ExitCode.DRIVER
    RECORDER = ExitCode.RECORDER
    WATCHDOG = ExitCode.WATCHDOG
    STOPPED = ExitCode.STOPPED
    HANGUP = ExitCode.HANGUP
    INTERRUPTED = ExitCode.INTERRUPTED
    TERMINATED = ExitCode.TERMINATED


SIGNALS = {number: (Cause(system.exit_code(number)), words) for number, words in interrupts.ENDING.items()}


AS_ASKED = (Cause.FINISHED, Cause.STOPPED, *(cause for cause, _ in SIGNALS.values()))
"""Ends on request, after which a recording is expected to be complete."""


class Stop(Exception):  # noqa: N818 (a run that is stopped need not be an error)
    """Ends the run now."""

    def __init__(self, cause: Cause, reason: str) -> None:
        self.cause, self.reason = cause, reason
        super().__init__(reason)
