"""Hysteresis of an actuator while a motion repeats, as one pass shows it: from the voltage of a period to its strain.

Plays of the voltage x, and two powers of it in the place of an asymmetry of the loop, with c = 2 (x - middle) / span::

    strain = sum_i w_i H_ri[x] + span / 2 (w_2 c^2 + w_3 c^3)

w are estimated together with the few numbers in which the stage differs from its dynamics: at the frequency of the
motion alone, a dead time and the width of a loop look alike, at its harmonics they do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.response_prior import FewNumbers
from truestroke.model import prior

BoolArray = npt.NDArray[np.bool_]

PLAYS = 12
CURVED = 0.1  # standard deviation of the weights of the powers
UNMODELLED, POWER = 0.03, 1.5  # of the strain: hysteresis of another structure, / h^1.5 at harmonic h
BESIDE = 0.5  # times the deviation of R at each harmonic by itself, much of which is hysteresis, and so in the plays
ROUNDS = 5  # steps of Gauss and Newton
LARGEST = 1.0  # standard deviations of the few numbers: such a step at most
LEAST = 0.2  # of the sum of the plays' weights: the least slope of the strain
STEPS = 60  # of the inverse, at most
EXACT = 1e-9  # of the span: error of the inverse
SURE = 1e-6  # standard deviation of what is not estimated twice


@dataclass(frozen=True, eq=False)
class PeriodicHysteresis:
    """The model for one motion.

    Attributes
    ----------
    thresholds : ndarray, shape (n,)
        r of the plays, V, ascending from 0.
    weights : ndarray, shape (n + 2,)
        Of the plays, with a sum of 1, and of the square and the cube.
    middle, span : float
        Of the voltage of the pass that has shown it, V.
    """

    thresholds: FloatArray
    weights: FloatArray
    middle: float
    span: float

    def strain(self, volts: FloatArray) -> FloatArray:
        """Of a period of voltages that has repeated, as that voltage which would make it without hysteresis, V."""
        return np.asarray(self.weights @ _terms(volts, self.thresholds, self.middle, self.span))

    def volts(self, strain: FloatArray, near: FloatArray, moved: BoolArray) -> FloatArray:
        """The voltages that make this strain, V, from voltages near to them, by the harmonics that may be moved.

        The slope of the strain is positive, so that each step leaves less of the error.
        """
        x = near
        for _ in range(STEPS):
            x, done = self.nearer(strain, x, moved)
            if done:
                break
        return x

    def nearer(self, strain: FloatArray, x: FloatArray, moved: BoolArray) -> tuple[FloatArray, bool]:
        """Voltages a step nearer, V; whether those before were near enough, and are kept."""
        left = np.fft.irfft(np.where(moved, np.fft.rfft(strain - self.strain(x)), 0.0), x.size)
        if np.abs(left).max() < EXACT * self.span:
            return x, True
        return x + 1 / (1 + _steepest(self.weights)) * left, False


def identified(
    volts: FloatArray,
    measured: ComplexArray,
    response: ComplexArray,
    noise2: FloatArray,
    *,
    few: FewNumbers,
    learned: BoolArray,
    periods: int,
) -> PeriodicHysteresis:
    """The model from a pass, by least squares with what is expected of actuators (`model.prior`).

    Parameters
    ----------
    volts : ndarray, shape (samples,)
        One repetition, V.
    measured, response, noise2 : ndarray, shape (samples // 2 + 1,)
        Z, um, G, um/V, and the variance of Z, as of `control.harmonics`.
    few : FewNumbers
        In what the stage may differ from G.
    learned : ndarray of bool
        Harmonics that count.
    periods : int
        Of the motion, in a repetition.
    """
    span, middle = float(np.ptp(volts)), float(volts.max() + volts.min()) / 2
    r = np.array(prior.thresholds(PLAYS, span))
    P = response * np.fft.rfft(_terms(volts, r, middle, span), axis=1)
    expected, covariance = _expected(r, span)
    n = expected.size
    mean = np.append(expected, np.zeros(few.deviations.size))
    deviations = np.append(SURE, few.deviations[1:])  # a gain is in the weights, too
    information = np.zeros((mean.size, mean.size))
    information[:n, :n], information[n:, n:] = np.linalg.inv(covariance), np.diag(deviations**-2.0)
    counts = learned & (np.arange(learned.size) > 0)
    h = 1.0 + np.arange(learned.size) / periods
    other = (UNMODELLED / h**POWER * np.abs(response / response[0])) ** 2
    found = mean
    for _ in range(ROUNDS):
        R, slopes = few.ratio(found[n:])
        plain = found[:n] @ P
        predicted = R * plain
        swing = np.sum(np.abs(plain * response[0] / np.where(counts, response, np.inf)) ** 2)
        variance = noise2 + BESIDE**2 * few.variance * np.abs(predicted) ** 2 + other * swing
        A = np.concatenate([R * P, slopes * plain])[:, counts]
        weighted = A.conj() / variance[counts]
        right = (weighted @ (measured - predicted)[counts]).real - information @ (found - mean)
        step = np.linalg.solve((weighted @ A.T).real + information, right)
        largest = float(np.abs(step[n:] / deviations).max())
        found = found + step * min(1.0, LARGEST / max(largest, 1e-300))
    return PeriodicHysteresis(r, _rising(found[:n]), middle, span)


def plays(x: FloatArray, r: FloatArray) -> FloatArray:
    """States of plays over a period of x, V, that has repeated; shape (thresholds, samples).

    A sample clamps the state between x - r and x + r, and clamps one after the other are a clamp: those of 1, 2, 4 ...
    samples are joined, until they are those of a period. A play that never moves is in the middle of its slack.

    Examples
    --------
    >>> plays(np.array([0.0, 1.0, 2.0, 1.0]), np.array([0.0, 0.5]))
    array([[0. , 1. , 2. , 1. ],
           [0.5, 0.5, 1.5, 1.5]])
    """
    low, high = x - r[:, None], x + r[:, None]
    many = 1
    while many < x.size:
        first_low, first_high = np.roll(low, many, axis=1), np.roll(high, many, axis=1)
        low, high = np.clip(first_low, low, high), np.clip(first_high, low, high)
        many *= 2
    return np.asarray((low + high) / 2)


def _terms(volts: FloatArray, r: FloatArray, middle: float, span: float) -> FloatArray:
    """What the weights multiply, V; beyond the span the powers go on straight."""
    c = 2 * (volts - middle) / span
    within = np.clip(c, -1.0, 1.0)
    beyond = c - within
    return np.concatenate(
        [plays(volts, r), span / 2 * np.array([within**2 + 2 * within * beyond, within**3 + 3 * beyond])]
    )


def _expected(r: FloatArray, span: float) -> tuple[FloatArray, FloatArray]:
    """Weights before the pass, and their covariance."""
    a = prior.play_weights(r.tolist(), span, 1.0)
    a = a / a.sum()
    hysteresis = np.append(0.0, a[1:])
    own = prior.WEIGHT_DEVIATION[0] * a + prior.WEIGHT_DEVIATION[1]
    own[0] = prior.FIRST_DEVIATION
    covariance = np.diag(np.append(own, [CURVED, CURVED]) ** 2)
    covariance[:-2, :-2] += prior.GAIN_DEVIATION**2 * np.outer(a, a)
    covariance[:-2, :-2] += prior.HYSTERESIS_DEVIATION**2 * np.outer(hysteresis, hysteresis)
    return np.append(a, [0.0, 0.0]), covariance


def _steepest(weights: FloatArray) -> float:
    """By how much the powers change the slope of the strain, at most."""
    return 2 * abs(float(weights[-2])) + 3 * abs(float(weights[-1]))


def _rising(weights: FloatArray) -> FloatArray:
    """The same with a sum of 1 of the plays, and such that the strain rises with the voltage everywhere."""
    a = np.maximum(weights[:-2], 0.0)
    a[0] = max(a[0], 2 * LEAST * a.sum())
    curved = weights[-2:] / a.sum()
    a = a / a.sum()
    most = a[0] - LEAST
    steepest = _steepest(curved)
    return np.append(a, curved * min(1.0, most / max(steepest, 1e-300)))
