"""The controller's settings: one frozen object, each setting declared once, in `SETTINGS`."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Unpack

import numpy as np

from truestroke.base import checks, declared, toml
from truestroke.base.checks import SettingError
from truestroke.base.declared import FOLLOWS, HUGE, SHARE, Bound, Setting, Times, between, bound, sized, whole
from truestroke.base.display import Displayed, Rows
from truestroke.base.typing import FloatArray
from truestroke.control import feedback, sensor, stage
from truestroke.control.adaptation import RETURN_EVERY
from truestroke.control.feedback import Feedback
from truestroke.control.options import SettingsOptions
from truestroke.model import layout, prior
from truestroke.model.dynamics import LATEST, Dynamics
from truestroke.model.layout import MAX_PLAYS, TERMS, Layout, Term

MAX_DEAD_ZONES = 8
RATE_WEIGHTS = 5  # of the paper's eight plays: the gradient matters for the first few only
STROKES = 50.0  # 1/s: speed at which a rate weight counts in full
STEEPEST = 1e30  # um/V: of a slope, whatever stroke and voltage limits are
UNLIMITED = 1e9  # for a limit that is not there: finite, so that it can be written to any file

NOISE_RATE = 2.0  # 1/s: how fast the robust estimate of the noise follows
RINGING_RATE = 200.0  # 1/s: how fast ringing counts as noise
SMOOTHING = 0.72e-3  # s: smoothing_time where no resonance is known
SMOOTHING_PERIODS = 0.216  # of the resonance: the same ratio to the corner of the law's filter
SMOOTHING_KNOWN = 0.5  # periods of the first resonance of `dynamics`
FILTER_SHARE = 1.6  # of the first resonance: corner of the three poles of the law where the stage is known
LAG_SHARE, INERTIA_SHARE = 0.01, 0.05  # of 1 / w0 and 1 / w0^2: what may be missing in known dynamics, one deviation
RESONANCE_SHARE = 0.1  # of 1 / w0^2: the same where only the resonance is set
DUHEM_DEVIATION = 0.1  # of stroke / voltage range: of a weight of a state of Duhem where the stage is known
COUPLING_SHARES = 0.2, 4.0  # of 1 / w0 and 1 / w0^2: what velocity and acceleration of another axis do, one deviation
DUHEM_LENGTHS = 1.0, 0.25  # of the voltage range: states of Duhem, for minor loops that do not close
SLEW = 120.0  # voltage ranges a second
SLEW_OF_DYNAMICS = 6.0  # voltage ranges in a period of the first resonance of the dynamics,
SLEW_OF_RESONANCE = 2.0  # and where `resonance` alone is known: twice what a sine of f0/3 over the whole travel needs
MOTION_RATE = 10.0  # 1/s: how fast the means of the motion follow
USUAL_RATE = 16.0  # 1/s: how fast the usual error of the model follows, to which a change is related
RANGE_RATE = 1.0  # 1/s: how fast the range of the motion shrinks
GUARD_PERIODS = 4.0  # of the resonance: a window of the guard
GUARD_FLOOR = 0.002  # of the stroke: an error below it is no failure of learning
RECALLS = 4  # blocks of a window of the guard, in which kept weights are compared with measurements
BURST = 5.0  # times the motion so far: an error beyond it, before anything was good, where no stage is given
CHANGE_RATE = 400.0  # 1/s: how fast the detector of a change follows


# ---- Bounds that are not those of one number -------------------------------------------------------------------------


@bound("low < high, each in [-1e9, 1e9]")
def _voltages(_: Any, name: str, value: Any, unit: str) -> tuple[float, float]:
    low, high = checks.interval(name, value, unit)
    if high - low < 1e-9 or max(-low, high) > 1e9:
        raise SettingError(name, value, "within 1e9 V of 0 and at least 1e-9 V apart", unit)
    return low, high


@bound("0, or from 1e-6 * sample_rate to 0.5 * sample_rate")
def _resonances(s: ControllerSettings, name: str, value: Any, unit: str) -> float:
    frequency, least, most = checks.number(name, value, unit), 1e-6 * s.sample_rate, s.sample_rate / 2
    if frequency != 0 and not least <= frequency <= most:
        words = f"from {least:g} to {most:g} Hz, half the sample rate, or 0 where it is not known or above that"
        raise SettingError(name, frequency, words, unit)
    return frequency


@bound("a Dynamics of this sample_rate, or the path of a dynamics.toml; None is not known")
def _dynamics(s: ControllerSettings, name: str, value: Any, unit: str) -> Dynamics | None:
    if value is None or s.law == "rls":
        if value is not None:
            raise SettingError(name, "a Dynamics", 'None for law = "rls", whose equations have no stage')
        return None
    if isinstance(value, str | os.PathLike):
        value = Dynamics.load(value)
    elif isinstance(value, Mapping):
        value = Dynamics.from_dict(value)
    words = "a Dynamics, such as of truestroke.measure_dynamics(actuator), or the path of its file"
    return checks.instance(name, value, Dynamics, words).check_rate(s.sample_rate)


def _sensor(s: ControllerSettings, name: str, value: float) -> float:
    """The same as in the dynamics, where they are known: the sensor is in them."""
    if s.dynamics is not None and value != (known := getattr(s.dynamics, name)):
        words = f"left out, or {known:g} as in dynamics: measure them again with it, truestroke bode --{name}"
        raise SettingError(name, value, words.replace("_", "-"), SETTINGS[name].unit)
    return value


@bound("0 to 20 ticks; as in `dynamics` where they are known")
def _sensor_delay(s: ControllerSettings, name: str, value: Any, unit: str) -> float:
    least = 0.0 if s.dynamics is None else -math.inf  # dynamics have their own bounds
    return _sensor(s, name, checks.within(name, value, least, LATEST / s.sample_rate, unit))


@bound("0, or from 1e-3 to 1e9; as in `dynamics` where they are known")
def _sensor_bandwidth(s: ControllerSettings, name: str, value: Any, unit: str) -> float:
    corner = checks.number(name, value, unit)
    return _sensor(s, name, checks.sized(name, corner, unit, 1e-3, 1e9) if corner else 0.0)


@bound("lines of the mains, Hz: 50 means 50, 100 and 150; () is none")
def _hum(s: ControllerSettings, name: str, value: Any, unit: str) -> tuple[float, ...]:
    lines = feedback.lines_of(value, s.sample_rate)
    if lines and s.law != "kalman":
        raise SettingError(name, lines, "() with the law of the paper: leave it out, or take the default law", unit)
    return lines


def _line(frequency: float, rate: float) -> tuple[float, float, float]:
    """Cosine and sine of its angle in a tick, and 1/s."""
    angle = 2 * math.pi * frequency / rate
    return math.cos(angle), math.sin(angle), 2 * math.pi * frequency


@bound("a Feedback, True for its design from the dynamics, False for none")
def _feedback(s: ControllerSettings, name: str, value: Any, unit: str) -> Feedback:
    none = Feedback(sample_rate=s.sample_rate, latency=s.latency)
    if isinstance(value, Mapping):
        value = toml.decode(Feedback, value)
    if value is False or (value is True and s.dynamics is None):
        return _hears(s, none)
    if value is True:
        return default_feedback(s)
    found = checks.instance(name, value, Feedback, "a Feedback of truestroke.control.feedback.design, True or False")
    if not found.filters:
        return _hears(s, found)
    if (found.sample_rate, found.latency) != (s.sample_rate, s.latency):
        words = f"designed for {s.sample_rate:g} Hz and a latency of {s.latency} ticks, those of the controller"
        raise SettingError(name, f"a Feedback for {found.sample_rate:g} Hz and {found.latency} ticks", words)
    if s.dynamics is None:
        words = "False without dynamics, as its margins are those of the dynamics that it was designed from"
        raise SettingError(name, f"a Feedback of {len(found.filters)} filters", words)
    if not found.is_stable(s.dynamics):
        words = "stable with these dynamics, and it was designed for others; True designs one for these"
        raise SettingError(name, f"a Feedback of {len(found.filters)} filters", words)
    return _hears(s, found)


def _hears(s: ControllerSettings, found: Feedback) -> Feedback:
    """The feedback, where it has a resonator for each line of `hum`, says why not, or leaves hum to the command."""
    if not found.filters or found.reasons or set(s.hum) <= set(found.hum):
        return found
    bound = "() where the feedback has no resonator for them: leave out hum, or leave out feedback"
    raise SettingError("hum", s.hum, bound, "Hz")


@bound(f"[1, {MAX_PLAYS}]")
def _number_of_plays(s: ControllerSettings, name: str, value: Any, unit: str) -> int:
    if s.thresholds is None:
        return checks.count(name, value, 1, MAX_PLAYS)
    return len(declared.checked(SETTINGS, "thresholds", s.thresholds))


@bound("each in [0, plays - 1]")
def _indices_of_plays(s: ControllerSettings, name: str, value: Any, unit: str) -> tuple[int, ...]:
    return tuple(sorted({checks.count(name, i, 0, s.plays - 1) for i in checks.several(name, value)}))


@bound("partial sums above 0")
def _dead_zone_weights(s: ControllerSettings, name: str, value: Any, unit: str) -> tuple[float, ...]:
    weights = tuple(checks.within(name, w, -HUGE, HUGE) for w in checks.several(name, value))
    if len(weights) != len(s.dead_zone_thresholds):
        raise SettingError(name, weights, f"{len(s.dead_zone_thresholds)} numbers, one for each threshold")
    if any(sum(weights[: i + 1]) < 1 / HUGE for i in range(len(weights))):
        raise SettingError(name, weights, "numbers whose partial sums are all above 0")
    return weights


@bound("[1e-30, 1e30]")
def _first_weight(s: ControllerSettings, name: str, value: Any, unit: str) -> float:
    if s.initial_weights is None:
        return checks.sized(name, value, unit, 1 / STEEPEST, STEEPEST)
    weights = _all_weights.check(s, "initial_weights", s.initial_weights, unit)
    return checks.positive("initial_weights[0]", weights[0], unit)


@bound("each in [-1e30, 1e30]")
def _all_weights(s: ControllerSettings, name: str, value: Any, unit: str) -> tuple[float, ...]:
    weights = tuple(checks.within(name, w, -STEEPEST, STEEPEST, unit) for w in checks.several(name, value, unit))
    if len(weights) != s.parameters:
        raise SettingError(name, weights, f"{s.parameters} numbers [a0, b0, a1, b1, ...]", unit)
    return weights


@bound("symmetric, positive definite")
def _covariances(s: ControllerSettings, name: str, value: Any, unit: str) -> tuple[tuple[float, ...], ...]:
    if s.law == "rls":
        return ()
    P0, m = checks.finite_array(name, value, ndim=2), s.parameters
    largest = float(np.abs(P0).max(initial=0.0))
    if largest > STEEPEST**2:
        raise SettingError(name, largest, f"of entries up to {STEEPEST**2:g}")
    good = P0.shape == (m, m) and np.allclose(P0, P0.T)
    # The default is not tested: it is positive definite but for rounding.
    if not good or (s.prior_covariance is not None and not _positive_definite(P0)):
        words = f"symmetric and positive definite, of shape ({m}, {m})"
        raise SettingError(name, f"array of shape {P0.shape}", words)
    return tuple(tuple(row) for row in P0.tolist())


def _positive_definite(P: FloatArray) -> bool:
    """Whether a symmetric matrix is positive definite; its rows may be of very different units."""
    variances = np.diag(P)
    if not np.all(variances > 0):
        return False
    scale = np.sqrt(variances)
    return bool(np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > 0)


@bound("at least the trace of P(0), up to 1e18")
def _traces(s: ControllerSettings, name: str, value: Any, unit: str) -> float:
    limit, trace = checks.sized(name, value, unit, most=1e18), s.parameters / s.regularization
    if limit < trace:
        raise SettingError(name, limit, f"at least the trace of P(0), {trace:g} {unit}", unit)
    return limit


@bound("0 < low < high <= 1e30")
def _slopes(_: Any, name: str, value: Any, unit: str) -> tuple[float, float]:
    low, high = checks.interval(name, value, unit)
    checks.sized(f"{name}[0]", low, unit, 1 / STEEPEST, STEEPEST)
    return low, checks.within(f"{name}[1]", high, 0.0, STEEPEST, unit)


# ---- Defaults that follow from other settings ------------------------------------------------------------------------


def default_thresholds(s: ControllerSettings) -> tuple[float, ...]:
    """`prior.thresholds`: over 0 to 36 % of the voltage range, the denser the nearer to 0."""
    return prior.thresholds(s.plays, s.voltage_range)


def default_rate_dependent(s: ControllerSettings) -> tuple[int, ...]:
    """The plays nearest to the first five thresholds of the paper: i / 8 of 36 % of the voltage range."""
    even = np.array(prior.thresholds(prior.EVEN, s.voltage_range)[:RATE_WEIGHTS])
    nearest = np.abs(np.array(s.thresholds)[:, np.newaxis] - even).argmin(axis=0)
    return tuple(sorted(set(nearest.tolist())))


def default_rate_scale(s: ControllerSettings) -> float:
    """`1 / (50 * stroke)`; with `dynamics` the first resonance, Hz, takes the place of 50, if it is more."""
    first = 0.0 if s.dynamics is None else s.dynamics.modes[0].frequency
    return 1 / (max(STROKES, first) * s.stroke)


def default_inertia(s: ControllerSettings) -> bool:
    """Whether `dynamics` are known."""
    return s.dynamics is not None


def default_duhem_lengths(s: ControllerSettings) -> tuple[float, ...]:
    """The voltage range, and a quarter of it; none for "rls"."""
    with_them = s.law is not None and str(s.law) != "rls"  # it is not checked yet
    return tuple(share * s.voltage_range for share in DUHEM_LENGTHS) if with_them else ()


def default_feedback(s: ControllerSettings) -> Feedback:
    """Designed from the `dynamics`; none where they are not known."""
    if s.dynamics is None:
        return Feedback(sample_rate=s.sample_rate, latency=s.latency)
    return feedback.design(s.dynamics, latency=s.latency, stroke=s.stroke, hum=s.hum)


def default_sensor_delay(s: ControllerSettings) -> float:
    """That of the `dynamics`; 0 where they are not known."""
    return 0.0 if s.dynamics is None else s.dynamics.sensor_delay


def default_sensor_bandwidth(s: ControllerSettings) -> float:
    """That of the `dynamics`; 0, no lag, where they are not known."""
    return 0.0 if s.dynamics is None else s.dynamics.sensor_bandwidth


def default_weights(s: ControllerSettings) -> tuple[float, ...]:
    """`prior.play_weights` and the lag of the prior; for "rls" the first weight alone."""
    a = _play_weights(s)
    return tuple((prior.mean(s, a, expected_terms(s)) if s.law == "kalman" else s.vector(a)).tolist())


def _play_weights(s: ControllerSettings) -> FloatArray:
    if s.law == "rls":  # (22): the first weight, all others 0
        return np.array([s.initial_sensitivity, *[0.0] * (s.plays - 1)])
    return prior.play_weights(s.thresholds, s.voltage_range, s.initial_sensitivity)


def default_covariance(s: ControllerSettings) -> FloatArray | None:
    """`prior.covariance` of `prior.play_weights`."""
    if s.law == "rls":
        return None
    return prior.covariance(s, _play_weights(s), q=s.q, stroke=s.stroke, terms=expected_terms(s))


def expected_terms(s: ControllerSettings) -> Mapping[str, Term]:
    """The known terms: lag and inertia are in the dynamics, or in `resonance`, but for their errors.

    States of Duhem are expected to do more where the stage is known: elsewhere the law would follow loads by them.
    What another axis does through velocity and acceleration is scaled by the stage that answers it, too.
    """
    if s.dynamics is None and not s.resonance:
        return TERMS
    w = 2 * math.pi * (s.resonance if s.dynamics is None else s.dynamics.modes[0].frequency)
    errors = {"inertia": RESONANCE_SHARE / w**2}
    if s.dynamics is not None:
        errors = {"lag": LAG_SHARE / w, "inertia": INERTIA_SHARE / w**2, "duhem": DUHEM_DEVIATION}
    taken = {"coupling_lag": COUPLING_SHARES[0] / w, "coupling_inertia": COUPLING_SHARES[1] / w**2}
    errors |= {name: min(TERMS[name].deviation, deviation) for name, deviation in taken.items()}
    return {**TERMS, **{name: dataclasses.replace(TERMS[name], mean=0.0, deviation=d) for name, d in errors.items()}}


def default_filter_frequency(s: ControllerSettings) -> float:
    """300 Hz, at most 15 % of the sample rate and half the resonance; 1.6 times that of `dynamics`."""
    if s.dynamics is not None:
        return min(FILTER_SHARE * s.dynamics.modes[0].frequency, 0.45 * s.sample_rate)
    return min(widest_filter(s.sample_rate), s.resonance / 2 or math.inf)


def default_return_time(s: ControllerSettings) -> float:
    """100,000 s; 20,000 s with `dynamics`: fast motion shows what the model has not."""
    return 2e4 if s.dynamics is not None else 1e5


def default_change_threshold(s: ControllerSettings) -> float:
    """12; 28 with `hum`, which is no change of the actuator."""
    return 28.0 if s.hum else 12.0


def default_slope_limits(s: ControllerSettings) -> tuple[float, float]:
    """`(0.15 * q, 25 * q)`: stroke or voltage limits may be given five times too wide."""
    return 0.15 * s.q, 25 * s.q


def default_slew_limit(s: ControllerSettings) -> float:
    """`120 * voltage_range`; in a period of f0 2 ranges with `resonance`, 6 with `dynamics`, if that is more."""
    # `feasibility` raises it for a known motion that needs more
    known = s.dynamics
    of_stage = SLEW_OF_RESONANCE * s.resonance if known is None else SLEW_OF_DYNAMICS * known.modes[0].frequency
    return max(SLEW, of_stage) * s.voltage_range


def default_smoothing_time(s: ControllerSettings) -> float:
    """0.72 ms, at least 0.216 periods of `resonance`, or half a period of the first one of `dynamics`."""
    periods = SMOOTHING_PERIODS / s.resonance if s.resonance else 0.0
    if s.dynamics is not None and not s.resonance:
        periods = SMOOTHING_KNOWN / s.dynamics.modes[0].frequency
    return min(1.0, max(SMOOTHING, periods))


def widest_filter(sample_rate: float) -> float:
    """Corner of the law's filter where no resonance is known, Hz."""
    return min(300.0, 0.15 * sample_rate)


