"""An identified model beside its record, in the numbers that page and pictures show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truestroke.base.typing import FloatArray
from truestroke.identification import ActuatorModel, Identified, Trace
from truestroke.identification.records.turning import reversals
from truestroke.model import prior as priors
from truestroke.model.layout import TERMS
from truestroke.model.sampled import central_difference

STROKES = 20  # of the voltage that a picture of loops can show
POINTS = 3000  # of a loop's line
FEWEST = 8  # samples of a bin
PRIOR_SHARE = 0.7  # of the prior's deviation: about a weight with more the record is hardly informative

Rows = NDArray[np.intp]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class View(Trace):
    """The samples that `identify` used, and their prediction by the model that was fitted to their first part.

    Attributes
    ----------
    model : ActuatorModel
        As found, fitted to all of them.
    error : ndarray, shape (samples,)
        Measured minus predicted displacement, um; NaN in gaps of the record.
    line_error : ndarray, shape (samples,)
        The same of a straight line through the fitted part.
    rate : ndarray, shape (samples,)
        Velocity of the prediction, um/s: that of the measurement is mostly noise.
    first : int
        The first sample that was held out.
    tested : ndarray of bool, shape (samples,)
        The held-out samples without those in gaps.
    """

    model: ActuatorModel
    error: FloatArray
    line_error: FloatArray
    rate: FloatArray
    first: int
    tested: NDArray[np.bool_]

    @classmethod
    def of(cls, found: Identified) -> View:
        """Of what `identify` has found."""
        trace = found.trace
        fitted = ~trace.held_out & trace.known
        line = np.polyfit(trace.volts[fitted], trace.displacement[fitted], 1)
        return cls(
            **vars(trace),
            model=found.model,
            error=np.where(trace.known, trace.residual, np.nan),
            line_error=np.where(trace.known, trace.displacement - np.polyval(line, trace.volts), np.nan),
            rate=central_difference(trace.predicted, found.model.metrics["record_sample_rate_hz"]),
            first=int(np.argmax(trace.held_out)),
            tested=trace.judged,
        )

    def loops(self) -> Rows:
        """Some held-out samples in their order: `STROKES` strokes of the voltage with the largest span, all turns."""
        x = self.volts[self.first :]
        turns = reversals(x, 0.05 * float(np.ptp(self.volts)))
        starts = range(max(1, turns.size - STROKES))
        best = max(starts, key=lambda k: float(np.ptp(x[turns[k : k + STROKES + 1]])))
        turns = turns[best : best + STROKES + 1]
        step = int(turns[-1] - turns[0]) // POINTS + 1
        return np.asarray(self.first + np.union1d(np.arange(turns[0], turns[-1] + 1, step), turns))

    def prior(self) -> tuple[FloatArray, FloatArray]:
        """What the fit was pulled to: mean and standard deviation of each weight, in their units."""
        m = self.model
        span = m.voltage_range[1] - m.voltage_range[0]
        a = priors.play_weights(m.thresholds, span, priors.FIRST_SLOPE * m.sensitivity)
        deviation = np.sqrt(np.diag(priors.covariance(m, a, q=m.sensitivity, stroke=m.stroke)))
        interval = 1 / m.metrics["record_sample_rate_hz"]
        deviation[m.columns["lag"]] = max(TERMS["lag"].deviation, interval)  # the clock of the record
        deviation[m.columns["offset"]] = m.stroke  # its sensor
        return m.vector(a), deviation

    def from_prior(self) -> NDArray[np.bool_]:
        """Which weights the record is hardly informative about: as uncertain as the prior."""
        return np.asarray(self.model.deviations > PRIOR_SHARE * self.prior()[1])


def binned(x: FloatArray, y: FloatArray, bins: int = 36) -> tuple[FloatArray, FloatArray]:
    """Means of x, shape (k,), and 0, 5, 50, 95, 100 % of y, shape (5, k), of even bins of x with enough samples.

    Examples
    --------
    >>> centres, spread = binned(np.arange(100.0), np.tile([-1.0, 0.0, 0.0, 0.0, 3.0], 20), bins=2)
    >>> centres, spread[:, 0]
    (array([24.5, 74.5]), array([-1., -1.,  0.,  3.,  3.]))
    """
    edges = np.linspace(x.min(), x.max(), bins + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    order = np.argsort(place, kind="stable")
    parts = np.split(order, np.searchsorted(place[order], np.arange(1, bins)))
    kept = [part for part in parts if part.size >= FEWEST]
    if not kept:
        return np.zeros(0), np.zeros((5, 0))
    return np.array([x[part].mean() for part in kept]), np.array(
        [np.percentile(y[part], [0, 5, 50, 95, 100]) for part in kept]
    ).T
