"""Noise of a signal between neighbouring samples."""

import hashlib
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from truestroke.base.typing import FloatArray

SAMPLED = 200_000  # rows, evenly taken, that medians are formed of
RAMP, ALIKE = 0.9, 0.02  # of the jumps, and of a jump: where so many are equal, they are those of a motion
DIGITS_OF = 1000  # rows whose digits are counted
ASKED_AGAIN = 8  # signals whose noise is kept: an examination asks ten times for that of two

_kept: dict[bytes, float] = {}  # by what the blocks of the signal are, which are not kept


def noise(signal: FloatArray, segments: Sequence[slice]) -> float:
    """Standard deviation of the noise, in the signal's unit.

    The least of the robust deviations of differences of order 2 to 6: higher ones contain less of a smooth motion.
    The median of |differences| is robust to the reversals and a few outliers. Noise that is slower than the samples,
    such as mains hum, is not in it. Nor is it less than that of rounding to the steps of a converter.
    """
    blocks, span = _blocks(signal, segments), float(np.ptp(signal)) if signal.size else 0.0
    which = hashlib.blake2b(repr((span, [block.size for block in blocks])).encode())
    for block in blocks:
        which.update(np.ascontiguousarray(block, dtype=np.float64).data)
    if (key := which.digest()) not in _kept:
        if len(_kept) >= ASKED_AGAIN:
            _kept.clear()
        _kept[key] = _noise(blocks, span)
    return _kept[key]


def _noise(blocks: Sequence[FloatArray], span: float) -> float:
    """Of a signal of this span, in these blocks."""
    if not blocks:
        return 0.0
    differences = [np.diff(block) for block in blocks]
    jumps, found = np.abs(np.concatenate(differences)), []
    for order in range(2, 7):
        differences = [np.diff(difference) for difference in differences]
        middle = float(np.median(np.abs(np.concatenate(differences))))
        found.append(middle / 0.6745 / math.sqrt(math.comb(2 * order, order)))
    most = np.median(jumps)
    if most > 1e-9 * span and np.mean(np.abs(jumps - most) <= ALIKE * most) > RAMP:
        return min(found)
    return max(min(found), _step(jumps[jumps > 1e-9 * span]) / math.sqrt(12))


def noise_with_tails(signal: FloatArray) -> float:
    """The same as a root mean square: rows that are far off count, as they do in every mean square error.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> white, tails = rng.standard_normal(20_000), rng.standard_t(3, 20_000)
    >>> all_of_it = (slice(0, 20_000),)
    >>> [round(noise(x, all_of_it), 1) for x in (white, tails)], [round(noise_with_tails(x), 1) for x in (white, tails)]
    ([1.0, 1.3], [1.0, 1.7])
    """
    if signal.size <= 8:
        return 0.0
    squares = (float(np.mean(np.diff(signal, order) ** 2)) / math.comb(2 * order, order) for order in range(2, 7))
    return max(noise(signal, (slice(0, signal.size),)), math.sqrt(min(squares)))


def converter_step(signal: FloatArray) -> float:
    """The step of a converter, of which every row is a whole number, in the signal's unit; 0 where there is none.

    Examples
    --------
    >>> sine = np.sin(np.arange(1000) / 50.0)
    >>> converter_step(np.round(sine * 64) / 64), converter_step(sine)
    (0.015625, 0.0)
    """
    blocks = _blocks(signal, (slice(0, signal.size),))
    jumps = np.abs(np.concatenate([np.diff(block) for block in blocks])) if blocks else np.zeros(0)
    return _step(jumps[jumps > 1e-9 * np.ptp(signal)])


def rounding(signal: FloatArray) -> float:
    """Standard deviation of what was rounded off when the signal was written as text, in its unit; else nearly 0.

    The last digit is the same in all rows, or is so many digits behind the first one of each row.
    """
    few = signal[:: max(1, signal.size // DIGITS_OF)]
    return _rounded(np.asarray(few[few != 0.0], np.float64).tobytes())


@lru_cache(maxsize=8)  # several of an examination ask for the same two signals
def _rounded(values: bytes) -> float:
    few = np.frombuffer(values)
    last, digits = math.inf, 0
    for value in np.abs(few).tolist():
        mantissa, _, exponent = f"{value:.14e}".partition("e")
        written = len(mantissa.rstrip("0").replace(".", ""))
        digits, last = max(digits, written), min(last, 10.0 ** (int(exponent) + 1 - written))
    same = 10.0 ** (np.floor(np.log10(np.abs(few))) + 1 - digits)
    return max(last, float(np.sqrt(np.mean(same**2)))) / math.sqrt(12) if few.size else 0.0


def _blocks(signal: FloatArray, segments: Sequence[slice]) -> list[FloatArray]:
    """Pieces of the signal without gaps, SAMPLED rows at most in all."""
    length = SAMPLED // 16
    starts = ((a, s.stop) for s in segments for a in range(s.start, s.stop, length))
    pieces = [signal[a : min(a + length, stop)] for a, stop in starts]
    return [piece for piece in pieces[:: max(1, len(pieces) // 16)] if piece.size > 8]


def _step(jumps: FloatArray) -> float:
    """The smallest jump, if every jump is a whole number of it, and most of them few; else 0."""
    if jumps.size == 0:
        return 0.0
    ratio = jumps / jumps.min()
    few = np.median(ratio) < 50 and np.median(np.abs(ratio - ratio.round())) < 0.01
    return float(jumps.min()) if few else 0.0
