"""Rows of a signal that stay at the end of its range, while what moves it goes on."""

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray

FLAT = 4  # equal values at an extreme that are no accident
AHEAD = 2.0  # times the desired motion: a voltage that goes so much further has no answer


def clipped(signal: FloatArray, other: FloatArray, moves: float) -> npt.NDArray[np.bool_]:
    """Rows in runs at an extreme value of `signal` in which `other` moves by more than `moves`, shape (samples,).

    A run that `other` does not cross is a hold. A run that `signal` enters by a jump is a step, after which a
    displacement still settles.

    Examples
    --------
    >>> wave = np.sin(np.linspace(0.0, 6.0, 200))
    >>> int(clipped(np.minimum(wave, 0.8), wave, 0.1).sum()), int(clipped(wave, wave, 0.1).sum())
    (43, 0)
    """
    rows = np.zeros(signal.size, dtype=np.bool_)
    for extreme in (signal.min(), signal.max()):
        for first, end in runs(signal == extreme):
            entered = abs(signal[first] - signal[max(first - 1, 0)])
            if end - first >= FLAT and entered < 0.1 * np.ptp(signal) and np.ptp(other[first:end]) > moves:
                rows[first:end] = True
    return rows


def at_an_end(
    measured: FloatArray, volts: FloatArray, desired: FloatArray, band: float, moves: float
) -> tuple[npt.NDArray[np.bool_], bool]:
    """Rows in which a sensor is at an end of its range in a closed loop, and whether its run begins there.

    Measured values stand in the outermost `band`, um, while the voltage goes further out and comes back by more than
    `moves`, um, of its usual motion; or, in the first rows, goes away from that end by that much, and by more than
    AHEAD times the desired motion: a sensor that is late stands still, too, but while the motion begins.

    Parameters
    ----------
    measured, volts, desired : ndarray, shape (samples,)
        um, V, um; finite.
    band, moves : float
        Width of what counts as one value, and least motion of the voltage, um; `band` is the smaller by far.

    Returns
    -------
    rows : ndarray, shape (samples,)
    begins : bool
        A controller takes that end for the zero then.

    Examples
    --------
    >>> wave = 10.0 - 10.0 * np.cos(np.linspace(0.0, 25.0, 2000))
    >>> rows, begins = at_an_end(np.minimum(wave, 15.0), wave / 10.0, wave, 0.01, 0.6)
    >>> round(float(rows.mean()), 2), begins, bool(at_an_end(wave, wave / 10.0, wave, 0.01, 0.6)[0].any())
    (0.34, False, False)
    """
    rows, begins = np.zeros(measured.size, dtype=np.bool_), False
    if not np.std(volts) or np.ptp(measured) < 2 * band:
        return rows, begins
    outward = volts * (np.std(measured) / np.std(volts))
    for sign in (-1.0, 1.0):
        z, u = sign * measured, sign * outward
        for first, end in runs(z >= z.max() - band):
            inside = u[first:end]
            if np.count_nonzero(inside > max(inside[0], inside[-1]) + moves) >= FLAT:
                rows[first:end] = True
            elif not first:
                asked = float(np.max(np.abs(desired[:end] - measured[0])))
                begins = bool(np.count_nonzero(inside < inside[0] - moves - AHEAD * asked) >= FLAT)
                rows[:end] = begins
    return rows, begins


def runs(flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """First row and end of each run of True, shape (runs, 2).

    >>> runs(np.array([True, True, False, True])).tolist()
    [[0, 2], [3, 4]]
    """
    return np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]]).astype(np.int8))).reshape(-1, 2)
