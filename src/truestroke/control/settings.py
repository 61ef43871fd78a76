"""The controller's settings: one frozen object, a unit on every member."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model import prior

MAX_PLAYS = 32
MAX_DEAD_ZONES = 8
MAX_CREEPS = 8
MAX_ASYMMETRY = 2
RATE_DEPENDENT = (0, 3, 6, 9, 12)  # which of the plays have a rate weight: the gradient matters for the first few only
STROKES = (1e-6, 1e9)  # um
LARGEST = 1e15  # of a setting, in its unit
STEEPEST = 1e30  # um/V: of a slope, whatever stroke and voltage limits are
UNLIMITED = 1e9  # for a limit that is not there: finite, so that it can be written to any file


@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """What a controller is told about the actuator and about how to learn.

    Only the first three are needed; the rest follows from them. Entries that are given as None are filled in, so that
    a settings object always holds the numbers that are used. q below is stroke / (highest - lowest voltage), um/V.

    Attributes
    ----------
    sample_rate : float
        Ticks per second, Hz.
    stroke : float
        Length of the travel that is asked for, um.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage that may leave the controller, V at the D/A converter.
    plays : int
        Number of play operators, 1 to 32.
    thresholds : tuple[float, ...]
        Thresholds r of the plays, V, ascending from 0; by default `prior.thresholds`.
    rate_dependent : tuple[int, ...]
        Which plays have a rate weight b.
    creep_times : tuple[float, ...]
        Time constants of the creep states, s; () is no creep.
    lag : bool
        Whether the model has a term in the velocity (a delay).
    offset : bool
        Whether it has a constant (drift).
    asymmetry : int
        Terms of asymmetry, 0 to 2: 4 s (1 - s) and 8 s (1 - s)(1 - 2 s), with s = z_d / stroke.
    dead_zone_thresholds : tuple[float, ...]
        Thresholds d' of the inverse dead zones, um, ascending from 0.
    dead_zone_weights : tuple[float, ...]
        Weights w_s' of the inverse dead zones, without unit; (1,) is none.
    rate_scale : float
        c_b of (20), s/um; 0 makes the plays independent of the rate. By default 1 / (50 strokes/s).
    initial_sensitivity : float
        First weight of w(0), um/V; by default 1.15 q.
    initial_weights : tuple[float, ...]
        w(0), um/V, in place of `initial_sensitivity`: [a0, b0, a1, b1, ...] (b_i where play i is rate-dependent),
        then the weights of the creep states (um/V), lag (s), offset (um) and asymmetry (um). It is also the mean of the
        prior.
    law : str
        "kalman", or "rls" for (23).
    prior_covariance : tuple[tuple[float, ...], ...]
        Covariance of w(0), m rows of m, in the squares of the units of w; by default `prior.covariance`. Kalman only.
    prior_return_time : float
        Time in which what was learned fades to the prior where nothing confirms it, s. Kalman only.
    filter_frequency : float
        Corner of each of the two poles that regressor and measurement pass through, Hz: below the first resonance of
        the stage. By default 300 Hz, at most 15 % of the sample rate and half the resonance. Kalman only.
    resonance : float
        First resonance of the stage under its load, Hz, at most half the sample rate; 0: not known. With it the command
        knows the stage's inertia, and the law's filter ends below it. Kalman only.
    model_error : float
        What the model cannot explain, um, added to the noise; by default 0.02 % of the stroke. Kalman only.
    change_threshold : float
        Mean square of the normalised innovation above which the actuator has changed suddenly. Kalman only.
    change_refractory : float
        Least time from one change to the next, s. Kalman only.
    change_gain : float
        Relative standard deviation of a sudden change of all play weights together, 0 to 1. Kalman only.
    change_hysteresis : float
        The same of all but the first, 0 to 1. Kalman only.
    change_share : float
        How far the covariance returns to the prior at a change, 0 to 1. Kalman only.
    outlier : float
        Normalised innovation above which a measurement is a spike. Kalman only.
    outliers : int
        Spikes in a row that are not believed. Kalman only.
    forgetting : float
        Forgetting factor lambda of (23), 0.001 to 1. RLS only.
    regularization : float
        delta of (22), V^2: P(0) = I / delta. RLS only.
    covariance_limit : float
        Largest trace of P, 1/V^2: above it the division by lambda is left out. RLS only.
    slope_limits : tuple[float, float]
        Smallest and largest partial slope, um/V; by default 0.4 q and 4 q.
    velocity_limit : float
        The slopes are within their limits at every rate that was commanded, up to this one, um/s; by default 50
        strokes/s. Kalman only.
    slew_limit : float
        Fastest change of the voltage, V/s; by default 120 times the voltage range.
    measurement_limit : float
        A measurement beyond it, on either side, is rejected, um; by default 10 strokes.
    smoothing_time : float
        Time constant with which what was learned reaches the command, s; 0 is at once. By default 0.72 ms, at least
        0.216 periods of the resonance.
    trim_rate : float
        Slow feedback: integral of the error into the command, 1/s; 0 is off.
    precision : str
        "double", or "single" to compute as a microcontroller would.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> s.plays, len(s.initial_weights), round(s.initial_sensitivity, 3)
    (24, 37, 8.214)
    >>> ControllerSettings(sample_rate=2000.0, stroke=-30.0, voltage_limits=(-0.6, 3.6))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: stroke = -30.0 um: must be above 0 um
    """

    sample_rate: float
    stroke: float
    voltage_limits: tuple[float, float]
    # model
    plays: int = 24
    thresholds: tuple[float, ...] = None  # type: ignore[assignment]  # None is filled in by __post_init__
    rate_dependent: tuple[int, ...] = None  # type: ignore[assignment]
    creep_times: tuple[float, ...] = (0.003, 0.03, 0.3, 3.0)
    lag: bool = True
    offset: bool = True
    asymmetry: int = 2
    dead_zone_thresholds: tuple[float, ...] = (0.0,)
    dead_zone_weights: tuple[float, ...] = (1.0,)
    rate_scale: float = None  # type: ignore[assignment]
    initial_sensitivity: float = None  # type: ignore[assignment]
    initial_weights: tuple[float, ...] = None  # type: ignore[assignment]
    # law
    law: Literal["kalman", "rls"] = "kalman"
    prior_covariance: tuple[tuple[float, ...], ...] = None  # type: ignore[assignment]
    prior_return_time: float = 1e5
    filter_frequency: float = None  # type: ignore[assignment]
    resonance: float = 0.0
    model_error: float = None  # type: ignore[assignment]
    change_threshold: float = 12.0
    change_refractory: float = 0.005
    change_gain: float = 0.15
    change_hysteresis: float = 0.3
    change_share: float = 0.002
    outlier: float = 12.0
    outliers: int = 3
    forgetting: float = 0.9999
    regularization: float = 1e-3
    covariance_limit: float = 1e6
    # safety
    slope_limits: tuple[float, float] = None  # type: ignore[assignment]
    velocity_limit: float = None  # type: ignore[assignment]
    slew_limit: float = None  # type: ignore[assignment]
    measurement_limit: float = None  # type: ignore[assignment]
    smoothing_time: float = None  # type: ignore[assignment]
    trim_rate: float = 0.0
    precision: Literal["double", "single"] = "double"

    def __post_init__(self) -> None:
        for step in (_basics, _model, _start, _kalman, _rls, _safety):
            for name, value in step(self).items():
                object.__setattr__(self, name, value)

    @property
    def parameters(self) -> int:
        """Number m of the parameters."""
        terms = len(self.creep_times) + self.lag + self.offset + self.asymmetry
        return len(self.thresholds) + len(self.rate_dependent) + terms

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order.

        Examples
        --------
        >>> bench = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
        >>> ControllerSettings(**bench, plays=2, creep_times=(0.3,), asymmetry=1).names
        ('a0', 'b0', 'a1', 'creep 0.3 s', 'lag', 'offset', 'asymmetry 1')
        """
        plays = [
            name for i in range(self.plays) for name in ((f"a{i}", f"b{i}") if i in self.rate_dependent else (f"a{i}",))
        ]
        creeps = [f"creep {tau:g} s" for tau in self.creep_times]
        asymmetry = [f"asymmetry {i + 1}" for i in range(self.asymmetry)]
        return (*plays, *creeps, *["lag"] * self.lag, *["offset"] * self.offset, *asymmetry)

    @property
    def q(self) -> float:
        """stroke / (highest - lowest voltage), um/V."""
        return self.stroke / (self.voltage_limits[1] - self.voltage_limits[0])

    def reach(self, volts: float) -> float:
        """How far from 0 an actuator under `volts` (V) may be, um.

        A sensor that shows more is not zeroed, or is another's. Three strokes, and three times what `volts` bring of
        the stroke; at most `measurement_limit`.

        Examples
        --------
        >>> ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(0.0, 10.0)).reach(5.0)
        135.0
        """
        low, high = self.voltage_limits
        return min(3 * self.stroke * (1 + abs(volts) / (high - low)), self.measurement_limit)

    def check_reach(self, argument: str, z: float, volts: float) -> None:
        """Refuse a displacement z (um) that an actuator under `volts` (V) cannot have."""
        if abs(z) > (reach := self.reach(volts)):
            raise checks.beyond_reach(argument, z, volts, reach, self.stroke)

    def to_dict(self) -> dict[str, float | str | Sequence[float]]:
        """All settings by name, as plain numbers and tuples, for a recording or a file."""
        return dataclasses.asdict(self)

    @classmethod
    def paper(
        cls, *, sample_rate: float, stroke: float, voltage_limits: tuple[float, float], **changes: Any
    ) -> ControllerSettings:
        """The settings of the paper: 8 plays, w(0) = [5, 0, ...], c_b = 0.007 s/um, lambda = 0.9999, delta = 1e-3.

        Nothing else is in the model or in the way; `changes` replace any of them, for rivals of the same kind.
        """
        low, high = _voltage_limits(voltage_limits)
        stroke = checks.sized("stroke", stroke, "um", *STROKES)
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


