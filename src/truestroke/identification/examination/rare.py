"""What no law of physics forbids in a record, but is rare in a correct one: it makes a model doubtful, not refused."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.identification.examination import slew
from truestroke.identification.examination.changes import changed
from truestroke.identification.examination.clipping import clipped_volts
from truestroke.identification.examination.findings import Findings
from truestroke.identification.examination.mistakes import LONG, SECONDS, SMOOTH, TOGETHER, ringing
from truestroke.identification.examination.mistakes import SLOW as SLOWEST
from truestroke.identification.examination.rows import rewritten
from truestroke.identification.examination.unrecorded import of_volts
from truestroke.identification.records import turning
from truestroke.identification.records.record import Record
from truestroke.identification.records.series import to_and_fro
from truestroke.signals.clipping import runs
from truestroke.signals.columns import Column
from truestroke.signals.noise import converter_step, noise, rounding

SOON, TARDY = 50e-6, 0.1  # s: an amplifier or a sensor is later than the first, none is later than the second
AHEAD = 2.5, 1.0  # rows by which reversals and rates of the displacement are both before the voltage's
SHOWN = 0.25  # rows: to which reversals show a delay
BY_NOISE = 2.0  # times the noise as a share of the stroke, of the time of a stroke: so late noise lets a turn seem
SLOW = 200.0  # Hz: few records of `LONG` s of motion are slower; one of 10 s in ms that are taken for s is
ALIASED = 3.5  # rows in a stroke; correct records of noise have 5 at least
COUNTED = 1000  # stamps or values that are looked at
STRAIGHT = 0.5  # % of the stroke that a linear filter leaves: actuators leave 1 to 8, set-points of a loop 0.36 at most
STRAIGHT_ALIKE = 0.2  # the same of strokes that are alike: a filter explains most of the loop of one sine
FILTER = 9, 0.25  # lags of the filter at most, each twice the one before, and the longest, of a stroke
ROWS = 50_000  # that it is fitted to
NOISY = 1.0  # % of the stroke: with more noise that difference is not seen
SMALL, LARGE = 0.1, 2000.0  # um: strokes that are rather written in nm, and in mm
OF_STAGE = 40.0, 20e3  # um/V, um/s: amplified stages and benders of more than `LARGE` do no more; nm of a stack do
PLATE, SHORT = 1e-3, 0.01  # um/V of a single plate at most, and um: strokes so short are measured with little noise
QUIET, QUIETEST = 2e-4, 3e-5  # um: noise of few sensors, and of hardly any
STRONG = 150.0  # um/V: few actuators move further by the signal that controls their amplifier
MILLIVOLTS = 1.5, 50.0  # V, um/V: few actuators go so far with so little
TINY = 0.15  # V: few amplifiers are driven by so little, however short the stroke
WEAK = 2e-4  # um/V: less than of a single plate
MONITOR = re.compile(r"\bmon(itor)?\b|[_ ]mon(itor)?([_ ]|$)|^mon", re.IGNORECASE)
CONVERTER = 10.5  # V: most converters of a sensor end at 10
EXPLAINED_BY_SLEW = 0.7  # of what is not explained without: with a slew rate of the amplifier it is below
LIMITED, FREE = 0.012, 2.0  # of the rows at one largest speed, and times the voltage's speeds differ in them
NEAR_TOP, FEWEST_AT_TOP = 0.05, 20  # of that speed, and rows
BITS = range(10, 19)  # of a converter of 20 V
ON_STEP, ON_STEPS = 0.1, 0.99  # of a step: a value on it, but for the digits of a text; and share of the values
WHOLE = 100  # different values, all of them whole numbers
NORMALISED = (0.0, 1.0), (0.0, 100.0), (-1.0, 1.0)  # which no sensor with noise hits at both ends
OF_ONE = (0.0, 1.0)  # V: the same of a voltage; many go from 0 to 100 V, or from -1 to 1 V
ABOVE_STEPS = 2.0  # steps of the converter: with more noise a sensor does not keep one value
LEVEL = 8.0  # times the noise: so wide is a level at which a signal stays
TO_AND_FRO = 8.0  # deviations of the noise: so far that of many rows goes to and fro
FLATTER, TURNED = 2.5, 0.025  # times what the level is of the span, and of its span, the other signal goes on meanwhile
CUT = 0.01  # of the rows
BURST, FEWEST_BURSTS = 50, 20  # rows on average in a burst, at most, and bursts
ONE_WAY = 5.0  # % of the rows: few of one direction; a flyback takes 10, a triangle 50
BY_CHANCE = 0.01  # of the deviation that noise alone makes of a mean: nearer to 0 no measured one is
COARSE, NEXT = 0.004, 0.9  # of the span: a step of the voltage; and share of its changes that are of one step
HELD, FEWEST_STEPS = 4, 20  # rows between two changes of one direction; and so many of these
EVENLY, ALONG_STEP = 0.35, 0.5  # of the way between two changes, in its second half; and that way over a step's
NO_MEAN = 1e-6  # of its span: the mean of a voltage of which it was taken off


def implausible(record: Record, found: Findings) -> tuple[str, ...]:
    """What does not contradict the record, but is rare if it is right, a sentence each with its evidence.

    Examples
    --------
    >>> from truestroke.identification import examine
    >>> t = np.arange(2000) / 1000.0
    >>> x = 5 - 5 * np.cos(20 * t)
    >>> z = x + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    >>> examine(Record.from_arrays(x, z, sample_rate=1000.0)).implausible[0][:50]
    'a linear filter of the voltage leaves 0.003 % of t'
    """
    if found.mistakes:
        return ()
    of_file = record.source not in ("arrays", "recording")
    unrecorded = (*of_volts(record, 1e-3 * (found.lag_ms or 0.0) * found.sample_rate_hz),)
    units = (*_of_clock(record, found), *_of_units(record, found)) if of_file else ()
    of_signals = (
        *_of_sampling(record, found),
        *_of_bursts(record, found),
        *_of_lead(record, found),
        *_of_means(record, found),
        *_of_hysteresis(record, found),
        *_of_levels(record, found),
        *_of_steps(record, found),
        *(() if unrecorded else _of_slew(record, found)),  # a displacement that moves under no voltage seems to slew
        *_of_ringing(record, found),
        *rewritten(record, found),
        *unrecorded,
    )
    return (*units, *of_signals, *changed(record))


def _of_clock(record: Record, found: Findings) -> Iterator[str]:
    """Of time stamps or sample rate, the first evidence."""
    time = record.columns.get("time")
    texts = [*_of_turns(record, found)]
    if not texts and time is not None and not time.asked:
        texts += _of_stamps(record, found, time.heading)
    yield from texts


def _of_turns(record: Record, found: Findings) -> Iterator[str]:
    """An actuator with amplifier and sensor turns later than its voltage, by tens of us to tens of ms."""
    time, delay = record.columns.get("time"), found.delay_ms
    if delay is None:
        return
    late, row = 1e-3 * delay, 1 / found.sample_rate_hz
    stamps = f"the time stamps ({time.heading!r} in {time.unit})" if time else "the given sample rate"
    if time is not None and time.unit != "s" and abs(late) + SHOWN * row < SOON:
        turns = f"within {figures(1e6 * (abs(late) + SHOWN * row), 2)} us of the voltage, before most amplifiers do"
        yield f"the displacement turns {turns}: are {stamps} in s? {_stated(time, 's')}"
    elif late > max(TARDY, SHOWN * row, BY_NOISE * found.noise_um / found.stroke_um * found.duration_s / found.strokes):
        turns = f"{late:.2g} s later than the voltage, as hardly any does"
        if time is None:
            yield f"the displacement turns {turns}: is {stamps} of {record.sample_rate:g} Hz in kHz?"
        else:
            finer = "ms" if time.unit in SECONDS else "a smaller unit"
            yield f"the displacement turns {turns}: are {stamps} in {finer}? {_stated(time, finer)}"


def _of_stamps(record: Record, found: Findings, heading: str) -> Iterator[str]:
    """Stamps said to be in s that count the rows, or make a record of hours out of few rows."""
    rate, time = found.sample_rate_hz, record.columns["time"]
    if not time.stated and rate <= SLOWEST:
        yield (
            f"the time stamps ({heading!r}) have no unit, and in s one row is {1 / rate:.4g} s: are they in ms, or do "
            "they count the rows? State the unit (`time_unit` s if it is that), or the sample rate (`sample_rate`)"
        )
        return
    if np.all(np.diff(record.time[:COUNTED]) == 1.0):
        yield (
            f"the time stamps ({heading!r}) are one apart each: do they count the rows? State the sample rate "
            "(`sample_rate`), or their unit (`time_unit`)"
        )
        return
    moved = found.duration_s - sum(seconds for _, seconds in found.gaps)
    if moved > LONG and rate < SLOW and found.strokes >= 4:
        yield (
            f"the time stamps ({heading!r}) make {found.strokes} strokes in {moved / 3600:.3g} h, one row each "
            f"{1 / rate:.3g} s: are they in ms? {_stated(time, 'ms')}"
        )


def _stated(time: Column, unit: str) -> str:
    """How stamps are corrected: a sample rate or a unit of the caller would be refused against the unit of the file."""
    return f"If so, write {time.says('time', unit)}" if time.of_file else "State the sample rate (`sample_rate`)"


def _of_sampling(record: Record, found: Findings) -> Iterator[str]:
    """So few rows in a stroke, or in those of one direction, that the motion is faster than they show."""
    rows = record.time.size / found.strokes
    if found.strokes >= 4 and rows < ALIASED:
        yield (
            f"a stroke has {figures(rows, 2)} rows on average: is the motion faster than the samples show it "
            "(aliasing)? Sample ten times in a stroke, or move more slowly"
        )
    if found.strokes >= 4 and found.seldom_way_percent < ONE_WAY:
        yield (
            f"only {found.seldom_way_percent:.2g} % of the rows are on strokes of one direction, in which the model is "
            "untested: were the ways back left out? Keep them"
        )


def _of_bursts(record: Record, found: Findings) -> Iterator[str]:
    """Short bursts far apart: the fit shortens what is between them, and knows no speed but that within them."""
    missing = sum(seconds for _, seconds in found.gaps)
    rows = record.time.size / (len(found.gaps) + 1)
    if missing * found.sample_rate_hz > record.time.size and rows < BURST and len(found.gaps) >= FEWEST_BURSTS:
        yield (
            f"the rows are in {len(found.gaps) + 1} bursts of {figures(rows, 2)} on average, between which "
            f"{100 * missing / found.duration_s:.2g} % of the time is not measured: speed, lag and creep are then not "
            "those of the actuator. Record evenly, or take the mean of each burst as one row"
        )


def _of_lead(record: Record, found: Findings) -> Iterator[str]:
    """A displacement whose turns and whose rates come before the voltage's: hysteresis alone makes the rates late."""
    delay, lag = found.delay_ms, found.lag_ms
    if delay is None or lag is None or 100 * found.noise_um > NOISY * found.stroke_um:
        return
    row = 1e3 / found.sample_rate_hz
    if delay < -AHEAD[0] * row and lag < -AHEAD[1] * row:
        yield (
            f"the displacement turns {figures(-delay, 2)} ms before the voltage, its cause: is the voltage filtered, "
            "or behind a slow monitor, or is the displacement shifted? Record both through the same filters"
        )


