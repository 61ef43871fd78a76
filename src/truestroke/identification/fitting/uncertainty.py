"""Covariance of the weights where the residual is not white."""

from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import normal
from truestroke.identification.fitting.normal import Prior

LAGS = 200  # of the autocorrelation at most
SEGMENTS = 8  # of the record, for the spectrum of the residual


def covariance_root(J: FloatArray, R: FloatArray, residual: FloatArray, prior: Prior, weight: float) -> FloatArray:
    """F of the covariance F F' of regularised least squares, in the units of the coefficients.

    ::

        F F' = A^-1 (J' Omega J + weight^2 P0^-1) A^-1,      A = J'J + weight P0^-1

    Omega, the covariance of the residual, is taken as stationary: J' Omega J is the sum over frequencies of the
    residual's spectrum (Welch) times the columns' own. For white noise and the weight sigma^2 it is the posterior
    covariance sigma^2 A^-1.

    Parameters
    ----------
    J : ndarray, shape (samples, m)
        Derivative of the prediction by each coefficient.
    R : ndarray, shape (m, m)
        Of its QR decomposition.
    residual : ndarray, shape (samples,)
        Residual of the fit, um.
    prior : Prior
        Of the coefficients.
    weight : float
        Variance, um^2, that the prior's precision was multiplied with.
    """
    pull = prior.rows(weight)[:, :-1]
    triangle = normal.reduced(np.vstack([R, pull]))  # U of A = U'U: the columns of J U^-1 are alike, whatever the bias
    of_record = colored(normal.triangular(triangle, J.T, transposed=True).T, residual)
    of_prior = normal.triangular(triangle, pull.T, transposed=True)
    values, vectors = np.linalg.eigh(of_record + weight * of_prior @ of_prior.T)
    return normal.triangular(triangle, vectors * np.sqrt(np.maximum(values, 0.0)))


def colored(J: FloatArray, residual: FloatArray) -> FloatArray:
    """J' Omega J for columns J, corrected for the degrees of freedom that the fit took."""
    samples, m = J.shape
    frequencies = np.fft.rfftfreq(samples)
    twice = np.where((frequencies > 0) & (frequencies < 0.5), 2.0, 1.0)  # for the negative frequencies
    share = _spectrum(residual, frequencies) * twice / max(samples - m, 1)
    F = np.fft.rfft(np.ascontiguousarray(J.T))
    F *= np.sqrt(share)
    both = F.view(np.float64)  # real and imaginary parts in turn
    return np.asarray(both @ both.T)


def _spectrum(residual: FloatArray, frequencies: npt.NDArray[np.floating[Any]]) -> FloatArray:
    """Two-sided density at the frequencies, per sample, by Welch's method."""
    from scipy.signal import welch

    length = max(residual.size // SEGMENTS, min(residual.size, 16))
    f, S = welch(residual, nperseg=length, return_onesided=False, detrend=False)
    order = np.argsort(f)
    upper = order[f[order] >= 0]
    return np.asarray(np.interp(frequencies, f[upper], S[upper]))


def effective_samples(residual: FloatArray) -> float:
    """How many independent samples have the same uncertainty of the mean: n S(white) / S(0)."""
    from scipy.signal import welch

    _, S = welch(residual, nperseg=max(residual.size // SEGMENTS, min(residual.size, 16)), return_onesided=False)
    return float(residual.size * min(1.0, S.mean() / max(S[1:4].mean(), 1e-300)))


def white_variance(residual: FloatArray) -> float:
    """Variance, um^2, of white noise with the same uncertainty of the mean."""
    return float(np.var(residual)) * residual.size / effective_samples(residual)


def autocorrelation(residual: FloatArray) -> FloatArray:
    """Sum of e[k] e[k + lag] over sum of e[k]^2, for lags from 0, 1/4 of the samples at most, `LAGS` at most."""
    from scipy.signal import correlate

    lags = min(LAGS, residual.size // 4)
    sums = correlate(residual, residual, mode="full", method="fft")[residual.size - 1 :][: lags + 1]
    return np.asarray(sums / max(sums[0], 1e-300))