# ---- What follows from what ----------------------------------------------------------------------------------------


def _basics(s: ControllerSettings) -> dict[str, object]:
    return {
        "precision": checks.one_of("precision", s.precision, ("double", "single")),
        "law": checks.one_of("law", s.law, ("kalman", "rls")),
        "sample_rate": checks.sized("sample_rate", s.sample_rate, "Hz", 1e-6, 1e8),
        "stroke": checks.sized("stroke", s.stroke, "um", *STROKES),
        "voltage_limits": _voltage_limits(s.voltage_limits),
    }


def _voltage_limits(value: object) -> tuple[float, float]:
    low, high = checks.interval("voltage_limits", value, "V")
    if high - low < 1e-9 or max(-low, high) > 1e9:
        raise SettingError("voltage_limits", value, "within 1e9 V of 0 and at least 1e-9 V apart", "V")
    return low, high


def _model(s: ControllerSettings) -> dict[str, object]:
    low, high = s.voltage_limits
    if s.thresholds is None:
        thresholds = prior.thresholds(checks.count("plays", s.plays, 1, MAX_PLAYS), high - low)
    else:
        thresholds = checks.ascending("thresholds", s.thresholds, "V")
        checks.within("thresholds", thresholds[-1], 0.0, LARGEST, "V")
    plays = checks.count("the number of thresholds", len(thresholds), 1, MAX_PLAYS)
    rate_dependent = tuple(i for i in RATE_DEPENDENT if i < plays) if s.rate_dependent is None else s.rate_dependent
    creep_times = tuple(checks.sized("creep_times", t, "s") for t in checks.several("creep_times", s.creep_times, "s"))
    checks.count("the number of creep_times", len(creep_times), 0, MAX_CREEPS)
    rate_scale = 1 / (50 * s.stroke) if s.rate_scale is None else s.rate_scale
    return {
        "plays": plays,
        "thresholds": thresholds,
        "rate_dependent": tuple(
            sorted(
                {
                    checks.count("rate_dependent", i, 0, plays - 1)
                    for i in checks.several("rate_dependent", rate_dependent)
                }
            )
        ),
        "creep_times": creep_times,
        "lag": checks.flag("lag", s.lag),
        "offset": checks.flag("offset", s.offset),
        "asymmetry": checks.count("asymmetry", s.asymmetry, 0, MAX_ASYMMETRY),
        "rate_scale": checks.within("rate_scale", rate_scale, 0.0, 1e6, "s/um"),
        **_dead_zones(s),
    }


