"""Modes, lag and dead time by least squares from the spectra of a record, with its transients."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.model.dynamics import averaged

FLOOR = 0.004  # of the output: what hysteresis and creep make of a line beyond the model, standard deviation
DAMPING = 5e-4, 0.7
RELAXING = 0.6  # at most: the part of the gain that relaxes, over that which does not
SLOW = 1.0, 50.0, 0.5  # Hz, Hz, of the first resonance: least and largest corner of that relaxation
CREEP = 0.06  # at most: the exponent of its power law
CANDIDATES = 400  # frequencies at which another mode is looked for
NEEDED = 5  # numbers of a mode: frequency, damping, share and two of its transient
FLAT = 0.6  # damping: a mode with more is no resonance
VAGUE = 0.02, 0.4  # relative: standard deviations of frequency and damping beyond which a mode is not known
ASIDE = 1.3  # times the first frequency: the least second one, where one mode alone does not fit
EVALUATIONS = 30  # steps of the search, at most
ABOUT = 1.25  # times its start, or over it: as far as a mode is looked for
SHIFTS = 3  # times, at most, that the first mode is looked for from the end of that on
POOR = 5.0  # cost of a line of a fit that may be of another minimum
STEP = 1.5e-8  # of a difference for a derivative
KEPT = 8  # parts of the response to the last numbers: a derivative changes one number, and most parts remain


@dataclass(frozen=True, eq=False)
class Spectra:
    """Input and output of a record at its lines.

    Attributes
    ----------
    sample_rate : float
        Hz.
    ticks : int
        Of the record.
    frequency : ndarray, shape (lines,)
        Hz.
    U, Y : ndarray of complex, shape (lines,)
        V, um.
    variance : ndarray, shape (lines,)
        Of the noise of Y, um^2.
    """

    sample_rate: float
    ticks: int
    frequency: FloatArray
    U: ComplexArray
    Y: ComplexArray
    variance: FloatArray


@dataclass(frozen=True, eq=False)
class Fit:
    """A model of the stage, fitted.

    Attributes
    ----------
    frequency, damping, share : ndarray, shape (modes,)
        Hz, 1, 1.
    lag : float
        Time constant of the amplifier, s; 0 is none.
    delay : float
        Dead time, s.
    hysteresis : tuple[float, float, float]
        What hysteresis and creep make of the response, which is not in the modes: the part that relaxes, its corner,
        Hz, and the exponent of the creep.
    gain : float
        Static, um/V.
    deviations : dict
        Standard deviations of the numbers by name.
    response : ndarray of complex, shape (lines,)
        um/V, of the whole.
    measured : ndarray of complex, shape (lines,)
        um/V: the spectrum without the transients, over that of the input.
    cost : float
        Sum of the squares of the weighted residual; 1 a line where the model is right.
    numbers : int
        That are fitted.
    x : ndarray
        The nonlinear ones, as `Problem` has them.
    """

    frequency: FloatArray
    damping: FloatArray
    share: FloatArray
    lag: float
    delay: float
    hysteresis: tuple[float, float, float]
    gain: float
    deviations: dict[str, float]
    response: ComplexArray
    measured: ComplexArray
    cost: float
    numbers: int
    x: FloatArray

    @property
    def evidence(self) -> float:
        """The smaller the better: the criterion of Schwarz."""
        return 2 * self.cost + self.numbers * math.log(2 * self.response.size)

    def resonates(self, i: int) -> bool:
        """Whether mode i is one, and known."""
        numbers = ("frequency", self.frequency), ("damping", self.damping)
        known = [self.deviations[f"{n}[{i}]"] < v * x[i] for (n, x), v in zip(numbers, VAGUE, strict=True)]
        return bool(self.damping[i] < FLAT and all(known))


def pulse_transfer(pole: complex, delay: float, z: ComplexArray) -> ComplexArray:
    """Of 1 / (s - pole), from held commands to means over a tick; pole times the tick, delay in ticks, z on the circle.

    With Q(t) = (exp(p t) - 1 - p t) / p^2, 0 before t = 0, the double integral of its impulse response, and a mean over
    the time w that ends at e, entry n of the pulse response is::

        (Q(n + e) - Q(n + e - 1) - Q(n + e - w) + Q(n + e - 1 - w)) / w

    >>> z = np.exp(2j * np.pi * np.array([1e-6]))
    >>> pulse_transfer(-0.5 + 0j, 0.3, z).real.round(6)
    array([2.])
    """
    first, entries, rest = _pulses(pole, delay)
    one = 1 / z
    made = rest / (1 - cmath.exp(pole) * one)
    for entry in entries[::-1]:  # by Horner: powers of so many complex numbers take five times as long
        made = made * one + entry
    return np.asarray(made * one**first)


def pair_transfer(pole: complex, residue: complex, delay: float, z: ComplexArray) -> ComplexArray:
    """Of residue / (s - pole) and its conjugate, as `pulse_transfer`: together their numbers are real."""
    first, entries, rest = _pulses(pole, delay)
    one, decay, rest = 1 / z, cmath.exp(pole), residue * rest
    made = 2 * (rest.real - (rest * decay.conjugate()).real * one)
    made /= (1 - decay * one) * (1 - decay.conjugate() * one)
    for entry in 2 * (residue * entries[::-1]).real:
        made *= one
        made += entry
    return np.asarray(made * one**first)


def _pulses(pole: complex, delay: float) -> tuple[int, ComplexArray, complex]:
    """The first entry of the pulse response that is not 0, all up to where it decays, and the one from there on."""
    width = averaged(delay)
    end = 0.5 - delay + width / 2
    corners = (end, 1.0), (end - 1, -1.0), (end - width, -1.0), (end - 1 - width, 1.0)
    first, later = 1 - math.ceil(end), math.ceil(1 + width - end)
    each = [sum(sign * _ramp(pole, n + t) for t, sign in corners) for n in range(first, later)]
    entries = np.array(each, np.complex128) / width
    rest = sum(sign * cmath.exp(pole * (later + t)) for t, sign in corners) / (pole**2 * width)
    return first, entries, rest


def _ramp(pole: complex, t: float) -> complex:
    return (cmath.exp(pole * t) - 1 - pole * t) / pole**2 if t > 0 else 0j


def small_hysteresis(f: FloatArray, numbers: tuple[float, float, float], last: float) -> ComplexArray:
    """What hysteresis and creep make of a small motion among others, at f, Hz; 1 far above, at `last`, Hz.

    The other frequencies of a multisine shake the small loops: their part of the gain relaxes, in a Bouc-Wen model as a
    first-order lag with a corner of beta E|dx/dt|. Creep is logarithmic in time, a power of the frequency.
    """
    part, corner, creep = numbers
    power = (f / last) ** -creep * np.exp(-0.5j * math.pi * creep)  # of 1j f / last: a complex power takes longer
    return np.asarray((1 + part / (1 + 1j * f / corner)) * power)


class Solved(NamedTuple):
    """The linear numbers at some nonlinear ones, with the inverse of the products of their rows."""

    rows: FloatArray
    linear: FloatArray
    inverse: FloatArray
    residual: FloatArray
    basis: ComplexArray


class Problem:
    """The fit of so many modes, with or without the lag of an amplifier."""

    def __init__(self, spectra: Spectra, modes: int, lag: bool) -> None:
        self.s, self.modes, self.lag = spectra, modes, lag
        self.z = np.exp(2j * np.pi * spectra.frequency / spectra.sample_rate)
        self.weight = 1 / np.sqrt(spectra.variance + FLOOR**2 * np.abs(spectra.Y) ** 2)
        self.target = (spectra.Y * self.weight).view(np.float64)
        t = np.arange(spectra.ticks) / spectra.ticks
        lines = np.round(spectra.frequency * spectra.ticks / spectra.sample_rate).astype(int)
        drifts = [t, t**2, np.log(t + 0.02)]  # slow: warming, creep after the ramp to the bias
        self.slow = np.array([np.fft.rfft(drift)[lines] for drift in drifts]).T
        self._mode, self._decays = lru_cache(KEPT * modes)(self._mode_of), lru_cache(KEPT * modes)(self._decays_of)
        self._around = lru_cache(KEPT)(self._around_of)
        self._lagging = lru_cache(KEPT)(self._lagging_of)
        self._solved: tuple[FloatArray, Solved] | None = None

    # Nonlinear numbers: log f, log zeta of each mode; delay (ticks), the relaxing part, log of its corner (Hz), creep;
    # log(lag / tick).

    def solve(self, x: FloatArray) -> Solved:
        """The linear numbers of least squares; made once for the last x, whose derivatives are asked for next."""
        if self._solved is None or not np.array_equal(x, self._solved[0]):
            basis = self.basis(x)
            rows = self._rows(x, basis)
            scale = np.sqrt(np.einsum("ik,ik->i", rows, rows))
            unit = rows / scale[:, None]
            inverse = np.linalg.inv(unit @ unit.T + 1e-12 * np.eye(scale.size)) / np.outer(scale, scale)
            linear = inverse @ (rows @ self.target)
            self._solved = x.copy(), Solved(rows, linear, inverse, self.target - linear @ rows, basis)
        return self._solved[1]

    def _rows(self, x: FloatArray, basis: ComplexArray) -> FloatArray:
        """Weighted, of the linear numbers: the real and the imaginary part of each line are two equations."""
        rows = np.concatenate([(basis * self.s.U[:, None]).T, self.transients(x).T]) * self.weight
        return rows.view(np.float64)

    def jacobian(self, x: FloatArray, high: FloatArray) -> FloatArray:
        """Derivatives of the residual, shape (equations, numbers), none of them made beyond `high`.

        By variable projection (Golub and Pereyra 1973): with the rows R of the linear numbers c, and R' of a
        difference in one number of x, that of the residual r = t - c R is -c R' + R^T (R R^T)^-1 (R (c R') - R' r).
        """
        at = self.solve(x)
        moved, missed = np.empty((x.size, at.residual.size)), np.empty((x.size, at.linear.size))
        for k, h in enumerate(STEP * np.maximum(1.0, np.abs(x))):
            there = x.copy()
            there[k] += h if x[k] + h <= high[k] else -h
            change = (self._rows(there, self.basis(there)) - at.rows) / (there[k] - x[k])
            moved[k], missed[k] = at.linear @ change, change @ at.residual
        return np.asarray(at.rows.T @ (at.inverse @ (at.rows @ moved.T - missed.T)) - moved.T)

    def basis(self, x: FloatArray) -> ComplexArray:
        """Response of each mode with a share of 1, behind lag, delay, hysteresis and creep."""
        delay, part, corner, creep = x[2 * self.modes : 2 * self.modes + 4]
        around, lag = self._around(part, corner, creep), x[-1] if self.lag else None
        return np.array([self._mode(*x[2 * i : 2 * i + 2], delay, lag) * around for i in range(self.modes)]).T

    def _around_of(self, part: float, corner: float, creep: float) -> ComplexArray:
        return small_hysteresis(self.s.frequency, (part, math.exp(corner), creep), self.s.frequency[-1])

    def _mode_of(self, frequency: float, damping: float, delay: float, lag: float | None) -> ComplexArray:
        """Pulse transfer of a mode behind the lag, by partial fractions."""
        pole = self.pole(frequency, damping)
        w2 = abs(pole) ** 2
        residue = w2 / (2j * pole.imag)
        if lag is None:
            return pair_transfer(pole, residue, delay, self.z)
        fast = -math.exp(-lag)
        residue = residue * -fast / (pole - fast)
        alone = -fast * w2 / ((fast - pole) * (fast - pole.conjugate())).real
        return np.asarray(pair_transfer(pole, residue, delay, self.z) + alone * self._lagging(fast, delay))

    def _lagging_of(self, fast: float, delay: float) -> ComplexArray:
        return pulse_transfer(complex(fast), delay, self.z)

    def pole(self, frequency: float, damping: float) -> complex:
        """Of a mode, times the tick."""
        w, damping = 2 * math.pi * math.exp(frequency) / self.s.sample_rate, math.exp(damping)
        return complex(-damping * w, w * math.sqrt(1 - damping**2))

    def transients(self, x: FloatArray) -> ComplexArray:
        """What the difference of the states at both ends of the record adds: free decays; and the slow drifts."""
        columns = [column for i in range(self.modes) for column in self._decays(*x[2 * i : 2 * i + 2])]
        return np.column_stack([*columns, self.slow])

    def _decays_of(self, frequency: float, damping: float) -> tuple[ComplexArray, ComplexArray]:
        ratio = np.exp(self.pole(frequency, damping))
        one, other = 1 / (1 - ratio / self.z), 1 / (1 - np.conj(ratio) / self.z)
        return one + other, 1j * (one - other)

    def run(self, frequency: Sequence[float], damping: Sequence[float], delay: float, lag: float = 0.3) -> Fit:
        """From starting values: Hz and 1 of the modes, dead time and lag in ticks."""
        from scipy.optimize import least_squares

        rate, high = self.s.sample_rate, self.s.frequency[-1]
        x = [v for f, zeta in zip(frequency, damping, strict=True) for v in (math.log(f), math.log(zeta))]
        low = [v for f in frequency for v in (math.log(f / ABOUT), math.log(DAMPING[0]))]
        top = [v for f in frequency for v in (math.log(min(ABOUT * f, 1.5 * high)), math.log(DAMPING[1]))]
        slowest, fastest = math.log(SLOW[0]), math.log(max(min(SLOW[1], SLOW[2] * min(frequency)), 2 * SLOW[0]))
        x, low = [*x, delay, 0.02, (slowest + fastest) / 2, 0.005], [*low, -1.0, 0.0, slowest, 0.0]
        top = [*top, max(22.0, delay + 2), RELAXING, fastest, CREEP]
        scale = [v for _ in frequency for v in (0.003, 0.2)] + [0.05, 0.02, 0.5, 0.005]
        if self.lag:
            x, low, top = [*x, math.log(lag)], [*low, math.log(0.01)], [*top, math.log(rate / 10)]
            scale = [*scale, 0.2]
        found = least_squares(
            lambda x: self.solve(x).residual, np.clip(x, low, top), lambda x: self.jacobian(x, np.array(top)),
            bounds=(low, top), x_scale=scale, ftol=1e-6, xtol=1e-6, max_nfev=EVALUATIONS,
        )  # fmt: skip
        return self.fit(found.x, found.jac)

    def at(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Response, and spectrum without transients over that of the input, of a fit to other lines, um/V."""
        linear, basis = self.solve(x).linear, self.solve(x).basis
        transients = self.transients(x) @ linear[self.modes :]
        return basis @ linear[: self.modes], (self.s.Y - transients) / self.s.U

    def fit(self, x: FloatArray, jacobian: FloatArray) -> Fit:
        """The numbers at a minimum, and their deviations."""
        residual, linear, basis = self.solve(x).residual, self.solve(x).linear, self.solve(x).basis
        parts, m = linear[: self.modes], self.modes
        gain = float(parts.sum())
        cost = float(residual @ residual)
        spread = max(cost / (residual.size - x.size - linear.size), 0.5)  # real and imaginary part have half each
        transients = self.transients(x) @ linear[m:]
        variances = spread * np.diag(np.linalg.pinv(jacobian.T @ jacobian))
        deviation = np.sqrt(np.maximum(variances, 0.0))
        lag = math.exp(x[-1]) / self.s.sample_rate if self.lag else 0.0
        names = {f"frequency[{i}]": math.exp(x[2 * i]) * deviation[2 * i] for i in range(m)}
        names |= {f"damping[{i}]": math.exp(x[2 * i + 1]) * deviation[2 * i + 1] for i in range(m)}
        names["dead_time"] = deviation[2 * m] / self.s.sample_rate
        if self.lag:
            names["amplifier_bandwidth"] = deviation[-1] / (2 * math.pi * lag)
        return Fit(
            frequency=np.exp(x[0 : 2 * m : 2]),
            damping=np.exp(x[1 : 2 * m : 2]),
            share=parts / gain,
            lag=lag,
            delay=float(x[2 * m]) / self.s.sample_rate,
            hysteresis=(float(x[2 * m + 1]), math.exp(x[2 * m + 2]), float(x[2 * m + 3])),
            gain=gain,
            deviations={name: float(value) for name, value in names.items()},
            response=basis @ parts,
            measured=(self.s.Y - transients) / self.s.U,
            cost=cost,
            numbers=x.size + linear.size,
            x=x,
        )