def _of_means(record: Record, found: Findings) -> Iterator[str]:
    """Means that were taken off: nothing is lost of a displacement, but the zero of a voltage."""
    x, z, few = record.volts, record.displacement, math.sqrt(record.volts.size)
    digits = [3 * rounding(signal) / few for signal in (x, z)]
    bare = abs(float(x.mean())) <= max(NO_MEAN * float(np.ptp(x)), digits[0])
    if bare and abs(float(z.mean())) <= max(BY_CHANCE * found.noise_um / few, digits[1]):
        yield (
            "the means of voltage and displacement are 0 to the last digit: were they taken off (`detrend`)? The model "
            "is then of voltages that nobody puts out. Keep both as they were measured"
        )


def _of_units(record: Record, found: Findings) -> Iterator[str]:
    """Numbers that people rather write in another unit; nothing where the caller has stated it."""
    yield from _of_voltage_unit(record)
    yield from _of_displacement_unit(record, found)


def _of_voltage_unit(record: Record) -> Iterator[str]:
    volts = record.columns["volts"]
    if not volts.asked and MONITOR.search(volts.heading):
        yield (
            f"the voltage is the column {volts.heading!r}: a monitor mostly shows a tenth or a hundredth of the "
            "voltage. State what 1 of it is (`volts_scale`; 1 if a controller is to put out these)"
        )
    if not volts.asked and volts.unit == "V" and _whole(record.volts):
        yield (
            f"the voltage has whole numbers of V only, from {record.volts.min():g} to {record.volts.max():g}: are they "
            "codes of a converter? State what 1 of it is (`volts_scale`)"
        )
    elif not volts.asked and volts.unit == "V" and (float(record.volts.min()), float(record.volts.max())) == OF_ONE:
        yield (
            "the voltage is exactly from 0 to 1: is it normalised? State the V of 1 of it (`volts_scale`; 1 if it is "
            "in V)"
        )


