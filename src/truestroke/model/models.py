"""Hysteresis models, forward and inverse: (3), (5), (7)-(12).

Symbols are the paper's: thresholds r (V) and weights w_h (um/V) of the plays, thresholds d (um) and weights w_s of the
dead zones; a prime (') marks the parameters of the inverse. A model holds no state: the play states y (V) go in and
come out of every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke import _kernel
from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model.layout import Layout
from truestroke.model.operators import dead_zone, dot, play, play_history

FAR = 100.0  # lengths of a state of Duhem in a tick, at most: it has forgotten all long before

# ---- Inverse parameters (10) -------------------------------------------------------------------------------------


def inverse_parameters(
    w_h: npt.ArrayLike, r: npt.ArrayLike, y0: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights, thresholds and states of the plays that undo the plays (w_h, r, y0).

    ::

        w'_0 = 1 / w_0,   w'_i = -w_i / (sum_{j<=i} w_j  sum_{j<i} w_j)
        r'_i = sum_{j<=i} w_j (r_i - r_j)                                  (10)
        y0'_i = sum_{j<=i} w_j y0_i + sum_{j>i} w_j y0_j

    Parameters
    ----------
    w_h : array_like, shape (n,)
        Weights, um/V; every partial sum is above 0.
    r : array_like, shape (n,)
        Thresholds, V, ascending from 0.
    y0 : array_like, shape (n,)
        Play states after the last tick, V.

    Returns
    -------
    w_h, r, y0 : ndarray, shape (n,)
        Of the inverse: weights, V/um; thresholds, um; states, um.

    Raises
    ------
    SettingError
        A partial sum is not above 0: the model has no inverse (Sec. 6).

    Examples
    --------
    >>> inverse_parameters([8.0, 2.0], [0.0, 0.5], [1.0, 0.5])
    (array([ 0.125, -0.025]), array([0., 4.]), array([9., 5.]))
    """
    w, y = _floats(w_h), _floats(y0)
    # The print has y0_j in the first sum; only y0_i makes (12) undo (3).
    y_inverse = np.array([np.sum(w[: i + 1]) * y[i] + np.sum(w[i + 1 :] * y[i + 1 :]) for i in range(w.size)])
    return _inverse_weights("w_h", w, "um/V"), _inverse_thresholds(w, _floats(r)), y_inverse


