"""AdaptiveController as its user meets it: settings, errors, flags, hold, reset, state."""

import dataclasses

import numpy as np
import pytest

import truestroke
from truestroke import AdaptiveController, ControllerSettings, SettingError, _kernel

BASIC = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}


def drive(controller: AdaptiveController, ticks: int, start: int = 0) -> list[float]:
    """A plant with play, which the model can hold; returns the voltages."""
    memory, volts = 0.0, []
    for k in range(start, start + ticks):
        phase = 0.01 * k
        x = controller.command(15.0 - 14.0 * np.cos(phase), 280.0 * np.sin(phase))
        memory = max(x - 0.45, min(x + 0.45, memory))
        controller.adapt(9.0 * x + 4.0 * memory)
        volts.append(x)
    return volts


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        ("sample_rate", 0.0, ["sample_rate", "0.0 Hz", "above 0 Hz"]),
        ("stroke", float("nan"), ["stroke", "nan um", "finite"]),
        ("voltage_limits", (3.6, -0.6), ["voltage_limits", "V", "low below high"]),
        ("plays", 33, ["plays", "33", "from 1 to 32"]),
        ("thresholds", (0.1, 0.2), ["thresholds", "V", "start at 0"]),
        ("dead_zone_thresholds", (0.0, 12.0), ["dead_zone_weights", "2 numbers"]),
        ("dead_zone_weights", (-1.0,), ["dead_zone_weights", "partial sums"]),
        ("initial_weights", (5.0, 0.0), ["initial_weights", "16 numbers", "um/V"]),
        ("initial_sensitivity", -5.0, ["initial_sensitivity", "-5.0 um/V", "above 0"]),
        ("rate_scale", -0.1, ["rate_scale", "-0.1 s/um", "from 0"]),
        ("forgetting", 1.5, ["forgetting", "1.5", "at most 1"]),
        ("regularization", 0.0, ["regularization", "V^2", "above 0"]),
        ("covariance_limit", 1.0, ["covariance_limit", "1/V^2", "trace of P(0)"]),
        ("slope_min", 0.0, ["slope_min", "um/V", "above 0"]),
        ("precision", "half", ["precision", "'half'", "'single'"]),
        ("lambda_", 0.99, ["lambda_", "no such setting", "forgetting"]),
    ],
)
def test_a_bad_setting_is_named_with_value_bound_and_unit(setting, value, words) -> None:
    with pytest.raises(SettingError) as caught:
        AdaptiveController(**{**BASIC, setting: value})
    for word in words:
        assert word in str(caught.value)


def test_settings_are_frozen_complete_and_of_the_kernel_s_size() -> None:
    settings = AdaptiveController(**BASIC).settings
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.forgetting = 0.5  # type: ignore[misc]
    assert all(value is not None for value in settings.to_dict().values())
    assert ControllerSettings(**settings.to_dict()) == settings
    assert truestroke.settings.MAX_PLAYS == _kernel.MAX_PLAYS
    assert truestroke.settings.MAX_DEAD_ZONES == _kernel.MAX_DEAD_ZONES


def test_paper_is_the_literal_algorithm() -> None:
    settings = AdaptiveController.paper(**BASIC).settings
    assert settings.plays == 8
    assert settings.initial_weights == (5.0, *[0.0] * 15)  # (22)
    assert settings.rate_scale == 0.007  # Sec. 3.2
    assert settings.forgetting < 1
    assert settings.dead_zone_weights == (1.0,)


def test_a_bad_desired_value_raises_before_anything_changes() -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 100)
    before = controller.state()
    for z_d, zdot_d in ((np.nan, 0.0), (np.inf, 0.0), (0.0, np.nan), (0.0, -np.inf)):
        with pytest.raises(ValueError, match="must be finite"):
            controller.command(z_d, zdot_d)
    with pytest.raises(ValueError, match=r"z_d\[1\] = nan um"):
        controller.process([1.0, np.nan], [0.0, 0.0])
    after = controller.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_a_bad_measurement_is_rejected_flagged_and_counted() -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 100)
    weights = controller.weights
    for bad in (np.nan, np.inf, -np.inf):
        controller.command(10.0, 0.0)
        controller.adapt(bad)
        assert controller.flags.rejected
    assert controller.counters.rejected == 3
    assert np.array_equal(controller.weights, weights)
    controller.command(10.0, 0.0)
    controller.adapt(10.0)
    assert not controller.flags.rejected
    assert controller.counters.adaptations == 101


