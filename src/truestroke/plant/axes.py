"""Two or three stages that disturb each other, read by sensors that may be turned against them, in C."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke._plant import MAX_AXES, Axes
from truestroke.base import checks, declared, frames
from truestroke.base.checks import SettingError
from truestroke.base.declared import Setting, bound
from truestroke.base.display import Rows, quantity
from truestroke.base.frames import Matrix
from truestroke.base.typing import FloatArray
from truestroke.plant.settings import STAGE_SETTINGS, StageSettings
from truestroke.plant.simulated import Simulated
from truestroke.signals.timing import Timing

COMMON = ("sample_rate", "steps_per_tick", "samples_per_tick")


@bound(f"2 to {MAX_AXES} StageSettings of one sample_rate, steps_per_tick and samples_per_tick")
def _axes(_: Any, name: str, value: Any, unit: str) -> tuple[StageSettings, ...]:
    found = tuple(value) if isinstance(value, tuple | list) else (value,)
    for one in found:
        checks.instance(name, one, StageSettings, "StageSettings, one for each axis")
    checks.count(f"the number of {name}", len(found), 2, MAX_AXES)
    for i, one in enumerate(found):
        for common in COMMON:
            given, first = getattr(one, common), getattr(found[0], common)
            if given != first:
                raise SettingError(
                    f"{name}[{i}].{common}", given, f"{first}, that of the first", STAGE_SETTINGS[common].unit
                )
    return found


@bound("a row and a column for each axis, each number in [-0.5, 0.5]; the diagonal is not used")
def _shares(s: MultiAxisSettings, name: str, value: Any, unit: str) -> Matrix:
    return _matrix(s, name, value, unit, 0.5)


@bound("a row and a column for each axis, each number in [-0.001, 0.001]; the diagonal is not used")
def _times(s: MultiAxisSettings, name: str, value: Any, unit: str) -> Matrix:
    return _matrix(s, name, value, unit, 1e-3)


def _matrix(s: MultiAxisSettings, name: str, value: Any, unit: str, most: float) -> Matrix:
    axes = len(s.axes)
    found = np.zeros((axes, axes)) if value is None else frames.matrix(name, value, axes, unit)
    checks.within(f"the largest of {name}", float(np.abs(found).max()), 0.0, most, unit)
    return frames.rows(found)


@bound("invertible; None is a sensor along each axis")
def _frame(s: MultiAxisSettings, name: str, value: Any, unit: str) -> Matrix:
    return frames.frame(name, value, len(s.axes))


# fmt: off
MULTI_AXIS_SETTINGS: declared.Table = {
    "axes": Setting("The stage of each axis", "", _axes, kernel="axes", convert=lambda stages, _: len(stages)),
    "coupling": Setting(
        "Row i, column j: what the displacement of axis j adds to that of axis i, behind its modes", "um/um", _shares
    ),
    "push": Setting("The same as a force, which the modes of axis i answer", "um/um", _shares),
    "drag": Setting("The same of the velocity of axis j, behind the modes of axis i", "s", _times),
    "frame": Setting("Row i, column j: what sensor i reads of the displacement of axis j", "", _frame),
}
# fmt: on


@declared.documented(MULTI_AXIS_SETTINGS)
@dataclass(frozen=True, kw_only=True)
class MultiAxisSettings:
    """Two or three stages, what they do to each other, and how their sensors stand.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> MultiAxisSettings(coupling=[[0.0, 0.03], [0.02, 0.0]]).coupling
    ((0.0, 0.03), (0.02, 0.0))
    >>> MultiAxisSettings(axes=(StageSettings(), StageSettings(sample_rate=5000.0)))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: axes[1].sample_rate = 5000.0 Hz: must be 10000.0, that of the first
    """

    axes: tuple[StageSettings, ...] = (
        StageSettings(resonances=(900.0,)),
        StageSettings(resonances=(600.0,), hysteresis_kind="preisach"),
    )
    coupling: Matrix = None  # type: ignore[assignment]  # a matrix from __post_init__ on
    push: Matrix = None  # type: ignore[assignment]
    drag: Matrix = None  # type: ignore[assignment]
    frame: Matrix = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        declared.complete(self, MULTI_AXIS_SETTINGS)

    @property
    def sample_rate(self) -> float:
        """Ticks per second, Hz."""
        return self.axes[0].sample_rate


class MultiAxisStage(Simulated):
    """Two or three `StagePlant` whose axes move each other; the sensors may be turned, or not at right angles.

    Each step of the integration adds to stage i ::

        behind_i = sum_j coupling_ij z_j + drag_ij z_j',    force_i = sum_j push_ij z_j,    j other than i,

    with the displacements z_j of the step before; the sensors read frame z, each with its noise.

    Parameters
    ----------
    settings : MultiAxisSettings
        Every number; the default is two stages of 30 um that ring at 900 and 600 Hz, without coupling.
    seed : int
        Of the sensors' noise, 0 or above. The same seed gives the same bits.

    Attributes
    ----------
    truth : ndarray, shape (ticks, axes)
        What sensors without lag, delay and noise would read, the mean over each tick of the last exchange, um.

    Raises
    ------
    SettingError
        An argument is out of bounds, or the `loop_width` of a stage so large that it would retract at a rising voltage.

    Examples
    --------
    >>> quiet = StageSettings(noise=0.0, creep=0.0)
    >>> stage = MultiAxisStage(MultiAxisSettings(axes=(quiet, quiet), coupling=[[0.0, 0.1], [0.0, 0.0]]))
    >>> stage.open().channels
    2
    >>> volts = np.zeros((3000, 2))
    >>> volts[:, 1] = 3.6
    >>> x, y = stage.exchange(volts)[-1]
    >>> print(f"{y:.1f} um of y move x by {x / y:.3f} um/um")
    34.3 um of y move x by 0.100 um/um
    """

    kind = "axes"
    table = MULTI_AXIS_SETTINGS

    def __init__(self, settings: MultiAxisSettings | None = None, seed: int = 0) -> None:
        given = MultiAxisSettings() if settings is None else settings
        self.settings = s = checks.instance("settings", given, MultiAxisSettings, "a MultiAxisSettings")
        stages = [declared.kernel_values(one, STAGE_SETTINGS) for one in s.axes]
        self.channels = len(stages)
        self._samples = self.channels * s.axes[0].samples_per_tick
        plant = Axes(stages, declared.kernel_values(s, MULTI_AXIS_SETTINGS))
        for i, slope in enumerate(plant.least_slopes):
            if slope <= 0:
                words = f"smaller for {s.axes[i].hysteresis_kind}: the stage would retract at a rising voltage"
                raise SettingError(f"axes[{i}].loop_width", s.axes[i].loop_width, words)
        super().__init__(plant, seed)

    def open(self) -> Timing:
        """Rest at time 0, noise from its beginning; opening again repeats the same bits."""
        timing = super().open()
        self.truth = np.empty((0, self.channels))
        return Timing(sample_rate=timing.sample_rate, channels=self.channels)

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Hold the voltages of each row for a tick.

        Parameters
        ----------
        volts : ndarray, shape (ticks, axes)
            Voltages at the D/A converters, V; any number of ticks.

        Returns
        -------
        ndarray, shape (ticks, axes)
            What the sensors read, the mean over each tick, um.

        Raises
        ------
        SettingError
            A voltage is NaN or infinite; nothing has moved.
        """
        volts = np.ascontiguousarray(volts, dtype=np.float64)
        if volts.ndim != 2 or volts.shape[1] != self.channels:
            raise SettingError("volts", f"array of shape {volts.shape}", f"of shape (ticks, {self.channels})", "V")
        measured, truth = np.empty(volts.shape), np.empty(volts.shape)
        noise = self._noise.take(len(volts) * self._samples)
        bad = self._plant.run(volts.ravel(), noise, measured.ravel(), truth.ravel())
        if bad >= 0:
            self._noise.put_back(noise.size)
            tick, axis = divmod(int(bad), self.channels)
            raise SettingError(f"volts[{tick}, {axis}]", volts[tick, axis], "finite", "V")
        self.truth = truth
        return measured

    def _display(self) -> tuple[str, Rows]:
        s = self.settings
        stages = [
            (f"axis {i}", f"{one.hysteresis_kind}, {', '.join(quantity(f, 'Hz') for f in one.resonances)}")
            for i, one in enumerate(s.axes)
        ]
        others = [(name, str(getattr(s, name))) for name in ("coupling", "push", "drag", "frame")]
        return f"{type(self).__name__}: seed {self.seed}", [*stages, *others]
