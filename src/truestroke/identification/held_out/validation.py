"""Whether a model is to be used: what its prediction error still contains, and which measurement would help."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.identification.examination.findings import PACE, VISITED, Findings
from truestroke.identification.fitting.regression import plays
from truestroke.identification.fitting.response import Response
from truestroke.identification.held_out.black_box import predictable
from truestroke.identification.held_out.changed import Change
from truestroke.identification.held_out.jump import Jump
from truestroke.identification.held_out.trace import HeldOut, Trace
from truestroke.identification.records import turning
from truestroke.model.dynamics import Dynamics
from truestroke.model.sampled import central_difference
from truestroke.signals.metrics import rms

NOISE = 2.0  # times the sensor's noise: below, no model has half the error
SILENT = 1e4  # times the noise: then it is that of rounded numbers, and the record is a simulated one
NEGLIGIBLE = 0.02  # % of peak-to-peak: an error that no other one is judged for
LINE = 0.8  # of the straight line's rmse: no gain worth a model
STRAIGHT = 1.0  # % of peak-to-peak: below, a straight line is a usable model
POOR = 5.0  # % of peak-to-peak: of no use
LOST = 10.0  # the same where the error is slow: no drift that a model is used beside
UNEXPLAINED = 2.5, 10.0  # the same in % and in times the noise, both
WORSE = 2.0  # times the error in the fitted part
CORRELATED = 0.5  # of the autocorrelation, beyond lag 0
OSCILLATES = -0.3  # and within this share of a stroke
WITHIN = 0.3
LINE_SHARE, LINE_ABOVE = 0.5, 5.0  # of the error's mean square, and times the frequency of the strokes: not motion
SHARPEST = 200.0  # times what the voltage has of a line, over the gain: no stage rings so much; it is hum
EXPLAINED = 0.25  # of the error's variance, by one of voltage, velocity and history
BEATEN = (
    0.5,
    0.75,
)  # of its mean square, by a black box: a reason, and a model with half the error, which none is good beside
SLOW = 0.5, 0.8  # the same by time, which few means show by chance; and where it hides the others
LONG_STROKES = 90.0  # per cent of the strokes are shorter than those that are compared
TESTED = 0.5  # of the length of the record's strokes, in the held-out part: below, long ones are not tested
BEYOND = 0.15  # of the range or speed of the fitted part: beyond it the held-out part extrapolates
LEFT_BY = 0.02  # of that range: so far outside of it a voltage is another one
SOON = 0.1  # of the held-out rows behind the first of those: then the error has grown
GROWN = 2.0  # times that in as many rows before it: an error that grows all the time has another reason
UNTIL_THEN = 0.5, 0.2  # of the error, and of the held-out rows: before it leaves the range, at most, and at least
FITS = 1.0  # % of peak-to-peak: with less residual of all of the record an error beyond the fitted range is no verdict
LATE_STATES = 0.4  # of the record, in which the voltage had not been at both ends of its range
DRIFTED = 10.0  # % of peak-to-peak within a record: a zero that drifts further is not there where it was
DEAD_TIME, DEAD_ROWS = 0.005, 8.0  # s, and rows: more is that of a shifted or buffered channel
LINES = 10.0  # of the record's spectrum: a narrower mode decays less than 30 times in it, which hardly show its damping
FEW_STROKES = 6
OF_LOOP = 0.3, 1.0  # of the mean width of the loop: errors on loops that the record has not, by plays; by branches
LEFT = 0.25  # of that width without the delay: with less the two are not distinguished
ROWS = 20_000  # of the held-out part at most, evenly taken
KNOTS = 8  # of the functions of voltage and velocity
THRESHOLDS = (0.04, 0.08, 0.14, 0.22, 0.32, 0.44)  # of the voltage span: plays that stand for the history
PIECES = 6  # of the held-out part, whose means are its slow part


@dataclass(frozen=True)
class Evidence:
    """What the prediction error of a model contains, by which its verdict is formed.

    Attributes
    ----------
    over_noise : float
        Rms error of the held-out part over the sensor's noise (`Findings.noise_um`).
    over_fitted : float
        The same over the rms error in the fitted part.
    over_line : float
        The same over that of a straight line through the fitted part, both without their means over sixths of the
        time, and without the hum: a zero that moves is not in it.
    autocorrelation : float
        Of the fit's residual, the largest in magnitude beyond lag 0.
    autocorrelation_s : float
        The lag at which it is found, s.
    least_autocorrelation, least_autocorrelation_s : float
        The most negative one, and its lag, s.
    voltage, velocity, history, time : float
        Share of the variance of the held-out error that a function of it predicts: of the voltage; of the velocity; of
        plays of the voltage, beyond both; means over sixths of the time, of the mean square. 0 is none.
    black_box : float
        Share of the mean square of the held-out error that a black-box model predicts (`black_box.predictable`): from
        0.75 on there is a model with half the error.
    line, line_hz : float
        Share of the mean square of the held-out error in the strongest line of its spectrum, and its frequency, Hz.
    hum : float
        The same share, if the voltage has so little of that line that no stage could ring so much; else 0.
    jump_um, jump_s : float
        By how much the residual of the fit jumps at once, um, and the time from which on; 0 where it does not.
    drift_percent : float
        How far the zero drifts within the record, by the fit to all of it, % of peak-to-peak.
    residual_percent : float
        Rms residual of the fit to the whole record, % of peak-to-peak.
    strokes_tested : float
        The length that a tenth of the strokes have in the held-out part, over that in the record: 0 where it rests.
    range_beyond, speed_beyond, strokes_beyond : float
        By which share of those of the fitted part the held-out part exceeds range and speed of the voltage, and the
        length that a tenth of its strokes have.
    left_s, until_left : float
        From when on the voltage of the held-out part is outside of that of the fitted rows, s, and the rms error until
        then over that of the whole part; 0 and 1 where it never is, or so from the beginning.
    gain_changed, later_s, changed_s : float
        By which share the gain is larger from some time on, or by how much the displacement is later, s, and that
        time, s, by the residual of the fit; 0 where neither is.
    """

    over_noise: float
    over_fitted: float
    over_line: float
    autocorrelation: float
    autocorrelation_s: float
    least_autocorrelation: float
    least_autocorrelation_s: float
    voltage: float
    velocity: float
    history: float
    time: float
    black_box: float
    line: float
    line_hz: float
    jump_um: float
    jump_s: float
    drift_percent: float
    residual_percent: float
    strokes_tested: float
    range_beyond: float
    speed_beyond: float
    strokes_beyond: float
    left_s: float = 0.0
    until_left: float = 1.0
    gain_changed: float = 0.0
    later_s: float = 0.0
    changed_s: float = 0.0
    hum: float = 0.0


# ---- Evidence --------------------------------------------------------------------------------------------------------


def evidence(
    trace: Trace,
    fit: tuple[FloatArray, FloatArray],
    autocorrelation: FloatArray,
    findings: Findings,
    drift: FloatArray | float = 0.0,
    rows: npt.NDArray[np.intp] | None = None,
    jumped: Jump | None = None,
    changed: Change | None = None,
) -> Evidence:
    """What is in the error of a trace, and in the residual of the fit to the whole record: its times, s, and it, um.

    `drift` is that of the zero by this fit, um, `jumped` a jump of its residual, `changed` a change of gain or delay
    that it shows; `rows` are those to which the model of the trace was fitted, by default all of its first part.
    """
    times, residual = fit
    fitted, tested = trace.known & ~trace.held_out, trace.judged
    settled = fitted & (trace.time - trace.time[0] >= min(findings.states_known_s, 0.25 * np.ptp(trace.time)))
    error = rms(trace.residual[tested])
    line = np.polyfit(trace.volts[fitted], trace.displacement[fitted], 1)
    off_line = trace.displacement[tested] - np.polyval(line, trace.volts[tested])
    of_line = _line(trace, tested, findings)
    hum = of_line["hum"] * error**2
    row = float(np.count_nonzero(trace.known) / trace.sample_rate / residual.size)
    lags = autocorrelation[1:]
    most, least = int(np.abs(lags).argmax()), int(lags.argmin())
    return Evidence(
        over_noise=_over(error, findings.noise_um),
        over_fitted=_over(error, rms(trace.residual[settled if settled.any() else fitted])),
        over_line=_over(_beside(_moving(trace.residual[tested]), hum), _beside(_moving(off_line), hum)),
        autocorrelation=float(lags[most]),
        autocorrelation_s=(most + 1) * row,
        least_autocorrelation=float(lags[least]),
        least_autocorrelation_s=(least + 1) * row,
        **_dependence(trace, tested),
        black_box=predictable(trace),
        **of_line,
        jump_um=0.0 if jumped is None else jumped.size,
        jump_s=0.0 if jumped is None else float(times[jumped.row]),
        drift_percent=100 * float(np.ptp(drift)) / float(np.ptp(trace.displacement)),
        residual_percent=100 * rms(residual) / float(np.ptp(trace.displacement)),
        strokes_tested=_over(_long(trace.volts[tested]), _long(trace.volts[trace.known])),
        **_beyond(trace, fitted, tested),
        **_left(trace, np.flatnonzero(fitted) if rows is None else rows, tested),
        **({} if changed is None else {_CHANGED[changed.of]: changed.size, "changed_s": float(times[changed.row])}),
    )


_CHANGED = {"gain": "gain_changed", "delay": "later_s"}


def _left(trace: Trace, rows: npt.NDArray[np.intp], tested: Any) -> dict[str, float]:
    """From when on the held-out part is at voltages that the fitted rows do not have, and the error until then.

    Of hysteresis it is not the error at these voltages alone: what they have switched stays. An error that grows later
    than `SOON` has another reason.
    """
    at = np.flatnonzero(tested)
    x, low, high = trace.volts[at], trace.volts[rows].min(), trace.volts[rows].max()
    outside = np.maximum(x - high, low - x) > LEFT_BY * (high - low)
    first = int(outside.argmax())
    if not outside.any() or first < UNTIL_THEN[1] * at.size:
        return {}
    error, soon = rms(trace.residual[at]), max(round(SOON * at.size), 1)
    before, then = (rms(trace.residual[at[k : k + soon]]) for k in (first - soon, first))
    if then < max(UNTIL_THEN[0] * error, GROWN * before):
        return {}
    return {"left_s": float(trace.time[at[first]]), "until_left": _over(rms(trace.residual[at[:first]]), error)}


def _over(value: float, other: float) -> float:
    return value / other if other > 0 else (math.inf if value > 0 else 1.0)


def _dependence(trace: Trace, tested: Any) -> dict[str, float]:
    """Shares of the held-out error that voltage, velocity, history and time predict."""
    every = max(1, int(np.count_nonzero(tested)) // ROWS)
    rows = np.flatnonzero(tested)[::every]
    x, e = trace.volts, trace.residual[rows]
    span = float(np.ptp(x))
    rate = central_difference(trace.predicted, trace.sample_rate)
    voltage, velocity = _hats(x[rows]), _hats(_ranked(rate[rows]))
    history = plays(x - x[0], tuple(r * span for r in THRESHOLDS))[rows] / span
    known = _predicted(np.hstack([voltage, velocity]), e)
    both = _predicted(np.hstack([voltage, velocity, history]), e)
    square = float(np.mean(e**2))
    slow = square - float(np.mean(_moving(e) ** 2))
    return {
        "voltage": _predicted(voltage, e),
        "velocity": _predicted(velocity, e),
        "history": max(both - known, 0.0),
        "time": slow / square if square > 0 else 0.0,
    }


def _moving(error: FloatArray) -> FloatArray:
    """What of an error is not slow: without its means over sixths of the time."""
    return np.concatenate([part - part.mean() for part in np.array_split(error, PIECES)])


def _ranked(values: FloatArray) -> FloatArray:
    """Their ranks: velocities are mostly slow."""
    return np.argsort(np.argsort(values)).astype(np.float64)


def _hats(values: FloatArray) -> FloatArray:
    """Columns of piecewise linear functions of the values, shape (rows, KNOTS)."""
    places = (KNOTS - 1) * (values - values.min()) / max(float(np.ptp(values)), 1e-300)
    return np.asarray(np.maximum(1 - np.abs(places[:, None] - np.arange(KNOTS)), 0.0))


def _predicted(columns: FloatArray, error: FloatArray) -> float:
    """Share of the variance in each half that the columns predict, fitted to the other half; not below 0."""
    half = error.size // 2
    left = total = 0.0
    for fit, test in ((slice(0, half), slice(half, None)), (slice(half, None), slice(0, half))):
        A, b = columns[fit] - columns[fit].mean(axis=0), error[fit] - error[fit].mean()
        weights = np.linalg.lstsq(A, b, rcond=1e-6)[0]
        off = error[test] - columns[test] @ weights
        left, total = left + off.size * float(off.var()), total + off.size * float(error[test].var())
    return max(1 - left / total, 0.0) if total > 0 else 0.0


def _line(trace: Trace, tested: Any, findings: Findings) -> dict[str, float]:
    """The strongest line of the held-out error's spectrum: three values of it, behind Hann's window."""
    error = np.where(tested, trace.residual, 0.0)[np.flatnonzero(trace.held_out)]
    error = error - error.mean()
    window = np.hanning(error.size)
    around, power = _lines(error * window)
    k, total = int(around.argmax()), float(power.sum())
    share = float(around[k]) / total if total > 0 else 0.0
    x = trace.volts[np.flatnonzero(trace.held_out)]
    driven, _ = _lines((x - x.mean()) * window)
    gain = float(np.ptp(trace.displacement) / np.ptp(trace.volts))
    shaken = math.sqrt(float(around[k])) > SHARPEST * gain * math.sqrt(float(driven[k]))
    line_hz = k * trace.sample_rate / error.size
    is_hum = shaken and share > LINE_SHARE and _is_above(line_hz, findings)
    return {"line": share, "line_hz": line_hz, "hum": share if is_hum else 0.0}


def _stroke(findings: Findings) -> float:
    """The mean time of a stroke, s, without gaps."""
    return findings.rows / findings.sample_rate_hz / max(findings.strokes, 1)


def _is_above(line_hz: float, findings: Findings) -> bool:
    """Whether a line is too fast to be motion."""
    return line_hz > LINE_ABOVE / (2 * _stroke(findings))


def _lines(windowed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The power of three neighbours of its spectrum together, about each of them, and of each."""
    power = np.abs(np.fft.rfft(windowed)) ** 2
    return np.convolve(power, np.ones(3), mode="same"), power


