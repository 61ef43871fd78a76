"""The first resonance from what is measured anyway: found, followed, put into the model; nothing where none is."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math

import mpmath
import numpy as np
import pytest
from benchmarks import axes, foreign_stages, given_resonance, one_hour
from scipy import signal

from truestroke import AdaptiveController, ControllerSettings, run
from truestroke.control import resonance
from truestroke.control.angles import arctangent, tangent
from truestroke.control.reference import ReferenceController, candidate
from truestroke.control.reference.adapt import DRIVES
from truestroke.control.reference.found import damping
from truestroke.control.resonance import SHOWN, ResonanceEstimator, shown
from truestroke.control.stage import Stage, found
from truestroke.model.operators import play
from truestroke.plant import RealisticPlant, StagePlant, StageSettings
from truestroke.signals.trajectories import Trajectory, raster, sine, triangle
from truestroke.studies import robustness
from truestroke.studies.robustness.fast.sample import sample
from truestroke.studies.robustness.fast.table import record, stage_of

RATE, LIMITS = 5000.0, (-0.6, 3.6)
AXIS = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": LIMITS, "slew_limit": 2e4}


def stage(f0: float, **changes) -> StageSettings:
    given = {"sample_rate": RATE, "resonances": (f0,), "dampings": (0.02,), "voltage_limits": LIMITS, "noise": 0.02}
    return StageSettings(**given | changes)


def estimated(
    settings: StageSettings, f: float, duration: float, error: float = 0.0, span: float = 0.0, highest: float = 0.4
) -> ResonanceEstimator:
    """From a triangle of the voltage, without a controller; the plays are those of evenly spaced thresholds.

    The error, um, stands for that of a motion of this range."""
    volts = 2.4 * np.abs(2 * ((f * np.arange(round(duration * RATE)) / RATE + 0.5) % 1) - 1)
    z = StagePlant(settings, seed=3).exchange(volts)
    estimator, r, y = ResonanceEstimator(), np.linspace(0.0, 1.5, 13), np.zeros(13)
    speed = np.gradient(volts) * RATE * 8.0
    for k in range(1, volts.size):
        y = play(float(volts[k - 1]), r, y)
        of_motion = error, float(speed[k]), float(speed[k] - speed[k - 1])
        estimator.update(1 / RATE, shown(y), float(z[k]), *of_motion, span, highest)
    return estimator


@pytest.mark.parametrize(("highest", "known"), [(0.4, 300.0), (320.0 / RATE, 300.0), (280.0 / RATE, 0.0)])
def test_a_resonance_above_the_highest_is_not_the_first(highest, known) -> None:
    estimator = estimated(stage(300.0), 10.0, 2.0, highest=highest)
    assert estimator.known * RATE == pytest.approx(known, rel=0.05)


def test_a_stage_on_trial_makes_way_for_one_that_is_far_from_it() -> None:
    """It was 42 % too low; the true one was known within 1 % for two seconds, but not taken: 14 % rms."""
    rms, _ = given_resonance.errors((41, 140), 0.0)
    assert rms < 0.5


@pytest.mark.parametrize(("number", "before"), [(800, 32.7), (1021, 27.1)])
def test_noise_of_the_sensor_does_not_move_the_resonance(number: int, before: float) -> None:
    """30 nm at 5 kHz: it was found 7 % and 4 % too high."""
    lines, _ = axes.errors(number, None, True, True, None)
    assert lines < before / 2


def test_a_stage_that_misses_more_than_the_law_is_not_put_into_the_model() -> None:
    """214 Hz on a stage of 512 Hz that was followed within 0.2 %: 137 %."""
    _, largest = given_resonance.errors((41, 166), 0.0)
    assert largest < 2


def test_noise_is_no_stage_that_rings() -> None:
    """A slow axis of 20 kHz had a stage of 4.6 kHz after 3.4 s, from three windows of noise alone: 1.6 um."""
    _, slow = axes.errors(751, None, True, True, None)
    assert slow < 4.0


def test_its_functions_are_those_of_mathematics() -> None:
    with mpmath.workdps(40):
        for x in np.linspace(1e-9, 1.3, 400).tolist():
            assert abs(tangent(x) / mpmath.tan(x) - 1) < 1e-15
        for x in np.linspace(1e-9, 0.55, 400).tolist():
            assert abs(arctangent(x) / mpmath.atan(x) - 1) < 1e-15
        for x in np.linspace(0.55, 3.6, 50).tolist():
            assert abs(arctangent(x) / mpmath.atan(x) - 1) < 1e-10
    for x in (0.56, 1.0, 30.0, 1e9, 1e200):
        assert arctangent(x) == 0 or arctangent(x) > 0.5


@pytest.mark.parametrize("f", [1e-4, 0.003, 0.05, 0.2, 0.5])
def test_a_stage_that_is_found_is_the_exact_one(f: float) -> None:
    """Of 1 / (1 + 0.04 s / w + s^2 / w^2), as a mean over each tick: the response to a pulse, from the integral of the
    step response by residues."""
    with mpmath.workdps(30):
        w = 2 * mpmath.pi * mpmath.mpf(f)
        damped = mpmath.sqrt(1 - mpmath.mpf("0.02") ** 2)
        s = [w * mpmath.mpc("-0.02", sign * damped) for sign in (1, -1)]
        step = [t + _residues(s, w, t) for t in range(5)]
        pulse = [step[1], *(step[k + 1] - 2 * step[k] + step[k - 1] for k in range(1, 4))]
    (b0, b1, a1, a2), direct, *_ = found(f, 1.0)["dynamics.section"][0], found(f, 1.0)["dynamics.direct"][0]
    response, state = [], [0.0, 0.0]
    for u in (1.0, 0.0, 0.0, 0.0):
        state = [b0 * u + b1 * (1.0 if len(response) == 1 else 0.0) - a1 * state[0] - a2 * state[1], state[0]]
        response.append(state[0] + direct * u)
    scale = float(max(abs(p) for p in pulse))
    np.testing.assert_allclose(response, [float(p) for p in pulse], atol=2e-13 * scale, rtol=0)


def _residues(s: list[mpmath.mpc], w: mpmath.mpf, t: int) -> mpmath.mpf:
    """Beside t: what the poles s and the double pole at 0 add to the integral of the step response."""
    moving = sum(w**2 * mpmath.exp(p * t) / (p**2 * (p - q)) for p, q in (s, s[::-1]))
    return mpmath.re(moving + (s[0] + s[1]) / (s[0] * s[1]))


@pytest.mark.parametrize(("kind", "f0"), [("plays", 300.0), ("preisach", 120.0), ("bouc-wen", 410.0)])
def test_it_is_found_on_stages_of_another_structure(kind, f0) -> None:
    found = estimated(stage(f0, hysteresis_kind=kind), f0 / 12, 0.6)
    assert found.known * RATE == pytest.approx(f0, rel=0.03)
    assert math.sqrt(found.variance) < 0.01


@pytest.mark.parametrize("bandwidth", [300.0, 500.0, 1000.0])
def test_the_lag_of_a_slow_amplifier_is_found_with_it(bandwidth) -> None:
    """Without a third derivative the resonance is up to 7 % off. The plays are a tick late, and so is the dead time."""
    slow = stage(410.0, hysteresis_kind="preisach", amplifier_bandwidth=bandwidth, dead_time=1 / RATE)
    found = estimated(slow, 50.0, 0.6)
    assert found.known * RATE == pytest.approx(410.0, rel=0.01)
    turned = math.atan(410.0 / bandwidth)  # by a pole there: a dead time as long as its time constant turns it further
    assert found.lag == pytest.approx(turned * RATE / (2 * math.pi * 410.0), abs=0.3)


def test_a_small_error_is_not_given_for_a_resonance_that_fewer_plays_do_not_show() -> None:
    """300 Hz in a triangle of 40 Hz, behind Preisach's hysteresis: with a small error nothing is known."""
    settings = stage(300.0, hysteresis_kind="preisach", dampings=(0.05,))
    assert estimated(settings, 40.0, 0.6, error=0.5, span=20.0).known * RATE == pytest.approx(300.0, rel=0.05)
    assert estimated(settings, 40.0, 0.6, error=1e-6, span=20.0).known == 0


