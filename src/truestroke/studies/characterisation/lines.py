"""Weights of every pass by least squares, and a line of weight against velocity for every play (7)."""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import FloatArray
from truestroke.identification import ActuatorModel
from truestroke.model.layout import MAX_PLAYS, Layout
from truestroke.model.models import RateDependentModel
from truestroke.model.operators import play_history
from truestroke.signals.recording import Recording

MIN_PASSES = 3  # of each direction, or a speed has not converged
TOLERANCE = 0.01  # of the stroke: rms error of a pass that follows its triangle
COMPLETE = 0.9  # of the stroke: what a pass must travel at constant speed
RATE_SCALE = 0.007  # s/um, that of the published weights


class NotConverged(TruestrokeError, RuntimeError):  # noqa: N818 (as RunInterrupted: what happened)
    """Fewer than two speeds were followed well enough for a line.

    Attributes
    ----------
    recording : Recording
        The run.
    """

    def __init__(self, message: str, recording: Recording) -> None:
        self.recording = recording
        super().__init__(message)


class Branches(NamedTuple):
    """Whether the weights change with speed, or with direction only; arrays of shape (n,), um/V.

    Attributes
    ----------
    b, b_deviations
        Rate weights within the directions, and their standard deviations.
    jump, jump_deviations
        Rising minus falling weight at rest, and its standard deviation.
    lag, lag_deviation : float
        What the velocity adds to the constant of a pass within the directions, s: below 0, a delay.
    quantile : float
        Deviations beyond which one is not 0, at 95 % for all of them together (Bonferroni, Student's t).
    """

    b: FloatArray
    b_deviations: FloatArray
    jump: FloatArray
    jump_deviations: FloatArray
    lag: float
    lag_deviation: float
    quantile: float

    @property
    def rate_dependent(self) -> npt.NDArray[np.bool_]:
        """Which weights change with speed."""
        return np.asarray(np.abs(self.b) > self.quantile * self.b_deviations)

    @property
    def parted(self) -> npt.NDArray[np.bool_]:
        """Which weights change with direction."""
        return np.asarray(np.abs(self.jump) > self.quantile * self.jump_deviations)


