"""What became of a run."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from truestroke.runtime.realtime.axis_check import Found
from truestroke.runtime.realtime.ending import Cause


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
