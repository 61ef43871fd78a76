"""How the errors of a model compare with its deviation: on later blocks of the record than those it was fitted to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.actuator import ActuatorModel, central_difference
from truestroke.identification import normal
from truestroke.identification.regression import Data, Structure
from truestroke.identification.select import BLOCKS, FIRST

LEVEL = 0.95
LEAST = 1.0  # of the factor: a later part may miss by more than the blocks did
BINS = 12  # of the velocity
STILL = 0.25  # of the mean square error: the share that does not grow with the velocity, at least


@dataclass(frozen=True, eq=False)
class Ahead:
    """What fits to the first blocks miss of all later ones; arrays of shape (rows,).

    Attributes
    ----------
    error : ndarray
        Measured minus predicted, um.
    weights : ndarray
        Variance of the prediction by that of the weights, um^2.
    velocity : ndarray
        um/s.
    seconds : ndarray
        Since the end of the fitted blocks, s.
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
        """The quantile of |error| over the deviation that the model states, at least 1."""
        motion = self.weights + model.noise**2 + (model.jitter * self.velocity) ** 2
        variance = np.maximum(motion + model.walk**2 * self.seconds, 1e-300)
        return max(float(np.quantile(np.abs(self.error) / np.sqrt(variance), LEVEL)), LEAST)


def calibrated(model: ActuatorModel, data: Data, s: Structure, weight: float) -> ActuatorModel:
    """The model with the `jitter` and the `coverage_factor` with which its intervals hold 95 % of later blocks.

    The factor is 1.96 where the errors are as the model says, and normal; less where they are bounded, as of a motion
    that repeats, and more where a later part of the record goes beyond the earlier one.

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
    parts = list(_ahead(model, data, s, weight))
    ahead = Ahead(*(np.concatenate(entries) for entries in zip(*parts, strict=True)))
    model = model.replace(jitter=ahead.jitter(model))
    return model.replace(coverage_factor=ahead.factor(model))


def _ahead(
    model: ActuatorModel, data: Data, s: Structure, weight: float
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """The entries of `Ahead`, of the fit to all blocks before each but the first ones."""
    strain = model.strain(data.volts, data.sample_rate)
    rows, late = data.columns(s, strain), data.fitted(rested=False)
    rate = central_difference(strain, data.sample_rate)[:: data.every][late]
    before, rows = normal.reduced(rows[data.fitted(s.rested) & ~late]), rows[late]
    J = rows[:, : s.parameters]
    of_weights = np.einsum("ki,ij,kj->k", J, model.covariance, J)
    seconds = np.flatnonzero(late) * data.every / data.sample_rate
    pull, start = data.prior(s).rows(weight), 0
    for k, block in enumerate(np.array_split(rows, BLOCKS)):
        if k >= FIRST:
            error = rows[start:] @ np.append(normal.solve(np.vstack([before, pull])), -1.0)
            yield error, of_weights[start:] * BLOCKS / k, rate[start:], seconds[start:] - seconds[start - 1]
        before, start = normal.reduced(np.vstack([before, block])), start + len(block)