def _beside(error: FloatArray, square: float) -> float:
    """The rms of an error without a part of this mean square."""
    return math.sqrt(max(float(np.mean(error**2)) - square, 0.0))


def _beyond(trace: Trace, fitted: Any, tested: Any) -> dict[str, float]:
    """How far the held-out part exceeds range, speed and strokes of the fitted part."""
    x, rate = trace.volts, np.abs(central_difference(trace.volts, trace.sample_rate))
    low, high = x[fitted].min(), x[fitted].max()
    out = max(x[tested].max() - high, low - x[tested].min(), 0.0) / max(high - low, 1e-300)
    fast, before = (float(np.percentile(rate[rows], 99)) for rows in (tested, fitted))
    long, usual = (_long(x[rows]) for rows in (tested, fitted))
    beyond = {"speed_beyond": _over(fast, before), "strokes_beyond": _over(long, usual)}
    return {"range_beyond": float(out), **{name: max(ratio - 1, 0.0) for name, ratio in beyond.items()}}


def _long(x: FloatArray) -> float:
    """The length that a tenth of the strokes have, V."""
    turns = turning.reversals(x, turning.STROKE * float(np.ptp(x)))
    return float(np.percentile(np.abs(np.diff(x[turns])), LONG_STROKES))


# ---- Verdict ---------------------------------------------------------------------------------------------------------


