"""The frequency response of a record without a model of the stage: a local polynomial at each line.

Around each line both response and transient are smooth: Y(k) = G(k) U(k) + T(k) + noise, with G and T polynomials of
the second order over a few lines. The residual gives the variance of the noise at the line, and so the coherence.
"""

from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import ComplexArray, FloatArray

ORDER = 2  # of the polynomials
REACH = 8  # lines on each side of the one that is estimated


@dataclass(frozen=True, eq=False)
class LocalResponse:
    """At each line.

    Attributes
    ----------
    response : ndarray of complex, shape (lines,)
        um/V.
    variance : ndarray, shape (lines,)
        Of the noise and distortion of the output, um^2: E |N|^2.
    coherence : ndarray, shape (lines,)
        |G U|^2 / (|G U|^2 + variance), 0 to 1, averaged over neighbouring lines.
    """

    response: ComplexArray
    variance: FloatArray
    coherence: FloatArray


def local_response(U: ComplexArray, Y: ComplexArray) -> LocalResponse:
    """Of input (V) and output (um) at consecutive lines, shape (lines,).

    References
    ----------
    Pintelon and Schoukens, System Identification, 2nd ed. 2012, Sec. 7.2: the local polynomial method.
    """
    count, width = U.size, 2 * REACH + 1
    start = np.clip(np.arange(count) - REACH, 0, count - width)
    index = start[:, None] + np.arange(width)
    offset = (index - np.arange(count)[:, None]) / REACH
    powers = offset[..., None] ** np.arange(ORDER + 1)
    regressors = np.concatenate([powers * U[index][..., None], powers.astype(np.complex128)], axis=-1)
    scale = np.sqrt(np.mean(np.abs(regressors) ** 2, axis=1, keepdims=True))
    q, r = np.linalg.qr(regressors / scale)
    projected = np.conj(np.swapaxes(q, -1, -2)) @ Y[index][..., None]
    weights = np.linalg.solve(r, projected)[..., 0] / scale[:, 0]
    rest = Y[index] - (q @ projected)[..., 0]
    variance = np.sum(np.abs(rest) ** 2, axis=1) / (width - 2 * (ORDER + 1))
    signal = smoothed(np.abs(weights[:, 0] * U) ** 2)
    noise = smoothed(variance)
    return LocalResponse(weights[:, 0], noise, signal / (signal + noise))


def smoothed(values: FloatArray, reach: int = 2 * REACH) -> FloatArray:
    """Median over so many lines on each side, which a narrow resonance does not raise.

    >>> smoothed(np.array([1.0, 1.0, 50.0, 1.0, 1.0]), 1)
    array([1., 1., 1., 1., 1.])
    """
    padded = np.pad(values, reach, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=-1))
