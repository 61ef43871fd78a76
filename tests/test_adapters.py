"""The identified model as a regressor of scikit-learn and as a system of python-control."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest
from late import Late

from truestroke import ActuatorModel, SettingError, Timing, TruestrokeError, identify, plant

control, sklearn, selection = Late("control"), Late("sklearn.base"), Late("sklearn.model_selection")
checks = Late("sklearn.utils.estimator_checks")
systems, ours = Late("truestroke.identification.adapters.control"), Late("truestroke.identification.adapters.sklearn")

FS = 1000.0
TIME = np.arange(3000) / FS
VOLTS = 1.5 - 1.5 * np.cos(2 * np.pi * 2 * TIME) * np.cos(1.1 * TIME)
SIMPLE = {"rate": False, "creep_times": (), "asymmetry": 0, "delay": 0.0}


def displacement(volts: np.ndarray) -> np.ndarray:
    """A stack of two plays, 8 and 3 um/V, the second of 0.4 V, and noise of 5 nm."""
    held, z = 0.0, np.empty_like(volts)
    for k, x in enumerate(volts):
        held = max(x - 0.4, min(x + 0.4, held))
        z[k] = 8.0 * x + 3.0 * held
    return z + 0.005 * np.random.default_rng(0).standard_normal(volts.size)


X, Z = VOLTS[:, np.newaxis], displacement(VOLTS)

# ---- scikit-learn --------------------------------------------------------------------------------------------------

# Checks that fit several random columns, or rows in any order; a record is one column in the order of time.
NOT_OF_A_RECORD = (
    "check_(array_api|dict_unchanged|dont_overwrite|dtype_object|estimators_(dtypes|fit|nan|overwrite|pickle)|f_contig"
    "|fit2d|fit_|methods|n_features_in|pipeline|positive_only|readonly|regressor|supervised_y_2d)"
)


def test_checks_of_scikit_learn():
    done = 0
    for estimator, check in checks.estimator_checks_generator(ours.ActuatorRegressor(**SIMPLE)):
        if not re.match(NOT_OF_A_RECORD, check.func.__name__):
            check(estimator)
            done += 1
    assert done > 20


def test_it_is_identify():
    stage = ours.ActuatorRegressor(FS, **SIMPLE).fit(X, Z)
    model = identify((VOLTS, Z, FS), **SIMPLE).model
    assert stage.model_.weights.tolist() == model.weights.tolist()
    assert stage.predict(X).tolist() == model.predict(VOLTS, FS).tolist()
    assert stage.score(X, Z) > 0.9999


def test_clone_pickle_and_parameters():
    stage = ours.ActuatorRegressor(FS, **SIMPLE)
    assert sklearn.clone(stage).get_params() == {"sample_rate": FS, "continued": False, "thresholds": None, **SIMPLE}
    fitted = stage.fit(X, Z)
    assert pickle.loads(pickle.dumps(fitted)).predict(X).tolist() == fitted.predict(X).tolist()
    assert stage.set_params(asymmetry=1).asymmetry == 1


def test_cross_validation_and_grid_search():
    folds = selection.TimeSeriesSplit(2, test_size=1000)
    stage = ours.ActuatorRegressor(FS, continued=True, **SIMPLE)
    assert selection.cross_val_score(stage, X, Z, cv=folds).min() > 0.99999
    grid = {"thresholds": [(0.0,), (0.0, 0.2, 0.4, 0.6)]}
    search = selection.GridSearchCV(stage, grid, cv=folds).fit(X, Z)
    assert search.best_params_["thresholds"] == (0.0, 0.2, 0.4, 0.6)


def test_a_second_column_is_refused():
    with pytest.raises(ValueError, match="takes one: the voltage"):
        ours.ActuatorRegressor(FS, **SIMPLE).fit(np.column_stack([VOLTS, TIME]), Z)
    with pytest.raises(TruestrokeError, match="asymmetry = 7"):
        ours.ActuatorRegressor(FS, **SIMPLE | {"asymmetry": 7}).fit(X, Z)


# ---- python-control ------------------------------------------------------------------------------------------------

MODEL = ActuatorModel(
    thresholds=(0.0, 0.3, 0.6),
    rate_dependent=(0, 2),
    weights=[8.0, 0.4, 2.0, 1.0, -0.2, 0.3, 0.1, -2e-4, 0.5, 0.6, 0.2],
    covariance=np.eye(11),
    stroke=30.0,
    voltage_range=(0.0, 3.0),
    creep_times=(0.05, 1.0),
    asymmetry=2,
    rate_scale=1e-3,
    delay=2.3e-3,
    zero=1.5,
)


def test_a_model_moves_as_it_predicts():
    """Apart from the velocity, which is that of half a sample before."""
    fs = 20e3
    time = np.arange(1000) / fs
    volts = 1.5 - 1.5 * np.cos(2 * np.pi * 25 * time) * np.cos(20 * time)
    response = control.input_output_response(systems.model_system(MODEL, fs), time, volts)
    predicted = MODEL.predict(volts, fs)
    assert np.ptp(predicted) > 25
    assert np.abs(response.outputs[200:] - predicted[200:]).max() < 2e-3 * np.ptp(predicted)


def test_terms_without_velocity_are_exact():
    still = MODEL.replace(rate_scale=0.0, delay=2e-3, weights=np.where(np.arange(11) == 7, 0.0, MODEL.weights))
    response = control.input_output_response(systems.model_system(still, FS), TIME[:400], VOLTS[:400])
    np.testing.assert_allclose(response.outputs, still.predict(VOLTS[:400], FS), atol=1e-9)


def test_the_system_has_names_and_a_sample_time():
    system = systems.model_system(MODEL, FS)
    assert (system.ninputs, system.noutputs, system.dt) == (1, 1, 1e-3)
    assert (
        " ".join(system.state_labels) == "play[0] play[1] play[2] creep[0] creep[1] volts[-2] volts[-1] z[-1] "
        "before lag[-1] behind lag[-1]"
    )


def test_a_plant_moves_as_in_the_loop():
    stack = plant.RealisticPlant(seed=3)
    system = systems.actuator_system(stack)
    time = np.arange(400) / 2000.0
    volts = 1.0 - np.cos(60 * time)
    for _ in range(2):  # it is opened again at t = 0
        response = control.input_output_response(system, time, volts)
        twin = plant.RealisticPlant(seed=3)
        assert response.outputs[1:].tolist() == twin.exchange(volts)[:-1].tolist()


def test_a_plant_in_a_feedback_loop_settles():
    """An integrator of python-control around the simulated stack."""
    integrator = control.tf([0.01, 0], [1, -1], 1 / 2000, inputs=["error"], outputs=["volts"], name="integrator")
    sum_ = control.summing_junction(["z_d", "-z"], "error")
    loop = control.interconnect(
        [integrator, sum_, systems.actuator_system(plant.RealisticPlant())], inputs=["z_d"], outputs=["z"]
    )
    response = control.input_output_response(loop, np.arange(1000) / 2000.0, np.full(1000, 10.0))
    assert np.abs(response.outputs[-200:] - 10.0).max() < 0.1


def test_what_is_no_actuator_is_refused():
    with pytest.raises(SettingError, match="model = 3: must be an ActuatorModel"):
        systems.model_system(3, FS)
    with pytest.raises(SettingError, match=r"driven = .*no exchange\(\)"):
        systems.actuator_system(MODEL)
    system = systems.actuator_system(plant.RealisticPlant())
    with pytest.raises(SettingError, match="continues from tick to tick"):
        control.input_output_response(system, np.arange(5, 10) / 2000.0, np.zeros(5))

    class Late(plant.RealisticPlant):
        def open(self):
            super().open()
            return Timing(sample_rate=2000.0, latency=1)

    with pytest.raises(SettingError, match="latency of the actuator = 1"):
        systems.actuator_system(Late())
