"""Where a stage truly is in a scan under each kind of controller, um, shape (ticks, 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from truestroke import _loops
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.axes import PARTS, MultiAxisController
from truestroke.control.controller import AdaptiveController
from truestroke.control.repeating.learned_strain import whole_ticks
from truestroke.control.repeating.repetition import LONGEST, SHORTEST
from truestroke.plant import MultiAxisStage
from truestroke.runtime.axes import between, pass_natively
from truestroke.runtime.ticks import SIMULATED
from truestroke.signals.channels import Array, dtype
from truestroke.signals.scans.scan import Scan

PART = 2**16  # ticks that are simulated at a time


def period_of(scan: Scan) -> float:
    """Period of the fast axis, or of a turn, s; SettingError where it is not one of 16 to 8192 whole ticks.

    Examples
    --------
    >>> from truestroke import scans
    >>> period_of(scans.raster(lines=4, rate=40.0, sample_rate=5000.0))
    0.025
    """
    name = "rotation" if scan.settings.get("velocity") == "angular" else "rate"
    rate = scan.settings.get(name)
    if not isinstance(rate, float):
        raise SettingError("scan", f"a {scan.name}", "one of lines or turns of equal time: this spiral has none")
    period = 1 / rate
    try:
        whole_ticks("period", period, scan.sample_rate)
    except SettingError:
        ticks = period * scan.sample_rate
        near = scan.sample_rate / min(max(round(ticks), SHORTEST), LONGEST)
        whole = f"whole number of ticks from {SHORTEST} to {LONGEST}"
        bound = f"one whose period is a {whole}, not {ticks:.10g}: such as {near:.10g} Hz"
        raise SettingError(name, rate, bound, "Hz") from None
    return period


def open_loop(scan: Scan, plant: MultiAxisStage, sensitivity: Sequence[float]) -> FloatArray:
    """Voltage in proportion to the desired motion, by a sensitivity of each axis, um/V."""
    plant.open()
    true = np.empty((len(scan.x), len(scan.axes)))
    for part in _parts(len(true)):
        volts = [axis.position[part] / gain for axis, gain in zip(scan.axes, sensitivity, strict=True)]
        plant.exchange(np.stack(volts, axis=1))
        true[part] = plant.truth
    return true


def alone(scan: Scan, plant: MultiAxisStage, controllers: Sequence[AdaptiveController]) -> FloatArray:
    """A controller for each axis that knows nothing of the others."""
    for axis, controller in zip(scan.axes, controllers, strict=True):
        feasibility.raise_slew(axis, controller)
    columns = [getattr(axis, part) for axis in scan.axes for part in PARTS]
    axes = len(controllers)
    calls = [controller._kernel.native() for controller in controllers]
    plant.open()
    true = np.empty((len(scan.x), axes))
    for part in _parts(len(true)):
        motion = np.stack([column[part] for column in columns], axis=1)
        ticks = len(motion)
        strain, others = np.full((ticks, axes), np.nan), np.zeros((ticks, 3 * axes))
        numbers, rows = _arrays(plant, ticks, axes)
        _loops.run_axes(calls, plant._plant.native(), motion, strain, others, np.eye(axes), numbers, *rows.values())
        _require_reach(controllers)
        true[part] = rows["true"]
    return true


def together(
    scan: Scan,
    plant: MultiAxisStage,
    controller: MultiAxisController,
    progress: Callable[[int, int], None] | None = None,
    hungry: AbstractContextManager[object] | None = None,
) -> FloatArray:
    """Adaptive controllers that know of one another, and what repeats in each line, where `controller` has a period.

    Where the stage is in `truestroke.run`, without its recording. `progress` is that of `run`; `hungry` is entered
    while much memory is needed.
    """
    with hungry or nullcontext():
        known = controller.prepare(dict(zip(controller.names, scan.axes, strict=True)))
    for name, axis in controller.axes.items():
        feasibility.raise_slew(known.axes[name], axis)
    plant.open()
    ticks = len(scan.x)
    true = np.empty((ticks, len(controller.axes)))
    for part in (one for whole in _parts(ticks) for one in between(whole.start, whole.stop, controller)):
        numbers, rows = _arrays(plant, part.stop - part.start, len(controller.axes))
        pass_natively(known, controller, plant, part, numbers, rows)
        _require_reach(controller.axes.values())
        true[part] = rows["true"]
        if progress is not None:
            progress(part.stop, ticks)
    return true


def _arrays(plant: MultiAxisStage, ticks: int, axes: int) -> tuple[FloatArray, dict[str, Array]]:
    """Numbers of the plant's noise for some ticks, and arrays for what is there in each, by `SIMULATED`."""
    return plant._noise.take(ticks * plant._samples), {name: np.zeros((ticks, axes), dtype(name)) for name in SIMULATED}


def _require_reach(controllers: Iterable[AdaptiveController]) -> None:
    for controller in controllers:
        controller._kernel.require_reach()


def _parts(ticks: int) -> Iterator[slice]:
    """Parts of a run: what only one of them needs at a time takes no memory for all."""
    return (slice(start, min(start + PART, ticks)) for start in range(0, ticks, PART))
