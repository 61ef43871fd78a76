"""The weights of a given structure: Gauss-Newton on the prediction error, constrained so that there is an inverse."""

from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.actuator import ActuatorModel
from truestroke.identification import normal, uncertainty
from truestroke.identification.regression import Data, Structure

STEPS = 2  # Gauss-Newton


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model, and its residual in the rows of `Data.fitted`, um."""

    model: ActuatorModel
    residual: FloatArray


def fit_structure(
    data: Data, s: Structure, weight: float, guess: FloatArray, delay: float, certain: bool = True
) -> Fit:
    """The model of structure `s`.

    Parameters
    ----------
    data : Data
        The record.
    s : Structure
        What the model consists of.
    weight : float
        Variance, um^2, with which the precision of the prior is multiplied.
    guess : ndarray, shape (samples,)
        A first prediction, um above `Data.zero`: velocity and asymmetry follow it in the first step, then the
        model's own.
    delay : float
        Which `data` has taken out of the voltage, s.
    certain : bool
        Whether the covariance is wanted.
    """
    prior, m = data.prior(s), s.parameters
    c, z = None, guess
    for _ in range(STEPS + 1):
        J, target, velocity = _linearised(data, s, z, c)
        pull = np.vstack([normal.reduced(np.column_stack([J, target])), prior.rows(weight)])
        c = normal.solve(pull, *data.constraints(s, velocity))
        model = data.model(s, c, velocity)
        z = model.predict(data.volts, data.sample_rate) - data.zero + data.starts(s, c[m:])
    residual = (data.displacement - z[:: data.every])[data.fitted(s.rested)]
    P = uncertainty.covariance(J, residual, prior, weight)[:m, :m] if certain else np.zeros((m, m))
    return Fit(model.replace(covariance=P, delay=delay, noise=float(np.sqrt(np.mean(residual**2)))), residual)


def _linearised(data: Data, s: Structure, z: FloatArray, c: FloatArray | None) -> tuple[FloatArray, FloatArray, float]:
    """J and t so that J c = t has the next coefficients, from the last ones and their prediction; velocity, um/s."""
    rows = data.columns(s, z)[data.fitted(s.rested)]
    C, measured = rows[:, :-1], rows[:, -1]
    velocity = float(np.abs(C[:, s.columns["lag"]]).max())
    if c is None:
        return C, measured, velocity
    predicted = z[:: data.every][data.fitted(s.rested)]
    J = data.derivative(s, C, predicted, c)
    return J, measured - predicted + J @ c, velocity
