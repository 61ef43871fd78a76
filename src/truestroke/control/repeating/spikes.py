"""Spikes of a sensor in an error that repeats, as each sample comes.

A spike is far from what the period before had at its place, and from what both places beside it have: by more than 15
times the median by which samples differ from those a period before. So far a pass judges by all of its periods
(`iterative`); on line the periods behind are not known yet. A stage that changes is no spike: after two samples in a
row the third counts, and so does one that has come back in the next period.
"""

from __future__ import annotations

import math

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.repeating.iterative import SPIKE

ROW = 2  # samples: a spike lasts no longer
FEWEST = 256  # differences, whose median counts


class Spikes:
    """Which samples of an error are spikes.

    Parameters
    ----------
    size : int
        Places of a period.

    Examples
    --------
    >>> spikes, noise = Spikes(100), np.random.default_rng(0)
    >>> found = []
    >>> for tick in range(1000):
    ...     error = 0.01 * noise.standard_normal() + (1.0 if tick == 777 else 0.0)
    ...     if spikes.is_one(tick % 100, error):
    ...         found.append(tick)
    >>> found
    [777]
    """

    def __init__(self, size: int) -> None:
        self._before, self._refused = np.full(size, math.nan), np.full(size, math.nan)
        self._apart: FloatArray = np.empty(max(size, FEWEST))
        self._many = self._row = 0
        self._most = math.inf

    def is_one(self, place: int, error: float) -> bool:
        """Whether an error, um, at a place of the period is a spike; it is none where that is not known."""
        last, refused = self._before.item(place), self._refused.item(place)
        beside = self._before.item(place - 1), self._before.item((place + 1) % self._before.size)
        far = max(min(last, *beside) - error, error - max(last, *beside)) > self._most  # False of NaN
        again = abs(error - refused) <= self._most
        self._see(abs(error - last))
        if far and not again and self._row < ROW:
            self._row += 1
            self._refused[place] = error
            return True
        self._row = self._row if far else 0
        self._before[place], self._refused[place] = error, math.nan
        return False

    def _see(self, apart: float) -> None:
        if not math.isfinite(apart):
            return
        self._apart[self._many] = apart
        self._many += 1
        if self._many == self._apart.size:
            self._many, middle = 0, float(np.median(self._apart))
            self._most = SPIKE * middle if middle > 0 else math.inf
