"""An identified actuator as a regressor of scikit-learn: voltage to displacement (extra `sklearn`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from truestroke.base.typing import FloatArray
from truestroke.identification.identified import identify
from truestroke.identification.records.record import Record


class ActuatorRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """`truestroke.identify` with `fit`, `predict` and `score`, for pipelines, cross-validation and grid search.

    The rows are samples in time, one after the other; split them in that order, by ``TimeSeriesSplit``.

    Parameters
    ----------
    sample_rate : float
        Samples per second, Hz.
    continued : bool
        Whether the rows of `predict` follow those of `fit` in time, as the folds of ``TimeSeriesSplit`` do, so that the
        plays remember these; else the actuator rests at the first voltage before.
    rate : bool, optional
        Whether the weights depend on the rate; left out, as all that follow, cross-validation chooses.
    creep_times : sequence of float, optional
        Time constants of the creep states, s; () is no creep.
    asymmetry : int, optional
        Terms of asymmetry, 0 to 2.
    thresholds : sequence of float, optional
        r of the plays, V, ascending from 0.
    delay : float, optional
        Between voltage and displacement, s.

    Attributes
    ----------
    model_ : ActuatorModel
        What `fit` found; a controller starts from it by `AdaptiveController.from_model`.
    volts_ : ndarray, shape (samples,)
        The voltage of `fit`, V.
    n_features_in_ : int
        1: the voltage.

    Examples
    --------
    >>> t = np.arange(2000) / 1000.0
    >>> volts = 1.5 - 1.5 * np.cos(2 * np.pi * t) * np.cos(0.8 * t)
    >>> stage = ActuatorRegressor(rate=False, creep_times=(), asymmetry=0, delay=0.0)
    >>> stage.fit(volts[:, np.newaxis], 10.0 * volts).predict([[0.0], [1.0]]).round(1)
    array([ 0., 10.])
    >>> round(stage.score(volts[:, np.newaxis], 10.0 * volts), 4)
    1.0
    """

    def __init__(
        self,
        sample_rate: float = 1000.0,
        *,
        continued: bool = False,
        rate: bool | None = None,
        creep_times: Sequence[float] | None = None,
        asymmetry: int | None = None,
        thresholds: Sequence[float] | None = None,
        delay: float | None = None,
    ) -> None:
        self.sample_rate = sample_rate
        self.continued = continued
        self.rate = rate
        self.creep_times = creep_times
        self.asymmetry = asymmetry
        self.thresholds = thresholds
        self.delay = delay

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> ActuatorRegressor:
        """Identify the actuator.

        Parameters
        ----------
        X : array_like, shape (samples, 1)
            Voltage, V.
        y : array_like, shape (samples,)
            Displacement, um.

        Raises
        ------
        SettingError
            As `identify`.
        ValueError
            X has not one column, or holds no finite numbers.
        """
        rows, z = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        record = Record.from_arrays(self._volts(rows), z, sample_rate=self.sample_rate)
        choices = {n: value for n, value in self.get_params().items() if n not in ("sample_rate", "continued")}
        self.model_ = identify(record, drift=False, **choices).model  # which `predict` does not have
        self.volts_ = record.volts
        return self

    def predict(self, X: npt.ArrayLike) -> FloatArray:
        """Displacement that the voltage makes, um, shape (samples,).

        Parameters
        ----------
        X : array_like, shape (samples, 1)
            Voltage, V.
        """
        check_is_fitted(self)
        rows = validate_data(self, X, reset=False, dtype=np.float64)
        before = self.volts_ if self.continued else self.volts_[:0]
        volts = np.concatenate([before, self._volts(rows)])
        return self.model_.predict(volts, self.sample_rate)[before.size :]

    def _volts(self, X: FloatArray) -> FloatArray:
        if X.shape[1] != 1:
            raise ValueError(f"X has {X.shape[1]} features, but {type(self).__name__} takes one: the voltage")
        return np.ascontiguousarray(X[:, 0])