# ---- The declaration -------------------------------------------------------------------------------------------------


def _kalman(meaning: str, unit: str, bound: Bound, member: str = "{name}", **others: Any) -> Setting:
    """A setting of the Kalman filter, which may change while running."""
    return Setting(meaning, unit, bound, law="kalman", changeable=True, kernel=f"kalman.{member}", **others)


def _per_tick(value: float, s: ControllerSettings) -> float:
    return value / s.sample_rate


# fmt: off
SETTINGS: declared.Table = {
    # actuator
    "sample_rate": Setting("Ticks per second", "Hz", sized(1e-6, 1e8), kernel=""),
    "stroke": Setting("Length of the travel that is asked for", "um", sized(1e-6, 1e9)),
    "voltage_limits": Setting(
        "Lowest and highest voltage that may leave the controller, at the D/A converter", "V", _voltages,
        changeable=True, kernel="voltage_min voltage_max",
    ),
    "resonance": Setting(
        "First resonance of the stage under its load within 15 %, 0 where it is not known; the stage is then in the "
        "model from the start, and its resonance is measured while it moves", "Hz", _resonances,
        law="kalman", changeable=True, convert=_per_tick,
    ),
    "dynamics": Setting(
        "Modes, lags and dead time of the stage and the sensor; the command inverts them", "",
        _dynamics, kernel="",
    ),
    "sensor_delay": Setting(
        "Of the sensor, from the displacement to its measurement, beside the mean over a tick: of any fraction of one",
        "s", _sensor_delay, default_sensor_delay, kernel="",
    ),
    "sensor_bandwidth": Setting(
        "Corner of the sensor's first-order lag; 0 is none", "Hz",
        _sensor_bandwidth, default_sensor_bandwidth, kernel="",
    ),
    "latency": Setting(
        "Ticks from a command to its measurement, beside the one until the next command; the feedback counts with it",
        "", whole(0, 20), changeable=True, kernel="",
    ),
    "hum": Setting(
        "Lines of the mains: the law learns without them, and feedback or command takes them away", "Hz", _hum,
        changeable=True, kernel="hum.line hum.lines",
        convert=lambda lines, s: ([_line(f, s.sample_rate) for f in lines], len(lines)),
    ),
    "feedback": Setting(
        "Filters of the error against loads, ringing and hum, with their margins", "", _feedback, default_feedback,
        changeable=True, kernel="feedback.filter feedback.filters feedback.most",
        convert=lambda bank, _: ([list(q) for q in bank.filters], len(bank.filters), bank.most),
    ),
    # model
    "plays": Setting("Number of play operators", "", _number_of_plays),
    "thresholds": Setting("Thresholds r of the plays", "V", declared.ascending(MAX_PLAYS), default_thresholds),
    "rate_dependent": Setting(
        "Which plays have a rate weight b", "", _indices_of_plays, default_rate_dependent,
        convert=lambda chosen, s: [i in chosen for i in range(s.plays)],
    ),
    **layout.SETTINGS,
    "inertia": dataclasses.replace(layout.SETTINGS["inertia"], rule=default_inertia),
    "duhem_lengths": dataclasses.replace(layout.SETTINGS["duhem_lengths"], rule=default_duhem_lengths),
    "dead_zone_thresholds": Setting(
        "Thresholds d' of the inverse dead zones", "um", declared.ascending(MAX_DEAD_ZONES),
        kernel="dead_zone_thresholds dead_zones", convert=lambda d, _: (d, len(d)),
    ),
    "dead_zone_weights": Setting(
        "Weights w_s' of the inverse dead zones; (1.0,) is none", "", _dead_zone_weights, changeable=True
    ),
    "rate_scale": Setting(
        "c_b of (20); 0 makes the plays independent of the rate", "s/um", between(0, 1e6), default_rate_scale,
        changeable=True,
    ),
    # law
    "law": Setting(
        'What adapts the weights: the Kalman filter, or "rls" for (23)', "", declared.word("kalman", "rls"),
        convert=lambda law, _: ("rls", "kalman").index(law),
    ),
    "initial_sensitivity": Setting(
        "First weight of w(0)", "um/V", _first_weight, Times(prior.FIRST_SLOPE, "q"), kernel=""
    ),
    "initial_weights": Setting(
        "w(0) in place of `initial_sensitivity`, the mean of the prior: [a0, b0, a1, b1, ...] (b_i where play i is "
        "rate-dependent), then creep (um/V), lag (s), inertia (s^2), offset (um), asymmetry (um), duhem (um/V) and "
        "coupling (um/um, s, s^2)", "um/V", _all_weights,
        default_weights,
    ),
    "prior_covariance": Setting(
        "Covariance P0 of w(0), m rows of m, in the squares of the units of w", "", _covariances, default_covariance,
        law="kalman", kernel="prior", convert=lambda P0, s: np.array(P0)[np.tril_indices(len(P0))] if P0 else [],
    ),
    "prior_return_time": _kalman(
        "Time in which the weights return to the prior where nothing confirms them", "s", sized(), "prior_return",
        rule=default_return_time, convert=lambda time, s: min(1.0, RETURN_EVERY / (time * s.sample_rate)),
    ),
    "filter_frequency": _kalman(
        "Corner of each of the two poles, with `dynamics` three, that regressor and measurement pass through", "Hz",
        between(Times(1e-6, "sample_rate"), Times(0.5, "sample_rate")), "filter", rule=default_filter_frequency,
        convert=lambda corner, s: -math.expm1(-2 * math.pi * corner / s.sample_rate),
    ),
    "model_error": _kalman(
        "What the model cannot explain, added to the noise", "um", between(0, Times(1, "stroke")),
        rule=Times(2e-4, "stroke"),
    ),
    "change_threshold": _kalman(
        "Mean square of the normalised innovation above which the actuator has changed suddenly", "", sized(),
        rule=default_change_threshold,
    ),
    "change_refractory": _kalman(
        "Least time from one change to the next", "s", between(0, 3600), "refractory",
        convert=lambda time, s: min(round(time * s.sample_rate), 2**31 - 1),
    ),
    "change_gain": _kalman("Relative standard deviation of a sudden change of all play weights together", "", SHARE),
    "change_hysteresis": _kalman("The same of all play weights but the first", "", SHARE),
    "change_share": _kalman("How far the covariance returns to the prior at a change", "", SHARE),
    "outlier": _kalman("Normalised innovation above which a measurement is a spike", "", sized()),
    "outliers": _kalman("Spikes in a row that are rejected", "", whole(0, 1_000_000)),
    "forgetting": Setting(
        "Forgetting factor lambda of (23)", "", between(1e-3, 1), law="rls", changeable=True
    ),
    "regularization": Setting(
        "delta of (22): P(0) = I / delta", "V^2", Bound("above 0, up to 1e15", sized().check), law="rls"
    ),
    "covariance_limit": Setting(
        "Largest trace of P: above it the division by lambda is left out", "1/V^2", _traces, law="rls", changeable=True
    ),
    # safety
    "slope_limits": Setting(
        "Smallest and largest partial slope of the weights at rest; at speed the inverse goes to a twentieth of the "
        "smallest", "um/V", _slopes, default_slope_limits, changeable=True, kernel="slope_min slope_max",
    ),
    "velocity_limit": Setting(
        "The weights are held so that the slopes are within their limits at every rate that was commanded, up to this "
        "one; 0: at rest", "um/s", between(0, 1e15),
        law="kalman", changeable=True,
    ),
    "slew_limit": Setting(
        "Fastest change of the voltage", "V/s", sized(), default_slew_limit, changeable=True,
        kernel="slew", convert=_per_tick,
    ),
    "measurement_limit": Setting(
        "A measurement beyond it, on either side, is rejected", "um", sized(), Times(10, "stroke"), changeable=True
    ),
    "smoothing_time": Setting(
        "Time constant with which a change of the weights reaches the command; 0 is at once", "s", SHARE,
        default_smoothing_time, changeable=True, kernel="smoothing",
        convert=lambda time, s: math.exp(-1 / (s.sample_rate * time)) if time > 0 else 0.0,
    ),
    "trim_rate": Setting(
        "Slow feedback: integral of the error into the command; 0 is off", "1/s", between(0, Times(1, "sample_rate")),
        changeable=True, kernel="trim", convert=_per_tick,
    ),
    "precision": Setting(
        'Number type; "single" computes as a microcontroller would', "", declared.word("double", "single"), kernel=""
    ),
}
# fmt: on
"""The declaration: a setting more is a line here, a field of `ControllerSettings`, and a member of ts_settings in C."""

