"""Whether the actuator rested at 0 V, as never moved before, when its record began: its first motion shows it."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import normal
from truestroke.identification.fitting.regression import Data, Structure, even_thresholds
from truestroke.identification.records.series import Series
from truestroke.signals.noise import noise

NEAR_ZERO = 0.02  # of the voltage range: a record that starts nearer to 0 V may start at rest
ROWS = 3000  # of the comparison at most
PLAYS, REACH = 24, 0.48  # of a start in the midst of motion; the reach in voltage ranges
FROM_REST = (16, 0.6), (16, 0.9), (32, 0.9)  # the same from rest: the first rise moves wider plays
CREEP_TIMES = (0.03, 0.3, 3.0)  # s
PADDED = 2  # rows between the motion that is supposed and the record
ANSWERED = 5.0  # lags after a step
STEPPED = 0.1  # of the range: a smaller step before the first row is not seen
CLEAR = 3 * 6**0.5  # deviations of the noise: that of a second difference by chance
LOWER = 0.15  # of the stroke: a rest at 0 V is so near the displacement at 0 V within motion


def over_motion(data: Data, guess: FloatArray, variance: float) -> float:
    """Rms error of a start at rest over that of a start in the midst of motion: below 1 the first motion shows a rest.

    Before the record either nothing is supposed, or the largest and smaller strokes down, up, or both. Each is fitted
    to the whole record; the error decides, in equal parts that of the rows until the states of the plays are known and
    that of the others. A voltage that stays at 0 V proves nothing: after motion the states of the plays are others.

    Parameters
    ----------
    data : Data
        The record.
    guess : ndarray, shape (samples,)
        A first prediction before dead time and lag, um, which asymmetry and lag follow.
    variance : float
        Of white noise of the same uncertainty, um^2: weight of the prior.

    Returns
    -------
    float
        inf where the record does not start near 0 V.
    """
    x, span = data.volts, float(np.ptp(data.volts))
    if abs(x[0]) > NEAR_ZERO * span:
        return np.inf
    data, guess = _thinned(data, guess)
    rested = min(_error(data, guess, _structure(data, n, reach, True), (), variance) for n, reach in FROM_REST)
    moved = _structure(data, PLAYS, REACH, False)
    found = min(_error(data, guess, moved, before, variance) for before in _before(x))
    return float(np.sqrt(rested / max(found, 1e-300)))


def begins_with_step(x: FloatArray) -> bool:
    """Whether the voltage jumps between the first two rows."""
    return bool(abs(x[1] - x[0]) > STEPPED * np.ptp(x))


def from_step(s: Series) -> Series:
    """The record with a row at rest at 0 V before its first, if the answer to a step from there begins with the record.

    Amplifier and actuator were at 0 V, and recording began with the motion: at the first row the displacement is that
    of 0 V, and goes faster and faster, beyond noise, towards that of the voltage. Without the row before, dead time,
    lag and creep would be at rest at a voltage at which they have not been. Of an answer that is under way the rest is
    not known.

    Examples
    --------
    >>> x = 1.0 + np.sin(np.arange(4000) / 50.0 - 0.2)
    >>> lagging = 10.0 * x - 8.0 * np.exp(-np.maximum(np.arange(4000) - 0.5, 0.0) / 4.0)
    >>> known = np.ones(4000, dtype=bool)
    >>> [from_step(Series(np.arange(4000.0), x, z, known, 1.0, "", ())).volts.size for z in (10.0 * x, lagging)]
    [4000, 4001]
    """
    x, z = s.volts, s.displacement
    span, stroke = float(np.ptp(x)), float(np.ptp(z))
    at_zero = np.abs(x) < NEAR_ZERO * span
    alike = np.abs(x - x[0]) < NEAR_ZERO * span
    alike[: 1 + int(np.argmin(alike))] = False  # but for the first rows, until the voltage has left
    if abs(x[0]) < STEPPED * span or not s.known[:3].all() or not (at_zero & s.known).any() or not alike.any():
        return s
    sign = 1.0 if x[0] > 0 else -1.0
    first, second, third = (sign * z[:3]).tolist()
    least, zero = float((sign * z[alike]).min()) - STEPPED * stroke, float(np.median(sign * z[at_zero & s.known]))
    faster = third - 2 * second + first > CLEAR * noise(z, (slice(0, z.size),))
    if not (first < second < least and faster and abs(first - zero) < LOWER * stroke):
        return s
    return dataclasses.replace(
        s,
        time=np.concatenate([[s.time[0] - 1 / s.sample_rate], s.time]),
        volts=np.concatenate([[0.0], x]),
        displacement=np.concatenate([z[:1], z]),
        known=np.concatenate([[True], s.known]),
        breaks=tuple(at + 1 for at in s.breaks),
    )


def _before(x: FloatArray) -> Iterator[tuple[float, ...]]:
    """Voltages that the actuator may have been at before the record."""
    low, high, first = float(x.min()), float(x.max()), float(x[0])
    yield (high,)
    yield ((high + first) / 2,)
    if first - low > NEAR_ZERO * (high - low):
        yield (low,)
        yield (high, low)
        yield (high, (low + first) / 2)


def _thinned(data: Data, guess: FloatArray) -> tuple[Data, FloatArray]:
    """Fewer rows, without dead time, lag and resonances: voltage and guess are as late instead."""
    late = min(round((data.delay + data.time_constant) * data.sample_rate), data.volts.size // 2)
    x, guess = (np.concatenate([np.full(late, a[0]), a[: a.size - late]]) for a in (data.volts, guess))
    fewer = -(-data.displacement.size // ROWS)
    known = data.known[::fewer].copy()
    if begins_with_step(data.volts):  # which a lag answers otherwise than a dead time
        known[: round(ANSWERED * data.time_constant * data.sample_rate / (fewer * data.every))] = False
    data = dataclasses.replace(
        data,
        volts=x,
        displacement=data.displacement[::fewer],
        known=known,
        every=fewer * data.every,
        delay=0.0,
        time_constant=0.0,
        dynamics=None,
    )
    return data, guess


def _structure(data: Data, n: int, reach: float, rested: bool) -> Structure:
    duration = data.volts.size / data.sample_rate
    times = tuple(tau for tau in CREEP_TIMES if 1 / data.sample_rate < tau < duration / 3)
    thresholds = even_thresholds(n, reach * (data.voltage_range[1] - data.voltage_range[0]))
    return Structure(thresholds=thresholds, creep_times=times, asymmetry=2, rested=rested)


def _error(data: Data, guess: FloatArray, s: Structure, before: tuple[float, ...], variance: float) -> float:
    """Mean square error, um^2, of the rows until the states of the plays are known, and as much of the others."""
    known, late, padded = data.known, data.fitted(rested=False), 0
    if before:
        padded = PADDED + len(before)
        x = np.concatenate([before, np.full(padded * data.every - len(before), data.volts[0]), data.volts])
        guess = np.concatenate([np.full(padded * data.every, guess[0]), guess])
        z = np.concatenate([np.zeros(padded), data.displacement])
        data = dataclasses.replace(data, volts=x, displacement=z)
    rows = data.columns(s, guess)[padded:]
    c = normal.solve(np.vstack([normal.reduced(rows[known]), data.prior(s).rows(variance)]))
    parts = [rows[part] for part in (known & ~late, late) if part.any()]
    return sum(normal.sum_of_squares(part, c) / len(part) for part in parts)
