"""Rows of which both signals, or the voltage, were not recorded: 0 to the last digit, or a value that stays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.examination.changes import regressors
from truestroke.identification.records import turning
from truestroke.identification.records.record import Record
from truestroke.identification.records.shaken import in_steps
from truestroke.signals.clipping import runs

UNFILLED = 20  # rows: by a sensor whose noise is more than its steps not so many are 0 to the last digit
JOINT = 0.03  # of the span: so far a signal moves from a row that was recorded to one that was not
STAYS, OF_LAG = 4, 0.7  # rows of the voltage with one value, at least, and of the lag: sooner no actuator answers
LONG = 20  # the same where nothing but the displacement speaks
JUMP = 0.1  # of the span: by which the voltage enters or leaves them within a row
ASKED = 8  # such places, those with the largest jumps
AROUND = 4000  # rows on either side that a place is compared with
NEAR = 0.12  # of a stroke: that a line goes on beyond them
BETTER = 2.0  # times smaller is the error with a line in their place,
CLEAR = 3.0  # and times larger than elsewhere without
LEAST = 0.02  # of the stroke: that error
NO_LAGS = 0.0  # rows of a stroke: by lags, smooth motion does not say what a jump does
FRO, SLOWLY = 0.25, 0.25  # of the stroke, and of a stroke's rows: the displacement goes to and fro as in motion


def of_ends(record: Record) -> Iterator[str]:
    """Both signals are at once 0, or 0 until they are at once another value, to the last digit, beneath noise too."""
    measured = np.flatnonzero((record.volts != 0) | (record.displacement != 0))
    for row, rows, of, leave in (
        (measured[-1], record.time.size - 1 - int(measured[-1]), "last", "what is behind"),
        (measured[0], int(measured[0]), "first", "what is before"),
    ):
        far = max(abs(signal[row]) / np.ptp(signal) for signal in (record.volts, record.displacement))
        if rows >= UNFILLED and far > JOINT:
            yield (
                f"both signals are 0 to the last digit in the {of} {rows} rows: were they not recorded? Leave out "
                f"{leave} {record.time[row]:.4g} s"
            )


def of_volts(record: Record, lag: float) -> Iterator[str]:
    """The voltage keeps one value, to the last digit, while the displacement moves as if it did not.

    `lag` is by how many rows the displacement follows the voltage.

    Examples
    --------
    >>> x = 5 - 5 * np.cos(np.arange(6000) / 50.0)
    >>> lost = x * (np.arange(6000) < 5000)
    >>> found = [[*of_volts(Record.from_arrays(v, x**1.1, sample_rate=1e3), 1.0)] for v in (x, lost)]
    >>> len(found[0]), found[1][0][:56]
    (0, 'the voltage keeps 0 V in 1000 rows from 5 s on, while th')
    """
    x = record.volts
    places = runs(np.concatenate([x[1:] == x[:-1], [False]]))
    places[:, 1] += 1
    places = places[places[:, 1] - places[:, 0] >= max(STAYS, OF_LAG * lag)]
    if not len(places) or in_steps(x):
        return
    turns = turning.reversals(x, turning.STROKE * float(np.ptp(x)))
    stroke = float(np.median(np.diff(turns)))
    wrong = [place for place in places.tolist() if _goes_on(record, place, stroke)] or _denied(record, places, stroke)
    if wrong:
        start, stop = max(wrong, key=lambda place: place[1] - place[0])
        besides = f", and at {len(wrong) - 1} other places" if len(wrong) > 1 else ""
        yield (
            f"the voltage keeps {x[start]:.4g} V in {stop - start} rows from {record.time[start] - record.time[0]:.4g} "
            f"s on{besides}, while the displacement moves as if it went on: was it not recorded there? Leave these "
            "rows out"
        )


def _goes_on(record: Record, place: list[int], stroke: float) -> bool:
    """Whether the displacement goes to and fro in there, as slowly as in motion: it neither creeps nor rings."""
    start, stop = place
    if stop - start < LONG:
        return False
    turns = turning.reversals(record.displacement[start:stop], FRO * float(np.ptp(record.displacement)))
    return bool(turns.size > 3 and np.median(np.diff(turns)) > SLOWLY * stroke)


def _denied(record: Record, places: npt.NDArray[np.intp], stroke: float) -> list[list[int]]:
    """Those that the voltage enters or leaves by a jump, where a line in its place explains the displacement."""
    steps = np.abs(np.diff(np.pad(record.volts, 1, mode="edge")))
    jumps = np.maximum(steps[places[:, 0]], steps[places[:, 1]])
    order = np.argsort(-jumps, kind="stable")[:ASKED]
    large = places[order[jumps[order] > JUMP * np.ptp(record.volts)]]
    return [place for place in large.tolist() if _better_by_a_line(record, place, stroke)]


def _better_by_a_line(record: Record, place: list[int], stroke: float) -> bool:
    a, b = max(place[0] - AROUND, 0), min(place[1] + AROUND, record.volts.size)
    x, z, start, stop = record.volts[a:b], record.displacement[a:b], place[0] - a, place[1] - a
    rows, line = _line(x, start, stop, max(STAYS, int(NEAR * stroke)))
    drawn, others = x.copy(), np.ones(x.size, dtype=np.bool_)
    drawn[rows] = line
    others[start : stop + int(stroke)] = False
    if np.count_nonzero(others) < 2 * stroke:
        return False
    (as_is, elsewhere), (by_line, _) = (_errors(v, z, others, rows) for v in (x, drawn))
    return as_is > max(BETTER * by_line, CLEAR * elsewhere, LEAST * float(np.ptp(record.displacement)))


def _line(x: FloatArray, start: int, stop: int, near: int) -> tuple[slice, FloatArray]:
    """Rows of a place and the line there: between what is on both sides, or on with the slope of the one there is."""
    if start > 0 and stop < x.size:
        rows = slice(start, stop)
        return rows, np.interp(np.arange(start, stop), [start - 1, stop], x[[start - 1, stop]])
    size = min(near, stop - start)
    k = np.arange(1, size + 1)
    if start > 0:
        return slice(start, start + size), x[start - 1] + k * (x[start - 1] - x[start - STAYS]) / (STAYS - 1)
    return slice(stop - size, stop), (x[stop] - k * (x[stop + STAYS - 1] - x[stop]) / (STAYS - 1))[::-1]


def _errors(x: FloatArray, z: FloatArray, fitted: npt.NDArray[np.bool_], rows: slice) -> tuple[float, float]:
    """Rms errors in some rows, and in those to which a regression is fitted, um."""
    columns = regressors(x, NO_LAGS)
    off = z - columns @ np.linalg.lstsq(columns[fitted], z[fitted], rcond=1e-10)[0]
    return float(np.sqrt(np.mean(off[rows] ** 2))), float(np.sqrt(np.mean(off[fitted] ** 2)))
