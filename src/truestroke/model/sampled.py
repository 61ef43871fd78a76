"""What the terms of a model are made of, over all samples of a record: plays, creep, dead time and lag, velocity."""

from __future__ import annotations

import math

import numpy as np

from truestroke import _kernel
from truestroke.base.typing import FloatArray

REST = 0.5  # s under the first voltage, before a waveform is output
VELOCITY_SPAN = 0.1e-3  # s: half of the span of a central difference, at least one sample


def play_sum(
    x: FloatArray, rate: float | FloatArray, a: FloatArray, b: FloatArray, thresholds: tuple[float, ...]
) -> FloatArray:
    """(a + rate b).H_r[x] along x, natively; the plays come from rest at 0 V."""
    sums = np.empty_like(x)
    rates = np.ascontiguousarray(np.broadcast_to(rate, x.shape), dtype=np.float64)
    _kernel.play_sum(np.ascontiguousarray(x), rates, a, b, np.array(thresholds), np.zeros(len(thresholds)), sums)
    return sums


def creep_states(x: FloatArray, times: tuple[float, ...], sample_rate: float) -> list[FloatArray]:
    """First-order states of the voltage of the tick before, which rested at the first one, natively; V."""
    rows = np.empty((len(times), x.size))
    _kernel.creep_rows(np.ascontiguousarray(x), np.array(creep_shares(times, sample_rate)), rows)
    return list(rows)


def creep_to_come(first: float, times: tuple[float, ...], rest: float, since: FloatArray) -> FloatArray:
    """What creep states lack at times since the start, s, behind a rest, s, under the first voltage, from 0 V; V.

    Shape (k, samples). They follow the voltage from there on as after an endless rest, but for this.

    Examples
    --------
    >>> creep_to_come(2.0, (1.0,), 1.0, np.array([0.0, 1.0])).round(3), creep_to_come(2.0, (1.0,), np.inf, np.zeros(1))
    (array([[0.736, 0.271]]), array([[0.]]))
    """
    return np.asarray(first * np.exp(-(rest + since) / np.array(times)[:, np.newaxis]))


def creep_shares(times: tuple[float, ...], sample_rate: float) -> list[float]:
    """By which part of its distance to the voltage each creep state moves in a sample."""
    return [-math.expm1(-1 / (tau * sample_rate)) for tau in times]


def respond(y: FloatArray, delay: float, time_constant: float) -> FloatArray:
    """What a dead time and a first-order lag, both in samples, make of straight lines between samples of y.

    Before the first sample it was as the first. y of shape (samples,) or (samples, k).

    Examples
    --------
    >>> respond(np.array([0.0, 2.0, 2.0, 2.0]), 1.5, 0.0)
    array([0., 0., 1., 2.])
    >>> respond(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0]), 0.0, 0.2).round(3)  # a ramp is late by the time constant
    array([0.   , 0.801, 1.8  , 2.8  , 3.8  , 4.8  ])
    """
    if y.size == 0 or (delay == 0.0 and time_constant == 0.0):
        return y
    above = after_lag(y - y[:1], time_constant)
    whole = min(int(delay), len(y))
    part = delay - int(delay)
    late = np.concatenate([np.zeros((whole + 1, *y.shape[1:])), above])
    return np.asarray(y[:1] + (1 - part) * late[1 : len(y) + 1] + part * late[: len(y)])


def after_lag(y: FloatArray, time_constant: float) -> FloatArray:
    """y behind a first-order lag of `time_constant` samples, from rest at 0.

    Examples
    --------
    >>> after_lag(np.array([0.0, 1.0, 1.0, 1.0]), 1.0).round(3)
    array([0.   , 0.368, 0.767, 0.914])
    """
    if time_constant == 0.0 or not y.any():
        return y
    from scipy.signal import lfilter

    last, before, kept = lag_coefficients(time_constant)
    return np.asarray(lfilter([last, before], [1.0, -kept], y, axis=0))


def lag_coefficients(time_constant: float) -> tuple[float, float, float]:
    """b0, b1, p of z[k] = b0 y[k] + b1 y[k-1] + p z[k-1]: a lag of `time_constant` samples of lines between samples."""
    if time_constant == 0.0:
        return 1.0, 0.0, 0.0
    gone = -math.expm1(-1 / time_constant)
    return 1 - gone * time_constant, gone * (1 + time_constant) - 1, 1 - gone


def ahead(x: FloatArray, samples: int, last: FloatArray) -> FloatArray:
    """x some samples later; after its end it is `last`."""
    return np.concatenate([x[samples:], np.repeat(last, min(samples, x.size))])


def central_difference(z: FloatArray, sample_rate: float) -> FloatArray:
    """Velocity, um/s, over a span of 0.2 ms or of two samples."""
    half = velocity_span(sample_rate)
    moved = np.empty(z.shape)
    moved[half : z.size - half] = (z[2 * half :] - z[: max(z.size - 2 * half, 0)]) * sample_rate / (2 * half)
    k = np.append(np.arange(min(half, z.size)), np.arange(max(z.size - half, half), z.size))  # near the ends
    after, before = np.minimum(k + half, z.size - 1), np.maximum(k - half, 0)
    moved[k] = (z[after] - z[before]) * sample_rate / np.maximum(after - before, 1)
    return moved


def velocity_span(sample_rate: float) -> int:
    """Samples before and after one from which its velocity is taken."""
    return max(1, round(VELOCITY_SPAN * sample_rate))