def verdict(
    found: Evidence,
    held_out: HeldOut,
    findings: Findings,
    response: Response | None = None,
    dynamics: Dynamics | None = None,
    part_branches: bool = False,
    branches: bool = False,
) -> Verdict:
    """Good, doubtful (usable) or bad (do not use it), with the reasons and the next measurement to make.

    Good is a model whose error on motion that it has not seen is at most twice the noise of the sensor, so that no
    other model has half of it, also by a black box, and white; of a record with strokes of several lengths.
    `part_branches` says whether the model of the first part has branches, `branches` whether that which is saved has.
    """
    return Verdict.of([
        *(("bad", f"The record contradicts itself: {_ended(mistake)}") for mistake in findings.mistakes),
        *(("doubtful", _ended(f"{text[0].upper()}{text[1:]}")) for text in findings.implausible),
        *_of_error(found, held_out, findings),
        *_of_zero(found, held_out),
        *(_of_change(found, findings) if _is_noise(found, held_out) and held_out.rmse_percent > NEGLIGIBLE else ()),
        *(() if response is None else _of_dead_time(response, findings)),
        *(() if dynamics is None else _of_modes(dynamics, findings)),
        *_of_residual(found, held_out, findings),
        *_of_tested(found),
        *(_OF_ANOTHER if part_branches and not branches else ()),
        *_of_excitation(findings, branches),
    ])  # fmt: skip