@pytest.mark.parametrize(("noise", "enough"), [(1e-4, True), (0.5, False)])
def test_one_window_that_is_sure_is_enough_wherever_its_centre_was(noise: float, enough: bool) -> None:
    """150 Hz, looked for about 190 Hz: 27 % away. Where there is noise, the next window is about what was shown."""
    tick, estimator, random = 1 / 2000, ResonanceEstimator(), np.random.default_rng(1)
    path, y, r = Stage(found(150 * tick, tick), 1), np.zeros(2), np.array([0.0, 1.0])
    estimator.look(190 * tick)
    for k in range(300):
        y = play(2 * math.sin(2 * math.pi * 20 * k * tick), r, y)
        path.strain[k] = float(y @ [5.0, 2.0])
        z = path.expected()
        path.notched(z)
        estimator.update(tick, shown(y), z + noise * random.standard_normal(), 0.0, 0.0, 0.0)
    assert estimator.suffices is enough
    if enough:
        assert estimator.windows == 1
        assert estimator.known / tick == pytest.approx(150.0, rel=0.02)


def test_expected_weights_are_measurements_of_the_plays() -> None:
    """The sums of a window with them are those of least squares with seven further rows, each with its deviation."""
    random, estimator = np.random.default_rng(5), ResonanceEstimator()
    rows = random.standard_normal((400, SHOWN + 4)) @ np.diag(10.0 ** random.uniform(-2, 1, SHOWN + 4))
    expected, left = random.uniform(0.1, 4.0, SHOWN), 3.7
    estimator._sum, estimator._window = rows.T @ rows, len(rows)
    sums = np.tril(estimator._sums_with_expected(expected, left))
    sums += np.tril(sums, -1).T
    found = np.linalg.solve(sums[:-1, :-1], sums[-1, :-1])
    share = math.sqrt(left / len(rows)) / (0.1 / 5 * expected.sum())
    further = share * np.eye(SHOWN, SHOWN + 3)
    wanted, *_ = np.linalg.lstsq(
        np.vstack([rows[:, :-1], further]), np.append(rows[:, -1], share * expected), rcond=None
    )
    np.testing.assert_allclose(found[:SHOWN], wanted[:SHOWN] - expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found[SHOWN:], wanted[SHOWN:], rtol=1e-8)


def test_a_sine_with_a_harmonic_near_the_resonance_shows_it_by_the_weights_that_are_expected() -> None:
    """1315 Hz, and the fifth harmonic at 1388. With plays that are free alone 1.6 % remain: no window is sure."""
    recording = record(1, 16, "unknown")
    later = recording["time"] >= recording["time"][-1] / 2
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    assert 100 * np.std(error) < 0.2 * span


def test_a_harmonic_that_grows_at_the_resonance_does_not_hide_the_stage() -> None:
    """The fifth of 46.4 Hz beside 207.5 Hz was a load of 227.6 to 229.8 Hz for 2.3 s, with errors of 3 %."""
    sampled = sample(27182, 125, ["unknown"])
    plant = StagePlant(stage_of(sampled), sampled.seed + 1)
    recording = run(sampled.motions["unknown"], AdaptiveController.from_settings(sampled.controllers["unknown"]), plant)
    later = recording["time"] >= recording["time"][-1] / 2
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    assert np.max(np.abs(error)) < 0.005 * span


