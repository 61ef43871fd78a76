"""A stage that is shown, before it is put into the model."""

import math
from dataclasses import dataclass, field

from truestroke.control.stage import found

TOO_MUCH = 4.0  # times the rms of what the law misses: a stage that misses more is not that of the measurements
FEWEST = 20  # ticks that show it
INDEPENDENT = 0.01  # share of the level's square that the velocity is no part of: with less there is no gain beside it
LARGEST_GAIN = 0.5  # what weights take beside a stage, in size: more is no matter of a stage,
LATEST, SOONEST = 5.0, 0.5  # nor a lag of more radians at the resonance, or one that is a lead of so many


@dataclass
class Moments:
    """Sums of a signal, and of its squares."""

    first: float = 0.0
    second: float = 0.0

    def add(self, x: float) -> None:
        """One more value."""
        self.first += x
        self.second += x * x

    def spread(self, ticks: int) -> float:
        """Mean square about the mean."""
        return product_of(self.second, self, self, ticks)


def product_of(both: float, a: Moments, b: Moments, ticks: int) -> float:
    """Mean product of two signals about their means; both: the sum of their products."""
    return both / ticks - a.first / ticks * (b.first / ticks)


@dataclass
class Candidate:
    """What a stage that is shown would have missed in a window, and by what that is less."""

    frequency: float = 0.0  # cycles per tick; 0: there is none
    section: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    direct: float = 0.0
    strain: float = 0.0  # um: of the tick before,
    made: tuple[float, float] = (0.0, 0.0)  # what the section made of it then, and before that
    first: float = 0.0  # um: what it makes in the first tick
    ticks: int = 0
    missed: Moments = field(default_factory=Moments)
    speed: Moments = field(default_factory=Moments)
    level: Moments = field(default_factory=Moments)  # of what it makes, beyond the first
    own: Moments = field(default_factory=Moments)  # of what the law misses
    missed_speed: float = 0.0  # sums of products
    missed_level: float = 0.0
    speed_level: float = 0.0
    shown: float = 0.0  # cycles per tick: the one of the last window; 0: there was none, or it shows no gain and lag,
    gain: float = 0.0  # with which, beside the weights, it misses least,
    lag: float = 0.0  # s, without a dead time,
    offset: float = 0.0  # um
    worse: float = 0.0  # cycles per tick: one that missed much more than the law in the last window; 0: none did

    def count(self, z: float, zdot_d: float, strain: float, own: float) -> None:
        """One tick: z, um, would be that of the stage at this strain, um, but for a lag; the law misses `own`, um."""
        q = self.section
        made = q[0] * strain + q[1] * self.strain - q[2] * self.made[0] - q[3] * self.made[1]
        level = made + self.direct * strain
        missed = z - level
        if self.ticks == 0:
            self.first = level
        level -= self.first
        self.made = made, self.made[0]
        self.ticks += 1
        self.missed.add(missed)
        self.speed.add(zdot_d)
        self.level.add(level)
        self.own.add(own)
        self.missed_speed += missed * zdot_d
        self.missed_level += missed * level
        self.speed_level += zdot_d * level

    def end(self, tick: float) -> None:
        """A window has ended: what the stage misses beside an offset, a lag and a gain, by least squares. tick: s."""
        tried, n = self.frequency, self.ticks
        self.worse = self.frequency = self.shown = self.gain = self.lag = self.offset = 0.0
        if not (tried > 0 and n > FEWEST):
            return
        missed, own = self.missed.spread(n), self.own.spread(n)
        speed, level = self.speed.spread(n), self.level.spread(n)
        by_speed = product_of(self.missed_speed, self.missed, self.speed, n)
        by_level = product_of(self.missed_level, self.missed, self.level, n)
        both = product_of(self.speed_level, self.speed, self.level, n)
        alone = speed * level - both * both
        lag, gain, radian = 0.0, 0.0, tick / (2 * math.pi * tried)
        if alone > INDEPENDENT * speed * level:
            lag = (by_speed * level - by_level * both) / alone
            gain = (by_level * speed - by_speed * both) / alone
        if abs(gain) < LARGEST_GAIN and -LATEST * radian < lag < SOONEST * radian:
            self.shown, self.lag, self.gain = tried, lag, gain
            missing = self.missed.first - lag * self.speed.first - gain * self.level.first
            self.offset = missing / n - gain * self.first
            missed -= lag * by_speed + gain * by_level
        elif speed > 0:
            missed -= by_speed * by_speed / speed
        if missed > TOO_MUCH * TOO_MUCH * own:
            self.worse = tried


def begun(frequency: float, tick: float, strain: float, before: float) -> Candidate:
    """A stage of this frequency, cycles per tick, at rest at this strain, um, and at that of the tick before."""
    if not frequency > 0:
        return Candidate()
    g = found(frequency, tick)
    q = tuple(g["dynamics.section"][0])
    gain = (q[0] + q[1]) / (1 + q[2] + q[3])
    made = gain * strain, gain * before
    return Candidate(frequency, q, g["dynamics.direct"][0], before, made)
