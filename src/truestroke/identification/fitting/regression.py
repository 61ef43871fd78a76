"""The model's terms as columns of a regression, and the prior of their coefficients."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from truestroke import _kernel
from truestroke.base.typing import FloatArray
from truestroke.control import stage
from truestroke.control.actuator import ActuatorModel
from truestroke.identification.fitting.normal import Prior
from truestroke.identification.records.resting import begun
from truestroke.identification.records.series import first_known
from truestroke.model import prior
from truestroke.model.branches import Branches
from truestroke.model.dynamics import Dynamics
from truestroke.model.layout import TERMS, Layout
from truestroke.model.models import Motion, asymmetry_slopes, known_terms
from truestroke.model.sampled import central_difference, creep_states, creep_to_come, lag_coefficients, respond

ROWS = 50_000  # of the regression at most: beyond, every so many samples; the plays see all of them
FLOOR = 0.05  # of the straight line's slope: the smallest partial slope
FIRST_FLOOR = 1e-3  # of the same: the smallest weight of the first play beside branches
STEEPEST = 0.2  # least slope of z - asymmetry(z): displacement rises by at most 5 times the weighted sum of the plays
CURVED = np.linspace(-1.0, 2.0, 31)  # of the stroke, the whole range of the asymmetry, in the record or not
LOOPS, POINTS = 8, 6  # from either end of the voltages, and on each way: where slopes with branches are bounded
RATE_DEPENDENT = (0, 3, 6, 9, 12)  # plays with a rate weight: the gradient matters for the first few only
CURVED_DEVIATION = 0.1  # of q: of each play of a curved voltage
DUHEM_DEVIATION = 0.5  # of q: of each state of Duhem
CELL_DEVIATION = 0.1  # of q: of each cell
DRIFT_DEVIATION = 0.05  # of the stroke: of a drift within the record
DRIFT_FROM = 40.0  # a logarithmic drift is straight for the first 40th of the record
CREEP_START = 0.015  # of the stroke: deviation of what a creep state still has to go at the start


Filter = tuple[FloatArray, FloatArray, int]
ALONE: Filter = (np.ones(1), np.empty((0, 4)), 0)

DRIFTS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "linear drift": lambda share: share,
    "log drift": lambda share: np.log1p(DRIFT_FROM * share) / np.log1p(DRIFT_FROM),
}
"""Drifts of the sensor's zero as functions of the time over the record's duration; each grows by 1 in a record."""


@dataclass(frozen=True, kw_only=True)
class Structure(Layout):
    """Which terms the model has: what cross-validation chooses."""

    rested: bool = False  # whether the actuator is taken to start at rest, so that the fit uses the start
    drift: tuple[str, ...] = ()  # of the record, names in `DRIFTS`
    branches: Branches | None = None  # without weights

    @property
    def starts(self) -> tuple[float, ...]:
        """Time constants, s, of creep that was under way when the record began: none at rest."""
        return () if self.rested else self.creep_times

    @cached_property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients: the weights, then the starts of the creep states, the drift, and the branches."""
        return (*self.names, *[f"start {tau:g} s" for tau in self.starts], *self.drift, *self.further)

    @cached_property
    def further(self) -> tuple[str, ...]:
        """Names of the weights of the branches, the last coefficients."""
        return () if self.branches is None else self.branches.names

    def columns_in(self, other: Structure) -> np.ndarray:
        """Places of this structure's coefficients among those of another that has them all."""
        places = {name: k for k, name in enumerate(other.coefficients)}
        return np.array([places[name] for name in self.coefficients])


