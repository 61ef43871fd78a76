"""Whether the zero jumped within a record: steps beside the fit that explain its residual, one or two."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import normal

BLOCKS = 4000  # of rows at most, of which the means are looked at
SLOW = 6  # cosines beside the fit: a zero that walks is no jump
TRIED = 4  # steps, one after the other: one or two of them are jumps, the others show what chance and errors make
BEGIN, END, FEWEST = 0.12, 0.03, 16  # of the blocks, or so many: there states that are not known look alike
SHOWN = 4.0  # blocks that show as much of a step as all do beside the fit, at least
CLEAR = 6.0  # deviations of the residual, and of what all steps explain behind those that are tried
ALONE = 1.9, 1.6  # times what the next steps explain: one jump, and the smaller one of two
AT_ONCE, SURE = 0.5, 6.0  # of its height, within so few blocks that they show it by so many deviations
SUDDEN = 5.0  # times the mean change of the voltage from block to block: a step, at which the error may have one, too
MOST_SUDDEN = 100  # such steps: beside more a jump of the zero is not known
BESIDE = -4, 16  # blocks before and behind these, and behind voltages that were not there before, which switch more
APART = 2.0  # strokes between two jumps: the error of a model comes and goes within one


class Jump(NamedTuple):
    """By how much the residual is higher from a row on, um."""

    size: float
    row: int


@one_thread
def jump(residual: FloatArray, columns: FloatArray, pull: FloatArray, volts: FloatArray, stroke: float) -> Jump | None:
    """The larger of one or two jumps of a residual, um, if there are any; a stroke takes so many rows.

    A fit takes most of a jump, as creep or drift. So each step is taken beside the fit: what it explains is measured
    in what the coefficients cannot make up for. The error of a model comes and goes in many places, and many steps
    explain it alike; a zero jumps in one or two.

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

    Examples
    --------
    >>> noise = np.random.Generator(np.random.PCG64(0)).standard_normal(4000)
    >>> nothing = np.zeros((4000, 0)), np.zeros((0, 0)), np.cos(np.arange(4000) / 30.0), 100.0
    >>> jump(noise, *nothing), jump(noise + 2.0 * (np.arange(4000) > 1700), *nothing).row
    (None, 1701)
    """
    each = -(-residual.size // BLOCKS)
    count = residual.size // each
    if count < 4 * FEWEST:
        return None
    r, J, x = (a[: count * each].reshape(count, each, -1).mean(axis=1) for a in (residual, columns, volts))
    changes = np.abs(np.diff(x[:, 0], prepend=x[0, 0]))
    sudden = np.flatnonzero(changes > SUDDEN * changes.mean())
    if sudden.size > MOST_SUDDEN:
        return None
    of_volts = np.arange(count)[:, None] >= sudden
    possible = np.zeros(count, np.bool_)
    possible[max(FEWEST, round(BEGIN * count)) : count - max(FEWEST, round(END * count))] = True
    low, high = np.minimum.accumulate(x[:, 0]), np.maximum.accumulate(x[:, 0])
    new = np.flatnonzero((np.diff(low) < 0) | (np.diff(high) > 0)) + 1
    possible[np.clip(np.add.outer(np.append(sudden, new), np.arange(*BESIDE)), 0, count - 1)] = False
    steps = _Steps(r[:, 0], np.column_stack([of_volts, J]), pull / np.sqrt(each), possible)
    found = [steps.next() for _ in range(TRIED)]
    deviation = max(float(np.std(steps.residual)), 1e-9 * float(np.abs(residual).max()), 1e-300)
    explain = np.array([share for share, _, _ in found]) / deviation
    for jumps, alone in enumerate(ALONE, 1):
        least = float(explain[:jumps].min())
        clear = least > CLEAR * max(1.0, steps.usual / deviation) and least > alone * explain[jumps:].max()
        apart = jumps == 1 or abs(found[0][2] - found[1][2]) * each > APART * stroke
        if clear and apart and all(_at_once(r[:, 0], deviation, height, at) for _, height, at in found[:jumps]):
            _, size, at = max(found[:jumps], key=lambda one: abs(one[1]))
            return Jump(size, at * each)
    return None


def _at_once(r: FloatArray, deviation: float, height: float, at: int) -> bool:
    """Whether a residual has most of a step at once: the error that a knock leaves, which decays, goes back slowly."""
    width = int(np.clip(np.ceil(2 * (SURE * deviation / height) ** 2), SHOWN, min(at, r.size - at)))
    change = float(r[at : at + width].mean() - r[at - width : at].mean())
    return change > AT_ONCE * height if height > 0 else change < AT_ONCE * height


class _Steps:
    """Steps that explain a residual, one after the other, each beside the fit and those before."""

    def __init__(self, r: FloatArray, columns: FloatArray, pull: FloatArray, possible: npt.NDArray[np.bool_]) -> None:
        n = r.size
        slow = np.cos(np.pi * (np.arange(n)[:, None] + 0.5) / n * np.arange(SLOW + 1))
        X = np.column_stack([slow, columns])
        above = np.zeros((X.shape[1], X.shape[1]))
        above[X.shape[1] - len(pull) :, X.shape[1] - len(pull) :] = pull
        R = normal.reduced(np.vstack([above, X]))
        self._W = normal.triangular(R, X.T, transposed=True).T
        self.residual = r - self._W @ (self._W.T @ r)
        self._until = _from(self._W)
        self._shown = np.arange(n, 0, -1) - np.einsum("ij,ij->i", self._until, self._until)
        self._taken = list[FloatArray]()
        self._possible = possible

    @property
    def _explains(self) -> FloatArray:
        """What a step from each block on explains, um: of white noise its deviation is that of the noise."""
        shown = self._possible & (self._shown > SHOWN)
        return np.asarray(np.where(shown, _from(self.residual) / np.sqrt(np.maximum(self._shown, SHOWN)), 0.0))

    @property
    def usual(self) -> float:
        """Deviation of what the steps explain, um, behind those that were taken."""
        explains = np.abs(self._explains[self._possible & (self._shown > SHOWN)])
        return 1.4826 * float(np.median(explains)) if explains.size else 0.0

    def next(self) -> tuple[float, float, int]:
        """The step that explains most: how much, its height, um, and the block from which on; it is then taken off."""
        explains = self._explains
        k = int(np.abs(explains).argmax())
        if explains[k] == 0.0:
            return 0.0, 0.0, k
        beside = -self._W @ self._until[k]
        beside[k:] += 1.0
        for before in self._taken:
            beside -= before * (before @ beside)
        beside /= np.linalg.norm(beside)
        height = float(explains[k] / np.sqrt(self._shown[k]))
        self._taken.append(beside)
        self.residual = self.residual - beside * (beside @ self.residual)
        self._shown = self._shown - _from(beside) ** 2
        return abs(float(explains[k])), height, k


def _from(a: FloatArray) -> FloatArray:
    """Sums of all rows from each on."""
    return np.asarray(np.cumsum(a[::-1], axis=0)[::-1])
