"""The next pass of a motion of any kind, from the passes so far, in the frequency domain.

Each pass is described by y, what a model of hysteresis and stage predicts of its voltage, and by z, what was measured.
At each frequency f of the whole pass::

    Y(f) <- Y(f) + s(f) w(f) E(f) / R(f),    E = D - Z

with the voltage that the model inverts from y, and with s, w and R of `harmonics`: R is the ratio of the true
response to that of the model. What the model knows of hysteresis is inverted by it; what it does not know is learned.
A pass has one period here, so that R, E and their noise are means over neighbouring frequencies.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.repeating import harmonics, iterative, response_prior
from truestroke.model.dynamics import Dynamics

APART = 1.2  # times the samples of a pass, at least: time for the way back to its first sample
UNKNOWN = 0.01  # of the sample rate: without dynamics the response is known to there; R is less sure with f^4
NEIGHBOURS = 1.5  # frequencies: standard deviation of the window over what is known of R
ERRORS = 4.0  # the same over the power of the error
NOISY = 1.5  # times the noise: power of an error that is not learned
SLOW = 0.1  # of the rms of the motion: a step of so much, such as creep or plays that begin elsewhere, is no response
LOST = 0.25  # of the response of the model: where the stage follows less, it is not learned


@dataclass(frozen=True, eq=False)
class Next:
    """What the next pass should be.

    Attributes
    ----------
    change : ndarray, shape (samples,)
        By how much the model has to predict more of its voltage than of that of the best pass, um.
    expected : float
        Its rmse, noise included, um.
    """

    change: FloatArray
    expected: float


def following(
    passes: list[tuple[FloatArray, FloatArray]],
    desired: FloatArray,
    sample_rate: float,
    *,
    best: int,
    step: float = 1.0,
    dynamics: Dynamics | None = None,
) -> Next:
    """The pass after these.

    Parameters
    ----------
    passes : list of (ndarray, ndarray), each of shape (samples,)
        Predicted by the model and measured, um, the last one last.
    desired : ndarray, shape (samples,)
        um
    sample_rate : float
        Hz
    best : int
        On which of them it builds.
    step : float
        Share of the whole correction, above 0 and at most 1: after a pass that was worse it is smaller.
    dynamics : Dynamics, optional
        Those of the model, with this sample rate.

    Examples
    --------
    A stage that does four fifths of what the model predicts: the next pass has to be nearly a quarter wider.

    >>> d = 5 - 5 * np.cos(np.arange(2000) * 2 * np.pi / 500)
    >>> made = following([(d, 0.8 * d)], d, 1000.0, best=0)
    >>> print(f"{np.ptp(made.change) / np.ptp(d):.2f}")
    0.24
    """
    size = 2 ** math.ceil(math.log2(APART * desired.size))
    f = np.asarray(np.fft.rfftfreq(size, 1 / sample_rate), dtype=np.float64)
    zero = float(desired.mean())
    D = _spectrum(desired - zero, size)
    spectra = [(_spectrum(y - zero, size), _spectrum(z - zero, size)) for y, z in passes]
    Y, Z = spectra[best]
    seen = iterative.SEEN * sample_rate
    high = iterative.band(dynamics, sample_rate)
    beyond = f > max(high, 0.9 * seen) if high < seen else f > seen
    noise2 = float(np.median(np.abs(Z - Y)[beyond] ** 2)) / math.log(2)
    swings = [(_spectrum(y - y.mean(), size), _spectrum(z - z.mean(), size)) for y, z in passes]
    R, variance = _ratio(swings, D, f, noise2, _variance(dynamics, f, sample_rate))
    E, R2 = D - Z, np.abs(R) ** 2
    power = _mean(np.abs(E) ** 2, ERRORS)
    w = np.maximum(power - NOISY * noise2, 0.0) / np.maximum(power, 1e-300)
    s = np.where((f <= high) & (R2 > LOST**2), step * w * R2 / (R2 + variance), 0.0)
    change = np.fft.irfft(s * np.conj(R) / np.maximum(R2, 1e-300) * E, size)[: desired.size]
    left = np.abs(E) ** 2 * ((1 - s) ** 2 + s**2 * variance / np.maximum(R2, 1e-300))
    expected = math.sqrt(float(2 * left.sum() - left[0]) / size / desired.size)
    return Next(change, expected)


def _spectrum(x: FloatArray, size: int) -> ComplexArray:
    """Of a pass that goes back to its first sample smoothly."""
    u = np.linspace(0.0, 1.0, size - x.size + 1)[1:]
    back = x[0] + (x[-1] - x[0]) * (1 - u**3 * (10.0 + u * (6.0 * u - 15.0)))
    return np.fft.rfft(np.concatenate([x, back]))


def _mean(x: FloatArray, width: float = NEIGHBOURS) -> FloatArray:
    """Over neighbouring frequencies."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(x, width, mode="nearest"))


def _variance(dynamics: Dynamics | None, f: FloatArray, sample_rate: float) -> FloatArray:
    """Of R, from what is known before the first pass."""
    known = iterative.response_of(dynamics, f, sample_rate, 1.0)[2]
    if dynamics is not None:
        return known
    return np.asarray(np.minimum(known + (f / (UNKNOWN * sample_rate)) ** 4, response_prior.UNSURE))


def _ratio(
    spectra: list[tuple[ComplexArray, ComplexArray]],
    D: ComplexArray,
    f: FloatArray,
    noise2: float,
    variance: FloatArray,
) -> tuple[ComplexArray, FloatArray]:
    """R and its variance, from the first pass and from what each change made, each without its mean: a zero is no gain.

    What hysteresis moves from one frequency to others counts as noise: a tenth of the amplitude, falling with the
    multiple h of the motion's mean frequency, and where the motion itself has its power. So does a step of a tenth of
    the amplitude, whose spectrum falls with f: where the motion has little power at low frequencies, creep and the
    state that a pass begins in are most of what is seen there.
    """
    power = np.abs(D) ** 2
    mean = math.sqrt(float(np.sum(f**2 * power) / np.sum(power)))
    h = np.maximum(f / mean, 1.0)
    cell = np.floor(h - 0.5).astype(np.int64)
    shape = _mean(np.abs(spectra[-1][0]) ** 2)
    shape = shape / np.maximum(np.bincount(cell, shape)[cell], 1e-300) / h ** (2 * harmonics.POWER)
    turns = np.pi * np.maximum(np.arange(f.size), 0.5) / (2 * (f.size - 1))  # half of those in a sample; of 0, less
    step = 0.5 / (np.sin(turns) * 2 * (f.size - 1)) ** 2  # of the square of the motion's spectrum, of an equal rms
    changes = [(*spectra[0], 1.0)]
    changes += [(b[0] - a[0], b[1] - a[1], 2.0) for a, b in itertools.pairwise(spectra)]
    information = 1 / variance
    weighted = information.astype(np.complex128)
    for age, (x, y, times) in enumerate(reversed(changes)):
        crossed = (harmonics.CROSSED**2 * shape + SLOW**2 * step) * np.sum(np.abs(x[1:]) ** 2)
        scatter = times * noise2 + crossed + harmonics.LITTLE * power.sum()
        product = np.conj(x) * y / scatter
        kept = harmonics.KEPT ** max(age - (age == len(changes) - 1), 0)
        weighted = weighted + kept * (_mean(product.real) + 1j * _mean(product.imag))
        information = information + kept * _mean(np.abs(x) ** 2 / scatter)
    return weighted / information, 1 / information