def _ended(sentence: str) -> str:
    return sentence if sentence.endswith("?") else f"{sentence}."


_OF_ANOTHER: tuple[tuple[Level, str], ...] = (
    (
        "doubtful",
        "The error is that of a model with branches, which the saved one does not need: it may be larger. Record for "
        "longer.",
    ),
)


def _is_noise(found: Evidence, held_out: HeldOut) -> bool:
    return found.over_noise <= NOISE or held_out.rmse_percent <= NEGLIGIBLE


def _is_untested(found: Evidence) -> bool:
    """Whether the held-out part goes beyond the range of the fitted one, and the saved model, fitted to all, fits."""
    return found.range_beyond > BEYOND and found.residual_percent < FITS


def _of_error(found: Evidence, held_out: HeldOut, findings: Findings) -> Iterator[tuple[Level, str]]:
    """The size of the error, against noise, stroke, line and the fitted part.

    Bad is a model by what is neither slow nor hum in its error, up to `LOST`: motion is predicted where the zero
    drifts, or the sensor hums, too.
    """
    worst: Level = "doubtful" if _is_untested(found) else "bad"
    if _is_noise(found, held_out):
        if held_out.rmse_percent > POOR:
            yield (
                "bad",
                f"The error is {figures(held_out.rmse_percent, 2)} % of peak-to-peak, {_times(found.over_noise)} the "
                "noise of the sensor: average, or move more.",
            )
        return
    error, times = sizes(held_out.rmse_um, held_out.rmse_percent, found.over_noise, findings.noise_um)
    motion = held_out.rmse_percent * math.sqrt(max(1 - found.time - found.hum, 0.0))
    if found.over_line >= LINE:
        than = "hardly better" if found.over_line < 1 else "worse"
        level: Level = worst if motion > STRAIGHT else "doubtful"
        yield level, f"It predicts motion that it has not seen {than} than a straight line does: {error}."
    unexplained = motion > UNEXPLAINED[0] and found.over_noise > UNEXPLAINED[1]
    level = worst if motion > POOR or held_out.rmse_percent > LOST or unexplained else "doubtful"
    yield level, f"The error on motion that it has not seen is {error}: {times}. A better model may exist."
    if found.over_fitted > WORSE:
        yield "doubtful", _worse(found, findings)


