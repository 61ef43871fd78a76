"""AdaptiveController as its user meets it: settings, errors, flags, hold, reset, state."""

import dataclasses

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings, Dynamics, Mode, SettingError
from truestroke.plant import RealisticPlant
from truestroke.signals.trajectories import random_wave

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
        ("initial_weights", (5.0, 0.0), ["initial_weights", "41 numbers", "um/V"]),
        ("initial_sensitivity", -5.0, ["initial_sensitivity", "-5.0 um/V", "above 0"]),
        ("rate_scale", -0.1, ["rate_scale", "-0.1 s/um", "from 0"]),
        ("forgetting", 1.5, ["forgetting", "1.5", "from 0.001 to 1"]),
        ("regularization", 0.0, ["regularization", "V^2", "above 0"]),
        ("covariance_limit", 1.0, ["covariance_limit", "1/V^2", "trace of P(0)"]),
        ("slope_limits", (0.0, 20.0), ["slope_limits", "um/V", "above 0"]),
        ("slope_limits", (20.0, 2.0), ["slope_limits", "um/V", "low below high"]),
        ("creep_times", (0.0,), ["creep_times", "0.0 s", "above 0"]),
        ("rate_dependent", (26,), ["rate_dependent", "26", "from 0 to 25"]),
        ("asymmetry", 3, ["asymmetry", "3", "from 0 to 2"]),
        ("law", "lms", ["law", "'lms'", "'kalman' or 'rls'"]),
        ("prior_covariance", ((1.0,),), ["prior_covariance", "(41, 41)", "positive definite"]),
        ("prior_return_time", -1.0, ["prior_return_time", "-1.0 s", "above 0"]),
        ("filter_frequency", 1500.0, ["filter_frequency", "1500.0 Hz", "1000 Hz"]),
        ("model_error", -1.0, ["model_error", "-1.0 um", "from 0"]),
        ("change_share", 2.0, ["change_share", "2.0", "from 0 to 1"]),
        ("outliers", 1.5, ["outliers", "1.5", "whole number"]),
        ("slew_limit", 0.0, ["slew_limit", "0.0 V/s", "above 0"]),
        ("measurement_limit", 0.0, ["measurement_limit", "0.0 um", "above 0"]),
        ("smoothing_time", 2.0, ["smoothing_time", "2.0 s", "from 0 to 1"]),
        ("trim_rate", -1.0, ["trim_rate", "-1.0 1/s", "from 0"]),
        ("precision", "half", ["precision", "'half'", "'single'"]),
        ("lambda_", 0.99, ["lambda_", "left out; there are", "sample_rate", "forgetting"]),
        ("forgeting", 0.99, ["forgeting = 0.99", "did you mean forgetting?"]),
        ("stroke", "30", ["stroke = '30' um", "a number"]),
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
    assert [name for name, value in settings.to_dict().items() if value is None] == ["dynamics"]
    assert ControllerSettings(**settings.to_dict()) == settings
    stage = Dynamics(sample_rate=2000.0, modes=(Mode(frequency=500.0, damping=0.02),), uncertainty={"dead_time": 1e-5})
    known = dataclasses.replace(settings, dynamics=stage, inertia=None, initial_weights=None, prior_covariance=None)
    assert ControllerSettings(**known.to_dict()) == known


def test_paper_is_the_literal_algorithm() -> None:
    settings = AdaptiveController.paper(**BASIC).settings
    assert settings.plays == 8
    assert settings.initial_weights == (5.0, *[0.0] * 15)  # (22)
    assert settings.rate_scale == 0.007  # Sec. 3.2
    assert settings.forgetting < 1
    assert settings.law == "rls"
    assert settings.dead_zone_weights == (1.0,)
    assert (settings.creep_times, settings.lag, settings.offset, settings.asymmetry) == ((), False, False, 0)
    assert settings.smoothing_time == settings.trim_rate == 0.0


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