def beside_a_lag(fit: Fit, made: Sequence[Fit]) -> Fit:
    """A fit without the lag of an amplifier, with the deviation of its dead time as it is with one; others as they are.

    A lag that is too short to be seen is in the dead time, whose own deviation does not include it.
    """
    lagged = [one for one in made if one.lag and one.frequency.size == fit.frequency.size]
    if fit.lag or not lagged:
        return fit
    other = min(lagged, key=lambda one: one.evidence)
    deviation = math.hypot(other.deviations["dead_time"], other.delay - fit.delay)
    return replace(fit, deviations={**fit.deviations, "dead_time": max(deviation, fit.deviations["dead_time"])})


# ---- Which modes ---------------------------------------------------------------------------------------------------


def next_mode(spectra: Spectra, found: Fit, above: float = 0.0) -> tuple[float, float]:
    """Frequency, Hz, of the mode that explains most of the residual of a fit, and by how much the cost decreases.

    The mode is above `above`, Hz.
    """
    weight = np.abs(spectra.U) / np.sqrt(spectra.variance + FLOOR**2 * np.abs(spectra.Y) ** 2)
    rest = (found.measured - found.response) * weight
    f = spectra.frequency
    candidates = np.geomspace(max(f[0], 0.3 * found.frequency.min(), above), f[-1], CANDIDATES)
    around = np.exp(1j * (np.angle(found.response) - np.angle(modal(found, f))))  # phase of delay and lag
    scores = []
    for candidate in candidates:
        ratio = f / candidate
        mode = around * weight / (1 - ratio**2 + 0.02j * ratio)
        scores.append(np.vdot(mode, rest).real ** 2 / np.vdot(mode, mode).real)
    best = int(np.argmax(scores))
    return float(candidates[best]), float(scores[best])


