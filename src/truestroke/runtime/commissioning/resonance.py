"""The first resonance of a stage from its answer to small steps: a model in the time domain, fitted to all of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray

CREEP = (0.01, 0.1, 1.0)  # s: time constants that creep is made of
DAMPING = (1e-3, 0.7)  # ratios that are looked for
PEAKS = 2  # of the spectrum that are tried
FIRST, EVALUATIONS = 10, 50  # of each fit: behind the first ones those go on that may still be the best, at most
LOST = 2.0  # times the least sum of squares: a fit that leaves more after the first evaluations ends there
DECISIVE = 30.0  # twice the difference of log-likelihood between an answer and the next
SHARE = 0.008  # of the squares that remain: by so much at least it must be better, as the model is not the stage
MISFIT = 0.25  # of the motion that the fit may leave, rms: beyond that it does not describe the stage
SLOWEST = 1000.0  # Hz: a sample rate below it shows a stage of any frequency as one of a few Hz
HIGH = 0.35  # of the sample rate: what may be there above it disturbs nobody
SURE = 0.02  # of the frequency: standard deviation beyond which it is not known
SYSTEMATIC = 0.003  # of the frequency: what the model is wrong by, where it fits


@dataclass(frozen=True, eq=False)
class Resonance:
    """What small steps say about the stage: second order behind a first-order lag and a delay.

    Attributes
    ----------
    frequency, uncertainty : float or None
        First resonance, Hz, and its standard deviation; None where it is not known.
    reason : str
        Why it is not known; else empty.
    damping : float
        Its ratio.
    delay : float
        Ticks from a command to the beginning of its answer in the record.
    gain : float
        um/V.
    fit : ndarray, shape (ticks,)
        What the best fit says of the record, um.
    doubtful : bool
        Whether there may be one that a controller has to know: it is not known, and not that high either.
    """

    frequency: float | None
    uncertainty: float | None
    reason: str
    damping: float
    delay: float
    gain: float
    fit: FloatArray
    doubtful: bool = False


def resonance(volts: FloatArray, z: FloatArray, sample_rate: float, onset: float, noise: float = 0.0) -> Resonance:
    """Find the first resonance in the answer to steps.

    A resonance above half the sample rate appears at a lower frequency; the two are distinguished by the start of the
    response in the first ticks, which the model describes. Where both explain the record about as well, neither is
    used.

    `volts` (V) are steps from rest, each held for some periods, and `z` (um, NaN where it was lost) the record of the
    same ticks, of which there are `sample_rate` in a second; it shows the first step after `onset` ticks, as
    `answer.onset` finds them. `noise` is the standard deviation of a tick, um: what no model can explain.

    >>> from truestroke.plant import PlantSettings, RealisticPlant
    >>> volts = 0.05 * np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], [400, 550, 450, 500, 650])
    >>> stage = RealisticPlant(PlantSettings(resonance=180.0))
    >>> found = resonance(volts, stage.exchange(volts), 2000.0, onset=0)
    >>> round(found.frequency)
    180
    """
    record = _Record(volts, z, sample_rate)
    none = record.fit(None, onset)
    if sample_rate < SLOWEST:
        return record.found(none, f"not sought at {sample_rate:g} Hz, only from {SLOWEST:g} Hz on", noise)
    fits = sorted(record.fits(onset), key=lambda fit: fit.left)
    best = fits[0] if fits and record.better(fits[0], none) else none
    hidden = f"no resonance is seen in small steps below {sample_rate / 2:g} Hz; `truestroke bode` finds weaker ones"
    reason = "" if best is not none else hidden
    if best is not none:
        others = [fit for fit in fits if not 0.95 < fit.frequency / best.frequency < 1.05]
        if best.frequency > 0.5 * sample_rate:
            reason = f"it seems to lie at {best.frequency:.4g} Hz, above half the sample rate of {sample_rate:g} Hz"
        elif candidates := [fit for fit in others if not record.better(best, fit)]:
            reason = (
                f"it is {best.frequency:.4g} or {candidates[0].frequency:.4g} Hz, the record does not distinguish them"
            )
    return record.found(best, reason, noise)


def step_means(ticks: int, sample_rate: float, model: tuple[float, float, float, float]) -> FloatArray:
    """Means over each tick (at `sample_rate`, Hz) of the answer to a step of 1 at tick 0.

    The model: frequency (Hz) and damping ratio of the stage, delay (ticks), corner of the lag (Hz).

    >>> step_means(4, 1000.0, (1e5, 0.7, 0.5, 1e5)).round(2).tolist()
    [0.5, 1.0, 1.0, 1.0]
    """
    frequency, damping, delay, corner = model
    w, p = 2 * np.pi * frequency, 2 * np.pi * corner
    pole = w * complex(-damping, np.sqrt(1 - damping**2))
    t = np.maximum(np.arange(ticks + 1) - delay, 0.0) / sample_rate
    # residues of the integral, by partial fractions
    stage = w**2 * p / (pole**2 * (pole - pole.conjugate()) * (pole + p))
    lag = w**2 / (p * abs(pole + p) ** 2)
    decay = np.exp(pole.real * t)  # real functions: one of complex numbers takes three times as long
    real, imaginary = decay * np.cos(pole.imag * t) - 1, decay * np.sin(pole.imag * t)
    integral = t + 2 * (stage.real * real - stage.imag * imaginary) + lag * np.expm1(-p * t)
    means: FloatArray = np.diff(integral) * sample_rate
    return means


@dataclass(frozen=True, eq=False)
class _Fit:
    """Parameters, the record by the model, the sum of squares of the residual (um^2), variance of log frequency.

    And the numbers that were fitted, from which a fit that has not converged goes on.
    """

    frequency: float
    damping: float
    delay: float
    gain: float
    model: FloatArray
    left: float
    variance: float
    numbers: FloatArray  # that were fitted
    converged: bool


class _Record:
    """The record, and the part of its model that is linear: gain, creep, offset, drift."""

    def __init__(self, volts: FloatArray, z: FloatArray, sample_rate: float) -> None:
        self.volts, self.rate, self.used = volts, sample_rate, np.isfinite(z)
        self.z = z[self.used]
        t = np.arange(volts.size) / sample_rate
        slow = [answer(volts, -np.expm1(-t / tau)) for tau in CREEP]
        self.slow = np.column_stack([np.ones(t.size), t / max(t[-1], 1.0 / sample_rate), *slow])
        self._basis = np.linalg.qr(self.slow[self.used])[0]
        self._rest = self._beyond(self.z)

    def _beyond(self, z: FloatArray) -> FloatArray:
        """Without what creep, offset and drift explain."""
        rest: FloatArray = z - self._basis @ (z @ self._basis)
        return rest

    def solve(self, model: tuple[float, float, float, float]) -> tuple[FloatArray, float]:
        """Residual of a model, um, and its gain, um/V."""
        fast = self._beyond(answer(self.volts, step_means(self.volts.size, self.rate, model))[self.used])
        gain = float(fast @ self._rest) / max(float(fast @ fast), 1e-300)
        return self._rest - gain * fast, gain

    def fits(self, onset: float) -> list[_Fit]:
        """Of each candidate; where another explains the record far better, it has not converged."""
        begun = [(f, self.fit(f, onset, FIRST)) for f in self.candidates(onset)]
        most = LOST * min((fit.left for _, fit in begun), default=0.0)
        return [
            fit if fit.converged or fit.left > most else self.fit(f, onset, EVALUATIONS - FIRST, fit.numbers)
            for f, fit in begun
        ]

    def fit(
        self, frequency: float | None, onset: float, evaluations: int = EVALUATIONS, start: FloatArray | None = None
    ) -> _Fit:
        """The best near a frequency, Hz, or of a stage without one; of so many evaluations, from these numbers on."""
        from scipy.optimize import least_squares

        rate, early = self.rate, 2.0 if frequency is None else 2.0 + 0.2 * self.rate / frequency
        bounds = [(onset - early, onset + 2.0), (np.log(0.01 * rate), np.log(10 * rate))]
        starts = [onset - 0.1 * (early - 2.0), np.log(0.25 * rate)]
        if frequency is not None:
            bounds += [(np.log(0.8 * frequency), np.log(1.25 * frequency)), (np.log(DAMPING[0]), np.log(DAMPING[1]))]
            starts += [np.log(frequency), np.log(0.02)]

        def model(p: npt.NDArray[Any]) -> tuple[float, float, float, float]:
            f, damping = (np.exp(p[2]), np.exp(p[3])) if frequency else (50 * rate, 0.7)
            return f, damping, p[0], np.exp(p[1])

        found = least_squares(
            lambda p: self.solve(model(p))[0],
            starts if start is None else start,
            bounds=tuple(np.array(bounds).T),
            x_scale=[0.3, 0.5, 0.02, 0.3][: len(starts)],
            max_nfev=evaluations,
        )
        f, damping, delay, _ = model(found.x)
        rest, gain = self.solve(model(found.x))
        z = np.full(self.used.size, np.nan)
        z[self.used] = self.z - rest
        left = 2 * float(found.cost)
        curvature = float(np.linalg.pinv(found.jac.T @ found.jac)[2, 2]) if frequency else 0.0
        variance, converged = curvature * left / self.z.size, found.status > 0
        return _Fit(float(f), float(damping), float(delay), gain, z, left, variance, found.x, converged)

    def candidates(self, onset: float) -> list[float]:
        """Frequencies of the ringing, Hz, and those that would look like them."""
        static = np.column_stack([answer(self.volts, np.ones(self.volts.size)), self.slow])
        shift = max(round(onset), 0)
        static = np.vstack([np.repeat(static[:1], shift, axis=0), static[: self.volts.size - shift]])
        rest = np.zeros(self.volts.size)
        rest[self.used] = self.z - static[self.used] @ np.linalg.lstsq(static[self.used], self.z, rcond=None)[0]
        edges = np.flatnonzero(np.diff(self.volts)) + 1
        starts = edges[np.diff(edges, prepend=-9) > 1] + shift
        length = int(np.diff([*starts, self.volts.size]).min())
        window = np.hanning(2 * length)[length:]
        parts = np.array([rest[k : k + length] for k in starts if k + length <= rest.size])
        parts -= parts.mean(axis=1, keepdims=True)
        power = (np.abs(np.fft.rfft(parts * window, 8 * length)) ** 2).sum(axis=0)
        frequencies = np.fft.rfftfreq(8 * length, 1 / self.rate)
        peaks = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
        peaks = peaks[frequencies[peaks] > 3 * self.rate / length]
        highest = peaks[np.argsort(power[peaks])[::-1][:PEAKS]]
        return [f for peak in highest for f in (float(frequencies[peak]), self.rate - float(frequencies[peak]))]

    def better(self, one: _Fit, other: _Fit) -> bool:
        """Whether `one` explains the record decisively better than `other`."""
        return other.left > one.left * (1 + max(SHARE, DECISIVE / self.z.size))

    def found(self, best: _Fit, reason: str, noise: float) -> Resonance:
        spread = float(np.hypot(np.sqrt(best.variance), SYSTEMATIC))
        unexplained = np.sqrt(max(best.left / self.z.size - noise**2, 0.0))
        if not reason and unexplained > max(MISFIT * self.z.std(), noise):
            reason = "the answer to small steps is not that of a single resonance"
        if not reason and spread > SURE:
            reason = f"the record gives {best.frequency:.4g} Hz only to {100 * spread:.0f} %"
        known, doubtful = not reason, bool(reason) and best.frequency < HIGH * self.rate
        return Resonance(
            frequency=best.frequency if known else None,
            uncertainty=spread * best.frequency if known else None,
            reason=reason,
            damping=best.damping,
            delay=best.delay,
            gain=best.gain,
            fit=best.model,
            doubtful=doubtful,
        )


def answer(volts: FloatArray, unit: FloatArray) -> FloatArray:
    """What `volts` make after rest at the first of them, `unit` being the answer to a step of 1 V.

    >>> answer(np.array([1.0, 1.0, 3.0, 3.0]), np.array([0.5, 1.0, 1.0, 1.0])).tolist()
    [0.0, 0.0, 1.0, 2.0]
    """
    z = np.zeros(volts.size)
    for k in np.flatnonzero(np.diff(volts)) + 1:
        z[k:] += (volts[k] - volts[k - 1]) * unit[: volts.size - k]
    return z