def test_the_two_calls_take_numbers_by_place_or_by_name_and_nothing_else() -> None:
    controller, other = AdaptiveController(**BASIC), AdaptiveController(**BASIC)
    assert controller.command(1, np.float32(2)) == other.command(zdot_d=2.0, z_d=True)
    controller.adapt(2, np.int64(0)), other.adapt(ago=0, z_measured=np.float64(2.0))
    assert np.array_equal(controller.weights, other.weights)
    command, adapt = controller.command, controller.adapt
    for call, args, names in [
        (command, (), {}), (command, (1.0,), {}), (command, (1.0, 2.0, 3.0, 4.0, 5.0), {}),
        (command, (1.0, 2.0), {"z_d": 1.0}), (command, (1.0, 2.0, "3"), {}), (command, (1.0, 2.0, np.nan), {}),
        (command, (1.0,), {"rate": 1.0}), (command, ("1", 2.0), {}), (command, (1.0, None), {}),
        (adapt, (), {}), (adapt, (1.0, 0, 0), {}), (adapt, (None,), {}), (adapt, (1.0, 0.5), {}),
    ]:  # fmt: skip
        with pytest.raises((TypeError, SettingError)):
            call(*args, **names)
    assert controller.counters == other.counters
    for ago in (-1, 1024, 10**15):
        controller.adapt(1.0, ago)
        assert controller.flags.rejected


def test_a_subclass_may_have_its_own_command() -> None:
    class Doubled(AdaptiveController):
        def command(self, z_d: float, zdot_d: float) -> float:
            return 2 * super().command(z_d, zdot_d)

    assert Doubled(**BASIC).command(1.0, 0.0) == 2 * AdaptiveController(**BASIC).command(1.0, 0.0)


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
    steps = np.diff(
        [0.0] + [controller.command(1e6, 0.0) for _ in range(40)] + [controller.command(-1e6, 0.0) for _ in range(40)]
    )
    slew = controller.settings.slew_limit / controller.settings.sample_rate
    assert np.abs(steps).max() == pytest.approx(slew)
    assert controller.counters.slewed > 20
    assert controller.flags.saturated
    assert controller.command(-1e6, 0.0) == -0.6
    assert controller.counters.saturated > 20
    for _ in range(40):
        volts = controller.command(10.0, 0.0)
    assert -0.6 < volts < 3.6
    assert not controller.flags.saturated
    assert not controller.flags.slewed


def test_at_speed_a_slope_may_be_a_twentieth_of_the_smallest_at_rest() -> None:
    controller = AdaptiveController(**BASIC, slope_limits=(2.0, 50.0))
    layout = controller.settings
    weights = layout.vector([8.0, *[0.0] * (layout.plays - 1)], [-1.0, *[0.0] * (len(layout.rate_dependent) - 1)])
    weights = tuple(weights.tolist())
    controller = AdaptiveController(**BASIC, slope_limits=(2.0, 50.0), initial_weights=weights)
    speeds = {7.0: 1.0, 7.8: 0.2, 7.95: 0.1, 9.0: 0.1}  # c_b zdot_d, and the slope 8 - that
    for rate, slope in speeds.items():
        controller.command(1.0, rate / layout.rate_scale)
        assert controller.diagnostics.partial_slopes == pytest.approx(slope)
        assert controller.flags.projected == (rate > 7.9)


