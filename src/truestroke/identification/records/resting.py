"""Where the voltage of a record rests for long: such rows show no motion, and make no share of one."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.model.sampled import velocity_span

STILL = 0.025  # of the voltage range: smaller steps back and forth, or deviations of noise, are no motion
BLOCKS = 400  # of a record: means over them, which noise of the voltage hardly moves
SHARE, LONG = 0.1, 1 / 3  # of the record, and of its motion: shorter ones, as of a staircase, are a part of the motion
FITTED = 0.1  # of the motion: so many rows of a rest are fitted; with more the intervals are too narrow for motion
FEWEST_MOVE = 0.02  # of the record: with less motion, as of few steps, the rests are what it shows

STEP = 0.1  # of the voltage range, in a row: no motion, but a step

Flags = npt.NDArray[np.bool_]


def moving(x: FloatArray) -> Flags:
    """Which rows are in no long rest of the voltage, V.

    It is long from a tenth of the record and a third of its motion on: a single one from a quarter of the record on.
    All rows, where hardly any move.

    Examples
    --------
    >>> motion = np.sin(np.arange(300) / 10.0)
    >>> [int(np.count_nonzero(moving(np.concatenate([motion, np.full(rows, -2.0)])))) for rows in (50, 700)]
    [350, 300]
    """
    rows, rests = np.ones(x.size, dtype=np.bool_), [(a, b) for a, b in _rests(x) if b - a > SHARE * x.size]
    motion = x.size - sum(b - a for a, b in rests)
    if motion >= FEWEST_MOVE * x.size:
        for start, stop in rests:
            rows[start:stop] = stop - start <= LONG * motion
    return rows


def begun(x: FloatArray, sample_rate: float) -> int:
    """First row whose velocity has nothing of a step with which the motion begins; 0 where it begins without.

    Of motion that is as fast as such a step a record shows nothing but its end. It is in the velocity, and so in terms
    of a strain that follow it, whose velocity is once more that around a row.

    Examples
    --------
    >>> [begun(np.concatenate([[0.0], first + np.linspace(0.0, 1.0, 50)]), 1000.0) for first in (0.0, 0.5)]
    [0, 3]
    """
    off, step = np.abs(x - x[0]), STEP * float(np.ptp(x))
    first = int(np.argmax(off > step))
    if abs(x[first] - x[first - 1]) <= step:
        return 0
    return first + 2 * velocity_span(sample_rate)


def fitted(x: FloatArray) -> Flags:
    """Which rows are fitted: of a long rest only the first ones, which have most of the creep."""
    moves = moving(x)
    rows, most = moves.copy(), int(FITTED * np.count_nonzero(moves))
    for start in np.flatnonzero(np.diff(moves, prepend=True) & ~moves).tolist():
        rows[start : start + most] = True
    return rows


def judged(x: FloatArray, error: FloatArray, rows: Flags) -> Flags:
    """Those of `rows` by which a model is judged: of motion, and `fitted` ones of rests if the error, um, is larger.

    A rest of the voltage `x`, V, is hardly ever predicted wrongly, and would hide the error in motion.
    """
    moves = rows & moving(x)
    both = rows & fitted(x)
    at_rest = both & ~moves
    if not moves.any() or (at_rest.any() and np.mean(error[at_rest] ** 2) > np.mean(error[moves] ** 2)):
        return both
    return moves


def _rests(x: FloatArray) -> Iterator[tuple[int, int]]:
    """First row of each stretch at one voltage, and the row behind it."""
    edges = np.linspace(0, x.size, min(BLOCKS, x.size) + 1).astype(np.int64)
    rows, span = np.diff(edges), float(np.ptp(x))
    mean = np.add.reduceat(x, edges[:-1]) / rows
    off = x - np.repeat(mean, rows)
    quiet = np.sqrt(np.add.reduceat(off * off, edges[:-1]) / rows) <= STILL * span
    levels, still, start = mean.tolist(), quiet.tolist(), 0
    while start < len(levels):
        stop, level = start, levels[start]
        while stop < len(levels) and still[stop] and abs(levels[stop] - level) <= STILL * span:
            stop += 1
        if stop > start + 1:
            yield int(edges[start]), int(edges[stop])
        start = max(stop, start + 1)