def _dead_zones(s: ControllerSettings) -> dict[str, object]:
    thresholds = checks.ascending("dead_zone_thresholds", s.dead_zone_thresholds, "um")
    checks.count("the number of dead_zone_thresholds", len(thresholds), 1, MAX_DEAD_ZONES)
    checks.within("dead_zone_thresholds", thresholds[-1], 0.0, LARGEST, "um")
    several = checks.several("dead_zone_weights", s.dead_zone_weights)
    weights = tuple(checks.within("dead_zone_weights", w, -LARGEST, LARGEST) for w in several)
    if len(weights) != len(thresholds):
        raise SettingError("dead_zone_weights", weights, f"{len(thresholds)} numbers, one for each threshold")
    if any(sum(weights[: i + 1]) < 1 / LARGEST for i in range(len(weights))):
        raise SettingError("dead_zone_weights", weights, "numbers whose partial sums are all above 0")
    return {"dead_zone_thresholds": thresholds, "dead_zone_weights": weights}


def _play_weights(s: ControllerSettings, first: float) -> FloatArray:
    if s.law == "rls":  # (22): the first weight, all others 0
        return np.array([first, *[0.0] * (s.plays - 1)])
    return prior.play_weights(s.thresholds, s.voltage_limits[1] - s.voltage_limits[0], first)