def test_the_guard_keeps_the_inverse_defined_and_says_so() -> None:
    weights = [0.0] * 16
    weights[0], weights[1] = 5.0, -5.0
    settings = ControllerSettings.paper(**BASIC, initial_weights=tuple(weights))
    controller = AdaptiveController.from_settings(settings)
    controller.command(10.0, 0.0)
    assert not controller.flags.projected
    controller.command(10.0, 1000.0)  # 5 - 0.007 * 1000 * 5 < 0: the singularity of Sec. 6
    assert controller.flags.projected
    assert controller.counters.projected == 1
    assert (controller.diagnostics.partial_slopes >= settings.slope_limits[0]).all()


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


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"stroke": 20.0}, r"made with stroke 30 um: must be one made with stroke 20 um, as here"),
        ({"voltage_limits": (0.0, 3.6)}, r"voltage_limits \(-0\.6, 3\.6\) V: .* voltage_limits \(0, 3\.6\) V"),
        (
            {"sample_rate": 1999.0, "stroke": 20.0},
            r"sample_rate 2000 Hz, stroke 30 um: .* sample_rate 1999 Hz",
        ),
        ({"latency": 2}, r"latency 0.*: must be one made with latency 2"),
        ({"law": "rls"}, "law kalman: must be one made with law rls"),
        ({"precision": "single"}, "precision double: must be one made with precision single"),
        ({"plays": 20}, "plays 26: must be one made with plays 20"),
        ({"slew_limit": 100.0}, r"slew_limit 504 V/s: must be one made with slew_limit 100 V/s"),
        ({"stroke": 30.0 * (1 + 1e-4)}, r"stroke 30 um: must be one made with stroke 30\.003 um"),
    ],
)
def test_a_state_of_other_settings_is_refused_by_name_and_changes_nothing(other, words, tmp_path) -> None:
    saved, controller = AdaptiveController(**BASIC), AdaptiveController(**{**BASIC, **other})
    drive(saved, 50), drive(controller, 50)
    np.savez(tmp_path / "state.npz", **saved.state())
    before = controller.state()
    with np.load(tmp_path / "state.npz") as state, pytest.raises(SettingError, match=words):
        controller.restore(state)
    assert all(np.array_equal(before[name], after) for name, after in controller.state().items())


def test_a_state_goes_to_settings_that_were_computed_elsewhere() -> None:
    """Libraries round what follows from others in their own way."""
    saved = AdaptiveController(**BASIC)
    P0 = np.array(saved.settings.prior_covariance)
    other = AdaptiveController(**BASIC, prior_covariance=P0 * (1 + 1e-12))
    drive(saved, 50)
    other.restore(saved.state())
    assert np.array_equal(other.weights, saved.weights)
    with pytest.raises(SettingError, match=r"prior_covariance\[0\]\[0\]"):
        AdaptiveController(**BASIC, prior_covariance=P0 * 1.01).restore(saved.state())


def test_settings_that_were_changed_are_those_of_the_state() -> None:
    saved, other = AdaptiveController(**BASIC), AdaptiveController(**BASIC)
    saved.change(trim_rate=20.0)
    with pytest.raises(SettingError, match="trim_rate 20 1/s: must be one made with trim_rate 0 1/s, as here: make"):
        other.restore(saved.state())
    other.change(trim_rate=20.0)
    other.restore(saved.state())
    without = {name: array for name, array in saved.state().items() if name != "made_with"}
    damaged = {**without, "made_with": np.ones(3)}
    for wrong, why in ((without, "it has no entry made_with"), (damaged, "its entry made_with is damaged")):
        with pytest.raises(SettingError, match=why):
            other.restore(wrong)


@pytest.mark.parametrize("fault", ["missing", "size", "nan"])
def test_a_bad_state_changes_nothing(fault) -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 50)
    before, bad = controller.state(), controller.state()
    if fault == "missing":
        del bad["lagged_play"]
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
    assert seen.play_states.shape == seen.partial_slopes.shape == (26,)
    assert seen.weights.shape == (41,)


# ---- What an engineer leaves switched on for a year ------------------------------------------------------------------


def test_a_spike_is_rejected_and_a_lasting_jump_is_believed() -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 2000)
    weights = controller.weights
    controller.command(15.0, 0.0)
    controller.adapt(29.0)
    assert controller.flags.rejected
    assert np.abs(controller.weights - weights).max() < 0.01
    for _ in range(3):
        controller.command(15.0, 0.0)
        controller.adapt(16.0)
    assert not controller.flags.rejected