@dataclass(frozen=True, eq=False, kw_only=True)
class Characterisation:
    """Weights against velocity, and the lines through them.

    ::

        w_i(zdot_d) = a_i + c_b zdot_d b_i                                 (7), in the scale of (20)

    n is the number of plays, v of velocities: each speed upwards (above 0) and downwards.

    Attributes
    ----------
    thresholds : ndarray, shape (n,)
        r of the plays, V.
    velocities : ndarray, shape (v,)
        Ascending, um/s.
    passes : ndarray of int, shape (v,)
        How many passes count: those from which on the motion was followed, without the first one.
    errors : ndarray, shape (v,)
        rms error of the measured displacement in them, um.
    converged : ndarray of bool, shape (v,)
        Whether the speed was followed, in both directions; the others are left out of the lines.
    weights, deviations : ndarray, shape (v, n)
        Mean over the passes and standard deviation of one pass, um/V.
    constants : ndarray, shape (v,)
        What a pass has beside its weights, mean, um.
    coefficients : ndarray, shape (2 n + 2,)
        [a0, b0, a1, b1, ...], um/V, then lag, s, and offset, um: the order of `ActuatorModel.weights`.
    covariance : ndarray, shape (2 n + 2, 2 n + 2)
        Of the coefficients, from the scatter of the weights about the lines: noise, and what is no line.
    r_squared : ndarray, shape (n,)
        Coefficient of determination of each line; near 0 where the velocity does not matter.
    misfit : float
        rms residual of the lines in the displacement of the passes, um.
    stroke : float
        Of the triangles, um.
    recording : Recording
        The run.
    """

    thresholds: FloatArray
    velocities: FloatArray
    passes: npt.NDArray[np.int64]
    errors: FloatArray
    converged: npt.NDArray[np.bool_]
    weights: FloatArray
    deviations: FloatArray
    constants: FloatArray
    coefficients: FloatArray
    covariance: FloatArray
    r_squared: FloatArray
    misfit: float
    stroke: float
    recording: Recording

    @property
    def layout(self) -> Layout:
        """Places of the coefficients."""
        return _layout(self.thresholds)

    @property
    def a(self) -> FloatArray:
        """Weights at rest, um/V, shape (n,)."""
        return self.coefficients[self.layout.a]

    @property
    def b(self) -> FloatArray:
        """Rate weights, um/V, shape (n,)."""
        return self.coefficients[self.layout.b]

    @property
    def a_deviations(self) -> FloatArray:
        """Standard deviations of a, um/V, shape (n,)."""
        return np.sqrt(np.diag(self.covariance)[self.layout.a])

    @property
    def b_deviations(self) -> FloatArray:
        """Standard deviations of b, um/V, shape (n,)."""
        return np.sqrt(np.diag(self.covariance)[self.layout.b])

    @property
    def lag(self) -> float:
        """What the velocity adds to the displacement, s; below 0, a delay."""
        return float(self.coefficients[self.layout.columns["lag"]].sum())

    @property
    def offset(self) -> float:
        """Displacement at 0 V, um."""
        return float(self.coefficients[self.layout.columns["offset"]].sum())

    def quantile(self, confidence: float = 0.95) -> float:
        """Standard deviations of a and b to either side that hold the truth so often: Student's t."""
        return _quantile(confidence, int(self.converged.sum()) - 2)

    @cached_property
    def branches(self) -> Branches:
        """The lines of the two directions apart, with one slope: w = a +- jump / 2 + c_b zdot_d b."""
        v = self.velocities[self.converged]
        X = np.column_stack([np.ones(v.size), RATE_SCALE * v, np.sign(v) / 2])
        B, P = _regression(X, np.column_stack([self.weights, self.constants])[self.converged])
        _, b, jump = np.sqrt(np.diag(P)).reshape(-1, 3).T
        quantile = _quantile(1 - 0.05 / b.size, v.size - 3)
        lag, deviation = RATE_SCALE * B[1, -1], RATE_SCALE * float(b[-1])
        return Branches(B[1, :-1], b[:-1], B[2, :-1], jump[:-1], float(lag), deviation, quantile)

    def cycle(self, speed: float) -> float:
        """Ticks of one triangle at `speed`, um/s."""
        time = self.recording["time"]
        return float(2 * self.stroke / speed * (time.size - 1) / np.ptp(time))

    @property
    def model(self) -> RateDependentModel:
        """The rate-dependent model (8) with these lines; without lag and offset."""
        return RateDependentModel(r=self.thresholds, a=self.a, b=self.b, rate_scale=RATE_SCALE)

    @property
    def actuator_model(self) -> ActuatorModel:
        """The same with lag, offset and covariance, for `save_model` and `AdaptiveController.from_model`."""
        volts = self.recording["volts"]
        plant = self.recording.metadata.get("plant", {}).get("name", "")
        return ActuatorModel(
            **self.layout.terms,
            weights=self.coefficients,
            covariance=self.covariance,
            rate_scale=RATE_SCALE,
            stroke=self.stroke,
            voltage_range=(float(volts.min()), float(volts.max())),
            velocity=float(self.velocities[self.converged].max()),
            noise=self.misfit,
            metrics={"misfit_um": self.misfit, "speeds": float(np.count_nonzero(self.converged) / 2)},
            provenance={"source": f"truestroke characterise, {plant}".rstrip(", "), "procedure": "Sec. 2.4"},
        )

    def as_dict(self) -> dict[str, Any]:
        """All results as plain numbers, for JSON."""
        of_velocity = "velocities passes errors converged weights deviations constants"
        of_play = "a b a_deviations b_deviations r_squared"
        arrays = f"thresholds {of_velocity} {of_play}".split()
        found = {name: getattr(self, name).tolist() for name in arrays}
        found["branches"] = {name: np.asarray(value).tolist() for name, value in self.branches._asdict().items()}
        return found | {name: getattr(self, name) for name in ("lag", "offset", "misfit", "stroke")}


# ---- From a recording ----------------------------------------------------------------------------------------------


class _Pass(NamedTuple):
    velocity: float  # um/s
    ticks: slice
    error: float  # rms, um