def sizes(rmse_um: float, rmse_percent: float, over_noise: float, noise_um: float) -> tuple[str, str]:
    """An error in words: its size, and what it is of the noise of the sensor."""
    error = f"{figures(rmse_um)} um rms, {figures(rmse_percent, 2)} % of peak-to-peak"
    if over_noise > SILENT:
        return error, "the sensor shows no noise"
    return error, f"{_times(over_noise)} the sensor's noise of {noise_um:.2g} um"


def _of_zero(found: Evidence, held_out: HeldOut) -> Iterator[tuple[Level, str]]:
    """A zero that jumps, where the error is noise and not that of the model, or is another one behind a long gap."""
    if found.jump_um and _is_noise(found, held_out) and held_out.rmse_percent > NEGLIGIBLE:
        moved = f"{abs(found.jump_um):.3g} um {'above' if found.jump_um > 0 else 'below'} what it was before"
        yield (
            "doubtful",
            f"From {found.jump_s:.4g} s on the displacement is at once {moved}: did the zero of the sensor jump, or "
            "the mount slip? Use the rows before or after.",
        )
    if found.drift_percent > DRIFTED and not held_out.zero_um:
        yield (
            "doubtful",
            f"The zero drifts by {found.drift_percent:.0f} % of peak-to-peak within the record, as the displacement "
            "does beside its motion: the model does not predict it. Record warmed up, or measure the zero before use.",
        )
    if held_out.zero_um:
        moved = f"{abs(held_out.zero_um):.3g} um {'above' if held_out.zero_um > 0 else 'below'} that before"
        yield "doubtful", f"Behind a long gap the zero is {moved}; the errors are without it. Measure it on each day."


