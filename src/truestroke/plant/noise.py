"""Standard normal numbers from a seed, sampled in chunks: cheap tick by tick, the same numbers in any block.

A sensor that drops out has NaN for its noise: the measurement is NaN then, and the truth is what it was.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truestroke.base.typing import FloatArray

_CHUNK = 16384


class Noise:
    """A stream of standard normal numbers of PCG64(seed), NaN where the sensor is silent.

    Parameters
    ----------
    seed : int
        0 or above.
    silent : sequence of (int, int)
        First number of each stretch that is NaN, and the first after it.

    Examples
    --------
    >>> one, other = Noise(7), Noise(7)
    >>> bool(np.all(one.take(3) == np.concatenate([other.take(1), other.take(2)])))
    True
    >>> np.isnan(Noise(7, [(1, 3)]).take(4)).tolist()
    [False, True, True, False]
    """

    def __init__(self, seed: int, silent: Sequence[tuple[int, int]] = ()) -> None:
        self._silent, self._at = silent, 0
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._chunk: FloatArray = np.empty(0)
        self._used = 0

    def take(self, count: int) -> FloatArray:
        """The next numbers of the stream, shape (count,)."""
        end = self._used + count
        if end > self._chunk.size:
            rest = self._chunk[self._used :]
            self._chunk = np.concatenate([rest, self._random.standard_normal(max(_CHUNK, count))])
            self._used, end = 0, count
        taken = self._chunk[self._used : end]
        self._used = end
        self._silence(taken)
        return taken

    def fill(self, out: FloatArray) -> None:
        """The next numbers of the stream into `out`, shape (count,), without a copy where none were left over."""
        left = self._chunk[self._used :][: out.size]
        out[: left.size] = left
        self._used += left.size
        self._random.standard_normal(out=out[left.size :])
        self._silence(out)

    def put_back(self, count: int) -> None:
        """Undo the last `take`, of `count` numbers."""
        self._used -= count
        self._at -= count

    def _silence(self, numbers: FloatArray) -> None:
        """NaN into those of the next numbers that are in a silent stretch."""
        first, self._at = self._at, self._at + numbers.size
        for start, stop in self._silent:
            numbers[max(start - first, 0) : max(stop - first, 0)] = np.nan
