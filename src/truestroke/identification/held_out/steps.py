"""Steps beside a fit: what each explains of a residual that the coefficients cannot make up for."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import normal

BLOCKS = 4000  # of rows at most, of which the means are looked at
SLOW = 6  # cosines beside the fit: a zero that walks is no jump
BEGIN, END, FEWEST = 0.12, 0.03, 16  # of the blocks, or so many: there states that are not known look alike
SHOWN = 4.0  # blocks that show as much of a step as all do beside the fit, at least
SUDDEN = 5.0  # times the mean change of the voltage from block to block: a step, at which the error may have one, too
MOST_SUDDEN = 100  # such steps: beside more a change is not known
BESIDE = -4, 16  # blocks before and behind these, and behind voltages that were not there before, which switch more
SMALL = 1e-9  # of the largest: columns that are sums of others


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means of the rows of a fit over blocks."""

    residual: FloatArray
    columns: FloatArray  # with one for each sudden step of the voltage
    pull: FloatArray
    possible: npt.NDArray[np.bool_]  # where a change is looked for
    each: int  # rows

    def means(self, rows: FloatArray) -> FloatArray:
        """Of others of the same rows."""
        return _means(rows, self.each)

    @functools.cached_property
    def fitted(self) -> FloatArray:
        """Orthonormal columns of all that is beside a step: the fit, as heavy as its prior leaves it, and cosines."""
        n = self.residual.size
        slow = np.cos(np.pi * (np.arange(n)[:, None] + 0.5) / n * np.arange(SLOW + 1))
        X = np.column_stack([slow, self.columns])
        above = np.zeros((X.shape[1], X.shape[1]))
        above[X.shape[1] - len(self.pull) :, X.shape[1] - len(self.pull) :] = self.pull
        R = normal.reduced(np.vstack([above, X]))
        return np.asarray(normal.triangular(R, X.T, transposed=True).T)


def blocks(residual: FloatArray, columns: FloatArray, pull: FloatArray, volts: FloatArray) -> Blocks | None:
    """None where a change cannot be known: of few rows, and of a staircase.

    Parameters
    ----------
    residual : ndarray, shape (rows,)
        Of the fit, um.
    columns : ndarray, shape (rows, m)
        Derivative of the prediction by each coefficient.
    pull : ndarray, shape (m, m)
        Rows of the prior, as heavy as in the fit.
    volts : ndarray, shape (rows,)
        Where they were measured.
    """
    each = -(-residual.size // BLOCKS)
    r, J, x = (_means(a, each) for a in (residual, columns, volts))
    count = r.size
    if count < 4 * FEWEST:
        return None
    changes = np.abs(np.diff(x, prepend=x[0]))
    sudden = np.flatnonzero(changes > SUDDEN * changes.mean())
    if sudden.size > MOST_SUDDEN:
        return None
    of_volts = np.arange(count)[:, None] >= sudden
    possible = np.zeros(count, np.bool_)
    possible[max(FEWEST, round(BEGIN * count)) : count - max(FEWEST, round(END * count))] = True
    low, high = np.minimum.accumulate(x), np.maximum.accumulate(x)
    new = np.flatnonzero((np.diff(low) < 0) | (np.diff(high) > 0)) + 1
    possible[np.clip(np.add.outer(np.append(sudden, new), np.arange(*BESIDE)), 0, count - 1)] = False
    return Blocks(r, np.column_stack([of_volts, J]), pull / np.sqrt(each), possible, each)


def _means(rows: FloatArray, each: int) -> FloatArray:
    count = rows.shape[0] // each
    return np.asarray(rows[: count * each].reshape(count, each, *rows.shape[1:]).mean(axis=1))


class Steps:
    """Steps that explain a residual, one after the other, each beside the fit and those before.

    A step is `shape` from some block on and 0 before: of ones for a zero that jumps, of the displacement for a gain.
    Where there is an `other` shape, it is beside a step of that at the same block. Cosines in time are beside all of
    them.
    """

    def __init__(self, of: Blocks, shape: FloatArray, other: FloatArray | None = None) -> None:
        r, self._W = of.residual, of.fitted
        self.residual = r - self._W @ (self._W.T @ r)
        self._shape, self._other = shape, other
        self._until = _from(self._W * shape[:, None])
        self._of_shape = _from(shape**2) - _square(self._until)
        if other is not None:
            self._others = _from(self._W * other[:, None])
            self._of_other = _from(other**2) - _square(self._others)
            self._of_both = _from(shape * other) - np.einsum("ij,ij->i", self._until, self._others)
        self._taken = list[FloatArray]()
        self._possible = of.possible
        self.square = float(np.mean(shape**2))
        self._least = SHOWN * self.square

    @property
    def _shown(self) -> FloatArray:
        """How much of the square of each step there is beside all else."""
        if self._other is None:
            return self._of_shape
        return np.asarray(self._of_shape - self._of_both**2 / np.maximum(self._of_other, SMALL * self._of_other.max()))

    @property
    def _explains(self) -> FloatArray:
        """What a step from each block on explains, um: of white noise its deviation is that of the noise."""
        shown, sums = self._shown, _from(self._shape * self.residual)
        if self._other is not None:
            share = self._of_both / np.maximum(self._of_other, SMALL * self._of_other.max())
            sums = sums - share * _from(self._other * self.residual)
        look = self._possible & (shown > self._least)
        return np.asarray(np.where(look, sums / np.sqrt(np.maximum(shown, self._least)), 0.0))

    @property
    def usual(self) -> float:
        """Deviation of what the steps explain, um, behind those that were taken."""
        explains = np.abs(self._explains[self._possible & (self._shown > self._least)])
        return 1.4826 * float(np.median(explains)) if explains.size else 0.0

    def next(self) -> tuple[float, float, int]:
        """The step that explains most: how much, its height, and the block from which on; it is then taken off."""
        explains = self._explains
        k = int(np.abs(explains).argmax())
        if explains[k] == 0.0:
            return 0.0, 0.0, k
        height = float(explains[k] / np.sqrt(self._shown[k]))
        if self._other is not None:
            self._take(self._other, self._others[k], k)
        self._take(self._shape, self._until[k], k)
        return abs(float(explains[k])), height, k

    def scatter(self, parts: int) -> float:
        """Deviation of what the last step explains, um, by how far parts of the record differ that show as much of it.

        An error that is not white, or that is not a step, has a larger one than the residual.
        """
        beside = self._taken[-1]
        until = np.cumsum(beside**2)
        of = np.minimum((parts * until / until[-1]).astype(np.intp), parts - 1)
        shown, sums = (np.bincount(of, a, parts) for a in (beside**2, beside * self.residual))
        each = sums**2 / np.maximum(shown, SMALL)
        return float(np.sqrt(each.sum() / (parts - 1)))

    def _take(self, shape: FloatArray, of_fit: FloatArray, k: int) -> None:
        """Takes a step off the residual, and off all other steps."""
        beside = -self._W @ of_fit
        beside[k:] += shape[k:]
        for before in self._taken:
            beside -= before * (before @ beside)
        beside /= np.linalg.norm(beside)
        self._taken.append(beside)
        self.residual = self.residual - beside * (beside @ self.residual)
        with_shape = _from(beside * self._shape)
        self._of_shape = self._of_shape - with_shape**2
        if self._other is not None:
            with_other = _from(beside * self._other)
            self._of_other = self._of_other - with_other**2
            self._of_both = self._of_both - with_shape * with_other


def _from(a: FloatArray) -> FloatArray:
    """Sums of all rows from each on."""
    return np.asarray(np.cumsum(a[::-1], axis=0)[::-1])


def _square(a: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, a))