def _start(s: ControllerSettings) -> dict[str, object]:
    """w(0), and the covariance of the prior about it."""
    if s.initial_weights is not None:
        several = checks.several("initial_weights", s.initial_weights, "um/V")
        weights = tuple(checks.within("initial_weights", w, -STEEPEST, STEEPEST, "um/V") for w in several)
        if len(weights) != s.parameters:
            raise SettingError("initial_weights", weights, f"{s.parameters} numbers [a0, b0, a1, b1, ...]", "um/V")
        first = checks.positive("initial_weights[0]", weights[0], "um/V")
    else:
        first = prior.FIRST_SLOPE * s.q if s.initial_sensitivity is None else s.initial_sensitivity
        first = checks.sized("initial_sensitivity", first, "um/V", 1 / STEEPEST, STEEPEST)
        a = _play_weights(s, first)
        plays = [w for i in range(s.plays) for w in ([float(a[i]), 0.0] if i in s.rate_dependent else [float(a[i])])]
        lag = [prior.LAG if s.law == "kalman" else 0.0] * s.lag
        weights = (*plays, *[0.0] * len(s.creep_times), *lag, *[0.0] * (s.offset + s.asymmetry))
    return {"initial_sensitivity": first, "initial_weights": weights, "prior_covariance": _covariance(s, first)}


def _covariance(s: ControllerSettings, first: float) -> tuple[tuple[float, ...], ...]:
    if s.law == "rls":
        return ()
    if s.prior_covariance is None:
        P0 = prior.covariance(
            _play_weights(s, first),
            s.rate_dependent,
            q=s.q,
            stroke=s.stroke,
            creeps=len(s.creep_times),
            lag=s.lag,
            offset=s.offset,
            asymmetry=s.asymmetry,
        )
    else:
        P0 = checks.finite_array("prior_covariance", s.prior_covariance, ndim=2)
        largest = float(np.abs(P0).max(initial=0.0))
        if largest > STEEPEST**2:
            raise SettingError("prior_covariance", largest, f"of entries up to {STEEPEST**2:g}")
        if P0.shape != (s.parameters, s.parameters) or not np.allclose(P0, P0.T) or np.linalg.eigvalsh(P0).min() <= 0:
            bound = f"symmetric and positive definite, of shape ({s.parameters}, {s.parameters})"
            raise SettingError("prior_covariance", f"array of shape {P0.shape}", bound)
    return tuple(tuple(row) for row in P0.tolist())


