"""The loop of a scan whose motion repeats line by line: what is the same in each line is learned and taken away.

The adaptive controllers follow the motion; their residual error is the same in each line, and small. It is learned as a
periodic correction r of the desired motion, an entry for each tick of a period::

    r <- r - q F e,    e: measured minus desired, the mean of some lines; F: harmonics up to 2.2 first resonances

The closed loop answers r with nearly 1 up to there, so 1 - q is what remains of an error after each correction. It
begins in the middle of a turn, where nothing is imaged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke import _loops
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility, stage
from truestroke.control.axes import MultiAxisController
from truestroke.control.controller import AdaptiveController
from truestroke.plant import MultiAxisStage
from truestroke.runtime.ticks import SIMULATED
from truestroke.signals.channels import dtype
from truestroke.signals.scans.scan import Scan

BAND = 2.2  # times the first resonance: harmonics up to there are corrected
STEP = 0.7  # q before the image
LINES = 8  # periods in a mean before the image
IN_IMAGE = 0.3, 8  # q and periods in the image: it follows what creeps, and does not learn the noise
BEGIN = 0.5  # s: until then the controllers learn alone
TAIL = 400  # ticks: the inverse of the dynamics looks no further ahead or back
PERIODIC = 1e-6  # ticks: how near to whole ticks a period has to be


@dataclass(frozen=True, eq=False)
class Moved:
    """What a stage did in a scan.

    Attributes
    ----------
    volts, measured, true : ndarray, shape (ticks, 2)
        V, um, um.
    """

    volts: FloatArray
    measured: FloatArray
    true: FloatArray


def period_of(scan: Scan) -> int:
    """Ticks in a period of the fast axis; SettingError where it does not repeat after whole ticks.

    Examples
    --------
    >>> from truestroke import scans
    >>> period_of(scans.raster(lines=4, rate=40.0, sample_rate=5000.0))
    125
    """
    period = scan.settings.get("period")
    if not isinstance(period, float):
        raise SettingError("scan", f"a {scan.name}", "a motion that is periodic: a spiral does not repeat")
    ticks = period * scan.sample_rate
    if abs(ticks - round(ticks)) > PERIODIC:
        near = scan.sample_rate / math.ceil(ticks)
        bound = f"a motion that is periodic in whole ticks, not in {ticks:.6g}: such as a rate of {near:.6g} Hz"
        raise SettingError("rate", 1 / period, bound, "Hz")
    return round(ticks)


def open_loop(scan: Scan, plant: MultiAxisStage, sensitivity: Sequence[float]) -> Moved:
    """Voltage in proportion to the desired motion, by a sensitivity of each axis, um/V."""
    plant.open()
    volts = np.stack([axis.position / gain for axis, gain in zip(scan.axes, sensitivity, strict=True)], axis=1)
    measured = plant.exchange(volts)
    return Moved(volts, measured, plant.truth)


def alone(scan: Scan, plant: MultiAxisStage, controllers: Sequence[AdaptiveController]) -> Moved:
    """A controller for each axis that knows nothing of the others."""
    motion = np.concatenate([_parts(axis) for axis in scan.axes], axis=1)
    ticks = len(scan.x)
    loop = _Loop(plant, controllers, np.eye(2), ticks)
    for axis, controller in zip(scan.axes, controllers, strict=True):
        feasibility.raise_slew(axis, controller)
    loop.run(slice(0, ticks), motion, np.full((ticks, 2), np.nan), np.zeros((ticks, 6)))
    return loop.moved


def by_lines(scan: Scan, plant: MultiAxisStage, controller: MultiAxisController) -> Moved:
    """Adaptive controllers that know of one another, and what repeats in each line taken away.

    A spiral does not repeat: there the controllers are by themselves.
    """
    known = controller.prepare(dict(zip(controller.names, scan.axes, strict=True)))
    axes, ticks = list(controller.axes.values()), len(scan.x)
    loop = _Loop(plant, axes, controller.to_axes, ticks)
    for name, axis in controller.axes.items():
        feasibility.raise_slew(known.axes[name], axis)
    if "period" not in scan.settings:
        loop.run(slice(0, ticks), known.motion, known.strain, known.others)
        return loop.moved
    period = period_of(scan)
    learned = [_Periodic(axis, period, scan.sample_rate) for axis in axes]
    desired = known.motion[:, ::3]
    for part, step in _pieces(scan, period):
        k = np.arange(part.start, part.stop) % period
        motion, strain = known.motion[part].copy(), known.strain[part].copy()
        for i, one in enumerate(learned):
            motion[:, 3 * i : 3 * i + 3] += one.motion[k]
            strain[:, i] += one.strain[k]
        loop.run(part, motion, strain, known.others[part])
        if step:
            error = loop.moved.measured[part] @ controller.to_axes.T - desired[part]
            whole = error[-(len(error) // period * period) :].reshape(-1, period, 2).mean(axis=0)
            for i, one in enumerate(learned):
                one.learn(np.roll(whole[:, i], k[-1] + 1), step)
    return loop.moved


def _pieces(scan: Scan, period: int) -> list[tuple[slice, float]]:
    """Parts of a scan that begin in the middle of a turn, and by how much to learn of each."""
    first = int(scan.lines["first"][0])
    turn = round(float(scan.settings.get("turn_time", 0.0)) * scan.sample_rate / 2)  # type: ignore[arg-type]
    image, end = first - turn, len(scan.x)
    begin = image - (image - round(BEGIN * scan.sample_rate)) // (LINES * period) * LINES * period
    edges = [0, *range(begin, image, LINES * period), image]
    made = [(slice(a, b), STEP if a >= begin else 0.0) for a, b in itertools.pairwise(edges) if b > a]
    step, lines = IN_IMAGE
    edges = [*range(image, end, lines * period), end]
    return made + [(slice(a, b), step if b < end else 0.0) for a, b in itertools.pairwise(edges)]


class _Periodic:
    """The correction of one axis, over a period: its motion, and what that is in front of the dynamics."""

    def __init__(self, axis: AdaptiveController, period: int, rate: float) -> None:
        self._dynamics = axis.settings.dynamics
        known = self._dynamics.modes[0].frequency if self._dynamics else axis.resonance
        limit = BAND * known if math.isfinite(known) else rate / 10
        self._kept = np.arange(period // 2 + 1) * rate / period < min(limit, 0.4 * rate)
        self._omega = 2j * np.pi * np.arange(period // 2 + 1) * rate / period
        self._spectrum = np.zeros(period // 2 + 1, complex)
        self._period = period
        self._set()

    def learn(self, error: FloatArray, step: float) -> None:
        """Take a share of the mean error of some periods away, um, from the beginning of a period on."""
        self._spectrum = self._spectrum - step * np.where(self._kept, np.fft.rfft(error), 0.0)
        self._set()

    def _set(self) -> None:
        parts = [np.fft.irfft(self._spectrum * self._omega**power, self._period) for power in (0, 1, 2)]
        self.motion = np.stack(parts, axis=1)
        self.strain = np.full(self._period, np.nan)
        if self._dynamics is not None:
            around = -(-TAIL // self._period)
            whole = stage.strain(self._dynamics, np.tile(parts[0], 2 * around + 1))
            self.strain = whole[around * self._period : (around + 1) * self._period]


def _parts(axis: object) -> FloatArray:
    return np.stack([getattr(axis, part) for part in ("position", "velocity", "acceleration")], axis=1)


class _Loop:
    """A native stage and native controllers, run in parts from rest."""

    def __init__(
        self, plant: MultiAxisStage, axes: Sequence[AdaptiveController], to_axes: FloatArray, ticks: int
    ) -> None:
        plant.open()
        self._plant, self._axes, self._to_axes = plant, axes, np.ascontiguousarray(to_axes)
        self._calls = [axis._kernel.native() for axis in axes]
        self._rows = {name: np.zeros((ticks, len(axes)), dtype(name)) for name in SIMULATED}

    def run(self, part: slice, motion: FloatArray, strain: FloatArray, others: FloatArray) -> None:
        numbers = self._plant._noise.take((part.stop - part.start) * self._plant._samples)
        given = [np.ascontiguousarray(one) for one in (motion, strain, others)]
        rows: list[Any] = [self._rows[name][part] for name in SIMULATED]
        native = self._plant._plant.native()
        _loops.run_axes(self._calls, native, given[0], given[1], given[2], self._to_axes, numbers, *rows)
        for axis in self._axes:
            axis._kernel.require_reach()

    @property
    def moved(self) -> Moved:
        return Moved(*(self._rows[name] for name in ("volts", "measured", "true")))
