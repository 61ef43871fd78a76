"""What is the same in the error of each period of an axis, learned as strain, while its controller goes on learning.

The strain G^-1 z_d, which the inverse of the hysteresis gets, is known ahead. The strain of a period r is added to it::

    strain(t) = G^-1 z_d(t) + r(t mod T)

The law of `control.harmonics` makes the next r of the mean error of some periods; U is the spectrum of r, and G the
response that is known. r is in front of the stage and behind everything that the controller has learned of velocities
and accelerations, so that the stage answers it with G: near a resonance a change of the motion itself is answered with
up to six times as much, as the inverse of the stage makes a large difference of a small one there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, snapshot
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import iterative
from truestroke.control.controller import State
from truestroke.control.harmonics import BoolArray, HarmonicLaw
from truestroke.control.repetition import LONGEST, SHORTEST
from truestroke.control.response_prior import ROUNDS, FewNumbers, beside
from truestroke.model.dynamics import Dynamics

BEGIN = 0.5  # s: until then the controller learns alone
AVERAGED = 0.2  # s of the periods of a batch, two at least
DECAY = 5.0  # time constants of the first mode before them, in which a change of r decays
SHORTEST_DECAY, LONGEST_DECAY = 0.05, 0.15  # s
WORSE = 2.0  # times the error without r: then it is learned from the beginning
PERIODIC = 1e-6  # ticks: how near to whole ticks a period has to be


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
        near = math.ceil(ticks) / sample_rate
        bound = f"a whole number of ticks of {sample_rate:g} Hz, not {ticks:.6g}: such as {near:.6g} s"
        raise SettingError(argument, period, bound, "s")
    return round(ticks)


class StrainLaw(HarmonicLaw):
    """The law for a controller that goes on learning: a batch builds on the last one, as no earlier one holds."""

    worse = math.inf


class LearnedStrain:
    """The strain of a period that one axis learns.

    A batch has some periods in which the last change of r decays, and some whose mean error counts. A period in which a
    measurement is missing, or a limit held the voltage, does not count. Where the error becomes twice what it was
    without r, r begins at 0 again.

    Parameters
    ----------
    dynamics : Dynamics
        Of the stage, with the sample rate of the controller.
    period : int
        Ticks.

    Attributes
    ----------
    errors : list of float
        Rms of the mean error of each batch, where errors count, um.
    """

    def __init__(self, dynamics: Dynamics, period: int) -> None:
        self._dynamics, self.period = dynamics, period
        rate = dynamics.sample_rate
        first = dynamics.modes[0]
        decay = DECAY / (2 * math.pi * first.frequency * first.damping)
        decay = min(max(decay, SHORTEST_DECAY), LONGEST_DECAY)
        self._counting, self._decaying = (max(2, math.ceil(AVERAGED * rate / period)), math.ceil(decay * rate / period))
        self.errors: list[float] = []
        self._wave, self._counts = np.empty(0), np.empty(0, dtype=bool)
        self._law: StrainLaw | None = None
        self._strain, self._without = np.zeros(self.period), math.inf
        self._start = self._stop = 0
        self._restart()

    def _restart(self) -> None:
        """At the first tick of a motion."""
        self._changed, self._next, self._first = self._start, 0, self._start
        self._before = np.zeros(self.period)
        self._error = np.full((self._decaying + self._counting) * self.period, np.nan)

    def follow(self, wave: FloatArray, counts: BoolArray, ticks: range) -> None:
        """A motion that repeats this period, um, in these ticks; what was learned of the same one is kept.

        Parameters
        ----------
        wave : ndarray, shape (period,)
            Desired displacement in the period from the first of these ticks on, um.
        counts : ndarray of bool, shape (period,)
            Where errors count.
        ticks : range
            In which it repeats.
        """
        same = self._law is not None and np.array_equal(wave, self._wave) and ticks.start == self._start
        self._stop = ticks.stop
        if same:
            return
        self._start, self._wave, self._counts = ticks.start, wave, counts
        self._forget()
        self._restart()

    def _forget(self) -> None:
        """r is 0, and nothing is known of the stage but its dynamics."""
        dynamics, rate = self._dynamics, self._dynamics.sample_rate
        f = np.arange(self.period // 2 + 1) * rate / self.period
        G, sensor, _ = iterative.response_of(dynamics, f, rate, 1.0)
        band = iterative.band(dynamics, rate)
        prior = FewNumbers(dynamics, f, rate, beside(f, dynamics.modes[0].frequency, band))
        self._law = StrainLaw(sensor * np.fft.rfft(self._wave), G, prior, f <= band, samples=self.period)
        self._strain, self._without = np.zeros(self.period), math.inf

    # ---- The strain ------------------------------------------------------------------------------------------------

    def at(self, tick: int) -> float:
        """r in a tick, um, with the bits of `of`; they are asked for one after the other."""
        if tick == 0:
            self._restart()
        self._next = tick + 1
        place = (tick - self._start) % self.period
        share = min(max((tick - self._changed) / self.period, 0.0), 1.0)
        before = self._before.item(place)
        left = min(max((tick - self._stop) / self.period, 0.0), 1.0)
        return (before + share * (self._strain.item(place) - before)) * (1 - left)

    def of(self, ticks: range) -> FloatArray:
        """The same of some ticks, which none of `stops` divides."""
        if ticks.start == 0:
            self._restart()
        self._next = ticks.stop
        k = np.arange(ticks.start, ticks.stop)
        place = (k - self._start) % self.period
        share = np.clip((k - self._changed) / self.period, 0.0, 1.0)
        strain = self._before[place] + share * (self._strain - self._before)[place]
        left = np.clip((k - self._stop) / self.period, 0.0, 1.0)
        return np.asarray(strain * (1 - left))

    @property
    def stops(self) -> tuple[int, ...]:
        """The tick after which the next batch is complete."""
        end = self._first + self._error.size
        return (end,) if self._law is not None and end <= self._stop else ()

    # ---- Learning ----------------------------------------------------------------------------------------------------

    def put(self, tick: int, error: float) -> None:
        """Measured minus desired displacement in a tick, um; NaN where it is missing."""
        place = tick - self._first
        if 0 <= place < self._error.size - 1 and tick < self._stop:
            self._error[place] = error
        else:
            self.see(tick, np.array([error]))

    def see(self, tick: int, errors: FloatArray) -> None:
        """Measured minus desired displacement, um, of a tick and those that follow it, up to the end of a batch."""
        errors = errors[: max(self._stop - tick, 0)]
        if self._law is None or not errors.size:
            return
        size = self._error.size
        if tick - self._first >= size:  # the last ones of the batch never came
            self._learn(tick)
        begin = max(self._first - tick, 0)
        place = tick + begin - self._first
        part = errors[begin : begin + size - place]
        self._error[place : place + part.size] = part
        if part.size and place + part.size == size:
            self._learn(tick + begin + part.size)

    def _learn(self, tick: int) -> None:
        """From a batch; the next one begins at this tick or before."""
        periods = self._error.reshape(-1, self.period)[self._decaying :].copy()
        self._first += (tick - self._first) // self._error.size * self._error.size
        self._error[:] = np.nan
        periods = periods[np.isfinite(periods).all(axis=1)]
        if len(periods) < 2:
            return
        law, E = self._law, np.fft.rfft(periods, axis=1)
        assert law is not None
        n = len(periods)
        noise2 = np.sum(np.abs(np.diff(E, axis=0)) ** 2, axis=0) / (2 * n * (n - 1))
        Z = np.fft.rfft(self._wave) + E.mean(axis=0)
        law.see(np.fft.rfft(self._strain), Z, noise2)
        for _ in range(ROUNDS):
            law.know()
        missing = np.fft.irfft(Z - law.desired, self.period)[self._counts]
        self.errors.append(float(np.sqrt(np.mean(missing**2))))
        self._before, self._changed = self._strain, self._next
        if self.errors[-1] > WORSE * self._without:
            self._forget()
            return
        self._without = min(self._without, self.errors[-1]) if not self._strain.any() else self._without
        self._strain = np.fft.irfft(law.follow(float(np.std(missing))).output, self.period)

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


KINDS = (FewNumbers, StrainLaw)
"""What a state may hold."""