def _resonance(s: ControllerSettings) -> float:
    resonance, least, most = checks.number("resonance", s.resonance, "Hz"), 1e-6 * s.sample_rate, s.sample_rate / 2
    if resonance != 0 and not least <= resonance <= most:
        bound = f"from {least:g} to {most:g} Hz, half the sample rate, or 0 where it is not known or above that"
        raise SettingError("resonance", resonance, bound, "Hz")
    return resonance


def _kalman(s: ControllerSettings) -> dict[str, object]:
    resonance, corner = _resonance(s), s.filter_frequency
    if corner is None:
        corner = min(widest_filter(s.sample_rate), resonance / 2 or math.inf)
    error = 2e-4 * s.stroke if s.model_error is None else s.model_error
    return {
        "prior_return_time": checks.sized("prior_return_time", s.prior_return_time, "s"),
        "filter_frequency": checks.within("filter_frequency", corner, 1e-6 * s.sample_rate, 0.5 * s.sample_rate, "Hz"),
        "resonance": resonance,
        "model_error": checks.within("model_error", error, 0.0, s.stroke, "um"),
        "change_threshold": checks.sized("change_threshold", s.change_threshold),
        "change_refractory": checks.within("change_refractory", s.change_refractory, 0.0, 3600.0, "s"),
        "change_gain": checks.within("change_gain", s.change_gain, 0.0, 1.0),
        "change_hysteresis": checks.within("change_hysteresis", s.change_hysteresis, 0.0, 1.0),
        "change_share": checks.within("change_share", s.change_share, 0.0, 1.0),
        "outlier": checks.sized("outlier", s.outlier),
        "outliers": checks.count("outliers", s.outliers, 0, 1_000_000),
    }


def _rls(s: ControllerSettings) -> dict[str, object]:
    regularization = checks.sized("regularization", s.regularization, "V^2")
    limit = checks.sized("covariance_limit", s.covariance_limit, "1/V^2", most=1e18)
    trace = s.parameters / regularization
    if limit < trace:
        raise SettingError("covariance_limit", limit, f"at least the trace of P(0), {trace:g} 1/V^2", "1/V^2")
    forgetting = checks.within("forgetting", s.forgetting, 1e-3, 1.0)
    return {"forgetting": forgetting, "regularization": regularization, "covariance_limit": limit}


def _safety(s: ControllerSettings) -> dict[str, object]:
    low, high = s.voltage_limits
    slopes = (0.4 * s.q, 4 * s.q) if s.slope_limits is None else s.slope_limits
    slopes = checks.interval("slope_limits", slopes, "um/V")
    checks.sized("slope_limits[0]", slopes[0], "um/V", 1 / STEEPEST, STEEPEST)
    checks.within("slope_limits[1]", slopes[1], 0.0, STEEPEST, "um/V")
    slew = 120 * (high - low) if s.slew_limit is None else s.slew_limit
    smoothing = s.smoothing_time
    if smoothing is None:
        smoothing = min(1.0, max(SMOOTHING, SMOOTHING_PERIODS / s.resonance)) if s.resonance else SMOOTHING
    measured = 10 * s.stroke if s.measurement_limit is None else s.measurement_limit
    velocity = 50 * s.stroke if s.velocity_limit is None else s.velocity_limit
    return {
        "slope_limits": slopes,
        "velocity_limit": checks.sized("velocity_limit", velocity, "um/s"),
        "slew_limit": checks.sized("slew_limit", slew, "V/s"),
        "measurement_limit": checks.sized("measurement_limit", measured, "um"),
        "smoothing_time": checks.within("smoothing_time", smoothing, 0.0, 1.0, "s"),
        "trim_rate": checks.within("trim_rate", s.trim_rate, 0.0, s.sample_rate, "1/s"),
    }


