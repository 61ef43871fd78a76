"""Laws that adapt the weights: a bounded Kalman filter, recursive least squares (19)-(23), least mean squares (Sec. 6).

A law is an object with `weights` and `update(u, e_m)`. A law of your own is used like this:

>>> class SignError:
...     "Sign-error LMS: the weights take steps of one size."
...     def __init__(self, initial_weights, step_size):
...         self.weights, self.step_size = np.array(initial_weights), step_size
...     def update(self, u, e_m):
...         self.weights = self.weights + self.step_size * np.sign(e_m) * u
>>> from truestroke import ControllerSettings
>>> from truestroke.control.reference import ReferenceController
>>> settings = ControllerSettings.paper(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
>>> controller = ReferenceController(settings, SignError(settings.initial_weights, step_size=0.01))
>>> controller.command(10.0, 0.0)
2.0
>>> controller.adapt(20.0)
>>> controller.weights[:4]
array([5.02    , 0.      , 0.018125, 0.      ])
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cache
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import FloatArray
from truestroke.model.operators import LANES, dot


class Law(Protocol):
    """What adapts the weights.

    Attributes
    ----------
    weights : ndarray, shape (m,)
        w = [a0, b0, a1, b1, ...] of (21), um/V.
    """

    weights: FloatArray

    def update(self, u: FloatArray, e_m: float) -> None:
        """Adapt to the regressor u of (20), V, and the error of the model e_m of (15), um.

        Raises `UpdateRefused`, and changes nothing, where it cannot.
        """


@runtime_checkable
class FilteringLaw(Law, Protocol):
    """A law that also passes measurement and regressor through a filter: `BoundedKalman`.

    The controller projects its weights, rejects spikes and frozen sensors, and lowers its filter below a resonance.
    """

    settings: KalmanSettings
    filter: float
    sigma: float
    ringing: float
    disturbance: float
    load: float
    caution: float
    changed: bool
    since_change: int
    relates: int
    steady: bool
    small: bool
    calm: bool
    outgrown: bool
    started: bool

    def is_spike(self, e_m: float, noisy: float | None = None) -> bool:
        """Whether a measurement with the innovation e_m, um, is not to be used; noisy: what `tick` gets instead."""

    def tick(self, u: FloatArray, y: float, innovation: float, *, measured: bool, learn: bool) -> bool:
        """One tick in which w.u should be y, um; returns whether the weights were updated."""

    def take(self, settings: KalmanSettings) -> None:
        """New settings; what was learned stays."""

    def project(self, columns: int, rate: float, missing: float) -> None:
        """The weights whose sum up to `columns`, with `rate` times those of no play, is larger by `missing`."""

    def reset_covariance(self) -> None:
        """The covariance of the prior again."""

    def separate(self, place: int, variance: float) -> None:
        """A weight that is independent of all others."""

    def doubt(self, d: FloatArray) -> None:
        """The weights may be off by any share of d, beside all else."""

    def wait(self, ticks: int) -> None:
        """The weights stay for so many ticks."""

    def noise_of_sine(self, amplitude: float, frequency: float) -> float:
        """A sine of this amplitude, um, and frequency, cycles per tick, as noise, um^2."""

    def start_filters(self) -> None:
        """The filters start at 0, in place of the first regressor and measurement, unless they have started."""

    def stop_filters(self) -> None:
        """They start anew with the next tick."""

    def missing(self, weights: FloatArray | None = None) -> float:
        """What the weights, or these, miss of the filtered measurement, um; 0 where the filters have not started."""

    def variance_of(self, place: int) -> float:
        """Of the weight in this place, (um/V)^2."""

    def knowledge(self) -> tuple[FloatArray, float]:
        """Covariance, and noise in um: what `restore` takes."""

    def restore(self, knowledge: tuple[FloatArray, float]) -> None:
        """Covariance and noise as they were; the filters start anew."""


class UpdateRefused(TruestrokeError, ArithmeticError):  # noqa: N818 (nothing is broken: one measurement is not used)
    """A law did not use a measurement, and has not changed."""


def rls_update(
    w: FloatArray, P: FloatArray, u: FloatArray, e_m: float, lambda_: float
) -> tuple[FloatArray, FloatArray]:
    """One step of recursive least squares as printed, (23).

    This is the statement; `RLS` computes the same in a form that is robust to rounding.

    Parameters
    ----------
    w : ndarray, shape (m,)
        Weights of the last tick, um/V.
    P : ndarray, shape (m, m)
        Inverse of the weighted correlation of u, symmetric, 1/V^2.
    u : ndarray, shape (m,)
        Regressor (20), V.
    e_m : float
        Error of the model (15), um.
    lambda_ : float
        Forgetting factor, above 0, at most 1.

    Returns
    -------
    w, P : ndarray
        Of this tick.

    Examples
    --------
    >>> rls_update(np.array([5.0, 0.0]), np.eye(2), np.array([1.0, 1.0]), 3.0, 1.0)
    (array([6., 1.]), array([[ 0.66666667, -0.33333333],
           [-0.33333333,  0.66666667]]))
    """
    pi = P @ u
    mu = pi / (lambda_ + u @ pi)
    w = w + mu * e_m  # the print has mu u e_m; mu is the gain vector already
    P = P / lambda_ - np.outer(mu, u @ P) / lambda_
    return w, P


class RLS:
    """Recursive least squares with a forgetting factor.

    ::

        w(0) = [5, 0, ...],   P(0) = I / delta                             (22)
        pi   = P(n-1) u(n)
        mu   = pi / (lambda + u(n)' pi)
        w(n) = w(n-1) + mu e_m(n)                                          (23)
        P(n) = (P(n-1) - mu u(n)' P(n-1)) / lambda

    Two departures from the print, both in P alone. The factors of P = U D U' are stored in its place (Bierman 1976): as
    printed, P loses its definiteness by rounding after some minutes at rest, and the gain has the wrong sign. And P
    does not grow beyond `covariance_limit`: at rest the division by lambda would end in infinity.

    Parameters
    ----------
    initial_weights : array_like, shape (m,)
        w(0), um/V.
    forgetting : float
        lambda, above 0, at most 1; 1 is infinite memory.
    regularization : float
        delta, V^2, above 0: small where the signal is large against the noise.
    covariance_limit : float
        Largest trace of P, 1/V^2.

    Attributes
    ----------
    weights : ndarray, shape (m,)
        w, um/V.
    U : ndarray, shape (m, m)
        Factor of P: upper triangle with ones on its diagonal, 1.
    D : ndarray, shape (m,)
        Factor of P: its diagonal, above 0, 1/V^2.
    trace : float
        Trace of P, 1/V^2.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    References
    ----------
    Haykin, Adaptive Filter Theory, 3rd ed., Prentice Hall 1996, ch. 13, the paper's [22]. Bierman, Factorization
    Methods for Discrete Sequential Estimation, Academic Press 1977, ch. 5: the U D update.

    Examples
    --------
    Two exact equations and almost no prior give the two unknowns:

    >>> law = RLS([0.0, 0.0], forgetting=1.0, regularization=1e-9)
    >>> for u, y in [((1.0, 1.0), 5.0), ((1.0, -1.0), 1.0)]:
    ...     law.update(np.array(u), y - np.dot(law.weights, u))
    >>> law.weights.round(6)
    array([3., 2.])
    """

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def __init__(
        self,
        initial_weights: npt.ArrayLike,
        *,
        forgetting: float = 0.9999,
        regularization: float = 1e-3,
        covariance_limit: float = 1e6,
    ) -> None:
        self.weights = checks.finite_array("initial_weights", initial_weights, "um/V").copy()
        self.forgetting = checks.positive("forgetting", forgetting)
        checks.within("forgetting", forgetting, 0.0, 1.0)
        self.covariance_limit = checks.positive("covariance_limit", covariance_limit, "1/V^2")
        self.regularization = checks.positive("regularization", regularization, "V^2")
        self._begin()

    def _begin(self) -> None:
        m, delta = self.weights.size, self.regularization
        self.U, self.D, self.trace = np.eye(m), np.full(m, 1 / delta), m / delta

    @property
    def P(self) -> FloatArray:  # noqa: N802 (the paper's symbol)
        """Inverse of the weighted correlation of u, shape (m, m), 1/V^2."""
        P: FloatArray = self.U * self.D @ self.U.T
        return P

    def update(self, u: FloatArray, e_m: float) -> None:
        """One step of (23), with the regressor u, V, and the error of the model e_m, um."""
        lambda_, U, D = self.forgetting, self.U, self.D
        f = dot(U.T, u)
        g = D * f
        alpha = np.cumsum(np.append(lambda_, f * g))  # grows from lambda to lambda + u'Pu
        b = np.cumsum(np.column_stack([np.zeros(f.size), g * U]), axis=1)  # grows from 0 to P u
        if not (math.isfinite(alpha[-1]) and math.isfinite(e_m)):
            raise UpdateRefused(f"lambda + u'Pu = {alpha[-1]}, e_m = {e_m} um")
        growth = 1.0 if self.trace > lambda_ * self.covariance_limit else 1.0 / lambda_
        inverse = 1 / alpha
        self.U = U - f * inverse[:-1] * b[:, :-1]
        self.D = growth * (alpha[:-1] * inverse[1:]) * D
        diagonal = np.cumsum(self.D * (self.U * self.U), axis=1)[:, -1]  # of P
        self.trace = float(dot(diagonal, np.ones(f.size)))
        if not (math.isfinite(self.trace) and math.isfinite(e_m * inverse[-1])):
            if not math.isfinite(self.trace):
                self._begin()
            raise UpdateRefused("P is too large to be computed")
        self.weights = within_largest(self.weights + e_m * inverse[-1] * b[:, -1])


class LMS:
    """Least mean squares, normalised (NLMS) or as Widrow and Hoff wrote it.

    ::

        w(n) = w(n-1) + eta u(n) e_m(n) / (epsilon + u(n)' u(n))           normalised
        w(n) = w(n-1) + eta u(n) e_m(n)                                    Widrow-Hoff

    The normalised law is stable for 0 < eta < 2 whatever the size of u; without noise it learns fastest at eta = 1, and
    a smaller eta averages more noise away. Widrow-Hoff is stable for 0 < eta < 2 / max u'u, in 1/V^2: a bound that
    depends on the trajectory, so that it cannot be checked beforehand. More robust to sudden changes than RLS, with a
    larger error in the steady state (Sec. 6). Leaky and sign variants are not here.

    Parameters
    ----------
    initial_weights : array_like, shape (m,)
        w(0), um/V.
    step_size : float
        eta, above 0: below 2 and without unit where normalised, otherwise in 1/V^2.
    normalised : bool
        Divide by the energy of u.
    regularization : float
        epsilon, V^2, 0 or more: keeps the division harmless where u is small.

    Attributes
    ----------
    weights : ndarray, shape (m,)
        w, um/V.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    References
    ----------
    Haykin, Adaptive Filter Theory, 3rd ed., Prentice Hall 1996, ch. 9.

    Examples
    --------
    >>> law = LMS([0.0, 0.0], step_size=1.0, regularization=0.0)
    >>> law.update(np.array([1.0, 2.0]), 10.0)
    >>> law.weights, float(np.dot(law.weights, [1.0, 2.0]))
    (array([2., 4.]), 10.0)
    """

    def __init__(
        self,
        initial_weights: npt.ArrayLike,
        *,
        step_size: float = 0.5,
        normalised: bool = True,
        regularization: float = 1e-3,
    ) -> None:
        self.weights = checks.finite_array("initial_weights", initial_weights, "um/V").copy()
        self.step_size = checks.positive("step_size", step_size, "" if normalised else "1/V^2")
        if normalised and self.step_size >= 2:
            raise SettingError("step_size", step_size, "below 2 for the normalised law")
        self.normalised = normalised
        self.regularization = checks.within("regularization", regularization, 0.0, math.inf, "V^2")

    def update(self, u: FloatArray, e_m: float) -> None:
        """One step, with the regressor u, V, and the error of the model e_m, um."""
        energy = self.regularization + float(dot(u, u)) if self.normalised else 1.0
        if not (energy < math.inf and math.isfinite(e_m)):
            raise UpdateRefused(f"epsilon + u'u = {energy} V^2, e_m = {e_m} um")
        if energy > 0:  # at rest at 0 V, with epsilon = 0, there is nothing to learn
            self.weights = self.weights + self.step_size * e_m / energy * u


@dataclass(frozen=True, kw_only=True)
class KalmanSettings:
    """Settings of `BoundedKalman`: ts_kalman_settings of the kernel, times turned into coefficients of a tick.

    Attributes
    ----------
    filter : float
        alpha: coefficient of each of two poles that regressor and measurement pass through, per tick, 0 to 1.
    model_error : float
        What the model cannot explain, um, added to the noise.
    prior_return : float
        epsilon: how far w and P return to the prior in `RETURN_EVERY` ticks, 0 to 1.
    noise_rate, ringing_rate : float
        How fast the robust estimate of the noise follows, and the fast one; per tick, 0 to 1.
    change_threshold, change_rate, usual_rate, refractory
        Mean square of the normalised innovation above which the actuator has changed; how fast that mean follows, per
        update, 0 to 1; the same of the usual mean: where it is above `USUAL`, the innovation is taken relative to it;
        ticks from one change to the next.
    change_gain, change_hysteresis, change_share : float
        Relative standard deviation of a change of all play weights together, and of all but the first together; how far
        P returns to the prior then, 0 to 1.
    outlier, outliers
        Normalised innovation above which a measurement is a spike; spikes in a row that are rejected.
    first_noise : float
        First guess of the noise, um.
    """

    filter: float
    model_error: float
    prior_return: float = 8e-8
    noise_rate: float = 1e-3
    ringing_rate: float = 0.1
    change_threshold: float = 12.0
    change_rate: float = 0.2
    usual_rate: float = 0.0
    refractory: int = 10
    change_gain: float = 0.15
    change_hysteresis: float = 0.3
    change_share: float = 0.002
    outlier: float = 12.0
    outliers: int = 3
    first_noise: float = 0.03


RETURN_EVERY = 16  # ticks: TS_RETURN_EVERY of the kernel
MEAN_SECOND_DIFFERENCE = 1.9544  # mean of |d| of white noise of deviation 1: sqrt(6) sqrt(2 / pi)
CLIP = 7.84  # of sigma: four times that mean, at which the robust estimate of the noise clips
LARGEST = 1e50  # TS_LARGEST of the kernel: largest weight and desired value
OUTGROWN = 0.01  # of the prior's covariance: what P has of it when the motion has become larger
STEADY = 0.4  # of the normalised innovation counts where the error has long been small
UNLIKELY = 3.0  # times the expected first weight: stroke or voltage limits are not those of the actuator
STEEPEST = 5.0  # times it, at most, that count
USUAL = 3.0  # mean square of the normalised innovation: a larger one is usual, but no sudden change
SOON = 8  # refractory times after a change: what seems to be another one until then,
RAISED = 2  # with so many times its mean square, is what the law has made of it
NEVER = 2**31 - 1  # ticks
SURPRISE = 100.0  # largest normalised innovation, squared, that counts for a change: one alone must not trigger it


def within_largest(w: FloatArray) -> FloatArray:
    """Weights of which none is further from 0 than `LARGEST`.

    Examples
    --------
    >>> within_largest(np.array([8.0, -1e70]))
    array([ 8.e+00, -1.e+50])
    """
    return np.clip(w, -LARGEST, LARGEST)


@cache
def _blocks(size: int) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """What the kernel stores of a symmetric matrix, and what of that is before its blocks on the diagonal."""
    block = np.arange(size) // LANES
    return block[:, np.newaxis] >= block, block[:, np.newaxis] > block


def symmetric_times(P: FloatArray, u: FloatArray) -> FloatArray:
    """P u of a symmetric P, in the order of the kernel, which stores rows up to their block of eight on the diagonal.

    Of these blocks and what is below them the columns are summed in order of the rows; then `dot` of the part before
    them, in place of the upper triangle.

    Examples
    --------
    >>> symmetric_times(np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([1.0, 10.0]))
    array([12., 31.])
    """
    stored, left = _blocks(u.size)
    below: FloatArray = np.cumsum(np.where(stored, P, 0.0) * u[:, np.newaxis], axis=0)[-1]
    return below + dot(np.where(left, P, 0.0), u)


def of_columns(a: FloatArray) -> FloatArray:
    """The sum along the last axis, in order; 0 of nothing.

    Examples
    --------
    >>> of_columns(np.array([[1.0, 2.0], [3.0, 4.0]])), of_columns(np.zeros((2, 0)))
    (array([3., 7.]), array([0., 0.]))
    """
    summed: FloatArray = np.cumsum(np.insert(a, 0, 0.0, axis=-1), axis=-1)[..., -1]
    return summed


class BoundedKalman:
    """A Kalman filter of weights that vary about a prior, so that it stays bounded under any input.

    The weights are modelled as an Ornstein-Uhlenbeck process about (w0, P0). With the regressor u and the measurement
    y, both after two equal poles::

        e = y - w.u,   s = u'P u + R / 2                                   innovation and its variance
        w = w + P u e / s,   P = P - P u u'P / s                           Kalman
        w = w + epsilon (w0 - w),   P = P + epsilon (P0 - P)               return to the prior, every 16 ticks

    The purpose of each part:

    - *Return to the prior* in place of forgetting: forgetting winds P up where nothing excites it, and a later motion
      makes the weights jump. Here P <= P0 always holds, and without informative measurements w ends at w0.
    - *Two poles* remove the stage's resonance: a law of high gain would excite it. The linear relation of u and y
      stays, because both pass the same filter.
    - *Noise on line*, R = max(sigma^2, ringing / 2) + model_error^2, from the second difference of the innovation
      d = e(k) - 2 e(k-1) + e(k-2), in which the slow errors of the model vanish. E d^2 = 6 sigma^2, E |d| = 1.9544
      sigma. The robust sigma clips d at four deviations; the fast one counts ringing after a jump as noise.
    - *Every second tick is used*: w moves in the first, P follows in the second, so that the kernel's load is even.
      Hence R / 2: each equation counts for two.
    - *Spikes*: e^2 > outlier^2 (s + sigma^2) up to three times in a row is a fault of the sensor; the fourth is used.
    - *Changes*: the mean of e^2 / (u'P u + (sigma^2 + model_error^2) / 2), each at most 100, above a threshold. P then
      grows in the usual directions of a change: all play weights together, and the hysteresis together, in proportion
      to w; and by a share of the prior. After that it waits for the refractory time. Where the tracking error was
      `small`, an innovation that grows within eight of these times is what the law has made of it, and no change.
    - *Ticks that are not used* (hold, a voltage limit) do not change w, and the poles start anew after them.

    Parameters
    ----------
    initial_weights : array_like, shape (m,)
        w0, um/V: the first weights and the mean of the prior.
    prior_covariance : array_like, shape (m, m)
        P0, symmetric and positive definite, in the squares of the units of w.
    part : array_like of int, shape (m,)
        1 where the weight is of the first play, 2 where it is of another play, 0 for anything else.
    settings : KalmanSettings
        The rest.

    Attributes
    ----------
    weights : ndarray, shape (m,)
        w, um/V.
    P : ndarray, shape (m, m)
        Covariance of w.
    sigma : float
        Noise of a measurement, um.
    filter : float
        The present coefficient of the poles; at first that of the settings.
    disturbance : float
        Variance of an innovation that is no error of the model, such as ringing, um^2; added to the noise.
    load : float
        The same of a load from outside, um^2.
    caution : float
        The same after learning has failed, um^2: see `truestroke.control.guard`.
    changed : bool
        The last update detected a change of the actuator.
    relates : int
        Times `usual_rate`; 0: it does not count. The controller says so while no stage is in the model and the tracking
        error is large.
    steady : bool
        Whether a change has to be larger by 1 / `STEADY`: the controller says so while the error has long been small.
    small : bool
        Whether the tracking error of the last window was small: a burst has only begun.
    calm : bool
        Whether no stage is in the model and the tracking error is small, so that large weights are no burst.
    outgrown : bool
        Whether the motion is larger than the one in which the weights were learned; the next update takes it back.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    References
    ----------
    Jazwinski, Stochastic Processes and Filtering Theory, Academic Press 1970, ch. 7. Rousseeuw and Croux, J. Am. Stat.
    Assoc. 88 (1993) 1273, on robust scale.

    Examples
    --------
    One equation for two weights, of which the prior gives the second; noise of 1 um on every second tick:

    >>> settings = KalmanSettings(filter=1.0, model_error=math.sqrt(2.0), first_noise=0.0, noise_rate=0, ringing_rate=0)
    >>> law = BoundedKalman([5.0, 1.0], np.diag([3.0, 0.5]), [1, 2], settings)
    >>> law.update(np.array([1.0, 0.0]), 4.0)
    >>> law.weights.round(6)
    array([8., 1.])
    """

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def __init__(
        self,
        initial_weights: npt.ArrayLike,
        prior_covariance: npt.ArrayLike,
        part: npt.ArrayLike,
        settings: KalmanSettings,
    ) -> None:
        self.w0 = checks.finite_array("initial_weights", initial_weights, "um/V").copy()
        m = self.w0.size
        self.P0 = checks.finite_array("prior_covariance", prior_covariance, ndim=2).copy()
        if self.P0.shape != (m, m):
            raise SettingError("prior_covariance", f"array of shape {self.P0.shape}", f"of shape ({m}, {m})")
        self.P0 = np.tril(self.P0) + np.tril(self.P0, -1).T  # to the last bit: the kernel takes the lower triangle
        is_play, is_other = np.asarray(part) > 0, np.asarray(part) == 2
        self._no_play = ~is_play
        self._together, self._hysteresis = np.outer(is_play, is_play), np.outer(is_other, is_other)
        self.take(settings)
        self.filter = settings.filter
        self.disturbance = self.load = self.caution = 0.0
        self.weights, self.P = self.w0.copy(), self.P0.copy()
        self.u1 = self.u = np.zeros(m)  # the regressor after one and two poles
        self.y1 = self.y = 0.0  # the measurement after one and two poles, um
        self.Pu = np.zeros(m)
        self.variance = 0.0  # s of the last update, um^2
        self.sigma, self.ringing = settings.first_noise, 0.0  # um, um^2
        self.e1 = self.e2 = 0.0  # innovations of the last two ticks, um
        self.change, self.since_change, self.spikes, self.since_return = 0.0, NEVER, 0, 0
        self.usual = 0.0  # mean square of the normalised innovation, slowly
        self.power = self.at_change = 0.0  # um^2: that of the innovation, and what it was at the last change, or 0
        self.started = self.pending = self.changed = False
        self.relates, self.steady, self.small, self.calm, self.outgrown = 1, False, False, False, False

    def take(self, settings: KalmanSettings) -> None:
        """New settings; w, P and the present filter stay."""
        self.settings = settings
        gain, hysteresis = settings.change_gain, settings.change_hysteresis
        self._change = gain * gain * self._together + hysteresis * hysteresis * self._hysteresis

    def reset_covariance(self) -> None:
        """The covariance is that of the prior again, and the filters start anew; the noise stays."""
        self.P = self.P0.copy()
        self.started = self.pending = self.changed = False
        self.change = self.variance = 0.0

    def doubt(self, d: FloatArray) -> None:
        """The weights may be off by any share of d, beside all else: P += d d'."""
        self.P = self.P + np.outer(d, d)

    def wait(self, ticks: int) -> None:
        """The weights stay for so many ticks, and what is unusual is summed anew."""
        self.since_change, self.change, self.at_change = -ticks, 0.0, 0.0

    def noise_of_sine(self, amplitude: float, frequency: float) -> float:
        """A sine of this amplitude, um, and frequency, cycles per tick, as noise, um^2: its variance behind the filter.

        Over the ticks of half a half-wave, times four because it is not white.
        """
        w = 2 * math.pi * frequency * (1 - self.filter) / self.filter
        left = amplitude / (1 + w * w)
        return left * left / (2 * frequency)

    def start_filters(self) -> None:
        """They start at 0, in place of the first u and y, unless they have: y = w.u stays exact."""
        if not self.started:
            self.u1 = self.u = np.zeros(self.u.size)
            self.y1, self.y, self.started = 0.0, 0.0, True

    def stop_filters(self) -> None:
        """They start anew with the next tick."""
        self.started = False

    def missing(self, weights: FloatArray | None = None) -> float:
        """What the weights, or these, miss of the filtered measurement, um; 0 where the filters have not started."""
        return self.y - float(dot(self.u, self.weights if weights is None else weights)) if self.started else 0.0

    def variance_of(self, place: int) -> float:
        """Of the weight in this place, (um/V)^2."""
        return float(self.P[place, place])

    def knowledge(self) -> tuple[FloatArray, float]:
        """Covariance, and noise in um: what `restore` takes."""
        return self.P, self.sigma

    def restore(self, knowledge: tuple[FloatArray, float]) -> None:
        """Covariance and noise as they were; the filters start anew."""
        self.P, self.sigma = knowledge
        self.started = self.pending = self.changed = False
        self.change = self.variance = 0.0

    def separate(self, place: int, variance: float) -> None:
        """The weight at `place` is independent of all others from now on, with this variance."""
        self.P = self.P.copy()
        self.P[place, :] = self.P[:, place] = 0.0
        self.P[place, place] = variance
        self.pending = self.changed = False

    def update(self, u: FloatArray, e_m: float | None, learn: bool = True) -> None:
        """One tick with the regressor u and the innovation e_m, um; None: no measurement came.

        Raises `UpdateRefused` where the measurement is a spike.
        """
        spike = e_m is not None and self.is_spike(e_m)
        innovation = 0.0 if e_m is None or spike else e_m
        y = float(dot(u, self.weights)) + innovation
        self.tick(u, y, innovation, measured=e_m is not None and not spike, learn=learn)
        if spike:
            raise UpdateRefused(f"e_m = {e_m} um is a spike")

    def is_spike(self, e_m: float, noisy: float | None = None) -> bool:
        """Whether a measurement with the innovation e_m, um, is a spike; at most `outliers` in a row are.

        noisy: what `tick` gets in place of e_m, um; then the innovation of a good measurement may be as large, but this
        not as sudden: its second difference decides.
        """
        s = self.settings
        if not self.variance > 0:  # before the first update the model may be far off
            return False
        most, noise = s.outlier * s.outlier, self.sigma * self.sigma
        d = (e_m if noisy is None else noisy) - 2 * self.e1 + self.e2
        sudden = noisy is None or d * d > most * (noise + self.ringing)
        beyond = e_m * e_m > most * (self.variance + noise) and sudden
        spike = beyond and self.spikes < s.outliers
        self.spikes = self.spikes + spike if beyond else 0
        return spike

    def tick(self, u: FloatArray, y: float, innovation: float, *, measured: bool, learn: bool) -> bool:
        """One tick in which w.u should be y, um; returns whether w was updated.

        innovation: of the measurement, um. measured: false where none came, or it was a spike; y is then what is
        expected. learn: false at a voltage limit and on hold: w stays, and the poles start anew afterwards.
        """
        if learn:
            self._follow_noise(innovation, measured)
            self._filter(u, y)
        else:
            self.started = False
        self.since_change = min(self.since_change + 1, NEVER)
        if self.pending:
            self._follow_covariance()
            return False
        return measured and learn and self.since_change >= 0 and self._update_weights()

    def _follow_noise(self, innovation: float, measured: bool) -> None:
        s = self.settings
        d = min(abs(innovation - 2 * self.e1 + self.e2), LARGEST)
        self.e1, self.e2 = innovation, self.e1
        if measured:
            self.ringing += s.ringing_rate * (d * d / 6 - self.ringing)
            clipped = min(d, CLIP * max(self.sigma, s.model_error))  # model_error: for rest
            self.sigma += s.noise_rate * (clipped / MEAN_SECOND_DIFFERENCE - self.sigma)

    def _filter(self, u: FloatArray, y: float) -> None:
        alpha = self.filter
        if not self.started:
            self.u1, self.u, self.y1, self.y, self.started = u, u, y, y, True
        self.u1 = self.u1 + alpha * (u - self.u1)
        self.u = self.u + alpha * (self.u1 - self.u)
        self.y1 += alpha * (y - self.y1)
        self.y += alpha * (self.y1 - self.y)

    def _update_weights(self) -> bool:
        """First tick of an update; returns whether there was one."""
        s = self.settings
        self.Pu = symmetric_times(self.P, self.u)
        explained, e = float(dot(self.u, self.Pu)), self.y - float(dot(self.u, self.weights))
        if not (explained >= 0 and math.isfinite(explained * e)):  # never observed: P is no longer definite
            self.P = self.P0.copy()
            return False
        floor = s.model_error * s.model_error + self.disturbance + self.load + self.caution
        quiet = self.sigma * self.sigma
        expected = explained + (quiet + floor) / 2
        if not expected > 0:  # no motion, no noise, no error of the model: nothing to divide by
            return False
        variance = explained + (max(self.ringing / 2, quiet) + floor) / 2
        gain = e / variance
        if not (math.isfinite(variance) and math.isfinite(gain)):
            return False
        self.variance, self.pending = variance, True
        self.weights = within_largest(self.weights + gain * self.Pu)
        self.since_return += 2
        if self.since_return >= RETURN_EVERY:
            self.weights = self.weights + s.prior_return * (self.w0 - self.weights)
        self._detect_change(e * e / expected, e * e)
        return True

    def _detect_change(self, surprise: float, square: float) -> None:
        s = self.settings
        self.power += s.change_rate * (min(square, LARGEST * LARGEST) - self.power)
        whole = min(surprise, SURPRISE)
        surprise = min(STEADY * surprise, SURPRISE) if self.steady else whole
        if s.usual_rate > 0 and self.relates:
            self.usual += min(self.relates * s.usual_rate, 1.0) * (whole - self.usual)
            if self.usual > USUAL:
                surprise *= USUAL / self.usual
        self.change += s.change_rate * (surprise - self.change)
        found = self.change > s.change_threshold and self.since_change >= s.refractory
        soon = self.small and self.at_change > 0 and self.since_change // SOON < s.refractory
        if found:
            self.since_change, self.change = 0, 0.0
        self.changed = found and not (soon and self.power > RAISED * self.at_change)
        if self.changed:
            self.at_change = self.power

    def _haste(self) -> float:
        """By how much faster P returns to the prior where the actuator is far steeper than that says."""
        slope, expected = float(self.weights[0]), float(self.w0[0])  # at a turn
        if not (expected > 0 and slope > UNLIKELY * expected):
            return 1.0
        steeper = min(slope / expected, STEEPEST)
        return steeper * steeper

    def _follow_covariance(self) -> None:
        """Second tick of an update."""
        s, back = self.settings, 0.0
        root = self.Pu * (1 / math.sqrt(self.variance))
        if not float(dot(root, root)) <= LARGEST * LARGEST:  # never observed, as above
            self.P, root = self.P0.copy(), np.zeros(root.size)
        P = self.P - np.outer(root, root)
        if self.since_return >= RETURN_EVERY:
            self.since_return, back = 0, s.prior_return
        if self.changed:
            back += s.change_share
        if self.outgrown:
            back += OUTGROWN
        if self.calm:
            back *= self._haste()
        if back > 0:
            P += min(back, 1.0) * (self.P0 - P)
        if self.changed:
            P += self._change * np.outer(self.weights, self.weights)
        self.P = P
        self.pending = self.changed = self.outgrown = False

    def project(self, columns: int, rate: float, missing: float) -> None:
        """Move w so that g.w grows by `missing`: w = w + P g missing / (g'P g).

        g is 1 for the first `columns` weights, but `rate` for those of no play, and 0 for the others. Of all w with
        this g.w it is the nearest one in the metric of P^-1: informative data weigh most.
        """
        rates = self._no_play[:columns]
        Pg = of_columns(self.P[:, :columns]) + (rate - 1) * of_columns(self.P[:, :columns][:, rates])
        g_Pg = float(of_columns(Pg[:columns]) + (rate - 1) * of_columns(Pg[:columns][rates]))
        if 0 < g_Pg < math.inf and math.isfinite(step := missing / g_Pg):
            self.weights = within_largest(self.weights + step * Pg)
