"""What no input may do: a displacement out of reach, an impossible state, absurd numbers, coarse sensors."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings, RunInterrupted, SettingError, metrics, run
from truestroke.control.reference import ReferenceController
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.runtime.batch import Simulation, SimulationError, simulate_many
from truestroke.signals.trajectories import random_wave

ROOT = Path(__file__).parents[1]
BASIC = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
REMEDY = r"within 90 um of 0 at 0 V, with a stroke of 30 um: zero the sensor, or subtract its reading at rest"


def drive(controller, ticks, start=0):
    """A wave, an actuator with play, some noise."""
    rng, memory = np.random.default_rng(1), 0.0
    for k in range(start, start + ticks):
        phase = 0.01 * k
        x = controller.command(15.0 - 14.0 * np.cos(phase), 280.0 * np.sin(phase))
        memory = max(x - 0.45, min(x + 0.45, memory))
        controller.adapt(9.0 * x + 4.0 * memory + rng.normal(0.0, 0.01))


def same(before, after) -> bool:
    return all(np.array_equal(before[name], after[name]) for name in before)


# ---- A displacement that the actuator cannot have --------------------------------------------------------------------


@pytest.mark.parametrize("make", [AdaptiveController.from_settings, ReferenceController])
@pytest.mark.parametrize("settings", [ControllerSettings(**BASIC), ControllerSettings.paper(**BASIC)])
def test_a_sensor_that_is_not_zeroed_is_refused_at_the_first_measurement(make, settings) -> None:
    for z in (200.0, -200.0, 1e9, -1.7e308):
        controller = make(settings)
        controller.command(0.0, 0.0)
        for _ in range(2):  # nothing has changed: it is still the first
            with pytest.raises(SettingError, match=REMEDY) as caught:
                controller.adapt(z)
            assert caught.value.argument == "z_measured"
            assert caught.value.value == z
        controller.adapt(float("nan"))  # no number: not a first measurement either
        with pytest.raises(SettingError, match=REMEDY):
            controller.adapt(z)
        controller.adapt(5.0)
        controller.command(0.0, 0.0)
        controller.adapt(z)  # in mid-run a measurement is used or rejected
        controller.reset()
        controller.command(0.0, 0.0)
        with pytest.raises(SettingError, match=REMEDY):
            controller.adapt(z)


@pytest.mark.parametrize("make", [AdaptiveController.from_settings, ReferenceController])
def test_start_believes_what_volts_and_stroke_allow(make) -> None:
    controller = make(ControllerSettings(**BASIC))
    drive(controller, 50)
    weights = controller.weights
    for volts, z in [(0.0, 200.0), (0.0, 1e6), (1.5, -150.0), (3.6, 1e308)]:
        with pytest.raises(SettingError, match=r"z = .* um: must be within .* subtract its reading at rest"):
            controller.start(volts, z)
        assert np.array_equal(controller.weights, weights)
    for volts, z in [(0.0, 89.0), (3.6, 150.0), (-0.6, -60.0)]:
        controller.start(volts, z)
        assert controller.command(z, 0.0) == pytest.approx(volts, abs=1e-9)
    narrow = make(ControllerSettings(**BASIC, measurement_limit=40.0))
    with pytest.raises(SettingError, match="within 40 um"):
        narrow.start(0.0, 41.0)


def test_late_measurements_and_blocks_are_refused_alike_and_nothing_changes() -> None:
    controller = AdaptiveController(**BASIC)
    before = controller.state()
    ticks = np.zeros(10)
    for late in (0, 3):
        with pytest.raises(SettingError, match=REMEDY):
            controller.process(ticks, ticks, ticks + 200.0, ago=late)
        assert same(before, controller.state())
    controller.process(ticks, ticks, ticks)
    controller.process(ticks, ticks, ticks + 200.0)
    for _ in range(3):
        controller.start(0.0, 0.0), controller.command(0.0, 0.0), controller.command(0.0, 0.0)
        with pytest.raises(SettingError, match=REMEDY):
            controller.adapt(200.0, 1)


class NotZeroed(RealisticPlant):
    def exchange(self, volts):
        return super().exchange(volts) + 200.0


def test_every_loop_tells_that_the_sensor_is_not_zeroed(monkeypatch) -> None:
    wave = random_wave(duration=0.6, seed=1)
    with pytest.raises(RunInterrupted, match="zero the sensor"):
        run(wave, AdaptiveController(**BASIC), NotZeroed(seed=1))
    kernel = AdaptiveController(**BASIC)._kernel
    nanometre = ControllerSettings(**BASIC | {"stroke": 1e-5})  # the noise is beyond three of them
    one = Simulation(trajectory=wave, controller=nanometre, plant=PlantSettings(), seed=0)
    with pytest.raises(SimulationError, match="zero the sensor"):
        simulate_many([one])
    kernel.require_reach()  # nothing was refused


def test_after_a_history_of_silence_no_measurement_raises() -> None:
    controller = AdaptiveController(**BASIC)
    for _ in range(1026):
        controller.command(0.0, 0.0)
    controller.adapt(1e4)
    assert controller.flags.rejected


@pytest.mark.parametrize("offset", [0.0, 5.0, -5.0])
def test_a_stroke_told_three_times_too_small_and_an_offset_work_as_before(offset) -> None:
    wave = random_wave(duration=2.0, seed=1)
    controller = AdaptiveController(**BASIC | {"stroke": 10.0})
    plant = RealisticPlant(seed=1)
    plant.open()
    errors = []
    for z_d, rate in zip(wave.position, wave.velocity, strict=True):
        controller.adapt(plant.exchange(np.array([controller.command(z_d + offset, rate)]))[0] + offset)
        errors.append(plant.truth[0] - z_d)
    assert metrics.rmse(np.array(errors[2000:]), np.zeros(2000)) < 0.15


# ---- A state that no run leaves behind ------------------------------------------------------------------------------


def spoil(name, place, value):
    return lambda state: state[name].__setitem__(place, value)


def spoil_flag(state):
    state["flags"].view(np.uint8)[2] = 7


BAD_STATES = {
    "counters": [("counters", 0, 2**63), ("counters", 0, 10), ("counters", 2, 10**6), ("counters", 5, 111)],
    "lagged_ticks": [("lagged_ticks", 0, 2**63), ("lagged_ticks", 0, 111)],
    "beyond": [("beyond", 0, -1), ("beyond", 0, 11)],
    "noise": [("noise", 0, -1.0), ("noise", 0, np.nan)],
    "ringing": [("ringing", 0, -1e-9)],
    "innovation_variance": [("innovation_variance", 0, -1.0)],
    "covariance": [("covariance", 0, -1.0), ("covariance", 1, 99.0), ("covariance", 9, np.inf)],
    "change": [("change", 0, 1e9)],
    "widest_motion": [("widest_motion", 0, -1.0)],
    "since_change": [("since_change", 0, -500)],  # the law waits for a found stage, a period of 40 Hz at most
    "resonance_search": [("resonance_search", 1, 1e-30), ("resonance_search", -2, 0.1)],  # and a load of no frequency
    "spikes": [("spikes", 0, -(2**31))],
    "since_return": [("since_return", 0, 2**31 - 1)],
    "play": [("play", 3, 40.0), ("play", 0, 1e300)],
    "slopes": [("slopes", 0, 0.0), ("slopes", 2, -1.0)],
    "weights": [("weights", 0, np.nan), ("weights", 0, 1e200)],
    "resolution": [("resolution", 0, -1.0)],
    "fastest": [("fastest", 0, -1.0)],
    "covariance_diagonal": [("covariance_diagonal", 2, -1.0)],
    "covariance_factor": [("covariance_factor", 0, 2.0), ("covariance_factor", 1, 0.5)],
    "covariance_trace": [("covariance_trace", 0, -1.0)],
}


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("law", ["kalman", "rls"])
def test_restore_names_the_entry_that_no_run_leaves_behind(law, precision) -> None:
    controller = AdaptiveController(**BASIC, law=law, precision=precision)
    drive(controller, 110)
    before = controller.state()
    faults = [(name, spoil(*fault)) for name, several in BAD_STATES.items() for fault in several if fault[0] in before]
    faults += [("flags", spoil_flag)]
    for name in ("hold", "history_limited"):
        faults += [(name, lambda state, name=name: state[name].view(np.uint8).__setitem__(0, 255))]
    for name, fault in faults:
        bad = {key: np.array(value) for key, value in controller.state().items()}
        with np.errstate(over="ignore"):
            fault(bad)
        with pytest.raises(ValueError, match=f"state entry {name}"):
            controller.restore(bad)
        assert same(before, controller.state()), name
    controller.restore(before)
    drive(controller, 50, 110)


# ---- Any finite number ----------------------------------------------------------------------------------------------

ABSURD = (0.0, -0.0, 5e-324, 1e-300, 1e30, -1e30, 1e60, 1e154, -1e155, 1.7e308, -1.7e308)


@pytest.mark.parametrize("law", ["kalman", "rls"])
def test_no_finite_argument_makes_a_state_that_is_not_finite(law) -> None:
    """Kernel and NumPy text, to the last bit, among plausible ticks."""
    settings = ControllerSettings(**BASIC, law=law, trim_rate=20.0, measurement_limit=1e9)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    rng = np.random.default_rng(3)
    drive(kernel, 20), drive(text, 20)
    for k in range(400):
        odd = rng.random(3) < 0.2
        z_d, rate, z = np.where(odd, rng.choice(ABSURD, 3), [15.0 + 10 * np.sin(0.1 * k), 100.0, 14.0 + rng.random()])
        volts = kernel.command(z_d, rate)
        assert volts == text.command(z_d, rate)
        assert -0.6 <= volts <= 3.6
        kernel.adapt(z), text.adapt(z)
        assert np.array_equal(kernel.weights, text.weights)
        assert all(np.isfinite(value).all() for value in kernel.state().values())


# ---- A coarse sensor ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.1, 0.3, 0.5, 1.0])
def test_the_good_samples_of_a_coarse_quiet_sensor_are_used(step) -> None:
    """A converter whose steps are larger than the noise repeats numbers while the actuator moves."""
    controller, plant, wave = AdaptiveController(**BASIC), RealisticPlant(seed=1), random_wave(duration=4.0, seed=1)
    plant.open()
    errors = []
    for z_d, rate in zip(wave.position, wave.velocity, strict=True):
        controller.adapt(step * np.round(plant.exchange(np.array([controller.command(z_d, rate)]))[0] / step))
        errors.append(plant.truth[0] - z_d)
    assert controller.counters.rejected <= 40  # of 8000; most of them in the cold start
    assert np.abs(errors[4000:]).max() < step


def test_a_coarse_sensor_that_freezes_is_not_believed() -> None:
    controller, plant, wave = AdaptiveController(**BASIC), RealisticPlant(seed=1), random_wave(duration=4.0, seed=1)
    plant.open()
    errors = []
    for k, (z_d, rate) in enumerate(zip(wave.position, wave.velocity, strict=True)):
        z = plant.exchange(np.array([controller.command(z_d, rate)]))[0]
        if not 4000 <= k < 5000:
            shown = 0.3 * np.round(z / 0.3)
        controller.adapt(shown)
        errors.append(plant.truth[0] - z_d)
    assert controller.counters.rejected > 900
    assert np.abs(errors[4000:]).max() < 0.5


# ---- Settings of any kind --------------------------------------------------------------------------------------------


def test_settings_of_any_kind_are_refused_by_name_or_run() -> None:
    """A seeded part of benchmarks/fuzz_settings.py; before, a tenth of them raised what was no SettingError."""
    spec = importlib.util.spec_from_file_location("fuzz_settings", ROOT / "benchmarks/fuzz_settings.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    counts, wrong = module.campaign(draws=1000, seed=1)
    assert not wrong
    assert counts["run"] > 100
    assert counts["refused"] > 500


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        ("sample_rate", 5e-324, "sample_rate = 5e-324 Hz: must be from 1e-06 to 1e.08 Hz"),
        ("stroke", 1e300, "stroke = 1e.300 um: must be from 1e-06 to 1e.09 um"),
        ("stroke", 10**400, "stroke = .*: must be a number"),
        ("voltage_limits", (0.0, 5e-324), "voltage_limits = .* at least 1e-9 V apart"),
        ("creep_times", 0.3, "creep_times = 0.3 s: must be a sequence"),
        ("lag", np.zeros(2), "lag = .*: must be True or False"),
        ("law", np.zeros(2), "law = .*: must be 'kalman' or 'rls'"),
        ("prior_covariance", np.eye(39) * 1e200, "prior_covariance = 1e.200: must be of entries up to 1e.60"),
        ("prior_return_time", 1e-300, "prior_return_time = 1e-300 s: must be from 1e-15"),
    ],
)
def test_a_setting_that_does_not_compute_is_named(setting, value, words) -> None:
    with pytest.raises(SettingError, match=words) as caught:
        ControllerSettings(**BASIC | {setting: value})
    assert caught.value.argument == setting


def test_the_paper_names_what_is_wrong_too() -> None:
    for given in ({"stroke": "x"}, {"stroke": 1e300}, {"voltage_limits": (0.0, 1e300)}):
        with pytest.raises(SettingError, match=next(iter(given))):
            ControllerSettings.paper(**BASIC | given)
    with pytest.raises(SettingError, match=r"thresholds = 1\.0 V: must be a sequence"):
        ControllerSettings.paper(**BASIC, thresholds=1.0)


def test_what_single_precision_cannot_hold_is_said() -> None:
    with pytest.raises(SettingError, match=r"precision = 'single': must be wider .* measurement_limit"):
        AdaptiveController(**BASIC, precision="single", measurement_limit=1e12)
    controller = AdaptiveController(**BASIC, precision="single")
    with pytest.raises(SettingError, match="precision"):
        controller.change(measurement_limit=1e12)
    assert controller.settings.measurement_limit == 300.0
