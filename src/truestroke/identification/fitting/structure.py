"""The weights of a given structure: least squares that are pulled to the prior."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.control.actuator import ActuatorModel
from truestroke.control.interval import InnerLoops
from truestroke.identification.fitting import normal, uncertainty
from truestroke.identification.fitting.regression import Data, Structure
from truestroke.model.sampled import central_difference

STEPS = 2  # Gauss-Newton
STILL = 0.15  # of the residual's rms: a fit to compare ends with a step that changes less; another has a tenth of it


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model, its residual in the fitted rows of the record, um, and the drift of the record's zero."""

    model: ActuatorModel
    structure: Structure
    weight: float  # um^2, of the prior
    residual: FloatArray
    rows: npt.NDArray[np.intp]  # of the record, to which the residual belongs
    drift: Callable[[int], FloatArray]  # um, of so many samples of the record
    strain: FloatArray  # um, what the model gives before dead time, lag and stage, at the full rate
    c: FloatArray  # of `Structure.coefficients`
    inner_loops: InnerLoops | None = None  # as later blocks of the record show them
    columns: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # of these rows, where it is certain
    pull: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # rows of the prior on the coefficients

    def before(self, data: Data) -> FloatArray:
        """What the model, with creep that was under way, gives before dead time, lag and stage of other rows, um."""
        same = data.volts.size == self.strain.size
        strain = self.strain if same else self.model.strain(data.volts, data.sample_rate)
        return strain + data.starts(self.structure, self.c[self.structure.parameters :])


def fit_structure(data: Data, s: Structure, weight: float, guess: FloatArray | Fit, certain: bool = True) -> Fit:
    """The model of structure `s`.

    Parameters
    ----------
    data : Data
        The record.
    s : Structure
        What the model consists of.
    weight : float
        Variance, um^2, with which the precision of the prior is multiplied.
    guess : ndarray, shape (samples,), or Fit
        A first prediction before dead time and lag, um above `Data.zero`: velocity and asymmetry follow it in the
        first step, then the model's own. Or a fit of the same structure to go on from, as behind other modes.
    certain : bool
        Whether the covariance is wanted. Where it is not, the fit is one to compare, and ends early (`STILL`).
    """
    prior, m = data.prior(s), s.parameters
    pull = prior.rows(weight)
    z, c = (guess.before(data), guess.c) if isinstance(guess, Fit) else (guess, np.zeros(0))
    for _ in range(STEPS + 1):
        last, linear = z, c.size > 0
        rows, velocity = _linearised(data, s, z, c)
        shown = normal.reduced(rows)
        c = normal.solve(pull, *data.constraints(s, velocity), above=shown)
        model = data.model(s, c, velocity)
        strain = model.strain(data.volts, data.sample_rate)
        z = strain + data.starts(s, c[m:])
        left = abs(float(shown[-1, -1])) / np.sqrt(len(rows))
        if linear and not certain and np.std(z - last) < STILL * left:
            break
    residual = data.displacement - (data.through(z) + data.drift(s, c[m:], z.size))[:: data.every]
    fitted = data.fitted(s.rested)
    residual = residual[fitted]
    J, R = rows[:, :-1], shown[:-1, :-1]
    P = _of_model(uncertainty.covariance_root(J, R, residual, prior, weight), s) if certain else np.zeros((m, m))
    times = {"delay": data.delay, "time_constant": data.time_constant}
    model = model.replace(covariance=P, noise=float(np.sqrt(np.mean(residual**2))), **times)
    of_record = np.flatnonzero(fitted) * data.every
    fit = Fit(model, s, weight, residual, of_record, partial(data.drift, s, c[m:]), strain, c)
    return replace(fit, columns=J, pull=pull[:, :-1]) if certain else fit


def _of_model(F: FloatArray, s: Structure) -> FloatArray:
    """Covariance of the weights, whatever starts and drift are; of a model with branches, with these as they are.

    Plays and branches follow each other closely: each by itself is hardly known, and their sum well. F F' is the
    covariance of all coefficients.
    """
    known, further = F[: s.parameters], F[F.shape[0] - len(s.further) :]
    if s.further:
        Q, _ = np.linalg.qr(further.T)
        known = known - (known @ Q) @ Q.T
    return np.asarray(known @ known.T)


def _linearised(data: Data, s: Structure, z: FloatArray, c: FloatArray) -> tuple[FloatArray, float]:
    """Rows [J | t] so that J c = t has the next coefficients, from the last ones and their prediction; velocity, um/s.

    The columns over the slope are the derivative of the prediction.
    """
    kept = normal.as_slice(data.fitted(s.rested))
    rows = data.columns(s, z)[kept]
    rate = central_difference(z, data.sample_rate)[:: data.every][kept]
    velocity = float(np.abs(rate).max())  # of the strain: dead time and lag are behind it
    if not c.size:
        return rows, velocity
    predicted = data.through(z)[:: data.every][kept]
    drift = data.drift(s, c[s.parameters :], z.size)[:: data.every][kept]
    measured = rows[:, -1].copy()
    rows /= data.slope(s, predicted, c)[:, None]
    rows[:, -1] = measured - predicted - drift + rows[:, :-1] @ c
    return rows, velocity
