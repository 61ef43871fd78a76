"""Dead time and lag: against scipy's simulation, and inside their intervals in records of simulated stages."""

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from benchmarks import foreign_records, identify_speed, other_records
from scipy.signal import lsim

from truestroke.control import stage
from truestroke.identification import ActuatorModel, Record, load_model, save_model
from truestroke.identification.fitting import response
from truestroke.identification.fitting.procedure import data_of, fit_samples, time_constants
from truestroke.identification.fitting.regression import Structure
from truestroke.identification.fitting.response import _excerpt, _Quick, find_response
from truestroke.identification.records.series import series
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.model.sampled import respond

SPEC = importlib.util.spec_from_file_location(
    "time_constants", Path(__file__).parents[1] / "benchmarks/time_constants.py"
)
simulated = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(simulated)


def found(volts, displacement, sample_rate):
    record = series((volts, displacement, sample_rate))
    return find_response(data_of(record, volts.size, volts.size), 3e-3)


def test_lag_and_dead_time_against_a_simulation():
    """Lines between samples through 1 / (1 + 7 s) and 3 samples of dead time."""
    y = np.random.Generator(np.random.PCG64(1)).standard_normal(400)
    made = lsim(([1.0], [7.0, 1.0]), y - y[0], np.arange(400.0))[1] + y[0]
    np.testing.assert_allclose(respond(y, 3.0, 7.0)[3:], made[:-3], atol=1e-9)


MODES = (Mode(frequency=90.0, damping=0.02, share=0.7), Mode(frequency=250.0, damping=0.05, share=0.3))
STAGE = Dynamics(sample_rate=1000.0, modes=MODES, dead_time=1.2e-3)


@pytest.mark.parametrize("dynamics", [None, STAGE], ids=["", "stage"])
@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.7e-3), (3.3e-3, 0.0), (4e-3, 12e-3), (1.0, 0.0)])
def test_columns_are_behind_stage_lag_and_dead_time_as_a_signal_is(dynamics, delay, lag):
    """Natively, of every third sample: what `stage.through` and `respond` make of each column."""
    t = np.arange(800) / 1000.0
    x = 1.5 - 1.5 * np.cos(40 * t) * np.cos(3 * t)
    plain = data_of(series((x, 10 * x, 1000.0)), 800, 800)
    s = Structure(thresholds=(0.0, 0.4, 0.9), rate_dependent=(0, 2), creep_times=(0.05,), asymmetry=2)
    before = plain.columns(s, 10 * x)[:, :-1]
    data = dataclasses.replace(plain, every=3, displacement=plain.displacement[::3])
    data = dataclasses.replace(data, dynamics=dynamics, delay=delay, time_constant=lag)
    moved = before if dynamics is None else stage.through(dynamics, before)
    expected = respond(moved, 1e3 * delay, 1e3 * lag)[::3]
    np.testing.assert_allclose(data.columns(s, 10 * x)[:, :-1], expected, atol=1e-10 * np.abs(before).max())


def test_an_excerpt_has_rows_whose_states_are_known():
    """The fastest motion is at the start of a long record, before the voltage has covered its range."""
    t = np.arange(100_000) / 1e5
    x = 0.4 * np.sin(2 * np.pi * 3e3 * t) * (t < 0.05) + 10.0 * (t > 0.09) * (1 - np.cos(2 * np.pi * 5.0 * (t - 0.09)))
    data = data_of(series((x, 2 * x, 1e5)), x.size, x.size)
    quick = _excerpt(data, 0.0)
    assert quick.rows > 4000


@pytest.mark.parametrize("kind", simulated.KINDS[::3], ids=lambda kind: kind.__name__)
def test_true_values_are_inside_the_intervals(kind):
    """`benchmarks/time_constants.py` counts more of them."""
    made = simulated.record(kind, 5, seconds=4.0)
    response = found(made.volts, made.displacement, made.sample_rate)
    for true, (low, high) in (
        (made.dead_time, response.delay_interval),
        (made.lag, response.time_constant_interval),
    ):
        assert low <= true <= high
    assert response.delay_interval[1] - response.delay_interval[0] < 0.015


def test_one_slow_sine_says_that_it_cannot_separate_them():
    """2 ms of dead time under a sine of 1 Hz, straight: as good a lag, or next to nothing."""
    t = np.arange(4000) / 1000.0
    x, noise = 1.8 - 1.8 * np.cos(2 * np.pi * t), np.random.Generator(np.random.PCG64(2)).standard_normal(t.size)
    response = found(x, 18 - 18 * np.cos(2 * np.pi * np.maximum(t - 2e-3, 0.0)) + 0.05 * noise, 1000.0)
    assert not response.separable
    assert response.delay_interval[0] == response.time_constant_interval[0] == 0.0
    assert response.delay_interval[1] > 2e-3
    assert response.time_constant_interval[1] > 2e-3


def preisach(v):
    """Relays whose loops are most often of one width: at a turn next to nothing moves, as behind a dead time."""
    a, b = (g.ravel() for g in np.meshgrid(*2 * [np.linspace(0.0, 1.0, 40)]))
    a, b = a[a >= b], b[a >= b]
    weights, state, out = np.exp(-0.5 * (((a - b) / 2 - 0.08) / 0.16) ** 2), np.zeros(a.size), np.empty(v.size)
    for k, x in enumerate(v):
        state = np.maximum(np.clip(40 * (x - a), 0, 1), np.minimum(state, np.clip(40 * (x - b), 0, 1)))
        out[k] = 0.35 * x + 0.65 * (weights @ state) / weights.sum()
    return out


