"""The model's terms as columns of a regression, and what is believed of their coefficients beforehand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from truestroke import _kernel
from truestroke.base.typing import FloatArray
from truestroke.control.actuator import (
    ActuatorModel,
    asymmetry_columns,
    asymmetry_slopes,
    central_difference,
    creep_states,
)
from truestroke.control.settings import RATE_DEPENDENT, ControllerSettings
from truestroke.identification.normal import Prior
from truestroke.identification.series import settled
from truestroke.model import prior

ROWS = 50_000  # of the regression at most: beyond, every so many samples; the plays see all of them
SETTLING = 0.1  # of the record at most: what is skipped until the play states are known
FLOOR = 0.05  # of the straight line's slope: the smallest partial slope
STEEPEST = 0.2  # least slope of z - asymmetry(z): displacement rises by 5 times what the plays say at most
CURVED = np.linspace(-1.0, 2.0, 31)  # of the stroke, all that the asymmetry covers, seen or not
CREEP_START = 0.015  # of the stroke: deviation of what a creep state still has to go at the start


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Which terms the model has: what cross-validation chooses."""

    thresholds: tuple[float, ...]
    rate_dependent: tuple[int, ...] = ()
    creep_times: tuple[float, ...] = ()
    asymmetry: int = 0
    rested: bool = False  # whether the actuator is taken to start at rest, so that the fit uses the start

    @property
    def starts(self) -> tuple[float, ...]:
        """Time constants, s, of creep that was under way when the record began: none at rest."""
        return () if self.rested else self.creep_times

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the weights in the order of `ControllerSettings`; behind them the starts of the creep states."""
        made = ControllerSettings(
            sample_rate=1.0,
            stroke=1.0,
            voltage_limits=(0.0, 1.0 + 2.0 * self.thresholds[-1]),
            thresholds=self.thresholds,
            plays=len(self.thresholds),
            rate_dependent=self.rate_dependent,
            creep_times=self.creep_times,
            asymmetry=self.asymmetry,
        )
        return (*made.names, *[f"start {tau:g} s" for tau in self.starts])

    def columns_in(self, other: Structure) -> np.ndarray:
        """Places of this structure's coefficients among those of another that has them all."""
        places = {name: k for k, name in enumerate(other.names)}
        return np.array([places[name] for name in self.names])


