"""What a desired motion repeats, and what is added to the command meanwhile: the NumPy text of c/src/repetition.c.

The period is given, and followed within 1.5 %: each period is compared with the one before, or with the shape that was
locked::

    z_d(p) = b + a x(p) + d x'(p) + rest(p)

Amplitude a, offset b and shift d are separate, for a shape x without its mean and its slope x' are orthogonal. A start
ramp has a rest: phase is taken from it only once amplitude and offset repeat.

A voltage of one period takes over smoothly, and a level follows the mean of the error, within limits of the sum.
`RepetitiveController` learns both, on a host. What it has learned goes on alone where it is given as `LearnedPeriod`:
a motion of that shape, of any amplitude, offset and phase, gets it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke import _kernel
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.signals.trajectories import Trajectory

ALIKE = 2e-3  # of the peak-to-peak: what may be left of two periods that are alike, rms,
FORM = 0.01  # and of one that has the learned form
PACED = 0.02  # the same of two that differ by their period,
APART = 0.003  # by so much of it at least
LEFT = 0.05  # of the peak-to-peak: a motion that is further from its shape does not repeat it
PULLED, INTEGRATED = 0.5, 0.2  # of a shift that is corrected in the next period, and of it for good
EARLIER = 0.015  # of the period, by which it may differ from the given one
GAP = 0.05  # of a period: what is missing is interpolated, more is a period that is lost
SHORTEST, LONGEST = 16, 8192  # ticks of a period
REPEATED = 2  # periods that are alike before it is a repetition,
WANDERS = 6  # and where each is earlier or later than the last one, as of a period that wanders
EXACT = 1e-6  # samples: a shift that is rounding
LOOKED_AT = 200_000  # ticks of a motion, until it has to repeat
LASTS = 5  # periods in which it does so, but at its end: batches of fewer show nothing
TRIED = 3  # periods that it may have
LARGEST = 1e50  # um: as in the kernel
PER_TURN = 0.63661977236758134308  # 4 / (2 pi): a quarter of an angle in turns


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


@dataclass(frozen=True, eq=False)
class Shape:
    """One period of a motion, um, and sums over it.

    Attributes
    ----------
    wave : ndarray, shape (samples,)
        um
    mean, span : float
        um; peak to peak
    power, slopes : float
        Sums of squares of the wave less its mean, and of half of the difference of both neighbours, um^2.
    cosine, sine : float
        Sums of products with those of the phase, um.
    """

    wave: FloatArray
    mean: float
    span: float
    power: float
    slopes: float
    cosine: float = 0.0
    sine: float = 0.0

    @classmethod
    def of(cls, wave: FloatArray) -> Shape:
        """That of a period."""
        mean, slope = float(wave.mean()), (np.roll(wave, -1) - np.roll(wave, 1)) / 2
        turn = np.exp(2j * np.pi * np.arange(wave.size) / wave.size)
        first = complex(np.sum((wave - mean) * turn))
        power = float(np.sum((wave - mean) ** 2))
        return cls(wave, mean, float(np.ptp(wave)), power, float(np.sum(slope**2)), first.real, first.imag)


@dataclass(frozen=True, eq=False)
class LearnedPeriod:
    """A correction that was learned, which needs nobody to be put out.

    Attributes
    ----------
    shape : Shape
        Of the motion in which it was learned.
    volts : ndarray, shape (samples,)
        One period in the phase of the shape, V, without its mean.
    level : float
        The mean, V.
    gain : float
        Displacement by voltage, slowly, um/V.
    """

    shape: Shape
    volts: FloatArray
    level: float
    gain: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RepetitionSettings:
    """Of a `Repetition`.

    Attributes
    ----------
    period : float
        Ticks, 16 to 8192.
    change : float
        Ticks in which a correction takes over, 1 or more.
    share : float
        Of the mean error of a period, which the next one takes away.
    ratio : float
        How many times the learned amplitude that of a motion may be, or the other way round, 1 to 10.
    settles : int
        Ticks from the begin to the end of leaving a correction.
    learned : LearnedPeriod, optional
        Of as many samples as `size`; without it the caller decides what is added.
    """

    period: float
    change: float = 1.0
    share: float = 0.0
    ratio: float = 1.01
    settles: int = 0
    learned: LearnedPeriod | None = None

    @property
    def size(self) -> int:
        """Phases of a period: the nearest whole number of ticks, or those of what was learned."""
        return round(self.period) if self.learned is None else self.learned.volts.size

    @property
    def turn(self) -> tuple[float, float]:
        """Cosine and sine of a phase."""
        return math.cos(2 * math.pi / self.size), math.sin(2 * math.pi / self.size)

    def members(self) -> dict[str, Any]:
        """As the kernel takes them."""
        own = {"size": self.size, "period": self.period, "change": self.change, "share": self.share}
        cosine, sine = self.turn
        one = self.learned
        known = None if one is None else {**asdict(one.shape), "volts": one.volts, "level": one.level, "gain": one.gain}
        return own | {"cosine": cosine, "sine": sine, "ratio": self.ratio, "settles": self.settles, "learned": known}


def kernel_repetition(settings: RepetitionSettings) -> _kernel.Repetition:
    """A `Repetition` in the kernel, which has the same bits."""
    return _kernel.Repetition(settings.members())


NUMBERS = (
    *("pace", "step", "part", "value", "amplitude", "offset", "drift", "error", "own", "slope", "square", "first"),
    *("sum", "squares", "low", "high", "slopes", "turned", "fundamental", "changed", "level", "goal", "climb"),
    *("errors", "kept", "range", "last"),
)
COUNTS = ("place", "turns", "alike", "counted", "waits", "limited")
FLAGS = (
    *("started", "whole", "begun", "triggered", "repeats", "aligned", "joined"),
    *("corrects", "slewed", "saturated", "commanded"),
)
"""Of a state after a tick, in its order; then the shape, and what is added."""


class Repetition:
    """The phase of a motion that repeats, and the voltage that is added to a controller's meanwhile.

    A tick is `tick`, the controller's command, `volts`, and `see`. `ts_repetition` of the kernel has the same bits.

    Parameters
    ----------
    settings : RepetitionSettings
        Period, and how a correction takes over.

    Attributes
    ----------
    repeats : bool
        Whether the motion repeats.
    corrects : bool
        Whether a voltage is added.
    joined : bool
        Whether it is the learned one of the settings.
    slewed, saturated : bool
        Whether a limit has held the last voltage back.
    limited : int
        Ticks in which one has.
    goal : float
        Of the level, V.
    """

    def __init__(self, settings: RepetitionSettings) -> None:
        self.settings, self.size = settings, settings.size
        self._cosine, self._sine = settings.turn
        self.pace = self.step = self._told = self.size / settings.period
        self.part = self.value = self.offset = self.drift = 0.0
        self.place = self.turns = self.alike = 0
        self.amplitude = 1.0
        self.shape: Shape | None = None
        self._now, self._other = np.zeros(self.size), np.zeros(self.size)
        self.error = self.own = self.slope = self.square = 0.0
        self.first = self.sum = self.squares = self.low = self.high = self.slopes = 0.0
        self.turned, self.fundamental = [0.0, 0.0], [0.0, 0.0]
        self.started = self.whole = self.begun = self.triggered = self.repeats = self.aligned = self.joined = False
        self._added: list[FloatArray | None] = [None, None]
        self._from, self._to = [0.0, 0.0], [0.0, 0.0]
        self.changed = 1.0
        self.level = self.goal = self.climb = self.errors = self.range = self.last = 0.0
        self.kept = 0.0 if settings.learned is None else settings.learned.level
        self.counted = self.waits = self.limited = 0
        self.corrects = self.slewed = self.saturated = self.commanded = False

    # ---- The motion --------------------------------------------------------------------------------------------------

    @property
    def at(self) -> float:
        """Phase of the last tick, going on from period to period."""
        return self.turns * self.size + self.place + self.part

    @property
    def period(self) -> float:
        """Of the motion, as it is now, ticks."""
        return self.size / self.pace

    @property
    def wave(self) -> FloatArray:
        """One period of the motion that repeats, um."""
        assert self.shape is not None
        return self.shape.wave.copy()

    def tick(self, z_d: float) -> bool:
        """The next tick, with the desired displacement, um; whether a period is complete or it no longer repeats.

        What is not finite changes nothing.
        """
        if not abs(z_d) <= LARGEST:
            return False
        moved = self._advance()
        last, self.value = self.value, z_d
        if not self.whole:  # the value at the phase before is not known
            self.whole = True
            return not self.part > 0 and self._sample(self.place, z_d)
        changes = False
        for behind in range(moved - 1, -1, -1):
            value = z_d - (behind + self.part) / self.step * (z_d - last)
            if not self._sample((self.place - behind) % self.size, value):
                continue
            aligned = self.aligned
            self._turned()
            changes = True
            if aligned != self.aligned or not self.whole:
                break  # it has another phase
        if changes or not self.repeats:
            return changes
        assert self.shape is not None
        near = z_d - self.drift - (self.offset + self.amplitude * self._entry(self.shape.wave))
        if abs(near) <= LEFT * self.shape.span * self.amplitude:
            return False
        self.leave()
        return True

    def trigger(self) -> None:
        """The next tick begins a period of the motion, or of the learned one.

        From the first call on its phase is that of these calls.
        """
        behind = self.size - (self.place + self.part + self.step)
        if behind > self.size / 2:
            behind -= self.size
        if self.triggered and abs(behind) <= self._largest_shift:
            self._follow(behind)
            return
        self.leave()
        self.triggered, self.started = True, False  # the next tick is at phase 0
        self.part, self.place = 0.0, 0

    def leave(self) -> None:
        """The motion does not repeat any more. A learned correction is taken back."""
        self.repeats = self.aligned = self.begun = self.whole = False
        self.alike, self.shape, self.amplitude = 0, None, 1.0
        self.offset = self.drift = 0.0
        if not self.joined:
            return
        self.joined, self.kept = False, self.goal
        self.become(None, 0.0, self.settings.settles)
        self.move(0.0, self.settings.change)

    def _advance(self) -> int:
        """The phase of the next tick; how many whole phases lie between."""
        moved = 0
        if self.started:
            self.part += self.step
            moved = int(self.part)
            self.part -= moved
            self.place += moved
            if self.place >= self.size:
                self.place -= self.size
                self.turns += 1
        self.started = True
        return moved

    def _sample(self, place: int, value: float) -> bool:
        """The value at a whole phase; whether the period is complete with it."""
        if place == 0:
            self._begin_period(value)
        if not self.begun:
            return False
        if self.shape is not None:
            self._compare(self.shape, place, value)
        if not self.repeats:
            self._record(place, value)
        return place == self.size - 1

    def _begin_period(self, value: float) -> None:
        self.begun = True
        self.error = self.own = self.slope = self.square = 0.0
        self.first = self.low = self.high = value
        self.sum = self.squares = self.slopes = 0.0
        self.turned, self.fundamental = [1.0, 0.0], [0.0, 0.0]

    def _compare(self, shape: Shape, place: int, value: float) -> None:
        x = shape.wave.item(place)
        e = value - (self.offset + self.amplitude * x)
        slope = (shape.wave.item((place + 1) % self.size) - shape.wave.item(place - 1)) / 2
        self.error += e
        self.own += e * (x - shape.mean)
        self.slope += e * slope
        self.square += e * e

    def _record(self, place: int, value: float) -> None:
        v, (c, s) = value - self.first, self.turned
        self._now[place] = value
        self.sum += v
        self.squares += v * v
        self.low, self.high = min(self.low, value), max(self.high, value)
        if place >= 2:
            slope = (value - self._now.item(place - 2)) / 2
            self.slopes += slope * slope
        self.fundamental[0] += v * c
        self.fundamental[1] += v * s
        self.turned = [c * self._cosine - s * self._sine, s * self._cosine + c * self._sine]

    def _turned(self) -> None:
        """A period is complete."""
        shape = self.shape
        if shape is None:
            self._adopt()
            return
        shift, unlike = self._seen(shape)
        if not unlike <= (FORM if self.aligned or self.triggered else ALIKE):
            if self.repeats:
                self.leave()
                return
            if unlike <= PACED and not self.triggered and abs(shift) > APART * self.size:
                self._follow(shift)  # with its own period the next one may be alike
            self.alike = 0
            self._adopt()
            return
        if not self.triggered:
            self._follow(shift)
        if self.repeats:
            self.drift = self.error / self.size
            if self.aligned and not self.joined:
                self._join()
            return
        self.alike += 1
        self._adopt()
        steady = self.triggered or abs(shift) < EARLIER
        wanders = self.alike >= WANDERS and abs(shift) < APART * self.size
        self.repeats = (self.alike >= REPEATED and steady) or wanders
        if self.repeats and self.settings.learned is not None:
            self._align(self.settings.learned.shape)

    def _seen(self, shape: Shape) -> tuple[float, float]:
        """What of the shape is in the period that is complete: by how many samples it is early, and how unlike it is.

        Unlike is a change of the amplitude, or the residual, rms, over the peak-to-peak. A large shift or offset is
        unlike altogether; the offset may drift.
        """
        if not (shape.span > 0 and shape.power > 0):
            return 0.0, math.inf
        n, span = float(self.size), shape.span * self.amplitude
        moved = self.slope / shape.slopes if shape.slopes > 0 else 0.0
        grown = self.own / shape.power
        rest = self.square - self.error * (self.error / n) - self.own * grown - self.slope * moved
        rest, shift = math.sqrt(rest / n) if rest > 0 else 0.0, moved / self.amplitude
        small = abs(shift) <= self._largest_shift and abs(self.error / n) <= LEFT * span
        return shift, max(abs(grown / self.amplitude), rest / span) if small else math.inf

    def _adopt(self) -> None:
        """The period that was recorded is the shape."""
        wave, n = self._now, float(self.size)
        self._now, self._other = self._other, wave
        a, b = (wave.item(1) - wave.item(-1)) / 2, (wave.item(0) - wave.item(-2)) / 2
        power = self.squares - self.sum * (self.sum / n)
        slopes = self.slopes + a * a + b * b
        self.shape = Shape(wave, self.first + self.sum / n, self.high - self.low, power, slopes, *self.fundamental)
        self.amplitude, self.offset, self.drift = 1.0, 0.0, 0.0

    @property
    def _largest_shift(self) -> float:
        """Samples: a trigger is up to a tick late."""
        return EARLIER * self.size + (1.0 if self.triggered else 0.0)

    def _follow(self, shift: float) -> None:
        """The pace by which a shift in the last period is gone after the next one."""
        locked = self.repeats or self.triggered
        if abs(shift) < (EXACT if locked else EARLIER):  # so that whole ticks stay whole
            self.step = self.pace
            return
        share = shift / self.size
        low, high = (1 - EARLIER) * self._told, (1 + EARLIER) * self._told
        if locked:
            self.pace = _clamped(self.pace * (1 + INTEGRATED * share), low, high)
            self.step = self.pace * (1 + PULLED * share)
        else:  # the shift since the last period is that of one period
            self.pace = self.step = _clamped(self.pace * (1 + share), low, high)

    def _align(self, learned: Shape) -> None:
        """The phase of a motion that repeats becomes that of the learned one, with which it is compared from now on."""
        assert self.shape is not None
        x, y = self.shape.cosine, self.shape.sine
        own, its = math.sqrt(x * x + y * y), math.sqrt(learned.cosine * learned.cosine + learned.sine * learned.sine)
        ratio = self.settings.ratio
        if not (own * ratio >= its and own <= ratio * its):
            self.leave()
            return
        if not self.triggered:
            c = (learned.cosine * x + learned.sine * y) / (own * its)
            s = (learned.sine * x - learned.cosine * y) / (own * its)
            shift = self.size * _turns(c, s) + self.part
            whole = math.floor(shift)
            self.part = shift - whole
            self.place = (self.place + whole) % self.size
        self.amplitude = own / its
        self.offset = self.shape.mean - self.amplitude * learned.mean
        self.shape, self.begun, self.aligned = learned, False, True

    def _join(self) -> None:
        learned = self.settings.learned
        assert learned is not None
        if self.become(learned.volts, self.amplitude, 0):
            self.move(self.kept, self.settings.change)
            self.joined = True

    # ---- What is added -----------------------------------------------------------------------------------------------

    def _gains(self) -> list[float]:
        g = _smooth(self.changed)
        return [(1 - g) * self._from[i] + g * self._to[i] for i in range(2)]

    def become(self, volts: FloatArray | None, scale: float = 1.0, waits: int = 0) -> bool:
        """From the next tick on so much of one period of a voltage, V, takes over, smoothly.

        None: nothing does, and it has ended after `waits` ticks. False, and no change, where a change from one voltage
        to another has not ended.
        """
        gains = self._gains()
        to = next((i for i in range(2) if gains[i] == 0), -1)
        if volts is not None:
            to = next((i for i in range(1, -1, -1) if self._added[i] is volts), to)
            if to < 0:
                return False
        self._from, self._to = gains, [0.0, 0.0]
        if volts is not None:
            self._added[to], self._to[to] = volts, scale
        self.changed, self.corrects, self.waits = 0.0, True, 0 if volts is not None else waits
        return True

    def move(self, volts: float, ticks: float) -> None:
        """The level goes to a voltage, V, within so many ticks."""
        self.goal, self.climb = volts, abs(volts - self.level) / ticks

    def volts(self, inside: float, low: float, high: float, slew: float) -> float:
        """The voltage of this tick, V, of that of the controller, within limits, V, and slew, V per tick."""
        volts, self.slewed, self.saturated, self.range = inside, False, False, high - low
        if self.corrects:
            total = inside + self._correction() + self._level()
            slewed = _clamped(total, self.last - slew, self.last + slew) if self.commanded else total
            volts = _clamped(slewed, low, high)
            self.slewed, self.saturated = slewed < total or slewed > total, volts < slewed or volts > slewed
            self.limited += self.slewed or self.saturated
            if self.waits > 0:
                self.waits -= 1
                self.corrects = self.waits > 0
        self.commanded, self.last = True, volts
        return volts

    def see(self, error: float, gain: float = 0.0) -> bool:
        """The error of a tick of this motion, um, and displacement by voltage, um/V, or 0; False: NaN, or no error."""
        span = -1.0 if self.shape is None else self.shape.span * self.amplitude
        if not abs(error) <= span:  # lost, NaN, or no displacement
            self.errors, self.counted = 0.0, 0
            return False
        if not gain > 0:
            return True
        self.errors += error
        self.counted += 1
        if self.counted >= self.size:
            goal = self.goal - self.settings.share * self.errors / (gain * self.counted)
            self.move(_clamped(goal, -self.range, self.range), self.size)
            self.errors, self.counted = 0.0, 0
        return True

    def _correction(self) -> float:
        self.changed = _clamped(self.changed + 1 / self.settings.change, 0.0, 1.0)
        total = 0.0
        for much, volts in zip(self._gains(), self._added, strict=True):
            if much != 0 and volts is not None:
                total += much * self._entry(volts)
        return total

    def _entry(self, values: FloatArray) -> float:
        """Between two samples of a period."""
        here = values.item(self.place)
        if not self.part > 0:
            return here
        return here + self.part * (values.item((self.place + 1) % self.size) - here)

    def _level(self) -> float:
        self.level += _clamped(self.goal - self.level, -self.climb, self.climb)
        return self.level

    # ---- The state ---------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The complete state after a tick, as named arrays; that of the kernel has the same names and `restore`."""
        shape = self.shape
        sums = [] if shape is None else [shape.mean, shape.span, shape.power, shape.slopes, shape.cosine, shape.sine]
        numbers = [np.atleast_1d(getattr(self, name)) for name in NUMBERS]
        return {
            "numbers": np.concatenate([*numbers, np.resize(sums or [0.0], 6), self._from, self._to]),
            "counts": np.array([getattr(self, name) for name in COUNTS], dtype=np.int64),
            "flags": np.array([*(getattr(self, name) for name in FLAGS), shape is not None]),
            "now": self._now.copy(),
            "other": self._other.copy(),
            **{f"added_{i}": np.zeros(self.size) if x is None else x.copy() for i, x in enumerate(self._added)},
        }


