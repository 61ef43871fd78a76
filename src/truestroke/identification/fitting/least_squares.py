"""Play and dead-zone weights from a record by constrained linear least squares, (6)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model.models import RateDependentModel, inverse_dead_zones
from truestroke.model.operators import dead_zone, play_history


@dataclass(frozen=True, eq=False)
class FittedWeights:
    """What `fit` found: the model w_s'.S_d'[z] = (a + b zdot).H_r[x] + offset.

    Attributes
    ----------
    thresholds : tuple[float, ...]
        r of the plays, V, n of them.
    play_weights : ndarray, shape (n,)
        a of (7), um/V; the play weights w_h in a fit without rate.
    rate_weights : ndarray, shape (n,)
        b of (7), (um/V)/(um/s); zero in a fit without rate.
    dead_zone_thresholds : tuple[float, ...]
        d' of the inverse dead zones, um.
    dead_zone_weights : ndarray
        w_s' of the inverse dead zones, without unit; the first is 1.
    offset : float
        Displacement that the record shows at rest, um; 0 where none was fitted.
    rmse : float
        Root mean square of the residual of (6), um.
    """

    thresholds: tuple[float, ...]
    play_weights: FloatArray
    rate_weights: FloatArray
    dead_zone_thresholds: tuple[float, ...]
    dead_zone_weights: FloatArray
    offset: float
    rmse: float

    def model(self) -> RateDependentModel:
        """The model (8), with `predict` and `invert`; it has no offset."""
        w_s, d = inverse_dead_zones(self.dead_zone_weights, self.dead_zone_thresholds)  # undone twice: forward
        r = np.array(self.thresholds)
        return RateDependentModel(r=r, a=self.play_weights, b=self.rate_weights, d=d, w_s=w_s, rate_scale=1.0)

    def settings(self, rate_scale: float = 0.007) -> dict[str, Any]:
        """The members of `ControllerSettings` that start a controller from this model.

        Parameters
        ----------
        rate_scale : float
            c_b of (20), s/um; 0 leaves the rate weights out.
        """
        scale = checks.within("rate_scale", rate_scale, 0.0, 1e6, "s/um")
        rate = self.rate_weights / scale if scale else np.zeros_like(self.rate_weights)
        return {
            "plays": len(self.thresholds),
            "thresholds": self.thresholds,
            "rate_dependent": tuple(range(len(self.thresholds))),
            "creep_times": (),
            "lag": False,
            "offset": False,
            "asymmetry": 0,
            "duhem_lengths": (),
            "dead_zone_thresholds": self.dead_zone_thresholds,
            "dead_zone_weights": tuple(self.dead_zone_weights.tolist()),
            "initial_weights": tuple(np.column_stack([self.play_weights, rate]).ravel().tolist()),
            "rate_scale": scale,
        }


def fit(
    volts: npt.ArrayLike,
    displacement: npt.ArrayLike,
    *,
    thresholds: Sequence[float],
    dead_zone_thresholds: Sequence[float] = (0.0,),
    dead_zone_weights: Sequence[float] | None = None,
    velocity: npt.ArrayLike | None = None,
    offset: bool = False,
    skip: int = 0,
    slope_min: float = 0.01,
) -> FittedWeights:
    """Play weights and inverse dead-zone weights of a record, all partial sums positive.

    Minimises the sum of squares of (6) as it must be meant: *forward* plays against *inverse* dead zones, ::

        E(t) = w_h.H_r[x](t) - w_s'.S_d'[z](t),      w_s'[0] = 1

    which is linear in (w_h, w_s'). In the partial sums of the weights, which must be positive for the inverse to
    exist, it is a non-negative least squares problem and is solved as such. With `velocity`, w_h = a + b velocity as
    in (7), and the partial sums are positive at every velocity up to the largest of the record, either way.

    Parameters
    ----------
    volts : array_like, shape (ticks,)
        Voltage x of every tick, V; the plays start at rest at 0 V.
    displacement : array_like, shape (ticks,)
        Measured displacement z of the same ticks, um.
    thresholds : sequence of float
        r of the plays, V, ascending from 0, the last below the largest magnitude of `volts`.
    dead_zone_thresholds : sequence of float
        d' of the inverse dead zones, um, ascending from 0, the last below the largest displacement.
    dead_zone_weights : sequence of float, optional
        w_s' from another record (Sec. 2.2 takes a sine of 8 Hz), kept as they are; left out, they are fitted.
    velocity : array_like, shape (ticks,), optional
        Velocity zdot, um/s; left out, the model does not depend on the rate.
    offset : bool
        Fit a constant too, for a sensor whose zero is not that of the actuator.
    skip : int
        Ticks at the start that are left out of the sum, because their play states are not known.
    slope_min : float
        Smallest partial sum, um/V for the plays, without unit for the dead zones.

    Raises
    ------
    SettingError
        An argument is out of bounds, or the record does not excite a threshold or is too short.

    Examples
    --------
    A triangle to 2 V and back, of an actuator with 10 um/V and one play of 2 um/V and 0.5 V:

    >>> x = np.array([0.0, 1.0, 2.0, 1.0, 0.0])
    >>> z = 10.0 * x + 2.0 * np.array([0.0, 0.5, 1.5, 1.5, 0.5])
    >>> fit(x, z, thresholds=(0.0, 0.5)).play_weights.round(6)
    array([10.,  2.])

    References
    ----------
    K. Kuhnen, "Modeling, identification and compensation of complex hysteretic nonlinearities: a modified
    Prandtl-Ishlinskii approach", European Journal of Control 9 (2003) 407-418, solves it as a quadratic programme.
    """
    x = checks.finite_array("volts", volts, "V")
    z = _same_length("displacement", displacement, x.size, "um")
    r = checks.ascending("thresholds", thresholds, "V")
    d = checks.ascending("dead_zone_thresholds", dead_zone_thresholds, "um")
    floor = checks.positive("slope_min", slope_min)
    skip = checks.count("skip", skip, 0, x.size)

    plays = _per_partial_sum(play_history(x, r))[skip:]
    zones = _per_partial_sum(dead_zone(z, d))[skip:]
    _require_excited("thresholds", r, plays, "V")
    _require_excited("dead_zone_thresholds", d, zones, "um")
    rate, top = _relative_rate(velocity, x.size)
    if rate is not None:  # partial sums at the velocities +top and -top; those between are interpolated
        plays = np.hstack([plays * (1 + rate[skip:]) / 2, plays * (1 - rate[skip:]) / 2])
    known = np.ones(1) if dead_zone_weights is None else np.cumsum(_given(dead_zone_weights, len(d)))
    target, unknown = zones[:, : known.size] @ known, zones[:, known.size :]
    constant = np.ones((target.size, int(offset)))

    free, sums, rmse = _bounded_least_squares(constant, np.hstack([plays, -unknown]), target, floor)
    end = plays.shape[1]  # n columns, or 2 n with the rate
    upper, lower = sums[: len(r)], sums[end - len(r) : end]
    return FittedWeights(
        thresholds=r,
        play_weights=np.diff((upper + lower) / 2, prepend=0.0),
        rate_weights=np.diff((upper - lower) / (2 * top), prepend=0.0),
        dead_zone_thresholds=d,
        dead_zone_weights=np.diff(np.concatenate([known, sums[end:]]), prepend=0.0),
        offset=float(free.sum()),
        rmse=rmse,
    )


def _same_length(argument: str, value: npt.ArrayLike, ticks: int, unit: str) -> FloatArray:
    array = checks.finite_array(argument, value, unit)
    if array.size != ticks:
        raise SettingError(argument, f"array of {array.size} ticks", f"an array of {ticks} ticks, as volts is", unit)
    return array


def _relative_rate(velocity: npt.ArrayLike | None, ticks: int) -> tuple[FloatArray | None, float]:
    """Velocity as a column in units of the largest of the record, and that, um/s."""
    if velocity is None:
        return None, 1.0
    rate = _same_length("velocity", velocity, ticks, "um/s")
    top = checks.positive("the largest |velocity|", np.abs(rate).max(initial=0.0), "um/s")
    return rate[:, None] / top, top


def _given(dead_zone_weights: Sequence[float], zones: int) -> FloatArray:
    weights = checks.finite_array("dead_zone_weights", dead_zone_weights)
    if weights.size != zones or weights[0] != 1 or np.any(np.cumsum(weights) <= 0):
        bound = f"{zones} numbers, the first 1, whose partial sums are all above 0"
        raise SettingError("dead_zone_weights", weights, bound)
    return weights


def _per_partial_sum(columns: FloatArray) -> FloatArray:
    """Columns C with weights.columns = partial_sums.C."""
    following = np.hstack([columns[:, 1:], np.zeros((len(columns), 1))])
    return np.asarray(columns - following)


def _require_excited(argument: str, thresholds: Sequence[float], columns: FloatArray, unit: str) -> None:
    for threshold, largest in zip(thresholds, np.abs(columns).max(axis=0, initial=0.0), strict=True):
        if largest == 0:
            raise SettingError(argument, threshold, "below what the record reaches", unit)


def _bounded_least_squares(
    free: FloatArray, columns: FloatArray, target: FloatArray, floor: float
) -> tuple[FloatArray, FloatArray, float]:
    """Coefficients of `free` and, at least `floor`, of `columns`, and the root mean square of their residual."""
    from scipy.optimize import nnls

    rows, f, n = target.size, free.shape[1], columns.shape[1]
    if rows <= f + n:
        raise SettingError("volts", f"array with {rows} ticks to fit", f"longer than {f + n} ticks")
    shifted = target - columns @ np.full(n, floor)
    # The last rows of R do not contain `free`: it is eliminated, and follows afterwards.
    R: FloatArray = np.asarray(np.linalg.qr(np.column_stack([free, columns, shifted]), mode="r"))
    above, residual = nnls(R[f:, f:-1], R[f:, -1])
    return np.linalg.solve(R[:f, :f], R[:f, -1] - R[:f, f:-1] @ above), floor + above, float(residual / np.sqrt(rows))