@dataclass(frozen=True, eq=False, kw_only=True)
class Data:
    """A record as the fit sees it: delayed voltage at the full rate, displacement of every `every`-th sample."""

    volts: FloatArray  # V, already delayed
    displacement: FloatArray  # um above `zero`
    known: npt.NDArray[np.bool_]  # of the same samples: whether they may be fitted
    sample_rate: float
    every: int
    voltage_range: tuple[float, float]
    stroke: float  # um
    zero: float  # um
    fastest: float = 0.0  # um/s: `speed` of the whole record

    @property
    def q(self) -> float:
        """Straight-line sensitivity, um/V."""
        return self.stroke / (self.voltage_range[1] - self.voltage_range[0])

    @property
    def speed(self) -> float:
        """Fastest motion of these rows as a straight line would have it, um/s."""
        return self.q * float(np.abs(central_difference(self.volts, self.sample_rate)).max())

    @property
    def rate_scale(self) -> float:
        """c_b, s/um: as `ControllerSettings` has it, unless the record is faster."""
        return 1 / max(50 * self.stroke, self.fastest)

    def settled(self) -> int:
        """First kept row whose plays do not remember their start."""
        return -(-min(settled(self.volts, float(np.ptp(self.volts))), int(SETTLING * self.volts.size)) // self.every)

    def fitted(self, rested: bool) -> npt.NDArray[np.bool_]:
        """Which kept rows are fitted: those that are known, from the start where the actuator starts at rest."""
        rows = self.known.copy()
        rows[: 0 if rested else self.settled()] = False
        return rows

    def columns(self, s: Structure, z: FloatArray) -> FloatArray:
        """Columns of all coefficients and, last, the displacement. `z` is the model's own, um, at the full rate.

        Velocity and asymmetry come from the model, not from the measurement, whose noise would bias the weights.
        """
        every, n = self.every, len(s.thresholds)
        rate = central_difference(z, self.sample_rate)[::every, None]
        H = plays(self.volts, s.thresholds, every)
        rate_dependent = {i: self.rate_scale * rate * H[:, i : i + 1] for i in s.rate_dependent}
        pairs = [
            c
            for i in range(n)
            for c in ((H[:, i : i + 1], rate_dependent[i]) if i in rate_dependent else (H[:, i : i + 1],))
        ]
        creep = [c[::every, None] for c in creep_states(self.volts, s.creep_times, self.sample_rate)]
        t = np.arange(0, self.volts.size, every)[:, None] / self.sample_rate
        starts = [np.exp(-t / tau) for tau in s.starts]
        asymmetry = asymmetry_columns(z[::every], self.stroke)[:, : s.asymmetry]
        target = self.displacement[:, None]
        return np.hstack([*pairs, *creep, rate, np.ones_like(t), asymmetry, *starts, target])

    def starts(self, s: Structure, c: FloatArray) -> FloatArray:
        """What the creep states still had to go at the start of the record, um, at the full rate."""
        t = np.arange(self.volts.size) / self.sample_rate
        return np.asarray(sum((w * np.exp(-t / tau) for w, tau in zip(c, s.starts, strict=True)), np.zeros_like(t)))

    def prior(self, s: Structure) -> Prior:
        """`prior.covariance`, but lag and offset as far as the record's clock and sensor may be off."""
        low, high = self.voltage_range
        a = prior.play_weights(s.thresholds, high - low, prior.FIRST_SLOPE * self.q)
        terms = {"creeps": len(s.creep_times), "lag": True, "offset": True, "asymmetry": s.asymmetry}
        P = prior.covariance(a, s.rate_dependent, q=self.q, stroke=self.stroke, **terms)  # type: ignore[arg-type]
        lag = P.shape[0] - s.asymmetry - 2
        P[lag, lag] = max(prior.LAG_DEVIATION, 1 / self.sample_rate) ** 2
        P[lag + 1, lag + 1] = (self.stroke + self.q * max(abs(low), abs(high))) ** 2
        m, k = P.shape[0], len(s.starts)
        covariance = np.zeros((m + k, m + k))
        covariance[:m, :m] = P
        covariance[range(m, m + k), range(m, m + k)] = (CREEP_START * self.stroke) ** 2
        mean = np.zeros(m + k)
        mean[[s.names.index(f"a{i}") for i in range(len(a))]] = a
        return Prior(mean, covariance)

    def constraints(self, s: Structure, velocity: float) -> tuple[FloatArray, FloatArray]:
        """G and g of G c >= g, without which there is no inverse.

        The partial slopes at the velocities +velocity and -velocity are `FLOOR` q at least, and so are they at all
        between; and z - asymmetry(z) rises by `STEEPEST` of z at least.
        """
        names, n = s.names, len(s.thresholds)
        plays, asymmetry = np.zeros((2, n, len(names))), np.zeros((CURVED.size, len(names)))
        for sign, side in zip((1, -1), plays, strict=True):
            for i in range(n):
                side[i:, names.index(f"a{i}")] = 1
                if i in s.rate_dependent:
                    side[i:, names.index(f"b{i}")] = sign * self.rate_scale * velocity
        first = names.index("offset") + 1
        asymmetry[:, first : first + s.asymmetry] = -asymmetry_slopes(CURVED * self.stroke, self.stroke)[
            :, : s.asymmetry
        ]
        floors = np.repeat([FLOOR * self.q, STEEPEST - 1], [2 * n, CURVED.size])
        return np.vstack([plays.reshape(-1, len(names)), asymmetry]), floors

    def model(self, s: Structure, c: FloatArray, velocity: float) -> ActuatorModel:
        """The model with these coefficients; its covariance is not known yet."""
        m = c.size - len(s.starts)
        return ActuatorModel(
            thresholds=s.thresholds,
            rate_dependent=s.rate_dependent,
            creep_times=s.creep_times,
            asymmetry=s.asymmetry,
            weights=c[:m],
            covariance=np.zeros((m, m)),
            stroke=self.stroke,
            zero=self.zero,
            voltage_range=self.voltage_range,
            rate_scale=self.rate_scale,
            velocity=velocity,
        )


def plays(x: FloatArray, thresholds: tuple[float, ...], every: int = 1) -> FloatArray:
    """Play states of every `every`-th sample, natively; from rest at 0 V."""
    rows = np.empty((-(-x.size // every), len(thresholds)))
    _kernel.play_history(np.ascontiguousarray(x), np.array(thresholds), np.zeros(len(thresholds)), every, rows)
    return rows


def delayed(x: FloatArray, samples: int) -> FloatArray:
    """x some samples ago; before the record it is the first."""
    return np.concatenate([np.full(min(samples, x.size), x[0]), x[: max(x.size - samples, 0)]])


def even_thresholds(n: int, largest: float) -> tuple[float, ...]:
    """n thresholds from 0 up to below `largest`, V."""
    return tuple(i / n * largest for i in range(n))


def rate_dependent(n: int) -> tuple[int, ...]:
    """Plays that have a rate weight where the rate matters."""
    return tuple(i for i in RATE_DEPENDENT if i < n)
