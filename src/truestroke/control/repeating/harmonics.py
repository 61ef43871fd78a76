"""The law that learns what repeats: one number for each harmonic, from pass to pass.

At each harmonic h of the motion::

    U(h) <- U(h) + s(h) w(h) E(h) / (R(h) G(h)),    E = D - Z

- U is what is put out, D what is desired, Z what the sensor shows of it; G is the response from U to Z that is known
  beforehand.
- R, the ratio of the true response to G, is estimated from all passes: R = 1 with the standard deviation that gain, f0,
  damping and dead time leave, then by least squares from what each change of U made of Z.
- s = |R|^2 / (|R|^2 + var R) makes the mean square of 1 - s R_true / R as small as it can be, var R / (|R|^2 + var R):
  below 1 at each harmonic, whatever is known. Where little is known, the step is small.
- w = |E|^2 / (|E|^2 + var E), so that noise is not learned.

A pass that is worse than the best one before it is undone: its U is given up, what it shows of R stays.

`iterative` learns the voltage by it, pass by pass, and `repetitive` a correction of it, on line, by the
`OnlineLaw` of `online`.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.repeating.mean import MeanAnswer
from truestroke.control.repeating.response_prior import Prior
from truestroke.control.repeating.steps import Steps, finished

BoolArray = npt.NDArray[np.bool_]
Spectra = tuple[ComplexArray, ComplexArray, FloatArray]
"""Of a pass, as `numpy.fft.rfft` has them: U, Z, um, and the variance of the latter."""

CROSSED, POWER = 0.1, 1.5  # hysteresis: a tenth of the change of all harmonics reaches the first, / h^1.5 harmonic h
KEPT = 0.8  # of what older passes say of R: it may not hold any more
SURE = 0.1  # relative variance of R below which a harmonic shows a change of the stage
LITTLE = 1e-12  # of the power of the motion: of rounding
CHANGED = 2.0  # times what a change of U makes: beyond, the stage has changed
WORSE = 1.05  # times the rmse of the best pass
SHY = 0.5  # times the step after a pass that was undone
SHOWN = 12.0  # times the variance of the noise: power beyond the bandwidth that is surely none
WHOLE = 0.3  # relative deviation of the answer to a small change from that to the whole motion: hysteresis
STILL = 1e-3  # of the response at rest: what a harmonic answers at least
MOVED, MOVED_BEYOND = 0.01, 1.0  # of the power of a change of voltage: what it moves elsewhere, as displacement
NEIGHBOUR, REACH = 0.2, 64  # hysteresis: so much of the change of a harmonic reaches each one beside it, / the distance
CARRIED = 4.0  # times the power that noise, which is put out, has at other harmonics
PROBED = 0.3  # of the step beyond the bandwidth, at least: it shows R
DOUBTED = 0.5  # variance of R beforehand, at least, once passes have shown that what is known of it is wrong
PAIRS = 3  # earlier changes whose effect is known
LONGEST = 1.5  # times such a change: how far its effect is trusted
ALIKE = 1e-3  # relative regularisation of changes that are alike
LEAST = 0.1  # of the whole step: the least that is taken
IN_TURNS = 0.001  # weight of the error where it does not count, beside 1 where it does
ITERATIONS = 200  # of conjugate gradients, at most
ENOUGH = 1e-20  # of the square of the wave: what may be left then


@dataclass(frozen=True, eq=False)
class Next:
    """What follows from a pass.

    Attributes
    ----------
    output : ndarray of complex
        U of the next pass.
    expected : float
        Its rmse where all harmonics count alike, noise included, um.
    undone : str
        In a sentence, why it does not build on this pass; empty where it does.
    """

    output: ComplexArray
    expected: float
    undone: str


class HarmonicLaw:
    """The law for one motion.

    Parameters
    ----------
    desired : ndarray of complex, shape (samples // 2 + 1,)
        D, `numpy.fft.rfft` of one repetition of what the sensor should show, um.
    response : ndarray of complex
        G at these harmonics, um per unit of U.
    prior : Prior
        What is known of R at the beginning.
    learned : ndarray of bool
        Which harmonics are learned.
    samples, periods : int
        Of a repetition.
    known : bool
        Whether R is known from the prior at once; else `knowing` is the first that is called.

    Attributes
    ----------
    ratio : ndarray of complex
        R as it is known.
    scaled : float
        How many times larger G has become.
    """

    worse = WORSE

    def __init__(
        self,
        desired: ComplexArray,
        response: ComplexArray,
        prior: Prior,
        learned: BoolArray,
        *,
        samples: int,
        periods: int = 1,
        known: bool = True,
    ) -> None:
        self.desired, self.response, self.samples, self.periods = desired, response, samples, periods
        self.learned = learned
        self._moving = learned & (np.arange(learned.size) > 0)
        self._prior, self._doubted = prior, 0.0  # the least variance of R beforehand
        self._shown: tuple[ComplexArray, FloatArray] = np.zeros_like(response), np.zeros(response.size)
        if known:
            self.know()
        self._last: Spectra | None = None
        self._base: tuple[float, ComplexArray, ComplexArray, FloatArray] | None = None
        self._step, self._worse, self._changed = 1.0, False, False
        self._pairs: list[Spectra] = []  # U and E of the last passes, and the variance of the latter
        self.scaled = 1.0

    def copy(self) -> Self:
        """Another one that goes on from here; no array of either is changed."""
        other = copy.copy(self)
        other._prior = copy.copy(self._prior)
        return other

    def remember(self, other: HarmonicLaw, then: FloatArray, now: FloatArray) -> None:
        """G, and R as far as it is known, of another law; their harmonics are at these frequencies then and now."""

        def between(x: FloatArray) -> FloatArray:
            return np.asarray(np.interp(now, then, x))

        self.scale(other.scaled)
        information = KEPT * between(other._shown[1])
        ratio = between(other.ratio.real) + 1j * between(other.ratio.imag)
        self._shown = np.asarray(information * ratio, dtype=np.complex128), information
        self.know()

    def know(self) -> None:
        """R and its variance, nearer to what the passes make of what is known without them."""
        finished(self.knowing())

    def knowing(self) -> Steps[None]:
        """`know` in steps."""
        weighted, information = self._shown
        mean, variance = yield from self._prior.giving(weighted, information)
        variance = np.maximum(variance, self._doubted)
        yield
        self._information = 1 / variance + information
        self.ratio: ComplexArray = np.asarray((mean / variance + weighted) / self._information, dtype=np.complex128)

    @property
    def fresh(self) -> bool:
        """Whether it has not seen a pass."""
        return self._last is None

    def gain(self, output: ComplexArray, measured: ComplexArray) -> float:
        """True gain over that of G, as a pass shows it, without its mean."""
        x = (self.response * output)[1:] * self.learned[1:]
        return float(np.sum(np.conj(x) * measured[1:]).real / np.sum(np.abs(x) ** 2))

    def scale(self, gain: float) -> None:
        """G becomes so many times larger."""
        self.response, self.scaled = gain * self.response, gain * self.scaled

    def delay(self, samples: float) -> None:
        """G becomes so much later."""
        self.response = later(self.response, samples, self.samples)

    def noise(self, noise2: FloatArray) -> float:
        """Standard deviation in time of what has these variances of its harmonics, um."""
        return float(np.sqrt(2 * noise2.sum())) / self.samples

    def expected(self, output: ComplexArray) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Z of a pass with U, um, by the last one and R; the change that it has of that; and the variance of the noise.

        Harmonics that are not learned are 0, and so is the mean.
        """
        assert self._last is not None
        U, Z, noise2 = self._last
        change = np.where(self._moving, self.ratio * self.response * (output - U), 0.0)
        return np.where(self._moving, Z, 0.0) + change, change, np.where(self._moving, noise2, 0.0)

    @property
    def best(self) -> float:
        """Rms of the error of the pass on which the next one builds, without its mean, um."""
        return math.inf if self._base is None else self._base[0]

    def remembers(self, output: ComplexArray) -> bool:
        """Whether what follows depends on a pass with this U."""
        base = [] if self._base is None else [self._base[1]]
        last = [] if self._last is None else [self._last[0]]
        return any(np.array_equal(output, U) for U in [*last, *base, *(pair[0] for pair in self._pairs)])

    def output_again(self, outputs: list[ComplexArray], others: list[ComplexArray]) -> None:
        """The remembered passes had these U; what was output is the same, and is described by others now."""

        def other(U: ComplexArray) -> ComplexArray:
            return next(V for output, V in zip(outputs, others, strict=True) if np.array_equal(output, U))

        if self._last is not None:
            self._last = other(self._last[0]), *self._last[1:]
        if self._base is not None:
            spread, U, E, noise2 = self._base
            self._base = spread, other(U), E, noise2
        self._pairs = [(other(U), E, noise2) for U, E, noise2 in self._pairs]

    # ---- A pass ----------------------------------------------------------------------------------------------------

    def see(self, output: ComplexArray, measured: ComplexArray, noise2: FloatArray) -> None:
        """What a pass with U has shown: its Z, and the variance of each harmonic of it, um^2."""
        finished(self.seeing(output, measured, noise2))

    def seeing(self, output: ComplexArray, measured: ComplexArray, noise2: FloatArray) -> Steps[None]:
        """`see` in steps."""
        this, before = (output, measured, noise2), self._last
        self._changed = False if before is None else (yield from self._estimate(before, this))
        self._last = this
        yield from self._estimate_error(before, this)

    def _estimate_error(self, before: Spectra | None, this: Spectra) -> Steps[None]:
        """The error on which the next pass builds."""
        yield
        self._error = self.desired - this[1]

    def _weight(self, E: ComplexArray, noise2: FloatArray) -> FloatArray:
        """w, the share of an error that is no noise."""
        power = np.abs(E) ** 2
        return np.asarray(power / np.maximum(power + noise2, 1e-300))

    def follow(self, spread: float) -> Next:
        """U of the pass after the one that was seen; `spread` is the rms of its error without its mean, um."""
        return finished(self.following(spread))

    def following(self, spread: float) -> Steps[Next]:
        """`follow` in steps."""
        assert self._last is not None
        output, _, noise2 = self._last
        E, noise = self._error, self.noise(noise2)
        undone = self._judge(spread, noise, E)
        assert self._base is not None
        _, U, E_base, noise2 = self._base
        U, E_base = np.append(output[:1], U[1:]), np.append(E[:1], E_base[1:])
        power = np.abs(E_base) ** 2
        R2, variance = np.abs(self.ratio) ** 2, 1 / self._information
        yield
        step = self._steps(E_base, noise2)
        yield
        step[1:] *= self._step
        left = power * ((1 - step) ** 2 + step**2 * variance / R2)
        left[0] /= 2
        expected = float(np.sqrt(2 * left.sum() / self.samples**2 + noise**2))  # by Parseval's theorem
        yield
        change = yield from self._change(U, E_base, step)
        return Next(U + change, expected, undone)

    def _steps(self, E: ComplexArray, noise2: FloatArray) -> FloatArray:
        """s w of each harmonic; 0 of those that are not learned."""
        R2 = np.abs(self.ratio) ** 2
        return np.where(self.learned, self._weight(E, noise2) * R2 / (R2 + 1 / self._information), 0.0)

    def _change(self, U: ComplexArray, E: ComplexArray, step: FloatArray) -> Steps[ComplexArray]:
        """Of U, by so large a step against the error."""
        yield
        R2 = np.maximum(np.abs(self.ratio) ** 2, 1e-300)
        return np.asarray(step * np.conj(self.ratio) / R2 * E / self.response)

    @property
    def _doubt(self) -> FloatArray:
        """Relative variance of R."""
        return np.asarray(1 / (self._information * np.maximum(np.abs(self.ratio) ** 2, 1e-300)))

    def _with_moved(
        self, change: ComplexArray, U: ComplexArray, T: ComplexArray
    ) -> Steps[tuple[ComplexArray, ComplexArray]]:
        """The change with what its likes have moved between harmonics, and its part that is like none of them.

        T is that from an error to the change of U.
        """
        B = self.response * self.ratio
        base = min(self._pairs, key=lambda pair: float(np.abs(pair[0] - U)[1:].max()))
        steps, moved, noise = [], [], []
        for V, E, noise2 in self._pairs:
            d = np.where(np.arange(V.size) > 0, V - base[0], 0.0)
            if not np.abs(d).any():
                continue
            yield
            r = np.where(self._moving, E - base[1] + B * d, 0.0)
            hidden = noise2 + base[2] + np.abs(B * d) ** 2 * self._doubt
            yield
            r = r * np.maximum(0.0, 1 - hidden / np.maximum(np.abs(r) ** 2, 1e-300))
            steps.append(d)
            moved.append(r)
            noise.append(np.sum((noise2 + base[2])[self._moving]) / max(float(np.sum(np.abs(r) ** 2)), 1e-300))
        if not steps:
            return change, change
        yield
        D, r = np.array(steps), np.array(moved)
        M = (D.conj() @ D.T).real
        M = M + np.diag(np.diag(M) * (ALIKE + np.minimum(noise, 1e6)))
        yield
        a = np.linalg.solve(M - (D.conj() @ (T * r).T).real, (D.conj() @ change).real)
        yield
        change = change + T * (np.clip(a, -LONGEST, LONGEST) @ r)
        return change, change - np.linalg.solve(M, (D.conj() @ change).real) @ D

    def _estimate(self, before: Spectra, after: Spectra) -> Steps[bool]:
        """R from what the change of U made of the displacement; whether the stage has changed: then not.

        It has where the sure harmonics did what no change of U explains. The mean creeps, and is left out.
        """
        (U, Z, noise), (V, Y, another) = before, after
        x, y = self.response * (V - U), Y - Z
        x[0] = 0.0
        expected = self.ratio * x
        sure = self._moving & (np.abs(self.ratio) ** 2 * SURE * self._information > 1)
        other = np.sqrt(np.sum(np.abs(y - expected)[sure] ** 2))
        known = np.sqrt(np.sum(np.abs(expected)[sure] ** 2))
        yield
        crossed = self._crossed(x)
        yield
        hidden = np.sum((noise + another + self._hidden(crossed) + self.least)[sure])
        if other > CHANGED * known + 5 * np.sqrt(hidden):
            return True
        scatter, told = noise + another + crossed + self.least, self._told(Z, noise)
        weighted, information = self._shown
        kept = 1 - (1 - KEPT) * told
        self._shown = (
            np.asarray(kept * weighted + told * np.conj(x) * y / scatter, dtype=np.complex128),
            kept * information + told * np.abs(x) ** 2 / scatter,
        )
        yield
        yield from self.knowing()
        return False

    def _told(self, Z: ComplexArray, noise2: FloatArray) -> FloatArray:
        """The share of what a change of U, that was made of the error of Z, may say of R."""
        return np.ones(Z.size)

    @property
    def least(self) -> FloatArray:
        """Variance of rounding, at each harmonic."""
        return np.full(self.response.size, LITTLE * float(np.sum(np.abs(self.desired) ** 2)))

    def _hidden(self, crossed: FloatArray) -> FloatArray:
        """How much of it cannot be distinguished from a change of the stage."""
        return np.zeros_like(crossed)

    def _crossed(self, x: ComplexArray) -> FloatArray:
        """Variance of what hysteresis makes at each harmonic of a change of the displacement by x."""
        h = 1.0 + np.arange(x.size) / self.periods
        return np.asarray((CROSSED / h**POWER) ** 2 * np.sum(np.abs(x[1:]) ** 2))

    @property
    def _neighbours(self) -> FloatArray:
        """Power of a strain that reaches a harmonic from those of the motion beside it, its own in the middle.

        A loop of which one half is the other one turned round moves odd harmonics to odd ones, and even to even ones.
        How far it is another one, the even harmonics of the strain show beside the odd ones.
        """
        apart = np.arange(-REACH, REACH + 1)
        power = np.abs((self.desired if self._last is None else self._last[0])[:: self.periods]) ** 2
        uneven = min(1.0, float(power[2::2].sum() / max(float(power[3::2].sum()), 1e-300)))
        return np.asarray((NEIGHBOUR / (1.0 + np.abs(apart))) ** 2 * np.where(apart % 2 == 0, 1.0, uneven))

    def _louder(self, own: FloatArray) -> FloatArray:
        """How many times its power noise has which a harmonic puts out; `own`: the power of its answer.

        Hysteresis moves it to the others, where a resonance amplifies it.
        """
        kernel = self._neighbours
        kernel[REACH] = 0.0
        size2 = np.abs(self.response[:: self.periods]) ** 2
        size2[0] = 0.0
        found = np.ones(own.size)
        found[:: self.periods] += CARRIED * summed(size2, kernel) / np.maximum(own[:: self.periods], 1e-300)
        return found

    def _moves(self, beyond: BoolArray) -> FloatArray:
        """What a change of voltage moves elsewhere; beyond the bandwidth more, as far as R is not known."""
        unknown = np.where(beyond, np.minimum(self._doubt, 1.0), 0.0)
        return np.asarray((MOVED + (MOVED_BEYOND - MOVED) * unknown) * np.abs(self.response[0]) ** 2)

    def _judge(self, spread: float, noise: float, E: ComplexArray) -> str:
        """Whether the next pass builds on this one; a sentence where it does not.

        The mean is not in `spread`: it creeps, and is corrected from the last pass always.
        """
        assert self._last is not None
        U, _, noise2 = self._last
        best = self.best
        if spread <= self.worse * best + 2 * noise:
            if spread < best:
                self._step = min(1.0, self._step / SHY)
            self._base, self._worse = (min(spread, best), U, E, noise2), False
            return ""
        if self._worse:
            self._base, self._worse = (spread, U, E, noise2), False
            return f"The stage has changed: {spread:.4g} um rms where it was {best:.4g}. It is learned again."
        self._worse = self._changed
        self._step = self._step if self._changed else max(LEAST, SHY * self._step)
        return f"This pass was worse, {spread:.4g} um rms where the best one had {best:.4g}: it is undone."


class PassLaw(HarmonicLaw):
    """The law for passes that learn the voltage from nothing; `beyond` are harmonics beyond the bandwidth.

    - A harmonic that takes much voltage for little displacement moves the others, by hysteresis: its step is small.
    - Nothing is put out beyond the bandwidth, but hysteresis excites harmonics there, and one may meet a further mode.
      Where the error is surely no noise it is learned, with small steps until the passes have shown R.
    - What hysteresis makes of a change is strain, in front of the stage: a resonance amplifies it, too.
    - Where the stage seems to have changed the best pass comes again. Is it as good as before, R was wrong, not the
      stage: what was known of R is forgotten, and the way back shows it.
    """

    def __init__(self, desired: ComplexArray, *given: Any, beyond: BoolArray, samples: int, **named: Any) -> None:
        self._mean = MeanAnswer(samples * float(np.ptp(np.fft.irfft(desired, samples))))
        super().__init__(desired, *given, samples=samples, **named)
        self._beyond = beyond
        self._asks = False
        self._before: Spectra | None = None  # the pass before the last one

    def seeing(self, output: ComplexArray, measured: ComplexArray, noise2: FloatArray) -> Steps[None]:
        """As of `HarmonicLaw`; the first pass shows some of R by itself."""
        if self.fresh:
            x = self.response * output
            x[0] = x[self._beyond] = 0.0  # there it is what the model of the hysteresis makes, which is not sure enough
            scatter = noise2 + self._crossed(x) + (WHOLE * np.abs(x)) ** 2 + self.least
            self._shown = np.asarray(np.conj(x) * measured / scatter), np.abs(x) ** 2 / scatter
            yield from self.knowing()
        self._before = self._last
        self._see_mean(output, measured, noise2)
        yield from super().seeing(output, measured, noise2)
        earlier = [] if self._changed else self._pairs[-PAIRS:]
        self._pairs = [*earlier, (output, self._error, noise2)]

    def knowing(self) -> Steps[None]:
        """As of `HarmonicLaw`; what is known of R at harmonics of the motion is not that of its mean."""
        yield from super().knowing()
        self._know_mean()

    def _know_mean(self) -> None:
        self.ratio[0], self._information[0] = self._mean.ratio, 1 / self._mean.variance

    def _see_mean(self, output: ComplexArray, measured: ComplexArray, noise2: FloatArray) -> None:
        mean, height, z = self._strain_mean(output), self._half_height(output), measured[0].real.item()
        if self._last is None:
            self._mean.begin(mean, height, z)
        else:
            U, Z, another = self._last
            mean, height, z = mean - self._strain_mean(U), height - self._half_height(U), z - Z[0].real.item()
            moved = math.sqrt(2 * float(np.sum(np.abs(measured - Z)[1:] ** 2)))
            self._mean.see(mean, height, z, (noise2 + another)[0].item(), moved)
        self._know_mean()

    def _strain_mean(self, U: ComplexArray) -> float:
        """As displacement by the gain, times samples, um."""
        return float((self.response[0] * U[0]).real)

    def _half_height(self, U: ComplexArray) -> float:
        """Of the strain, in the same unit."""
        return self.samples / 2 * float(np.abs(self.response[0]) * np.ptp(np.fft.irfft(U, self.samples)))

    def _estimate_error(self, before: Spectra | None, this: Spectra) -> Steps[None]:
        """As of `HarmonicLaw`, with the creep that the mean will have in the next pass."""
        yield from super()._estimate_error(before, this)
        self._error[0] -= self._mean.foreseen

    def _change(self, U: ComplexArray, E: ComplexArray, step: FloatArray) -> Steps[ComplexArray]:
        """As of `HarmonicLaw`, with what its likes have moved."""
        R2 = np.maximum(np.abs(self.ratio) ** 2, 1e-300)
        T = np.where(self._moving, step * np.conj(self.ratio) / R2 / self.response, 0.0)
        change = yield from super()._change(U, E, step)
        change, _ = yield from self._with_moved(change, U, T)
        assert self._last is not None
        height = self._half_height(U + change) - self._half_height(self._last[0])
        change[0] = step[0] * self._mean.change(float(E[0].real), height) / self.response[0]
        return change

    def _judge(self, spread: float, noise: float, E: ComplexArray) -> str:
        asked, step = self._asks, self._step
        undone = super()._judge(spread, noise, E)
        self._asks = self._worse and self._changed
        if asked and not undone:
            self._forget(max(LEAST, SHY * step))
        return undone

    def _forget(self, step: float) -> None:
        """R is unsure again; the way back to the best pass, which no sure R explained, is the first that shows it."""
        assert self._before is not None
        assert self._last is not None
        self._doubted, self._step = DOUBTED, step
        self._shown = np.zeros_like(self.response), np.zeros(self.response.size)
        self.know()
        finished(self._estimate(self._before, self._last))

    def _crossed(self, x: ComplexArray) -> FloatArray:
        size = np.abs(self.response) / np.abs(self.response[0])
        return np.asarray(size**2 * super()._crossed(x / np.maximum(size, STILL)))

    def _steps(self, E: ComplexArray, noise2: FloatArray) -> FloatArray:
        if self._asks:
            return np.zeros(E.size)
        power, R2, variance = np.abs(E) ** 2, np.abs(self.ratio) ** 2, 1 / self._information
        usual = float(noise2[self._beyond].mean()) if self._beyond.any() else 0.0
        shown = self._beyond & (power > SHOWN * np.maximum(noise2, usual))
        own = np.abs(self.response) ** 2 * (R2 + variance)
        own[0] = math.inf
        known = np.maximum(R2 / (R2 + variance), np.where(self._beyond, PROBED, 0.0))
        step = self._weight(E, noise2 * self._louder(own)) * known
        moved = self._moves(self._beyond)
        return np.where(self.learned | shown, step / (1 + moved / np.maximum(own, 1e-300)), 0.0)


def later(harmonics: ComplexArray, by: float, samples: int) -> ComplexArray:
    """Harmonics of a period of so many samples, which begins `by` samples later."""
    return np.asarray(harmonics * np.exp(-2j * np.pi * np.arange(harmonics.size) * by / samples))


def summed(values: npt.NDArray[Any], window: FloatArray) -> FloatArray:
    """Sums over the neighbours, weighted; the window has an odd length."""
    half = window.size // 2
    return np.asarray(np.convolve(values, window)[half : half + values.size])


# ---- What can be learned -------------------------------------------------------------------------------------------


def nearest(wave: FloatArray, counts: BoolArray, learned: BoolArray) -> Steps[FloatArray]:
    """The wave of some harmonics alone that is nearest to another where errors count, by conjugate gradients, in steps.

    The error where it does not count has a small weight, so that the turns stay near the motion.

    Parameters
    ----------
    wave : ndarray, shape (samples,)
        One repetition, um.
    counts : ndarray of bool
        Where errors count.
    learned : ndarray of bool, shape (samples // 2 + 1,)
        Which harmonics it may have.

    Returns
    -------
    ndarray, shape (samples,)
        um
    """

    def within(x: FloatArray) -> Steps[FloatArray]:
        X = np.where(learned, np.fft.rfft(x), 0.0)
        yield
        return np.fft.irfft(X, x.size)

    found = yield from within(wave)
    if counts.all():
        return found
    weight = np.where(counts, 1.0, IN_TURNS)
    left = direction = yield from within(weight * (wave - found))
    size, enough = float(left @ left), ENOUGH * float(wave @ wave)
    for _ in range(ITERATIONS):
        if size <= enough:
            break
        yield
        turned = yield from within(weight * direction)
        pace = size / float(direction @ turned)
        found, left = found + pace * direction, left - pace * turned
        size, before = float(left @ left), size
        direction = left + size / before * direction
    return found
