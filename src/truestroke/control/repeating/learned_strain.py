"""What is the same in the error of each period of an axis, learned as strain, while its controller goes on learning.

The strain G^-1 z_d, which the inverse of the hysteresis gets, is known ahead. The strain of a period r is added to it::

    strain(t) = G^-1 z_d(t) + r(t mod T)

The law of `harmonics` makes the next r of the mean error of some periods; U is the spectrum of r, and G the
response that is known. r is in front of the stage and behind everything that the controller has learned of velocities
and accelerations, so that the stage answers it with G: near a resonance a change of the motion itself is answered with
up to six times as much, as the inverse of the stage makes a large difference of a small one there.

A batch is concluded in steps, one in a tick, so that a loop in real time is not late. When the next r begins does not
depend on how they were done: blocks of ticks, in which all steps are one, have the same bits.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, snapshot
from truestroke.base.checks import SettingError
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.controller import State
from truestroke.control.repeating import iterative
from truestroke.control.repeating.harmonics import BoolArray, HarmonicLaw
from truestroke.control.repeating.repetition import LONGEST, SHORTEST
from truestroke.control.repeating.response_prior import ROUNDS, FewNumbers, beside
from truestroke.control.repeating.turns import Turns
from truestroke.model.dynamics import Dynamics

BEGIN = 0.5  # s: until then the controller learns alone
AVERAGED = 0.2  # s of the periods of a batch, two at least
GROWING, FEWEST = 0.6, 4  # the same of turns that grow, whose error is another one soon: of the decay, and periods
CAREFUL = 0.7  # of the step in turns that grow: where a resonance is given wrong, a whole one may go the wrong way
BATCHES = 6  # of turns that grow, at least: the first ones may be wrong
DECAY = 5.0  # time constants of the first mode before them, in which a change of r decays
SHORTEST_DECAY, LONGEST_DECAY = 0.05, 0.2  # s; where f0 times damping is below 4 Hz some of it remains
WORSE = 2.0  # times the error without r: then it is learned from the beginning
DRIFTS = 1.0  # times the power of the drift within a batch: that from batch to batch
NOISY = 4.0  # times the variance of its noise: an error with less power says nothing of R
PERIODIC = 1e-6  # ticks: how near to whole ticks a period has to be
GAP = 0.2  # of a period: with more missing measurements it does not count
STEPS = ("_conclude", "_look", "_see", *["_know"] * ROUNDS, "_follow", "_begin")
"""Of the learning from a batch."""


def whole_ticks(argument: str, period: float, sample_rate: float) -> int:
    """Ticks of a period, s.

    Raises
    ------
    SettingError
        It is no whole number of ticks, or not 16 to 8192 of them.

    Examples
    --------
    >>> whole_ticks("period", 0.025, 5000.0)
    125
    """
    period = checks.within(argument, period, SHORTEST / sample_rate, LONGEST / sample_rate, "s")
    ticks = period * sample_rate
    if abs(ticks - round(ticks)) > PERIODIC:
        near = round(ticks) / sample_rate
        bound = f"a whole number of ticks of {sample_rate:g} Hz, not {ticks:.10g}: such as {near:.10g} s"
        raise SettingError(argument, period, bound, "s")
    return round(ticks)


class StrainLaw(HarmonicLaw):
    """The law for a controller that goes on learning: a batch builds on the last one, as no earlier one holds.

    While the controller learns, the error drifts: that shows nothing of R.

    Attributes
    ----------
    drift2 : ndarray
        Variance of the drift of the error from batch to batch, um^2.
    share : float
        Of each step that is taken.
    """

    worse = math.inf
    share = 1.0

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.drift2 = np.zeros(self.response.size)

    @property
    def contradicted(self) -> bool:
        """Whether the last batch did what R and the drift do not explain."""
        return self._changed

    def _steps(self, E: ComplexArray, noise2: FloatArray) -> FloatArray:
        return np.asarray(self.share * super()._steps(E, noise2))

    def _told(self, Z: ComplexArray, noise2: FloatArray) -> FloatArray:
        """A change that was made of noise meets the same noise in the difference of the batches: that is no answer."""
        power = np.maximum(np.abs(self.desired - Z) ** 2, 1e-300)
        return np.asarray(np.maximum(0.0, 1 - NOISY * noise2 / power))

    def _crossed(self, x: ComplexArray) -> FloatArray:
        return np.asarray(super()._crossed(x) + self.drift2)

    def _hidden(self, crossed: FloatArray) -> FloatArray:
        return self.drift2


class LearnedStrain:
    """The strain of a period that one axis learns.

    A batch has some periods in which the last change of r decays, and some whose mean error counts. A period in which a
    limit held the voltage, or more than `GAP` of the measurements are missing, does not count; what is missing in
    another one is the mean of the others there. Where the error becomes twice what it was without r, r begins at 0
    again, with what has been learned of the stage.

    Parameters
    ----------
    dynamics : Dynamics
        Of the stage, with the sample rate of the controller.
    period : int
        Ticks.
    others : int
        Axes whose steps are done before those of this one, so that no tick has two.

    Attributes
    ----------
    errors : list of float
        Rms of the mean error of each batch, where errors count, um; of turns that grow as if each were the largest.
    """

    def __init__(self, dynamics: Dynamics, period: int, others: int = 0) -> None:
        self._dynamics, self.period, self._others = dynamics, period, others * len(STEPS)
        rate = dynamics.sample_rate
        first = dynamics.modes[0]
        decay = DECAY / (2 * math.pi * first.frequency * first.damping)
        decay = min(max(decay, SHORTEST_DECAY), LONGEST_DECAY)
        self._counting, self._decaying = 0, math.ceil(decay * rate / period)
        self.errors: list[float] = []
        self._wave, self._counts = np.empty(0), np.empty(0, dtype=bool)
        self._law: StrainLaw | None = None
        self._strain, self._without = np.zeros(self.period), math.inf
        self._turns = Turns(period, 0, 0)
        self._held = False
        self._periods, self._begins = np.empty((0, period)), 0  # from one step to the next
        self._Z: ComplexArray = np.zeros(period // 2 + 1, dtype=np.complex128)
        self._noise2, self._drift2 = np.zeros(period // 2 + 1), np.zeros(period // 2 + 1)
        self._left, self._new = 0.0, np.zeros(period)
        self._restart()

    def _restart(self) -> None:
        """At the first tick of a motion."""
        self._todo: deque[str] = deque()  # names of steps
        self._changed, self._next, self._first = self._turns.start, 0, self._turns.start
        self._before = np.zeros(self.period)
        self._error = np.full((self._decaying + self._counting) * self.period, np.nan)

    def follow(self, wave: FloatArray, counts: BoolArray, turns: Turns) -> None:
        """A motion that repeats this period in these turns; what was learned of the same one is kept.

        Parameters
        ----------
        wave : ndarray, shape (period,)
            Desired displacement in the largest turn, um.
        counts : ndarray of bool, shape (period,)
            Where errors count.
        turns : Turns
            Where it repeats, and how large each turn is.

        Raises
        ------
        SettingError
            Turns that grow are too few to learn from; nothing has changed.
        """
        counting = self.periods_that_count(turns)
        before, self._turns = self._turns, turns
        same = self._law is not None and np.array_equal(wave, self._wave) and turns.start == before.start
        if same and np.array_equal(turns.sizes, before.sizes):
            return
        self._wave, self._counts, self._counting = wave, counts, counting
        self._forget()
        self._restart()

    def periods_that_count(self, turns: Turns) -> int:
        """Those of a batch; SettingError where turns that grow are too few to learn from."""
        rate = self._dynamics.sample_rate
        if not turns.sizes.size:
            return max(2, math.ceil(AVERAGED * rate / self.period))
        counting = max(FEWEST, math.ceil(GROWING * self._decaying))
        least = BATCHES * (self._decaying + counting)
        if turns.sizes.size < least:
            more = least - turns.sizes.size
            bound = f"left out, or the motion {more} turns longer: {turns.sizes.size} turns grow evenly, and with this "
            bound += f"damping {least} are learned from"
            raise SettingError("period", self.period / rate, bound, "s")
        return counting

    def _forget(self) -> None:
        """r is 0, and nothing is known of the stage but its dynamics."""
        dynamics, rate = self._dynamics, self._dynamics.sample_rate
        f = np.arange(self.period // 2 + 1) * rate / self.period
        G, sensor, _ = iterative.response_of(dynamics, f, rate, 1.0)
        band = iterative.band(dynamics, rate)
        prior = FewNumbers(dynamics, f, rate, beside(f, dynamics.modes[0].frequency, band))
        self._law = StrainLaw(sensor * np.fft.rfft(self._wave), G, prior, f <= band, samples=self.period)
        self._law.share = CAREFUL if self._turns.sizes.size else 1.0
        self._strain, self._without = np.zeros(self.period), math.inf

    def _return(self) -> None:
        """r is 0 again; what batches have shown of the stage stays, as it made r wrong that nothing was known of it.

        Not where the last one contradicts it: no batch would then show what is true, as all would contradict it, too.
        """
        before, harmonics = self._law, np.arange(self.period // 2 + 1.0)
        self._forget()
        assert before is not None
        assert self._law is not None
        if not before.contradicted:
            self._law.remember(before, harmonics, harmonics)

    # ---- The strain ------------------------------------------------------------------------------------------------

    def at(self, tick: int) -> float:
        """r in a tick, um, with the bits of `of`; they are asked for one after the other."""
        if tick == 0:
            self._restart()
        self._next = tick + 1
        place = (tick - self._turns.start) % self.period
        share = min(max((tick - self._changed) / self.period, 0.0), 1.0)
        left = min(max((tick - self._turns.stop) / self.period, 0.0), 1.0)
        strain = self._strain.item(place)
        if share < 1.0:
            before = self._before.item(place)
            strain = before + share * (strain - before)
        return strain * (1 - left) * self._turns.at(tick)

    def of(self, ticks: range) -> FloatArray:
        """The same of some ticks, which none of `stops` divides."""
        if ticks.start == 0:
            self._restart()
        self._next = ticks.stop
        k = np.arange(ticks.start, ticks.stop)
        place = (k - self._turns.start) % self.period
        share = np.clip((k - self._changed) / self.period, 0.0, 1.0)
        strain = self._before[place] + share * (self._strain - self._before)[place]
        strain = np.where(share < 1.0, strain, self._strain[place])
        left = np.clip((k - self._turns.stop) / self.period, 0.0, 1.0)
        return np.asarray(strain * (1 - left) * self._turns.size(k))

    @property
    def stops(self) -> tuple[int, ...]:
        """The tick after which the next batch is complete."""
        end = self._first + self._error.size
        return (end,) if self._law is not None and end <= self._turns.stop else ()

    # ---- Learning ----------------------------------------------------------------------------------------------------

    def hold(self) -> None:
        """Stop learning; r stays as it is."""
        self._held = True
        self._todo.clear()

    def resume(self) -> None:
        """Learn again; no period in which it was held counts."""
        self._held = False

    def put(self, tick: int, error: float) -> None:
        """Measured minus desired displacement in a tick, um; NaN where it is missing, infinite where a limit holds.

        The next step of the learning, if one waits, is done here, when the voltage of this tick has left.
        """
        place, error = tick - self._first, error / self._turns.at(tick)
        if 0 <= place < self._error.size - 1 and tick < self._turns.stop:
            self._error[place] = math.nan if self._held else error
        else:
            self._take(tick, np.array([error]))
        if self._todo:
            getattr(self, self._todo.popleft())()

    def see(self, tick: int, errors: FloatArray) -> None:
        """Measured minus desired displacement, um, of a tick and those that follow it, up to the end of a batch.

        All steps of the learning are done, as if each had had its tick.
        """
        self._take(tick, errors / self._turns.size(np.arange(tick, tick + errors.size)))
        while self._todo:
            getattr(self, self._todo.popleft())()

    def _take(self, tick: int, errors: FloatArray) -> None:
        errors = errors[: max(self._turns.stop - tick, 0)]
        if self._law is None or not errors.size:
            return
        size = self._error.size
        if tick - self._first >= size:  # the last ones of the batch never came
            self._complete(tick)
        begin = max(self._first - tick, 0)
        place = tick + begin - self._first
        part = errors[begin : begin + size - place]
        self._error[place : place + part.size] = math.nan if self._held else part
        if part.size and place + part.size == size:
            self._complete(tick + begin + part.size)

    def _complete(self, tick: int) -> None:
        """A batch is; the next one begins at this tick or before."""
        self._periods = filled(self._error.reshape(-1, self.period)[self._decaying :])
        self._first += (tick - self._first) // self._error.size * self._error.size
        self._error[:] = np.nan
        if self._held or len(self._periods) < 2:
            return
        self._begins = self._next + self._others + len(STEPS)
        self._todo = deque(["_wait"] * self._others)
        self._todo.extend(STEPS)

    def _wait(self) -> None:
        """The steps of another axis."""

    def _conclude(self) -> None:
        """Mean, noise and drift of the periods.

        Near a resonance one period is like the next, as what rings goes on: that the mean is noise as well, the halves
        of the batch show, not neighbours.
        """
        E, n = np.fft.rfft(self._periods, axis=1), len(self._periods)
        noise2 = np.sum(np.abs(np.diff(E, axis=0)) ** 2, axis=0) / (2 * n * (n - 1))
        drift2 = np.abs(E[-(n // 2) :].mean(axis=0) - E[: n // 2].mean(axis=0)) ** 2
        self._drift2 = DRIFTS * np.maximum(drift2 - 4 * noise2, 0.0)
        self._noise2 = np.maximum(noise2, drift2 / 4)
        self._Z = np.fft.rfft(self._wave) + E.mean(axis=0)

    def _look(self) -> None:
        """The errors that remain."""
        assert self._law is not None
        missing = np.fft.irfft(self._Z - self._law.desired, self.period)[self._counts]
        self.errors.append(float(np.sqrt(np.mean(missing**2))))
        self._left = float(np.std(missing))

    def _see(self) -> None:
        """What they show of the stage."""
        assert self._law is not None
        self._law.drift2 = self._drift2
        self._law.see(np.fft.rfft(self._strain), self._Z, self._noise2)

    def _know(self) -> None:
        assert self._law is not None
        self._law.know()

    def _follow(self) -> None:
        """What follows."""
        assert self._law is not None
        if not self._strain.any():
            self._without = min(self._without, self.errors[-1])
        self._new = np.fft.irfft(self._law.follow(self._left).output, self.period)

    def _begin(self) -> None:
        """The next r takes over, or it is learned from the beginning."""
        self._before, self._changed = self._strain, max(self._next, self._begins)
        if self.errors[-1] > WORSE * self._without:
            self._return()
        else:
            self._strain = self._new

    # ---- The state -------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """All that it has learned, as named arrays."""
        return snapshot.taken({name: value for name, value in vars(self).items() if name != "_dynamics"}, KINDS)

    def restore(self, state: State) -> None:
        """What `state` gave, of one with the same dynamics and period.

        Raises
        ------
        SettingError
            It is not; nothing has changed.
        """
        try:
            own = snapshot.rebuilt(dict(state.items()), KINDS)
            if own["period"] != self.period or set(own) != set(vars(self)) - {"_dynamics"}:
                raise ValueError(f"it is of another period than {self.period} ticks")
            if not np.isfinite(own["_strain"]).all():
                raise ValueError("its strain is none")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SettingError("state", "the learned strain", f"what `state` gave: {error}") from None
        vars(self).update(own)


def filled(periods: FloatArray) -> FloatArray:
    """Those periods that count, and what is missing in them: the mean of the others.

    Parameters
    ----------
    periods : ndarray, shape (periods, samples)
        NaN where a sample is missing, infinite where its period does not count.

    Examples
    --------
    >>> rows = np.tile(np.arange(40.0), (3, 1))
    >>> rows[0, 7], rows[1, 0] = math.nan, math.inf
    >>> filled(rows)[:, 6:9].tolist()
    [[6.0, 7.0, 8.0], [6.0, 7.0, 8.0]]
    """
    missing = np.isnan(periods)
    kept = ~np.isinf(periods).any(axis=1) & (missing.mean(axis=1) <= GAP)
    rows: FloatArray = periods[kept]
    missing = missing[kept]
    if not missing.any():
        return rows
    seen = (~missing).sum(axis=0)
    if not seen.all():  # a place that no period shows
        return np.empty((0, periods.shape[1]))
    return np.asarray(np.where(missing, np.where(missing, 0.0, rows).sum(axis=0) / seen, rows))


KINDS = (FewNumbers, StrainLaw, Turns)
"""What a state may hold."""