def modal(found: Fit, f: FloatArray) -> ComplexArray:
    """The modes alone, at frequencies in Hz."""
    parts = zip(found.frequency, found.damping, found.share, strict=True)
    return np.asarray(sum(share / (1 - (f / f0) ** 2 + 2j * zeta * f / f0) for f0, zeta, share in parts))


def fits(spectra: Spectra, first: float, delay: float, most: int = 3, lags: bool = True) -> list[Fit]:
    """With one mode, two, ... the best first; another mode is tried where the residual may have one.

    `first` is the frequency of the first mode, Hz, and `delay` the dead time, ticks, to begin with. Without `lags` that
    of the amplifier is known, and in the input.
    """
    frequency, damping, lag, rough, made = [first], [0.02], 0.3, delay, list[Fit]()
    with_a_lag = (True, False) if lags else (False,)
    while True:
        count = len(frequency)
        starts = [(known, delay, lag) for known in with_a_lag]
        if delay > 1.0 and lags:  # most of it may be a lag: another minimum
            starts += [(True, 0.2 * delay, 0.8 * delay)]
        tried = [Problem(spectra, count, known).run(frequency, damping, d, tau) for known, d, tau in starts]
        best = min(tried, key=lambda fit: fit.evidence)
        if count == 1:
            tried += _shifted(spectra, best, first, delay, with_a_lag)
            best = min(tried, key=lambda fit: fit.evidence)
        if count > 1 and best.cost > POOR * best.response.size:  # fewer modes had dead time and lag that are wrong
            tried += [Problem(spectra, count, known).run(frequency, damping, rough, 0.3) for known in with_a_lag]
            best = min(tried, key=lambda fit: fit.evidence)
        worse = bool(made) and best.evidence >= min(fit.evidence for fit in made)
        made += tried
        candidate, gained = next_mode(spectra, best)
        enough = 2 * gained < NEEDED * math.log(2 * spectra.U.size)
        lost = not best.resonates(int(np.argmin(best.frequency)))
        if worse or enough or count == most or (lost and ASIDE * first >= spectra.frequency[-1]):
            break
        if lost:  # beside others that are as high, too few modes fit none: the first one is where its peak is
            found = [f for i, f in enumerate(best.frequency) if f > ASIDE * first and best.resonates(i)]
            frequency = sorted([first, *found, next_mode(spectra, best, ASIDE * first)[0]])
            damping = [0.02] * len(frequency)
            continue
        modes = sorted([*zip(best.frequency, best.damping, strict=True), (candidate, 0.01)])
        frequency, damping = ([float(mode[i]) for mode in modes] for i in range(2))
        delay, lag = best.delay * spectra.sample_rate, max(best.lag * spectra.sample_rate, 0.3)
    made += [_without(spectra, fit) for fit in tried if count > 1 and 0 < sum(_resonate(fit)) < count]
    return sorted(made, key=lambda fit: fit.evidence)


def _shifted(spectra: Spectra, fit: Fit, start: float, delay: float, lags: Sequence[bool]) -> list[Fit]:
    """From where a fit with one mode ended, if that is the end of where the mode was looked for, from `start` Hz."""
    made = list[Fit]()
    while abs(math.log(fit.frequency[0] / start)) > 0.99 * math.log(ABOUT) and len(made) < len(lags) * SHIFTS:
        start = float(fit.frequency[0])
        made += [Problem(spectra, 1, known).run([start], [0.02], delay) for known in lags]
        fit = min(made[-len(lags) :], key=lambda fit: fit.evidence)
    return made


def _resonate(fit: Fit) -> list[bool]:
    return [fit.resonates(i) for i in range(fit.frequency.size)]


def _without(spectra: Spectra, fit: Fit) -> Fit:
    """Without the modes that are none, from what it has found beside them."""
    kept, rate = _resonate(fit), spectra.sample_rate
    frequency, damping = ([float(x) for x in numbers[kept]] for numbers in (fit.frequency, fit.damping))
    return Problem(spectra, sum(kept), fit.lag > 0).run(frequency, damping, fit.delay * rate, max(fit.lag * rate, 0.01))