def _of_change(found: Evidence, findings: Findings) -> Iterator[tuple[Level, str]]:
    """A gain or a delay that is another one from some row on, where the error is noise and not that of the model."""
    since = f"From about {found.changed_s:.4g} s on the displacement"
    if found.gain_changed:
        size = f"{100 * abs(found.gain_changed):.2g} % {'further' if found.gain_changed > 0 else 'less far'}"
        yield (
            "doubtful",
            f"{since} moves {size} for the same voltage than before: did the gain or the range of sensor or amplifier "
            "change, or the load? Identify the rows before and after by themselves.",
        )
    if found.later_s:
        late = abs(found.later_s)
        rows = f"{max(round(late * findings.sample_rate_hz), 1)} rows, {_seconds(late)},"
        yield (
            "doubtful",
            f"{since} is {'later' if found.later_s > 0 else 'earlier'} by about {rows} than before: did one channel "
            "lose rows? Use the rows before or after.",
        )


def _of_dead_time(response: Response, findings: Findings) -> Iterator[tuple[Level, str]]:
    """A dead time that amplifier, sensor and converters do not have: one of the channels is late."""
    rows = response.delay * findings.sample_rate_hz
    if response.separable and response.delay > DEAD_TIME and rows > DEAD_ROWS:
        late = f"late by {_seconds(response.delay)} ({rows:.0f} rows) at all speeds"
        yield (
            "doubtful",
            f"The displacement is {late}, as hardly any is: is it shifted, or one channel buffered? Record both by one "
            "clock, or state the dead time (`delay`).",
        )


def _of_modes(dynamics: Dynamics, findings: Findings) -> Iterator[tuple[Level, str]]:
    """Modes that ring for so long that the record has few of their decays, and little of it shows the damping."""
    narrow = [m for m in dynamics.modes if 2 * m.damping * m.frequency * findings.duration_s < LINES]
    if narrow:
        modes = " and ".join(f"{m.frequency:.4g} Hz (damping {m.damping:.2g})" for m in narrow)
        longest = max(LINES / (2 * m.damping * m.frequency) for m in narrow)
        mode, its = ("modes", "their") if len(narrow) > 1 else ("mode", "its")
        yield (
            "doubtful",
            f"Few decays of the {mode} of {modes} are in the record, and decide {its} damping: larger steps are "
            f"predicted worse. Record {_seconds(longest)} and more, with steps as large as in use.",
        )


