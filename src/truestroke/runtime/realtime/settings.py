"""Settings of a run in real time: its axes, its clock and its supervision."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.controller import Controller
from truestroke.control.repeating.learned_strain import LearnedStrain
from truestroke.control.settings import ControllerSettings
from truestroke.runtime.drivers.guard import Limits
from truestroke.runtime.drivers.paced import SPIN
from truestroke.runtime.realtime.motion import SetPoint
from truestroke.signals.trajectories import Trajectory

ENDINGS = ("", ".h5", ".hdf5")
"""Of a recording."""


def checked_zero(zero: object) -> float | Literal["measured"] | None:
    """What is to be subtracted from all measurements, um, "measured" or None; SettingError otherwise."""
    if zero is None or zero == "measured":
        return None if zero is None else "measured"
    if isinstance(zero, str):
        raise SettingError("zero", repr(zero), '"measured", or a number', "um")
    return checks.number("zero", zero, "um")


@dataclass(frozen=True, kw_only=True, eq=False)
class Axis:
    """One axis: motion, controller, limits.

    Attributes
    ----------
    trajectory : Trajectory or SetPoint
        Desired motion, known beforehand or moved by an operator.
    controller : Controller
        Gives the voltages and learns.
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V at the D/A converter, for any command of the controller.
    slew : float
        Fastest change of the output voltage, V/s; also of soft start and soft stop.
    safe_voltage : float
        Where the output starts and ends, V, within the limits.
    name : str
        For messages and files.
    zero : float, "measured" or None
        What is subtracted from all measurements, um; "measured": so much that 0 um is at 0 V, by the first ones at
        rest; None: the same where the sensor shows a tenth of the stroke or more beside what the safe voltage explains,
        else nothing.
    error_limit : float or None
        An error beyond it is one of an axis that is lost, if it lasts (`RealtimeSettings`), um; by default 30 % of the
        motion from end to end, and at least 5 % of the stroke.
    others : ndarray, shape (ticks, 3 other axes), or None
        What its controller takes of the motion of the others, as `couple` makes it; None: it stands alone.
    learned : LearnedStrain or None
        What is the same in each period of its error, as `couple` makes it; None: nothing of that is learned.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """

    trajectory: Trajectory | SetPoint
    controller: Controller
    voltage_limits: tuple[float, float]
    slew: float
    safe_voltage: float = 0.0
    name: str = "axis"
    zero: float | Literal["measured"] | None = None
    error_limit: float | None = None
    others: FloatArray | None = None
    learned: LearnedStrain | None = None

    def __post_init__(self) -> None:
        limits = Limits(voltage_limits=self.voltage_limits, slew=self.slew, safe_voltage=self.safe_voltage)
        object.__setattr__(self, "voltage_limits", limits.voltage_limits)
        object.__setattr__(self, "zero", checked_zero(self.zero))
        if self.error_limit is not None:
            checks.positive("error_limit", self.error_limit, "um")
        if not self.name or not all(c.isalnum() or c in "-_" for c in self.name):
            bound = "letters, digits, - and _, as it may become part of a file name"
            raise SettingError("name", repr(self.name), bound)

    @property
    def known(self) -> ControllerSettings | None:
        """The settings of its controller; one of another kind has no stroke to compare with."""
        settings = getattr(self.controller, "settings", None)
        return settings if isinstance(settings, ControllerSettings) else None

    @property
    def limits(self) -> tuple[float, float]:
        """The narrower of its voltage limits and those of its controller, V."""
        both = [self.voltage_limits] + ([self.known.voltage_limits] if self.known else [])
        return max(low for low, _ in both), min(high for _, high in both)


@dataclass(frozen=True, kw_only=True)
class RealtimeSettings:
    """How to keep time, and when to give up.

    Attributes
    ----------
    spin : float
        How long before a tick to wake up and spin, s; 0 only sleeps.
    cpu : int or None
        Processor that the loop alone uses, pinned; None leaves it to the system.
    priority : int
        1 to 99 runs under SCHED_FIFO, 0 does not. A loop that spins under SCHED_FIFO is stopped by the system for tens
        of milliseconds at a time, so this needs ``spin = 0``.
    overrun_streak : int
        So many blocks in a row, each more than a period late, end the run; 0 never does.
    sensor_timeout : float
        So long without a usable measurement ends the run, s: lost, rejected by the controller, or frozen while the
        voltage moves.
    watchdog_timeout : float
        After this time without a tick the watchdog kills the process and sets the output to the safe voltage, s.
    axis_check : bool
        Whether each axis makes a small motion before the run, that shows sign, gain and channel of its sensor. Without
        it nothing but the supervision of the run finds a wrong one, after it has moved as far as `error_limit` allows.
    error_time : float
        So long with an error beyond `error_limit` ends the run, s; 0 never does.
    limit_time : float
        So long with such an error and the output at a voltage limit ends it, s; 0 never does.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """

    spin: float = SPIN
    cpu: int | None = None
    priority: int = 0
    overrun_streak: int = 20
    sensor_timeout: float = 0.1
    watchdog_timeout: float = 0.25
    axis_check: bool = True
    error_time: float = 1.0
    limit_time: float = 0.2

    def __post_init__(self) -> None:
        checks.within("spin", self.spin, 0.0, 0.02, "s")
        if self.cpu is not None:
            checks.count("cpu", self.cpu, 0, 4095)
        checks.count("priority", self.priority, 0, 99)
        if self.priority and self.spin:
            raise SettingError("spin", self.spin, "0 under SCHED_FIFO (priority above 0)", "s")
        checks.count("overrun_streak", self.overrun_streak, 0, 10**6)
        checks.within("sensor_timeout", self.sensor_timeout, 1e-3, 3600.0, "s")
        checks.within("watchdog_timeout", self.watchdog_timeout, 0.05, 60.0, "s")
        if not isinstance(self.axis_check, bool):
            raise SettingError("axis_check", repr(self.axis_check), "true or false")
        checks.within("error_time", self.error_time, 0.0, 3600.0, "s")
        checks.within("limit_time", self.limit_time, 0.0, 3600.0, "s")


def files_of(argument: str, file: Path, axes: Sequence[str]) -> list[Path]:
    """What the recording of each axis is called: of several with the name of the axis before the ending.

    Raises
    ------
    SettingError
        The ending is that of another kind of file.

    Examples
    --------
    >>> [path.name for path in files_of("file", Path("scan.h5"), ["x", "y"])]
    ['scan-x.h5', 'scan-y.h5']
    >>> files_of("file", Path("scan.csv"), ["x", "y"])
    Traceback (most recent call last):
        ...
    truestroke.SettingError: file = 'scan.csv': must be a name that ends with .h5 or .hdf5, such as scan.h5
    """
    if file.suffix not in ENDINGS or not file.name:
        example = file.with_suffix(".h5") if file.name else "run.h5"
        wanted = f"a name that ends with {' or '.join(filter(None, ENDINGS))}, such as {example}"
        raise SettingError(argument, repr(str(file)), wanted)
    return [file if len(axes) == 1 else file.with_name(f"{file.stem}-{name}{file.suffix}") for name in axes]