def test_an_absurd_measurement_does_no_harm() -> None:
    for make in (AdaptiveController, AdaptiveController.paper):
        controller = make(**BASIC)
        drive(controller, 500)
        for absurd in (1.7e308, -1e300, 1e4):
            controller.command(15.0, 0.0)
            controller.adapt(absurd)
            assert controller.flags.rejected
        drive(controller, 500, start=500)
        assert np.isfinite(controller.weights).all()
        assert abs(controller.innovation) < 0.5


def test_a_sudden_change_is_flagged_once_and_forgotten_soon() -> None:
    controller, memory, errors = AdaptiveController(**BASIC), 0.0, []
    rng = np.random.default_rng(3)
    changes = []
    for k in range(8000):
        gain, phase = (1.0 if k < 4000 else 0.8), 0.02 * k * (1 + 0.1 * np.sin(0.0007 * k))
        z_d = 12.0 - 11.0 * np.cos(phase)
        x = controller.command(z_d, 440.0 * np.sin(phase))
        memory = max(x - 0.3, min(x + 0.3, memory))
        z = gain * (7.0 * x + 4.0 * memory)
        controller.adapt(z + rng.normal(0.0, 0.013))
        errors.append(z - z_d)
        if controller.flags.changed:
            changes.append(k)
    assert changes
    assert 4000 <= changes[0] <= 4010
    assert len(changes) <= 2
    assert np.abs(errors[4100:]).max() < 0.25
    assert controller.counters.changed == len(changes)


def test_a_saturated_tick_is_not_used() -> None:
    controller = AdaptiveController(**BASIC)
    drive(controller, 1000)
    for _ in range(60):
        controller.command(60.0, 0.0)
        controller.adapt(20.0)
        controller.flags  # noqa: B018
    weights = controller.weights
    for _ in range(100):
        controller.command(60.0, 0.0)
        controller.adapt(20.0)
    assert controller.flags.saturated
    assert np.abs(controller.weights - weights).max() < 1e-3  # but for the slow return to the prior


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("length", [1000, 2000])
@pytest.mark.parametrize("fault", ["sign inverted", "cable off", "100 um too little"])
def test_no_sensor_locks_the_controller_up_for_longer_than_it_fails(fault, length, precision) -> None:
    """Nonsense for half a second or one drives it to the limits; 0.25 s after the sensor is right all is well."""
    rng = np.random.default_rng(7)
    for seed in range(3):
        controller, plant = AdaptiveController(**BASIC, precision=precision), RealisticPlant(seed=seed)
        wave, errors = random_wave(duration=3.5, seed=seed), []
        plant.open()
        for k in range(wave.position.size):
            z = plant.exchange(np.array([controller.command(wave.position[k], wave.velocity[k])]))[0]
            nonsense = {"sign inverted": -z, "cable off": rng.normal(0.0, 0.013), "100 um too little": z - 100.0}
            controller.adapt(nonsense[fault] if 3000 <= k < 3000 + length else z)
            errors.append(plant.truth[0] - wave.position[k])
        errors = np.abs(errors)
        assert errors[3000 : 3000 + length].max() > 30.0, "it was led astray"
        assert errors[3000 + length + 500 :].max() < 0.25


def test_a_sensor_may_stand_still_where_the_voltage_does() -> None:
    """At a limit, without noise, the same number comes again and again, however fast the desired motion is."""
    controller = AdaptiveController(**BASIC)
    for k in range(1000):
        x = controller.command(80.0 + 10.0 * np.sin(0.5 * k), 1e4 * np.cos(0.5 * k))
        controller.adapt(13.0 * x)
    assert x == 3.6
    assert controller.counters.rejected <= 3  # the first of them might be spikes