def _worse(found: Evidence, findings: Findings) -> str:
    """Why the held-out part is predicted worse than the fitted one."""
    text = f"The held-out part is predicted {_times(found.over_fitted)} worse than the fitted one"
    other = ", or score the model, which is fitted to all, on another record" if found.residual_percent < FITS else ""
    if found.until_left < UNTIL_THEN[0]:
        share = f"{figures(found.until_left, 2)} of its error until it goes beyond the voltages of the fitted rows"
        return f"{text}: it has {share} at {found.left_s:.4g} s. Record the whole range first{other}."
    if found.range_beyond > BEYOND:
        share = f"{100 * found.range_beyond:.0f} % beyond the voltages of the fitted part"
        return f"{text}: it goes {share}. Record the whole range first{other}."
    if found.strokes_beyond > BEYOND and found.time < SLOW[1]:
        share = f"{100 * found.strokes_beyond:.0f} % longer than those of the fitted part"
        return f"{text}: its strokes are up to {share}. Record strokes of all lengths first."
    if found.speed_beyond > BEYOND and found.time < SLOW[1]:
        share = f"{100 * found.speed_beyond:.0f} % faster than the fitted part"
        return f"{text}: it is {share}. Record all speeds first."
    if findings.states_known_s > LATE_STATES * findings.duration_s:
        reached = f"has been at both ends of its range only after {findings.states_known_s:.3g} s"
        return f"{text}, and the voltage {reached}: until then the turns before are not known. Drive all of it first."
    if found.time > SLOW[0]:
        return f"{text}, by a slow error. Record for longer, or warmed up."
    return f"{text}: something changed. Record for longer, or the same motion twice."


def _times(ratio: float) -> str:
    return f"{figures(ratio, 2)} times" if ratio < 100 else f"{ratio:.0f} times" if ratio < SILENT else "many times"


def _of_residual(found: Evidence, held_out: HeldOut, findings: Findings) -> Iterator[tuple[Level, str]]:
    """What the error depends on, each with its measurement."""
    if held_out.rmse_percent <= NEGLIGIBLE:
        return
    yield from _of_whiteness(found, findings)
    share, half = BEATEN
    if found.black_box > (half if _is_noise(found, held_out) else share):
        known, ratio = f"{100 * found.black_box:.0f} %", math.sqrt(1 - found.black_box)
        better = f"a model of another structure has {ratio:.2f} times this error"
        use = "Use this one where its error is small enough"
        yield "doubtful", f"{known} of the mean square error can be predicted: {better}. {use}."
    if _is_noise(found, held_out):
        return
    if found.time > SLOW[0] and not found.until_left < UNTIL_THEN[0]:
        slow = f"{100 * found.time:.0f} % of the error is slow: drift, creep, or a zero that moved"
        yield "doubtful", f"{slow}. Record for longer, warmed up, with a rest at the end."
    causes = {
        "voltage": "follows the voltage: the curve lacks a term. Record the whole range twice, slowly",
        "velocity": "follows the velocity: a lag or a rate dependence. Record strokes of several speeds, or hard steps",
        "history": "follows the reversals before: hysteresis. Record curves from reversals at many voltages",
    }
    shares = {name: getattr(found, name) for name in causes if found.time < SLOW[1]}
    for name, found_share in sorted(shares.items(), key=lambda entry: -entry[1]):
        if found_share > EXPLAINED:
            yield "doubtful", f"{100 * found_share:.0f} % of the error {causes[name]}."


