"""A voltage without the noise of its own measurement, which the actuator does not see."""

import itertools
import math

import numpy as np

from truestroke import _kernel
from truestroke.base.typing import FloatArray
from truestroke.signals.noise import noise

LEAST, MOST = 1e-4, 0.02  # of the span: noise that does no harm, and that is motion
HALVES = 2, 4, 8, 16, 32, 64  # samples on each side, to which a parabola is fitted
CLEAR = 3.0  # deviations by which a wider window contradicts a narrower one: there it would round a corner
FOLLOWED = 0.3  # of the gain: where the displacement follows the residual by so much, it is motion
LATE = 3  # samples by which it may do so
PAST, LAGS = 12, 16  # samples of the displacement and of the voltage, by which the next displacement is predicted
HELPS = 0.975  # of its error without what is taken off: with that it must be below
RIDGE = 1e-9  # of the mean square of a column
OUTLIER = 4.0  # deviations of that error: steps count as much
FEWEST, ROWS = 500, 20_000  # for that


def noise_of(x: FloatArray, span: float, deviation: float | None = None) -> float:
    """Standard deviation of white noise of 1e-4 to 0.02 of a span in the voltage x, V; 0 where it is less or more.

    `deviation` is that of all its noise, V, where the caller knows it already.

    Examples
    --------
    >>> x = 50 - 50 * np.cos(np.arange(2000) / 100.0)
    >>> round(noise_of(x + 0.2 * np.random.default_rng(0).standard_normal(2000), 100.0), 1), noise_of(x, 100.0)
    (0.2, 0.0)
    """
    deviation = noise(x, (slice(0, x.size),)) if deviation is None else deviation
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
    if deviation == 0.0:
        return 0.0
    gain = abs(float((x - x.mean()) @ (z - z.mean()))) / float(np.sum((x - x.mean()) ** 2))
    return 0.0 if _is_followed(x, z, deviation, gain) or _shakes(x, z, deviation) else deviation


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


def without_reversals(x: FloatArray, least: float) -> FloatArray:
    """The voltage x, V, with reversals of `least` and more only: hysteresis sees what the others add up to.

    Examples
    --------
    >>> without_reversals(np.array([0.0, 1.0, 0.9, 2.0, 0.0]), 0.5).tolist()
    [0.0, 0.95, 0.95, 2.0, 0.0]
    """
    if not least > 0 or x.size < 2:
        return x
    followed = np.empty((x.size, 1))
    _kernel.play_history(np.ascontiguousarray(x), np.array([least / 2]), x[:1].copy(), 1, followed)
    steps = np.diff(followed[:, 0])
    moves = np.flatnonzero(steps)
    turns = moves[:-1][steps[moves[:-1]] * steps[moves[1:]] < 0] + 1
    way, made = 1.0 if not moves.size or steps[moves[0]] > 0 else -1.0, x.copy()
    for first, last in itertools.pairwise([0, *turns.tolist(), x.size - 1]):
        part = way * x[first : last + 1]
        lowest, highest = np.minimum.accumulate(part[::-1])[::-1], np.maximum.accumulate(part)
        made[first : last + 1] = way * (lowest + highest) / 2
        way = -way
    return made


def _is_followed(x: FloatArray, z: FloatArray, deviation: float, gain: float) -> bool:
    """Whether the displacement moves with the residual of the narrowest parabolas in the voltage, steps aside."""
    from scipy.signal import savgol_filter

    rest, moved = (a - savgol_filter(a, 2 * HALVES[0] + 1, 2) for a in (x, z))
    most = CLEAR * deviation
    rest, moved = np.where(np.abs(rest) < most, rest, 0.0), np.clip(moved, -2 * gain * most, 2 * gain * most)
    shares = (float(rest[: rest.size - k] @ moved[k:]) / float(rest @ rest) for k in range(LATE + 1))
    return max(abs(share) for share in shares) > FOLLOWED * gain


def _shakes(x: FloatArray, z: FloatArray, deviation: float) -> bool:
    """Whether what would be taken off shakes the stage: it helps to predict z beside the past of z and the rest of x.

    A resonance below the fastest parts of the voltage, or a lag, follows none of these.
    """
    x, z, past = x[:ROWS], z[:ROWS] - z[:ROWS].mean(), PAST + LAGS
    if x.size < FEWEST:
        return False
    quiet = without_noise(x, deviation)
    before = [(z, range(1, PAST + 1)), (quiet - quiet.mean(), range(LAGS)), (x - quiet, range(LAGS))]
    columns = np.column_stack([signal[past - k : x.size - k] for signal, lags in before for k in lags])
    columns /= np.maximum(columns.std(axis=0), 1e-300)
    without, beside = (_ahead(columns[:, :count], z[past:]) for count in (PAST + LAGS, PAST + 2 * LAGS))
    cap = OUTLIER * float(np.median(without)) / 0.6745
    squares = [float(np.sum(np.minimum(error, cap) ** 2)) for error in (without, beside)]
    return squares[1] < HELPS**2 * squares[0]


def _ahead(columns: FloatArray, target: FloatArray) -> FloatArray:
    """Magnitude of the errors of each half, predicted by the columns as fitted to the other half."""
    half = len(target) // 2
    parts, errors = (slice(0, half), slice(half, None)), []
    for test, fit in (parts, parts[::-1]):
        G = columns[fit].T @ columns[fit]
        weights = np.linalg.solve(G + RIDGE * np.trace(G) / len(G) * np.eye(len(G)), columns[fit].T @ target[fit])
        errors.append(np.abs(target[test] - columns[test] @ weights))
    return np.concatenate(errors)
