"""Covariance of the weights where what is left is not white."""

from __future__ import annotations

import numpy as np

from truestroke._typing import FloatArray
from truestroke.identification.normal import Prior, reduced

SEGMENTS = 8  # of the record, for the spectrum of what is left


def covariance(J: FloatArray, residual: FloatArray, prior: Prior, weight: float) -> FloatArray:
    """Covariance of regularised least squares, in the squares of the coefficients' units.

    ::

        A^-1 (J' Omega J + weight^2 P0^-1) A^-1,      A = J'J + weight P0^-1

    Omega, the covariance of the residual, is taken as stationary: J' Omega J is the sum over frequencies of the
    residual's spectrum (Welch) times the columns' own. For white noise and the weight sigma^2 it is the posterior
    covariance sigma^2 A^-1.

    Parameters
    ----------
    J : ndarray, shape (samples, m)
        Derivative of the prediction by each coefficient.
    residual : ndarray, shape (samples,)
        What the fit leaves, um.
    prior : Prior
        What was believed before.
    weight : float
        Variance, um^2, that the prior's precision was multiplied with.
    """
    precision = np.linalg.inv(prior.covariance)
    R = reduced(J)
    A = np.linalg.inv(R.T @ R + weight * precision)
    spread = colored(J, residual) + weight**2 * precision
    P = A @ spread @ A.T
    return np.asarray((P + P.T) / 2)


def colored(J: FloatArray, residual: FloatArray) -> FloatArray:
    """J' Omega J, corrected for the degrees of freedom that the fit took."""
    from scipy.signal import welch

    samples, m = J.shape
    length = max(samples // SEGMENTS, min(samples, 16))
    f, S = welch(residual, nperseg=length, return_onesided=False, detrend=False)
    order = np.argsort(f)
    grid = np.fft.rfftfreq(samples)
    spectrum = np.interp(grid, f[order][f[order] >= 0], S[order][f[order] >= 0])
    twice = np.where((grid > 0) & (grid < 0.5), 2.0, 1.0)
    scale = samples / max(samples - m, 1) / samples
    F = np.fft.rfft(J, axis=0) * np.sqrt(spectrum * twice * scale)[:, None]
    return np.asarray(F.real.T @ F.real + F.imag.T @ F.imag)


def effective_samples(residual: FloatArray) -> float:
    """How many independent samples have the same uncertainty of the mean: n S(white) / S(0)."""
    from scipy.signal import welch

    _, S = welch(residual, nperseg=max(residual.size // SEGMENTS, min(residual.size, 16)), return_onesided=False)
    return float(residual.size * min(1.0, S.mean() / max(S[1:4].mean(), 1e-300)))
