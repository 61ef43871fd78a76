"""Metrics of a run, each with its formula.

The error of tick k is e(k) = z(k) - z_d(k): the mean displacement over the tick against the desired value of that tick.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.flags import BIT, FLAGS
from truestroke.base.typing import FloatArray

WINDOW = 0.25  # s, over which convergence is judged
SHARE, OF_STROKE = 0.02, 0.001  # of the motion and of the stroke: what an error may be
NOISE_LIMIT = 0.005  # of the stroke: what may pass for noise of the sensor
AT_LIMIT = 0.01  # of the ticks of the second half: a run with more at a voltage limit and far off has not converged

Labelled = Mapping[str, npt.NDArray[Any]]
"""Arrays by name: a Recording, or a dict."""


def rms(error: FloatArray) -> float:
    """Root mean square, sqrt(mean of e^2), of an array that is known to be finite, in its unit.

    Examples
    --------
    >>> round(rms(np.array([3.0, 4.0])), 4)
    3.5355
    """
    return float(np.sqrt(np.mean(error**2)))


def rmse(desired: npt.ArrayLike, measured: npt.ArrayLike) -> float:
    """Root mean square of the error, sqrt(mean of e^2), um.

    Parameters
    ----------
    desired, measured : array_like, shape (ticks,)
        um, finite.

    Examples
    --------
    >>> round(rmse([0.0, 0.0], [3.0, 4.0]), 4)
    3.5355
    """
    return rms(_error(desired, measured))


def maximum_error(desired: npt.ArrayLike, measured: npt.ArrayLike) -> float:
    """Largest absolute error, max of abs(e), um.

    Examples
    --------
    >>> maximum_error([0.0, 0.0], [3.0, -4.0])
    4.0
    """
    return float(np.max(np.abs(_error(desired, measured))))


def peak_to_peak(z: npt.ArrayLike) -> float:
    """Highest minus lowest value, max z - min z, um.

    Examples
    --------
    >>> peak_to_peak([1.0, -2.0, 0.5])
    3.0
    """
    return float(np.ptp(checks.finite_array("z", z, "um")))


def convergence_time(time: npt.ArrayLike, error: npt.ArrayLike, level: float | None = None) -> float | None:
    """Time after which the error stays near what it ends with, s from the start.

    The smallest t for which every window of 0.25 s that begins at t or later has
    sqrt(mean of e^2 over the window) <= 2 level.

    Parameters
    ----------
    time, error : array_like, shape (ticks,)
        s, evenly spaced, and um; at least four windows long.
    level : float, optional
        The rms error that it ends with, um; by default sqrt(mean of e^2 over the second half).

    Returns
    -------
    float or None
        None if even the last window exceeds it: the error never settles.

    Examples
    --------
    >>> time = np.arange(4000) / 1000.0
    >>> convergence_time(time, np.where(time < 0.5, 8.0, 1.0))
    0.489
    """
    time, error = checks.finite_array("time", time, "s"), checks.finite_array("error", error, "um")
    if time.size != error.size:
        raise SettingError("error", f"array of shape {error.shape}", f"of shape {time.shape}", "um")
    duration = _duration(time)
    if duration < 4 * WINDOW:
        raise SettingError("time", f"{duration:g}", f"at least {4 * WINDOW:g} s long", "s")
    window = round(WINDOW / duration * time.size)
    squares = np.concatenate([[0.0], np.cumsum(error**2)])
    limit = 4 * (np.mean(error[time.size // 2 :] ** 2) if level is None else checks.number("level", level, "um") ** 2)
    exceeds = np.flatnonzero((squares[window:] - squares[:-window]) / window > limit * (1 + 1e-9))
    if not exceeds.size:
        return 0.0
    first = int(exceeds[-1]) + 1
    return float(time[first] - time[0]) if first + window <= time.size else None


def noise(error: npt.ArrayLike) -> float:
    """Standard deviation of the sensor's noise in an error, um: median of abs(second difference) / (0.6745 sqrt 6).

    What moves slowly against the sample rate drops out of the second difference, single spikes out of the median. It
    is at least that of the sensor's steps, the smallest one over sqrt 12.

    Parameters
    ----------
    error : array_like
        Or a displacement at rest, um; evenly sampled, NaN is left out.

    Examples
    --------
    >>> t = np.arange(20_000) / 2000.0
    >>> white = np.random.Generator(np.random.PCG64(0)).normal(0.0, 0.013, t.size)
    >>> round(noise(white + np.sin(50 * t)), 3)
    0.013
    """
    values = np.asarray(error, dtype=np.float64)
    known = values[np.isfinite(values)]
    if known.size < 3:
        return 0.0
    steps = np.abs(np.diff(known))
    step = float(np.min(steps[steps > 0], initial=np.inf))
    white = float(np.median(np.abs(np.diff(known, 2)))) / (0.6745 * np.sqrt(6))
    return float(max(white, step / np.sqrt(12) if np.isfinite(step) else 0.0))


def tolerable(span: float, stroke: float, noise: float) -> float:
    """What an error may be, um: the largest of 2 % of the motion, 0.1 % of the stroke, and the sensor's noise.

    A good run has no larger rms error, and one whose error stays above twice that has not converged
    (docs/exit-codes.md).

    Parameters
    ----------
    span, stroke : float
        Peak-to-peak of the motion, and the stroke of the actuator, um.
    noise : float
        Standard deviation, um; it counts up to 0.5 % of the stroke, beyond which it is no noise.

    Examples
    --------
    >>> tolerable(20.0, 30.0, 0.013), tolerable(0.05, 30.0, 0.013)
    (0.4, 0.03)
    """
    return max(SHARE * span, OF_STROKE * stroke, min(noise, NOISE_LIMIT * stroke))


def phase_lag(desired: npt.ArrayLike, measured: npt.ArrayLike, sample_rate: float, frequency: float) -> float:
    """Angle by which `measured` comes after `desired` at one frequency, degrees in (-180, 180].

    Each is projected on 1, cos(w t) and sin(w t) by least squares; with D and M the complex amplitudes,
    lag = arg(D / M).

    Parameters
    ----------
    desired, measured : array_like, shape (ticks,)
        um; a period or more.
    sample_rate, frequency : float
        Hz.

    Examples
    --------
    >>> t = np.arange(2000) / 2000.0
    >>> round(phase_lag(np.sin(50 * t), np.sin(50 * t - 0.1), 2000.0, 50 / (2 * np.pi)), 4)
    5.7296
    """
    desired, measured = _pair(desired, measured)
    omega = 2 * np.pi * checks.positive("frequency", frequency, "Hz")  # rad/s
    angle = omega / checks.positive("sample_rate", sample_rate, "Hz")
    if angle * desired.size < 2 * np.pi:
        raise SettingError("desired", f"{desired.size} ticks", f"at least a period, {2 * np.pi / angle:g} ticks")
    phase = angle * np.arange(desired.size)
    basis = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
    fit = np.linalg.lstsq(basis, np.column_stack([desired, measured]), rcond=None)[0]
    d, m = fit[1] - 1j * fit[2]
    return float(np.degrees(np.angle(d * np.conj(m))))


def delay(desired: npt.ArrayLike, measured: npt.ArrayLike, sample_rate: float, longest: float = 50.0) -> float:
    """Time by which `measured` comes after `desired`, ms: where their correlation coefficient peaks.

    For each lag of whole ticks up to `longest`, the correlation coefficient of measured(k) and desired(k - lag) over
    the same measured(k); the peak is that of the parabola through the highest three.

    Parameters
    ----------
    desired, measured : array_like, shape (ticks,)
        um; longer than 4 `longest`.
    sample_rate : float
        Hz.
    longest : float
        Largest delay looked for, either way, ms.

    Raises
    ------
    SettingError
        The correlation still rises at the longest delay; a motion is too short or constant.

    Examples
    --------
    >>> t = np.arange(4000) / 2000.0
    >>> wave = lambda t: np.sin(50 * t) + np.sin(83 * t + 1.0)
    >>> round(delay(wave(t), 0.5 * wave(t - 0.0013), 2000.0), 4)
    1.3
    """
    desired, measured = _pair(desired, measured)
    seconds = checks.positive("longest", longest, "ms") / 1000
    lags = int(np.ceil(seconds * checks.positive("sample_rate", sample_rate, "Hz")))
    if desired.size <= 4 * lags or not np.ptp(desired) or not np.ptp(measured):
        raise SettingError("desired", f"{desired.size} ticks", f"a motion of more than {4 * lags} ticks")
    inner = measured[lags:-lags]
    ends = range(2 * lags, -1, -1)  # where desired(k - lag) begins, for lag = -lags ... lags
    r = np.array([np.corrcoef(inner, desired[start : start + inner.size])[0, 1] for start in ends])
    best = int(np.argmax(r))
    if best in (0, 2 * lags):
        raise SettingError("longest", longest, "longer: the correlation still rises there", "ms")
    before, peak, after = r[best - 1 : best + 2]
    vertex = 0.5 * (before - after) / (before - 2 * peak + after)
    return float(1000 * (best - lags + vertex) / sample_rate)


def loop_width(x: npt.ArrayLike, z: npt.ArrayLike) -> float:
    """Largest vertical width of a hysteresis loop, % of the peak-to-peak of z.

    With z_up and z_down the rising and the falling branch over x,
    100 max over x of abs(z_down(x) - z_up(x)) / (max z - min z).

    Parameters
    ----------
    x, z : array_like, shape (ticks,)
        One closed cycle, starting anywhere, of the input (any unit) and the displacement, um. Slow, or the width
        counts the phase lag, too.

    Examples
    --------
    >>> t = np.linspace(0.0, 2 * np.pi, 2001)[:-1]
    >>> round(loop_width(np.cos(t), np.cos(t - 0.1)), 2)  # an ellipse: 100 sin(0.1)
    9.98
    """
    x, z = _pair(x, z)
    if not np.ptp(x) or not np.ptp(z):
        raise SettingError("x", f"{x.size} ticks", "a motion, not a rest")
    start = int(np.argmin(x))
    x, z = (np.append(np.roll(a, -start), a[start]) for a in (x, z))
    top = int(np.argmax(x))
    grid = np.linspace(x[0], x[top], 1001)
    up, down = (_branch(grid, x[part], z[part]) for part in (slice(0, top + 1), slice(top, None)))
    return float(100 * np.max(np.abs(down - up)) / np.ptp(z))


def _branch(grid: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
    order = np.argsort(x, kind="stable")
    return np.interp(grid, x[order], z[order])


def _duration(time: FloatArray) -> float:
    """From the start of the first tick to the end of the last, s."""
    return float(time[-1] - time[0]) * time.size / max(time.size - 1, 1) if time.size else 0.0


def _pair(first: npt.ArrayLike, second: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    a, b = checks.finite_array("desired", first, "um"), checks.finite_array("measured", second, "um")
    if a.shape != b.shape or not a.size:
        raise SettingError("measured", f"array of shape {b.shape}", f"of shape {a.shape}, not empty", "um")
    return a, b


def _error(desired: npt.ArrayLike, measured: npt.ArrayLike) -> FloatArray:
    z_d, z = _pair(desired, measured)
    return z - z_d


# ---- Of a whole recording ------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class TrackingSummary:
    """The table of a run. Errors count from `counted_from_s`, flags over the whole run.

    Where the recording has the channel `flat`, errors count where it is up alone, and so does the peak-to-peak.

    Attributes
    ----------
    duration_s, counted_from_s, judged_s : float
        Length of the run; time from which errors count; from the first tick to the last one whose error is judged, s.
    peak_to_peak_um : float
        Of the desired motion in the counted part; percentages refer to it.
    measured_rmse_um, measured_maximum_um, measured_rmse_percent, measured_maximum_percent : float
        Error of the measurement.
    true_rmse_um, true_maximum_um, true_rmse_percent, true_maximum_percent : float or None
        Error without sensor noise; None where the recording has no truth.
    convergence_time_s : float or None
        See `convergence_time`, of the measured error, over the whole run, or up to the sudden change where there is
        one, to its final value, but at most to `tolerable`. None if it never settles, if it is at a
        voltage limit in 1 % of the second half, farther off than that, or if there is less than 1 s of it.
    change_s, recovery_time_s : float or None
        When the actuator changed suddenly, and the time from then on until the error is again near what it was in the
        second half before: the `convergence_time` of what follows, to that level. None without a change; the second
        also if it never is, or if there is less than 1 s of either.
    stroke_um, noise_um : float
        Stroke of the actuator, and the sensor's noise (`noise` of the measured error).
    ticks, missing_ticks : int
        All ticks, and those without a measurement, which are left out.
    saturated_ticks, ..., restored_ticks : int or None
        How often each of `truestroke.base.flags` was up; None where the controller has no flags.
    """

    duration_s: float
    counted_from_s: float
    judged_s: float
    peak_to_peak_um: float
    measured_rmse_um: float
    measured_maximum_um: float
    measured_rmse_percent: float
    measured_maximum_percent: float
    true_rmse_um: float | None
    true_maximum_um: float | None
    true_rmse_percent: float | None
    true_maximum_percent: float | None
    convergence_time_s: float | None
    change_s: float | None
    recovery_time_s: float | None
    stroke_um: float
    noise_um: float
    ticks: int
    missing_ticks: int
    saturated_ticks: int | None
    projected_ticks: int | None
    rejected_ticks: int | None
    held_ticks: int | None
    changed_ticks: int | None
    slewed_ticks: int | None
    oscillating_ticks: int | None
    restored_ticks: int | None

    def as_dict(self) -> dict[str, float | int | None]:
        """All metrics by name, for JSON."""
        return dataclasses.asdict(self)


def summary(
    recording: Labelled, start: float = 0.5, change: float | None = None, stroke: float | None = None
) -> TrackingSummary:
    """The metrics of a run: rmse and maximum of its later part, convergence, recovery, flags.

    Parameters
    ----------
    recording : Recording or dict of arrays
        With time, desired, measured, and what there is of true, flags and flat.
    start : float
        Part of the duration from which errors count, in [0, 1).
    change : float, optional
        When the actuator changed suddenly, s; convergence is then judged before it and recovery after it.
    stroke : float, optional
        Of the actuator, um; by default the peak-to-peak of the desired motion over the whole run.

    Raises
    ------
    SettingError
        `start` or `change` is outside its bounds, or no measurement is in the counted part.

    Examples
    --------
    >>> t = np.arange(4000) / 2000.0
    >>> z_d = 10 + 10 * np.sin(50 * t)
    >>> s = summary({"time": t, "desired": z_d, "measured": z_d + 0.05 + np.exp(-20 * t)})
    >>> round(s.measured_rmse_um, 4), round(s.measured_rmse_percent, 4), s.true_rmse_um
    (0.05, 0.25, None)
    """
    checks.able("recording", recording, ("__getitem__",), "a Recording, or a mapping of names to arrays")
    time, desired, measured = recording["time"], recording["desired"], recording["measured"]
    if not 0 <= checks.number("start", start) < 1:
        raise SettingError("start", start, "at least 0 and below 1")
    known = np.isfinite(measured) & judged(recording)
    counted = known & (np.arange(time.size) >= start * time.size)
    if not counted.any():
        raise SettingError("recording", f"{time.size} ticks", f"one with measurements after {start:g} of its duration")
    duration = _duration(time)
    span = peak_to_peak(desired[counted])
    changed = np.inf if change is None else checks.number("change", change)
    error = measured - desired
    whole = float(np.ptp(desired)) if stroke is None else checks.positive("stroke", stroke, "um")
    sensor = noise(error)
    tolerated = tolerable(span, whole, sensor), min(sensor, NOISE_LIMIT * whole)
    converged, recovered = _settled(time[known], error[known], changed, float(np.hypot(*tolerated)))
    if np.mean(at_limit(recording, *tolerated)[time.size // 2 :]) > AT_LIMIT:
        converged = None
    none = dict.fromkeys(f"true_{name}" for name in ("rmse_um", "maximum_um", "rmse_percent", "maximum_percent"))
    return TrackingSummary(
        duration_s=duration,
        counted_from_s=start * duration,
        judged_s=_duration(time[known]),
        peak_to_peak_um=span,
        **_errors("measured", desired[counted], measured[counted], span),
        **(_errors("true", desired[counted], recording["true"][counted], span) if "true" in recording else none),
        convergence_time_s=converged,
        change_s=change,
        recovery_time_s=recovered,
        stroke_um=whole,
        noise_um=sensor,
        ticks=time.size,
        missing_ticks=int(np.count_nonzero(~np.isfinite(measured))),
        **_flag_counts(recording),
    )


def _errors(which: str, desired: FloatArray, z: FloatArray, span: float) -> dict[str, Any]:
    um = {"rmse": rmse(desired, z), "maximum": maximum_error(desired, z)}
    percent = {name: 100 * value / span if span else float("inf") for name, value in um.items()}
    return {f"{which}_{k}_um": v for k, v in um.items()} | {f"{which}_{k}_percent": v for k, v in percent.items()}


def at_limit(recording: Labelled, tolerated: float, noise: float, limit: str = "saturated") -> npt.NDArray[np.bool_]:
    """Ticks in which a limit kept the actuator away from where it should be, by more than what is tolerable.

    Parameters
    ----------
    recording : Recording or dict of arrays
        With desired and measured; without flags no tick is known to be at a limit.
    tolerated, noise : float
        um; a limit that is met on the spot, as 0 V at rest, is none of them.
    limit : str
        The flag: "saturated" or "slewed".
    """
    if "flags" not in recording:
        return np.zeros(recording["time"].size, bool)
    off = np.abs(recording["measured"] - recording["desired"])
    return np.asarray((recording["flags"] & BIT[limit] > 0) & ~(off <= tolerated + 3 * noise) & judged(recording))


def judged(recording: Labelled) -> npt.NDArray[np.bool_]:
    """Ticks in which errors count: where the channel `flat` is up, as on the lines of a raster; all without it.

    Examples
    --------
    >>> judged({"time": np.arange(3), "flat": np.array([0, 1, 1])}).tolist()
    [False, True, True]
    """
    return np.asarray(recording["flat"] > 0 if "flat" in recording else np.ones(recording["time"].size, bool))


def _settled(time: FloatArray, error: FloatArray, change: float, highest: float) -> tuple[float | None, float | None]:
    """Times of convergence before the change and of recovery after it, s; None where there is too little of it."""
    before = time < change
    if _duration(time[before]) < 4 * WINDOW:
        return None, None
    usual = error[before][np.count_nonzero(before) // 2 :]
    level = min(float(np.sqrt(np.mean(usual**2))), highest)
    converged = convergence_time(time[before], error[before], level)
    if _duration(time[~before]) < 4 * WINDOW:
        return converged, None
    return converged, convergence_time(time[~before], error[~before], level)


def _flag_counts(recording: Labelled) -> dict[str, Any]:
    up = recording.get("flags")
    return {f"{f.name}_ticks": None if up is None else int(np.count_nonzero(up & f.bit)) for f in FLAGS}