@dataclass(frozen=True, eq=False, kw_only=True)
class Data:
    """A record prepared for the fit: voltage at the full rate, displacement of every `every`-th sample."""

    volts: FloatArray  # V
    displacement: FloatArray  # um above `zero`
    known: npt.NDArray[np.bool_]  # of the same samples: whether they may be fitted
    sample_rate: float
    every: int
    voltage_range: tuple[float, float]
    stroke: float  # um
    zero: float  # um
    fastest: float = 0.0  # um/s: `speed` of the whole record
    dynamics: Dynamics | None = None  # of the stage, at this sample rate
    delay: float = 0.0  # s, of the displacement behind the voltage
    time_constant: float = 0.0  # s, of a first-order lag
    duration: float = 0.0  # s, of the whole record, in which a drift grows by 1
    rest: float = math.inf  # s, under the first voltage before the record, from 0 V
    _kept: dict[str, tuple[object, int, FloatArray | None, FloatArray]] = field(default_factory=dict, init=False)

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

    @cached_property
    def begun(self) -> int:
        """First row of all from which on the velocity is that of the motion: none of a step with which it begins."""
        return begun(self.volts, self.sample_rate)

    @cached_property
    def settled(self) -> int:
        """First kept row that is fitted where the actuator is not taken to start at rest."""
        return -(-first_known(self.volts, float(np.ptp(self.volts))) // self.every)

    def fitted(self, rested: bool) -> npt.NDArray[np.bool_]:
        """Which kept rows are fitted: those that are known, from the start where the actuator starts at rest."""
        rows = self.known.copy()
        rows[: 0 if rested else self.settled] = False
        return rows

    def columns(self, s: Structure, z: FloatArray) -> FloatArray:
        """Columns of all coefficients and, last, the displacement. `z` is the model's own, um, at the full rate.

        Velocity and asymmetry come from the model, not from the measurement, whose noise would bias the weights. With
        `dynamics`, z is the strain, and the columns are those behind the stage.
        """
        counts, end = tuple(s.counts.values()), len(s.coefficients) - len(s.further)
        known = np.arange(s.of_plays, end - len(s.drift))
        moving = np.isin(known, np.r_[s.columns["lag"], s.columns["inertia"], s.columns["asymmetry"]])
        columns = np.empty((self.displacement.size, len(s.coefficients) + 1))
        columns[:, s.a] = self._once("plays", s.thresholds, lambda: plays(self.volts, s.thresholds, self._step))
        columns[:, s.b] = self._seen(self._with_rate(s, z))
        columns[:, known[moving]] = self._once("moving", counts, lambda: self._moving(s, z).T[:, moving], z)
        still = counts, s.creep_times, s.starts
        columns[:, known[~moving]] = self._once("still", still, lambda: self._still(s).T[:, ~moving])
        t = np.arange(self.displacement.size) * self.every / self.sample_rate
        for k, name in enumerate(s.drift, start=end - len(s.drift)):
            columns[:, k] = self._drift(name, t)
        if s.branches is not None:
            parts = s.branches.parts
            columns[:, end:-1] = self._once("branches", s.branches, lambda: parts(self.volts, self._step))
        columns[:, -1] = self.displacement
        return columns

    def _once(
        self,
        name: str,
        key: object,
        make: Callable[[], FloatArray | Iterator[FloatArray]],
        z: FloatArray | None = None,
    ) -> FloatArray:
        """`_seen` of what is made of the key and of z, in one part or in several; or the last one, if of the same."""
        if name not in self._kept or self._kept[name][:2] != (key, id(z)):
            made = make()
            seen = self._seen(made) if isinstance(made, np.ndarray) else np.hstack([self._seen(part) for part in made])
            self._kept[name] = key, id(z), z, seen  # z is held: no other array has its id
        return self._kept[name][-1]

    def _with_rate(self, s: Structure, z: FloatArray) -> FloatArray:
        H = plays(self.volts, tuple(s.thresholds[i] for i in s.rate_dependent), self._step)
        return np.asarray((self.rate_scale * central_difference(z, self.sample_rate)[:: self._step])[:, None] * H)

    def _moving(self, s: Structure, z: FloatArray) -> FloatArray:
        """The known terms, rows of the array, along z; those of the voltage alone are 0, as are the starts."""
        motion = Motion(z[:: self._step], central_difference(z, self.sample_rate)[:: self._step])
        known = known_terms(s, np.zeros((len(s.creep_times), motion.z_d.size)), motion, self.stroke)
        return np.vstack([known, np.zeros((len(s.starts), motion.z_d.size))])

    def _still(self, s: Structure) -> FloatArray:
        """The same along the voltage, at rest at 0 um, and the starts of creep."""
        t = np.arange(0, self.volts.size, self._step) / self.sample_rate
        creep = [c[:: self._step] for c in creep_states(self.volts, s.creep_times, self.sample_rate)]
        if self.rest < math.inf and creep:
            creep = list(creep - creep_to_come(float(self.volts[0]), s.creep_times, self.rest, t))
        known = known_terms(s, creep, Motion(np.zeros_like(t), np.zeros_like(t)), self.stroke)
        return np.vstack([known, *(np.exp(-t / tau) for tau in s.starts)])

    @property
    def _step(self) -> int:
        """Between the samples along which columns are made: a filter follows all of them."""
        return self.every if self.direct else 1

    @property
    def direct(self) -> bool:
        """Whether the displacement is that of the columns themselves: no stage, dead time or lag between."""
        return self.dynamics is None and self.delay == self.time_constant == 0.0

    @cached_property
    def _stage(self) -> Filter:
        return ALONE if self.dynamics is None else stage.difference_equation(self.dynamics)

    def _seen(self, columns: FloatArray) -> FloatArray:
        """`through` of columns, natively; of every sample that is kept."""
        if self.direct:
            return columns
        fs = self.sample_rate
        return respond_rows(columns, self.delay * fs, self.time_constant * fs, self.every, self._stage)

    def through(self, strain: FloatArray) -> FloatArray:
        """What the stage, dead time and lag make of a strain, um, at the full rate."""
        moved = strain if self.dynamics is None else stage.through(self.dynamics, strain)
        return respond(moved, self.delay * self.sample_rate, self.time_constant * self.sample_rate)

    def slope(self, s: Structure, predicted: FloatArray, c: FloatArray) -> FloatArray:
        """That of z - asymmetry(z): the columns over it are the derivative of the prediction by the coefficients."""
        slope = 1 - c[s.columns["asymmetry"]] @ asymmetry_slopes(predicted, self.stroke)[: s.asymmetry]
        return np.maximum(slope, 0.1)

    def starts(self, s: Structure, c: FloatArray) -> FloatArray:
        """What the creep states still had to go at the start of the record, um, at the full rate."""
        t = np.arange(self.volts.size) / self.sample_rate
        return np.asarray(sum((w * np.exp(-t / tau) for w, tau in zip(c, s.starts, strict=False)), np.zeros_like(t)))

    def drift(self, s: Structure, c: FloatArray, samples: int) -> FloatArray:
        """Drift of the zero, um, of the first samples of the record, at the full rate; c after the weights."""
        t, weights = np.arange(samples) / self.sample_rate, c[len(s.starts) : len(s.starts) + len(s.drift)]
        parts = (w * self._drift(name, t) for w, name in zip(weights, s.drift, strict=True))
        return np.asarray(sum(parts, np.zeros_like(t)))

    def _drift(self, name: str, t: FloatArray) -> FloatArray:
        """One of `DRIFTS` at the times t, s: 0 at the end of these rows, after which the model is used."""
        end = np.array([(self.volts.size - 1) / self.sample_rate / self.duration])
        return np.asarray(DRIFTS[name](t / self.duration) - DRIFTS[name](end))

    def prior(self, s: Structure) -> Prior:
        """`prior.covariance`, but lag and offset as far as the record's clock and sensor may be off."""
        return _prior(s, self.stroke, self.voltage_range, self.sample_rate)

    def constraints(self, s: Structure, velocity: float) -> tuple[FloatArray, FloatArray]:
        """G and g of G c >= g, without which there is no inverse.

        The partial slopes at the velocities +velocity and -velocity are `FLOOR` q at least, and so are they at all
        between; and z - asymmetry(z) rises by `STEEPEST` of z at least. With branches the slopes are those of all
        ways of `loops`.
        """
        n, size = len(s.thresholds), len(s.coefficients)
        plays, asymmetry = np.zeros((2, n, size)), np.zeros((CURVED.size, size))
        for sign, side in zip((1, -1), plays, strict=True):
            for i in range(n if s.branches is None else 0):
                side[i, : s.parameters] = s.vector(
                    np.arange(n) <= i, sign * self.rate_scale * velocity * (s.rate_plays <= i)
                )
        asymmetry[:, s.columns["asymmetry"]] = -asymmetry_slopes(CURVED * self.stroke, self.stroke)[: s.asymmetry].T
        slopes = plays.reshape(-1, size) if s.branches is None else self._slopes(s, s.branches, velocity)
        floors = np.repeat([FLOOR * self.q, STEEPEST - 1], [len(slopes), CURVED.size])
        return np.vstack([slopes, asymmetry]), floors

    def _slopes(self, s: Structure, branches: Branches, velocity: float) -> FloatArray:
        """The slope by voltage at the samples of `loops`, up and down, at rest and at the velocity; rows of G.

        The last row keeps the weight of the first play positive, as models must have it: branches may take its place.
        """
        x, rows = loops(self.voltage_range), []
        y, r = plays(x, s.thresholds), np.array(s.thresholds)
        for sign in (1, -1):
            moves = sign * (x[:, None] - y) >= r - 1e-9 * branches.half
            further = branches.slopes(x, sign)
            for rate in (0.0, sign * self.rate_scale * velocity):
                side = np.zeros((x.size, len(s.coefficients)))
                side[:, s.a], side[:, s.b] = moves, rate * moves[:, s.rate_plays]
                side[:, len(s.coefficients) - len(s.further) :] = further
                rows.append(side)
        first = np.zeros((1, len(s.coefficients)))
        first[0, s.a[0]] = FLOOR / FIRST_FLOOR
        return np.vstack([*rows, first])

    def model(self, s: Structure, c: FloatArray, velocity: float) -> ActuatorModel:
        """The model with these coefficients; its covariance is not known yet."""
        m, more = s.parameters, len(s.further)
        weights = tuple(c[c.size - more :].tolist())
        return ActuatorModel(
            **s.terms,
            branches=None if s.branches is None else dataclasses.replace(s.branches, weights=weights),
            weights=c[:m],
            covariance=np.zeros((m, m)),
            stroke=self.stroke,
            zero=self.zero,
            voltage_range=self.voltage_range,
            rate_scale=self.rate_scale,
            velocity=velocity,
            dynamics=self.dynamics,
        )


@lru_cache(maxsize=64)
def _prior(s: Structure, stroke: float, voltage_range: tuple[float, float], sample_rate: float) -> Prior:
    """Kept for the many fits that differ by their rows and by what is behind the actuator."""
    low, high = voltage_range
    q = stroke / (high - low)
    a = prior.play_weights(s.thresholds, high - low, prior.FIRST_SLOPE * q)
    known = prior.covariance(s, a, q=q, stroke=stroke)
    lag, offset = s.columns["lag"], s.columns["offset"]
    known[lag, lag] = max(TERMS["lag"].deviation, 1 / sample_rate) ** 2
    known[offset, offset] = (stroke + q * max(abs(low), abs(high))) ** 2
    starts = np.repeat([CREEP_START, DRIFT_DEVIATION], [len(s.starts), len(s.drift)]) ** 2 * stroke**2
    of = {"duhem": DUHEM_DEVIATION, "cell": CELL_DEVIATION}
    curved = [of.get(name.split()[0], CURVED_DEVIATION) for name in s.further]
    starts = np.append(starts, (np.array(curved) * q) ** 2)
    covariance = np.diag(np.append(np.zeros(s.parameters), starts))
    covariance[: s.parameters, : s.parameters] = known
    mean = np.append(s.vector(a), np.zeros_like(starts))
    mean.flags.writeable = covariance.flags.writeable = False
    return Prior(mean, covariance)


def plays(x: FloatArray, thresholds: tuple[float, ...], every: int = 1) -> FloatArray:
    """Play states of every `every`-th sample, natively; from rest at 0 V."""
    rows = np.empty((-(-x.size // every), len(thresholds)))
    _kernel.play_history(np.ascontiguousarray(x), np.array(thresholds), np.zeros(len(thresholds)), every, rows)
    return rows


def respond_rows(
    columns: FloatArray, delay: float, time_constant: float, every: int = 1, before: Filter = ALONE
) -> FloatArray:
    """`respond` of columns, natively; of every `every`-th row, behind a filter of `stage.difference_equation`."""
    taps, sections, dead = before
    whole, part = divmod(delay, 1.0)
    rows, lag = np.empty((-(-len(columns) // every), columns.shape[1])), np.array(lag_coefficients(time_constant))
    whole = dead + min(int(whole), len(columns))
    _kernel.respond_rows(np.ascontiguousarray(columns), taps, sections, lag, whole, part, every, rows)
    return rows


def loops(voltage_range: tuple[float, float]) -> FloatArray:
    """A voltage with ways up and down from many turns: from 0 V over the whole range, then loops from either end, V."""
    low, high = voltage_range
    inside = np.linspace(low, high, LOOPS + 2)[1:-1]
    turns = np.concatenate([[0.0, high], *[[a, high] for a in inside], [low], *[[b, low] for b in inside], [high, low]])
    return np.asarray(np.interp(np.arange((turns.size - 1) * POINTS + 1) / POINTS, np.arange(turns.size), turns))


def even_thresholds(n: int, largest: float) -> tuple[float, ...]:
    """n thresholds from 0 up to below `largest`, V."""
    return tuple(i / n * largest for i in range(n))


def rate_dependent(n: int) -> tuple[int, ...]:
    """Plays that have a rate weight where the rate matters."""
    return tuple(i for i in RATE_DEPENDENT if i < n)
