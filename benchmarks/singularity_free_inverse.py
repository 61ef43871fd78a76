"""The inverse where partial slopes are zero or negative: the singularity-free form of Tan, Latt and Ang (2006).

The inverse (10) divides by the partial sums s_i of the weights. Where one is zero it is singular; where one is
negative, output falls while input rises. The cure is a mapping: y' = y + c x has the partial sums s_i + c, all positive
if c is large enough, and so it has an inverse Gamma'^-1 by (10). What is sought in y is found in y'::

    x = Gamma'^-1[y_d + c x]

Source: [23] of the paper; its text was not at hand. This is a reconstruction from its title, from what Sec. 6 says of
it, and from first principles (docs/decisions/0021-singularity-free-inverse.md).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.model.operators import dot


def mapped_weights(w_h: npt.ArrayLike, slope_min: float) -> tuple[FloatArray, float]:
    """Weights of the mapped plays y' = y + c x, with the least c that makes them invertible by (10).

    Parameters
    ----------
    w_h : array_like, shape (n,)
        Weights, um/V, with partial sums of any sign.
    slope_min : float
        Smallest partial sum after the mapping, um/V, above 0.

    Returns
    -------
    w_h : ndarray, shape (n,)
        [w_0 + c, w_1, ...], um/V: every partial sum is `slope_min` or more.
    c : float
        Slope of the mapping, um/V, 0 or more; 0 where nothing has to be mapped.

    Raises
    ------
    SettingError
        `slope_min` is not above 0, or a weight is not finite.

    Examples
    --------
    >>> mapped_weights([-1.0, 4.0, 5.0], slope_min=0.5)
    (array([0.5, 4. , 5. ]), 1.5)
    """
    w = checks.finite_array("w_h", w_h, "um/V").copy()
    c = max(0.0, checks.positive("slope_min", slope_min, "um/V") - float(np.cumsum(w).min()))
    w[0] += c
    return w, c


def singularity_free_inverse(
    y_d: float,
    w_h: npt.ArrayLike,
    r: npt.ArrayLike,
    y: npt.ArrayLike,
    voltage_limits: tuple[float, float] = (-math.inf, math.inf),
) -> float:
    """The input that brings the plays to y_d, whatever the signs of their partial slopes, in O(n).

    It solves x = Gamma'^-1[y_d + c x]. Repeated from the last input, that equation climbs without overshoot to the
    first solution on the side where the mapped plays point: above the last input if y_d is above the last output,
    below it otherwise. The walk over the breakpoints finds that solution at once, and c drops out. Where all slopes are
    positive it is the solution of (12), the only one.

    Without limits a solution exists on that side whenever the sum of all weights is positive. If the limits cut it
    off, the other side is tried, and then the input within the limits that comes closest to y_d is returned.
    Where a slope is negative, the input *must* jump somewhere: no continuous inverse exists.

    Parameters
    ----------
    y_d : float
        Desired output of the plays, um.
    w_h : array_like, shape (n,)
        Weights, um/V, with partial sums of any sign.
    r, y : array_like, shape (n,)
        Thresholds, V, and states that the last tick left, V; the state of the first play is the last input.
    voltage_limits : tuple[float, float]
        Lowest and highest input, V, around the last input.

    Returns
    -------
    float
        x, V, within `voltage_limits`.

    Examples
    --------
    The first slope is negative. A rise of 1 um is found beyond the corner at 1 V, where the slope is 3 um/V:

    >>> round(singularity_free_inverse(1.0, [-1.0, 4.0], [0.0, 1.0], [0.0, 0.0]), 6)
    1.666667

    With 1.5 V at the most it is found on the other side:

    >>> singularity_free_inverse(1.0, [-1.0, 4.0], [0.0, 1.0], [0.0, 0.0], (-1.5, 1.5))
    -1.0
    """
    weights, thresholds, states = (np.asarray(value, dtype=np.float64) for value in (w_h, r, y))
    branches = np.cumsum(weights).tolist(), thresholds.tolist(), states.tolist()
    gap = float(y_d - dot(weights, states))
    if gap == 0:
        return float(states[0])
    ahead, behind = sorted(voltage_limits, reverse=gap > 0)
    x, missing = _walk(gap, ahead, *branches)
    if missing == 0:
        return x
    back, missing_back = _walk(gap, behind, *branches)
    return back if missing_back < missing else x


def _walk(gap: float, end: float, slopes: list[float], r: list[float], y: list[float]) -> tuple[float, float]:
    """From the last input to `end`: the first input that closes the gap, or the closest one, and what it misses, um."""
    x, sign = y[0], math.copysign(1.0, end - y[0])
    closest, missing = x, abs(gap)
    corners = [state + sign * threshold for state, threshold in zip(y[1:], r[1:], strict=True)]
    for slope, corner in zip(slopes, [*corners, end], strict=True):
        stop = min(corner, end) if sign > 0 else max(corner, end)
        beyond = gap - slope * (stop - x)
        if gap > 0 >= beyond or gap < 0 <= beyond:  # so slope is not 0
            x += gap / slope
            return (min(x, stop) if sign > 0 else max(x, stop)), 0.0
        if abs(beyond) < missing:
            closest, missing = stop, abs(beyond)
        gap, x = beyond, stop
    return closest, missing