# ---- As the kernel takes them --------------------------------------------------------------------------------------


def kernel_settings(s: ControllerSettings) -> dict[str, Any]:
    """The settings by the names of c/include/truestroke.h, times turned into coefficients of a tick."""
    fs = s.sample_rate
    lower = np.tril_indices(s.parameters)
    return {
        "thresholds": list(s.thresholds),
        "dead_zone_thresholds": list(s.dead_zone_thresholds),
        "dead_zone_weights": list(s.dead_zone_weights),
        "creep": [-math.expm1(-1 / (tau * fs)) for tau in s.creep_times],
        "asymmetry": s.asymmetry,
        "lag": s.lag,
        "offset": s.offset,
        "rate_dependent": [i in s.rate_dependent for i in range(s.plays)],
        "rate_scale": s.rate_scale,
        "stroke": s.stroke,
        "initial_weights": list(s.initial_weights),
        "kalman": s.law == "kalman",
        "forgetting": s.forgetting,
        "regularization": s.regularization,
        "covariance_limit": s.covariance_limit,
        "filter": -math.expm1(-2 * math.pi * s.filter_frequency / fs),
        "noise_rate": min(1.0, NOISE_RATE / fs),
        "ringing_rate": min(1.0, RINGING_RATE / fs),
        "model_error": s.model_error,
        "prior_return": min(1.0, FORGET_EVERY / (s.prior_return_time * fs)),
        "change_threshold": s.change_threshold,
        "change_rate": min(1.0, CHANGE_RATE / fs),
        "refractory": min(round(s.change_refractory * fs), 2**31 - 1),
        "change_gain": s.change_gain,
        "change_hysteresis": s.change_hysteresis,
        "change_share": s.change_share,
        "outlier": s.outlier,
        "outliers": s.outliers,
        "prior": np.array(s.prior_covariance)[lower].tolist() if s.law == "kalman" else [],
        "first_noise": 1e-3 * s.stroke,
        "velocity_limit": s.velocity_limit,
        "slope_min": s.slope_limits[0],
        "slope_max": s.slope_limits[1],
        "voltage_min": s.voltage_limits[0],
        "voltage_max": s.voltage_limits[1],
        "slew": s.slew_limit / fs,
        "measurement_limit": s.measurement_limit,
        "smoothing": math.exp(-1 / (fs * s.smoothing_time)) if s.smoothing_time > 0 else 0.0,
        "trim": s.trim_rate / fs,
        "resonance": s.resonance / fs,
        **_oscillation(s),
    }


def _oscillation(s: ControllerSettings) -> dict[str, float]:
    """Of the frequencies and sizes that an oscillation of the law's own making has."""
    fs, corner = s.sample_rate, max(s.filter_frequency, widest_filter(s.sample_rate))
    fast = -math.expm1(-2 * math.pi * corner / fs)
    return {
        "tick": 1 / fs,
        "corner": min(1.15 * corner / fs, 1.0),
        "fast": fast,
        "slow": -math.expm1(-2 * math.pi * corner / 20 / fs),
        "motion_rate": min(1.0, MOTION_RATE / fs),
        "noise_share": 3 * math.sqrt(fast / (2 - fast)),
        "floor": 0.005 * s.stroke,
        "large": 0.02 * s.stroke,
    }


def widest_filter(sample_rate: float) -> float:
    """Corner of the law's filter where no resonance is known, Hz."""
    return min(300.0, 0.15 * sample_rate)


FORGET_EVERY = 16  # ticks: TS_FORGET_EVERY of the kernel
NOISE_RATE = 2.0  # 1/s: how fast the robust estimate of the noise follows
RINGING_RATE = 200.0  # 1/s: how fast ringing counts as noise
SMOOTHING = 0.72e-3  # s: smoothing_time where no resonance is known
SMOOTHING_PERIODS = 0.216  # of the resonance: the same ratio to the corner of the law's filter
MOTION_RATE = 10.0  # 1/s: how fast the means of the motion follow
CHANGE_RATE = 400.0  # 1/s: how fast the detector of a change follows
