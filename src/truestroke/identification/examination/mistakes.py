"""Mistakes in a record, by the evidence that the record itself holds: wrong units, clocks, columns and shifts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from truestroke.base.display import figures
from truestroke.identification.examination.changes import jumped
from truestroke.identification.examination.faults import faults
from truestroke.identification.examination.findings import Findings
from truestroke.identification.records import turning
from truestroke.identification.records.record import Record
from truestroke.identification.records.shaken import in_steps, shaken
from truestroke.signals.noise import noise, rounding
from truestroke.signals.tables import RecordError

VOLTS = 0.05, 2100.0  # V: spans of the voltage; macro fibre composites take 2000 V, controllers' inputs 5 to 20 V
HIGH_VOLTS = 1250.0  # V: stacks take 1100 V at most; beyond it only composites, with at least `HIGH_GAIN`
HIGH_GAIN = 0.04  # um/V
STROKE = 0.005, 20_000.0  # um
NANOMETRES = 5e-5  # um: the smallest stroke that is stated in nm
GAIN = 1e3  # um/V
SPEED = 0.1e6  # um/s: a stack reaches it at a tenth of its own resonance; stages and amplifiers do not
FAST = ((20e3, 60e3), (100e3, 20e3))  # Hz, um/s: the same for stamps in ms or less, by sample rate
BURSTS, APART, NO_FURTHER = 20, 4.0, 2.0  # gaps, times an interval, and times a step beside it: stamps of reading
SURE = 4.0  # deviations of the noise that the voltage moves from row to row, where that is compared
SECONDS, DAYS = ("s", "min", "h", "day"), (29_221.0, 73_051.0)  # units of a second and more; days since 1900
LONGER = ("min, h or days", "min, h or day"), ("days, as of a spreadsheet", "day")
SLOW, LONG = 1.0, 9000.0  # Hz, s: stamps of no stated unit that give less than one and more than the other
LEADS = -1.5  # % of stroke: mean width of a loop that turns the wrong way round
EARLIEST = 0.25  # of a stroke: twice as far a displacement is looked for before steps
EARLY, EARLY_ROWS = 0.02, 2.5  # of a stroke, and rows, by which the displacement may be ahead of the voltage
SHIFTS = 21  # that are tried
LATE = 0.25  # of a stroke: hysteresis alone is late by 0.06 at most, an actuator with a slow sensor by 0.2
SOON = 0.5e-3  # s: amplifier, stage and sensor are late by less, however fast the strokes
TURNS = 0.04, 4.0  # the same two limits where reversals show it
PART = 16  # of a stroke, one in so many: of means that show a lead beneath such noise
COARSE = 0.008  # of the stroke: noise, or rounding to 36 steps, beyond which no single reversal shows a lead
TOGETHER = 0.7  # least correlation of voltage and displacement, and of their strokes
RINGS, RING_ABOVE = 0.3, 2.5  # of the mean square, about a line, and times the frequency of the strokes
COMMAND = 1e-5  # of the stroke: rms by which a displacement that is the voltage times a number may differ from it
ROUNDED = 1e-4  # the same at most, where the text is rounded
BEHIND = 2  # rows by which a command may be behind the voltage, and about the lag
SMOOTH = 3e-6  # of the stroke: noise that no sensor is below
ROUGHER = 5.0  # times as noisy, of its span, is the voltage
REAL = 2.0  # times what the rounding of a text does: noise that is measured

COMMANDS = ("desired", "command", "commanded", "setpoint", "set point", "target", "reference", "ref", "demand", "z_d")
MEASURED = ("measured", "displacement", "disp", "position", "pos", "stroke", "sensor")
VOLTAGES = ("volts", "volt", "voltage", "drive", "vin", "v_in")
"""Headings that say what a column is, whatever it is taken for."""


def refuse(found: Findings) -> None:
    """RecordError that names every mistake that `examine` found.

    Raises
    ------
    RecordError
        There is one.
    """
    if found.mistakes:
        reasons = "; ".join(found.mistakes)
        raise RecordError(found.source, f"{reasons}; `force` uses it all the same, and a model of it is marked")


def mistakes(record: Record, found: Findings) -> tuple[str, ...]:
    """What contradicts that this is a record of voltage and displacement of an actuator, a sentence each.

    Every sentence names its evidence. Limits are far from every correct record that is known, so that a mistake may
    pass, but a record without one does not fail.

    Parameters
    ----------
    record : Record
        The record.
    found : Findings
        What `examine` measured of it.
    """
    of_pair = (*_of_names(record), *_of_size(record, found))
    return (*record.contradictions, *of_pair, *faults(record), *_of_order(record, found))


def _of_names(record: Record) -> Iterator[str]:
    """Headings that say something else than what the column is used for."""
    names = {role: column.heading.lower().rsplit("/", 1)[-1] for role, column in record.columns.items()}
    volts, moved = names.get("volts", ""), names.get("displacement", "")
    if moved in COMMANDS:
        yield f"the displacement is the column {moved!r}: a command, not what a sensor measured"
    if volts in MEASURED or moved in VOLTAGES:
        yield f"the voltage is the column {volts!r} and the displacement {moved!r}: are they swapped?"


def _of_size(record: Record, found: Findings) -> Iterator[str]:
    """Spans, gain and speed that no actuator has: wrong units."""
    volts, stroke, gain = float(np.ptp(record.volts)), found.stroke_um, abs(found.gain_um_per_v)
    moved, of_volts = record.columns["displacement"], record.columns["volts"]
    smallest = NANOMETRES if moved.stated and moved.unit == "nm" else STROKE[0]
    spans = f"the voltage spans {figures(volts, 4)} V for {figures(stroke)} um"
    high = volts > HIGH_VOLTS and gain < HIGH_GAIN and of_volts.unit != "kV"  # a heading of kV never means mV
    if volts > VOLTS[1] or high:
        yield f"{spans}: is its unit right? If it is mV, say {of_volts.says('volts', 'mV')}"
    elif volts < VOLTS[0]:
        yield f"{spans}: is its unit right? If it is V, say {of_volts.says('volts', 'V')}"
    elif not smallest <= stroke <= STROKE[1] or gain > GAIN:
        spans = f"the displacement spans {figures(stroke)} um, {figures(gain)} um/V"
        long = stroke > STROKE[1]
        said = f"If it is nm, say {moved.says('displacement', 'nm')}" if long else f"State {moved.says('displacement')}"
        yield f"{spans}: is its unit right? {said}"
    else:
        yield from _of_clock(record, found)


def _of_clock(record: Record, found: Findings) -> Iterator[str]:
    """Time stamps that make the motion too fast, or the samples too rare."""
    speed, rate = found.rates_um_s[2], found.sample_rate_hz
    time = record.columns.get("time")
    short = time is not None and time.stated and time.unit not in SECONDS
    if speed > SPEED or (short and any(rate >= hz and speed >= um_s for hz, um_s in FAST)):
        stamps = f"time stamps ({time.heading!r} in {time.unit}) make" if time else "given sample rate makes"
        remedy = "is it right?"
        if time is not None:
            words, unit = ("s", "s") if time.unit not in SECONDS else LONGER[_of_spreadsheet(record)]
            remedy = f"are they in {words} ({'write ' * bool(time.of_file)}{time.says('time', unit)})?"
        yield (
            f"the {stamps} {found.strokes} strokes in {found.duration_s:.3g} s, at {1e-3 * speed:.3g} mm/s and "
            f"{1e-3 * rate:.4g} kHz: {remedy}"
        )
    yield from _of_reading(record)
    if time is not None and not time.stated and rate <= SLOW and found.duration_s > LONG and record.source != "arrays":
        yield (
            f"the time stamps have no unit, and in s one row would be {1 / rate:.4g} s, the record "
            f"{found.duration_s / 3600:.3g} h: are they in ms (`time_unit`), or do they count the rows (`sample_rate`)?"
        )


def _of_spreadsheet(record: Record) -> bool:
    """Whether stamps are of one day by the count of spreadsheets, from 1900 on, of the years 1980 to 2100."""
    return bool(DAYS[0] < record.time[0] and record.time[-1] < DAYS[1] and float(np.ptp(record.time)) < 1.0)


def _of_reading(record: Record) -> Iterator[str]:
    """Stamps of the instants at which a buffer was read: in a gap the voltage goes no further than in a row beside it.

    Examples
    --------
    >>> k = np.arange(500)
    >>> read = 1e-2 * (k // 10) + 1e-4 * (k % 10)
    >>> signals = [np.sin(20 * t) for t in (1e-3 * k, read)]
    >>> [len(list(_of_reading(Record.from_arrays(x, x, time=read)))) for x in signals]
    [1, 0]
    """
    ends = np.array([s.stop - 1 for s in record.segments[:-1]], dtype=np.intp)
    ends = ends[(ends > 0) & (ends < record.time.size - 2)]
    if "time" not in record.columns or ends.size < BURSTS:
        return
    steps, times = np.abs(np.diff(record.volts)), np.diff(record.time)
    gap, beside = float(steps[ends].mean()), float((steps[ends - 1] + steps[ends + 1]).mean()) / 2
    apart = float(np.median(times[ends]) / np.median(times))
    if apart < APART or gap > NO_FURTHER * beside or beside < SURE * noise(record.volts, record.segments):
        return
    first, last = record.segments[1].start, record.segments[-1].start
    rate = (last - first) / float(record.time[last] - record.time[first])
    yield (
        f"the time stamps have {ends.size} gaps, {apart:.3g} times as long as from row to row, in which the voltage "
        "moves no further than from row to row: are they of the instants at which a buffer was read? Give the sample "
        f"rate in their place (`sample_rate`), by them about {rate:.4g} Hz"
    )


def _of_order(record: Record, found: Findings) -> Iterator[str]:
    """A displacement that is not the effect of the voltage: a command, ahead of it, too late, or of something else."""
    turns = turning.reversals(record.volts, turning.STROKE * float(np.ptp(record.volts)))
    if turns.size < 4:
        return
    quiet, rough = _noises(record, found)
    rows, off = _off_line(record, found)
    digits = REAL * rounding(record.displacement) / found.stroke_um
    if off < max(COMMAND, min(digits, ROUNDED)):
        late = f" {rows} rows before" if rows > 1 else " one row before" if rows else ""
        yield (
            f"the displacement is the voltage{late} times {found.gain_um_per_v:.6g} um/V but for {off:.1g} of the "
            "stroke, without loop, lag or noise: is it the command?"
        )
        return
    if shaken(record.volts, record.displacement) > 0.0:  # loop, delay and correlation are those of the ringing
        return
    if not _together(record, found, turns):
        if ringing(record) > 0.0:  # which `rare` asks about; loop and delay are those of the ringing
            return
        yield (
            f"voltage and displacement do not move together (correlation {found.correlation:.2f}): is one of them "
            "shifted in time or at another rate, or is it the wrong column?"
        )
        return
    lead = _lead(record, found, turns)
    if lead and (jump := jumped(record, turns)):
        yield jump
    elif lead:
        shifted = "" if quiet < rough / ROUGHER else " Or is the displacement shifted in time?"
        yield f"the displacement leads the voltage, its cause ({lead}): are the columns swapped?{shifted}"
    elif quiet < SMOOTH and rough > max(
        ROUGHER * quiet, SMOOTH, REAL * rounding(record.volts) / float(np.ptp(record.volts))
    ):
        yield (
            f"the displacement has no noise ({quiet:.1g} of the stroke), the voltage has ({rough:.1g} of its span): "
            "is it the desired displacement?"
        )
    elif late := _late(record, found, turns):
        each = f"each of its values stays for {found.rows_per_value} rows. Leave out all but the first of these"
        shifted = "is it a mean over many rows, or is it shifted?" if found.rows_per_value == 1 else each
        yield f"the displacement is late by {late}, far beyond hysteresis: {shifted}"


def _noises(record: Record, found: Findings) -> tuple[float, float]:
    """Noise of displacement and voltage, of their spans."""
    return found.noise_um / found.stroke_um, noise(record.volts, record.segments) / float(np.ptp(record.volts))


def _off_line(record: Record, found: Findings) -> tuple[int, float]:
    """By how many rows the displacement follows a line in the voltage best, and its rms about that, of the stroke."""
    about = round(_rows(found)["lag"])
    tried = {*range(BEHIND + 1), *range(max(about - BEHIND, 0), max(about, 0) + BEHIND + 1)}
    return min(((rows, _off(record, rows) / found.stroke_um) for rows in sorted(tried)), key=lambda entry: entry[1])


def _off(record: Record, rows: int) -> float:
    """The same of one number of rows, um."""
    x, z = record.volts, record.displacement
    x, z = (x[: x.size - rows], z[rows:]) if rows >= 0 else (x[-rows:], z[: z.size + rows])
    if x.size < 3 or np.ptp(x) == 0.0:
        return float(np.ptp(record.displacement))
    above = x - x.mean()
    return float(np.std(z - (above @ z) / (above @ above) * above))


def _together(record: Record, found: Findings, turns: turning.Rows) -> bool:
    """Whether displacement and voltage agree, as a whole or, where it drifts, stroke by stroke."""
    strokes = np.diff(record.volts[turns]), np.diff(record.displacement[turns])
    moved = np.ptp(strokes[1]) > 0 and abs(np.corrcoef(*strokes)[0, 1]) >= TOGETHER
    return abs(found.correlation) >= TOGETHER or bool(moved)


def ringing(record: Record) -> float:
    """Frequency of a ringing that hides the motion, Hz; 0 where the displacement does not ring so.

    One line, as wide as strokes make it, has much of the displacement's mean square, far above the strokes, and below
    its half voltage and displacement move together.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> x, rung = 5 - 5 * np.cos(20 * t), 12 * np.sin(500 * t)
    >>> [round(ringing(Record.from_arrays(x, z, sample_rate=1000.0)), 1) for z in (x + rung, rung - x, x)]
    [79.5, 0.0, 0.0]
    """
    turns = turning.reversals(record.volts, turning.STROKE * float(np.ptp(record.volts)))
    rows = max(record.segments, key=lambda s: s.stop - s.start)
    size = rows.stop - rows.start
    X, Z = (np.fft.rfft((a[rows] - a[rows].mean()) * np.hanning(size)) for a in (record.volts, record.displacement))
    power = np.abs(Z) ** 2
    top = int(power.argmax())
    motion = -(-turns.size * size // (2 * record.volts.size))  # the line of two strokes, each of which shakes the stage
    if top < RING_ABOVE * motion or power[top - motion : top + motion + 1].sum() < RINGS * power.sum():
        return 0.0
    below = slice(1, top // 2)
    both = float(np.vdot(X[below], Z[below]).real)
    alike = both > TOGETHER * float(np.linalg.norm(X[below]) * np.linalg.norm(Z[below]))
    return top * record.sample_rate / size if alike else 0.0


def _lead(record: Record, found: Findings, turns: turning.Rows) -> str:
    """By what the displacement is seen to come first; empty where it does not."""
    stroke, rows = float(np.median(np.diff(turns))), _rows(found)
    if in_steps(record.volts):  # turns are somewhere in a hold, loops not closed, and rates agree a step later, too
        ahead = -_best_shift(record, -EARLIEST * stroke)
        return _by(found, ahead) if ahead > max(EARLY * stroke, EARLY_ROWS) else ""
    if found.loop_width_percent < LEADS:
        return f"the loop turns clockwise, {found.loop_width_percent:.1f} % of the stroke"
    shown = {"lag": (EARLY, EARLY_ROWS)}
    noisy = found.noise_um >= COARSE * found.stroke_um
    if not noisy:
        shown["delay"] = TURNS
    if max(rows.values()) > EARLY_ROWS:  # the other one is late
        return ""
    if noisy and rows["lag"] < -EARLY_ROWS:
        rows = {**rows, "lag": _of_means(record, stroke)}
    for name, (share, least) in shown.items():
        if rows[name] < -max(share * stroke, least):
            return _by(found, -rows[name])
    return ""


def _of_means(record: Record, stroke: float) -> float:
    """The lag, rows, of means over a part of a stroke: rates from row to row are those of noise where there is much."""
    over = max(int(stroke / PART), 1)
    sums = (np.cumsum(signal - signal.mean()) for signal in (record.volts, record.displacement))
    x, z = ((each[over:] - each[:-over]) / over for each in sums)  # a convolution takes rows times `over`
    return turning.rate_lag(x, z, int(stroke)) or 0.0


def _by(found: Findings, rows: float) -> str:
    return f"by {figures(rows)} rows, {1e3 * rows / found.sample_rate_hz:.3g} ms"


def _late(record: Record, found: Findings, turns: turning.Rows) -> str:
    """By what the displacement follows too late; empty where it does not."""
    stroke, lag = float(np.median(np.diff(turns))), _rows(found)["lag"]
    least = max(LATE * stroke, 2 * EARLY_ROWS, SOON * found.sample_rate_hz)
    if lag <= least or _best_shift(record, lag) <= least:  # the rates of a stage that rings agree a period later, too
        return ""
    return f"{1e3 * lag / found.sample_rate_hz:.4g} ms, {100 * lag / stroke:.0f} % of a stroke"


def _best_shift(record: Record, lag: float) -> float:
    """Rows up to twice the lag by which the displacement follows a line in the voltage best; below 0 it is ahead."""
    tried = np.unique(np.linspace(0.0, 2 * lag, SHIFTS).astype(int))
    return float(min(tried.tolist(), key=lambda rows: _off(record, rows)))


def _rows(found: Findings) -> Mapping[str, float]:
    """Delay and lag of the rates in rows; 0 where the record does not show them."""
    shown = {"delay": found.delay_ms, "lag": found.lag_ms}
    return {name: 0.0 if ms is None else 1e-3 * ms * found.sample_rate_hz for name, ms in shown.items()}
