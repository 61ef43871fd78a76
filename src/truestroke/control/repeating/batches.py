"""What batches of periods show of a motion that repeats, and the correction that follows, in steps.

`RepetitiveController` measures the batches, and does the steps in its ticks. A `Learned` is not changed: a batch makes
another one, so that learning that is broken off leaves nothing behind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.repeating import iterative
from truestroke.control.repeating.harmonics import BoolArray, HarmonicLaw, nearest
from truestroke.control.repeating.online import OnlineLaw
from truestroke.control.repeating.periodic_hysteresis import PeriodicHysteresis, identified
from truestroke.control.repeating.response_prior import APART, ROUNDS, FewNumbers, beside
from truestroke.control.repeating.steps import Steps
from truestroke.model.dynamics import Dynamics

UNKNOWN = 0.01  # of the sample rate: without dynamics the response is known to there; R is less sure with f^4
STRAIGHT = 1e-3  # of the largest acceleration: where there is less, the motion is straight
LINES = 0.3  # of a period: errors of a motion that is straight for so long count there alone
LEARNED = 0.8  # times the error: while it falls below from batch to batch, the controller inside goes on learning
PATIENCE = 6  # batches, at most
LOSES = 5  # batches in a row that are worse than the controller alone, until it is alone again,
FALLS = 0.9  # where none has fallen to so much of the least mean square of them,
SURE = 2.0  # and each is worse by so many standard deviations of what noise makes of it
ALIKE = 0.02  # of the rms of a motion: another one within it is the same, but for amplitude, offset and phase
SAME = 0.05  # of the amplitude: so near in amplitude and offset a motion has the same voltage,
NEAR = 0.01  # of the period: and so near in period the same response
CORRECTS = 0.5  # of the error of a batch: a correction of another motion is used that leaves less
CARRIED = 3.0  # times: how much more a correction may become where the period changes
ABOVE = 1.05  # times the square of the first error, and
NOISES = 2.0  # times that of the noise of a sample: a period beyond their sum is too much
AT_ONCE, HARMONICS = 2048, 16  # samples of periods, and harmonics of a response, that are worked on in one step


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Batch(Displayed):
    """What the periods with one correction have shown.

    Attributes
    ----------
    number : int
        From 0 on; the first one is without a correction.
    tick : int
        Commands until its end.
    rmse, maximum : float
        Error of the mean of its periods, where errors count, um.
    noise : float
        Standard deviation of that mean, um: an error like it cannot be learned.
    expected : float
        Rmse that the next one should have, um.
    undone : str
        In a sentence, why the next one does not build on it; empty where it does.
    """

    number: int
    tick: int
    rmse: float
    maximum: float
    noise: float
    expected: float
    undone: str = ""

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, quantity(getattr(self, name), "um")) for name in ("rmse", "maximum", "noise", "expected")]
        return f"Batch {self.number}: {self.undone or 'taken'}", rows


@dataclass(frozen=True, eq=False)
class Learned:
    """What is known of one motion.

    Attributes
    ----------
    motion : ndarray of complex
        Its spectrum, um.
    f : ndarray
        Of its harmonics, Hz.
    heard, learned, counts : ndarray of bool
        Harmonics that may be put out, and those up to the bandwidth; samples at which errors count.
    unlearned : ndarray
        The motion less what of it can be learned, um.
    law : OnlineLaw
        Of the strain.
    hysteresis : PeriodicHysteresis or None
        From the voltage to the strain, as the best batch has shown it; None until one has.
    passes : tuple of (ndarray, ndarray, ndarray, ndarray)
        Voltage, V, U, Z, and the variance of the latter, of the batches that the law remembers.
    inside : ndarray of complex or None
        Spectrum of the voltage of the controller inside, V, since it rests.
    base, table : ndarray
        Voltage of the last batch that was taken, V, and the correction as it was asked for.
    error : float
        Of the last batch in which the controller inside learned, um.
    alone : tuple of (float, int)
        The mean square of all its samples that count, um^2, and how many these are.
    least : float
        Of the last batches since it rests, which all have more, um^2.
    lost : int
        How many of them have not fallen below those before.
    listens : int
        Batches at most in which it still learns.
    carries : bool
        Whether it began with what was learned of its like.
    waiting : ndarray or None
        The correction of its like, V, until the first batch shows whether the error is what it would correct.
    """

    motion: ComplexArray
    f: FloatArray
    heard: BoolArray
    learned: BoolArray
    counts: BoolArray
    unlearned: FloatArray
    law: OnlineLaw
    few: FewNumbers
    listens: int
    carries: bool = False
    waiting: FloatArray | None = None
    hysteresis: PeriodicHysteresis | None = None
    passes: tuple[tuple[FloatArray, ComplexArray, ComplexArray, FloatArray], ...] = ()
    inside: ComplexArray | None = None
    base: FloatArray | None = None
    table: FloatArray | None = None
    error: float = math.inf
    alone: tuple[float, int] = (math.inf, 1)
    least: float = math.inf
    lost: int = 0

    @property
    def slope(self) -> float:
        """Displacement at rest by voltage, um/V."""
        return float(np.abs(self.law.response[0]))


@dataclass(frozen=True, eq=False)
class Outcome:
    """What follows from a batch, or from joining a motion.

    Attributes
    ----------
    learned : Learned
        What is known now.
    volts : ndarray or None
        The next correction, V, without its mean; None where there is none yet.
    batch : Batch or None
        Of a batch with a correction.
    base : ndarray or None
        The correction on which that one builds, V.
    most : float
        Mean square of the error of a period, um^2, beyond which the next correction is too much.
    whole : ndarray or None
        The voltage of a period that was learned of the same motion, V: `volts` is then what of it the controller inside
        does not output any more.
    """

    learned: Learned
    volts: FloatArray | None = None
    batch: Batch | None = None
    base: FloatArray | None = None
    most: float = math.inf
    whole: FloatArray | None = None

    @property
    def gives_up(self) -> bool:
        """Whether the controller alone is better than what it learned while it rests."""
        return self.learned.lost >= LOSES


@dataclass(frozen=True, eq=False)
class Kept:
    """What was learned of a motion that has been left: with the correction, V, and its mean, V."""

    learned: Learned
    volts: FloatArray
    level: float


@dataclass(frozen=True, eq=False)
class Measured:
    """A batch.

    Attributes
    ----------
    errors : Sequence of ndarray, shape (samples,)
        Measured less desired displacement, period by period, um.
    added, inside : ndarray, shape (samples,)
        One period of the correction as it was output, and of the controller inside, V.
    table : ndarray, shape (samples,)
        The correction as it was asked for, V: between two of its samples the output is interpolated, and smoother.
    number, tick : int
        As of `Batch`.
    """

    errors: Sequence[FloatArray]
    added: FloatArray
    inside: FloatArray
    table: FloatArray
    number: int
    tick: int


# ---- Joining a motion -----------------------------------------------------------------------------------------------


def joined(
    wave: FloatArray,
    f: FloatArray,
    rate: float,
    dynamics: Dynamics | None,
    band: float,
    kept: Kept | None,
    held: bool = False,
) -> Steps[Outcome]:
    """A motion repeats: what of it can be learned, and what was learned of its like before.

    Parameters
    ----------
    wave : ndarray, shape (samples,)
        One period, um.
    f : ndarray
        Of its harmonics, Hz.
    rate : float
        Ticks per second, Hz.
    dynamics : Dynamics or None
        Of the stage.
    band : float
        Highest harmonic that is learned, Hz.
    kept : Kept or None
        Of the last motion.
    held : bool
        Whether nothing is learned, so that no batch shows whether a correction of another motion is right.
    """
    yield
    below = np.minimum(f, rate / 2)  # a period of 16.9 ticks has 17 phases: harmonics above half of the sample rate
    G, sensor = yield from _responses(dynamics, below)
    first = UNKNOWN * rate if dynamics is None else dynamics.modes[0].frequency
    alone = beside(below, first, band, 1.0 if dynamics is None else APART)
    few = FewNumbers(dynamics, below, rate, alone)
    yield
    heard, learned = f <= iterative.SEEN * rate, f <= band
    yield
    bent = np.abs(np.roll(wave, 1) - 2 * wave + np.roll(wave, -1))
    straight = bent <= STRAIGHT * bent.max()
    straight |= np.roll(straight, 1) | np.roll(straight, -1)  # both ends of a line are on it
    counts = straight if straight.mean() >= LINES else np.ones(wave.size, dtype=bool)
    found = yield from nearest(wave, counts, learned)
    yield
    motion, desired = np.fft.rfft(wave), sensor * np.fft.rfft(found)
    law = OnlineLaw(desired, G, few, heard, samples=wave.size, beyond=heard & ~learned, known=False)
    yield from law.knowing()
    unlearned = wave - np.fft.irfft(desired, wave.size)
    yield
    fresh = Learned(motion, f, heard, learned, counts, unlearned, law, few, listens=PATIENCE)
    carried = None if kept is None else (yield from _carried(kept, fresh))
    if carried is None:
        return Outcome(fresh)
    volts, whole = carried
    if whole is None and not held:
        return Outcome(replace(fresh, carries=True, waiting=volts))
    return Outcome(replace(fresh, listens=0, carries=True), volts, whole=whole)


def _responses(dynamics: Dynamics | None, f: FloatArray) -> Steps[tuple[ComplexArray, ComplexArray]]:
    """From the strain to the measurement, without unit, and from displacement to measurement."""
    if dynamics is None:
        return (np.ones(f.size, dtype=np.complex128),) * 2
    both = np.empty((2, f.size), dtype=np.complex128)
    for begin in range(0, f.size, HARMONICS):
        some = slice(begin, begin + HARMONICS)
        for row, sensor in zip(both, (True, False), strict=True):
            row[some] = dynamics.response(f[some], sensor=sensor)
            yield
    return both[0], both[0] / both[1]


def _carried(kept: Kept, now: Learned) -> Steps[tuple[FloatArray, FloatArray | None] | None]:
    """The correction for another amplitude, offset, phase or period of the same form; None: it is another form.

    And the whole voltage, where amplitude, offset and period are the same.
    What the law has learned of the response goes to that of now.
    """
    then, law = kept.learned, now.law
    before = then.law
    size, scale = min(now.motion.size, then.motion.size), law.samples / before.samples
    this, that = now.motion[1:size], scale * then.motion[1:size]
    across = np.fft.irfft(np.concatenate([[0.0], this * np.conj(that)]), law.samples)
    yield
    h = np.arange(1, size)
    shift = np.exp(-2j * np.pi * h * int(np.argmax(across)) / law.samples)
    yield
    product = np.conj(that * shift) * this
    part = float(np.sum(h * product.imag) / max(float(np.sum(h**2 * product.real)), 1e-300))  # of a sample
    yield
    shift = shift * np.exp(1j * h * part)
    yield
    amplitude = float(np.sum(np.conj(that * shift) * this).real / np.sum(np.abs(that) ** 2))
    if np.sum(np.abs(this - amplitude * shift * that) ** 2) > ALIKE**2 * np.sum(np.abs(this) ** 2):
        return None
    yield
    yield from _remembered(before, then.f, law, now.f)
    moved = (before.response * before.ratio)[1:size] / (law.response * law.ratio)[1:size]
    yield
    moved = moved * np.minimum(1.0, CARRIED / np.abs(moved))
    if abs(now.f[1] / then.f[1] - 1) < NEAR:
        moved = np.ones(size - 1, dtype=np.complex128)  # the response is the same, what is known of it is not
    both = np.zeros((2, now.motion.size), dtype=np.complex128)
    both[:, 1:size] = amplitude * shift * moved * scale * np.fft.rfft(kept.volts)[1:size]
    yield
    if not _same(then, now, amplitude):
        return np.asarray(np.fft.irfft(both[0], law.samples)), None
    assert then.inside is not None
    both[1, 1:size] += amplitude * shift * moved * scale * then.inside[1:size]
    yield
    correction, whole = np.fft.irfft(both, law.samples)
    return correction, whole


def _same(then: Learned, now: Learned, amplitude: float) -> bool:
    """Whether a motion has nearly the amplitude, the offset and the period of the other one."""
    offsets = now.motion[0].real / now.law.samples - then.motion[0].real / then.law.samples
    span = float(np.ptp(np.fft.irfft(now.motion, now.law.samples)))
    same = abs(amplitude - 1) < SAME and abs(float(offsets)) < SAME * span
    return same and abs(now.f[1] / then.f[1] - 1) < NEAR


def _remembered(before: HarmonicLaw, then: FloatArray, law: HarmonicLaw, now: FloatArray) -> Steps[None]:
    law.remember(before, then, now)
    for _ in range(ROUNDS):
        yield
        yield from law.knowing()


# ---- A batch --------------------------------------------------------------------------------------------------------


def concluded(before: Learned, batch: Measured) -> Steps[Outcome]:
    """What follows from a batch: the controller inside goes on, or it rests and a correction is learned."""
    yield
    mean, noise2 = yield from _spectra(batch.errors)
    Z = before.motion + mean
    added, inside = np.fft.rfft(batch.added), np.fft.rfft(batch.inside)
    yield
    if before.inside is not None:
        inside = before.inside  # later ones differ by drift and a wandering period
    yield
    volts = np.fft.irfft(inside + added, batch.added.size)
    law, begins = before.law.copy(), before.law.fresh and not before.carries
    if begins and not _scaled(law, inside + added, Z):
        return Outcome(before)
    yield
    now = replace(before, law=law, inside=inside if before.listens == 0 else None)
    missing = np.fft.irfft(Z - law.desired, volts.size)[now.counts]
    spread = float(np.std(missing))
    yield
    if now.hysteresis is None or (before.listens == 0 and spread < law.best):
        others = [(x, Y, n) for x, _, Y, n in now.passes]
        shows = identified(volts, Z, law.response, noise2, few=now.few, learned=now.learned, periods=1, others=others)
        now = yield from _with_model(now, (yield from shows))
    assert now.hysteresis is not None
    strain = yield from now.hysteresis.strain(volts)
    U = np.fft.rfft(strain)
    yield
    if before.hysteresis is None and not before.carries:
        _scaled(law, U, Z)
    yield from law.seeing(U, Z, noise2)
    yield
    remembered = [one for one in now.passes if law.remembers(one[1])]
    now = replace(now, passes=(*remembered, (volts, U, Z, noise2 + law.least)))
    for _ in range(ROUNDS):
        yield
        yield from law.knowing()
    seen = yield from _mean_square(now, batch.errors)
    if now.listens > 0:
        return _listened(replace(now, error=spread, alone=seen, waiting=None), before, Z)
    lost, least = 0, math.inf
    if _loses(seen, now.alone):
        lost = now.lost + 1 if seen[0] > FALLS * now.least else 0
        least = min(now.least, seen[0])
    now = replace(now, lost=lost, least=least)
    return (yield from _followed(now, batch, volts, missing, law.noise(noise2)))


def _listened(now: Learned, before: Learned, measured: ComplexArray) -> Outcome:
    """After a batch of the controller inside alone: the correction that waits is made, or this goes on."""
    if before.waiting is not None and _corrects(now, before.waiting, measured, now.error):
        return Outcome(replace(now, listens=0), before.waiting)
    return Outcome(replace(now, listens=now.listens - 1 if now.error < LEARNED * before.error else 0))


def _corrects(now: Learned, volts: FloatArray, measured: ComplexArray, error: float) -> bool:
    """Whether a correction would take more than half of the error of a batch, um rms, by the response that is known."""
    law = now.law
    missing = measured - law.desired + np.where(now.heard, law.response * law.ratio * np.fft.rfft(volts), 0.0)
    return float(np.std(np.fft.irfft(missing, volts.size)[now.counts])) < CORRECTS * error


def _mean_square(now: Learned, errors: Sequence[FloatArray]) -> Steps[tuple[float, int]]:
    """Of the samples that count, um^2, with what does not repeat; and their number."""
    total, rows = 0.0, max(1, AT_ONCE // errors[0].size)
    for begin in range(0, len(errors), rows):
        total += float(np.sum((np.array(errors[begin : begin + rows]) + now.unlearned)[:, now.counts] ** 2))
        yield
    count = len(errors) * int(now.counts.sum())
    return total / count, count


def _loses(seen: tuple[float, int], alone: tuple[float, int]) -> bool:
    """Whether the mean square of a batch is above that of another one, beyond chance."""
    return seen[0] > alone[0] * (1 + SURE * math.sqrt(2 / seen[1] + 2 / alone[1]))


def _with_model(now: Learned, hysteresis: PeriodicHysteresis) -> Steps[Learned]:
    """With another model of the hysteresis, and the strain that it makes of earlier batches."""
    passes = []
    for x, _, Z, noise2 in now.passes:
        strain = yield from hysteresis.strain(x)
        passes.append((x, np.fft.rfft(strain), Z, noise2))
        yield
    now.law.output_again([one[1] for one in now.passes], [one[1] for one in passes])
    return replace(now, hysteresis=hysteresis, passes=tuple(passes))


def _scaled(law: HarmonicLaw, output: ComplexArray, measured: ComplexArray) -> bool:
    """The gain is that of a batch; False: its sign is wrong, and it stays."""
    gain = law.gain(output, measured)
    if gain > 0:
        law.scale(gain)
    return gain > 0


def _spectra(errors: Sequence[FloatArray]) -> Steps[tuple[ComplexArray, FloatArray]]:
    """Mean of some periods, which may drift and wander a little, and its variance at each harmonic."""
    n, rows = len(errors), max(1, AT_ONCE // errors[0].size)
    last = np.fft.rfft(errors[0])
    total, scatter = last.copy(), np.zeros(last.size)
    for begin in range(1, n, rows):
        yield
        some = np.fft.rfft(np.array(errors[begin : begin + rows]), axis=1)
        yield
        scatter += np.sum(np.abs(np.diff(some, axis=0, prepend=last[None])) ** 2, axis=0)
        total += some.sum(axis=0)
        last = some[-1]
    return total / n, scatter / (2 * n * (n - 1))


def _followed(now: Learned, measured: Measured, volts: FloatArray, missing: FloatArray, noise: float) -> Steps[Outcome]:
    """The voltage of the next batch is taken, but for its mean."""
    following = yield from now.law.following(float(np.std(missing)))
    yield
    batch = Batch(
        number=measured.number,
        tick=measured.tick,
        rmse=float(np.sqrt(np.mean(missing**2))),
        maximum=float(np.abs(missing).max()),
        noise=noise,
        expected=following.expected,
        undone="the controller alone is better" if now.lost >= LOSES else following.undone,
    )
    if not following.undone:
        now = replace(now, base=volts, table=measured.table)
    assert now.base is not None
    assert now.table is not None
    assert now.hysteresis is not None
    assert now.inside is not None
    strain = np.fft.irfft(following.output, volts.size)
    yield
    x = yield from now.hysteresis.volts(strain, now.base, now.heard)
    corrections = []
    for total in (x, now.base):
        yield
        v = np.where(now.heard, np.fft.rfft(total - now.base + now.table), 0.0)
        v[0] = 0.0
        corrections.append(np.fft.irfft(v, volts.size))
    sample2 = len(measured.errors) * noise**2
    most = ABOVE * now.law.first**2 + NOISES * sample2
    return Outcome(now, corrections[0], batch, corrections[1], most)
