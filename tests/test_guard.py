"""Never worse than not learning: bursts end, other reasons cost a hold, and a change is learned as before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from benchmarks import changing_motion, fixed_loads, growing_motion

from truestroke import AdaptiveController, ControllerSettings, run, trajectories
from truestroke.control.baselines import ConstantGain
from truestroke.control.guard import Action, Guard, GuardSettings, Recall
from truestroke.control.reference import ReferenceController
from truestroke.control.reference.learned import take_weights
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
    ("f0", "frequency", "rate", "told", "restored"),
    [(300.0, 100.0, 10_000.0, 1.3, 0), (90.0, 20.0, 10_000.0, 1.3, 1), (700.0, 233.0, 10_000.0, None, 0)],
    ids=["f0 30 % wrong", "soft, 30 % wrong", "nothing known"],
)
def test_what_burst_before_is_better_than_a_straight_line(f0, frequency, rate, told, restored) -> None:
    """Without the guard up to 1088, 962 and 349 % of peak to peak. Where nothing is known, the stage is found first."""
    settings = stage(f0, rate)
    dynamics = None if told is None else dataclasses.replace(settings, resonances=(f0 * told,)).dynamics()
    wave = trajectories.sine(frequency=frequency, peak_to_peak=SPAN, duration=2.0, sample_rate=rate)
    controller = AdaptiveController(sample_rate=rate, **LIMITS, dynamics=dynamics, slew_limit=1e5)
    rms, largest = errors(run(wave, controller, StagePlant(settings)))
    assert restored <= controller.counters.restored <= 6
    assert largest < (60 if told else 0.5)
    line = ConstantGain(30.0 / 3.6, LIMITS["voltage_limits"])
    straight = run(wave, line, StagePlant(settings))
    half = straight["true"].size // 2
    gain, offset = np.polyfit(straight["true"][half:], straight["desired"][half:], 1)
    assert rms < np.std(straight["desired"][half:] - gain * straight["true"][half:] - offset) * 100 / SPAN


def test_the_second_mode_does_not_take_the_place_of_given_dynamics() -> None:
    """The law drifts to 1.7 % at a harmonic near the second mode; a stage of 1.6 f0 in its place burst to 1900 %."""
    recording = fast.record(0, 59, "measured")
    error = (recording["true"] - recording["desired"])[recording["true"].size // 8 :]
    assert 100 * np.abs(error).max() / np.ptp(recording["desired"]) < 15


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


def go_on(guard: Guard, size: float, windows: int) -> list[Action]:
    """Windows of a motion of 2 um with this error over its range: what is decided at their ends."""
    k = np.arange(100 * windows)
    error, z_d = size * 2.0 * np.sqrt(2) * np.sin(2 * np.pi * k / 20), np.sin(2 * np.pi * k / 100)
    pairs = zip(error.tolist(), z_d.tolist(), strict=True)
    return [guard.update(*pair, counts=True, noise=1e-3) for pair in pairs][99::100]


@pytest.mark.parametrize(
    ("before", "made", "windows"),
    [(0.04, 0.3, 5), (0.04, 0.09, None), (0.15, 0.3, None)],
    ids=["harms", "a little", "as bad without it"],
)
def test_a_stage_that_harms_is_a_failure_in_the_windows_after_it_entered(before, made, windows) -> None:
    """Errors over the range, without the stage and with it: in so many windows."""
    guard = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.02))
    guard.wait = 20
    go_on(guard, before, 5)
    guard.begin()
    actions = go_on(guard, made, 10)
    assert (actions.index(Action.RESTORE) + 1 if Action.RESTORE in actions else None) == windows


def test_what_a_stage_harmed_is_no_failure_again_in_the_windows_after_a_hold() -> None:
    """Held weights were no better, so learning was not the cause: the next failure waits for its five windows."""
    guard = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.02))
    go_on(guard, 0.04, 5)
    guard.begin()
    actions = go_on(guard, 0.3, 40)
    ended = next(i for i, action in enumerate(actions) if action in (Action.RETURN, Action.ADOPT))
    assert actions.index(Action.RESTORE, ended) - ended > 5


@pytest.mark.parametrize(
    ("size", "missed", "action"),
    [
        (0.05, 0.02, Action.RESTORE),
        (0.05, 0.03, Action.NOTHING),
        (0.05, 1.0, Action.NOTHING),
        (0.55, 1.0, Action.RESTORE),
    ],
)
def test_weights_that_would_have_half_of_the_error_are_not_held(size, missed, action) -> None:
    """Over the range of the motion; an error beyond half of it is ended, whatever is kept."""
    guard, found = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.002)), []
    for k in range(2000):
        part = 0.001 if k < 1000 else size
        if guard.bad > 0:
            guard.compare(5.0 + 20 * missed * np.sqrt(2) * np.sin(0.7 * k))  # a mean is an offset
        found.append(
            guard.update(20 * part * np.sqrt(2) * np.sin(0.9 * k), 10 * np.sin(0.05 * k), counts=True, noise=1e-3)
        )
        if found[-1] is Action.RESTORE:
            break
    assert found[-1] is action


def test_what_kept_weights_missed_counts_until_they_are_asked_again() -> None:
    """Where nothing is learned they are not: a hold of another kind, say. Then they had been held at once, at 124 %."""
    guard, found = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.002)), set()
    for k in range(3000):
        if guard.bad > 0 and k < 2000:
            guard.compare(20 * np.sqrt(2) * np.sin(0.7 * k))
        error = 20 * (0.001 if k < 1000 else 0.05) * np.sqrt(2) * np.sin(0.9 * k)
        found.add(guard.update(error, 10 * np.sin(0.05 * k), counts=True, noise=1e-3))
    assert Action.RESTORE not in found


def test_weights_of_a_slow_motion_are_not_held_in_a_fast_one() -> None:
    """f0 given 15 % too low: they were 50 to 80 % off in a sine of f0/4, where the error was 4 %."""
    _, error, _ = changing_motion.follow(5118, 0.85, measured=False, last="fast")
    assert error["fast"][1] < 25
    assert error["fast"][0] < 5


def test_held_weights_that_are_far_worse_are_not_held_on() -> None:
    """Without the rule they stay for four windows, and then the first weights for four more."""
    guard, windows = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.002)), []
    for k in range(6000):
        swing = 0.02 if k < 3000 else 5.0 if guard.held else 0.6
        action = guard.update(swing * np.sin(0.9 * k), 10 * np.sin(0.05 * k), counts=True, noise=0.001)
        if action in (Action.RESTORE, Action.FIRST, Action.ADOPT, Action.RETURN):
            windows.append((action, k // 100))
    (first, begun), (second, ended) = windows[:2]
    assert (first, second) == (Action.RESTORE, Action.RETURN)
    assert ended - begun == 2


@pytest.mark.parametrize(("before", "windows"), [(9.0, 3), (3.0, 5)])
def test_weights_of_a_smaller_motion_prove_nothing_of_a_larger_one(before, windows) -> None:
    """In 5 windows a motion that is more than twice as large may be learned, in 3 one that is not."""
    guard = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.002))
    for k in range(6000):
        swing, z_d = (0.02, before * np.sin(0.05 * k)) if k < 3000 else (1.0, 10 * np.sin(0.05 * k))
        action = guard.update(swing * np.sin(0.9 * k), z_d, counts=True, noise=0.001)
        if action is Action.RESTORE:
            break
    assert (k + 1 - 3000) // 100 == windows


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
        controller.adapt(z_d + 0.02 * rng.standard_normal() + shaken * 6 * np.sin(2.7 * k))  # no resonance
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


@pytest.mark.parametrize(("frequency", "forgotten"), [(25.0, True), (45.0, False)])
def test_an_oscillation_below_where_a_stage_is_looked_for_is_forgotten_where_nothing_else_helps(
    frequency, forgotten
) -> None:
    settings = ControllerSettings(sample_rate=1000.0, **LIMITS, plays=4, outliers=0)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    np.testing.assert_array_equal(wavering(kernel, frequency), wavering(text, frequency))
    assert kernel.counters.oscillating >= 1
    assert np.isnan(kernel.resonance) == forgotten


@pytest.mark.parametrize(("growth", "kept"), [(1.0, 1), (1.4, 1), (2.0, 5)])
def test_weights_are_good_for_a_motion_that_no_longer_grows(growth, kept) -> None:
    """Five windows, each of a larger motion, and one as large as the last: in which of them some are kept first."""
    guard, seen = Guard(GuardSettings(window=100, range_rate=0.0, floor=0.02, burst=5.0)), []
    for size in [*np.cumprod([2.0, *[growth] * 4]), 2.0 * growth**4]:
        motion = size * np.sin(2 * np.pi * np.arange(100) / 100)
        seen += [guard.update(1e-3 * (-1) ** k, z_d, counts=True, noise=1e-4) for k, z_d in enumerate(motion)]
    assert seen.index(Action.KEEP) // 100 == kept


def study_case(seed, number):
    sampled = fast.sample(seed, number, ["unknown"])
    return sampled.controllers["unknown"], sampled.motions["unknown"], StagePlant(sampled.plant, sampled.seed)


def growing_case(number):
    case = growing_motion.sampled(number)
    controller = growing_motion.controller_of(case, "nothing")
    return controller.settings, growing_motion.wave_of(case), StagePlant(case.stage, seed=number)


@pytest.mark.parametrize(
    ("made", "stopped", "f0", "most"),
    [
        (lambda: study_case(0, 174), 0, 54.0, 6.0),
        (lambda: study_case(2, 28), 0, 102.0, 1.0),
        (lambda: growing_case(202), 1, 74.0, 10.0),
        (lambda: growing_case(58), 1, 107.0, 10.0),
    ],
    ids=["376 um before", "105 um before", "it bursts", "it bursts in a later window"],
)
def test_a_burst_at_the_start_does_not_begin_or_is_stopped_and_shows_the_stage(made, stopped, f0, most) -> None:
    """Kernel and text, to the last bit, on stages that moved by several times their stroke before."""
    settings, wave, plant = made()
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    largest = 0.0
    plant.open()
    for k in range(min(2800, round(0.5 * settings.sample_rate)) if stopped else 2800):
        motion = wave.position[k], wave.velocity[k]
        volts = kernel.command(*motion)
        assert text.command(*motion) == volts
        z = float(plant.exchange(np.array([volts]))[0])
        kernel.adapt(z)
        text.adapt(z)
        largest = max(largest, abs(z - motion[0]))
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert kernel.counters.restored == text.counters["restored"] == stopped
    assert kernel.resonance == pytest.approx(f0, rel=0.06)
    assert largest < most


@pytest.mark.parametrize(
    ("ratios", "burst", "stops"),
    [
        ([2.0] * 5, 5.0, True),
        ([1.4] * 12, 5.0, False),  # it grows slowly: windows judge
        ([50.0], 5.0, False),  # it jumps
        ([2.0] * 5, 0.0, False),  # the stage is given
    ],
)
def test_an_error_that_swings_up_beyond_the_motion_is_stopped_within_its_half_wave(ratios, burst, stops) -> None:
    """Motion of 2 um; weights are kept, then half-waves of 10 ticks grow from 0.1 um by each ratio."""
    guard = Guard(GuardSettings(window=100, range_rate=1e-3, floor=0.02, burst=burst))
    sizes = np.concatenate([[0.002], 0.1 * np.cumprod([1.0, *ratios])])
    half_wave = np.repeat(np.arange(sizes.size), [400] + [10] * (sizes.size - 1))
    error = sizes[half_wave] * np.sin(np.pi * (np.arange(half_wave.size) + 0.5) / 10)
    motion = np.sin(np.arange(error.size) * 2 * np.pi / 100)
    found = [guard.update(e, z_d, counts=True, noise=1e-3) for e, z_d in zip(error, motion, strict=True)]
    assert Action.KEEP in found[:400]
    assert (Action.RESTORE in found) == stops
    if stops:
        at = found.index(Action.RESTORE)
        assert np.abs(error[:at]).max() < 2.4 < abs(error[at]) < 3.2


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


def another(k: int, z_d: float) -> float:
    """What the sensor of another axis shows, um."""
    return 12 + 8 * np.sin(0.11 * k)


def rings_before(k: int, z_d: float) -> float:
    """The same, behind an oscillation of 45 Hz that grows, and is taken for a stage."""
    wave = 0.05 * np.exp(min(k, 60) / 15) * np.sin(2 * np.pi * 45 * k / 1000)
    return z_d + wave if k < 200 else another(k, z_d)


def misled(controller, wrong, until: int) -> np.ndarray:
    """Voltage, flags, true error and weights, while the sensor of a linear actuator is wrong from 1.2 s on."""
    rng, seen = np.random.default_rng(3), []
    for k in range(until + 400):
        z_d = 15 - 10 * np.cos(0.03 * k)
        volts = controller.command(z_d, 300.0 * np.sin(0.03 * k))
        z = 8.0 * volts
        controller.adapt((wrong(k - 1200, z_d) if 1200 <= k < until else z) + 0.02 * rng.standard_normal())
        seen.append([volts, controller.flag_bits, z - z_d, *controller.weights])
    return np.array(seen)


@pytest.mark.parametrize(("wrong", "until"), [(another, 1600), (rings_before, 1600)], ids=["at once", "with a stage"])
def test_what_a_wrong_sensor_has_taught_is_dropped(wrong, until) -> None:
    """Kernel and text, to the last bit: below 0.25 um a period after the sensor is right again, without the stage."""
    settings = ControllerSettings(sample_rate=1000.0, **LIMITS, plays=4, outliers=0)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    seen = misled(kernel, wrong, until)
    np.testing.assert_array_equal(seen, misled(text, wrong, until))
    assert np.abs(seen[1200:until, 2]).max() > 5
    assert np.abs(seen[until + 210 :, 2]).max() < 0.25
    assert np.abs(seen[until + 210 :, 3:] - seen[1199, 3:]).max() < 0.5
    assert kernel.counters.restored >= 1
    assert np.isnan(kernel.resonance)
    if wrong is rings_before:
        np.testing.assert_array_equal(misled(kernel, wrong, until), misled(text, wrong, until))  # and once more


@pytest.mark.parametrize(
    ("gain", "offset", "size", "ticks", "again"),
    [
        (1.0, 0.0, 10.0, 16_000, True),
        (1.0, 0.8, 10.0, 16_000, True),
        (1.0, 1.2, 10.0, 16_000, False),
        (0.9, 0.0, 10.0, 16_000, False),
        (1.0, 0.0, 0.9, 16_000, False),
        (1.0, 0.0, 10.0, 8000, False),
    ],
    ids=["as it was", "moved", "moved too far", "10 % less gain", "at rest", "one way"],
)
def test_kept_weights_are_recalled_where_they_predict_a_motion_and_only_there(gain, offset, size, ticks, again) -> None:
    """Slow as it is, below the noise within a block: 20 um in 8 s at 1 kHz, and back."""
    recall = Recall(GuardSettings(window=50, range_rate=1e-3, floor=0.06, recall=12))
    predicted = 15 - size * np.cos(2 * np.pi * np.arange(ticks) / 16_000)
    noise = np.random.default_rng(1).normal(0.0, 0.02, predicted.size)
    missed = gain * (predicted - 15) + 15 + offset + noise - predicted
    found = [
        recall.update(p, m, span=20.0, noise=0.02) for p, m in zip(predicted.tolist(), missed.tolist(), strict=True)
    ]
    assert any(found) == again
    if again:
        assert recall.offset == pytest.approx(offset, abs=0.02)


def test_weights_of_a_lost_model_are_kept_when_the_error_has_been_small_for_long() -> None:
    """Not in a window in which it is large and constant, as where a wrong sensor shows rest."""
    guard = Guard(GuardSettings(window=50, range_rate=1e-4, floor=0.05, recall=12))
    kept, rng = [], np.random.default_rng(1)
    for k in range(5000):
        error = 8.0 * np.sin(0.9 * k) if 2000 <= k < 2100 else 5.0 if 2100 <= k < 4000 else 0.0
        action = guard.update(error + 0.02 * rng.standard_normal(), 10 * np.sin(0.1 * k), counts=True, noise=0.02)
        kept += [k] * (action is Action.KEEP)
        assert guard.lost == (2049 <= k < 4499)
    assert not [k for k in kept if 2000 < k < 4499]
    assert kept[-1] >= 4499


@pytest.mark.parametrize(
    ("f0", "kind", "load", "amplitude"),
    [(110.0, "preisach", 0.4, 0.5), (130.0, "plays", 0.55, 1.0), (165.0, "plays", 0.4, 0.5)],
)
def test_a_load_that_the_command_answers_does_not_take_the_place_of_the_dynamics(f0, kind, load, amplitude) -> None:
    """A stage of the frequency of the load was put into the model: errors of 25 to 67 times the load."""
    error, resonance, _ = fixed_loads.follow(f0, kind, load, amplitude)
    assert error < 6
    assert resonance == pytest.approx(1.0, abs=0.01)


def test_the_weights_of_the_start_predict_what_held_ones_do_that_were_no_better() -> None:
    """With another gain they moved the stage by what their offset lacked: by 12 um here."""
    reference = ReferenceController(ControllerSettings(sample_rate=2000.0, **LIMITS))
    for k in range(400):
        volts = reference.command(10 * np.sin(0.05 * k), 1000 * np.cos(0.05 * k))
        reference.adapt(4 * volts + 1)
    state, law = reference._state, reference._state.filtering
    law.started, state.kept.guard.at_start = False, True  # as when held weights are no better
    before = law.weights @ state.u
    take_weights(state, law, state.kept.first, earlier=True)
    assert law.weights @ state.u == pytest.approx(before)
    assert state.kept.first @ state.u > before + 10
