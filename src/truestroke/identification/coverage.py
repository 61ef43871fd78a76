"""How the errors of a model compare with its deviation: on blocks of the record to which it was fitted, or not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control import interval
from truestroke.control.actuator import ActuatorModel, central_difference
from truestroke.identification import normal
from truestroke.identification.regression import Data, Structure
from truestroke.identification.select import BLOCKS, FIRST

LEVEL = 0.95
LEAST = 0.5  # of the factor
BINS = 12  # of the velocity
STILL = 0.25  # of the mean square error: the share that does not grow with the velocity, at least


@dataclass(frozen=True, eq=False)
class Errors:
    """What fits to some blocks of a record miss of some of its rows; arrays of shape (rows,).

    Attributes
    ----------
    error : ndarray
        Measured minus predicted, um.
    weights : ndarray
        Variance of the prediction by that of the weights, um^2.
    velocity : ndarray
        um/s.
    seconds : ndarray
        In which the zero has walked, s.
    """

    error: FloatArray
    weights: FloatArray
    velocity: FloatArray
    seconds: FloatArray

    def jitter(self, model: ActuatorModel) -> float:
        """By how much the error grows with the velocity, s: of a late clock, a lag, a rate dependence that is missed.

        The mean squares e^2 of bins of the velocity are a + b v^2, and jitter^2 over noise^2 is b / a.
        """
        from scipy.optimize import nnls

        square = np.maximum(self.error**2 - model.walk**2 * self.seconds, 0.0)
        bins = np.array_split(np.argsort(np.abs(self.velocity), kind="stable"), BINS)
        speed, mean = np.array([[np.mean(self.velocity[rows] ** 2), square[rows].mean()] for rows in bins]).T
        if not mean.any() or not speed.any():
            return 0.0
        scale = speed.max(), mean.max()
        (still, grows), _ = nnls(np.column_stack([np.ones(BINS), speed / scale[0]]), mean / scale[1])
        still = max(float(still), STILL * float(mean.mean() / scale[1]))
        return model.noise * math.sqrt(float(grows) / scale[0] / still)

    def factor(self, model: ActuatorModel) -> float:
        """The k with which the interval holds 95 % of the errors; at least `LEAST`."""
        motion = self.weights + model.noise**2 + (model.jitter * self.velocity) ** 2
        of_zero = interval.OF_ZERO**2 * model.walk**2 * self.seconds
        square = float(np.quantile((self.error**2 - of_zero) / np.maximum(motion, 1e-300), LEVEL))
        return math.sqrt(max(square, LEAST**2))


def calibrated(model: ActuatorModel, data: Data, s: Structure, weight: float) -> ActuatorModel:
    """The model with its `jitter` and its `coverage_factor`.

    The factor is the geometric mean of three, with which the interval holds 95 % of three kinds of errors: of later
    blocks than those that were fitted, which is right where the record changes; of each block as the others predict
    it, which is right where later motion lies between what was seen; and of the fit itself, right where motion
    repeats. Any one of them alone is too wide or too narrow on most of the records of `benchmarks.coverage`. It is
    1.96 where the errors are as the model says, and normal, and less where they are bounded.

    Parameters
    ----------
    model : ActuatorModel
        With covariance, noise and walk.
    data : Data
        The record, as structures are compared on it.
    s : Structure
        Of the model.
    weight : float
        Variance, um^2, with which the precision of the prior is multiplied.
    """
    ahead, *others = _errors(model, data, s, weight)
    model = model.replace(jitter=ahead.jitter(model))
    factors = [errors.factor(model) for errors in (ahead, *others)]
    return model.replace(coverage_factor=math.exp(float(np.mean(np.log(factors)))))


def _errors(model: ActuatorModel, data: Data, s: Structure, weight: float) -> tuple[Errors, Errors, Errors]:
    """Of later blocks, of each block but the first between the others, and of the fit to all.

    All fits have an inverse, as the model has: what that costs is part of its error.
    """
    strain = model.strain(data.volts, data.sample_rate)
    rows, late = data.columns(s, strain), data.fitted(rested=False)
    rate = central_difference(strain, data.sample_rate)[:: data.every][late]
    start, rows = normal.reduced(rows[data.fitted(s.rested) & ~late]), rows[late]
    J = rows[:, : s.parameters]
    of_weights = np.sum(J @ model.covariance * J, axis=1)
    seconds = np.flatnonzero(late) * data.every / data.sample_rate
    pull, blocks = data.prior(s).rows(weight), np.array_split(np.arange(len(rows)), BLOCKS)
    inverse = data.constraints(s, model.velocity)
    parts = [normal.reduced(rows[block]) for block in blocks]

    def error(fitted: list[FloatArray], at: slice) -> FloatArray:
        return np.asarray(rows[at] @ np.append(normal.solve(np.vstack([start, *fitted, pull]), *inverse), -1.0))

    def later() -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        for k in range(FIRST, BLOCKS):
            at = slice(int(blocks[k][0]), len(rows))
            yield error(parts[:k], at), of_weights[at] * BLOCKS / k, rate[at], seconds[at] - seconds[at.start - 1]

    ahead = Errors(*(np.concatenate(entries) for entries in zip(*later(), strict=True)))
    walked = np.full(len(rows), ahead.seconds.mean())  # as long as to the later blocks, on average
    second = int(blocks[1][0])
    between = [
        error(parts[:k] + parts[k + 1 :], slice(int(block[0]), int(block[-1]) + 1))
        for k, block in enumerate(blocks[1:], 1)
    ]
    left_out = Errors(np.concatenate(between), of_weights[second:], rate[second:], walked[second:])
    return ahead, left_out, Errors(error(parts, slice(0, len(rows))), of_weights, rate, walked)