def _of_whiteness(found: Evidence, findings: Findings) -> Iterator[tuple[Level, str]]:
    """Autocorrelation of the residual at all lags."""
    stroke = _stroke(findings)
    if findings.rows_per_value > 1 and (found.least_autocorrelation < OSCILLATES or found.line > LINE_SHARE):
        yield (
            "doubtful",
            f"The displacement has a new value in every {findings.rows_per_value}. row only, and the residual has its "
            "steps: record at the rate of the sensor, or leave out the rows between.",
        )
        return
    if found.line > LINE_SHARE and _is_above(found.line_hz, findings):
        yield (
            "doubtful",
            f"{100 * found.line:.0f} % of the error is one line at {figures(found.line_hz, 4)} Hz: hum, a floor that "
            f"shakes, or a stage that rings. Record at rest: if it is there, shield the sensor, or average over "
            f"{_seconds(1 / found.line_hz)}; if not, record for longer, so that the ringing ends within a tenth of it.",
        )
        return
    least, lag = found.least_autocorrelation, found.least_autocorrelation_s
    at = [f"{found.autocorrelation:.2f} at a lag of {_seconds(found.autocorrelation_s)}"]
    if least < OSCILLATES and least != found.autocorrelation:
        at.append(f"{least:.2f} at {_seconds(lag)}")
    text = f"autocorrelation {', '.join(at)}"
    if least < OSCILLATES and lag < WITHIN * stroke:
        yield "doubtful", f"The residual oscillates: {text}. A resonance, or hum: measure it with `truestroke bode`."
    elif abs(found.autocorrelation) > CORRELATED:
        yield "doubtful", f"The residual is not white: {text}."


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"


def _of_tested(found: Evidence) -> Iterator[tuple[Level, str]]:
    """Motion that fades: what the held-out part hardly has."""
    if found.strokes_tested < TESTED:
        yield (
            "doubtful",
            f"The strokes of the held-out part are {100 * found.strokes_tested:.0f} % as long as those of the record: "
            "the error of long ones is untested. Record long ones to the end, as of a random wave.",
        )


def _matters(findings: Findings, branches: bool) -> bool:
    """Whether loops of a kind that the record has not may be off by more than the noise: branches know no bounds.

    A delay that leaves hardly any of the loop may be hysteresis.
    """
    loop, width = findings.loop_width_percent, findings.hysteresis_percent
    if width is None or width < LEFT * loop:
        width = loop
    return OF_LOOP[branches] * width * findings.stroke_um > 100 * NOISE * findings.noise_um


def _of_excitation(findings: Findings, branches: bool) -> Iterator[tuple[Level, str]]:
    """What the record could not show, however small the error."""
    long = findings.stroke_lengths_percent[1]
    quick, slow = findings.stroke_durations_s
    if findings.strokes < 2:
        yield (
            "bad",
            "The voltage never turns: the hysteresis is the prior's, not that of this actuator. Record strokes up and "
            f"down, at least {FEW_STROKES}.",
        )
    elif findings.strokes < FEW_STROKES:
        yield "doubtful", f"The record has {findings.strokes} strokes: record at least {FEW_STROKES}."
    elif findings.one_length:
        yield (
            "doubtful",
            f"All strokes are about as long ({long:.0f} % of the span): for other motion the model is untested. Record "
            "strokes of many lengths, such as a random wave.",
        )
    elif findings.one_family and _matters(findings, branches):
        yield (
            "doubtful",
            "Strokes of one length are all at one voltage, as of a motion that grows, decays, or always comes back to "
            "one end: inner loops elsewhere are untested. Record a random wave.",
        )
    elif _matters(findings, branches) and slow < PACE * quick:
        yield (
            "doubtful",
            f"All strokes take about as long ({_seconds(slow)}), so that long ones are fast: at other speeds the model "
            "is untested. Record strokes of several speeds, such as a random wave.",
        )
    if narrow := findings.narrow:
        yield (
            "doubtful",
            f"{narrow[0].upper()}{narrow[1:]}: for motion beside that the model is hardly tested. Record a random wave "
            "over all voltages that you use, or leave out the rows before and behind it.",
        )
    elif findings.volts_visited_percent < VISITED:
        yield (
            "doubtful",
            "The voltage is at few levels, and hardly in between: for other motion the model is untested. Record ways "
            "between them, such as a random wave.",
        )
    if findings.assumed_displacement:
        yield (
            "doubtful",
            "The unit of the displacement is not stated, um is assumed: state it (`displacement_unit`).",
        )
