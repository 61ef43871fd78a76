"""Ticks without Python between them are the ticks of the loop, to the last bit: recording, state, progress, faults."""

import copy

import numpy as np
import pytest
from fakes.in_python import InPython

from truestroke import AdaptiveController, Dynamics, Mode, RunInterrupted, run
from truestroke.plant import Change, MatchedPlant, PlantSettings, RealisticPlant, StagePlant, StageSettings
from truestroke.runtime import native
from truestroke.signals.trajectories import random_wave, raster, sine

RANGE = {"stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
RATE = 10_000.0
KNOWN = Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=1e-4)
FAST = sine(frequency=211.0, peak_to_peak=12.0, offset=12.0, duration=0.4, ramp=0.1, sample_rate=RATE)
SLOW = random_wave(duration=0.7, seed=3)
CHANGE = Change(time=0.4, gain=0.7, hysteresis=1.4)


def stage(**given):
    return StagePlant(StageSettings(dead_time=1e-4, hum=0.05, **given), seed=2, dropouts=[(3, 9), (2000, 2120)])


PAIRS = {
    "default": (SLOW, {"sample_rate": 2000.0}, lambda: RealisticPlant(PlantSettings(change=CHANGE), seed=1)),
    "sensor that drops out": (SLOW, {"sample_rate": 2000.0}, lambda: RealisticPlant(seed=4, dropouts=[(0, 70)])),
    "matched": (SLOW, {"sample_rate": 2000.0}, lambda: MatchedPlant(SLOW.velocity, seed=5)),
    "all of it": (FAST, {"sample_rate": RATE, "dynamics": KNOWN, "hum": 50.0, "slew_limit": 1e4}, stage),
    "inertia": (FAST, {"sample_rate": RATE, "inertia": True, "slew_limit": 1e4}, stage),
    "limits are met": (SLOW, {"sample_rate": 2000.0, "slew_limit": 30.0, "voltage_limits": (0.0, 2.0)}, RealisticPlant),
    "single precision": (SLOW, {"sample_rate": 2000.0, "precision": "single"}, RealisticPlant),
}


def controller(given):
    return AdaptiveController(**{**RANGE, **given})


def same(one, other):
    """Recordings with the same bits in every channel."""
    assert one.channels.keys() == other.channels.keys()
    for name in one.channels:
        np.testing.assert_array_equal(one[name], other[name], name, strict=True)


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize("name", PAIRS)
def test_every_channel_and_the_state_afterwards_have_the_bits_of_the_loop(name):
    wave, given, plant = PAIRS[name]
    fast, slow, moved, called = controller(given), controller(given), plant(), InPython(plant())
    same(run(wave, fast, moved), run(wave, slow, called))
    for entry, value in slow.state().items():
        np.testing.assert_array_equal(fast.state()[entry], value, entry)
    assert moved.truth == called.plant.truth
    if not isinstance(moved, MatchedPlant):  # it is where it would be: plant and noise go on alike
        np.testing.assert_array_equal(moved.exchange(np.full(300, 0.5)), called.plant.exchange(np.full(300, 0.5)))


def test_these_pairs_are_native_and_others_are_not(monkeypatch):
    for wave, given, plant in PAIRS.values():
        assert native.pair(wave, controller(given), plant(), [wave.position, wave.velocity]) is not None

    class Own(AdaptiveController):
        pass

    desired = [SLOW.position, SLOW.velocity]
    usual = controller({"sample_rate": 2000.0})
    replaced, commanded, patched = copy.deepcopy(usual), copy.deepcopy(usual), RealisticPlant()
    replaced.adapt = lambda z, ago=0: None
    commanded.command = lambda z_d, zdot_d: 0.0
    patched.exchange = lambda volts: 10.0 * volts
    own = Own(sample_rate=2000.0, **RANGE)
    for of in (own, replaced, commanded):
        assert native.pair(SLOW, of, RealisticPlant(), desired) is None
    for plant in (patched, InPython(None)):
        assert native.pair(SLOW, usual, plant, desired) is None
    assert native.pair(SLOW, usual, MatchedPlant(2 * SLOW.velocity), desired) is None  # another motion
    single = controller({"sample_rate": 2000.0, "precision": "single"})
    assert native.pair(SLOW, single, RealisticPlant(), [1e39 * SLOW.position, SLOW.velocity]) is None
    monkeypatch.setattr(RealisticPlant, "exchange", InPython.exchange)
    assert native.pair(SLOW, usual, RealisticPlant(), desired) is None


def test_a_second_run_continues_from_the_state_of_the_first():
    fast, slow = controller({"sample_rate": 2000.0}), controller({"sample_rate": 2000.0})
    for _ in range(2):
        same(run(SLOW, fast, RealisticPlant(seed=1)), run(SLOW, slow, InPython(RealisticPlant(seed=1))))


def test_progress_has_the_same_ticks():
    wave = raster(frequency=5.0, duration=0.6, sample_rate=2000.0)
    seen = {}
    for name, plant in (("native", RealisticPlant()), ("loop", InPython(RealisticPlant()))):
        seen[name] = []
        run(wave, controller({"sample_rate": 2000.0}), plant, lambda *done, to=seen[name]: to.append(done))
    assert seen["native"] == seen["loop"]
    assert len(seen["native"]) == 100


def test_what_was_recorded_is_kept_when_a_run_is_interrupted():
    def stop(done, _):
        if done > 700:
            raise KeyboardInterrupt

    kept = []
    for plant in (RealisticPlant(seed=1), InPython(RealisticPlant(seed=1))):
        with pytest.raises(RunInterrupted, match="after 714 ticks: KeyboardInterrupt") as interrupted:
            run(SLOW, controller({"sample_rate": 2000.0}), plant, stop)
        kept.append(interrupted.value.recording)
    same(*kept)


@pytest.mark.parametrize("silent", [0, 40])
def test_a_first_measurement_that_is_beyond_reach_ends_both_alike(silent):
    kept = []
    for wrap in (lambda plant: plant, InPython):
        plant = wrap(
            StagePlant(StageSettings(load=500.0, load_on_stage=False), dropouts=[(0, silent)])
        )  # um: no zero of the sensor
        with pytest.raises(RunInterrupted, match=f"after {silent} ticks: SettingError z_measured") as interrupted:
            run(FAST, controller({"sample_rate": RATE, "slew_limit": 1e4}), plant)
        kept.append(interrupted.value.recording)
    same(*kept)
