"""What an actuator does not do in the course of a record: another gain, a delay that jumps, a way back by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.identification.fitting.regression import plays
from truestroke.identification.records import turning
from truestroke.identification.records.record import Record
from truestroke.signals.noise import noise

ROWS = 12_000  # evenly taken, that are looked at
STROKES = 2000  # the same
FEWEST = 12  # strokes
THRESHOLDS = 0.03, 0.08, 0.15, 0.25, 0.4  # of the span: plays of a hysteresis of any kind
LAGS, LONGEST = 9, 0.25  # of the voltage, each twice the one before, and the longest, of a stroke
BACK = 0.01, 3.0  # of the way to its mean by which the displacement goes back in a stroke
BY_ITSELF = 2.2  # times smaller is the residual with such a way back; 1.9 at most in correct records
UNKNOWN = 1  # strokes at the start, of another history than all later ones
HIDDEN = 0.15  # of the mean square of the noise: less of a residual is not seen beside it
GAIN, SURE = 0.07, 2.5  # of the gain, and times smaller are the squares with two gains; correct records: not both
SHOWS, SCATTERS = 0.03, 0.4  # of the gain: what two explain beyond all else, rms; and of the change, their residual
HATS = 5  # functions of the length of a stroke
FREE = 5  # strokes more than numbers that are fitted to them
BY_FEW = 45.0  # Fisher's F of the second gain: few strokes make 42 by chance, another actuator 52 and more
DRIFTS = 1.2  # times the squares of a step that a gain leaves which drifts from some stroke on, where it is a step
STEADILY = -1  # in place of a stroke: the gain changes throughout
RAMP_SURE, RAMP_SHOWS = 1.5, 0.012  # as `SURE` and `SHOWS`: a ramp has half the rms of a step
RAMP_BY_FEW = 40.0  # as `BY_FEW`: a ramp has no place that chance could find
OF_ITS_OWN = 0.5  # of the squares of a ramp: where strokes get longer, a ramp of the gain may be that of the length
MIDDLE = 0.15, 0.85  # of the strokes: a change before or after is that of a start or an end
PLACES = 60  # in between at which a change is looked for: beside its stroke a change is not seen
PARTS = 8  # of the record, each with a delay of its own
JUMP, JUMP_ROWS = 0.04, 4.0  # of a stroke, and rows
ALIKE = 0.15  # of a jump: so much do the delays on either side differ at most
SEEN = 0.1  # correlation of rates, of each part
STEADY = 0.2  # of a delay's drift: so far the parts are from a line at most
BETTER = 1.5  # times smaller is the residual without the jump


def changed(record: Record) -> Iterator[str]:
    """A sentence for each, with its evidence and the remedy."""
    turns = turning.reversals(record.volts, turning.STROKE * float(np.ptp(record.volts)))
    if turns.size > FEWEST:
        fitted = _fitted(record, turns)
        yield from _of_way_back(fitted, noise(record.displacement, record.segments))
        yield from [*_of_delay(record, fitted), *_of_clocks(record, fitted)][:1] or _of_gain(record, turns)


def jumped(record: Record, turns: turning.Rows) -> str:
    """The sentence on a delay that jumps; empty where none does."""
    return next(_of_delay(record, _fitted(record, turns)), "") if turns.size > FEWEST else ""


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Rows of a record, and what a regression predicts of them."""

    volts: FloatArray
    displacement: FloatArray
    columns: FloatArray
    predicted: FloatArray
    every: int  # rows of the record for one
    stroke: float  # rows of a stroke
    row: float  # s

    @cached_property
    def delays(self) -> FloatArray | None:
        """Rows by which the displacement follows the prediction in each part; None where it is not seen."""
        return _delays(self.predicted, self.displacement, self.stroke)


