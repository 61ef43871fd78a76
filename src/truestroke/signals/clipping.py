"""Rows of a signal that stay at the end of its range, while what moves it goes on."""

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray

FLAT = 4  # equal values at an extreme that are no accident


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
        at = np.flatnonzero(signal == extreme)
        for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            entered = abs(signal[run[0]] - signal[max(run[0] - 1, 0)])
            if run.size >= FLAT and entered < 0.1 * np.ptp(signal) and np.ptp(other[run]) > moves:
                rows[run] = True
    return rows