@pytest.mark.parametrize("offset", [True, False])
def test_start_takes_over_where_the_actuator_is(offset) -> None:
    controller = AdaptiveController(**BASIC, offset=offset)
    drive(controller, 100)
    controller.start(volts=1.25, z=17.0)
    assert controller.command(17.0, 0.0) == pytest.approx(1.25, abs=1e-12)
    assert controller.counters.commands == 1
    with pytest.raises(SettingError, match=r"volts = 9.0 V: must be from -0.6 to 3.6 V"):
        controller.start(volts=9.0, z=0.0)


def test_settings_change_without_a_jump() -> None:
    changed, same = AdaptiveController(**BASIC), AdaptiveController(**BASIC)
    drive(changed, 1000), drive(same, 1000)
    changed.change(prior_return_time=100.0, trim_rate=10.0, slope_limits=(3.0, 25.0))
    z_d, rate = 15.0 - 14.0 * np.cos(10.0), 280.0 * np.sin(10.0)
    assert changed.command(z_d, rate) == pytest.approx(same.command(z_d, rate), abs=0.02)
    assert changed.settings.trim_rate == 10.0
    with pytest.raises(SettingError, match="plays = 5: must be left out"):
        changed.change(plays=5)
    with pytest.raises(SettingError, match="prior_return_time = -1"):
        changed.change(prior_return_time=-1.0)
    assert changed.settings.prior_return_time == 100.0


def test_trim_removes_what_the_model_cannot_know_and_does_not_wind_up() -> None:
    """Adaptation on hold, an actuator with 5 um of offset: the integral alone brings it home."""
    controller = AdaptiveController(**BASIC, trim_rate=50.0)
    controller.hold()
    for _ in range(2000):
        x = controller.command(10.0, 0.0)
        z = 10.0 * x + 5.0
        controller.adapt(z)
    assert z == pytest.approx(10.0, abs=1e-6)
    for _ in range(4000):  # out of reach: the integral waits
        x = controller.command(50.0, 0.0)
        controller.adapt(10.0 * x + 5.0)
    back = []
    for _ in range(2000):
        back.append(10.0 * controller.command(10.0, 0.0) + 5.0)
        controller.adapt(back[-1])
    assert back[-1] == pytest.approx(10.0, abs=1e-6)
    assert min(back[60:]) > 5.0  # no long swing to the other side


def test_trim_is_switched_off_without_a_trace() -> None:
    """What the integral held goes by and by, and the actuator is where it would be without it."""
    controller, never = AdaptiveController(**BASIC, trim_rate=100.0), AdaptiveController(**BASIC)
    for c in (controller, never):
        c.hold()
    for _ in range(1000):
        controller.adapt(10.0 * controller.command(10.0, 0.0) + 5.0)
        never.command(10.0, 0.0)
    before = controller.command(10.0, 0.0)
    controller.change(trim_rate=0.0)
    volts = [controller.command(10.0, 0.0) for _ in range(40)]
    assert volts[0] == pytest.approx(before, abs=1e-9)
    assert volts[-1] != pytest.approx(before, abs=0.1)
    assert np.abs(np.diff(volts)).max() < 0.3


def test_a_frozen_sensor_is_not_believed() -> None:
    """The last value again and again for half a second, in motion: rejected, and the actuator stays on course."""
    controller, memory, errors = AdaptiveController(**BASIC), 0.0, []
    rng = np.random.default_rng(5)
    for k in range(6000):
        phase = 0.02 * k
        z_d = 12.0 - 11.0 * np.cos(phase)
        x = controller.command(z_d, 440.0 * np.sin(phase))
        memory = max(x - 0.3, min(x + 0.3, memory))
        z = 7.0 * x + 4.0 * memory
        if not 4000 <= k < 5000:
            measured = z + rng.normal(0.0, 0.013)
        controller.adapt(measured)
        errors.append(z - z_d)
    assert np.abs(errors[3000:]).max() < 0.15
    assert controller.counters.rejected > 950
    assert controller.counters.changed == 0
