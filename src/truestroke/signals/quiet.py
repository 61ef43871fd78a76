"""A voltage without the noise of its own measurement, which the actuator does not see."""

import math

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.signals.noise import noise

LEAST, MOST = 1e-4, 0.02  # of the span: noise that does no harm, and that is motion
HALVES = 2, 4, 8, 16, 32, 64  # samples on each side, to which a parabola is fitted
CLEAR = 3.0  # deviations by which a wider window contradicts a narrower one: there it would round a corner
FOLLOWED = 0.3  # of the gain: where the displacement follows the residual by so much, it is motion
LATE = 3  # samples by which it may do so


def noise_of(x: FloatArray, span: float) -> float:
    """Standard deviation of white noise of 1e-4 to 0.02 of a span in the voltage x, V; 0 where it is less or more.

    Examples
    --------
    >>> x = 50 - 50 * np.cos(np.arange(2000) / 100.0)
    >>> round(noise_of(x + 0.2 * np.random.default_rng(0).standard_normal(2000), 100.0), 1), noise_of(x, 100.0)
    (0.2, 0.0)
    """
    deviation = noise(x, (slice(0, x.size),))
    if deviation == 0.0 or float(np.median(np.abs(np.diff(x, 2)))) < LEAST * deviation:  # a staircase: steps, no noise
        return 0.0
    return deviation if LEAST * span < deviation < MOST * span else 0.0


def noise_not_followed(x: FloatArray, z: FloatArray) -> float:
    """The same of a voltage x whose noise the displacement z does not follow: that of its measurement, V.

    Examples
    --------
    >>> x = 50 - 50 * np.cos(np.arange(2000) / 100.0)
    >>> measured = x + 0.2 * np.random.default_rng(0).standard_normal(2000)
    >>> round(noise_not_followed(measured, x), 1), noise_not_followed(measured, measured)
    (0.2, 0.0)
    """
    deviation = noise_of(x, float(np.ptp(x)))
    return 0.0 if deviation == 0.0 or _is_followed(x, z, deviation) else deviation


def without_noise(x: FloatArray, deviation: float) -> FloatArray:
    """The voltage x without white noise of a standard deviation, V; x itself where that is 0.

    In each sample the parabola over the widest window that agrees with all narrower ones (Lepski 1991): steps and
    corners stay as they are.

    Examples
    --------
    >>> true = np.where(np.arange(2000) < 1000, 10.0, 90.0) + 5 * np.sin(np.arange(2000) / 100.0)
    >>> measured = true + 0.2 * np.random.default_rng(0).standard_normal(2000)
    >>> [round(float(np.std(v - true)), 2) for v in (measured, without_noise(measured, 0.2))]
    [0.2, 0.04]
    """
    if deviation == 0.0:
        return x
    from scipy.signal import savgol_coeffs, savgol_filter

    quiet, agrees, narrower = x.copy(), np.ones(x.size, dtype=np.bool_), [(x, 1.0)]
    for half in (half for half in HALVES if half < x.size // 16):
        width = 2 * half + 1
        wide = savgol_filter(x, width, 2)
        for values, share in narrower:
            agrees &= np.abs(wide - values) <= CLEAR * deviation * share
        quiet[agrees] = wide[agrees]
        narrower.append((wide, math.sqrt(float(savgol_coeffs(width, 2)[half]))))
    return quiet


def _is_followed(x: FloatArray, z: FloatArray, deviation: float) -> bool:
    """Whether the displacement moves with the residual of the narrowest parabolas in the voltage, steps aside."""
    from scipy.signal import savgol_filter

    gain = float((x - x.mean()) @ (z - z.mean())) / float(np.sum((x - x.mean()) ** 2))
    rest, moved = (a - savgol_filter(a, 2 * HALVES[0] + 1, 2) for a in (x, z))
    most = CLEAR * deviation
    rest, moved = np.where(np.abs(rest) < most, rest, 0.0), np.clip(moved, -2 * abs(gain) * most, 2 * abs(gain) * most)
    shares = (float(rest[: rest.size - k] @ moved[k:]) / float(rest @ rest) for k in range(LATE + 1))
    return max(abs(share) for share in shares) > FOLLOWED * abs(gain)