def inverse_dead_zones(w_s: npt.ArrayLike, d: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Weights and thresholds of the dead zones that undo the dead zones (w_s, d), by (10).

    Undone twice they are themselves again.

    Parameters
    ----------
    w_s : array_like, shape (m,)
        Weights, without unit; every partial sum is above 0.
    d : array_like, shape (m,)
        Thresholds, um, ascending from 0.

    Returns
    -------
    w_s, d : ndarray, shape (m,)
        Of the inverse: weights, without unit; thresholds, um.

    Raises
    ------
    SettingError
        A partial sum is not above 0.

    Examples
    --------
    >>> inverse_dead_zones([1.0, 0.25], [0.0, 12.0])
    (array([ 1. , -0.2]), array([ 0., 12.]))
    """
    return _inverse_weights("w_s", _floats(w_s), ""), _inverse_thresholds(_floats(w_s), _floats(d))


def _inverse_weights(name: str, w: FloatArray, unit: str) -> FloatArray:
    sums = np.cumsum(w)
    if not np.all(sums > 0):
        raise SettingError(name, w, "numbers whose partial sums are all above 0", unit)
    return np.concatenate([[1.0 / w[0]], -w[1:] / (sums[1:] * sums[:-1])])


def _inverse_thresholds(w: FloatArray, r: FloatArray) -> FloatArray:
    return np.array([np.sum(w[: i + 1] * (r[i] - r[: i + 1])) for i in range(w.size)])


def _floats(value: npt.ArrayLike) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


# ---- Inverse of the plays, one tick ------------------------------------------------------------------------------


def play_inverse_literal(y_d: float, w_h: npt.ArrayLike, r: npt.ArrayLike, y: npt.ArrayLike) -> float:
    """The input for which the weighted sum of the plays is y_d, as printed: (10), then (12).

    The weights may change at every tick: (10) is computed anew from the forward states y after the last tick.

    Parameters
    ----------
    y_d : float
        Desired output of the plays, um.
    w_h, r, y : array_like, shape (n,)
        Weights of this tick, um/V, thresholds, V, and states after the last tick, V.

    Returns
    -------
    float
        x(t) = w_h' . H_r'[y_d, y0'](t), V                                 (12)

    Examples
    --------
    >>> x = play_inverse_literal(7.0, [8.0, 2.0], [0.0, 0.5], [0.0, 0.0])
    >>> x, float(np.dot([8.0, 2.0], play(x, [0.0, 0.5], [0.0, 0.0])))
    (0.8, 7.0)
    """
    w_inverse, r_inverse, y0_inverse = inverse_parameters(w_h, r, y)
    return float(w_inverse @ play(y_d, r_inverse, y0_inverse))


def play_inverse(y_d: float, slopes: npt.ArrayLike, r: npt.ArrayLike, y: npt.ArrayLike) -> float:
    """The same input in O(n), as the kernel finds it: a walk over the breakpoints of x -> w_h . H_r[x].

    That function is piecewise linear and increasing. Play i begins to move at y_i + r_i on the way up and at
    y_i - r_i on the way down; from there on the slope is w_0 + ... + w_i. The breakpoints are in order already, because
    the states of plays that share their input are nested.

    Parameters
    ----------
    y_d : float
        Desired output of the plays, um.
    slopes : array_like, shape (n,)
        Partial sums of the weights, um/V, each above 0.
    r, y : array_like, shape (n,)
        Thresholds, V, and states after the last tick, V; the state of the first play is the last input.

    Returns
    -------
    float
        x, V

    Examples
    --------
    >>> play_inverse(7.0, [8.0, 10.0], [0.0, 0.5], [0.0, 0.0])
    0.8
    """
    return play_walk(y_d - float(weighted_sum(_floats(slopes), _floats(y))), slopes, r, y)


def play_walk(gap: float, slopes: npt.ArrayLike, r: npt.ArrayLike, y: npt.ArrayLike) -> float:
    """The same from the last input, where `gap` um are missing, with slopes that may be others than those of the sum.

    Examples
    --------
    >>> play_walk(7.0, [8.0, 10.0], [0.0, 0.5], [0.0, 0.0])
    0.8
    """
    s, thresholds, states = (_floats(value).tolist() for value in (slopes, r, y))  # plain floats: no array is made
    sign = -1.0 if gap < 0 else 1.0
    x, slope = states[0], s[0]
    for threshold, state, next_slope in zip(thresholds[1:], states[1:], s[1:], strict=True):
        corner = state + sign * threshold  # where the next play begins to move
        beyond = gap - slope * (corner - x)
        if beyond * sign <= 0:
            break
        gap, x, slope = beyond, corner, next_slope
    return float(x + gap / slope)


def weighted_sum(slopes: FloatArray, y: FloatArray) -> FloatArray:
    """Weighted sum of the plays, um: w.y with w_j = s_j - s_{j-1}, summed by parts.

    Parameters
    ----------
    slopes : ndarray, shape (n,)
        Partial sums s of the weights, um/V.
    y : ndarray, shape (n,)
        Play states, V.

    Examples
    --------
    >>> float(weighted_sum(np.array([8.0, 10.0]), np.array([1.0, 0.5])))
    9.0
    """
    steps = y.copy()
    steps[:-1] -= y[1:]
    return dot(slopes, steps)


def limit_slopes(slopes: FloatArray, limits: tuple[float, float]) -> tuple[FloatArray, bool]:
    """Partial sums of the weights, each within its limits: the guard that keeps the inverse defined (Sec. 6).

    Not in the paper, which requires that negative slopes be avoided and does not specify how. The weights stay as they
    are.

    Parameters
    ----------
    slopes : ndarray, shape (n,)
        Slopes of the branches, um/V.
    limits : tuple[float, float]
        Smallest, above 0, and largest slope, um/V.

    Returns
    -------
    slopes : ndarray, shape (n,)
        Slopes of the branches, um/V; NaN becomes the smallest.
    moved : bool
        Whether a slope had to be moved.

    Examples
    --------
    >>> limit_slopes(np.array([5.0, -1.0, 2.0]), (0.25, 4.0))
    (array([4.  , 0.25, 2.  ]), True)
    """
    low, high = limits
    values = slopes.tolist()  # plain floats: each tick has few
    within = [min(slope, high) if slope >= low else low for slope in values]
    return np.array(within), within != values


# ---- Terms of the regressor --------------------------------------------------------------------------------------


def play_terms(layout: Layout, H: FloatArray, rate: float | FloatArray) -> FloatArray:
    """The part of the regressor (20) of the plays: [H_0, rate H_0, H_1, ...], with c_a = 1.

    Parameters
    ----------
    layout : Layout
        Which plays have a rate weight; the entries of the others are left out.
    H : ndarray, shape (n,) or (n, samples)
        Play states, V.
    rate : float or ndarray, shape (samples,)
        c_b zdot_d of (20), without unit.

    Examples
    --------
    >>> play_terms(Layout(thresholds=(0.0, 0.5), rate_dependent=(0,)), np.array([1.0, 0.5]), 0.1)
    array([1. , 0.1, 0.5])
    """
    terms = np.empty((layout.of_plays, *H.shape[1:]))
    terms[layout.a], terms[layout.b] = H, rate * H[layout.rate_plays]
    return terms


def creep_step(c: FloatArray, x: float, share: FloatArray) -> FloatArray:
    """Creep states after a tick: first-order lags of the voltage, c + share (x - c), share = 1 - exp(-T / tau).

    Parameters
    ----------
    c : ndarray, shape (k,)
        States before, V.
    x : float
        Voltage of the last tick, V: the states are known before the next voltage is chosen.
    share : ndarray, shape (k,)
        1 - exp(-T / tau), above 0, at most 1.

    Examples
    --------
    >>> creep_step(np.array([0.0, 1.0]), 2.0, np.array([0.5, 0.1]))
    array([1. , 1.1])
    """
    return c + share * (x - c)


def duhem_change(c: FloatArray, before: float, moved: float, lengths: FloatArray) -> FloatArray:
    """By how much states of Duhem change when the voltage moves by `moved`, V: dc / d|x| = (x - c) / length.

    They follow the voltage as far as it moves, not as time goes, so that they do not depend on the sample rate: by
    1 - exp(-|moved| / length) of their distance from the middle of the move, to the second order.

    Parameters
    ----------
    c : ndarray, shape (k,)
        States before, V.
    before, moved : float
        Voltage before, and by how much it moves, V.
    lengths : ndarray, shape (k,)
        How far the voltage moves until the states have forgotten, V.

    Examples
    --------
    >>> duhem_change(np.array([0.0, 1.0]), 0.0, 1.0, np.array([1.0, 4.0])).round(3)
    array([ 0.3 , -0.11])
    """
    middle, changes = before + moved / 2, []
    for state, length in zip(c.tolist(), lengths.tolist(), strict=True):  # few: plain floats are sooner there
        way = min(abs(moved) / length, FAR)
        grown = way + way * way / 2
        changes.append(grown / (1 + grown) * (middle - state))
    return np.array(changes)


def asymmetry_terms(z_d: float | FloatArray, stroke: float) -> tuple[FloatArray, FloatArray]:
    """Terms of asymmetry: 4 s (1 - s) and 8 s (1 - s)(1 - 2 s), with s = z_d / stroke within -1 <= s <= 2.

    They act on the desired displacement, which is known before the voltage.

    Parameters
    ----------
    z_d : float or ndarray
        Desired displacement, um.
    stroke : float
        Length of the travel, um.

    Examples
    --------
    >>> [float(term) for term in asymmetry_terms(7.5, 30.0)]
    [0.75, 0.75]
    """
    s: Any = z_d / stroke
    s = min(max(s, -1.0), 2.0) if isinstance(s, float) else np.minimum(np.maximum(s, -1.0), 2.0)
    first = 4 * s * (1 - s)
    return first, 2 * first * (1 - 2 * s)


def asymmetry_slopes(z: FloatArray, stroke: float) -> FloatArray:
    """Derivatives of `asymmetry_terms` by z, 1/um, shape (2, samples)."""
    s = np.clip(z / stroke, -1.0, 2.0)
    inside = s == z / stroke
    return np.array([inside * (4 - 8 * s), inside * 8 * (1 - 6 * s + 6 * s * s)]) / stroke


class Motion(NamedTuple):
    """What the known terms take of the desired motion: numbers at a tick, arrays along a record."""

    z_d: Any  # um
    zdot_d: Any  # um/s
    zddot_d: Any = 0.0  # um/s^2
    ahead: Any = 0.0  # um: what the stage's dynamics ask of the hysteresis beyond z_d
    others: tuple[tuple[Any, Any, Any], ...] = ()  # um, um/s, um/s^2: of each other axis; at rest where left out


def known_terms(
    layout: Layout, creep: Sequence[Any] | FloatArray, motion: Motion, stroke: float, duhem: FloatArray | None = None
) -> FloatArray:
    """The part of the regressor that is known before the voltage is chosen, so that the inverse stays a walk.

    Parameters
    ----------
    layout : Layout
        Which terms the model has.
    creep : array_like, shape (k,) or (k, samples)
        Creep states, V.
    motion : Motion
        Desired motion.
    stroke : float
        Length of the travel, um.
    duhem : ndarray, shape (k,)
        States of Duhem, V, of a layout that has them.

    Returns
    -------
    ndarray, shape (terms,) or (terms, samples)
        In the order of `layout.TERMS`; times a weight each is in um.

    Examples
    --------
    >>> layout = Layout(thresholds=(0.0,), creep_times=(0.3,), asymmetry=1)
    >>> known_terms(layout, np.array([0.5]), Motion(7.5, 20.0), stroke=30.0)
    array([ 0.5 , 20.  ,  1.  ,  0.75])
    """
    counts = layout.counts
    if not any(counts.values()):
        return np.zeros(0)
    one_tick = isinstance(motion.z_d, float)  # plain floats make an array sooner
    others: Any = [*zip(*motion.others, strict=True)]
    if not others:
        others = [()] * 3 if not layout.other_axes else np.zeros((3, layout.other_axes, *np.shape(motion.z_d)))
    terms: dict[str, Sequence[Any] | FloatArray] = {
        "creep": np.asarray(creep).tolist() if one_tick else creep,
        "lag": [motion.zdot_d],
        "inertia": [motion.zddot_d],
        "offset": [1.0] if one_tick else [np.ones_like(motion.z_d)],
        "asymmetry": asymmetry_terms(motion.z_d + motion.ahead, stroke) if counts["asymmetry"] else (),
        "duhem": () if duhem is None else duhem.tolist() if one_tick else duhem,
        "coupling": others[0],
        "coupling_lag": others[1],
        "coupling_inertia": others[2],
    }
    return np.array([entry for name, count in counts.items() if count for entry in terms[name][:count]])


# ---- Models ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PrandtlIshlinskii:
    """A weighted sum of plays: y(t) = w_h . H_r[x, y0](t)  (3).

    Attributes
    ----------
    r : ndarray, shape (n,)
        Thresholds, V, ascending from 0.
    w_h : ndarray, shape (n,)
        Weights, um/V.

    Examples
    --------
    >>> model = PrandtlIshlinskii(r=[0.0, 0.5], w_h=[8.0, 2.0])
    >>> model.predict([0.8, 0.0])
    array([7. , 0.6])
    """

    r: FloatArray
    w_h: FloatArray

    def __post_init__(self) -> None:
        _set(self, r=_thresholds("r", self.r, "V"))
        _set(self, w_h=_matching("w_h", self.w_h, "um/V", "r", self.r))

    def step(self, x: float, y: FloatArray) -> tuple[float, FloatArray]:
        """Output, um, and play states, V, after the input x, V; y are the states after the last tick."""
        y = play(x, self.r, y)
        return float(dot(self.w_h, y)), y

    def predict(self, x: npt.ArrayLike, y0: npt.ArrayLike | None = None) -> FloatArray:
        """Output, um, shape (ticks,), for the input x, V, shape (ticks,)."""
        return dot(play_history(x, self.r, y0), self.w_h)


@dataclass(frozen=True, eq=False)
class ModifiedPrandtlIshlinskii:
    """Plays and dead zones: z(t) = w_s . S_d[w_h . H_r[x, y0]](t)  (5).

    Attributes
    ----------
    r, w_h : ndarray, shape (n,)
        Thresholds, V, ascending from 0, and weights, um/V, of the plays.
    d, w_s : ndarray, shape (m,)
        Thresholds, um, ascending from 0, and weights, without unit, of the dead zones.

    Examples
    --------
    >>> model = ModifiedPrandtlIshlinskii(r=[0.0, 0.5], w_h=[8.0, 2.0], d=[0.0, 5.0], w_s=[1.0, 0.1])
    >>> model.predict([0.8, 0.0])
    array([7.2, 0.6])
    """

    r: FloatArray
    w_h: FloatArray
    d: FloatArray = (0.0,)  # type: ignore[assignment]  # any sequence; an array after __post_init__
    w_s: FloatArray = (1.0,)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        _set(self, r=_thresholds("r", self.r, "V"), d=_thresholds("d", self.d, "um"))
        _set(self, w_h=_matching("w_h", self.w_h, "um/V", "r", self.r), w_s=_matching("w_s", self.w_s, "", "d", self.d))

    def step(self, x: float, y: FloatArray) -> tuple[float, FloatArray]:
        """Displacement, um, and play states, V, after the input x, V; y are the states after the last tick."""
        y = play(x, self.r, y)
        return float(dot(dead_zone(dot(self.w_h, y), self.d), self.w_s)), y

    def predict(self, x: npt.ArrayLike, y0: npt.ArrayLike | None = None) -> FloatArray:
        """Displacement, um, shape (ticks,), for the input x, V, shape (ticks,)."""
        return dot(dead_zone(dot(play_history(x, self.r, y0), self.w_h), self.d), self.w_s)


@dataclass(frozen=True, eq=False, kw_only=True)
class RateDependentModel:
    """The rate-dependent model and its inverse.

    ::

        w_h(zdot_d) = a + c_b zdot_d b                                     (7), in the scale of (20)
        z(t)        = w_s . S_d[w_h(zdot_d) . H_r[x, y0]](t)               (8)
        x(t)        = w_h' . H_r'[w_s' . S_d'[z_d], y0'](t)                (9)

    The published b is in the scale of (20), so c_b belongs to (7) as well.

    Attributes
    ----------
    r, a, b : ndarray, shape (n,)
        Thresholds, V, ascending from 0; weights at rest, um/V; rate weights, um/V.
    d, w_s : ndarray, shape (m,)
        Thresholds, um, ascending from 0, and weights, without unit, of the dead zones.
    rate_scale : float
        c_b, s/um.

    Examples
    --------
    The stack of Sec. 4.3 on the way up and down at 100 um/s, and the voltages found again:

    >>> stack = RateDependentModel(
    ...     r=np.arange(8) / 8 * 1.5,
    ...     a=[8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23],
    ...     b=[-0.9, 1.03, -0.244, 0.1, 0.05, -0.02, 0.01, -0.01],
    ... )
    >>> z = stack.predict([1.0, 2.0, 1.0], [100.0, 100.0, -100.0])
    >>> z.round(3)
    array([10.491, 22.702, 13.237])
    >>> stack.invert(z, [100.0, 100.0, -100.0]).round(9)
    array([1., 2., 1.])
    """

    r: FloatArray
    a: FloatArray
    b: FloatArray
    d: FloatArray = (0.0,)  # type: ignore[assignment]  # any sequence; an array after __post_init__
    w_s: FloatArray = (1.0,)  # type: ignore[assignment]
    rate_scale: float = 0.007

    def __post_init__(self) -> None:
        _set(self, r=_thresholds("r", self.r, "V"), d=_thresholds("d", self.d, "um"))
        _set(self, a=_matching("a", self.a, "um/V", "r", self.r), b=_matching("b", self.b, "um/V", "r", self.r))
        _set(self, w_s=_matching("w_s", self.w_s, "", "d", self.d))
        _set(self, rate_scale=checks.number("rate_scale", self.rate_scale, "s/um"))

    def weights(self, zdot_d: npt.ArrayLike) -> FloatArray:
        """Weights w_h (7), um/V, shape (..., n), at the rates zdot_d, um/s, shape (...)."""
        rate = self.rate_scale * _floats(zdot_d)[..., np.newaxis]
        return self.a + rate * self.b

    def step(self, x: float, zdot_d: float, y: FloatArray) -> tuple[float, FloatArray]:
        """Displacement (8), um, and play states, V, after the input x, V, at the rate zdot_d, um/s."""
        y = play(x, self.r, y)
        return float(dot(dead_zone(dot(self.weights(zdot_d), y), self.d), self.w_s)), y

    def predict(self, x: npt.ArrayLike, zdot_d: npt.ArrayLike, y0: npt.ArrayLike | None = None) -> FloatArray:
        """Displacement (8), um, for the input x, V, and rates zdot_d, um/s, all of shape (ticks,)."""
        x, rate, y = self._arrays(x, zdot_d, y0)
        sums = np.empty_like(x)
        _kernel.play_sum(x, rate, self.a, self.b, self.r, y, sums)
        return dot(dead_zone(sums, self.d), self.w_s)

    def invert_step(self, z_d: float, zdot_d: float, y: FloatArray) -> tuple[float, FloatArray]:
        """Input (9), V, and play states, V, for the displacement z_d, um, at the rate zdot_d, um/s.

        Raises `SettingError` where a partial sum of w_s or of w_h(zdot_d) is not above 0.
        """
        w_s, d = inverse_dead_zones(self.w_s, self.d)
        y_d = float(dot(dead_zone(z_d, d), w_s))  # (11)
        x = play_inverse_literal(y_d, self.weights(zdot_d), self.r, y)  # (12)
        return x, play(x, self.r, y)

    def invert(self, z_d: npt.ArrayLike, zdot_d: npt.ArrayLike, y0: npt.ArrayLike | None = None) -> FloatArray:
        """Input (9), V, for the displacement z_d, um, and rates zdot_d, um/s, all of shape (ticks,).

        In the kernel; `invert_step` is the text.
        """
        z_d, rate, y = self._arrays(z_d, zdot_d, y0)
        w_s, d = inverse_dead_zones(self.w_s, self.d)
        x = np.empty_like(z_d)
        bad = _kernel.play_invert(dot(dead_zone(z_d, d), w_s), rate, self.a, self.b, self.r, y, x)
        if bad >= 0:
            w_h = self.a + rate[bad] * self.b
            raise SettingError(f"w_h(zdot_d[{bad}])", w_h, "numbers whose partial sums are all above 0", "um/V")
        return x

    def _arrays(
        self, values: npt.ArrayLike, zdot_d: npt.ArrayLike, y0: npt.ArrayLike | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values, c_b zdot_d and play states, each an array of its own, as the kernel takes them."""
        first, rate = np.broadcast_arrays(_floats(values), self.rate_scale * _floats(zdot_d))
        y = np.zeros(self.r.size) if y0 is None else np.array(y0, dtype=np.float64)
        return np.array(first, ndmin=1), np.array(rate, ndmin=1), y


def _set(model: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(model, name, value)


def _thresholds(name: str, value: npt.ArrayLike, unit: str) -> FloatArray:
    return np.array(checks.ascending(name, checks.finite_array(name, value, unit).tolist(), unit))


def _matching(name: str, value: npt.ArrayLike, unit: str, other: str, thresholds: FloatArray) -> FloatArray:
    array = checks.finite_array(name, value, unit)
    if array.size != thresholds.size:
        raise SettingError(name, array, f"{thresholds.size} numbers, one for each of {other}", unit)
    return array