def test_an_amplifier_slower_than_the_resonance_is_damped_with_its_phase() -> None:
    """1768 Hz behind 507 Hz: six ticks in place of two turn the active damping into its opposite, 603 %."""
    recording = record(16, 138, "unknown")
    later = recording["time"] >= 0.5
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    assert np.max(np.abs(error)) < 0.1 * span


@pytest.mark.parametrize(("seed", "number", "before"), [(4, 98, 130), (5, 16, 84), (0, 164, 111)])
def test_no_stage_that_is_not_there_bursts_nor_one_that_rings_until_it_is_known(seed, number, before) -> None:
    """Largest error after 0.5 s, % of peak to peak: 123 Hz were shown in place of 520, with fewer plays others; an
    error of the motion 97 Hz in place of 289; 106 Hz were known, but not used, for 0.25 s."""
    recording = record(seed, number, "unknown")
    later = recording["time"] >= 0.5
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    assert 100 * np.max(np.abs(error)) < before / 80 * span


def test_an_oscillation_that_comes_again_does_not_end_the_window() -> None:
    """One at the frequency of the window; one elsewhere begins another."""
    estimator = ResonanceEstimator()
    for k in range(50):
        estimator.look(0.06 * (1 + 0.01 * math.sin(k)))
        estimator.update(1 / RATE, np.zeros(SHOWN), 0.0, 0.0, 0.0, 0.0)
    assert estimator.ticks == 50
    estimator.look(0.09)
    assert (estimator.centre, estimator.ticks) == (0.09, 0)


def windows(error: float, ticks: int, centre: float = 0.0, burst: float = 1.0, from_tick: int = 0, speed: float = 1.0):
    """Ticks in which windows end, and the centres behind them, of an actuator that does not answer.

    From a tick on the error is this one, um."""
    estimator, found = ResonanceEstimator(), []
    if centre > 0:
        estimator.look(centre)
    for k in range(ticks):
        before = estimator.ticks
        of_motion = error if k >= from_tick else 0.0, speed * math.cos(0.01 * k), 0.0
        estimator.update(1 / RATE, np.zeros(SHOWN), 0.0, *of_motion, burst=burst)
        if estimator.ticks <= before:
            found.append((k + 1, round(estimator.centre, 4)))
    return found


def test_a_burst_does_not_wait_for_the_end_of_a_window() -> None:
    """One of 60 ms ends after 20 periods. Where 20 periods of a low centre last long, the search begins above."""
    assert windows(0.9, 330) == [(320, 0.09)]  # 3 periods and 60 ms
    assert windows(1.1, 330)[0] == (155, 0.09)  # 3 and 20 periods, and the tick in which that is seen
    assert windows(0.0, 2400, centre=0.01) == [(2300, 0.15)]
    assert windows(3.0, 900, centre=0.01, from_tick=800)[0] == (801, 0.15)
    assert windows(1.9, 900, centre=0.01, from_tick=800) == []  # not sudden


def test_the_search_stays_where_it_is_at_rest() -> None:
    """Else a motion after a rest meets it at its lowest frequency: 136 % of it for a tenth of a second. A staircase has
    no velocity either, but errors."""
    assert {centre for _, centre in windows(0.0, 2000, centre=0.1, speed=0.0)} == {0.1}
    assert [centre for _, centre in windows(0.0, 700)] == [0.09, 0.054]
    assert [centre for _, centre in windows(0.5, 700, speed=0.0)] == [0.09, 0.054]


def sudden(f0: float, slow: float, rest: float, fast: float = 0.8) -> Trajectory:
    """A slow sine of this peak to peak, um, for `rest` s, then within 0.1 s one of 20 um and 0.3 f0, for `fast` s."""
    time, of_both = np.arange(round((rest + fast) * RATE)) / RATE, {"duration": rest + fast, "sample_rate": RATE}
    of_slow = slow / 20.0 * sine(frequency=3.0, peak_to_peak=20.0, **of_both).position
    of_fast = sine(frequency=f0 / 3.3, peak_to_peak=20.0, **of_both).position
    begun, moves = np.clip((time - rest) / 0.1, 0, 1) ** 2, np.clip(time / 0.1, 0, 1) ** 2
    position = moves * (12.0 + (1 - begun) * of_slow + begun * of_fast)
    return Trajectory(name="sudden", position=position, velocity=np.gradient(position) * RATE, sample_rate=RATE)


@pytest.mark.parametrize(("f0", "before"), [(288.0, 0.43), (800.0, 0.52)])
def test_a_burst_of_a_sudden_fast_motion_is_over_at_once(f0: float, before: float) -> None:
    """After 1.6 s of a slow sine, with nothing given: seconds above 10 % of peak to peak."""
    plant = StagePlant(stage(f0, dampings=(0.018,), hysteresis_kind="preisach"), seed=1)
    recording = run(sudden(f0, 20.0, 1.6), AdaptiveController(**AXIS), plant)
    error = recording["true"] - recording["desired"]
    assert np.sum(np.abs(error) > 2.0) / RATE < 0.1 < before
    assert np.std(error[-1000:]) < 0.05


@pytest.mark.parametrize(("f0", "slow", "rest"), [(800.0, 0.0, 0.5), (288.0, 20.0, 0.9)], ids=["rest", "slow"])
def test_the_kernel_is_the_numpy_text_in_a_burst(f0: float, slow: float, rest: float) -> None:
    """The search stays where it is at rest, and begins above where it is low, at 63 Hz after 0.9 s of a slow motion."""
    wave = sudden(f0, slow, rest, 0.25)
    wave = dataclasses.replace(wave, acceleration=np.gradient(wave.velocity) * RATE)
    kernel, _ = followed_alike(stage(f0, dampings=(0.018,), hysteresis_kind="preisach"), wave)
    assert kernel.resonance == pytest.approx(f0, rel=0.1)


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_a_burst_that_excites_a_second_mode_does_not_make_it_grow() -> None:
    """Number 4 of `benchmarks.foreign_stages`: 5.4 % rms without the third pole, 36 % at most."""
    _, rms, largest = foreign_stages.follow(4, given=False, duration=3.0)
    assert rms < 0.3
    assert largest < 5.0


