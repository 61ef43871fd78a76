"""The controller's settings: one frozen object, a unit on every member."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from truestroke import _check
from truestroke._check import SettingError

MAX_PLAYS = 32
MAX_DEAD_ZONES = 8


@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """What a controller is told about the actuator and about how to learn.

    Only the first three are needed; the rest follows from them. Entries that are given as None are filled in, so that
    a settings object always holds the numbers that are used.

    Attributes
    ----------
    sample_rate : float
        Ticks per second, Hz.
    stroke : float
        Length of the travel that is asked for, um.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage that may leave the controller, V at the D/A converter.
    plays : int
        Number of play operators, 1 to 32.
    thresholds : tuple[float, ...]
        Thresholds r of the plays, V, ascending from 0; by default i / plays of half the highest voltage (Sec. 2.1).
    dead_zone_thresholds : tuple[float, ...]
        Thresholds d' of the inverse dead zones, um, ascending from 0.
    dead_zone_weights : tuple[float, ...]
        Weights w_s' of the inverse dead zones, without unit; (1,) is a symmetric actuator.
    initial_sensitivity : float
        First entry of w(0), um/V; all others are 0. By default stroke / (highest - lowest voltage).
    initial_weights : tuple[float, ...]
        w(0) = [a0, b0, a1, b1, ...], um/V, in place of `initial_sensitivity`.
    rate_scale : float
        c_b of (20), s/um; 0 makes the model independent of the rate.
    forgetting : float
        Forgetting factor lambda of (23), above 0, at most 1.
    regularization : float
        delta of (22), V^2: P(0) = I / delta.
    covariance_limit : float
        Largest trace of P, 1/V^2: above it the division by lambda is left out, so that P stays finite at rest.
    slope_min : float
        Smallest partial slope that the inverse uses, um/V; by default 5 % of stroke / (highest - lowest voltage).
    precision : str
        "double", or "single" to compute as a microcontroller would.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> s.plays, round(s.initial_sensitivity, 3), round(s.slope_min, 3)
    (8, 7.143, 0.357)
    >>> ControllerSettings(sample_rate=2000.0, stroke=-30.0, voltage_limits=(-0.6, 3.6))
    Traceback (most recent call last):
        ...
    truestroke._check.SettingError: stroke = -30.0 um: must be above 0 um
    """

    sample_rate: float
    stroke: float
    voltage_limits: tuple[float, float]
    plays: int = 8
    thresholds: tuple[float, ...] = None  # type: ignore[assignment]  # None is filled in by __post_init__
    dead_zone_thresholds: tuple[float, ...] = (0.0,)
    dead_zone_weights: tuple[float, ...] = (1.0,)
    initial_sensitivity: float = None  # type: ignore[assignment]
    initial_weights: tuple[float, ...] = None  # type: ignore[assignment]
    rate_scale: float = 0.007
    forgetting: float = 0.9999
    regularization: float = 1e-3
    covariance_limit: float = 1e6
    slope_min: float = None  # type: ignore[assignment]
    precision: Literal["double", "single"] = "double"

    def __post_init__(self) -> None:
        for name, value in self._checked().items():
            object.__setattr__(self, name, value)

    def _checked(self) -> dict[str, object]:
        low, high = _check.interval("voltage_limits", self.voltage_limits, "V")
        stroke = _check.positive("stroke", self.stroke, "um")
        sensitivity = stroke / (high - low)
        plays, thresholds = self._play_thresholds(high)
        initial, weights = self._start(plays, sensitivity)
        regularization = _check.positive("regularization", self.regularization, "V^2")
        limit = _check.positive("covariance_limit", self.covariance_limit, "1/V^2")
        if limit < 2 * plays / regularization:
            raise SettingError(
                "covariance_limit",
                limit,
                f"at least the trace of P(0), {2 * plays / regularization:g} 1/V^2",
                "1/V^2",
            )
        forgetting = _check.number("forgetting", self.forgetting)
        if not 0 < forgetting <= 1:
            raise SettingError("forgetting", forgetting, "above 0 and at most 1")
        if self.precision not in ("double", "single"):
            raise SettingError("precision", repr(self.precision), "'double' or 'single'")
        return {
            "sample_rate": _check.positive("sample_rate", self.sample_rate, "Hz"),
            "stroke": stroke,
            "voltage_limits": (low, high),
            "plays": plays,
            "thresholds": thresholds,
            **self._dead_zones(),
            "initial_sensitivity": initial,
            "initial_weights": weights,
            "rate_scale": _check.within("rate_scale", self.rate_scale, 0.0, 1e6, "s/um"),
            "forgetting": forgetting,
            "regularization": regularization,
            "covariance_limit": limit,
            "slope_min": _check.positive(
                "slope_min", 0.05 * sensitivity if self.slope_min is None else self.slope_min, "um/V"
            ),
        }

    def _play_thresholds(self, high: float) -> tuple[int, tuple[float, ...]]:
        if self.thresholds is not None:
            thresholds = _check.ascending("thresholds", self.thresholds, "V")
            return _check.count("the number of thresholds", len(thresholds), 1, MAX_PLAYS), thresholds
        plays = _check.count("plays", self.plays, 1, MAX_PLAYS)
        if high <= 0:
            raise SettingError("thresholds", None, "given where the highest voltage is not above 0", "V")
        return plays, tuple(i / plays * high / 2 for i in range(plays))

    def _dead_zones(self) -> dict[str, object]:
        thresholds = _check.ascending("dead_zone_thresholds", self.dead_zone_thresholds, "um")
        _check.count("the number of dead_zone_thresholds", len(thresholds), 1, MAX_DEAD_ZONES)
        weights = tuple(_check.number("dead_zone_weights", w) for w in self.dead_zone_weights)
        if len(weights) != len(thresholds):
            raise SettingError("dead_zone_weights", weights, f"{len(thresholds)} numbers, one for each threshold")
        if any(sum(weights[: i + 1]) <= 0 for i in range(len(weights))):
            raise SettingError("dead_zone_weights", weights, "numbers whose partial sums are all above 0")
        return {"dead_zone_thresholds": thresholds, "dead_zone_weights": weights}

    def _start(self, plays: int, sensitivity: float) -> tuple[float, tuple[float, ...]]:
        if self.initial_weights is not None:
            weights = tuple(_check.number("initial_weights", w, "um/V") for w in self.initial_weights)
            if len(weights) != 2 * plays:
                raise SettingError("initial_weights", weights, f"{2 * plays} numbers [a0, b0, a1, b1, ...]", "um/V")
            return _check.positive("initial_weights[0]", weights[0], "um/V"), weights
        initial = self.initial_sensitivity if self.initial_sensitivity is not None else sensitivity
        initial = _check.positive("initial_sensitivity", initial, "um/V")
        return initial, (initial, *([0.0] * (2 * plays - 1)))

    def to_dict(self) -> dict[str, float | str | Sequence[float]]:
        """All settings by name, as plain numbers and lists, for a recording or a file."""
        return dataclasses.asdict(self)

    @classmethod
    def paper(cls, *, sample_rate: float, stroke: float, voltage_limits: tuple[float, float]) -> ControllerSettings:
        """The settings of the paper: 8 plays, w(0) = [5, 0, ...], c_b = 0.007 s/um, lambda = 0.9999, delta = 1e-3."""
        return cls(
            sample_rate=sample_rate,
            stroke=stroke,
            voltage_limits=voltage_limits,
            plays=8,
            initial_sensitivity=5.0,
            rate_scale=0.007,
            forgetting=0.9999,
            regularization=1e-3,
        )