CHANGEABLE = tuple(name for name, setting in SETTINGS.items() if setting.changeable)
"""Settings that a controller's `change` takes."""


@declared.documented(SETTINGS)
@dataclass(frozen=True, kw_only=True, repr=False)
class ControllerSettings(Displayed, Layout):
    """The actuator's data and the parameters of the adaptation.

    Only the first three are needed; the rest follows from them. Entries that are given as None are filled in, so that
    a settings object always holds the numbers that are used. q is stroke / voltage_range, um/V.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> s.plays, len(s.initial_weights), round(s.initial_sensitivity, 3)
    (26, 41, 8.214)
    >>> ControllerSettings(sample_rate=2000.0, stroke=-30.0, voltage_limits=(-0.6, 3.6))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: stroke = -30.0 um: must be above 0 um
    """

    sample_rate: float
    stroke: float
    voltage_limits: tuple[float, float]
    resonance: float = 0.0
    dynamics: Dynamics | None = None
    sensor_delay: float = FOLLOWS
    sensor_bandwidth: float = FOLLOWS
    latency: int = 0
    hum: tuple[float, ...] = ()
    feedback: Feedback = FOLLOWS
    plays: int = 26
    thresholds: tuple[float, ...] = FOLLOWS
    rate_dependent: tuple[int, ...] = FOLLOWS
    creep_times: tuple[float, ...] = (0.003, 0.03, 0.3, 3.0)
    inertia: bool = FOLLOWS
    asymmetry: int = 2
    duhem_lengths: tuple[float, ...] = FOLLOWS
    other_axes: int = 0
    dead_zone_thresholds: tuple[float, ...] = (0.0,)
    dead_zone_weights: tuple[float, ...] = (1.0,)
    rate_scale: float = FOLLOWS
    law: Literal["kalman", "rls"] = "kalman"
    initial_sensitivity: float = FOLLOWS
    initial_weights: tuple[float, ...] = FOLLOWS
    prior_covariance: tuple[tuple[float, ...], ...] = FOLLOWS
    prior_return_time: float = FOLLOWS
    filter_frequency: float = FOLLOWS
    model_error: float = FOLLOWS
    change_threshold: float = FOLLOWS
    change_refractory: float = 0.005
    change_gain: float = 0.15
    change_hysteresis: float = 0.3
    change_share: float = 0.002
    outlier: float = 12.0
    outliers: int = 3
    forgetting: float = 0.9999
    regularization: float = 1e-3
    covariance_limit: float = 1e6
    slope_limits: tuple[float, float] = FOLLOWS
    velocity_limit: float = 0.0
    slew_limit: float = FOLLOWS
    measurement_limit: float = FOLLOWS
    smoothing_time: float = FOLLOWS
    trim_rate: float = 0.0
    precision: Literal["double", "single"] = "double"

    def __post_init__(self) -> None:
        declared.complete(self, SETTINGS)

    @property
    def q(self) -> float:
        """stroke / voltage_range, um/V."""
        return self.stroke / self.voltage_range

    @property
    def voltage_range(self) -> float:
        """Highest less lowest voltage, V."""
        return self.voltage_limits[1] - self.voltage_limits[0]

    def changed(self, given: Mapping[str, Any]) -> ControllerSettings:
        """Other values of some settings; what follows from them, and was not chosen, follows again."""
        follow = {"filter_frequency", "smoothing_time"} if "resonance" in given else set()
        if "resonance" in given and self.slew_limit == default_slew_limit(self):
            follow |= {"slew_limit"}
        if given.keys() & {"latency", "hum"} and self.feedback == default_feedback(self):
            follow |= {"feedback"}
        if "hum" in given and self.change_threshold == default_change_threshold(self):
            follow |= {"change_threshold"}
        return dataclasses.replace(self, **{**dict.fromkeys(follow), **given})

    def among(self, other_axes: int) -> ControllerSettings:
        """These settings for an axis beside so many others, whose coupling is not known: its weights are 0.

        Examples
        --------
        >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(0.0, 10.0)).among(1)
        >>> s.names[-3:], s.initial_weights[-3:]
        (('coupling 1', 'coupling_lag 1', 'coupling_inertia 1'), (0.0, 0.0, 0.0))
        """
        alone = self.parameters - 3 * self.other_axes
        known = expected_terms(self)
        taken = [known[name].deviation for name in ("coupling", "coupling_lag", "coupling_inertia")]
        deviations = np.repeat(taken, checks.count("other_axes", other_axes, 0, layout.MAX_OTHERS))
        P0 = np.diag(np.concatenate([np.zeros(alone), np.square(deviations)]))
        if self.law == "kalman":
            P0[:alone, :alone] = np.array(self.prior_covariance)[:alone, :alone]
        prior: Any = tuple(map(tuple, P0.tolist())) if self.law == "kalman" else None
        weights = (*self.initial_weights[:alone], *[0.0] * deviations.size)
        return dataclasses.replace(self, other_axes=other_axes, initial_weights=weights, prior_covariance=prior)

    def reach(self, volts: float) -> float:
        """How far from 0 an actuator under `volts` (V) may be, um.

        With a larger reading the sensor is not zeroed, or is that of another axis. Three strokes, and three times the
        part of the stroke; at most `measurement_limit`.

        Examples
        --------
        >>> ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(0.0, 10.0)).reach(5.0)
        135.0
        """
        return min(3 * self.stroke * (1 + abs(volts) / self.voltage_range), self.measurement_limit)

    def check_reach(self, argument: str, z: float, volts: float) -> None:
        """Refuse a displacement z (um) that an actuator under `volts` (V) cannot have."""
        if abs(z) > (reach := self.reach(volts)):
            raise checks.beyond_reach(argument, z, volts, reach, self.stroke)

    def _display(self) -> tuple[str, Rows]:
        return f"ControllerSettings: {self.summary}", declared.rows(self, SETTINGS)

    @property
    def summary(self) -> str:
        """Law and model in a line, as controllers show them."""
        return f"{self.law}, {self.plays} plays, {self.parameters} weights, {self.precision} precision"

    def describe(self) -> list[dict[str, Any]]:
        """The declaration of each setting, with its value here: of new settings the table of all defaults.

        Returns
        -------
        list of dict
            name, value, unit, bound, default, law, changeable, kernel (members of ts_settings in C) and meaning.

        Examples
        --------
        >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
        >>> limit = next(row for row in s.describe() if row["name"] == "measurement_limit")
        >>> limit["value"], limit["unit"], limit["default"], limit["kernel"]
        (300.0, 'um', '`10 * stroke`', ['measurement_limit'])
        """
        return declared.described(self, SETTINGS)

    def to_dict(self) -> dict[str, float | str | Sequence[float]]:
        """All settings by name, as plain numbers and tuples, for a recording or a file."""
        values: dict[str, Any] = {name: getattr(self, name) for name in SETTINGS}
        within = {name: v for name, v in values.items() if isinstance(v, Dynamics | Feedback)}
        return values | {name: dataclasses.asdict(v) for name, v in within.items()}  # of all: it copies each number

    def __deepcopy__(self, _: dict[int, Any]) -> ControllerSettings:
        return self  # nothing in it changes; a copy of a controller copied each number of the prior

    @classmethod
    def paper(
        cls,
        *,
        sample_rate: float,
        stroke: float,
        voltage_limits: tuple[float, float],
        **changes: Unpack[SettingsOptions],
    ) -> ControllerSettings:
        """The settings of the paper: 8 plays, w(0) = [5, 0, ...], c_b = 0.007 s/um, lambda = 0.9999, delta = 1e-3.

        The model and the law have no other parts; `changes` replace any of them, for comparisons.
        """
        low, high = declared.checked(SETTINGS, "voltage_limits", voltage_limits)
        stroke = declared.checked(SETTINGS, "stroke", stroke)
        if low + high <= 0 and "thresholds" not in changes:
            raise SettingError("thresholds", None, "given where the middle of voltage_limits is not above 0 V", "V")
        plays = checks.count("plays", changes.get("plays", 8), 1, MAX_PLAYS)
        literal: dict[str, Any] = {
            "plays": plays,
            # r_n is half of the maximum input: the middle of the range, 1.5 V for the paper's stack
            "thresholds": tuple(i / plays * (low + high) / 2 for i in range(plays)),
            "creep_times": (),
            "lag": False,
            "offset": False,
            "asymmetry": 0,
            "duhem_lengths": (),
            "rate_scale": 0.007,
            "initial_sensitivity": 5.0,
            "law": "rls",
            "slope_limits": (0.05 * stroke / (high - low), UNLIMITED),
            "slew_limit": UNLIMITED,
            "smoothing_time": 0.0,
        }
        thresholds = changes.get("thresholds")
        known = literal["thresholds"] if thresholds is None else checks.several("thresholds", thresholds, "V")
        literal["rate_dependent"] = tuple(range(len(known)))
        return cls(sample_rate=sample_rate, stroke=stroke, voltage_limits=voltage_limits, **{**literal, **changes})