def fit_lines(
    recording: Recording,
    *,
    thresholds: npt.ArrayLike | None = None,
    plays: int = 8,
    offset: bool = True,
) -> Characterisation:
    """The lines (7) from a recording of triangles at several speeds, as `characterise` makes it.

    The weights of one pass minimise the squares of z - w.H_r[x] - o over its ticks, H from the voltages that were
    applied. Line by line, w_i = a_i + c_b zdot_d b_i and o = offset + lag zdot_d through the means over the passes.

    Parameters
    ----------
    recording : Recording
        Whole or interrupted.
    thresholds : array_like, shape (n,), optional
        r of the plays, V; by default r_i = i / n of half the voltage span, so that every play moves.
    plays : int
        n where no thresholds are given.
    offset : bool
        Whether a pass has the constant o: it keeps zero point, creep and delay out of the weights. Sec. 2.4 has none.

    Raises
    ------
    SettingError
        A threshold is so large that its play does not move, or the recording lacks a channel.
    NotConverged
        Fewer than two speeds were followed.

    Examples
    --------
    The same run with fewer plays:

    >>> from truestroke import characterise
    >>> from truestroke.plant import RealisticPlant
    >>> bench = {"stroke": 38.0, "voltage_limits": (-0.6, 3.6), "speeds": (150.0, 300.0), "duration": 1.0}
    >>> found = characterise(RealisticPlant(), **bench)
    >>> fit_lines(found.recording, plays=4).thresholds.round(2)
    array([0.  , 0.38, 0.76, 1.14])
    """
    by_velocity = _by_velocity(recording)
    stroke = float(np.ptp(recording["desired"])) if by_velocity else 0.0
    kept = {v: _followed(passes, TOLERANCE * stroke) for v, passes in by_velocity.items()}
    converged = np.array([min(len(kept[v]), len(kept.get(-v, ()))) >= MIN_PASSES for v in kept])
    velocities = np.array(list(kept))
    if np.count_nonzero(converged) < 4:
        raise NotConverged(_complaint(velocities, converged), recording)
    used = [p for v in velocities[converged] for p in kept[v]]
    r = _thresholds(recording["volts"], used, thresholds, plays)
    H = play_history(recording["volts"], r)
    single = [_weights(H, recording["measured"], kept[v] or by_velocity[v], offset) for v in velocities]
    means = np.array([w.mean(axis=0) for w in single])
    coefficients, covariance, r_squared = _lines(velocities[converged], means[converged])
    return Characterisation(
        thresholds=r,
        velocities=velocities,
        passes=np.array([len(passes) for passes in kept.values()]),
        errors=np.array([_rms([p.error for p in kept[v] or by_velocity[v]]) for v in velocities]),
        converged=converged,
        weights=means[:, :-1],
        deviations=np.array([_deviation(w) for w in single])[:, :-1],
        constants=means[:, -1],
        coefficients=coefficients,
        covariance=covariance,
        r_squared=r_squared[:-1],
        misfit=_misfit(H, recording["measured"], used, coefficients, _layout(r)),
        stroke=stroke,
        recording=recording,
    )


def _by_velocity(recording: Recording) -> dict[float, list[_Pass]]:
    """Complete passes at constant velocity, without the first of each, in the order of velocity."""
    for name in ("time", "desired", "desired_velocity", "volts", "measured"):
        if name not in recording:
            raise SettingError("recording", f"without {name}", "one of a run of triangles")
    if len(recording["time"]) < 2:
        return {}
    velocity, rate = recording["desired_velocity"], (len(recording["time"]) - 1) / np.ptp(recording["time"])
    error = recording["measured"] - recording["desired"]
    stroke = float(np.ptp(recording["desired"]))
    found: dict[float, list[_Pass]] = {}
    starts = np.flatnonzero(np.diff(velocity, prepend=np.nan))
    for start, stop in itertools.pairwise([*starts.tolist(), velocity.size]):
        v = float(velocity[start])
        if v and abs(v) * (stop - start) / rate > COMPLETE * stroke:
            ticks = slice(start, stop)
            found.setdefault(v, []).append(_Pass(v, ticks, _rms(error[ticks])))
    return {v: found[v][1:] for v in sorted(found) if len(found[v]) > 1}