def _of_displacement_unit(record: Record, found: Findings) -> Iterator[str]:
    volts, moved = record.columns["volts"], record.columns["displacement"]
    span, stroke = found.voltage_v[1] - found.voltage_v[0], found.stroke_um
    gain = abs(found.gain_um_per_v)
    if not moved.asked and moved.unit == "um" and _whole(record.displacement):
        yield (
            f"the displacement has whole numbers of um only, from {record.displacement.min():g} to "
            f"{record.displacement.max():g}: are they counts or nm? State its unit "
            f"({_say('displacement', moved)})"
        )
    elif not moved.asked and moved.unit == "um" and found.displacement_um in NORMALISED:
        yield (
            f"the displacement is exactly from {found.displacement_um[0]:g} to {found.displacement_um[1]:g}: is it "
            "normalised? State the um of 1 of it (`displacement_scale`)"
        )
    elif not moved.asked and moved.unit == "um" and (step := _of_converter(record.displacement)):
        yield (
            f"the displacement stays within +-10 um in steps of {step:.6g} um, as the volts of a converter of 20 V do "
            "in steps of a power of two: are they a sensor's V? State the unit, or its um/V "
            f"({_say('displacement', moved)})"
        )
    elif not moved.stated and max(map(abs, found.displacement_um)) <= CONVERTER:
        yield (
            "the displacement has no unit, and stays within +-10 as the volts of a sensor do: is it in um? State its "
            "unit (`displacement_unit`), or its um/V (`displacement_scale`)"
        )
    elif (
        moved.unit == "um" and not moved.asked and (stroke < SMALL or (stroke > LARGE and not _of_stage(found, moved)))
    ):
        others = "nm or mm" if stroke < SMALL else "nm or counts"
        yield f"the stroke is {figures(stroke)} um: is it in {others}? State its unit ({_say('displacement', moved)})"
    elif moved.unit == "nm" and not moved.asked and (like := _of_nanometres(found, gain)):
        yield (
            f"{figures(1e3 * stroke)} nm for {figures(span)} V with noise of {figures(1e3 * found.noise_um, 2)} nm is "
            f"{like}: is it in um? Say `displacement_scale` 1 if so, `displacement_unit` nm if not"
        )
    elif not moved.asked and not WEAK <= gain <= STRONG:
        what = "less than a single plate moves" if gain < WEAK else "more than most actuators move"
        said = f"is its unit right? State it ({_say('displacement', moved)})"
        yield f"{figures(stroke)} um for {figures(span)} V is {what}: {said}"
    elif volts.unit == "mV" and not volts.asked and (span < TINY or (span < MILLIVOLTS[0] and gain > MILLIVOLTS[1])):
        said = f"is the voltage in V? State its unit ({_say('volts', volts)})"
        yield f"{figures(1e3 * span)} mV move {figures(stroke)} um: {said}"