def test_a_large_tone_from_outside_is_no_resonance() -> None:
    """207 Hz of a third of the motion, which the voltage does not drive: one window is sure of it."""
    controller, random = (
        AdaptiveController(sample_rate=1000.0, stroke=30.0, voltage_limits=LIMITS),
        np.random.default_rng(3),
    )
    for k in range(760):
        z_d = 15 - 10 * math.cos(0.02 * k)
        controller.command(z_d, 200.0 * math.sin(0.02 * k))
        controller.adapt(z_d + 0.02 * random.standard_normal() + (k > 500) * 6 * math.sin(1.3 * k))
    assert not controller.state()["found"].any()


@pytest.mark.parametrize("way", [0.95, 1.05])
def test_a_jump_is_followed(way) -> None:
    changed = stage(300.0, resonance_change=way, resonance_change_time=0.3)
    found = estimated(changed, 25.0, 0.75)
    assert found.known * RATE == pytest.approx(300.0 * way, rel=0.015)


def test_nothing_is_found_where_nothing_rings() -> None:
    """A resonance above what is looked for, with the noise of a sensor."""
    assert estimated(stage(1900.0, dampings=(0.1,)), 40.0, 0.6).known == 0.0


@pytest.fixture(scope="module")
def fast():
    """Errors of the second half, % of p-p, rms, and the resonances in the model; late: the stage is not looked for."""
    wave = sine(frequency=70.0, peak_to_peak=18.0, offset=12.0, duration=2.0, sample_rate=RATE)
    found = {}
    for late in (0.0, 1e-9):
        controller = AdaptiveController(**AXIS, sensor_delay=late)
        recording = run(wave, controller, StagePlant(stage(400.0, hysteresis_kind="preisach"), seed=1))
        error = (recording["true"] - recording["desired"])[wave.position.size // 2 :]
        found[late] = 100 / 18.0 * float(np.std(error)), controller.resonance
    return found


def test_a_fast_motion_is_followed_where_nothing_is_given(fast) -> None:
    assert fast[0.0][1] == pytest.approx(400.0, rel=0.04)
    assert fast[0.0][0] < 0.3
    assert fast[0.0][0] < fast[1e-9][0] / 3


def test_the_command_is_the_whole_inverse_of_the_stage_that_was_found() -> None:
    """At a third of it: with two derivatives, the second half a tick late, the law predicts an error that stays."""
    wave = sine(frequency=120.0, peak_to_peak=18.0, offset=12.0, duration=2.5, sample_rate=RATE)
    controller = AdaptiveController(**AXIS)
    recording = run(wave, controller, StagePlant(stage(360.0, hysteresis_kind="preisach"), seed=1))
    turns = np.exp(-2j * np.pi * 120.0 * recording["time"][10_000:])  # a whole number of periods
    left = 2 * abs(np.mean((recording["true"] - recording["desired"])[10_000:] * turns))
    assert controller.resonance == pytest.approx(360.0, rel=0.04)
    assert left < 0.001 * 18.0


@pytest.mark.parametrize(("f", "late", "least"), [(0.003, 1, 0.08), (0.012, 2, 0.08), (0.06, 3, 0.08), (0.1, 2, 0.03)])
@pytest.mark.parametrize("damped", [0.003, 0.02, 0.08])
@pytest.mark.parametrize("wrong", [0.95, 1.0, 1.05])
def test_a_stage_that_was_found_is_damped(f: float, late: int, least: float, damped: float, wrong: float) -> None:
    """All poles of the loop decay, that of the mode by `least` more than alone, also where f0 is 5 % wrong."""
    w = 2 * np.pi * f
    b, a, _ = signal.cont2discrete(([w * w], [1, 2 * damped * w, w * w]), 1.0)
    *c, a1, a2 = damping(wrong * f, late)
    loop = np.polymul(np.r_[a, np.zeros(late - 1)], [1.0, a1, a2])  # a held command is a tick late already
    s = np.log(np.roots(np.polyadd(loop, np.polymul(b[0], c))) + 0j)
    assert np.all(s.real < 0)
    modes = s[(np.abs(s) > 0.8 * w) & (np.abs(s) < 1.25 * w)]
    assert np.min(-s.real / w) > 0.003 + least / 2
    assert np.min(-modes.real / np.abs(modes)) > damped + least / 2


def test_the_ringing_of_a_soft_stage_is_over_within_a_second() -> None:
    """Alone it decays by 1 / e in 0.66 s: without the damping 15 % of the motion were left here."""
    wave = sine(frequency=16.0, peak_to_peak=18.0, offset=12.0, duration=1.5, sample_rate=RATE)
    controller = AdaptiveController(**AXIS)
    plant = stage(60.0, dampings=(0.004,), hysteresis_kind="preisach")
    recording = run(wave, controller, StagePlant(plant, seed=2))
    error = np.abs(recording["true"] - recording["desired"])
    assert controller.resonance == pytest.approx(60.0, rel=0.05)
    assert error.max() > 0.05 * 18.0
    assert error[5000:].max() < 0.01 * 18.0


def test_velocities_that_jump_have_no_third_difference() -> None:
    """A triangle with sharp turns: the higher derivatives of a jump make the stage ring."""
    wave = triangle(frequency=20.0, peak_to_peak=18.0, duration=1.5, sample_rate=RATE)
    controller = AdaptiveController(**AXIS)
    recording = run(wave, controller, StagePlant(stage(300.0), seed=1))
    error = (recording["true"] - recording["desired"])[4000:]
    assert controller.resonance == pytest.approx(300.0, rel=0.04)
    assert error.std() < 0.03 * 18.0


def test_a_slow_motion_keeps_its_bits() -> None:
    wave = sine(frequency=5.0, peak_to_peak=18.0, offset=12.0, duration=0.6, sample_rate=RATE)
    volts = []
    for late in (0.0, 1e-9):
        controller = AdaptiveController(**AXIS, sensor_delay=late)
        volts.append(run(wave, controller, StagePlant(stage(600.0), seed=1))["volts"])
        assert math.isnan(controller.resonance)
    assert np.abs(volts[0] - volts[1]).max() < 1e-6


def test_a_stage_that_rings_in_a_slow_motion_is_put_into_the_model() -> None:
    """Its 29th harmonic meets f0; the motion is slower than f0 / 40."""
    wave = raster(frequency=24.0, peak_to_peak=18.0, offset=12.0, turn=0.1, duration=2.0, sample_rate=RATE)
    controller = AdaptiveController(**AXIS)
    plant = StagePlant(stage(696.0, hysteresis_kind="bouc-wen", dampings=(0.01,)), seed=1)
    recording = run(wave, controller, plant)
    error = (recording["true"] - recording["desired"]).reshape(-1, 1250).std(axis=1)
    assert controller.resonance == pytest.approx(696.0, rel=0.02)
    assert error[-1] < 0.12 * error[0]  # without it the error stays at 0.4


def test_a_resonance_that_is_given_stays() -> None:
    wave = sine(frequency=70.0, peak_to_peak=18.0, offset=12.0, duration=0.6, sample_rate=RATE)
    controller = AdaptiveController(**AXIS, resonance=380.0)
    run(wave, controller, StagePlant(stage(400.0), seed=1))
    assert controller.resonance == 380.0


def test_the_kernel_is_the_numpy_text_with_a_stage_that_is_found_and_jumps() -> None:
    """Commands, flags and innovations, every tick, with lost samples; the resonance in the model follows the jump."""
    settings = ControllerSettings(**AXIS)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    slow = {"amplifier_bandwidth": 1000.0, "dead_time": 2 / RATE}  # so that the stage that is found has it, too
    plant = StagePlant(stage(600.0, resonance_change=1.08, resonance_change_time=0.3, **slow), seed=1)
    plant.open()
    wave = triangle(frequency=33.0, peak_to_peak=18.0, duration=0.6, sample_rate=RATE)
    resonances = []
    for k, (z_d, zdot_d) in enumerate(zip(wave.position, wave.velocity, strict=True)):
        x = kernel.command(z_d, zdot_d)
        assert text.command(z_d, zdot_d) == x
        z = math.nan if k % 1601 == 1600 else float(plant.exchange(np.array([x]))[0])
        kernel.adapt(z)
        text.adapt(z)
        assert kernel.flag_bits == text.flag_bits
        assert kernel.innovation == text.innovation
        resonances.append(kernel.resonance)
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert resonances[1600] == pytest.approx(600.0, rel=0.05)
    assert resonances[-1] == pytest.approx(648.0, rel=0.03)
    assert kernel.state()["found_dead"][0] > 1


def followed_alike(
    settings: StageSettings, wave: Trajectory, ticks: int | None = None
) -> tuple[AdaptiveController, np.ndarray]:
    """The kernel after this motion, and its true error, um; for so many ticks the NumPy text gives its commands."""
    known = ControllerSettings(**AXIS | {"sample_rate": settings.sample_rate})
    kernel, text = AdaptiveController.from_settings(known), ReferenceController(known)
    plant, error = StagePlant(settings, seed=1), []
    plant.open()
    ticks = len(wave) if ticks is None else ticks
    for k, motion in enumerate(zip(wave.position, wave.velocity, wave.acceleration, strict=True)):
        x = kernel.command(*motion)
        z = float(plant.exchange(np.array([x]))[0])
        kernel.adapt(z)
        error.append(plant.truth[-1] - motion[0])
        if k < ticks:
            assert text.command(*motion) == x
            text.adapt(z)
        if k == ticks - 1:
            tried, beside = kernel.state()["candidate"], text._state.candidate
            assert [beside.strain, beside.own.second, beside.missed_speed, beside.missed_level] == tried[
                [6, 18, 19, 20]
            ].tolist()
            assert [beside.shown, beside.gain, beside.lag, beside.offset, beside.worse] == tried[-5:].tolist()
    return kernel, np.array(error)


def test_a_stage_without_dead_time_is_found_without_one() -> None:
    """In kernel and NumPy text alike, after 0.26 s; a tick of 0.2 ms of it left 33 nm of these lines."""
    wave = raster(frequency=40.0, peak_to_peak=20.0, offset=15.0, duration=1.4, sample_rate=RATE)
    kernel, error = followed_alike(stage(570.0, hysteresis_kind="bouc-wen"), wave, ticks=2000)
    assert kernel.state()["found_dead"].tolist() == [0]
    again = AdaptiveController.from_settings(kernel.settings)
    again.restore(kernel.state())
    assert again.state()["found_dead"].tolist() == [0]
    assert np.std(error[6000:][wave.flat[6000:] > 0]) < 0.012


def test_the_kernel_is_the_numpy_text_where_a_slow_motion_rings() -> None:
    wave = raster(frequency=23.0, peak_to_peak=18.0, offset=12.0, turn=0.1, ramp=0.05, duration=0.28, sample_rate=RATE)
    kernel, _ = followed_alike(stage(690.0, dampings=(0.01,)), wave)
    assert kernel.resonance == pytest.approx(690.0, rel=0.02)


def test_a_ringing_of_less_than_a_thousandth_is_enough() -> None:
    """In kernel and NumPy text alike, after 0.25 s: without it 15 nm of these lines stay."""
    wave = raster(frequency=40.0, peak_to_peak=20.0, offset=15.0, duration=0.6, sample_rate=10_000.0)
    kernel, _ = followed_alike(stage(935.0, dampings=(0.024,), noise=0.01, sample_rate=10_000.0), wave, ticks=3200)
    assert kernel.resonance == pytest.approx(935.0, rel=0.05)


def test_a_window_points_to_the_next_one() -> None:
    """Where none does, none of 0.6 s shows the stage. Both alike."""
    wave = raster(frequency=40.0, peak_to_peak=20.0, offset=15.0, duration=0.6, sample_rate=RATE)
    kernel, _ = followed_alike(stage(1085.0, hysteresis_kind="preisach", dampings=(0.026,), noise=0.01), wave, 2200)
    assert kernel.resonance == pytest.approx(1085.0, rel=0.03)


def test_windows_that_point_elsewhere_end_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three in a search at most, or behind one that shows a resonance."""
    shown = (resonance._Window(f0=0.25 * (k == 5), left=1.0, points=(0.2, 0.3)[k % 2]) for k in itertools.count())
    monkeypatch.setattr(ResonanceEstimator, "_shown", lambda *_: next(shown))
    centres = [centre for _, centre in windows(0.0, 20_000)]
    assert centres[:9] == [0.2, 0.3, 0.2, 0.12, 0.072, 0.25, 0.2, 0.3, 0.2]
    below = [centres[k] for k in range(10, 22, 2)]  # beside windows about what the sixth has shown
    assert below == [0.12, 0.072, 0.0432, 0.0259, 0.0156, 0.0093]
    assert centres[22:26] == [0.15, 0.3, 0.2, 0.3]


def test_each_second_window_is_about_what_is_known_until_a_stage_is_in_the_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One window has shown 0.25 cycles per tick; `burst` is 0 with a stage in the model."""

    def centres(burst: float) -> list[float]:
        shown = (resonance._Window(f0=0.25 * (k == 1), variance=1e-6, left=1.0) for k in itertools.count())
        monkeypatch.setattr(ResonanceEstimator, "_shown", lambda *_: next(shown))
        return [centre for _, centre in windows(0.0, 4_000, burst=burst)][:8]

    assert centres(1.0) == [0.09, 0.25, 0.15, 0.25, 0.09, 0.25, 0.054, 0.25]
    assert centres(0.0) == [0.09, 0.25, 0.15, 0.09, 0.054, 0.0324, 0.0194, 0.0117]


@pytest.mark.parametrize(("number", "before"), [(210, 12.8), (255, 14.0), (313, 28.7)])
def test_windows_about_what_they_show_find_a_stage_that_noise_hides(number: int, before: float) -> None:
    """An x of `benchmarks/axes.py`, nothing given, nm rms; `before`, where a window pointed to no other one."""
    assert axes.errors(number, None, True, True, None)[0] < before / 3


def test_noise_that_no_voltage_drives_shows_no_stage() -> None:
    """The slow y of an XY stage; 34 nm where windows about 819 Hz put that into the model. The stage has 528 Hz."""
    assert axes.errors(382, None, True, True, None)[1] < 5.0


def test_noise_of_a_slow_motion_is_no_stage_that_rings() -> None:
    """Rest and slow waves for two minutes: after 111 s a stage of 434 Hz was found in place of one of 609 Hz."""
    one = robustness.sample(0, 2)
    plant = RealisticPlant(one.plant.without("change"), seed=2)
    _, position, velocity = one_hour.pieces(np.random.default_rng(2), one.sampled["reach"], 12)
    limits = {"stroke": one_hour.STROKE, "voltage_limits": one_hour.VOLTAGE_LIMITS}
    controller = AdaptiveController(sample_rate=one_hour.SAMPLE_RATE, **limits)
    plant.open()
    error = one_hour.drive(controller, plant, position, velocity) - position
    assert math.isnan(controller.resonance)
    assert np.std(error[-20_000:]) < 0.01


def largest_later(seed: int, number: int) -> float:
    """Largest error after 0.5 s of a run of the fast study with nothing given, % of peak to peak."""
    recording = record(seed, number, "unknown")
    later = recording["time"] >= 0.5
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    return float(100 * np.max(np.abs(error)) / span)


@pytest.mark.parametrize(("number", "before"), [(4, 159.0), (162, 33.0)])
def test_a_stage_that_is_found_is_put_into_the_model_without_a_jump(number: int, before: float) -> None:
    """Largest error after 0.5 s: `before`, % of peak to peak, where the law began anew from the first weights."""
    assert largest_later(4, number) < before / 5


@pytest.mark.parametrize(("seed", "number", "before"), [(5, 168, 0.15), (7, 0, 0.07)])
def test_the_voltage_has_no_step_when_a_stage_is_found(seed: int, number: int, before: float) -> None:
    """Largest second difference of the voltage after 0.5 s, over its range: `before` with the lag counted twice."""
    recording = record(seed, number, "unknown")
    volts = recording["volts"][recording["time"] >= 0.5]
    assert np.abs(np.diff(volts, 2)).max() < before / 5 * np.ptp(volts)


@pytest.mark.parametrize(("seed", "number", "before"), [(13, 166, 0.31), (14, 144, 0.33), (2, 166, 0.63)])
def test_a_resonance_within_5_percent_is_soon_enough_in_the_model(seed: int, number: int, before: float) -> None:
    """Rms of the second half, % of peak to peak; `before`, where it had to be within 2 %."""
    recording = record(seed, number, "unknown")
    error = recording["true"] - recording["desired"]
    assert 100 * error[error.size // 2 :].std() < before / 1.5 * np.ptp(recording["desired"])


def test_windows_that_walk_put_no_stage_into_the_model() -> None:
    """A sine on 1358 Hz, whose windows rise from 648 to 1026 Hz: their mean of 884 Hz was taken, and 52 % were left.

    15 % where one within 5 % is taken at first, 2 % where it has to be within 2 %.
    """
    recording = record(4, 170, "unknown")
    later = recording["time"] >= 0.5
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    assert 100 * np.max(np.abs(error)) < 20 * span


def test_a_stage_that_failed_takes_its_resonance_with_it_and_does_not_come_back() -> None:
    """Where the error was small before: 3.4 % without, and six trials of the same false resonance to the end."""
    recording = record(0, 55, "unknown")
    later = recording["time"] >= 2.5
    error, span = (recording["true"] - recording["desired"])[later], np.ptp(recording["desired"][later])
    assert np.std(error) < 0.003 * span


def test_a_controller_is_copied_while_the_stage_that_it_found_has_ticks_of_dead_time() -> None:
    """Before the stage is found, when it is, and after the jump that moves it: the copy goes on to the same voltage."""
    slow = {"amplifier_bandwidth": 1000.0, "dead_time": 2 / RATE}
    plant = StagePlant(stage(600.0, resonance_change=1.08, resonance_change_time=0.3, **slow), seed=1)
    plant.open()
    controller, dead = AdaptiveController(**AXIS), set()
    wave = triangle(frequency=33.0, peak_to_peak=18.0, duration=0.6, sample_rate=RATE)
    for k, (z_d, zdot_d) in enumerate(zip(wave.position, wave.velocity, strict=True)):
        known = controller.resonance
        twin = copy.copy(controller) if k % 50 == 0 else None
        x = controller.command(z_d, zdot_d)
        assert twin is None or twin.command(z_d, zdot_d) == x
        controller.adapt(float(plant.exchange(np.array([x]))[0]))
        if controller.resonance > 0 and controller.resonance != known:
            dead.add(int(copy.copy(controller).state()["found_dead"][0]))
    assert max(dead) > 1


def test_a_resonance_that_is_high_for_the_sample_rate_is_found() -> None:
    """At 0.2 of it, when the search has been down and begins again above; in kernel and NumPy text alike."""
    settings = ControllerSettings(**AXIS | {"slew_limit": 1e6})
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant, error = StagePlant(stage(1000.0, hysteresis_kind="bouc-wen"), seed=1), []
    plant.open()
    wave = sine(frequency=232.0, peak_to_peak=18.0, offset=12.0, duration=0.8, sample_rate=RATE)
    for k, (z_d, zdot_d) in enumerate(zip(wave.position, wave.velocity, strict=True)):
        x = kernel.command(z_d, zdot_d)
        z = float(plant.exchange(np.array([x]))[0])
        kernel.adapt(z)
        if k < 1600:  # it is found in tick 948
            assert text.command(z_d, zdot_d) == x
            text.adapt(z)
            weights = kernel.weights
        error.append(plant.truth[-1] - z_d)
    np.testing.assert_array_equal(weights, text.weights)
    assert kernel.resonance == pytest.approx(1000.0, rel=0.03)
    assert np.std(error[3200:]) < 0.003 * 18.0  # 1.9 % without


def test_single_precision_finds_the_same_stage() -> None:
    wave = sine(frequency=70.0, peak_to_peak=18.0, offset=12.0, duration=1.0, sample_rate=RATE)
    errors = {}
    for precision in ("single", "double"):
        controller = AdaptiveController(**AXIS, precision=precision)
        recording = run(wave, controller, StagePlant(stage(400.0), seed=1))
        errors[precision] = float(np.std((recording["true"] - recording["desired"])[2500:]))
        assert controller.resonance == pytest.approx(400.0, rel=0.02)
    assert errors["single"] == pytest.approx(errors["double"], rel=0.5)


def test_a_run_that_was_restored_is_the_run() -> None:
    """Also amid a window of the estimate, and where the lag that was found is more than a tick."""
    whole, plant = AdaptiveController(**AXIS), StagePlant(stage(400.0, dead_time=2 / RATE), seed=1)
    plant.open()
    wave, other = sine(frequency=70.0, peak_to_peak=18.0, offset=12.0, duration=0.5, sample_rate=RATE), None
    for k, (z_d, zdot_d) in enumerate(zip(wave.position, wave.velocity, strict=True)):
        if k in (333, 1900):
            other = AdaptiveController(**AXIS)
            other.restore(whole.state())
        x = whole.command(z_d, zdot_d)
        z = float(plant.exchange(np.array([x]))[0])
        whole.adapt(z)
        if other is not None:
            assert other.command(z_d, zdot_d) == x
            other.adapt(z)
    assert other.resonance == whole.resonance > 0
    assert whole.state()["found_dead"][0] > 1


LATE = StageSettings(sample_rate=10_000.0, voltage_limits=(0.0, 10.0), hysteresis_kind="preisach", noise=0.03)
KNOWN = {"sample_rate": 10_000.0, "stroke": 24.0, "voltage_limits": (0.0, 10.0), "slew_limit": 1e5}


@pytest.mark.parametrize(
    ("f0", "damping", "ticks", "share", "before"),
    [(1500.0, 0.01, 3, 0.1, 459), (700.0, 0.005, 6, 0.1, 435)],
)
def test_a_loop_that_is_later_than_known_is_not_driven_by_its_damping(f0, damping, ticks, share, before) -> None:
    """With f0 given; rms in % of peak to peak, that of before to the end."""
    late = dataclasses.replace(LATE, resonances=(f0,), dampings=(damping,), dead_time=1e-4 * ticks)
    wave = sine(frequency=share * f0, peak_to_peak=16.0, offset=12.0, duration=1.5, sample_rate=10_000.0)
    recording = run(wave, AdaptiveController(**KNOWN, resonance=f0), StagePlant(late, seed=ticks))
    rms = np.std((recording["true"] - recording["desired"])[-5000:]) / 0.16
    assert rms < 1.0 < before


@pytest.mark.parametrize(("f0", "ticks"), [(1500.0, 3), (700.0, 6)])
def test_the_kernel_is_the_numpy_text_in_a_loop_that_is_late(f0: float, ticks: int) -> None:
    """The damping ends; a stage in the model gets another dead time."""
    late = dataclasses.replace(LATE, resonances=(f0,), dampings=(0.005,), dead_time=1e-4 * ticks)
    wave = sine(frequency=0.3 * f0, peak_to_peak=16.0, offset=12.0, duration=0.2, ramp=0.1, sample_rate=10_000.0)
    settings = ControllerSettings(**KNOWN, resonance=f0)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    volts, of_text = (run(wave, controller, StagePlant(late, seed=1))["volts"] for controller in (kernel, text))
    assert volts.tolist() == of_text.tolist()
    assert kernel.state()["feedback_damping"][9] == DRIVES
    assert kernel.state()["found_dead"] > 1


def test_a_ringing_far_above_the_limit_of_the_damping_is_damped_to_its_end() -> None:
    """A load of 1.5 strokes; swings that become smaller do not end the damping."""
    wide = {"voltage_limits": (-30.0, 40.0)}
    knocked = dataclasses.replace(LATE, **wide, resonances=(300.0,), dampings=(0.003,), load=-36.0, load_time=0.1)
    wave = sine(frequency=30.0, peak_to_peak=8.0, offset=12.0, duration=0.2, ramp=0.05, sample_rate=10_000.0)
    settings = ControllerSettings(**KNOWN | wide, resonance=300.0)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    volts, of_text = (run(wave, controller, StagePlant(knocked, seed=1))["volts"] for controller in (kernel, text))
    assert volts.tolist() == of_text.tolist()
    assert kernel.state()["feedback_damping"][9] < DRIVES


def test_a_candidate_shows_the_gain_the_lag_and_the_offset_that_the_weights_miss() -> None:
    """Behind a stage of 300 Hz, by its response in closed form: 0.9 times as much, 0.4 ms late, 2 um away."""
    f0, damping, tick, time = 300.0, 0.02, 1e-4, np.arange(4000) * 1e-4
    tones = [(31.0, 6.0, 0.3), (83.0, 3.0, 1.1)]  # Hz, um, rad
    strain = 400.0 + sum(a * np.sin(2 * np.pi * f * time + p) for f, a, p in tones)
    z, speed = np.full(time.size, 0.9 * 400.0 + 2.0), np.zeros(time.size)
    for f, a, p in tones:
        G = 1 / (1 - (f / f0) ** 2 + 2j * damping * f / f0)
        moved = a * G * np.exp(1j * (2 * np.pi * f * time + p))
        speed += (2j * np.pi * f * moved).imag
        z += (0.9 * moved).imag - 4e-4 * (2j * np.pi * f * moved).imag
    one = candidate.begun(f0 * tick, tick, float(strain[0]), float(strain[0]))
    for values in zip(z.tolist(), speed.tolist(), strain.tolist(), strict=True):
        one.count(*values, own=0.01)
        one.strain = values[2]
    one.end(tick)
    assert one.shown == f0 * tick
    assert one.gain == pytest.approx(-0.1, abs=0.004)
    assert one.lag == pytest.approx(-4e-4, abs=0.1 * tick)
    assert one.offset == pytest.approx(2.0, abs=0.004 * 400)


@pytest.mark.parametrize(("seed", "number", "before"), [(1732, 121, 7.1), (8128, 72, 9.4), (2236, 121, 7.3)])
def test_a_stage_that_is_found_late_costs_nothing(seed: int, number: int, before: float) -> None:
    """Largest error after 0.5 s, % of peak to peak; `before`, where weights without the stage went on beside it."""
    assert largest_later(seed, number) < before / 5


@pytest.mark.parametrize(("seed", "number", "most", "before"), [(1732, 60, 3.0, 7.3), (8128, 134, 2.4, 3.1)])
def test_a_stage_takes_over_the_lag_and_the_gain_of_the_weights(
    seed: int, number: int, most: float, before: float
) -> None:
    """`before` without: the least with five noises; 7.9 and more with a lag that lacks the dead time of the stage."""
    assert largest_later(seed, number) < most < before


@pytest.mark.parametrize(("seed", "number", "before"), [(2357, 58, 10.1), (8765, 8, 1.4)])
def test_what_harms_and_an_error_that_grows_end_in_earlier_weights(seed: int, number: int, before: float) -> None:
    """rms, % of peak to peak: a wrong stage had 16 windows until it was judged, held weights one to ring out."""
    recording = record(seed, number, "unknown")
    error = (recording["true"] - recording["desired"])[recording["true"].size // 2 :]
    assert 100 * np.sqrt(np.mean(error**2)) / np.ptp(recording["desired"]) < before / 2


@pytest.mark.parametrize(("seed", "number"), [(8128, 90), (1732, 82)])
def test_a_law_that_is_good_is_not_given_up_for_a_resonance_that_fewer_plays_move(seed: int, number: int) -> None:
    """A slow raster with 0.15 % of error: 100 Hz were found in place of 296, or 236 of 911, and then 434 % or 223."""
    recording = record(seed, number, "unknown")
    error, span = (recording["true"] - recording["desired"])[20_000:], np.ptp(recording["desired"])
    assert 100 * np.max(np.abs(error)) < 0.8 * span
