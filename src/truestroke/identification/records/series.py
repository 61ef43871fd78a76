"""A record as the fit takes it: regular samples, holes bridged and marked."""

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke import _kernel
from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.identification.records import turning
from truestroke.identification.records.record import FEWEST_ROWS
from truestroke.identification.records.resting import STILL
from truestroke.identification.records.shaken import shaken
from truestroke.signals.channels import Signals
from truestroke.signals.clipping import clipped
from truestroke.signals.quiet import noise_not_followed, without_noise

SAMPLES = 500_000  # of the record at most: longer ones are replaced by means over blocks
REGULAR = 0.02  # of the interval: how far time stamps may be off, beyond the rounding of their digits
SWEPT = 0.96  # of the voltage range: when it has been swept, the plays do not remember what was before
UNSWEPT = 0.6  # over the motion that remains: what it is worth to know all states of the plays
MOVES = 0.05  # of its span: how far the other signal moves while one is clipped
RING_SHARE, RING_TURNS = 0.25, 6  # of its range, and turns of so much, with both ends: more is a stage that rings
BRIDGED = 0.2  # of a stroke's duration: a hole that is shorter hides no reversal


@dataclass(frozen=True, eq=False, repr=False)
class Series(Signals):
    """Regular samples of voltage and displacement.

    Attributes
    ----------
    time, volts, displacement : ndarray, shape (samples,)
        s, V, um. Within holes of the record, straight lines.
    known : ndarray of bool, shape (samples,)
        False within a hole, after a long one until the states of the plays are known again, and where the
        displacement is clipped.
    sample_rate : float
        Hz.
    source : str
        Where it comes from.
    breaks : tuple of int
        First samples after gaps that are longer than all that was measured: there the zero is another one.
    voltage_noise : float
        Noise of the measurement of the voltage that is not in `volts` any more, V (`quiet.noise_not_followed`).
    """

    time: FloatArray
    volts: FloatArray
    displacement: FloatArray
    known: npt.NDArray[np.bool_]
    sample_rate: float
    source: str
    breaks: tuple[int, ...]
    voltage_noise: float = field(default=0.0, kw_only=True)


