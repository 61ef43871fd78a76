"""How the errors of a model compare with its deviation: on blocks of the record to which it was fitted, or not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control import interval
from truestroke.control.actuator import ActuatorModel
from truestroke.control.explored import Explored, places, spread
from truestroke.control.interval import InnerLoops
from truestroke.identification.fitting import normal
from truestroke.identification.fitting.regression import Data, Structure
from truestroke.identification.fitting.select import BLOCKS, FIRST
from truestroke.model.sampled import central_difference

LEVEL = 0.95
LEAST = 0.3  # of the factor
ROUNDING = 1e-8  # of the stroke: a smaller deviation is none, of a record without noise that the model has exactly
BINS = 12  # of the velocity
STILL = 0.25  # of the mean square error: the share that does not grow with the velocity, at least
GROWTH = 0.16  # of the stroke: the deviation of the error a unit of distance, where the record does not show it
WIDEST = 2.0  # how far, as a logarithm, that of a record may be from it before the square root


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
    distance : ndarray
        From what was fitted, as `Explored.distance` has it.
    volts : ndarray
        V.
    """

    error: FloatArray
    weights: FloatArray
    velocity: FloatArray
    seconds: FloatArray
    distance: FloatArray
    volts: FloatArray

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

    def growth(self, model: ActuatorModel) -> float:
        """The deviation of the error a unit of distance, um.

        What these errors have beyond noise, weights, velocity and walk, over their distance, is known to a factor of
        two at best: the geometric mean of it and of `GROWTH` of the stroke. It is no more than all of the error. That
        they have nothing beyond is no evidence where later motion is as near as that of a sine: there the usual
        growth would be lost in the error, and it stays.
        """
        usual, away = GROWTH * model.stroke, float(np.mean(self.distance**2))
        if not away:
            return usual
        all_of_it = float(np.mean(self.error**2))
        more = all_of_it - float(np.mean(self._motion(model) + model.walk**2 * self.seconds))
        seen = math.log(max(math.sqrt(max(more, 0.0) / away) / usual, 1e-300))
        exponent = 0.5 * float(np.clip(seen, -WIDEST, WIDEST))
        if exponent < 0:
            exponent *= usual**2 * away / (usual**2 * away + all_of_it)
        return min(usual * math.exp(exponent), math.sqrt(all_of_it / away))

    def inner_loops(self, model: ActuatorModel) -> InnerLoops:
        """What is missed inside of the loops that were fitted: least squares of its square."""
        inside = interval.inside_of(model, self.volts, self.distance) ** 2
        square = float(inside @ inside)
        inner = math.sqrt(float(self.error**2 @ inside) / square) if square else math.inf
        return InnerLoops(inner, float(np.minimum(self.distance / interval.INSIDE, 1.0).mean()))

    def factor(self, model: ActuatorModel) -> float:
        """The k with which the interval holds 95 % of the errors; at least `LEAST`."""
        growth = 0.0 if model.explored is None else model.explored.growth
        motion = self._motion(model) + (growth * self.distance) ** 2
        of_zero = interval.OF_ZERO**2 * model.walk**2 * self.seconds
        least = (ROUNDING * model.stroke) ** 2
        square = float(np.quantile((self.error**2 - of_zero) / np.maximum(motion, least), LEVEL))
        return math.sqrt(max(square, LEAST**2))

    def _motion(self, model: ActuatorModel) -> FloatArray:
        return np.asarray(self.weights + model.noise**2 + (model.jitter * self.velocity) ** 2)


def calibrated(
    model: ActuatorModel, data: Data, s: Structure, weight: float, strain: FloatArray
) -> tuple[ActuatorModel, InnerLoops]:
    """The model with `usual_velocity`, `jitter`, `explored` and `coverage_factor`; and what blocks show of inner loops.

    The factor is the geometric mean of two, with which the interval holds 95 % of two kinds of errors: of later blocks
    than those that were fitted, which is right where the record changes; and of the fit itself, right where motion
    repeats. Either of them alone is too wide or too narrow on most of the records of `benchmarks.coverage`. It is
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
    strain : ndarray, shape (samples,)
        Of the model, um.
    """
    ahead, fit, been = _errors(model, data, s, weight, strain)
    usual = interval.shown_velocity(central_difference(strain, data.sample_rate)[data.begun :])
    model = model.replace(jitter=ahead.jitter(model), usual_velocity=min(usual, model.velocity))
    model = model.replace(explored=Explored(been, ahead.growth(model)))
    factor = math.sqrt(ahead.factor(model) * fit.factor(model))
    return model.replace(coverage_factor=factor), ahead.inner_loops(model)


def _errors(
    model: ActuatorModel, data: Data, s: Structure, weight: float, strain: FloatArray
) -> tuple[Errors, Errors, FloatArray]:
    """Of all later blocks, by the fits to the first ones; of the fit to all; and the places of all that was fitted.

    All fits have an inverse, as the model has: what that costs is part of its error.
    """
    rows, late = data.columns(s, strain), data.fitted(rested=False)
    v = central_difference(strain, data.sample_rate)
    at = places(data.volts, v, data.voltage_range, model.velocity, data.every)[late]
    start, rows = normal.reduced(rows[data.fitted(s.rested) & ~late]), rows[late]
    J = rows[:, : s.parameters]
    of_weights = np.sum(J @ model.covariance * J, axis=1)
    x = data.volts[:: data.every][late]
    seconds, rate = np.flatnonzero(late) * data.every / data.sample_rate, v[:: data.every][late]
    pull, blocks = data.prior(s).rows(weight), np.array_split(np.arange(len(rows)), BLOCKS)
    inverse = data.constraints(s, model.velocity)
    parts = [normal.reduced(rows[block]) for block in blocks]

    def error(fitted: list[FloatArray], at: slice) -> FloatArray:
        return np.asarray(rows[at] @ np.append(normal.solve(np.vstack([start, *fitted, pull]), *inverse), -1.0))

    def later() -> Iterator[Errors]:
        for k in range(FIRST, BLOCKS):
            first = int(blocks[k][0])
            rest = slice(first, len(rows))
            away = Explored(spread(at[:first]), 0.0).distance(at[rest])
            since = seconds[rest] - seconds[first - 1]
            yield Errors(error(parts[:k], rest), of_weights[rest] * BLOCKS / k, rate[rest], since, away, x[rest])

    each, been = [vars(part) for part in later()], spread(at)
    ahead = Errors(**{name: np.concatenate([part[name] for part in each]) for name in each[0]})
    walked = np.full(len(rows), ahead.seconds.mean())  # as long as to the later blocks, on average
    away = Explored(been, 0.0).distance(at)
    return ahead, Errors(error(parts, slice(0, len(rows))), of_weights, rate, walked, away, x), been