def _clamped(x: float, low: float, high: float) -> float:
    return low if x < low else high if x > high else x


def _smooth(u: float) -> float:
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


def _turns(c: float, s: float) -> float:
    """Angle of a vector of length 1, in turns, -0.25 to 0.75.

    >>> round(_turns(math.cos(2.0), math.sin(2.0)) * 2 * math.pi, 4)
    2.0
    """
    turns = 0.0
    if c < 0:
        c, s, turns = -c, -s, 0.5
    t = s / (1 + c)  # tangent of half of the angle,
    t = t / (1 + math.sqrt(1 + t * t))  # and of a quarter: at most that of 22.5 degrees
    t2 = t * t
    return turns + PER_TURN * t * (1 + t2 * (-1.0 / 3 + t2 * (0.2 + t2 * (-1.0 / 7 + t2 * (1.0 / 9)))))


def begun(wave: FloatArray, ticks: int) -> FloatArray:
    """A motion of so many ticks that begins softly at 0 in two periods of a wave, and repeats it."""
    k = np.arange(ticks)
    u = np.minimum(k / (2 * wave.size), 1.0)
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2) * wave[k % wave.size])


def derivatives(position: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Velocity and acceleration of samples, by differences to both neighbours; it rests before and after them.

    >>> derivatives(np.array([0.0, 1.0, 4.0, 9.0]), 1.0)
    (array([0.5, 2. , 4. , 2.5]), array([ 1.,  2.,  2., -5.]))
    """
    around = np.concatenate([position[:1], position, position[-1:]])
    return (around[2:] - around[:-2]) * rate / 2, (around[2:] - 2 * position + around[:-2]) * rate**2


def check_repeats(motion: Trajectory, period: float) -> int:
    """The tick from which on a motion repeats with a period, s, by `Repetition` itself.

    Raises
    ------
    SettingError
        No two periods in a row are alike, or never more than a few.

    Examples
    --------
    >>> from truestroke import trajectories
    >>> check_repeats(trajectories.sine(frequency=20.0, peak_to_peak=10.0, duration=1.0), 0.05)
    799
    """
    if not motion.sample_rate * period >= 1:
        return 0  # refused by what takes the period
    z = motion.position[:LOOKED_AT]
    if (tick := _repeats_from(z, period * motion.sample_rate)) is not None:
        return tick
    frequency, own = motion.settings.get("frequency"), _period_of(z)
    stated = motion.sample_rate / frequency if isinstance(frequency, float) and frequency > 0 else 0.0
    if SHORTEST <= stated <= LONGEST and _repeats_from(z, stated) is not None:
        own = stated
    remedy = "it repeats none: leave it out" if own is None else f"{own / motion.sample_rate:.6g} s"
    raise SettingError("period", period, f"a period of the motion, here a {motion.name}: {remedy}", "s")


def _repeats_from(z: FloatArray, period: float) -> int | None:
    """The tick from which on a motion, um, repeats with a period, ticks, for some or to its end; None: nowhere."""
    repetition = kernel_repetition(RepetitionSettings(period=period))
    begin, ended = -1, False
    for tick, z_d in enumerate(z.tolist()):
        repetition.tick(z_d)
        if not repetition.repeats:
            begin, ended = -1, ended or begin >= 0
        elif begin < 0:
            begin = tick
        elif tick - begin >= LASTS * period:
            return begin
    return None if ended or begin < 0 else begin


def _period_of(motion: FloatArray) -> float | None:
    """The shortest period that a motion, um, repeats behind its start, ticks; None: none of 16 to 8192."""
    z = motion[motion.size // 3 :]
    n, most = z.size, min(LONGEST, z.size // 2)
    if most < 2 * SHORTEST or not np.ptp(z) > 0:
        return None
    x, lags = z - z.mean(), np.arange(most + 1)
    with_itself = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[: most + 1]
    squares = np.concatenate([[0.0], np.cumsum(x**2)])
    apart = (squares[n - lags] + squares[n] - squares[lags] - 2 * with_itself) / (n - lags) / np.ptp(z) ** 2
    left = np.flatnonzero(apart > LEFT**2)
    begin = max(int(left[0]) if left.size else most, SHORTEST)
    middle, before, after = apart[begin + 1 : -1], apart[begin:-2], apart[begin + 2 :]
    near = begin + 1 + np.flatnonzero((middle <= before) & (middle < after) & (middle < LEFT**2))
    for lag in near[:TRIED].tolist():
        period = _finer(apart, lag)
        if _repeats_from(motion, period) is not None:
            return period
    return None


def _finer(apart: FloatArray, lag: int) -> float:
    """A period of about so many ticks, from how far a motion is from itself after it, and after several of them."""
    period = float(lag)
    for times in range(1, (apart.size - 2) // (lag + 1) + 1):
        at = round(times * period)
        before, here, after = apart[at - 1 : at + 2].tolist()
        if not here <= min(before, after) or not before + after > 2 * here:
            break
        period = (at + 0.5 * (before - after) / (before - 2 * here + after)) / times
    return period
