"""How well a model predicts another record, whose zero may be another one."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control import actuator, interval
from truestroke.control.actuator import ActuatorModel
from truestroke.control.spans import Beyond
from truestroke.identification.fitting.rest import from_step
from truestroke.identification.held_out.trace import Trace
from truestroke.identification.held_out.validation import NEGLIGIBLE, NOISE, sizes
from truestroke.identification.records import resting
from truestroke.identification.records.series import first_known, series, settled
from truestroke.signals.clipping import runs
from truestroke.signals.metrics import rms
from truestroke.signals.noise import noise

OF_DAY = 0.0, *(2.0 ** (-k / 2) for k in range(8, -1, -1))  # of what another day adds to the deviations of the weights
NARROWER = 0.5, 0.7, 0.85  # times that of the model's own day: motion may be nearer to what its record shows
PARTS, FEWEST = 4, 200  # of the record, each with the share of the others; samples: with fewer all of it
BEYOND = 30.0  # cost of 1 um beyond the half width: least where 97 % are within, 2 % more as errors are not independent
HELD = 0.8  # of the samples in the interval, at least
WORSE = 3.0  # times the residual of the model's own record
LATEST = 0.5  # of the motion: until then its start ends where the voltage has been at all voltages
MISSED = 0.02  # of the stroke: an error of the start that is a reason
EXPLAINED = 0.5  # of the rmse remains beside what explains it, at most
SCALED = 0.005  # by so much another gain differs, at least
UNIT = 1.1  # times, or less than one part in so many: more than a day, a load or an amplifier changes a gain
RATES = 10.0 ** (np.arange(-6, 7) / 4)  # times the stated sample rate, among which the true one is looked for
ANOTHER_RATE = 1.5  # times, or one part in so many: with another load a stage is faster or slower by less
BESIDE = 0.7  # of what remains beside any other cause: beside a sample rate it must be less
MOSTLY = 0.5  # of the samples: motion that is beyond the record of the model in more of them is a reason at all events
TIMES = "times as far as predicted"
THERE = 1.2  # times the rmse elsewhere: then motion beyond the record of the model explains the error


@dataclass(frozen=True, eq=False)
class Score:
    """Errors of a model on a record.

    Attributes
    ----------
    offset_um : float
        By how much the zero of this record is above that of the model's, um: removed before all other errors.
    estimated : bool
        Whether it is the median of measured minus predicted displacement, or was given.
    rmse_um, maximum_um : float
        Of the prediction with the offset, um.
    rmse_percent : float
        The same, % of the peak-to-peak displacement.
    rmse_without_offset_um : float
        Of the prediction with the zero of the model's own record, um.
    coverage : float
        Share of the samples within the 95 % interval, 0 to 1. What `ActuatorModel.another_day` adds is in it as far as
        the other quarters of the record show it.
    half_width_um : float
        Median half width of that interval, um.
    start_rmse_um, start_maximum_um : float
        Errors of the start, such as a first step, which is not judged: the model takes the actuator to have rested.
        With the offset, um; NaN where none is known.
    beyond : Beyond
        Spans in which this record is beyond that of the model.
    trace : Trace
        The record beside the prediction, which has the offset; `held_out` are the samples that are judged.
    verdict : Verdict
        Whether the model holds for this record.
    """

    offset_um: float
    estimated: bool
    rmse_um: float
    maximum_um: float
    rmse_percent: float
    rmse_without_offset_um: float
    coverage: float
    half_width_um: float
    start_rmse_um: float
    start_maximum_um: float
    beyond: Beyond
    trace: Trace
    verdict: Verdict


def score(model: ActuatorModel, record: Any, *, offset: float | None = None) -> Score:
    """Errors of a model on another record; the zero is a state of the day, not a weight.

    The start, until the voltage has covered its range, is not judged: the states of the plays are not known there. Of a
    record that takes more than its first half for that, it ends as in `identify`.

    Parameters
    ----------
    model : ActuatorModel
        Of `identify` or `load_model`.
    record : Record or tuple
        As of `identify`.
    offset : float, optional
        By how much the zero of this record is above that of the model's, um; by default it is estimated.

    Raises
    ------
    SettingError
        An argument is out of bounds, or no sample behind the start is known.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> x = 1.5 - 1.5 * np.cos(2 * np.pi * t)
    >>> model = ActuatorModel(
    ...     thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=1e-4 * np.eye(3), stroke=30.0,
    ...     voltage_range=(0.0, 3.0), noise=0.01,
    ... )
    >>> found = score(model, (x, 10.0 * x + 0.5, 1000.0))
    >>> round(found.offset_um, 3), round(found.rmse_um, 3), round(found.rmse_without_offset_um, 3)
    (0.5, 0.0, 0.5)
    >>> found.verdict.reasons
    ('The zero is 0.5 um above that of the record of the model; the other errors are without it.',)
    """
    checks.instance("model", model, ActuatorModel, actuator.EXPECTED)
    s = from_step(series(record))
    swept = np.arange(s.volts.size) >= _start(s.volts)
    after, start = s.known & swept, s.known & ~swept
    if not after.any():
        raise SettingError("record", "without a known sample after its start", "one whose displacement is known there")
    predicted = model.forward(s.volts, s.sample_rate)
    error = s.displacement - predicted
    moved = float(np.median(error[after])) if offset is None else checks.number("offset", offset, "um")
    rest = error - moved
    judged = resting.judged(s.volts, rest, after)
    width = _half_width(model, s.volts, s.sample_rate, predicted, rest, judged, centred=offset is None)
    numbers = {
        "offset_um": moved,
        "rmse_um": rms(rest[judged]),
        "maximum_um": float(np.abs(rest[judged]).max()),
        "rmse_percent": 100 * rms(rest[judged]) / float(np.ptp(s.displacement)),
        "rmse_without_offset_um": rms(error[judged]),
        "coverage": float(np.mean(np.abs(rest) <= width, where=judged)),
        "half_width_um": float(np.median(width[judged])),
        "start_rmse_um": rms(rest[start]) if start.any() else math.nan,
        "start_maximum_um": float(np.abs(rest[start]).max()) if start.any() else math.nan,
    }
    trace = Trace(**vars(s), predicted=predicted + moved, half_width=width, held_out=swept)
    measured = [slice(start, stop) for start, stop in runs(s.known).tolist()]
    noise_um = noise(s.displacement, measured)
    words = _explained(trace, numbers["rmse_um"], s.sample_rate, model) if _large(numbers, noise_um) else ""
    beyond = model.beyond(s.volts, s.sample_rate, measured=False)
    verdict = _verdict(model, numbers, noise_um, words, _causes(beyond, rest, judged, s.sample_rate))
    return Score(**numbers, estimated=offset is None, beyond=beyond, trace=trace, verdict=verdict)


def _start(x: FloatArray) -> int:
    """First sample that is judged."""
    span = float(np.ptp(x))
    swept = settled(x, span)
    moves = resting.moving(x)
    early = np.count_nonzero(moves[:swept]) < LATEST * np.count_nonzero(moves)
    return swept if early else first_known(x, span)


def _half_width(
    model: ActuatorModel,
    volts: FloatArray,
    fs: float,
    predicted: FloatArray,
    rest: FloatArray,
    judged: npt.NDArray[np.bool_],
    centred: bool,
) -> FloatArray:
    """Half width of the 95 % interval of the prediction error on this day, um, shape (samples,).

    As `ActuatorModel.interval`, with a share of what `another_day` adds to the covariance, or with none and narrower:
    what is best for the judged samples in the other quarters of the record. The zero walks from the start of this
    record, or, where the offset is estimated, from its middle; the part of the weights that moves all samples alike is
    not in it.
    """
    start = 0.5 * volts.size if centred else 0.0
    since = np.abs(np.arange(volts.size) - start) / fs
    own = interval.of_motion(model, volts, fs, model.covariance, centred)
    day = interval.of_motion(model, volts, fs, model.another_day(), centred) - own
    own = own + interval.unshown(model, volts, fs, predicted) + interval.of_walk(model, since)
    least = interval.of_inner_loops(model, volts, fs)
    widths = [interval.COVERED * np.sqrt(np.maximum(own + share**2 * day, least)) for share in OF_DAY]
    widths = [*(size * widths[0] for size in NARROWER), *widths]
    rows = np.flatnonzero(judged)
    return np.asarray(widths[-1]) if rows.size < FEWEST else _cheapest(widths, np.abs(rest), rows)


def _cheapest(widths: list[FloatArray], error: FloatArray, rows: npt.NDArray[np.intp]) -> FloatArray:
    """For each part of the record the width that costs least in the others: itself, and what is beyond (Winkler)."""
    costs, parts = np.zeros((len(widths), PARTS)), np.array_split(rows, PARTS)
    for k, width in enumerate(widths):
        costs[k] = [np.sum(width[part] + BEYOND * np.maximum(error[part] - width[part], 0.0)) for part in parts]
    chosen = np.argmin(costs.sum(axis=1, keepdims=True) - costs, axis=0)
    found, ends = np.empty(error.size), [0, *(int(part[0]) for part in parts[1:]), error.size]
    for k, (first, end) in zip(chosen, pairwise(ends), strict=True):
        found[first:end] = widths[k][first:end]
    return found


def _large(found: dict[str, float], noise_um: float) -> bool:
    """Whether the error is more than that of the sensor."""
    return found["rmse_um"] > NOISE * noise_um and found["rmse_percent"] > NEGLIGIBLE


def _explained(trace: Trace, rmse: float, fs: float, model: ActuatorModel) -> str:
    """In words what explains the error: another sample rate or gain, a shift in time, a drift; or empty."""
    judged, predicted = trace.judged, trace.predicted
    causes = {
        "gain": predicted,
        "later": -np.gradient(predicted) * fs,
        "drift": np.arange(predicted.size) / fs,
    }
    error = (trace.displacement - predicted)[judged]
    found = {name: _fitted(cause[judged], error) for name, cause in causes.items()}
    name = min(found, key=lambda name: found[name][1])
    size, left = found[name]
    if of_rate := _of_rate(trace, min(BESIDE * left, EXPLAINED * rmse), fs, model):
        return of_rate
    if left > EXPLAINED * rmse:
        return ""
    remain = f"and {figures(left, 3)} um of the error remain beside that"
    if name == "drift":
        words = f"The displacement drifts by {figures(size, 3)} um/s against the prediction, {remain}"
        return f"{words}: is it temperature, or creep of a move before? Wait until it has settled."
    if name == "later":
        when = "later" if size > 0 else "earlier"
        words = f"The displacement comes {figures(1e3 * abs(size), 3)} ms {when} than predicted, {remain}"
        return f"{words}: is a filter or the sensor another one, or is a channel of the recording shifted in time?"
    return _of_gain(1 + size, remain)


def _of_rate(trace: Trace, least: float, fs: float, model: ActuatorModel) -> str:
    """Words for another sample rate, where less than `least`, um, of the error remain with it.

    The hysteresis of plays is the same at any rate: dead time, lag, creep and resonances of the model show it. A lag
    that is longer by as much is the same.
    """
    from scipy.optimize import minimize_scalar

    judged = trace.judged

    def left(exponent: float) -> float:
        try:
            predicted = model.forward(trace.volts, fs * 10.0 ** float(exponent))
        except SettingError:  # modes that this rate does not resolve
            return math.inf
        return float(np.std((trace.displacement - predicted)[judged]))

    tried = np.log10(RATES)
    errors = [left(exponent) for exponent in tried]
    k = int(np.argmin(errors))
    if not 0 < k < tried.size - 1:
        return ""
    fine = minimize_scalar(left, bounds=(tried[k - 1], tried[k + 1]), method="bounded", options={"xatol": 2e-3})
    if fine.fun > least or abs(fine.x) < math.log10(ANOTHER_RATE):
        return ""
    rate, remain = figures(fs * 10.0**fine.x, 2), f"{figures(fine.fun, 3)} um of the error remain with it"
    words = f"The displacement is as predicted at a sample rate of {rate} Hz, not of {figures(fs, 4)} Hz, and {remain}"
    return (
        f"{words}: is `sample_rate`, or the clock of the record, wrong, or are a filter, the sensor or the load others?"
    )


def _fitted(cause: FloatArray, error: FloatArray) -> tuple[float, float]:
    """By which factor a cause is in the error, and the deviation that remains."""
    from_mean = cause - cause.mean()
    square = float(from_mean @ from_mean)
    size = float(from_mean @ error) / square if square > 0 else 0.0
    return size, float(np.std(error - size * cause))


def _of_gain(gain: float, remain: str) -> str:
    if gain <= 0 or abs(math.log(gain)) < SCALED:
        return ""
    words = f"The displacement moves {figures(gain, 4)} {TIMES}, {remain}"
    if abs(math.log(gain)) > math.log(UNIT):
        words += ": is a unit or a scale wrong (`displacement_scale`, `volts_scale`), are the columns"
        return f"{words} exchanged, or is it another actuator or load?"
    return f"{words}: another temperature, load or amplifier may do so, or another actuator; `refine` learns it."


def _causes(beyond: Beyond, error: FloatArray, judged: npt.NDArray[np.bool_], fs: float) -> tuple[str, ...]:
    """Warnings of motion beyond the record of the model, of those where the error is larger than elsewhere."""
    parts = (
        dataclasses.replace(Beyond((), ()), **{name: getattr(beyond, name)}, tested_frequency=beyond.tested_frequency)
        for name in ("voltage", "velocity", "frequency")
    )
    return tuple(words for part in parts for words in part.warnings if _there(part, error, judged, fs))


def _there(part: Beyond, error: FloatArray, judged: npt.NDArray[np.bool_], fs: float) -> bool:
    """Whether the error is larger in these spans than in the other samples, or there are none."""
    inside = np.zeros(error.size, dtype=np.bool_)
    for span in (*part.voltage, *part.velocity, *part.frequency):
        inside[round(span.start * fs) : round(span.stop * fs)] = True
    there, elsewhere = judged & inside, judged & ~inside
    if not there.any() or np.mean(inside[judged]) > MOSTLY:
        return bool(there.any())
    return rms(error[there]) > THERE * rms(error[elsewhere])


def _verdict(
    model: ActuatorModel, found: dict[str, float], noise_um: float, explained: str, beyond: tuple[str, ...]
) -> Verdict:
    """Bad where the model does not hold, doubtful where its interval does not, or its error is not that of the sensor.

    The last as `identify` has it: a model whose error on its own record is large is as little known on another one.
    """
    said: list[tuple[Level, str]] = []
    if model.verdict.is_bad:
        said.append(("doubtful", "The verdict of the model on its own record is bad: see its page."))
    if abs(found["offset_um"]) > 3 * model.noise:
        where = "above" if found["offset_um"] > 0 else "below"
        size = f"{abs(found['offset_um']):.3g} um {where}"
        words = f"The zero is {size} that of the record of the model; the other errors are without it."
        words += " Another gain moves it, too." if TIMES in explained else ""
        said.append(("doubtful", words))
    if found["rmse_um"] > max(WORSE * model.noise, 0.02 * model.stroke):
        words = f"The rmse is {found['rmse_um']:.3g} um, that of the model's own record {model.noise:.3g} um: "
        said.append(("bad", words + "identify the actuator anew."))
        said += [("bad", explained)] if explained else []
    elif found["rmse_um"] > NOISE * noise_um and found["rmse_percent"] > NEGLIGIBLE:
        over = found["rmse_um"] / noise_um if noise_um > 0 else math.inf
        error, times = sizes(found["rmse_um"], found["rmse_percent"], over, noise_um)
        said.append(("doubtful", f"The error is {error}: {times}. Use the model where that is small enough."))
        said += [("doubtful", explained)] if explained else []
    if found["rmse_um"] > NOISE * max(noise_um, model.noise):
        words = "The motion is beyond that of the record of the model"
        said += [("doubtful", f"{words}: {warning}. Identify with this record, too.") for warning in beyond]
    if found["start_rmse_um"] > max(WORSE * found["rmse_um"], MISSED * model.stroke):
        words = f"The start is missed by {found['start_rmse_um']:.3g} um rms, by {found['start_maximum_um']:.3g} um at "
        said.append(("doubtful", words + "most: the actuator had moved before the record, or answers steps otherwise."))
    if found["coverage"] < HELD:
        words = f"The 95 % interval holds {100 * found['coverage']:.0f} % of the samples."
        said.append(("doubtful", words))
    return Verdict.of(said)