def _fitted(record: Record, turns: turning.Rows) -> _Fitted:
    every = -(-record.volts.size // ROWS)
    x, z = record.volts[::every], record.displacement[::every]
    stroke = max(float(np.median(np.diff(turns))) / every, 1.0)
    columns = regressors(x, stroke)
    predicted = columns @ np.linalg.lstsq(columns, z, rcond=1e-10)[0]
    return _Fitted(x, z, columns, predicted, every, stroke, every / record.sample_rate)


def regressors(x: FloatArray, stroke: float) -> FloatArray:
    """Of a regression that describes most actuators to 1 to 3 %: a drift, a curve, plays, and lags."""
    span, low, n = float(np.ptp(x)), float(x.min()), x.size
    lags = [1]
    while len(lags) < LAGS - 1 and 2 * lags[-1] <= LONGEST * stroke:
        lags.append(2 * lags[-1])
    v = (x - x.mean()) / span
    delayed = [np.concatenate([np.full(lag, v[0]), v[:-lag]]) for lag in lags if lag <= LONGEST * stroke]
    H = plays(x - low, tuple(share * span for share in THRESHOLDS)) / span
    return np.column_stack([np.ones(n), np.linspace(-0.5, 0.5, n), v, v**2, v**3, H, *delayed])


def _of_way_back(fitted: _Fitted, quiet: float) -> Iterator[str]:
    """Behind a high pass the displacement loses a share of its distance from the mean in each row.

    Residuals are compared beside the noise, um, which neither regression explains.
    """
    z = fitted.displacement
    more = np.column_stack([fitted.columns, np.cumsum(z - z.mean()) / z.size])
    c = np.linalg.lstsq(more, z, rcond=1e-10)[0]
    share, least = -float(c[-1]) / z.size * fitted.stroke, float(np.std(z - more @ c))
    without = math.sqrt(max(float(np.var(z - fitted.predicted)) - quiet**2, 0.0))
    least = math.sqrt(max(least**2 - quiet**2, HIDDEN * quiet**2))
    if BACK[0] < share < BACK[1] and without > BY_ITSELF * max(least, 1e-9 * float(np.ptp(z))):
        yield (
            "the displacement goes back towards its mean by itself, with a time constant of about "
            f"{fitted.row * fitted.stroke / share:.3g} s, as no actuator does: is its sensor or recorder AC-coupled? "
            "Record with DC coupling"
        )


def _of_delay(record: Record, fitted: _Fitted) -> Iterator[str]:
    """One channel has lost rows, or has some twice: from then on the displacement is later or earlier."""
    jump = _jump(fitted)
    if jump is not None:
        rows, at = jump
        later = "later" if rows > 0 else "earlier"
        yield (
            f"from about {_time(record, at * fitted.every):.4g} s on the displacement is {later} by about "
            f"{abs(rows) * fitted.every} rows, {1e3 * abs(rows) * fitted.row:.3g} ms, than before: did one channel "
            "lose rows? Use the rows before or after"
        )


def _jump(fitted: _Fitted) -> tuple[int, int] | None:
    """Rows by which the delay jumps, and the row at which it does; None where it is the same throughout."""
    x, z, stroke, delays = fitted.volts, fitted.displacement, fitted.stroke, fitted.delays
    if delays is None:
        return None
    best: tuple[float, float, int] | None = None
    for k in range(2, PARTS - 1):
        sides = delays[:k], delays[k:]
        middles = [float(np.median(side)) for side in sides]
        apart = max(float(np.abs(side - middle).mean()) for side, middle in zip(sides, middles, strict=True))
        jump = middles[1] - middles[0]
        if best is None or abs(jump) - 2 * apart > abs(best[0]) - 2 * best[1]:
            best = jump, apart, k
    if best is None or abs(best[0]) < max(JUMP * stroke, JUMP_ROWS) or best[1] > ALIKE * abs(best[0]):
        return None
    rows, at = round(best[0]), best[2] * (x.size // PARTS)
    return (rows, at) if _explains(x, z, rows, at, stroke) else None


def _delays(predicted: FloatArray, z: FloatArray, stroke: float) -> FloatArray | None:
    """By how many rows the rate of the displacement follows that of the prediction in each part; None if not seen."""
    from scipy.signal import correlate

    over = max(1, int(stroke) // 64)
    rates = predicted[over:] - predicted[:-over], z[over:] - z[:-over]
    size = rates[0].size // PARTS
    reach = int(min(3 * stroke, size // 3))
    if reach < JUMP_ROWS:
        return None
    found = []
    overlap = size - np.abs(np.arange(-reach, reach + 1))
    for start in range(0, size * PARTS, size):
        of_model, of_record = (rate[start : start + size] - rate[start : start + size].mean() for rate in rates)
        c = correlate(of_record, of_model, mode="full", method="fft")[size - 1 - reach : size + reach] / overlap
        spread = float(np.std(of_model) * np.std(of_record))
        if spread == 0.0 or c.max() < SEEN * spread:
            return None
        found.append(float(c.argmax()) - reach)
    return np.array(found)


def _explains(x: FloatArray, z: FloatArray, rows: int, at: int, stroke: float) -> bool:
    """Whether the regression fits better with the later part moved back; the part in which it may be is left out."""
    half, n = x.size // PARTS // 2, x.size
    kept = np.ones(n, dtype=np.bool_)
    kept[max(at - half, 0) : at + half + abs(rows)] = False
    kept[n - abs(rows) :] = False
    moved = np.concatenate([z[:at], np.roll(z, -rows)[at:]])
    columns = regressors(x, stroke)[kept]
    left = [float(np.std(y - columns @ np.linalg.lstsq(columns, y, rcond=1e-10)[0])) for y in (z[kept], moved[kept])]
    return left[0] > BETTER * left[1]


def _of_clocks(record: Record, fitted: _Fitted) -> Iterator[str]:
    """The delay grows or shrinks steadily: the channels have clocks of their own."""
    delays = fitted.delays
    if delays is None:
        return
    slope, first = np.polyfit(np.arange(PARTS), delays, 1)
    drift, off = float(slope) * PARTS, float(np.abs(delays - first - slope * np.arange(PARTS)).max())
    if abs(drift) > max(JUMP * fitted.stroke, JUMP_ROWS) and off < STEADY * abs(drift):
        rate = 1e6 * abs(drift) / fitted.volts.size
        way = "later" if drift > 0 else "earlier"
        yield (
            f"the displacement gets {way} and {way}, by {figures(abs(drift) * fitted.every)} rows in the whole record "
            f"({figures(rate, 2)} millionths): do the channels have clocks of their own? Record both by one clock"
        )


def _of_gain(record: Record, turns: turning.Rows) -> Iterator[str]:
    """The gain of strokes changes steadily, or is another one from a stroke on."""
    turns = turns[UNKNOWN:]
    first = turns[:-1][:: -(-(turns.size - 1) // STROKES)]
    last = turns[1:][:: -(-(turns.size - 1) // STROKES)]
    x, span = record.volts, float(np.ptp(record.volts))
    way, length = x[last] - x[first], np.abs(x[last] - x[first]) / span
    gain = (record.displacement[last] - record.displacement[first]) / way * length  # weighted with the length
    usual = _usual(record, first, last)
    alone, (squares, k, more) = _squares(usual, gain)[0], _change(usual, gain, length)
    gains, all_of_it = gain / length, float(np.sum(length**2))
    before = float(np.median(gains) - more / 2 if k == STEADILY else np.median(gains[:k]))
    if before == 0.0:  # most strokes are beyond the end of the sensor's range
        return
    share, free = more / before, gain.size - usual.shape[1] - 1
    sure, least, by_few = (RAMP_SURE, RAMP_SHOWS, RAMP_BY_FEW) if k == STEADILY else (SURE, SHOWS, BY_FEW)
    shown = math.sqrt(max(alone - squares, 0.0) / all_of_it) > least * abs(before)  # beyond what lengths explain, too
    if not (
        abs(share) > GAIN
        and alone > sure * squares
        and shown
        and free >= FREE
        and (alone - squares) * free > by_few * squares
        and math.sqrt(squares / free * gain.size / all_of_it) < SCATTERS * abs(more)
        and (k == STEADILY or _drifts(usual, gain, length) > DRIFTS * squares)
    ):
        return
    if k == STEADILY:
        yield (
            f"in the end strokes have {100 * (1 + share):.0f} % of the gain of the beginning, and it changes steadily: "
            "does the sensor, the amplifier or the actuator warm up? Record when it has"
        )
        return
    yield (
        f"from about {_time(record, int(first[k])):.4g} s on strokes have {100 * (1 + share):.0f} % of the gain of "
        "before: is it another actuator, load, or range of the sensor? Identify each part by itself"
    )


def _usual(record: Record, first: turning.Rows, last: turning.Rows) -> FloatArray:
    """Columns of what length, place, direction and speed make of the gain of strokes, times their lengths.

    Behind a lag a stroke that takes T ends short of its end by a share that falls with T.
    """
    x, span = record.volts, float(np.ptp(record.volts))
    way = x[last] - x[first]
    length, place, side = np.abs(way) / span, (x[last] + x[first]) / 2 / span - float(x.mean()) / span, np.sign(way)
    quick = 1.0 / (last - first)
    long = np.maximum(1 - np.abs((HATS - 1) * length[:, None] - np.arange(HATS)), 0.0)  # piecewise linear
    return np.column_stack([long, place, place**2, side, side * length, quick, quick**2]) * length[:, None]


def _change(usual: FloatArray, gain: FloatArray, length: FloatArray) -> tuple[float, int, float]:
    """The change of the gain that explains most: squares beside it, from which stroke on or `STEADILY`, its size."""
    middles = np.unique(np.linspace(MIDDLE[0] * gain.size, MIDDLE[1] * gain.size, PLACES).astype(int)).tolist()
    ramp, best = np.linspace(0.0, 1.0, gain.size) * length, (math.inf, 0, 0.0)
    own = _squares(usual, ramp)[0] > OF_ITS_OWN * _squares(length[:, None], ramp)[0]
    for k in (STEADILY, *middles) if own else middles:
        since = ramp if k == STEADILY else (np.arange(gain.size) >= k) * length
        squares, c = _squares(np.column_stack([usual, since]), gain)
        best = min(best, (squares, k, float(c[-1])))
    return best


def _drifts(usual: FloatArray, gain: FloatArray, length: FloatArray) -> float:
    """Squares beside a gain that changes steadily from some stroke on, at the place that explains most."""
    middles = np.unique(np.linspace(0.0, gain.size - 2, 24).astype(int)).tolist()
    ways = (np.maximum(np.arange(gain.size) - k, 0.0) * length for k in middles)
    return min(_squares(np.column_stack([usual, way]), gain)[0] for way in ways)


def _squares(columns: FloatArray, y: FloatArray) -> tuple[float, FloatArray]:
    c = np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    return float(np.sum((y - columns @ c) ** 2)), np.asarray(c)


def _time(record: Record, row: int) -> float:
    return float(record.time[row] - record.time[0])