@pytest.mark.parametrize(("lag", "taken"), [(0.0, False), (0.02, True)])
def test_hysteresis_under_one_sine_is_no_dead_time(lag, taken):
    """2 Hz: turns of such relays are late by 6 % of a stroke, as of 16 ms of dead time. So is what has a lag of 20."""
    t = np.arange(2000) / 500.0
    x, noise = 0.5 - 0.5 * np.cos(4 * np.pi * t), np.random.Generator(np.random.PCG64(2)).standard_normal(t.size)
    y = preisach(x)
    y = respond(y, 0.0, 500.0 * lag)
    response = found(100 * x, 10 * y + 0.002 * noise, 500.0)
    assert (response.delay + response.time_constant > 0.0) == taken
    assert not response.separable
    for low, high in (response.delay_interval, response.time_constant_interval):
        assert low <= 0.0
        assert max(lag, 0.01) < high < 0.06


def test_intervals_are_no_longer_than_a_motion_that_shows_them():
    """Where both are 0, each alone takes all of the lateness away, and the curvature there says nothing."""
    t = np.arange(4000) / 500.0
    x = 50 - 25 * np.cos(4 * np.pi * t) - 20 * np.cos(2.6 * np.pi * t)
    noise = np.random.Generator(np.random.PCG64(2)).standard_normal(t.size)
    response = found(x, 0.1 * x + 2e-3 * noise, 500.0)
    assert response.delay_interval[1] < 0.02
    assert response.time_constant_interval[1] < 0.02


def test_a_lag_is_in_file_prediction_inverse_and_controller(tmp_path):
    model = ActuatorModel(
        thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.eye(3), stroke=20.0, voltage_range=(-1.0, 3.0),
        time_constant=0.01,
    )  # fmt: skip
    save_model(tmp_path / "model.toml", model)
    again = load_model(tmp_path / "model.toml")
    assert again.time_constant == 0.01
    step = again.predict(np.repeat([0.0, 1.0], [10, 50]), 1000.0)
    assert step[19] == pytest.approx(10 * (1 - np.exp(-0.95)), abs=0.05)  # the line to the step ends 0.5 ms before it
    t = np.arange(500) / 1000.0
    z = 5 - 5 * np.cos(2 * np.pi * 5 * t)
    volts = again.invert(z, 1000.0)
    np.testing.assert_allclose(volts[5:-5], (z + 0.01 * np.gradient(z, 1e-3))[5:-5] / 10, atol=1e-3)
    assert again.settings(1000.0).initial_weights[1] == pytest.approx(-0.01)


@pytest.mark.parametrize("lag", [0, 10])
def test_hysteresis_that_goes_on_behind_a_turn_is_no_lag(lag):
    """A Duhem actuator in a wave below 2 Hz, ms; plays alone leave intervals of 20 to 35."""
    t, rng = np.arange(4000) / 500.0, np.random.Generator(np.random.PCG64(11))
    v = foreign_records.wave(t, rng, 2.0)
    v = np.concatenate([np.linspace(v[0], v[0], 3), v])
    y = respond(foreign_records.duhem(v), 0.0, 0.5 * lag)
    response = found(100 * v, 20 * y + 4e-3 * rng.standard_normal(y.size), 500.0)
    assert 1e3 * (response.delay + response.time_constant) == pytest.approx(lag, abs=0.5)
    assert response.time_constant_interval[1] < (lag + 8) / 1e3


FREE = {
    **dict.fromkeys(("rate", "creep_times", "asymmetry", "thresholds", "drift")), "modes": False, "branches": True,
}  # fmt: skip


@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_the_final_model_decides_where_the_quick_one_hardly_prefers_a_lag(lag):
    """Relays with a coercive field that the quick model takes for a lag; and a true lag behind curved plays."""
    rng, t = np.random.Generator(np.random.PCG64(1 if lag else 0)), np.arange(3600) / 200.0
    if lag:
        v = foreign_records.sine(t, 1.0) * rng.uniform(0.3, 1.0, 100)[t.astype(int)]
        y = respond(20 * other_records.envelopes_of_tanh(v, rng), 0.0, 200.0 * lag)
    else:
        v = foreign_records.wave(t, rng, 2.0)
        y = 10 * other_records.polarisation(2 * v - 1, rng, 0.25)
    record = series((100 * v, y + 0.02 * rng.standard_normal(t.size), 200.0))
    quick = time_constants(record)
    assert quick.undecided
    assert quick.time_constant > 0.02
    fit, _, response = fit_samples(record, t.size, None, FREE)
    assert fit.model.time_constant == response.time_constant == (quick.time_constant if lag else 0.0)
    low, high = response.time_constant_interval
    assert low <= response.time_constant <= high
    assert high == quick.time_constant_interval[1]


def test_what_is_only_compared_is_not_fitted_to_the_last_digit(monkeypatch):
    """Six starts and the ends of intervals: what is found is the same but for a small part of its interval."""
    made, fitted = [], _Quick._fitted
    monkeypatch.setattr(_Quick, "_fitted", lambda *given: (made.append(given[1:]), fitted(*given))[1])
    volts, z = identify_speed.record(1200, excited=True)
    s = series(Record.from_arrays(volts, stage.through(identify_speed.MODES, z), sample_rate=2000.0))
    found = time_constants(s)
    few = len(made)
    monkeypatch.setattr(response, "NEARLY", 0.0)
    to_the_end = time_constants(s)
    assert few < 0.9 * (len(made) - few)
    for name in ("delay", "time_constant"):
        low, high = getattr(to_the_end, f"{name}_interval")
        assert abs(getattr(found, name) - getattr(to_the_end, name)) < 0.03 * (high - low)