def test_saturation_is_flagged_and_the_voltage_stays_within_limits() -> None:
    controller = AdaptiveController(**BASIC)
    assert controller.command(1e6, 0.0) == 3.6
    assert controller.flags.saturated
    assert controller.command(-1e6, 0.0) == -0.6
    assert controller.counters.saturated == 2
    controller.command(10.0, 0.0)
    assert not controller.flags.saturated


def test_the_guard_keeps_the_inverse_defined_and_says_so() -> None:
    weights = [0.0] * 16
    weights[0], weights[1] = 5.0, -5.0
    controller = AdaptiveController(**BASIC, initial_weights=tuple(weights))
    controller.command(10.0, 0.0)
    assert not controller.flags.projected
    controller.command(10.0, 1000.0)  # 5 - 0.007 * 1000 * 5 < 0: the singularity of Sec. 6
    assert controller.flags.projected
    assert controller.counters.projected == 1
    assert (controller.diagnostics.partial_slopes >= controller.settings.slope_min).all()


def test_hold_keeps_the_weights_and_resume_lets_them_go() -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 100)
    controller.hold()
    weights = controller.weights
    drive(controller, 50, start=100)
    assert controller.flags.held
    assert np.array_equal(controller.weights, weights)
    assert controller.innovation != 0  # still told
    controller.resume()
    drive(controller, 50, start=150)
    assert not np.array_equal(controller.weights, weights)


def test_reset_equals_fresh() -> None:
    used, fresh = AdaptiveController(**BASIC), AdaptiveController(**BASIC)
    drive(used, 300)
    used.hold()
    used.reset()
    assert drive(used, 300) == drive(fresh, 300)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_run_saved_and_restored_goes_on_to_the_same_bits(precision, tmp_path) -> None:
    whole = AdaptiveController(**BASIC, precision=precision)
    expected = drive(whole, 600)
    first = AdaptiveController(**BASIC, precision=precision)
    drive(first, 300)
    np.savez(tmp_path / "state.npz", **first.state())
    second = AdaptiveController(**BASIC, precision=precision)
    with np.load(tmp_path / "state.npz") as state:
        second.restore(state)
    memory = 0.0
    for x in expected[:300]:  # the plant goes on where it was
        memory = max(x - 0.45, min(x + 0.45, memory))
    for k in range(300, 600):
        phase = 0.01 * k
        x = second.command(15.0 - 14.0 * np.cos(phase), 280.0 * np.sin(phase))
        assert x == expected[k]
        memory = max(x - 0.45, min(x + 0.45, memory))
        second.adapt(9.0 * x + 4.0 * memory)


@pytest.mark.parametrize("fault", ["missing", "size", "nan"])
def test_a_bad_state_changes_nothing(fault) -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 50)
    before, bad = controller.state(), controller.state()
    if fault == "missing":
        del bad["covariance_root"]
    elif fault == "size":
        bad["weights"] = bad["weights"][:5]
    else:
        bad["play"][3] = np.nan
    bad["regressor"] += 1.0
    with pytest.raises(ValueError, match="state"):
        controller.restore(bad)
    after = controller.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_diagnostics_are_a_read_only_copy() -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 100)
    seen = controller.diagnostics
    kept = seen.weights.copy()
    with pytest.raises(ValueError, match="read-only"):
        seen.weights[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        seen.innovation = 0.0  # type: ignore[misc]
    drive(controller, 100, start=100)
    assert np.array_equal(seen.weights, kept)
    assert seen.trace_P > 0
    assert seen.play_states.shape == seen.partial_slopes.shape == (8,)
