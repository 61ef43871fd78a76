"""What a record holds, and what it cannot identify, before anything is fitted."""

import dataclasses
import itertools
import math

import numpy as np
import numpy.typing as npt

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.identification.examination.clipping import clipped_volts
from truestroke.identification.examination.faults import repeated
from truestroke.identification.examination.findings import PACE, VISITED, Findings, count
from truestroke.identification.examination.mistakes import mistakes, ringing
from truestroke.identification.examination.rare import implausible
from truestroke.identification.records import turning
from truestroke.identification.records.record import GAP, Record, as_record
from truestroke.identification.records.resting import moving
from truestroke.identification.records.series import MOVES
from truestroke.identification.records.shaken import shaken
from truestroke.identification.records.turning import Rows
from truestroke.signals.clipping import clipped
from truestroke.signals.noise import noise
from truestroke.signals.quiet import noise_not_followed

SAMPLED = 200_000  # rows, evenly taken, that percentiles and medians are formed of
EXCERPT = 50_000  # rows, with the most travel, in which delay and lag are sought
WHOLE, FEW_PARTS = 0.9, 6  # of the span: longer strokes have one place; and shorter ones that show their places
PARTS, SELDOM = 20, 0.1  # of the span; and the share of the rows of an even motion below which one is not visited


def examine(record: Record) -> Findings:
    """Sample rate, stroke, delay, noise, rates, gaps, clipping, and in words what the record cannot identify.

    Examples
    --------
    One sine of 2 Hz for 5 s, 36 um, that arrives 3 ms late:

    >>> t = np.arange(5000) / 1000.0
    >>> z = 18 - 18 * np.cos(4 * np.pi * np.maximum(t - 0.003, 0.0))
    >>> found = examine(Record.from_arrays(1.8 - 1.8 * np.cos(4 * np.pi * t), z, sample_rate=1000.0))
    >>> round(found.stroke_um, 2), round(found.delay_ms, 2), found.strokes
    (36.0, 3.0, 20)
    >>> found.warnings[2]
    'all strokes have about the same speed (144 um/s): the record is not informative about rate dependence'
    """
    record = as_record(record)
    x, z = record.volts, record.displacement
    span, stroke = float(np.ptp(x)), float(np.ptp(z))
    turns = turning.reversals(x, turning.STROKE * span)
    gain, offset, correlation = _line(x, z)
    cut = clipped(z, x, MOVES * span)
    level = _noise(record, cut)
    delay, lag = _delay(record, turns)
    speeds, lengths, durations = _strokes(record, turns, span)
    travel = float(np.abs(np.diff(x[turns])).sum())
    visited, mostly = _visited(x)
    findings = Findings(
        source=record.source,
        rows=x.size,
        dropped=record.dropped,
        sample_rate_hz=record.sample_rate,
        jitter_us=_jitter(record),
        duration_s=float(record.time[-1] - record.time[0]),
        gaps=tuple((s.stop - 1, float(record.time[s.stop] - record.time[s.stop - 1])) for s in record.segments[:-1]),
        voltage_v=(float(x.min()), float(x.max())),
        displacement_um=(float(z.min()), float(z.max())),
        stroke_um=stroke,
        gain_um_per_v=gain,
        offset_um=offset,
        correlation=correlation,
        loop_width_percent=_width(record, 0.0, travel, stroke, gain),
        hysteresis_percent=None if delay is None else _width(record, delay, travel, stroke, gain),
        delay_ms=None if delay is None else 1e3 * delay / record.sample_rate,
        lag_ms=None if lag is None else 1e3 * lag / record.sample_rate,
        noise_um=level,
        voltage_noise_v=noise_not_followed(x, z),
        rates_um_s=_rates(record, level),
        strokes=turns.size - 1,
        stroke_speeds_um_s=speeds,
        stroke_lengths_percent=lengths,
        stroke_durations_s=durations,
        stroke_places=_places(x[turns]),
        seldom_way_percent=_seldom_way(x[turns], np.diff(turns)),
        volts_visited_percent=visited,
        volts_mostly_v=mostly,
        states_known_s=_states_known(record),
        clipped_displacement=int(cut.sum()),
        assumed_displacement=not record.columns["displacement"].stated,
        clipped_volts=clipped_volts(x, z, noise(x, record.segments), level)[0],
        rows_per_value=repeated(z),
    )
    findings = dataclasses.replace(findings, mistakes=mistakes(record, findings))
    findings = dataclasses.replace(findings, implausible=implausible(record, findings))
    warnings = (
        *findings.mistakes,
        *findings.implausible,
        *_of_columns(findings, record),
        *_of_sampling(findings, record),
        *_of_content(findings),
    )
    return dataclasses.replace(findings, warnings=warnings)


