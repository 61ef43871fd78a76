"""Never worse than not learning: bursts end, other reasons cost a hold, and a change is learned as before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings, run, trajectories
from truestroke.control.baselines import ConstantGain
from truestroke.control.guard import Action, Guard, GuardSettings
from truestroke.control.reference import ReferenceController
from truestroke.plant import Change, PlantSettings, RealisticPlant, StagePlant, StageSettings
from truestroke.studies.robustness import fast

SPAN = 15.0  # um
LIMITS = {"stroke": 30.0, "voltage_limits": (-0.6, 3.6)}


def stage(f0: float, rate: float = 10_000.0) -> StageSettings:
    return StageSettings(sample_rate=rate, resonances=(f0,), dampings=(0.01,), hysteresis_kind="preisach", noise=0.02)


def errors(recording) -> tuple[float, float]:
    """Of the second half, % of the span: rms and largest."""
    error = (100 / SPAN * (recording["true"] - recording["desired"]))[recording["true"].size // 2 :]
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


@pytest.mark.parametrize(
    ("f0", "frequency", "rate", "told"),
    [(300.0, 100.0, 10_000.0, 1.3), (90.0, 20.0, 10_000.0, 1.3), (700.0, 233.0, 10_000.0, None)],
    ids=["f0 30 % wrong", "soft, 30 % wrong", "nothing known"],
)
def test_what_burst_before_is_better_than_a_straight_line(f0, frequency, rate, told) -> None:
    """Without the guard up to 1088, 962 and 349 % of peak to peak."""
    settings = stage(f0, rate)
    dynamics = None if told is None else dataclasses.replace(settings, resonances=(f0 * told,)).dynamics()
    wave = trajectories.sine(frequency=frequency, peak_to_peak=SPAN, duration=2.0, sample_rate=rate)
    controller = AdaptiveController(sample_rate=rate, **LIMITS, dynamics=dynamics, slew_limit=1e5)
    rms, largest = errors(run(wave, controller, StagePlant(settings)))
    assert 1 <= controller.counters.restored <= 6
    assert largest < 60
    line = ConstantGain(30.0 / 3.6, LIMITS["voltage_limits"])
    straight = run(wave, line, StagePlant(settings))
    half = straight["true"].size // 2
    gain, offset = np.polyfit(straight["true"][half:], straight["desired"][half:], 1)
    assert rms < np.std(straight["desired"][half:] - gain * straight["true"][half:] - offset) * 100 / SPAN


def test_a_stage_that_the_measurements_show_is_not_taken_out() -> None:
    """Weights that were held and were no better: with the stage taken out 22 %. The sampled stage has 79 Hz."""
    recording = fast.record(6, 98, "unknown")
    error = (recording["true"] - recording["desired"])[recording["true"].size // 2 :]
    assert 100 * error.std() / np.ptp(recording["desired"]) < 2


def test_half_of_the_motion_is_a_failure_in_the_windows_after_a_hold_too() -> None:
    """A smaller error is none there."""
    for size, action in ((0.3, Action.NOTHING), (0.6, Action.RESTORE)):
        guard = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.02))
        guard.pause = 100
        motion = np.sin(np.arange(2, 502) * 2 * np.pi / 100)  # 2 um
        error = size * 2.0 * np.sqrt(2) * np.sin(np.arange(500) * 2 * np.pi / 20)
        found = {guard.update(e, z_d, counts=True, noise=1e-3) for e, z_d in zip(error, motion, strict=True)}
        assert found == {Action.NOTHING, action}


def test_a_sudden_change_is_no_failure_of_learning() -> None:
    """The guard does nothing: it is learned as without it."""
    plant = PlantSettings(sample_rate=2000.0, change=Change(time=1.0, gain=0.8, hysteresis=1.3))
    wave = trajectories.sine(frequency=8.0, peak_to_peak=SPAN, duration=2.0)
    controller = AdaptiveController(sample_rate=2000.0, **LIMITS)
    rms, _ = errors(run(wave, controller, RealisticPlant(plant)))
    assert controller.counters.changed >= 1
    assert controller.counters.restored == 0
    assert rms < 2.5


def watched(controller, calms: bool) -> list[list[float]]:
    """Commands, flags and weights where z leaves z_d by 6 um at 0.5 s, until weights are held if it `calms`."""
    rng, shaken, seen = np.random.default_rng(3), False, []
    for k in range(1500):
        z_d = 15 - 10 * np.cos(0.02 * k)
        volts = controller.command(z_d, 4.0 * np.sin(0.02 * k) * 50)
        shaken = k > 500 and not (calms and (controller.flag_bits & 128 or (not shaken and k > 501)))
        controller.adapt(z_d + 0.02 * rng.standard_normal() + shaken * 6 * np.sin(1.3 * k))
        seen.append([volts, controller.flag_bits, *controller.weights])
    return seen


@pytest.mark.parametrize("calms", [True, False], ids=["held weights are better", "they are not"])
def test_kernel_and_text_restore_and_return_to_the_last_bit(calms) -> None:
    settings = ControllerSettings(sample_rate=1000.0, **LIMITS, plays=4, outliers=0)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    seen = np.array(watched(kernel, calms))
    np.testing.assert_array_equal(seen, watched(text, calms))
    held = seen[:, 1].astype(int) & 128 > 0
    begins = np.flatnonzero(np.diff(held.astype(int)) > 0)
    assert 500 < begins[0] < 800
    assert kernel.counters.restored == text.counters["restored"] == begins.size
    ends = np.flatnonzero(np.diff(held.astype(int)) < 0)
    at_best, failed, after = seen[490, 2:], seen[begins[0], 2:], seen[ends[0] + 1, 2:]
    nearer_to_the_best = np.linalg.norm(after - at_best) < np.linalg.norm(after - failed)
    assert nearer_to_the_best == calms  # where learning was not the cause it goes on as if nothing had happened


def decided(errors_: np.ndarray) -> list[tuple[int, Action]]:
    """When the guard decides what, at errors of a motion of 20 um."""
    guard = Guard(GuardSettings(window=50, range_rate=1e-3, floor=0.05))
    found = [guard.update(e, 10 * np.sin(0.1 * k), counts=True, noise=1e-3) for k, e in enumerate(errors_.tolist())]
    return [(k, action) for k, action in enumerate(found) if action not in (Action.NOTHING, Action.KEEP)]


def test_an_error_that_falls_is_learned_and_one_that_lasts_is_undone() -> None:
    k = np.arange(4000)
    wave, later = np.sin(0.9 * k), np.maximum(k - 1000, 0)
    assert decided(0.05 * wave + np.where(k >= 1000, 8.0, 0.0) * wave * np.exp(-later / 40)) == []
    grows = decided(0.05 * wave * np.exp(later / 200))
    assert grows[0][1] is Action.RESTORE
    assert grows[0][0] < 2500
    (lasts, *others) = decided(0.05 * wave + np.where(k >= 1000, 2.0, 0.0) * wave)
    assert lasts == (1149, Action.RESTORE)  # three windows of 50 ticks
    assert [action for _, action in others[:2]] == [Action.FIRST, Action.RETURN]


def test_what_is_no_longer_kept_does_not_excuse_an_error() -> None:
    """After held weights that were no better, errors are judged without the best of what was given up: 7 % that stay
    are a failure, though the weights before had 1.8 %."""
    k = np.arange(6000)
    part = np.select([k < 1000, k < 1600], [0.018, 0.3], 0.07)  # of 20 um
    actions = decided(part * 20 * np.sqrt(2) * np.sin(0.9 * k))
    assert [action for _, action in actions[:4]] == [Action.RESTORE, Action.FIRST, Action.RETURN, Action.RESTORE]
    assert actions[2][0] < 1600 < actions[3][0]


def wavering(controller, frequency: float) -> list[list[float]]:
    """Commands, flags and weights where the sensor shows an oscillation that grows and stays, whatever the voltage."""
    rng, seen = np.random.default_rng(3), []
    for k in range(1400):
        z_d = 15 - 10 * np.cos(0.012 * k)
        volts = controller.command(z_d, 120.0 * np.sin(0.012 * k))
        size = 0.05 * np.exp(min(k - 300, 60) / 15) if k > 300 else 0.0
        wave = size * np.sin(2 * np.pi * frequency * k / 1000)
        controller.adapt(z_d + 0.02 * rng.standard_normal() + wave)
        seen.append([volts, controller.flag_bits, *controller.weights])
    return seen


@pytest.mark.parametrize(("frequency", "forgotten"), [(24.0, True), (45.0, False)])
def test_an_oscillation_below_where_a_stage_is_looked_for_is_forgotten_where_nothing_else_helps(
    frequency, forgotten
) -> None:
    settings = ControllerSettings(sample_rate=1000.0, **LIMITS, plays=4, outliers=0)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    np.testing.assert_array_equal(wavering(kernel, frequency), wavering(text, frequency))
    assert kernel.counters.oscillating >= 1
    assert np.isnan(kernel.resonance) == forgotten


def test_a_burst_at_the_start_is_stopped_and_shows_the_stage() -> None:
    """Kernel and text, to the last bit, on a stage that moved by four times its stroke before (376 um)."""
    sampled = fast.sample(0, 174, ["unknown"])
    settings, wave = sampled.controllers["unknown"], sampled.motions["unknown"]
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant, largest = StagePlant(sampled.plant, sampled.seed), 0.0
    plant.open()
    for k in range(2100):
        motion = wave.position[k], wave.velocity[k]
        volts = kernel.command(*motion)
        assert text.command(*motion) == volts
        z = float(plant.exchange(np.array([volts]))[0])
        kernel.adapt(z)
        text.adapt(z)
        largest = max(largest, abs(z - motion[0]))
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert kernel.counters.restored == text.counters["restored"] == 1
    assert kernel.resonance == pytest.approx(54.0, rel=0.06)
    assert largest < 60.0


def test_an_error_at_the_start_is_no_burst_where_the_stage_is_given() -> None:
    """The first weights were held there, and a stage of 51 Hz rang on for seconds."""
    sampled = fast.sample(8, 100, ["measured"])
    controller, wave = AdaptiveController.from_settings(sampled.controllers["measured"]), sampled.motions["measured"]
    plant = StagePlant(sampled.plant, sampled.seed)
    plant.open()
    for k in range(600):
        volts = controller.command(wave.position[k], wave.velocity[k], wave.acceleration[k])
        controller.adapt(float(plant.exchange(np.array([volts]))[0]))
    assert controller.counters.restored == 0
