"""Faults of a sensor, by what no actuator does: it stops, jumps, has single wrong rows, or is slower than the rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.records.record import Record
from truestroke.signals.noise import converter_step, noise

STOPPED = 0.25  # of its span: so far the voltage moves while the displacement keeps one value
SPIKE = 0.2  # of the peak-to-peak value: a row that is so far from those beside it
JUMP = 0.1  # of the stroke: within one row
SMALL, OTHERS = 0.01, 4.0  # the same at least, if it is so many times what nearly all rows move: fringes that were lost
MOST, SAMPLED = 99.8, 200_000  # per cent of the rows, and rows, evenly taken, that show it
BY_CHANCE = 12.0  # deviations of the noise: a step from row to row that is smaller may be noise
CONVERTED = 4.0  # steps of a converter: noise makes jumps of one or two
NAMED = 8  # rows of which a sentence says where they are, behind the first
ALONE = 10.0  # times what the rows beside it do
QUIET = 5.0  # or, where those beside it are within so many deviations of the noise
BESIDE = 2  # rows on either side
BEFORE_S, BEFORE_ROWS = 0.2, 2000  # before a jump: a step of the voltage in there explains it
EXPLAINS = 0.2  # of the jump, both over their spans: a step of the voltage that is larger
LISTED = 100  # jumps, and stops, that are looked at
FEWEST, AFTER = 20, 10  # rows of a stop, and after the voltage has moved so far: an actuator answers sooner
BLOCK = 100_000  # rows at a time
REPEATS = 0.9  # of the changes: so many are the same number of rows apart
UNLIKE = 3.0  # the large changes over the small ones: those of a coarse converter are alike
CHANGES, LONGER = 20, 5.0  # at least; and times as long as usual the longest of them are apart

Rows = npt.NDArray[np.intp]


def faults(record: Record) -> Iterator[str]:
    """A sentence for each fault of the sensor, with its evidence and the remedy."""
    yield from _of_spikes(record)
    if held(record.displacement) == 1.0:  # else it stops and jumps all the time
        yield from _of_jumps(record)
        yield from _of_stops(record)


def repeated(signal: FloatArray) -> int:
    """In every which row a signal changes: 1, or more where a slow sensor repeats its values.

    Examples
    --------
    >>> repeated(np.repeat(np.sin(np.arange(100.0)), 4))
    4
    """
    changes = signal[1:] != signal[:-1]
    if not CHANGES <= np.count_nonzero(changes) < signal.size / 2:
        return 1
    at = np.flatnonzero(changes)
    small, large = np.percentile(np.abs(signal[at + 1] - signal[at]), [10, 90])
    apart = np.diff(at)
    rows = int(np.median(apart))
    return rows if large > UNLIKE * small and np.mean(apart == rows) > REPEATS else 1


def held(signal: FloatArray) -> float:
    """For how many rows a signal keeps each value on average, also of a clock of its own; 1 where it keeps none.

    Examples
    --------
    >>> held(np.sin(np.arange(300.0))[(np.arange(300) / 2.6).astype(int)]), held(np.sin(np.arange(300.0)))
    (2.6, 1.0)
    """
    at = np.flatnonzero(signal[1:] != signal[:-1])
    apart = np.diff(at)
    if at.size < CHANGES or np.median(apart) < 2 or apart.max() > LONGER * np.median(apart):
        return 1.0
    small, large = np.percentile(np.abs(signal[at + 1] - signal[at]), [10, 90])
    return round(float(apart.mean()), 1) if large > UNLIKE * small else 1.0


def _of_stops(record: Record) -> Iterator[str]:
    """A value that stays while the voltage moves on; at the ends of the range it is clipping."""
    z, x = record.displacement, record.volts
    stays = z[1:] == z[:-1]
    ends = np.flatnonzero(stays[1:] != stays[:-1]) + 1  # of runs of rows that are, or are not, like those before
    starts = np.concatenate([[0], ends])
    rows = np.diff(np.append(starts, z.size - 1)) + 1
    still = np.flatnonzero(stays[starts] & (z[starts] > z.min()) & (z[starts] < z.max()) & (rows >= FEWEST))
    for run in still[np.argsort(-rows[still], kind="stable")][:LISTED]:
        start, volts = int(starts[run]), x[starts[run] : starts[run] + rows[run]]
        moved = float(np.ptp(volts[: rows[run] - AFTER]))
        if moved > STOPPED * np.ptp(x):
            yield (
                f"the displacement stays at {z[start]:.6g} um in {rows[run]} rows from {_at(record, start)} on, while "
                f"the voltage moves by {np.ptp(volts):.3g} V: the sensor had stopped; leave these rows out"
            )
            return


def _of_spikes(record: Record) -> Iterator[str]:
    """Single rows that are far from those beside them."""
    both = (("displacement", record.displacement, "um"), ("voltage", record.volts, "V"))
    found = {name: _spikes(signal) for name, signal, _ in both}
    for name, signal, unit in both:
        rows = found[name]
        if name == "displacement":  # a pulse of the voltage has an effect
            rows = rows[~np.isin(rows, np.add.outer(found["voltage"], np.arange(BESIDE + 1)))]
        if rows.size:
            k = int(rows[0])
            yield (
                f"the {name} is far from the rows beside it in {_rows(rows.size)}, first at {_at(record, k)}: "
                f"{signal[k]:.4g} between {signal[k - 1]:.4g} and {signal[k + 1]:.4g} {unit}{_others(record, rows)}; "
                "leave these rows out: delete them, or write NaN in them and give `drop_bad_rows`"
            )


def _others(record: Record, rows: Rows) -> str:
    """Where the other rows are, as far as a sentence can say it."""
    if rows.size < 2:
        return ""
    named = ", ".join(_at(record, k).removesuffix(" s") for k in rows[1 : NAMED + 1].tolist())
    return f", then at {named} s{' and so on' if rows.size > NAMED + 1 else ''}"


def _spikes(signal: FloatArray) -> Rows:
    """Rows of spikes, from 0."""
    least, found = SPIKE * float(np.ptp(signal)), [np.array([], dtype=np.intp)]
    for start in range(0, signal.size - 2 * BESIDE, BLOCK):
        block = signal[start : start + BLOCK + 2 * BESIDE]
        size = block.size - 2 * BESIDE
        beside = [block[k : k + size] for k in range(2 * BESIDE + 1) if k != BESIDE]
        low, high, middle = np.minimum.reduce(beside), np.maximum.reduce(beside), block[BESIDE : BESIDE + size]
        off = np.maximum(middle - high, low - middle)
        found.append(np.flatnonzero(off > np.maximum(ALONE * (high - low), least)) + start + BESIDE)
    return np.concatenate(found)


def _of_jumps(record: Record) -> Iterator[str]:
    """Jumps within a row without one of the voltage: a zero that moved, fringes or rows that were lost."""
    x, z = record.volts, record.displacement
    stroke, span = float(np.ptp(z)), float(np.ptp(x))
    deviation = noise(z, record.segments)
    least = max(SMALL * stroke, CONVERTED * converter_step(z), BY_CHANCE * deviation)
    rows, sizes, usual = _beyond(z, least)
    large = (sizes > JUMP * stroke) | (sizes > OTHERS * usual)
    found = np.setdiff1d(rows[large], [s.start - 1 for s in record.segments[1:]])
    before = min(max(10, round(BEFORE_S * record.sample_rate)), BEFORE_ROWS)
    sudden = []
    for k in found[:LISTED].tolist():
        steps = np.diff(z[k - BESIDE : k + BESIDE + 2])
        others = np.delete(steps, BESIDE)
        jump, beside = abs(steps[BESIDE] - others.mean()), np.abs(others - others.mean()).max()
        volts = np.abs(np.diff(x[max(k - before, 0) : k + 2])).max()
        alone = jump > ALONE * beside or beside < QUIET * deviation
        if alone and volts / span < EXPLAINS * jump / stroke:
            sudden.append(k + 1)
    if sudden:
        k = sudden[0]
        yield (
            f"the displacement jumps by {abs(z[k] - z[k - 1]):.3g} um from one row to the next without a jump of the "
            f"voltage, {_times(len(sudden))}, first at {_at(record, k)}: the zero of the sensor moved, fringes or rows "
            "were lost, or its counter ran over; use the rows before or after"
        )


def _beyond(signal: FloatArray, least: float) -> tuple[Rows, FloatArray, float]:
    """Rows with a step that is further than `least` from the mean of those beside it, how far, and what is usual."""
    rows, sizes, usual = [], [], []
    every = -(-signal.size // SAMPLED)
    for start in range(0, signal.size - 2 * BESIDE - 1, BLOCK):
        steps = np.diff(signal[start : start + BLOCK + 2 * BESIDE + 1])
        size = steps.size - 2 * BESIDE
        beside = [steps[k : k + size] for k in range(2 * BESIDE + 1) if k != BESIDE]
        off = np.abs(steps[BESIDE : BESIDE + size] - sum(beside) / len(beside))
        usual.append(off[::every])
        at = np.flatnonzero(off > least)
        rows.append(at + start + BESIDE)
        sizes.append(off[at])
    return np.concatenate(rows), np.concatenate(sizes), float(np.percentile(np.concatenate(usual), MOST))


def _rows(number: int) -> str:
    return f"{number} row{'' if number == 1 else 's'}"


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _at(record: Record, row: int) -> str:
    return f"{record.time[row] - record.time[0]:.4g} s"
