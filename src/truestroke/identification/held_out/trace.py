"""A record beside what a model predicts of it, and the errors in its last part."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.records import resting
from truestroke.identification.records.series import Series


@dataclass(frozen=True)
class HeldOut:
    """Errors of a model that predicts, from voltage alone, the last part of a record, unused for any choice.

    Attributes
    ----------
    rmse_um, maximum_um : float
        Root mean square and largest magnitude of the error, um.
    rmse_percent, maximum_percent : float
        The same in % of the peak-to-peak displacement of the record.
    samples : int
        Length of that part.
    coverage : float
        Share of them within the 95 % interval (`Trace.half_width`), 0 to 1.
    zero_um : float
        By how much the zero behind a long gap is above that before it, um; it is taken off the errors.
    """

    rmse_um: float
    maximum_um: float
    rmse_percent: float
    maximum_percent: float
    samples: int
    coverage: float
    zero_um: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Series):
    """The record as it was fitted beside what the model that was fitted to its first part predicts.

    Attributes
    ----------
    predicted : ndarray, shape (samples,)
        Displacement predicted from the voltage alone, um.
    half_width : ndarray, shape (samples,)
        Of the 95 % interval about it, um, as `ActuatorModel.interval` has it; the drift is in `predicted`.
    held_out : ndarray of bool, shape (samples,)
        The last part, not used for that model; the errors of `HeldOut` are those of its samples that are `judged`.
    """

    predicted: FloatArray
    half_width: FloatArray
    held_out: npt.NDArray[np.bool_]

    @property
    def residual(self) -> FloatArray:
        """displacement - predicted, um, shape (samples,)."""
        return self.displacement - self.predicted

    @property
    def judged(self) -> npt.NDArray[np.bool_]:
        """Known samples of the held-out part, of long rests only where the error is larger, shape (samples,)."""
        return resting.judged(self.volts, self.residual, self.known & self.held_out)
