"""Keywords of controllers for type checkers; written by tests/settings_texts.py from the declaration."""

from typing import Literal, TypedDict

from truestroke.control.feedback import Feedback
from truestroke.model.dynamics import Dynamics


class ChangeableOptions(TypedDict, total=False):
    """Members of `ControllerSettings` that may change while running, but `voltage_limits`."""

    resonance: float
    latency: int
    hum: tuple[float, ...]
    feedback: Feedback | None
    dead_zone_weights: tuple[float, ...]
    rate_scale: float | None
    prior_return_time: float | None
    filter_frequency: float | None
    model_error: float | None
    change_threshold: float | None
    change_refractory: float
    change_gain: float
    change_hysteresis: float
    change_share: float
    outlier: float
    outliers: int
    forgetting: float
    covariance_limit: float
    slope_limits: tuple[float, float] | None
    velocity_limit: float
    slew_limit: float | None
    measurement_limit: float | None
    smoothing_time: float | None
    trim_rate: float


class SettingsOptions(ChangeableOptions, total=False):
    """Members of `ControllerSettings` but the three that are needed."""

    dynamics: Dynamics | None
    sensor_delay: float | None
    sensor_bandwidth: float | None
    plays: int
    thresholds: tuple[float, ...] | None
    rate_dependent: tuple[int, ...] | None
    creep_times: tuple[float, ...]
    lag: bool
    inertia: bool | None
    offset: bool
    asymmetry: int
    duhem_lengths: tuple[float, ...] | None
    other_axes: int
    dead_zone_thresholds: tuple[float, ...]
    law: Literal["kalman", "rls"]
    initial_sensitivity: float | None
    initial_weights: tuple[float, ...] | None
    prior_covariance: tuple[tuple[float, ...], ...] | None
    regularization: float
    precision: Literal["double", "single"]
