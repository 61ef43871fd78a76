"""Standard normal numbers from a seed, drawn in chunks: cheap tick by tick, the same numbers in any block."""

from __future__ import annotations

import numpy as np

from truestroke.base.typing import FloatArray

_CHUNK = 16384


class Noise:
    """A stream of standard normal numbers of PCG64(seed).

    Examples
    --------
    >>> one, other = Noise(7), Noise(7)
    >>> bool(np.all(one.take(3) == np.concatenate([other.take(1), other.take(2)])))
    True
    """

    def __init__(self, seed: int) -> None:
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
        return taken

    def fill(self, out: FloatArray) -> None:
        """The next numbers of the stream into `out`, shape (count,), without a copy where none were left over."""
        left = self._chunk[self._used :][: out.size]
        out[: left.size] = left
        self._used += left.size
        self._random.standard_normal(out=out[left.size :])

    def put_back(self, count: int) -> None:
        """Undo the last `take`, of `count` numbers."""
        self._used -= count