# ---- As the kernel takes them ----------------------------------------------------------------------------------------


def kernel_settings(s: ControllerSettings) -> dict[str, Any]:
    """The members of ts_settings in c/include/truestroke.h: coefficients of a tick; 0 what belongs to another law."""
    if s.dynamics is None:
        known = stage.NOT_KNOWN | sensor.members(s.sample_rate, s.sensor_delay, s.sensor_bandwidth)
    else:
        known = stage.members(s.dynamics) | sensor.IN_DYNAMICS
    return declared.kernel_values(s, SETTINGS, s.law) | _derived(s) | known


def _guard_window(s: ControllerSettings) -> float:
    """Of the error that learning must not increase, s: four periods of the resonance, if it is known."""
    f0 = s.dynamics.modes[0].frequency if s.dynamics is not None else s.resonance
    return min(max(GUARD_PERIODS / f0, 0.02), 0.1) if f0 else 0.05


def _derived(s: ControllerSettings) -> dict[str, float]:
    """What the Kalman law needs beside its settings: rates of its estimates, and what an oscillation looks like."""
    fs, corner = s.sample_rate, max(s.filter_frequency, widest_filter(s.sample_rate))
    fast = -math.expm1(-2 * math.pi * corner / fs)
    members = {
        "first_noise": 1e-3 * s.stroke,
        "kalman.noise_rate": min(1.0, NOISE_RATE / fs),
        "kalman.ringing_rate": min(1.0, RINGING_RATE / fs),
        "kalman.change_rate": min(1.0, CHANGE_RATE / fs),
        "kalman.usual_rate": min(1.0, USUAL_RATE / fs),
        "oscillation.tick": 1 / fs,
        "oscillation.corner": min(1.15 * corner / fs, 1.0),
        "oscillation.fast": fast,
        "oscillation.slow": -math.expm1(-2 * math.pi * corner / 20 / fs),
        "oscillation.motion_rate": min(1.0, MOTION_RATE / fs),
        "oscillation.noise_share": 3 * math.sqrt(fast / (2 - fast)),
        "oscillation.floor": 0.005 * s.stroke,
        "oscillation.large": 0.02 * s.stroke,
        "guard.window": round(fs * _guard_window(s)),
        "guard.range_rate": min(1.0, RANGE_RATE / fs),
        "guard.floor": GUARD_FLOOR * s.stroke,
        "guard.burst": BURST if s.dynamics is None else 0.0,
        "guard.recall": max(round(fs * _guard_window(s)) // RECALLS, 1) if s.dynamics is None else 0,
    }
    return members if s.law == "kalman" else {name: type(value)(0) for name, value in members.items()}
