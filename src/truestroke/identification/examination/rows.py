"""Rows that were not measured where they stand: written twice, repeated, filled by a line, or lost on the way."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.identification.examination.faults import held, repeated
from truestroke.identification.examination.findings import Findings
from truestroke.identification.examination.unrecorded import of_ends
from truestroke.identification.records.record import Record
from truestroke.signals.clipping import runs
from truestroke.signals.noise import noise, rounding

STAIRS = 0.04  # of the span, from one value to the next: rows that are there several times of a motion move less
FEWEST_AGAIN, AGAIN = 5, 0.001  # rows, and of the rows
STILL = 0.15  # of the median step: where the voltage turns, it moves by less from row to row
WINDOW, BLOCK = 8, 40  # rows that are compared with all others, and of a block that is a copy
COPIED, DRAWN_FROM = 1.0, 2.0  # steps of the sensor: with so much noise no block, and no line, is there by chance
STRAIGHT = 6  # second differences on one line, at least
FLOAT = 1e-9  # of the stroke: rounding of floats
CHANCE = 1e-3  # of a line of so many rows anywhere in the record, by noise alone
FEWEST_FILLED, LONG = 3, 2  # such places, or one with so many times the rows
DRAWN = 0.45  # of all rows, where lines join the measured ones
JOINT = 0.03  # of the span: both signals move so far from one row to the next
SUDDEN, BESIDE = 8.0, 3  # times what they do in so many rows on either side
GOES_ON, CLEAR = 0.2, 4.0  # of the median step, and deviations: so fast the voltage moves before and behind
SURE = 5.0  # deviations of the noise of the displacement
SHARE = 0.4, 1.6  # of the voltage's jump times the gain: of the displacement in the same row
SORTED = 0.005  # of the stroke: noise of rows that alternate between the ways up and down
LONG_BESIDE, MOST_BESIDE = 40, 12  # of a stroke, one part in so many, and rows: of lines beside an even voltage's jump
SHORT_BESIDE = 10  # the same of the displacement's
ABOUT = 0.4, 3.0  # the same where it is far beyond all others: a lag has less, a turn that is missing less or more
SHOWN = 0.015  # of the span: so far it jumps
ALONE = 0.5  # of that, or of what stands out: no other row jumps so far
AT_ONCE = 0.5  # of a jump: in the one row in which it is
FEW_JOINTS = 4  # a motion that jumps more often is meant to
EVEN = 0.2  # of a step: so far the two before and behind it differ from their mean, where the voltage is smooth
MISSING, MOST_MISSING = 1.7, 30.0  # times these: a step over a row that is missing, and over many
FEWEST_LOST, LOST = 6, 0.002  # such steps, and of the even ones
RARELY = 0.33  # as many between 1 and 2 times: of a motion that is sampled too rarely there are as many and more
ALIKE = 0.25  # of its factor: so far that of the displacement differs, and its deviation at most


def rewritten(record: Record, found: Findings) -> Iterator[str]:
    """A sentence for each kind of such rows, with its evidence and the remedy."""
    yield from _of_copies(record)
    step = _step(record.displacement)
    if repeated(record.displacement) == 1:
        if found.noise_um > COPIED * step:
            yield from _of_blocks(record)
            yield from of_ends(record)
        yield from _of_lines(record, step)
    yield from [*_of_joints(record, found)] or _of_lost_rows(record, found)
    yield from _of_order(record, found)


def _of_copies(record: Record) -> Iterator[str]:
    """Both signals repeat their values in the same rows: each row is there several times, or some rows are."""
    every = repeated(record.displacement)
    if every > 1 and repeated(record.volts) == every:
        steps, moved = np.abs(np.diff(record.volts)), np.diff(record.displacement)
        stairs = steps[steps > 0].mean() > STAIRS * np.ptp(record.volts)
        if not stairs and np.mean((steps != 0) == (moved != 0)) > 0.9:
            yield (
                f"voltage and displacement have a new value in every {every}. row only: are rows written {every} "
                f"times, and is the sample rate {every} times too high?"
            )
    again = _again(record)
    if again >= FEWEST_AGAIN:
        yield (
            f"{again} rows, each by itself, repeat both values of the row before, while both signals move: did the "
            "logger write rows twice? Leave out the copies, or record with time stamps"
        )


def _again(record: Record) -> int:
    """Rows that repeat both values, between rows in which the voltage moves; 0 where chance makes as many.

    Converters repeat both values where the voltage turns: there it moves slowly before and behind.
    """
    steps = np.diff(record.volts)
    still = steps == 0, np.diff(record.displacement) == 0
    usual = float(np.median(np.abs(steps[~still[0]]))) if not still[0].all() else 0.0
    both, moves = still[0] & still[1], np.abs(steps) > STILL * usual
    alone = both[1:-1] & moves[:-2] & moves[2:]
    by_chance = float(still[0].mean() * still[1].mean()) * both.size
    number = int(alone.sum())
    return number if number > max(AGAIN * both.size, 5 * by_chance) else 0


def _of_blocks(record: Record) -> Iterator[str]:
    """A part of the record that is there again, noise and all."""
    x, z, n = record.volts, record.displacement, record.volts.size - WINDOW
    if n < BLOCK:
        return
    weights = np.random.Generator(np.random.PCG64(0)).standard_normal((2, WINDOW))
    marks = np.sum([a * x[k : k + n] + b * z[k : k + n] for k, (a, b) in enumerate(weights.T)], axis=0)
    order = np.argsort(marks, kind="stable")
    same = np.flatnonzero(np.diff(marks[order]) == 0.0)
    first, again = order[same], order[same + 1]
    moves = np.any([z[first + k] != z[first] for k in range(1, WINDOW)], axis=0) if same.size else np.zeros(0, np.bool_)
    if np.count_nonzero(moves) < BLOCK - WINDOW:
        return
    first, apart = first[moves], (again - first)[moves]
    later = int(np.bincount(apart).argmax())
    rows = first[apart == later]
    if rows.size >= BLOCK - WINDOW:
        start = int(rows.min()) + 1
        yield (
            f"{rows.size + WINDOW} rows from row {start} on are there again {later} rows later, noise and all: "
            "is a block of the file there twice? Leave out the copy"
        )


def _step(signal: FloatArray) -> float:
    """The least by which a signal changes: the step of a converter, or the last digit of a text."""
    changes, none = np.abs(np.diff(signal)), FLOAT * float(np.ptp(signal))
    least = float(changes[changes > none].min(initial=np.inf))
    return max(least, math.sqrt(12) * rounding(signal), none)


def _of_lines(record: Record, step: float) -> Iterator[str]:
    """A displacement with noise does not run on a line or stay: holes were filled, or the rows multiplied.

    While the voltage rests it may: between the steps of a staircase, what seems to be noise is the ringing behind them.
    """
    z, bends = record.displacement, np.abs(np.diff(record.displacement, 2))
    moves = record.volts[2:] != record.volts[:-2]
    noisy = float(np.percentile(bends, 90)) / (1.645 * math.sqrt(6.0)) / step  # of rows that were measured
    if noisy < DRAWN_FROM:
        return
    by_chance = 0.82 / noisy  # that a second difference of normal noise is within two steps
    least = max(STRAIGHT, math.ceil(math.log(z.size / CHANCE) / -math.log(by_chance)))
    flat = bends <= 2.01 * step
    flats = runs(flat & moves)
    inside = (z[flats[:, 0]] > z.min()) & (z[flats[:, 0]] < z.max())  # at the ends of the range it is clipped
    filled = flats[inside & (flats[:, 1] - flats[:, 0] >= least)]
    longest = int(np.diff(filled, axis=1).max(initial=0))
    drawn = float(flat[moves].mean()) if moves.mean() > DRAWN else 0.0
    each = held(z)
    if drawn > max(DRAWN, 2 * by_chance) and each > 1.0:
        yield (
            f"the displacement keeps each of its values for {each:.3g} rows on average, while the voltage moves: is "
            "the sensor, or the way to the recorder, slower than the record? Record at its rate, or leave out the rows "
            "that repeat a value"
        )
    elif drawn > max(DRAWN, 2 * by_chance):
        rows = round(1 / max(1 - drawn, 1 / z.size))
        yield (
            f"the displacement is on straight lines of {rows} rows each: were rows put "
            "between those that were measured? Record at the rate of the sensor, or leave them out"
        )
    elif len(filled) >= FEWEST_FILLED or longest >= LONG * least:
        places = "one place" if len(filled) == 1 else f"{len(filled)} places"
        first = f"first at {record.time[filled[0, 0]] - record.time[0]:.4g} s"
        yield (
            f"the displacement has noise, but stays or is on a line for {least + 2} rows and more at {places}, {first}"
            ": were holes filled? Leave these rows out"
        )


def _of_joints(record: Record, found: Findings) -> Iterator[str]:
    """Both signals jump in one row, and were moving before and behind: rows are missing, or two records joined."""
    x, z = np.diff(record.volts), np.diff(record.displacement)
    steps = np.abs(x[x != 0.0])
    jumps = np.flatnonzero(np.abs(x) > JOINT * np.ptp(record.volts))
    if not jumps.size < x.size // 50 or not steps.size:
        return
    gaps = {s.start - 1 for s in record.segments[1:]}
    by_noise = CLEAR * math.sqrt(2.0) / BESIDE * noise(record.volts, record.segments)
    gain, slow = found.gain_um_per_v, max(GOES_ON * float(np.median(steps)), by_noise)
    by_noise = SURE * math.sqrt(2.0) * found.noise_um
    joints = [k for k in jumps.tolist() if k not in gaps and _is_joint(x, z, k, gain, slow, by_noise)]
    joints = joints or _sudden(record, found, slow / 2)
    if 0 < len(joints) <= FEW_JOINTS:
        k, size = joints[0], len(joints)
        places = "one place" if size == 1 else f"{size} places"
        yield (
            f"at {places}, first at {record.time[k] - record.time[0]:.4g} s, both signals jump within one row, the "
            f"voltage by {abs(x[k]):.3g} V, and move on behind: are rows missing, or two records joined? Use each part "
            "by itself, or time stamps"
        )


def _sudden(record: Record, found: Findings, slow: float) -> list[int]:
    """Rows behind which an even voltage jumps by far more than anywhere else, and moves on, faster than `slow` a row.

    The displacement does so, too; where noise hides that, there is one such row.
    """
    x, z = record.volts, record.displacement
    stroke = x.size / max(found.strokes, 1)
    beside = int(np.clip(stroke / LONG_BESIDE, BESIDE, MOST_BESIDE))
    if found.strokes < 4 or x.size < 4 * beside:
        return []
    level, slope = _lines(x, beside)
    last, first = slice(0, x.size - 2 * beside + 1), slice(beside, None)  # windows that end, and begin, at a row
    jump = (level[first] - slope[first] * beside / 2) - (level[last] + slope[last] * beside / 2)
    moving = np.minimum(np.abs(slope[first]), np.abs(slope[last])) > slow
    size, places = np.abs(jump), []
    for gap in record.segments[1:]:
        size[max(gap.start - 2 * beside, 0) : gap.start + beside] = 0.0
    for _ in range(FEW_JOINTS + 1):
        place = int(np.argmax(size))
        places.append((place + beside - 1, float(jump[place]), bool(moving[place])))
        size[max(place - 2 * beside, 0) : place + 2 * beside + 1] = 0.0
    least = max(SHOWN * float(np.ptp(x)), SUDDEN * float(size.max()))
    large = [each for each in places if abs(each[1]) > least]
    if len(large) > FEW_JOINTS or not all(moves for *_, moves in large):
        return []
    steps, by_noise = np.abs(np.diff(x)), CLEAR * noise(x, record.segments)
    if any(steps[k] + by_noise < AT_ONCE * abs(by) for k, by, _ in large):  # a quick way in some rows, as to a start
        return []
    if any(abs(by) > ALONE * least for _, by, _ in places[len(large) :]):
        return []
    seen = [_follows(z, k, found.gain_um_per_v * by, found.noise_um, stroke) for k, by, _ in large]
    return sorted(k for k, *_ in large) if (seen and all(seen)) or seen == [None] else []


def _lines(x: FloatArray, rows: int) -> tuple[FloatArray, FloatArray]:
    """Mean and slope of the line through each so many rows."""
    u = np.arange(rows) - (rows - 1) / 2
    sums = np.concatenate([[0.0], np.cumsum(x - x.mean())])
    return (sums[rows:] - sums[:-rows]) / rows + x.mean(), np.correlate(x, u / (u @ u), mode="valid")


def _follows(z: FloatArray, k: int, by: float, quiet: float, stroke: float) -> bool | None:
    """Whether the displacement jumps behind row k, by about so much, um; None where its noise hides that."""
    most = max(int(stroke / SHORT_BESIDE), BESIDE)
    if 8 * (SURE * quiet / by) ** 2 > most or not most <= k + 1 <= z.size - most:
        return None
    rows = min(max(most // 2, math.ceil(8 * (2 * SURE * quiet / by) ** 2)), most)
    parts = z[k + 1 - rows : k + 1], z[k + 1 : k + 1 + rows]
    (before, up), (behind, on) = ([float(values[0]) for values in _lines(part, rows)] for part in parts)
    moved = (behind - on * rows / 2) - (before + up * rows / 2)
    return bool(ABOUT[0] < moved / by < ABOUT[1])


def _is_joint(x: FloatArray, z: FloatArray, k: int, gain: float, slow: float, by_noise: float) -> bool:
    """Whether step k of both is such a jump; x, z are the steps of the voltage and of the displacement.

    A jump of the displacement beyond its noise, um, is compared with the mean of the steps beside it, in which is less.
    """
    if not BESIDE <= k < x.size - BESIDE:
        return False
    before, behind = slice(k - BESIDE, k), slice(k + 1, k + 1 + BESIDE)
    if any(abs(x[k]) < SUDDEN * np.abs(x[side]).max() for side in (before, behind)):
        return False
    beside = [np.abs(z[side]).max() if abs(z[k]) < by_noise else abs(z[side].mean()) for side in (before, behind)]
    if abs(z[k]) < SUDDEN * max(beside):
        return False
    low, high = SHARE
    goes_on = min(abs(x[before].mean()), abs(x[behind].mean())) > slow
    return bool(goes_on and low < z[k] / (gain * x[k]) < high)


def _of_lost_rows(record: Record, found: Findings) -> Iterator[str]:
    """Single steps of a smooth motion are twice as long as those beside them, and more, in both signals.

    Examples
    --------
    >>> from truestroke.identification import examine
    >>> kept = np.arange(3000) % 10 != 7
    >>> x = 5 - 5 * np.cos(np.arange(3000)[kept] / 50.0)
    >>> record = Record.from_arrays(x, x**1.1, sample_rate=1000.0)
    >>> next(_of_lost_rows(record, examine(record)))[:74]
    'at 251 places both signals go 2 times as far in one row as in those beside'
    """
    step, z = np.diff(record.volts), np.diff(record.displacement)
    beside = np.array([np.roll(step, shift) for shift in (2, 1, -1, -2)])
    usual = beside.mean(axis=0)
    even = np.abs(beside - usual).max(axis=0) < EVEN * np.abs(usual)
    even &= np.abs(usual) > CLEAR * noise(record.volts, record.segments)
    even &= np.diff(record.time) < MISSING / record.sample_rate
    even[:BESIDE] = even[-BESIDE:] = False
    longer = np.divide(step, usual, out=np.ones_like(step), where=even)
    lost = np.flatnonzero((longer > MISSING) & (longer < MOST_MISSING))
    between = np.count_nonzero((longer > (1 + MISSING) / 2) & (longer <= MISSING))
    if lost.size < max(FEWEST_LOST, LOST * np.count_nonzero(even)) or between > RARELY * lost.size:
        return
    way = np.sign(step[lost])
    moved = float(np.mean([way * z[lost + k] for k in (-2, -1, 1, 2)]))
    factor, of_moved = float(longer[lost].mean()), float(np.mean(way * z[lost]) / moved)
    unsure = found.noise_um * math.sqrt(2 / lost.size) / abs(moved)
    if max(abs(of_moved - factor), unsure) < ALIKE * factor:
        yield (
            f"at {lost.size} places both signals go {factor:.2g} times as far in one row as in those beside it: are "
            "rows missing? Record with time stamps"
        )


def _of_order(record: Record, found: Findings) -> Iterator[str]:
    """A voltage that never turns, while the displacement goes to and fro from row to row."""
    steps = np.diff(record.volts)
    if (np.all(steps >= 0.0) or np.all(steps <= 0.0)) and found.noise_um > SORTED * found.stroke_um:
        share = 100 * found.noise_um / found.stroke_um
        yield (
            f"the voltage never turns, and the displacement goes to and fro by {share:.2g} % of the stroke from row to "
            "row: are the rows sorted by the voltage? Keep them in the order in which they were measured"
        )
