"""Laws that adapt the weights: recursive least squares (19)-(23), and least mean squares (Sec. 6).

A law is anything with `weights` and `update(u, e_m)`. A law of your own goes into the loop like this:

>>> class SignError:
...     "Sign-error LMS: the weights take steps of one size."
...     def __init__(self, initial_weights, step_size):
...         self.weights, self.step_size = np.array(initial_weights), step_size
...     def update(self, u, e_m):
...         self.weights = self.weights + self.step_size * np.sign(e_m) * u
>>> from truestroke import ControllerSettings
>>> from truestroke.reference import ReferenceController
>>> settings = ControllerSettings.paper(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
>>> controller = ReferenceController(settings, SignError(settings.initial_weights, step_size=0.01))
>>> controller.command(10.0, 0.0)
2.0
>>> controller.adapt(20.0)
>>> controller.weights[:4]
array([5.02   , 0.     , 0.01775, 0.     ])
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from truestroke import _check
from truestroke._check import SettingError
from truestroke._typing import FloatArray
from truestroke.operators import dot


class Law(Protocol):
    """What adapts the weights.

    Attributes
    ----------
    weights : ndarray, shape (m,)
        w = [a0, b0, a1, b1, ...] of (21), um/V.
    """

    weights: FloatArray

    def update(self, u: FloatArray, e_m: float) -> None:
        """Learn from the regressor u of (20), V, and the error of the model e_m of (15), um.

        Raises `UpdateRefused`, and changes nothing, where it cannot.
        """


class UpdateRefused(ArithmeticError):  # noqa: N818 (nothing is broken: one measurement is not used)
    """A law did not use a measurement, and has not changed."""


def rls_update(
    w: FloatArray, P: FloatArray, u: FloatArray, e_m: float, lambda_: float
) -> tuple[FloatArray, FloatArray]:
    """One step of recursive least squares as printed, (23).

    This is the statement; `RLS` computes the same in a way that survives rounding.

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

    Two departures from the print, both in P alone. A square root S of P = S S' is carried in its place (Potter 1963):
    as printed, P loses its definiteness to rounding after some minutes at rest, and the law points the wrong way. And
    P does not grow past `covariance_limit`: at rest the division by lambda would end in infinity.

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
    S : ndarray, shape (m, m)
        Square root of P, 1/V.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    References
    ----------
    Haykin, Adaptive Filter Theory, 3rd ed., Prentice Hall 1996, ch. 13, the paper's [22]. Bierman, Factorization
    Methods for Discrete Sequential Estimation, Academic Press 1977, ch. 2: Potter's algorithm.

    Examples
    --------
    Two exact equations and next to no prior give the two unknowns:

    >>> law = RLS([0.0, 0.0], forgetting=1.0, regularization=1e-9)
    >>> for u, y in [((1.0, 1.0), 5.0), ((1.0, -1.0), 1.0)]:
    ...     law.update(np.array(u), y - np.dot(law.weights, u))
    >>> law.weights.round(6)
    array([3., 2.])
    """

    def __init__(
        self,
        initial_weights: npt.ArrayLike,
        *,
        forgetting: float = 0.9999,
        regularization: float = 1e-3,
        covariance_limit: float = 1e6,
    ) -> None:
        self.weights = _check.finite_array("initial_weights", initial_weights, "um/V").copy()
        self.forgetting = _check.positive("forgetting", forgetting)
        _check.within("forgetting", forgetting, 0.0, 1.0)
        self.covariance_limit = _check.positive("covariance_limit", covariance_limit, "1/V^2")
        self.S = np.eye(self.weights.size) / math.sqrt(_check.positive("regularization", regularization, "V^2"))

    @property
    def P(self) -> FloatArray:  # noqa: N802 (the paper's symbol)
        """Inverse of the weighted correlation of u, shape (m, m), 1/V^2."""
        P: FloatArray = self.S @ self.S.T
        return P

    def update(self, u: FloatArray, e_m: float) -> None:
        """One step of (23), with the regressor u, V, and the error of the model e_m, um."""
        lambda_, S = self.forgetting, self.S
        f = dot(S.T, u)
        u_pi = float(dot(f, f))  # u'Pu
        if not (math.isfinite(u_pi) and math.isfinite(e_m)):
            raise UpdateRefused(f"u'Pu = {u_pi}, e_m = {e_m} um")
        a = lambda_ + u_pi
        pi = dot(S, f)  # P u
        self.weights = self.weights + pi / a * e_m
        # Squared, this is the last line of (23).
        trace = float(dot(S.ravel(), S.ravel()))
        growth = 1.0 if trace > lambda_ * self.covariance_limit else 1.0 / math.sqrt(lambda_)
        self.S = growth * (S - np.outer(1.0 / (a + math.sqrt(lambda_ * a)) * pi, f))


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
        epsilon, V^2, 0 or more: what keeps the division harmless where u is small.

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
        self.weights = _check.finite_array("initial_weights", initial_weights, "um/V").copy()
        self.step_size = _check.positive("step_size", step_size, "" if normalised else "1/V^2")
        if normalised and self.step_size >= 2:
            raise SettingError("step_size", step_size, "below 2 for the normalised law")
        self.normalised = normalised
        self.regularization = _check.within("regularization", regularization, 0.0, math.inf, "V^2")

    def update(self, u: FloatArray, e_m: float) -> None:
        """One step, with the regressor u, V, and the error of the model e_m, um."""
        energy = self.regularization + float(dot(u, u)) if self.normalised else 1.0
        if not (energy < math.inf and math.isfinite(e_m)):
            raise UpdateRefused(f"epsilon + u'u = {energy} V^2, e_m = {e_m} um")
        if energy > 0:  # at rest at 0 V, with epsilon = 0, there is nothing to learn
            self.weights = self.weights + self.step_size * e_m / energy * u
