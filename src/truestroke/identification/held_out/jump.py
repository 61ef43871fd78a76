"""Whether the zero jumped within a record: the residual of the fit has another mean from some row on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray

FEWEST = 16  # rows on either side, whose means are compared; twice as many, and so on, up to a stroke
LONGEST = 0.1  # of the rows: no longer, so that there are other places to compare with
MIDDLE = 0.1, 0.9  # of the rows: before and after, states that are not known look alike
CLEAR = 6.5  # deviations of such differences at all places
ALONE = 1.15  # times the largest difference elsewhere
STAYS = 0.6  # of it is still there in the means of two strokes on either side
REMAINS = 0.15  # of it, in the means of all rows on both sides: creep of the fit takes most; by a model's error 0.09


class Jump(NamedTuple):
    """By how much the residual is higher from a row on, um."""

    size: float
    row: int


def jump(residual: FloatArray, stroke: float) -> Jump | None:
    """The one jump of a residual, um, shape (rows,), if there is one; a stroke takes so many rows.

    The error of a model comes and goes within strokes, in many of them. A jump is one, of a few rows, and stays. So
    the means of a few rows and of more, on both sides of each place, are compared with those at all other places.

    Examples
    --------
    >>> noise = np.random.Generator(np.random.PCG64(0)).standard_normal(4000)
    >>> jump(noise, 100.0), jump(noise + 2.0 * (np.arange(4000) > 1700), 100.0).row
    (None, 1701)
    """
    n = residual.size
    stroke, sums = min(stroke, n), np.concatenate([[0.0], np.cumsum(residual)])

    def steps(at: npt.NDArray[np.intp], width: int) -> FloatArray:
        return np.asarray((sums[at + width] - 2 * sums[at] + sums[at - width]) / width)

    found, width = [], FEWEST
    while width <= min(stroke, LONGEST * n):
        at = np.arange(round(MIDDLE[0] * n), round(MIDDLE[1] * n))
        d = steps(at, width)
        k = int(np.abs(d).argmax())
        size, elsewhere = abs(float(d[k])), float(np.abs(d[np.abs(at - at[k]) > 2 * width]).max())
        both = min(2 * max(int(stroke), width), at[k], n - at[k])
        stays = float(steps(at[k], both) / d[k]) if size else 0.0
        remains = (sums[n] - sums[at[k]]) / (n - at[k]) - sums[at[k]] / at[k]
        deviation = 1.4826 * float(np.median(np.abs(d)))
        clear = size > CLEAR * deviation and size > ALONE * elsewhere
        if clear and stays > STAYS and remains / d[k] > REMAINS:
            found.append((size / elsewhere if elsewhere > 0 else math.inf, Jump(stays * float(d[k]), int(at[k]))))
        width *= 2
    return max(found)[1] if found else None
