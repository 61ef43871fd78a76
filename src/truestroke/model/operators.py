"""The two operators that everything is built from: play (1), (2) and one-sided dead zone (4)."""

from __future__ import annotations

from collections.abc import Iterable
from operator import add

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray


def play(x: float, r: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
    """Play operators after one more sample: the slack of a gear train, one for each threshold.

    ::

        y(t) = H_r[x, y0](t) = max{x(t) - r, min{x(t) + r, y(t - T)}}      (1)

    The first sample is the same formula with y0 in place of y(t - T), which is (2).

    Parameters
    ----------
    x : float
        Input of this tick, V.
    r : array_like, shape (n,)
        Thresholds, V, 0 or more.
    y : array_like, shape (n,)
        States after the last tick, V; y0 at the first tick.

    Returns
    -------
    ndarray, shape (n,)
        States after this tick, V.

    Examples
    --------
    >>> play(1.0, [0.0, 0.25, 0.5], [0.0, 0.0, 0.0])
    array([1.  , 0.75, 0.5 ])
    """
    r = np.asarray(r, dtype=np.float64)
    states: FloatArray = np.maximum(x - r, np.minimum(x + r, y))
    return states


def play_history(x: npt.ArrayLike, r: npt.ArrayLike, y0: npt.ArrayLike | None = None) -> FloatArray:
    """Play operators (1), (2) along a whole record.

    Parameters
    ----------
    x : array_like, shape (ticks,)
        Input, V.
    r : array_like, shape (n,)
        Thresholds, V, 0 or more.
    y0 : array_like, shape (n,), optional
        States before the first tick, V; 0 by default.

    Returns
    -------
    ndarray, shape (ticks, n)
        States after each tick, V.

    Examples
    --------
    Up to 2 V and back to 1 V; the second play follows only when its slack is taken up:

    >>> play_history([2.0, 1.0], [0.0, 0.75])
    array([[2.  , 1.25],
           [1.  , 1.25]])
    """
    x, r = np.asarray(x, dtype=np.float64), np.asarray(r, dtype=np.float64)
    states = np.empty((x.size, r.size))
    y = np.zeros(r.size) if y0 is None else np.asarray(y0, dtype=np.float64)
    for state, least, most in zip(states, x[:, np.newaxis] - r, x[:, np.newaxis] + r, strict=True):
        y = np.maximum(least, np.minimum(most, y, out=state), out=state)  # (1): `play` of a tick, for half
    return states


def dead_zone(y: npt.ArrayLike, d: npt.ArrayLike) -> FloatArray:
    """One-sided dead zones, which make the loop asymmetric.

    ::

        S_d[y] = max{y - d, 0}  for d > 0,   y  for d = 0                  (4)

    Parameters
    ----------
    y : array_like, shape (...)
        Input, um.
    d : array_like, shape (m,)
        Thresholds, um, 0 or more.

    Returns
    -------
    ndarray, shape (..., m)
        Output of each dead zone, um.

    Examples
    --------
    >>> dead_zone([-3.0, 15.0], [0.0, 12.0, 20.0])
    array([[-3.,  0.,  0.],
           [15.,  3.,  0.]])
    """
    if isinstance(y, float):  # of one tick: the same bits without arrays between
        return np.array([max(y - zone, 0.0) if zone > 0 else y for zone in np.asarray(d, dtype=np.float64).tolist()])
    y, d = np.asarray(y, dtype=np.float64)[..., np.newaxis], np.asarray(d, dtype=np.float64)
    return np.where(d > 0, np.maximum(y - d, 0.0), y)


LANES = 8
"""Interleaved sums in which all sums of products run: TS_LANES of the kernel."""
REST = [[0.0] * (-n % LANES) for n in range(LANES)]  # behind n values of the last of the sums
FEW = 5  # blocks of so many lanes, of which plain floats have the sum sooner than arrays


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Sum of products over the last axis, in the order of the C kernel: eight interleaved sums, then their total.

    ``a @ b`` sums in an order of its own, and adaptation makes rounding visible after some thousand ticks. With `dot`
    the kernel and the NumPy text agree to the last bit, with vectors of any width.

    Parameters
    ----------
    a : ndarray, shape (..., n)
        Weights or states.
    b : ndarray, shape (..., n)
        The other factor.

    Returns
    -------
    ndarray, shape (...)
        a . b

    Examples
    --------
    >>> dot(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([10.0, 1.0]))
    array([12., 34.])
    """
    products = a * b
    if products.ndim == 1 and products.size <= FEW * LANES:  # plain floats have the same sums in half the time
        values: list[float] = products.tolist()
        values += REST[len(values) % LANES] if values else REST[0] + [0.0] * LANES
        sums: Iterable[float] = values[:LANES]
        for k in range(LANES, len(values), LANES):
            sums = map(add, sums, values[k : k + LANES])
        return _total(sums)
    *outer, n = products.shape
    blocks = max(1, -(-n // LANES))
    padded = np.zeros((*outer, blocks * LANES))
    padded[..., :n] = products
    lanes: FloatArray = np.add.reduce(padded.reshape(*outer, blocks, LANES), axis=-2)  # row by row
    if not outer:
        return _total(lanes.tolist())
    for half in (4, 2, 1):
        lanes = lanes[..., :half] + lanes[..., half:]
    return lanes[..., 0]


def _total(lanes: Iterable[float]) -> FloatArray:
    a0, a1, a2, a3, a4, a5, a6, a7 = lanes
    return np.float64(((a0 + a4) + (a2 + a6)) + ((a1 + a5) + (a3 + a7)))  # type: ignore[return-value]