def _of_stage(found: Findings, moved: Column) -> bool:
    """Whether a stroke of several mm is one: the file says um, and gain and speed are of an amplified stage."""
    gain, speed = OF_STAGE
    return bool(moved.of_file) and abs(found.gain_um_per_v) <= gain and found.rates_um_s[2] <= speed


def _say(role: str, column: Column) -> str:
    """The arguments that state a unit: that of the file, so that nothing is asked about it, or another one."""
    right = f"`{role}_unit` {column.of_file} if it is right, else " if column.of_file else ""
    return right + column.says(role)


def _of_nanometres(found: Findings, gain: float) -> str:
    """What a displacement said to be in nm is like, where um under a heading of nm are at least as likely; else empty.

    Noise that is too small even for a stroke without a sensor is that of a simulation, which says nothing.
    """
    if found.noise_um < SMOOTH * found.stroke_um:
        return ""
    if found.noise_um < QUIETEST:
        return "quieter than most sensors"
    of_plate = gain < PLATE and found.stroke_um > SHORT and found.noise_um < QUIET
    return "what a single plate moves, read by a quiet sensor" if of_plate else ""


def _of_converter(values: FloatArray) -> float:
    """The step of a converter of 20 V, or of 10 V, in which these values stay, if all of them are on it; else 0.

    Examples
    --------
    >>> moved = 3.0 + np.sin(np.arange(3000) / 50.0)
    >>> [round(_of_converter(step * np.round(moved / step)), 6) for step in (20 / 65536, 3e-4)]
    [0.000305, 0.0]
    """
    few = values[:: -(-values.size // COUNTED)]
    for bits in BITS if np.abs(values).max() <= CONVERTER else ():
        step: float = 20.0 / (1 << bits)
        counts = few / step
        whole = np.round(counts)
        if np.mean(np.abs(counts - whole) < ON_STEP) > ON_STEPS and np.unique(whole).size > WHOLE:
            return step
    return 0.0


def _whole(values: FloatArray) -> bool:
    """Whether all of many different values are whole numbers: counts, codes, or a smaller unit without its point."""
    return not np.any(values % 1.0) and np.unique(values).size > WHOLE


def _of_hysteresis(record: Record, found: Findings) -> Iterator[str]:
    """No hysteresis at all, which an actuator under a voltage has: a command, or a loop that is closed already."""
    left = nonlinear(record, found)
    if left is not None and left < (STRAIGHT_ALIKE if found.one_length else STRAIGHT):
        yield (
            f"a linear filter of the voltage leaves {left:.1g} % of the stroke beside the noise, so there is hardly "
            "any hysteresis, which an actuator under a voltage has (1 to 8 % left): is the displacement a command, or "
            "the voltage the set-point of a closed loop or of a charge?"
        )


def nonlinear(record: Record, found: Findings) -> float | None:
    """What the best linear filter of the voltage leaves of the displacement beside its noise, % of the stroke.

    None where there are no four strokes, or with so much noise that it is not seen.
    """
    noisy = 100 * found.noise_um / found.stroke_um
    if found.strokes < 4 or noisy > NOISY:
        return None
    turns = turning.reversals(record.volts, turning.STROKE * float(np.ptp(record.volts)))
    lags, longest = [0], FILTER[1] * float(np.median(np.diff(turns)))
    while len(lags) < FILTER[0] and max(2 * lags[-1], 1) <= longest:
        lags.append(max(2 * lags[-1], 1))
    rows = np.concatenate([np.arange(s.start + lags[-1], s.stop) for s in record.segments])[:ROWS]
    if rows.size < 10 * len(lags):
        return None
    z = record.displacement[rows]
    columns = np.column_stack([np.ones(rows.size), *(record.volts[rows - lag] for lag in lags)])
    rest = z - columns @ np.linalg.lstsq(columns, z, rcond=1e-10)[0]
    return math.sqrt(max((100 * float(np.std(rest)) / found.stroke_um) ** 2 - noisy**2, 0.0))


def _of_levels(record: Record, found: Findings) -> Iterator[str]:
    """A signal that stays at an end of its range, but for noise, while the other one moves: it is cut off there."""
    x, z = record.volts, record.displacement
    quiet = {"displacement": found.noise_um, "voltage": noise(x, record.segments)}
    quietest = quiet["displacement"], quiet["voltage"]
    rows, moved = level(z, x, *quietest)
    exact = level(z, x, 0.0, quiet["voltage"]) if found.noise_um > ABOVE_STEPS * converter_step(z) else (0, 0.0)
    if exact[0] > rows:  # beneath much noise: no sensor has one value so often by chance
        (rows, moved), quiet["displacement"] = exact, 0.0
    ways = (
        ("displacement", "voltage", "um", "V", rows if rows >= CUT * x.size else 0, moved),
        (
            "voltage",
            "displacement",
            "V",
            "um",
            *(clipped_volts(x, z, *reversed(quietest)) if found.clipped_volts else (0, 0.0)),
        ),
    )
    for name, beside, unit, its, cut, moved in ways:
        if cut:
            width = f"within {LEVEL * quiet[name]:.2g} {unit}" if quiet[name] else "exactly"
            yield (
                f"the {name} stays at an end of its range, {width}, in {cut} rows, "
                f"while the {beside} goes on by up to {moved:.3g} {its} and comes back: is it cut off there?"
            )


def _of_steps(record: Record, found: Findings) -> Iterator[str]:
    """A voltage in steps between which the displacement goes on: it was recorded with few digits or bits.

    The steps of a D/A converter move the actuator behind each of them, and no more before the next one.
    """
    x, z, span = record.volts, record.displacement, float(np.ptp(record.volts))
    at = np.flatnonzero(np.diff(x)) + 1
    jumps = np.diff(x)[at - 1]
    step = float(np.abs(jumps).min())
    if step < COARSE * span or np.mean(np.abs(jumps) < 1.5 * step) < NEXT:
        return
    held, onward = np.diff(at), jumps[1:] * jumps[:-1] > 0
    start, rows, sign = (values[onward & (held >= HELD)] for values in (at[:-1], held, np.sign(jumps[1:])))
    if start.size < FEWEST_STEPS:
        return
    whole, second = (float(np.median(sign * (z[start + rows - 1] - z[start + k]))) for k in (0, rows // 2))
    if whole > ALONG_STEP * abs(found.gain_um_per_v) * step and second > EVENLY * whole:
        yield (
            f"the voltage goes by steps of {step:.3g} V, {100 * step / span:.2g} % of its span, between which the "
            "displacement goes on evenly: was it recorded with few digits or bits? Record it finer"
        )


def level(signal: FloatArray, other: FloatArray, quiet: float, rough: float = 0.0) -> tuple[int, float]:
    """Rows at the ends of a signal while another one moves on and comes back, and by how much at most.

    `quiet` and `rough` are the noises of the two.

    Examples
    --------
    >>> x = 1 - np.cos(np.linspace(0.0, 12.0, 2000))
    >>> level(np.minimum(x, 1.5), x, 1e-6)[0], level(x, x, 1e-6)[0]
    (698, 0)
    """
    span, width = float(np.ptp(signal)), LEVEL * quiet
    least = max(TURNED, FLATTER * width / span) * float(np.ptp(other)) + TO_AND_FRO * rough
    rows, most = 0, 0.0
    for near in (signal <= signal.min() + width, signal >= signal.max() - width):
        for start, stop in runs(near):
            entered = abs(signal[start] - signal[max(start - 1, 0)])  # a step, after which a displacement settles
            moved = to_and_fro(other[start:stop])
            if stop - start >= 4 and moved > least and entered < 0.1 * span:
                rows, most = rows + int(stop - start), max(most, moved)
    return rows, most


def _of_slew(record: Record, found: Findings) -> Iterator[str]:
    """An amplifier at the limit of its current: the displacement has a largest speed, or is that of such a voltage."""
    share, slowest, fastest = limited(record, found)
    where = "is the amplifier at the limit of its current or slew rate, and the voltage recorded in front of it?"
    remedy = "Record behind it, or move more slowly"
    if share > LIMITED and fastest > FREE * slowest:
        yield (
            f"in {100 * share:.2g} % of the rows the displacement moves at one largest speed, while the voltage's "
            f"differs by more than {FREE:g} times: {where} {remedy}"
        )
        return
    rows = max(record.segments, key=lambda s: s.stop - s.start)
    behind = slew.best(record.volts[rows], record.displacement[rows], record.sample_rate, found.strokes)
    if behind is not None and behind.ratio < EXPLAINED_BY_SLEW:
        yield (
            f"behind a voltage of at most {figures(behind.rate, 2)} V/s, which is slower than the record's in "
            f"{100 * behind.share:.2g} % of its fastest rows, the displacement is {figures(1 / behind.ratio, 2)} times "
            f"better explained: {where} {remedy}"
        )


def _of_ringing(record: Record, found: Findings) -> Iterator[str]:
    """A stage that rings more than it moves."""
    if abs(found.correlation) < TOGETHER and (frequency := ringing(record)):
        yield (
            f"the displacement rings at {frequency:.4g} Hz as far as the voltage moves it, or further: the stage is "
            f"shaken at its resonance. Move more slowly, round the steps to {2e3 / frequency:.2g} ms and more, or "
            "record until the ringing has ended"
        )


def limited(record: Record, found: Findings) -> tuple[float, float, float]:
    """Share of the rows at the largest speed of the displacement, and the voltage's 10 and 90 % speeds in them."""
    x, z, over = record.volts, record.displacement, 1
    moved = np.abs(np.diff(z))
    while found.noise_um * 1.5 > 0.01 * np.percentile(moved, 99) and 40 * over <= z.size:
        over *= 2
        moved = np.abs(z[over:] - z[:-over])
    top = float(np.percentile(moved, 99.5))
    at = np.abs(moved - top) < NEAR_TOP * top
    if np.count_nonzero(at) < FEWEST_AT_TOP:
        return 0.0, 0.0, 0.0
    late = round(1e-3 * max(found.lag_ms or 0.0, 0.0) * found.sample_rate_hz)  # dead time and lag shift it, too
    speeds = np.abs(x[over:] - x[:-over])[np.maximum(np.flatnonzero(at) - late, 0)]
    low, high = np.percentile(speeds, [10, 90])
    return float(at.mean()), float(low), float(high)