def _followed(passes: list[_Pass], tolerance: float) -> list[_Pass]:
    """Those after the last one whose error is larger."""
    behind = [i + 1 for i, p in enumerate(passes) if not p.error <= tolerance]
    return passes[behind[-1] if behind else 0 :]


def _complaint(velocities: FloatArray, converged: npt.NDArray[np.bool_]) -> str:
    speeds = ", ".join(f"{v:g}" for v in velocities if v > 0)
    return (
        f"{np.count_nonzero(converged) // 2} of the speeds ({f'{speeds} um/s' if speeds else 'none complete'}) were "
        "followed within "
        f"{100 * TOLERANCE:g} % of the stroke, {MIN_PASSES} times in each direction: lines need two"
    )


def _thresholds(volts: FloatArray, used: list[_Pass], given: npt.ArrayLike | None, plays: int) -> FloatArray:
    """Those given, or r_i = i / n of half the voltage span that every pass takes: the last play must move."""
    half = min(float(np.ptp(volts[p.ticks])) for p in used) / 2
    if given is None:
        n = checks.count("plays", plays, 1, MAX_PLAYS)
        return np.arange(n) / n * half
    r = np.array(checks.ascending("thresholds", np.ravel(given).tolist(), "V"))
    checks.within("the largest of thresholds", r[-1], 0.0, half, "V")
    return r


def _weights(H: FloatArray, z: FloatArray, passes: list[_Pass], offset: bool) -> FloatArray:
    """Least squares of each pass, shape (passes, n + 1): weights, um/V, and the constant, um."""
    rows = []
    for p in passes:
        there = np.isfinite(z[p.ticks])
        columns = np.column_stack([H[p.ticks], np.full(there.size, float(offset))])
        rows.append(np.linalg.lstsq(columns[there], z[p.ticks][there], rcond=None)[0])
    return np.array(rows)


def _lines(velocities: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients and covariance in the order of `Characterisation`, and R^2 of each column of `weights`."""
    X = np.column_stack([np.ones(velocities.size), RATE_SCALE * velocities])
    B, P = _regression(X, weights)
    T = np.eye(B.size)  # the last line is offset + c_b zdot (lag / c_b)
    T[-2:, -2:] = [[0.0, RATE_SCALE], [1.0, 0.0]]
    spread = np.sum((weights - weights.mean(axis=0)) ** 2, axis=0)
    r_squared = 1 - np.sum((weights - X @ B) ** 2, axis=0) / np.where(spread > 0, spread, 1.0)
    return np.asarray(T @ B.T.ravel()), np.asarray(T @ P @ T.T), np.asarray(r_squared)


def _regression(X: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """B, one column for each of `weights`, and the covariance of its entries, column after column.

    All have the same X, so that ordinary least squares is the best for each, whatever the correlation between them:
    cov(B_pi, B_qj) = (X'X)^-1_pq S_ij, with S the covariance of the residuals.
    """
    B = np.linalg.lstsq(X, weights, rcond=None)[0]
    left = weights - X @ B
    S = left.T @ left / (X.shape[0] - X.shape[1])
    return np.asarray(B), np.asarray(np.kron(S, np.linalg.inv(X.T @ X)))


def _layout(thresholds: FloatArray) -> Layout:
    """All plays depend on the rate; beside them there are lag and offset."""
    return Layout(thresholds=tuple(thresholds.tolist()), rate_dependent=tuple(range(thresholds.size)))


def _quantile(confidence: float, freedom: int) -> float:
    from scipy.stats import t

    return float(t.ppf((1 + confidence) / 2, freedom))


def _misfit(H: FloatArray, z: FloatArray, used: list[_Pass], coefficients: FloatArray, layout: Layout) -> float:
    (a, b), (lag, offset) = layout.of_all_plays(coefficients), coefficients[layout.of_plays :]
    left = [z[p.ticks] - H[p.ticks] @ (a + RATE_SCALE * p.velocity * b) - offset - lag * p.velocity for p in used]
    return _rms(np.concatenate(left))


def _deviation(weights: FloatArray) -> FloatArray:
    return weights.std(axis=0, ddof=1) if len(weights) > 1 else np.full(weights.shape[1], np.nan)


def _rms(values: npt.ArrayLike) -> float:
    """Of what was measured; NaN where nothing was."""
    there = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else float("nan")
