"""A controller from a model, with measured dynamics or a sensor beside it: nothing of the record is counted twice."""

import numpy as np
import pytest

from truestroke import ActuatorModel, AdaptiveController, ControllerSettings, Dynamics, Mode, SettingError, save_model

AXIS = {"sample_rate": 10_000.0, "voltage_limits": (-0.6, 3.6), "slew_limit": 1e5}
STAGE = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=1e-4)
WEIGHTS = {"a0": 6.0, "b0": 0.1, "a1": 1.0, "creep 0.3 s": 0.2, "lag": -3e-5, "offset": 0.4}


def model(**others):
    names = dict(WEIGHTS)
    if others.get("inertia"):
        offset = names.pop("offset")
        names |= {"inertia": 1e-7, "offset": offset}
    known = {
        "thresholds": (0.0, 0.3),
        "rate_dependent": (0,),
        "creep_times": (0.3,),
        "rate_scale": 7e-4,
        "stroke": 24.0,
    }
    known |= {"voltage_range": (0.0, 3.0), "delay": 2e-4, "time_constant": 5e-5}
    return ActuatorModel(weights=list(names.values()), covariance=1e-6 * np.eye(len(names)), **known, **others)


def weights(controller):
    return dict(zip(controller.settings.names, controller.weights.tolist(), strict=True))


def deviation(settings, name):
    i = settings.names.index(name)
    return np.sqrt(settings.prior_covariance[i][i])


@pytest.mark.parametrize("inertia", [False, True])
def test_measured_dynamics_replace_what_the_record_says_of_lag_and_inertia(inertia):
    of = model(inertia=inertia)
    alone, known = AdaptiveController.from_model(of, **AXIS), AdaptiveController.from_model(of, dynamics=STAGE, **AXIS)
    assert weights(alone)["lag"] == pytest.approx(-3e-5 - 2e-4 - 5e-5)
    still = {"duhem 4.2 V": 0.0, "duhem 1.05 V": 0.0}
    assert weights(known) == {**WEIGHTS, "lag": 0.0, "inertia": 0.0, "offset": 0.0, **still}
    assert known.settings.dynamics == STAGE
    usual = ControllerSettings(stroke=24.0, dynamics=STAGE, **AXIS)
    for name in ("lag", "inertia"):  # no more than what measured dynamics may miss
        assert deviation(known.settings, name) == pytest.approx(deviation(usual, name))
    assert deviation(known.settings, "a0") == pytest.approx(deviation(alone.settings, "a0"))
    assert known.command(10.0, 0.0) == pytest.approx(alone.command(10.0, 0.0), rel=1e-3)


@pytest.mark.parametrize("lengths", [(), (1.0,), None])
def test_weights_and_covariance_may_be_those_that_another_controller_learned(lengths):
    before = AdaptiveController.from_model(model(), duhem_lengths=lengths, **AXIS)
    for _ in range(20):
        before.command(10.0, 0.0)
        before.adapt(11.0)
    P = np.diag(np.diag(before.covariance))
    learned = {"initial_weights": tuple(before.weights.tolist()), "prior_covariance": tuple(map(tuple, P.tolist()))}
    after = AdaptiveController.from_model(model(), duhem_lengths=lengths, **AXIS, **learned)
    assert np.array_equal(after.weights, before.weights)
    assert np.array_equal(after.settings.prior_covariance, P)
    with pytest.raises(SettingError, match=f"initial_weights = .* must be {before.weights.size} numbers"):
        AdaptiveController.from_model(model(), duhem_lengths=lengths, **AXIS, initial_weights=(1.0, 2.0))


def test_they_may_be_files(tmp_path):
    save_model(tmp_path / "model.toml", model())
    STAGE.save(tmp_path / "dynamics.toml")
    files = AdaptiveController.from_model(tmp_path / "model.toml", dynamics=tmp_path / "dynamics.toml", **AXIS)
    assert files.settings == AdaptiveController.from_model(model(), dynamics=STAGE, **AXIS).settings


def test_the_delay_of_the_sensor_is_a_part_of_that_of_the_record():
    late = AdaptiveController.from_model(model(), sensor_delay=1e-4, sensor_bandwidth=8000.0, **AXIS)
    assert weights(late)["lag"] == pytest.approx(-3e-5 - 2e-4 - 5e-5 + 1e-4 + 1 / (2 * np.pi * 8000.0))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"dynamics": STAGE.at(5000.0)}, "10000"),
        ({"dynamics": 700.0}, "dynamics = 700.0: must be a Dynamics"),
        ({"dynamics": STAGE, "law": "rls"}, 'None for law = "rls"'),
        ({"dynamics": STAGE, "sensor_delay": 1e-4}, "truestroke bode --sensor-delay"),
    ],
)
def test_what_does_not_fit_is_refused(given, words):
    with pytest.raises(SettingError, match=words):
        AdaptiveController.from_model(model(), **AXIS, **given)


def test_dynamics_of_another_stage_are_refused_with_both_frequencies():
    of = model(dynamics=Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=300.0, damping=0.02),)))
    with pytest.raises(SettingError, match=r"first resonance 700 Hz: must be that of the same stage.* 300 Hz"):
        AdaptiveController.from_model(of, dynamics=STAGE, **AXIS)
    near = model(dynamics=Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=640.0, damping=0.02),)))
    assert AdaptiveController.from_model(near, dynamics=STAGE, **AXIS).settings.dynamics == STAGE
    assert AdaptiveController.from_model(near, dynamics=None, **AXIS).settings.dynamics is None


def test_a_covariance_of_very_different_units_is_no_reason_to_refuse():
    usual = ControllerSettings(stroke=24.0, dynamics=STAGE, **AXIS)
    assert ControllerSettings(stroke=24.0, dynamics=STAGE, prior_covariance=usual.prior_covariance, **AXIS) == usual
    P = np.array(usual.prior_covariance)
    i = usual.names.index("inertia")
    P[i, i] *= -1
    with pytest.raises(SettingError, match="positive definite"):
        ControllerSettings(stroke=24.0, dynamics=STAGE, prior_covariance=P, **AXIS)
