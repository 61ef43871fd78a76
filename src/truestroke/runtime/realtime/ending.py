"""How a run ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from truestroke.base import interrupts, system
from truestroke.base.exit_codes import ExitCode

if TYPE_CHECKING:
    from truestroke.runtime.realtime.axis_check import Found


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


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a run.

    Attributes
    ----------
    cause : Cause
        Why it ended; ``cause.value`` is the exit code.
    reason : str
        The same in words; empty if it finished.
    files : tuple[Path, ...]
        The recording of each axis.
    ticks, all_ticks : int
        Completed and asked for.
    overruns, missed : int
        Blocks that began more than a period late, and the periods lost by them.
    worst_us : float
        The latest beginning of a block, us.
    histogram : tuple[int, ...]
        Blocks by lateness, see `drivers.paced.EDGES_US`.
    limited : int
        Voltages that only the guard kept within limits and slew.
    lost : int
        Samples that the hardware did not deliver.
    found : Mapping[str, Found]
        What the axis check saw, by the name of the axis: zero, noise, gain.
    """

    cause: Cause
    reason: str
    files: tuple[Path, ...]
    ticks: int
    all_ticks: int
    overruns: int
    missed: int
    worst_us: float
    histogram: tuple[int, ...]
    limited: int
    lost: int
    found: Mapping[str, Found]
