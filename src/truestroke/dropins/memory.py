"""The inverse of a model without a sensor: it remembers all that the output has done."""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from truestroke import _kernel
from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import actuator
from truestroke.control.actuator import ActuatorModel
from truestroke.model.models import Motion, known_terms
from truestroke.model.sampled import central_difference

PASSES = 8  # at most: the creep of a voltage that follows from it
CLOSE = 1e-7  # of the voltage range: a pass that changes less is the last


class Memory:
    """One axis whose voltages are all known: where it is, and which voltages take it elsewhere.

    It comes from rest at 0 V. Plays and creep are those of `model`, of one with branches those of `model.plain`. Dead
    time and lag are led by the velocity; resonances are left out.

    Parameters
    ----------
    model : ActuatorModel
        Of `identify` or `load_model`.
    voltage_limits : tuple[float, float]
        Of the output, V; the range of the model's record bounds it, too.

    Attributes
    ----------
    volts, position : float
        At the output now, V; where the axis is by the model, um above the model's zero.

    Raises
    ------
    SettingError
        The limits leave no voltage, or the model's slopes are not positive.

    Examples
    --------
    >>> model = ActuatorModel(
    ...     thresholds=(0.0, 0.5), weights=[8.0, 2.0, 0.0, 0.0], covariance=np.eye(4), stroke=20.0,
    ...     voltage_range=(0.0, 2.0),
    ... )
    >>> axis = Memory(model, (0.0, 10.0))
    >>> up = axis.voltages([0.0, 9.0, 18.0], sample_rate=100.0)
    >>> axis.output(up, sample_rate=100.0)
    >>> down = axis.voltages([9.0], sample_rate=100.0)
    >>> up.round(3).tolist(), down.round(3).tolist()  # another voltage for the same place
    ([0.0, 1.0, 1.9], [0.8])
    >>> round(axis.position, 3)
    18.0
    """

    def __init__(self, model: ActuatorModel, voltage_limits: tuple[float, float]) -> None:
        checks.instance("model", model, ActuatorModel, actuator.EXPECTED)
        if model.branches is not None:
            if model.plain is None:
                raise SettingError("model.plain", None, "the model of plays alone, for this one has branches")
            model = model.plain
        given, (first, last) = checks.interval("voltage_limits", voltage_limits, "V"), model.voltage_range
        self.model, self.limits = model, (max(given[0], first), min(given[1], last))
        if not self.limits[0] < self.limits[1]:
            bound = f"limits that have voltages of the model's record, {first:.4g} to {last:.4g} V"
            raise SettingError("voltage_limits", voltage_limits, bound, "V")
        self._a, self._b = model.of_all_plays(model.weights)
        if not (np.cumsum(self._a) > 0).all():
            raise SettingError(
                "model.weights", "slopes below 0", "of positive partial sums, so that it can be inverted"
            )
        self._y = np.zeros(len(model.thresholds))
        self._c = np.zeros(len(model.creep_times))
        self.volts = 0.0
        self.position = self._where(0.0)

    def voltages(self, positions: object, sample_rate: float) -> FloatArray:
        """Voltages, V, for positions from now on, um above the model's zero; the axis stays where it is.

        A position beyond `reach` gets the limit; one position is taken for rest.
        """
        z = checks.finite_array("positions", positions, "um")  # type: ignore[arg-type]
        fs, model = checks.positive("sample_rate", sample_rate, "Hz"), self.model
        if not z.size:
            return z
        moving = z.size > 1
        rate = central_difference(z, fs) if moving else np.zeros_like(z)
        z = z + (model.delay + model.time_constant) * model.seen(rate)
        z, rate = model.before_lag(z, rate, fs)
        velocity = model.seen(rate)
        volts, before = np.full_like(z, self.volts), np.full_like(z, np.inf)
        for _ in range(PASSES):
            creep = self._creep(volts, fs) if moving else self._c[:, None]
            free = known_terms(model, creep, Motion(z, velocity), model.stroke)
            wanted = np.ascontiguousarray(z - model.weights[model.of_plays :] @ free)
            volts = np.clip(self._plays(wanted, model.rate_scale * velocity), *self.limits)
            if not model.creep_times or np.abs(volts - before).max() < CLOSE * np.ptp(self.limits):
                break
            before = volts
        return volts

    def output(self, volts: object, sample_rate: float) -> None:
        """These voltages, V, were output at this rate, Hz."""
        x = checks.finite_array("volts", volts, "V")  # type: ignore[arg-type]
        if not x.size:
            return
        creep = self._creep(x, checks.positive("sample_rate", sample_rate, "Hz"))
        for part in self._turns(x):
            self._step(part)
        self._c = creep[:, -1]
        self.position = self._where(float(x[-1]))

    def hold(self, seconds: float) -> None:
        """So long, s, nothing has changed at the output: the axis creeps."""
        seconds = checks.number("seconds", seconds, "s")
        if self._c.size and seconds > 0:
            self._c = self._c - np.expm1(-seconds / np.array(self.model.creep_times)) * (self.volts - self._c)
            self.position = self._where(self.volts)

    def reach(self) -> tuple[float, float]:
        """Lowest and highest position of slow motion from rest at 0 V, um above the model's zero."""
        ends = []
        for end in self.limits:
            trial = copy.copy(self)
            trial._y = np.zeros_like(self._y)
            trial._c = np.zeros_like(self._c)
            trial._step(end)
            ends.append(trial._where(end))
        return ends[0], ends[1]

    def _creep(self, volts: FloatArray, fs: float) -> FloatArray:
        """Creep states at each of these voltages, V, shape (states, samples)."""
        before = np.concatenate([[self.volts], volts[:-1]])
        found = np.empty((self._c.size, volts.size))
        for row, tau, start in zip(found, self.model.creep_times, self._c, strict=True):
            share = -np.expm1(-1 / (tau * fs))
            row[:], _ = lfilter([share], [1.0, share - 1.0], before, zi=[(1 - share) * start])
        return found

    def _plays(self, wanted: FloatArray, rate: FloatArray) -> FloatArray:
        """Voltages whose plays make this sum, um."""
        found = np.empty_like(wanted)
        for rates in (np.ascontiguousarray(rate), np.zeros_like(wanted)):  # at rest the slopes are positive
            y = self._y.copy()
            if _kernel.play_invert(wanted, rates, self._a, self._b, self._thresholds, y, found) < 0:
                return found
        raise SettingError("model.weights", "slopes below 0", "of positive partial sums, so that it can be inverted")

    @property
    def _thresholds(self) -> FloatArray:
        return np.array(self.model.thresholds)

    def _step(self, volts: float) -> None:
        r = self._thresholds
        self._y = np.maximum(volts - r, np.minimum(volts + r, self._y))
        self.volts = volts

    def _turns(self, x: FloatArray) -> list[float]:
        """The voltages at which the direction changes, and the last one: the plays remember nothing else."""
        steps = np.sign(np.diff(x, prepend=self.volts))
        moved = np.flatnonzero(steps)
        turns = [float(x[b - 1]) for a, b in pairwise(moved) if steps[a] != steps[b]]
        return [*turns, float(x[-1])]

    def _where(self, volts: float) -> float:
        w = self.model.weights
        plays = np.array([float(self._a @ self._y)])
        found = actuator.displacement(self.model, w, plays, self._c[:, None], np.zeros(1))
        return float(found[0])
