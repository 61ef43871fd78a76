"""What a desired motion repeats: its phase, its period and its shape, from the values that come tick by tick.

The period is given, and followed within 1.5 %: each period is compared with the one before, or with the shape that was
locked::

    z_d(p) = b + a x(p) + d x'(p) + rest(p)

Amplitude a, offset b and shift d are separate, for a shape x without its mean and its slope x' are orthogonal. A start
ramp has a rest: phase is taken from it only once amplitude and offset repeat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.signals.trajectories import Trajectory

ALIKE = 2e-3  # of the peak-to-peak: what may be left of two periods that are alike, rms
LEFT = 0.05  # of the peak-to-peak: a motion that is further from its shape does not repeat it
PULLED, INTEGRATED = 0.5, 0.2  # of a shift that is corrected in the next period, and of it for good
EARLIER = 0.015  # of the period, by which it may differ from the given one
GAP = 0.05  # of a period: what is missing is interpolated, more is a period that is lost
SHORTEST, LONGEST = 16, 8192  # ticks of a period
TURNS = 2  # periods that are alike before it is a repetition
EXACT = 1e-6  # samples: a shift that is rounding
LOOKED_AT = 200_000  # ticks of a motion, until it has to repeat


class Periods:
    """The samples of a signal at whole phases of its period, interpolated between ticks.

    Parameters
    ----------
    size : int
        Phases of a period.
    """

    def __init__(self, size: int) -> None:
        self.size, self._gap = size, 2.0 + GAP * size
        self._now, self._done = np.empty(size), np.empty(size)
        self.restart()

    def restart(self) -> None:
        """The next period begins after the next value."""
        self._at = math.nan
        self._next = self._start = 0

    def put(self, at: float, value: float) -> FloatArray | None:
        """A value at a phase, which goes on from period to period; the period that it completes, valid until the next.

        Phases increase. A gap of a twentieth of a period is interpolated, after a longer one the next period begins.
        """
        before, self._at = self._at, at
        if not at - before <= self._gap:
            self._next = self._start = math.ceil(at)
            if self._start == at:
                self._now[self._start % self.size] = value
                self._next += 1
            self._value = value
            return None
        last, self._value = self._value, value
        done = None
        while self._next <= at:
            place = self._next % self.size
            self._now[place] = value - (at - self._next) / (at - before) * (value - last)
            self._next += 1
            if place == self.size - 1 and self._next - self._start >= self.size:
                self._now, self._done = self._done, self._now
                done = self._done
        return done


@dataclass(frozen=True)
class Seen:
    """What of a shape is in a period: amplitude, without unit; offset, um; shift, samples; rms of the rest, um."""

    amplitude: float
    offset: float
    shift: float
    rest: float


class Shape:
    """One period of a motion.

    Parameters
    ----------
    wave : ndarray, shape (samples,)
        um

    Attributes
    ----------
    span : float
        Peak to peak, um.
    """

    def __init__(self, wave: FloatArray) -> None:
        self.wave, self._mean, self.span = wave, float(wave.mean()), float(np.ptp(wave))
        self._own = wave - self._mean
        self._slope = (np.roll(wave, -1) - np.roll(wave, 1)) / 2
        self._power, self._slopes = (max(float(x @ x), 1e-300) for x in (self._own, self._slope))

    def seen_in(self, wave: FloatArray) -> Seen:
        """What of it is in another period."""
        mean = float(wave.mean())
        amplitude, shift = float(wave @ self._own) / self._power, float(wave @ self._slope) / self._slopes
        rest = wave - mean - amplitude * self._own - shift * self._slope
        return Seen(amplitude, mean - self._mean, shift, math.sqrt(float(rest @ rest) / rest.size))

    def like(self, seen: Seen) -> bool:
        """Whether another period repeats it: of the same amplitude, and but for a small shift; its offset may drift."""
        near = ALIKE * self.span
        small = abs(seen.shift) <= EARLIER * self._own.size and abs(seen.offset) <= LEFT * self.span
        return small and abs(seen.amplitude - 1) <= ALIKE and seen.rest <= near

    def near(self, at: float, value: float) -> bool:
        """Whether it has about this value, um, at a phase."""
        return abs(value - self.wave.item(int(at) % self._own.size)) <= LEFT * self.span


class Repetition:
    """The phase of a motion, and whether it repeats.

    Parameters
    ----------
    period : float
        Ticks.

    Attributes
    ----------
    size : int
        Phases of a period: the nearest whole number of ticks.
    at : float
        Phase of the last tick, in these, going on from period to period.
    shape : Shape or None
        Of the last period, or the one that is repeated.
    seen : Seen or None
        What of the shape was in the last period.
    repeats : bool
        Whether it is repeated.
    """

    def __init__(self, period: float) -> None:
        self.size = round(period)
        self._told = self._pace = self._step = self.size / period
        self.at = -self._step
        self._periods = Periods(self.size)
        self.shape: Shape | None = None
        self.seen: Seen | None = None
        self.repeats, self._alike = False, 0

    @property
    def period(self) -> float:
        """Of the motion, as it is now, ticks."""
        return self.size / self._pace

    def tick(self, z_d: float) -> bool:
        """The next tick, with the desired displacement, um; whether it leaves or has completed a period."""
        self.at += self._step
        wave = self._periods.put(self.at, z_d)
        if wave is not None:
            return self._turned(wave)
        if self.repeats and self.shape is not None and not self.shape.near(self.at, z_d - self._offset):
            return self.leave()
        return False

    def leave(self) -> bool:
        """It does not repeat any more; True."""
        self.repeats, self._alike, self.shape = False, 0, None
        self._periods.restart()
        return True

    @property
    def _offset(self) -> float:
        return 0.0 if self.seen is None else self.seen.offset

    def _turned(self, wave: FloatArray) -> bool:
        """A period is complete."""
        if self.shape is None:
            self.shape, self.seen = Shape(wave.copy()), None
            return False
        self.seen = self.shape.seen_in(wave)
        if not (self.shape.span > 0 and self.shape.like(self.seen)):
            if self.repeats:
                return self.leave()
            self._alike, self.shape = 0, Shape(wave.copy())
            return False
        self._follow(self.seen.shift)
        if not self.repeats:
            self._alike += 1
            self.shape = Shape(wave.copy())
            if self._alike >= TURNS and abs(self.seen.shift) < EARLIER:
                self.repeats, self.seen = True, None
        return True

    def _follow(self, shift: float) -> None:
        """The pace by which a shift in the last period is gone after the next one."""
        if abs(shift) < EXACT:
            self._step = self._pace
            return
        share = shift / self.size
        low, high = (1 - EARLIER) * self._told, (1 + EARLIER) * self._told
        if self.repeats:
            self._pace = min(max(self._pace * (1 + INTEGRATED * share), low), high)
            self._step = self._pace * (1 + PULLED * share)
        else:  # the shift since the last period is that of one period
            self._pace = self._step = min(max(self._pace * (1 + share), low), high)


def check_repeats(motion: Trajectory, period: float) -> int:
    """The tick from which on a motion repeats with a period, s, by `Repetition` itself.

    Raises
    ------
    SettingError
        No two periods in a row are alike.

    Examples
    --------
    >>> from truestroke import trajectories
    >>> check_repeats(trajectories.sine(frequency=20.0, peak_to_peak=10.0, duration=1.0), 0.05)
    799
    """
    if not motion.sample_rate * period >= 1:
        return 0  # refused by what takes the period
    repetition = Repetition(period * motion.sample_rate)
    for tick, z_d in enumerate(motion.position[:LOOKED_AT].tolist()):
        repetition.tick(z_d)
        if repetition.repeats:
            return tick
    frequency = motion.settings.get("frequency")
    own = (
        f"{1 / frequency:.6g} s"
        if isinstance(frequency, float) and frequency > 0
        else "one that it has; or leave it out"
    )
    raise SettingError("period", period, f"a period of the motion, here a {motion.name}: {own}", "s")