def series(record: Any) -> Series:
    """Regular samples of a record: an object with `volts`, `displacement`, `sample_rate`, or a tuple of the three.

    Where its time stamps are irregular or leave gaps, straight lines between its rows, at its own rate. Gaps that are
    together longer than all that was measured are shortened, the longest ones. Beyond 500,000 samples, means over
    blocks. The voltage is without the noise of its measurement.

    Raises
    ------
    SettingError
        This is no record, or a short one, or its voltage or displacement does not move, or the displacement falls with
        the voltage.
    """
    volts, displacement, rate = _three(record)
    x, z = checks.finite_array("volts", volts, "V"), checks.finite_array("displacement", displacement, "um")
    fs = checks.positive("sample_rate", rate, "Hz")
    _refuse_useless(x, z, getattr(record, "flipped", False))
    position = _positions(record, fs)
    time, known = np.arange(x.size) / fs, ~clipped(z, x, MOVES * float(np.ptp(x)))
    breaks: list[int] = []
    if position is not None:
        seen, t = known, record.time
        later = [after.start for after in record.segments[1:] if t[after.start] - t[after.start - 1] > x.size / fs]
        breaks = [int(np.ceil(position[row])) for row in later]
        time, x, z, known = _bridged(record.time, x, z, position, record.segments)
        nearest = np.round(np.interp(np.arange(time.size), position, np.arange(seen.size))).astype(np.int64)
        known &= seen[nearest]
    deviation = noise_not_followed(x, z)
    x = without_noise(x, deviation)
    block = -(-x.size // SAMPLES)
    time, x, z = (a[: a.size // block * block].reshape(-1, block).mean(axis=1) for a in (time, x, z))
    known = np.asarray(known[: known.size // block * block].reshape(-1, block).all(axis=1), dtype=np.bool_)
    breaks = [at // block for at in breaks]
    return Series(
        time, x, z, known, fs / block, str(getattr(record, "source", "")), tuple(breaks), voltage_noise=deviation
    )


def _three(record: Any) -> tuple[Any, Any, Any]:
    """Volts, displacement, sample rate."""
    try:
        if isinstance(record, tuple | list):
            volts, displacement, rate = record
            return volts, displacement, rate
        return record.volts, record.displacement, record.sample_rate
    except (AttributeError, ValueError):
        bound = "a Record, as of read_record, or (volts in V, displacement in um, sample rate in Hz)"
        raise SettingError("record", f"of type {type(record).__name__}", bound) from None


def _refuse_useless(x: FloatArray, z: FloatArray, flipped: bool) -> None:
    if z.size != x.size:
        raise SettingError("displacement", f"array of {z.size} samples", f"as long as volts, {x.size} samples", "um")
    if x.size < FEWEST_ROWS:
        raise SettingError("volts", f"array of {x.size} samples", f"a record of at least {FEWEST_ROWS} samples")
    for name, value, unit in (("volts", x, "V"), ("displacement", z, "um")):
        if np.ptp(value) <= 1e-12 * np.abs(value).max():
            raise SettingError(name, f"{value[0]:g} throughout", "a record that moves", unit)
    rings = shaken(x, z)
    if rings < 0 or (rings == 0 and (x - x.mean()) @ (z - z.mean()) <= 0):
        remedy = "leave out `flip_displacement`, which has turned" if flipped else "`flip_displacement` turns"
        raise SettingError("displacement", "one that falls as the voltage rises", f"one that rises; {remedy} its sign")


def _positions(record: Any, fs: float) -> FloatArray | None:
    """Time of each row in samples from the first; None where they count from 0 without a hole."""
    segments = getattr(record, "segments", ())
    if "time" not in getattr(record, "columns", ()) and len(segments) < 2:
        return None
    t = record.time
    regular = all(_regular(t[s], fs) for s in segments)
    if regular and len(segments) == 1:
        return None
    steps = np.ones(t.size - 1) if regular else np.diff(t) * fs
    ends = np.array([s.stop - 1 for s in segments[:-1]], dtype=np.int64)
    gaps = np.round((t[ends + 1] - t[ends]) * fs)
    steps[ends] = np.minimum(gaps, _longest(gaps, t.size))
    return np.concatenate([[0.0], np.cumsum(steps)])


def _longest(gaps: FloatArray, together: int) -> float:
    """To which gaps are shortened, so that they have so many samples together at most; two at least each.

    Examples
    --------
    >>> _longest(np.array([3.0, 100.0, 2.0]), 50), _longest(np.array([3.0, 4.0]), 50)
    (45.0, inf)
    """
    ascending, number = np.sort(gaps), gaps.size
    shares = (together - np.cumsum(ascending) + ascending) // (number - np.arange(number))
    long = np.flatnonzero(ascending > shares)
    return max(2.0, float(shares[long[0]])) if long.size else np.inf


def _regular(t: FloatArray, fs: float) -> bool:
    """Whether the stamps lie on a line, but for the rounding of their last digit."""
    if t.size < 3:
        return True
    off = np.abs(t - np.linspace(t[0], t[-1], t.size)).max()
    few = t[:: max(1, t.size // 10_000)]
    digits = (d for d in 10.0 ** np.arange(0, -10, -1) if np.abs(few - np.round(few / d) * d).max() < 1e-4 * d)
    digit = next(digits, 0.0)
    return bool(off <= max(REGULAR / fs, 1.01 * digit))


def _bridged(
    t: FloatArray, x: FloatArray, z: FloatArray, position: FloatArray, segments: tuple[slice, ...]
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Time, voltage and displacement at whole positions, and which of them are known."""
    grid = np.arange(int(position[-1] + 1e-6) + 1, dtype=np.float64)
    time, volts, moved = (np.interp(grid, position, a) for a in (t, x, z))
    known = np.ones(grid.size, dtype=bool)
    span = float(np.ptp(volts))
    turns = turning.reversals(volts, turning.STROKE * span)
    for before, after in itertools.pairwise(segments):
        start, stop = int(position[before.stop - 1]) + 1, int(np.ceil(position[after.start]))
        end = int(position[after.stop - 1]) + 1
        known[start:stop] = False
        if stop - start > BRIDGED * np.median(np.diff(turns)):
            known[stop : stop + first_known(volts[stop:end], span)] = False
    return time, volts, moved, known


def settled(x: FloatArray, span: float) -> int:
    """First sample at which the voltage has swept nearly all of its range `span`, V; else how many there are."""
    swept = np.maximum.accumulate(x) - np.minimum.accumulate(x) >= SWEPT * span
    return int(np.argmax(swept)) if x.size and swept[-1] else x.size


def first_known(x: FloatArray, span: float) -> int:
    """First sample to fit: there the plays remember as little as possible of before, and enough motion follows.

    Of all samples the one with the least ::

        D / (1 - D) + UNSWEPT max(1 - swept / (SWEPT span), 0)

    D is the share of the travel before it, not of the time: a rest costs nothing. `swept` is the range up to it, V.

    Examples
    --------
    A rest, and then a triangle that goes round several times:

    >>> first_known(np.concatenate([np.full(50, 1.0), np.tile([2.0, 3.0, 2.0, 1.0, 0.0, 1.0], 4)]), 3.0)
    54
    """
    if x.size < 2:
        return 0
    held = np.empty((x.size, 1))
    _kernel.play_history(np.ascontiguousarray(x), np.array([STILL * span]), x[:1].copy(), 1, held)
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(held[:, 0])))])
    if travel[-1] == 0.0:
        return 0
    left = 1 - travel / travel[-1]
    swept = np.maximum.accumulate(x) - np.minimum.accumulate(x)
    unknown = UNSWEPT * np.maximum(1 - swept / (SWEPT * span), 0.0)
    return int(np.argmin((1 - left) / np.maximum(left, 1e-12) + unknown))


def to_and_fro(signal: FloatArray) -> float:
    """How far it goes and comes back, to one side.

    Behind a backlash a displacement rests while the voltage goes one way; where the voltage rests a stage creeps one
    way, or rings to both sides.

    Examples
    --------
    >>> [to_and_fro(np.array(way)) for way in ([0.0, 2.0, 0.1], [0.0, 2.0], [0.0, 2.0, -2.0, 0.0])]
    [1.8, 0.0, 0.0]
    """
    ends, least, most = (signal[0], signal[-1]), signal.min(), signal.max()
    if turning.reversals(signal, RING_SHARE * float(most - least)).size > RING_TURNS:
        return 0.0
    beyond = max(most - max(ends), min(ends) - least)
    return float(min(beyond, abs(most + least - 2 * signal[-1])))
