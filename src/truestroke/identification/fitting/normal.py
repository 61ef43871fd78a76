"""Regularised linear least squares on R factors, all partial slopes positive at every velocity of the record."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray

CHUNK = 512  # rows that are eliminated at a time: they stay in the processor's cache
BLOCK = 8  # columns, likewise


@dataclass(frozen=True, eq=False)
class Prior:
    """Mean and covariance of the coefficients before the record."""

    mean: FloatArray
    covariance: FloatArray

    def rows(self, weight: float) -> FloatArray:
        """Rows [A | t] that pull coefficients to the mean with `weight` times the precision."""
        return np.asarray(self._rows * np.sqrt(weight))

    @cached_property
    def _rows(self) -> FloatArray:
        root = np.linalg.inv(np.linalg.cholesky(self.covariance))
        return np.column_stack([root, root @ self.mean])

    def part(self, columns: FloatArray) -> Prior:
        """Of some of the coefficients."""
        return Prior(self.mean[columns], self.covariance[np.ix_(columns, columns)])


def as_slice(rows: npt.NDArray[np.bool_]) -> slice | npt.NDArray[np.bool_]:
    """The rows as a slice where they are all in a row, of which NumPy makes no copy; else as they are."""
    places = np.flatnonzero(rows)
    if not places.size or places[-1] - places[0] >= places.size:
        return rows
    return slice(int(places[0]), int(places[-1]) + 1)


def reduced(rows: FloatArray, above: FloatArray | None = None) -> FloatArray:
    """R of the QR decomposition: the same sums of squares in as many rows as there are columns.

    Of `above`, an R of other rows, and these where it is given: half the work of both as rows.
    """
    from scipy.linalg.lapack import dtpqrt

    columns = rows.shape[1]
    R = np.zeros((columns, columns), order="F") if above is None else np.array(above, order="F")
    for start in range(0, len(rows), CHUNK):
        R, *_ = dtpqrt(0, min(BLOCK, columns), R, rows[start : start + CHUNK], overwrite_a=1)
    return np.asarray(R)


def solve(
    rows: FloatArray,
    G: FloatArray | None = None,
    floor: float | FloatArray = 0.0,
    *,
    above: FloatArray | None = None,
) -> FloatArray:
    """Coefficients c that minimise the sum of squares of A c - t, rows = [A | t], subject to G c >= floor.

    The unconstrained solution is taken where it is admissible. Elsewhere it is a least distance problem, and so
    non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23). `above` is as
    `reduced` has it.
    """
    R = reduced(rows, above)
    m = R.shape[1] - 1
    R, t = np.asfortranarray(R[:m, :m]), R[:m, m]
    c = triangular(R, t)
    if G is None or np.all(G @ c >= floor):
        return np.asarray(c)
    from scipy.optimize import nnls

    H = triangular(R, G.T, transposed=True)  # A c - t = s, G c = H's + G c_free
    need = floor - G @ c
    E = np.vstack([H, need])
    u, _ = nnls(E, np.append(np.zeros(m), 1.0))
    residual = E @ u - np.append(np.zeros(m), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):  # none is admissible: nan, which no model takes
        return np.asarray(c + triangular(R, -residual[:m] / residual[m]))


def triangular(R: FloatArray, right: FloatArray, transposed: bool = False) -> FloatArray:
    """x of R x = right, or of R' x = right, for an upper triangle R."""
    from scipy.linalg.lapack import dtrtrs

    x, zero = dtrtrs(R, right, trans=int(transposed))
    if zero:
        raise np.linalg.LinAlgError(f"row {zero} of the triangle is 0")
    return np.asarray(x)


def sum_of_squares(rows: FloatArray, c: FloatArray) -> float:
    """Of A c - t, rows = [A | t]."""
    e = rows[:, :-1] @ c - rows[:, -1]
    return float(e @ e)
