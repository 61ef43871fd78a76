"""Hysteresis of an actuator while a motion repeats, as one pass shows it: from the voltage of a period to its strain.

Plays of the voltage x, and two powers of it in the place of an asymmetry of the loop, with c = 2 (x - middle) / span::

    strain = sum_i w_i H_ri[x] + span / 2 (w_2 c^2 + w_3 c^3)

w are estimated together with the few numbers in which the stage differs from its dynamics: at the frequency of the
motion alone, a dead time and the width of a loop look alike, at its harmonics they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.repeating.response_prior import FewNumbers
from truestroke.control.repeating.steps import Steps
from truestroke.model import prior

BoolArray = npt.NDArray[np.bool_]

PLAYS = 12
CURVED = 0.1  # standard deviation of the weights of the powers
UNMODELLED, POWER = 0.03, 1.5  # of the strain: hysteresis of another structure, / h^1.5 at harmonic h
CHANGE = 0.05  # of a change of the strain at any harmonic: the same of what two passes differ by
BESIDE = 0.5  # times the deviation of R at each harmonic by itself, much of which is hysteresis, and so in the plays
DIFFERENT = 1e-6  # of the span: by which voltages differ
ROUNDS = 5  # steps of Gauss and Newton
UNIT = np.array(prior.thresholds(PLAYS, 1.0))  # of the span
LARGEST = 1.0  # standard deviations of the few numbers: such a step at most
LEAST = 0.2  # of the sum of the plays' weights: the least slope of the strain
ROUNDS_BACK = 60  # of the inverse, at most
EXACT = 1e-9  # of the span: error of the inverse
SURE = 1e-6  # standard deviation of what is not estimated twice
SAMPLES, HARMONICS = 4096, 192  # of arrays that are worked on in one step


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

    def strain(self, volts: FloatArray) -> Steps[FloatArray]:
        """Of a period of voltages that has repeated, as that voltage which would make it without hysteresis, V."""
        terms = yield from _terms(volts, self.thresholds, self.middle, self.span)
        return np.asarray(self.weights @ terms)

    def volts(self, strain: FloatArray, near: FloatArray, moved: BoolArray) -> Steps[FloatArray]:
        """The voltages that make this strain, V, from voltages near to them, by the harmonics that may be moved.

        The slope of the strain is positive, so that each round leaves less of the error.
        """
        x, pace = near, 1 / (1 + _steepest(self.weights))
        for _ in range(ROUNDS_BACK):
            made = yield from self.strain(x)
            yield
            missing = np.where(moved, np.fft.rfft(strain - made), 0.0)
            left = np.fft.irfft(missing, x.size)
            if np.abs(left).max() < EXACT * self.span:
                break
            x = x + pace * left
            yield
        return x


def identified(
    volts: FloatArray,
    measured: ComplexArray,
    response: ComplexArray,
    noise2: FloatArray,
    *,
    few: FewNumbers,
    learned: BoolArray,
    periods: int,
    others: Sequence[tuple[FloatArray, ComplexArray, FloatArray]] = (),
) -> Steps[PeriodicHysteresis]:
    """The model from a pass, by least squares with what is expected of actuators (`model.prior`).

    Parameters
    ----------
    volts : ndarray, shape (samples,)
        One repetition, V.
    measured, response, noise2 : ndarray, shape (samples // 2 + 1,)
        Z, um, G, um/V, and the variance of Z, as of `harmonics`.
    few : FewNumbers
        In what the stage may differ from G.
    learned : ndarray of bool
        Harmonics that count.
    periods : int
        Of the motion, in a repetition.
    others : sequence of (ndarray, ndarray, ndarray)
        Voltage, Z and its variance of earlier passes: what a change of the voltage has changed counts, too.
    """
    span, middle = float(np.ptp(volts)), float(volts.max() + volts.min()) / 2
    r = span * UNIT
    counts = np.flatnonzero(learned[1:]) + 1
    about = r, middle, span
    P = yield from _spectra(volts, response, counts, about)
    relative = np.abs(response[counts] / response[0])
    unmodelled = (UNMODELLED / (1.0 + counts / periods) ** POWER * relative) ** 2
    shown = [_Shown(P, measured[counts], noise2[counts], unmodelled)]
    for x, Z, noise in others:
        if np.abs(x - volts).max() > DIFFERENT * span:
            Q = yield from _spectra(x, response, counts, about)
            shown.append(_Shown(Q - P, (Z - measured)[counts], (noise + noise2)[counts], (CHANGE * relative) ** 2))
    expected, covariance = _expected(r, span)
    yield
    n = expected.size
    mean = np.append(expected, np.zeros(few.deviations.size))
    deviations = np.append(SURE, few.deviations[1:])  # a gain is in the weights, too
    known = np.zeros((mean.size, mean.size))
    known[:n, :n], known[n:, n:] = np.linalg.inv(covariance), np.diag(deviations**-2.0)
    own = BESIDE**2 * few.variance[counts]
    found = mean
    for _ in range(ROUNDS):
        yield
        R, slopes = yield from few.ratio(found[n:])
        information, right = known.copy(), known @ (mean - found)
        for one in shown:
            yield from one.add(information, right, found[:n], R[counts], slopes[:, counts], own, relative)
        step = np.linalg.solve(information, right)
        largest = float(np.abs(step[n:] / deviations).max())
        found = found + step * min(1.0, LARGEST / max(largest, 1e-300))
    return PeriodicHysteresis(r, _rising(found[:n]), middle, span)


@dataclass(frozen=True, eq=False)
class _Shown:
    """What a pass shows, or by what two differ: spectra of the terms through G, um, and Z, with its variances."""

    terms: ComplexArray
    measured: ComplexArray
    noise2: FloatArray
    unmodelled: FloatArray  # of the power of the strain

    def add(
        self,
        information: FloatArray,
        right: FloatArray,
        weights: FloatArray,
        R: ComplexArray,
        slopes: ComplexArray,
        own: FloatArray,
        relative: FloatArray,
    ) -> Steps[None]:
        """To the normal equations of a step from these weights and numbers; `own` is the variance of R beside them."""
        yield
        plain = weights @ self.terms
        predicted = R * plain
        swing = np.sum(np.abs(plain / relative) ** 2)
        variance = self.noise2 + own * np.abs(predicted) ** 2 + self.unmodelled * swing
        for begin in range(0, R.size, HARMONICS):
            yield
            some = slice(begin, begin + HARMONICS)
            A = np.concatenate([R[some] * self.terms[:, some], slopes[:, some] * plain[some]])
            weighted = A.conj() / variance[some]
            information += (weighted @ A.T).real
            right += (weighted @ (self.measured - predicted)[some]).real
        yield


def _spectra(
    volts: FloatArray, response: ComplexArray, counts: npt.NDArray[np.intp], about: tuple[FloatArray, float, float]
) -> Steps[ComplexArray]:
    """Of the terms, through the response, at the harmonics that count, um."""
    terms = yield from _terms(volts, *about)
    made = np.empty((len(terms), counts.size), dtype=np.complex128)
    for row, term in zip(made, terms, strict=True):
        row[:] = (response * np.fft.rfft(term))[counts]
        yield
    return made


def plays(x: FloatArray, r: FloatArray) -> Steps[FloatArray]:
    """States of plays over a period of x, V, that has repeated; shape (thresholds, samples).

    A sample clamps the state between x - r and x + r, and clamps one after the other are a clamp: those of 1, 2, 4 ...
    samples are joined, until they are those of a period. A play that never moves is in the middle of its slack.

    Examples
    --------
    >>> from truestroke.control.repeating.steps import finished
    >>> finished(plays(np.array([0.0, 1.0, 2.0, 1.0]), np.array([0.0, 0.5])))
    array([[0. , 1. , 2. , 1. ],
           [0.5, 0.5, 1.5, 1.5]])
    """
    states, rows = np.empty((r.size, x.size)), max(1, SAMPLES // x.size)
    for begin in range(0, r.size, rows):
        some = slice(begin, begin + rows)
        low, high = x - r[some, None], x + r[some, None]
        many = 1
        while many < x.size:
            first_low, first_high = np.roll(low, many, axis=1), np.roll(high, many, axis=1)
            low, high = np.clip(first_low, low, high), np.clip(first_high, low, high)
            many *= 2
            yield
        states[some] = (low + high) / 2
    return states


def _terms(volts: FloatArray, r: FloatArray, middle: float, span: float) -> Steps[FloatArray]:
    """What the weights multiply, V; beyond the span the powers go on straight."""
    c = 2 * (volts - middle) / span
    within = np.clip(c, -1.0, 1.0)
    beyond = c - within
    yield
    powers = span / 2 * np.array([within**2 + 2 * within * beyond, within**3 + 3 * beyond])
    yield
    states = yield from plays(volts, r)
    return np.concatenate([states, powers])


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
    if not a.any():  # the displacement goes against the voltage
        return np.append([1.0, *a[1:]], [0.0, 0.0])
    a[0] = max(a[0], 2 * LEAST * a.sum())
    curved = weights[-2:] / a.sum()
    a = a / a.sum()
    most = a[0] - LEAST
    steepest = _steepest(curved)
    return np.append(a, curved * min(1.0, most / max(steepest, 1e-300)))