# ---- Single quantities -----------------------------------------------------------------------------------------------


def _line(x: FloatArray, z: FloatArray) -> tuple[float, float, float]:
    """Slope, height at 0 and correlation of the straight line, without large temporary arrays."""
    mx, mz, parts = float(x.mean()), float(z.mean()), -(-x.size // SAMPLED)
    xx = xz = zz = 0.0
    for a, b in zip(np.array_split(x, parts), np.array_split(z, parts), strict=True):
        dx, dz = a - mx, b - mz
        xx, xz, zz = xx + float(dx @ dx), xz + float(dx @ dz), zz + float(dz @ dz)
    gain = xz / xx
    return gain, mz - gain * mx, xz / math.sqrt(xx) / math.sqrt(zz)


def _noise(record: Record, cut: npt.NDArray[np.bool_]) -> float:
    """Noise of the displacement, um, of rows that are not clipped; of a slow sensor, of those with a new value."""
    every = repeated(record.displacement)
    if every > 1:
        new = record.displacement[np.flatnonzero(np.diff(record.displacement)) + 1]
        return noise(new, (slice(0, new.size),))
    ends = np.flatnonzero(np.diff(cut)) + 1 if cut.any() else np.array([], dtype=np.intp)
    pieces = (
        slice(int(a), int(b))
        for s in record.segments
        for a, b in itertools.pairwise([s.start, *ends[(ends > s.start) & (ends < s.stop)], s.stop])
    )
    return noise(record.displacement, [piece for piece in pieces if not cut[piece.start]])


def _jitter(record: Record) -> float | None:
    """Deviation of the intervals between time stamps, us, evenly taken; gaps left out."""
    if "time" not in record.columns:
        return None
    every = max(1, record.time.size // SAMPLED)
    steps = record.time[1::every] - record.time[:-1:every]
    return float(1e6 * steps[steps <= GAP / record.sample_rate].std())


def _delay(record: Record, turns: Rows) -> tuple[float | None, float | None]:
    """Delay and lag in samples, from the excerpt in which the voltage travels most."""
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(record.volts[turns])))])
    starts = turns[:: max(1, turns.size // 200)]
    ends = np.minimum(starts + EXCERPT, record.volts.size - 1)
    travels = np.interp(ends, turns, travelled) - np.interp(starts, turns, travelled)
    start = int(starts[travels.argmax()])
    end, every = min(start + EXCERPT, record.volts.size), 1
    if np.count_nonzero((turns > start) & (turns < end)) < 8:  # sampled much faster than it moves
        every = max(1, record.volts.size // EXCERPT)
        start, end = 0, record.volts.size
    x, z = record.volts[start:end:every], record.displacement[start:end:every]
    inside = (turns[(turns > start) & (turns < end)] - start) // every
    inside = np.unique(np.concatenate([[0], inside, [x.size - 1]]))
    breaks = [(s.start - start) // every for s in record.segments if start < s.start < end]
    delay = turning.delay(x, z, inside, breaks)
    lag = turning.rate_lag(x, z, int(np.median(np.diff(inside)))) if not breaks else None
    return None if delay is None else every * delay, None if lag is None else every * lag


def _width(record: Record, shift: float, travel: float, stroke: float, gain: float) -> float:
    """Mean width of the loop, % of stroke, of displacement over the voltage `shift` samples before."""
    low = math.floor(shift)
    part = shift - low
    area = (1 - part) * _area(record, low) + part * _area(record, low + 1)
    return 100 * math.copysign(1.0, gain) * 2 * area / (travel * stroke)


def _area(record: Record, shift: int) -> float:
    """Integral of x dz, um V, with x `shift` samples before; without temporary arrays of the record's size."""
    total = 0.0
    for s in record.segments:
        x, z, rows = record.volts[s], record.displacement[s], max(s.stop - s.start - abs(shift), 0)
        x, z = (x[:rows], z[shift:]) if shift >= 0 else (x[-shift:], z[:rows])
        if rows > 1:  # sum of (x[k] + x[k+1]) (z[k+1] - z[k]) / 2, products of equal rows cancel
            total += 0.5 * float(x[:-1] @ z[1:] - x[1:] @ z[:-1] + x[-1] * z[-1] - x[0] * z[0])
            total -= 0.5 * float((x[0] + x[-1]) * (z[-1] - z[0]))  # the chord that closes the way
    return total


def _rates(record: Record, noise: float) -> tuple[float, float, float]:
    """Percentiles of |dz/dt| over the shortest time in which noise makes less than a twentieth of the upper ones."""
    z, n = record.displacement, record.displacement.size
    every, over = max(1, n // SAMPLED), 1
    while True:
        moved = np.abs(z[over::every] - z[: n - over : every])
        if noise * math.sqrt(2) <= 0.05 * np.percentile(moved, 90) or 20 * over > n:
            break
        over *= 2
    median, most, nearly_all = np.percentile(moved, [50, 90, 99]) * record.sample_rate / over
    return float(median), float(most), float(nearly_all)


def _strokes(record: Record, turns: Rows, span: float) -> tuple[tuple[float, float], ...]:
    """5 and 95 % of speeds, um/s, lengths, % of span, and durations, s, of the strokes, weighted by their rows.

    A gap of a day in a stroke is no motion for a day. The first and the last one are parts of longer ones: without
    them lengths and durations, where that leaves some.
    """
    seconds, rows = np.diff(record.time[turns]), np.diff(turns).astype(np.float64)
    speeds = np.abs(np.diff(record.displacement[turns])) / seconds
    lengths = 100 * np.abs(np.diff(record.volts[turns])) / span
    whole = slice(1, -1) if seconds.size >= FEW_PARTS else slice(None)
    of_whole = (_weighted(values[whole], rows[whole]) for values in (lengths, seconds))
    return _weighted(speeds, rows), *of_whole


def _places(turns: FloatArray) -> float | None:
    """How far strokes of one length are apart, over what the span lets them be; of `turns` of the voltage, V.

    Lengths over `WHOLE` of the span are all at one place. The first and the last stroke are parts of longer ones, or
    lead from 0 V to where the motion is, and back: the span is that of the others.
    """
    inner = turns[1:-1]
    if inner.size <= FEW_PARTS:
        return None
    ends = (inner - inner.min()) / np.ptp(inner)
    length, middle = np.abs(np.diff(ends)), (ends[1:] + ends[:-1]) / 2
    length, middle = length[length < WHOLE], middle[length < WHOLE]
    if length.size < FEW_PARTS:
        return None
    columns = np.vander(length, 3)
    off = middle - columns @ np.linalg.lstsq(columns, middle, rcond=1e-9)[0]
    return float(np.std(off) / np.sqrt(np.mean((1 - length) ** 2) / 12))


def _seldom_way(turns: FloatArray, rows: Rows) -> float:
    """Share of the rows of strokes up or down, whichever has fewer, %; of `turns` of the voltage, V, and their rows."""
    up = int(rows[np.diff(turns) > 0].sum())
    return float(100 * min(up, rows.sum() - up) / rows.sum())


def _visited(x: FloatArray) -> tuple[float, tuple[float, float] | None]:
    """Share of `PARTS` of the span with more than `SELDOM` of the rows of an even motion, %; where these are, V.

    The second where they lie side by side. Long rests are no motion.
    """
    rows, edges = np.histogram(x[moving(x)], PARTS, (float(x.min()), float(x.max())))
    places = np.flatnonzero(rows > SELDOM * rows.sum() / PARTS)
    whole = float(edges[places[0]]), float(edges[places[-1] + 1])
    return 100 * places.size / PARTS, whole if places[-1] - places[0] + 1 == places.size else None


def _weighted(values: FloatArray, weights: FloatArray) -> tuple[float, float]:
    order = values.argsort()
    share = np.cumsum(weights[order]) / weights.sum()
    low, high = (values[order[min(int(np.searchsorted(share, p)), values.size - 1)]] for p in (0.05, 0.95))
    return float(low), float(high)


def _states_known(record: Record) -> float:
    """Time from the start until the voltage has been within 1 % of both its ends, s."""
    x, margin = record.volts, 0.01 * np.ptp(record.volts)
    row = max(int(np.argmax(x <= x.min() + margin)), int(np.argmax(x >= x.max() - margin)))
    return float(record.time[row] - record.time[0])


# ---- In words --------------------------------------------------------------------------------------------------------


def _ordinal(number: int) -> str:
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def _of_columns(found: Findings, record: Record) -> list[str]:
    """Whether voltage and displacement are plausible as such."""
    says = []
    if assumed := [f"{c.heading} in {c.unit}" for c in record.columns.values() if not c.stated]:
        says.append(f"the units are not stated and assumed: {', '.join(assumed)}")
    moved, volts = record.columns["displacement"], record.columns["volts"]
    if volts.besides:
        says.append(
            f"the voltage is the column {volts.heading!r}, and {', '.join(map(repr, volts.besides))} not in use: name "
            "the one that a controller or a waveform is to put out (`volts`)"
        )
    if moved.other:
        says.append(
            f"{moved.heading!r} is in {moved.other}, and um are what the scale makes of it; with a scale of 1, um "
            f"stands for {moved.other} here"
        )
    if found.mistakes:  # which say the rest
        return says
    for name, size, least, largest, unit in (
        ("displacement", found.stroke_um, 0.1, 2000.0, "um"),
        ("voltage", found.voltage_v[1] - found.voltage_v[0], 0.05, 1500.0, "V"),
    ):
        if not least <= size <= largest:
            says.append(f"the {name} moves by {size:.3g} {unit}, unlikely for a piezo actuator: is its unit right?")
    if not 1e-3 <= abs(found.gain_um_per_v) <= 1e3 and not says:
        says.append(f"the gain is {found.gain_um_per_v:.3g} um/V, unlikely for a piezo actuator: are the units right?")
    rings = shaken(record.volts, record.displacement)
    if rings > 0:  # loop and correlation are those of the ringing
        return says
    if found.loop_width_percent < -0.5:
        says.append("the displacement leads the voltage (its loop turns clockwise): are the columns swapped?")
    if abs(found.correlation) < 0.7 and not ringing(record):
        correlation = f"correlation {found.correlation:.2f}"
        says.append(f"voltage and displacement hardly move together ({correlation}): wrong column?")
    elif found.gain_um_per_v < 0 or rings < 0:
        remedy = (
            "leave out `flip_displacement`" if record.flipped else "turn its sign before fitting (`flip_displacement`)"
        )
        says.append(f"the displacement falls as the voltage rises: {remedy}")
    return says


def _of_sampling(found: Findings, record: Record) -> list[str]:
    """What sampling, gaps and clipping spoil."""
    says = []
    if found.dropped:
        says.append(f"{count(found.dropped, 'row')} without usable numbers or time stamps left out")
    if found.gaps:
        longest = max(seconds for _, seconds in found.gaps)
        gaps = f"{count(len(found.gaps), 'gap')}, the longest {longest:.3g} s"
        says.append(f"{gaps}: the plays' states are unknown after each")
    if found.clipped_displacement:
        says.append(f"the displacement is clipped in {found.clipped_displacement} rows: they are not fitted")
    if found.clipped_volts:
        says.append(f"the voltage seems clipped in {found.clipped_volts} rows, while the displacement moves on")
    if (every := found.rows_per_value) > 1:
        new = f"the displacement has a new value in every {_ordinal(every)} row only"
        says.append(f"{new}: the sensor is slower than the record, and {every} rows are one measurement")
    if found.jitter_us is None:
        stamps = record.unused or "there are no time stamps"
        stroke = f"by it a stroke takes {figures(found.duration_s / found.strokes)} s"
        says.append(f"{stamps}: jitter and gaps cannot be measured, the given sample rate is used; {stroke}")
    elif (error := 1e-6 * found.jitter_us * found.rates_um_s[1]) > max(found.noise_um, 1e-3 * found.stroke_um):
        says.append(
            f"jitter of the time stamps makes errors of about {error:.2g} um at {figures(found.rates_um_s[1])} um/s"
        )
    per_stroke = record.time.size / found.strokes
    if per_stroke < 10:
        says.append(f"a stroke has only {per_stroke:.1f} samples on average: turning points are missed")
    if found.noise_um > 0.01 * found.stroke_um:
        says.append(f"noise is {100 * found.noise_um / found.stroke_um:.1f} % of the stroke")
    if found.voltage_noise_v:
        share = found.voltage_noise_v / (found.voltage_v[1] - found.voltage_v[0])
        noise = f"the voltage has noise of {found.voltage_noise_v:.2g} V, {100 * share:.2g} % of its span"
        says.append(f"{noise}, that the displacement does not follow: it was measured, and is fitted without its noise")
    return says


def _of_content(found: Findings) -> list[str]:
    """What the motion cannot identify."""
    says = []
    if found.strokes < 3:
        says.append(f"only {count(found.strokes, 'stroke')} of the voltage: a loop needs three (up, down, up)")
    else:
        slow, fast = found.stroke_speeds_um_s
        if fast < 2 * slow:
            same = f"all strokes have about the same speed ({figures(fast)} um/s)"
            says.append(f"{same}: the record is not informative about rate dependence")
        elif found.stroke_durations_s[1] < PACE * found.stroke_durations_s[0]:
            same = f"all strokes take about as long ({found.stroke_durations_s[1]:.3g} s)"
            says.append(f"{same}: speed is not distinguished from length, nor rate dependence from a wider hysteresis")
        if found.one_length:
            long = found.stroke_lengths_percent[1]
            says.append(f"all strokes are about as long ({long:.0f} % of the span): inner loops are not tested")
        elif found.one_family:
            says.append("strokes of one length are at one voltage: inner loops elsewhere are not tested")
        if found.volts_visited_percent < VISITED:
            says.append(
                f"{found.narrow}: the curve beside that is hardly tested"
                if found.narrow
                else "the voltage is at few levels: the curve between them is not tested"
            )
    delay, lag = found.delay_ms, found.lag_ms  # delay and hysteresis both make the lag
    if delay is not None and lag is not None and delay > lag + 2e3 / found.sample_rate_hz:
        both = f"{delay:.3g} ms, most motion by {max(lag, 0.0):.3g} ms"
        says.append(f"the reversals are late by {both}: that is no dead time; `identify` compares it with a lag")
    if found.delay_ms is None and found.strokes >= 3:
        says.append("too few clean reversals to separate the delay from hysteresis")
    if abs(found.loop_width_percent) < 0.3:
        says.append("there is hardly a loop: is the displacement a command, or that of a closed loop?")
    if found.duration_s < 300:
        says.append(f"{found.duration_s:.3g} s are too short for creep slower than about {found.duration_s / 3:.2g} s")
    return says
