"""Dynamics of another stage: a load was mounted since they were measured, or the file is that of another axis."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from benchmarks import wrong_dynamics
from benchmarks.changing_motion import rise, tone
from benchmarks.foreign_stages import Relays, travel
from benchmarks.foreign_stages import Stage as OtherStructure

from truestroke import AdaptiveController, ControllerSettings, run
from truestroke.control.reference import ReferenceController
from truestroke.control.stage import MOST_DEAD, Stage, found
from truestroke.plant import StagePlant, StageSettings
from truestroke.signals.judgement import judge
from truestroke.signals.trajectories import sine
from truestroke.studies.robustness.fast.sample import sample

RATE, LIMITS = 5000.0, (-0.6, 3.6)
AXIS = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": LIMITS, "slew_limit": 2e4}
STAGE = StageSettings(sample_rate=RATE, resonances=(340.0,), dampings=(0.008,), voltage_limits=LIMITS, noise=0.01)


def dynamics(times: float):
    """Those of the stage with all of its modes elsewhere."""
    right = STAGE.dynamics()
    return replace(right, modes=tuple(replace(mode, frequency=times * mode.frequency) for mode in right.modes))


def wave(duration: float = 2.0, frequency: float = 90.0):
    return sine(frequency=frequency, peak_to_peak=18.0, offset=12.0, duration=duration, sample_rate=RATE)


def followed(kind: str, times: float) -> tuple[AdaptiveController, np.ndarray]:
    """A controller whose resonances are wrong by this factor, and its true error, um: at last below 1 % rms."""
    controller = AdaptiveController(**AXIS, dynamics=dynamics(times))
    recording = run(wave(), controller, StagePlant(replace(STAGE, hysteresis_kind=kind), seed=1))
    error: np.ndarray = recording["true"] - recording["desired"]
    assert error[-5000:].std() < 0.01 * 18.0
    return controller, error


@pytest.mark.parametrize(
    ("kind", "times"),
    [(kind, times) for kind in ("plays", "preisach", "bouc-wen") for times in (0.5, 0.8, 1.25, 2.0)],
)
@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_the_stage_that_the_measurements_show_takes_their_place(kind: str, times: float) -> None:
    """The resonance that the controller states.

    Where it is the wrong one, the law learns the difference in 0.4 s: from then on below 1.5 % of peak to peak.
    """
    controller, error = followed(kind, times)
    assert controller.resonance == pytest.approx(340.0, rel=0.05) or np.abs(error[2000:]).max() < 0.015 * 18.0


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize(("number", "before"), [(10, 138.0), (50, 114.0)])
def test_a_burst_does_not_wait_for_eight_windows(number: int, before: float) -> None:
    """f0 given twice as high: largest error after half a second, % of peak to peak, and `before` when it waited."""
    rms, largest = wrong_dynamics.errors(sample(4242, number, ["measured"]), times=2.0)
    assert largest < before / 50
    assert rms < 0.1


@pytest.mark.parametrize("kind", ["plays", "preisach", "bouc-wen"])
@pytest.mark.parametrize("times", [0.85, 1.0, 1.15])
@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_a_resonance_that_is_given_is_a_stage_at_once(kind: str, times: float) -> None:
    """Without it the first half second has up to 18 % of peak to peak, and before decision 217 2.4 % rms stayed."""
    plant = StageSettings(sample_rate=10_000.0, resonances=(1200.0,), dampings=(0.01,), hysteresis_kind=kind)
    controller = AdaptiveController(
        sample_rate=10_000.0, stroke=24.0, voltage_limits=LIMITS, slew_limit=2e4, resonance=1200.0 * times
    )
    motion = sine(frequency=250.0, peak_to_peak=20.0, offset=12.0, duration=2.0, sample_rate=10_000.0)
    recording = run(motion, controller, StagePlant(plant, seed=1))
    error = recording["true"] - recording["desired"]
    assert error[10_000:].std() < 0.004 * 20.0


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_a_second_mode_far_above_the_resonance_that_is_given_does_not_take_its_place() -> None:
    """A slow sine that shows 199 Hz behind 83 Hz, given as 95 Hz: it did, and the next fast motion burst."""
    modes = [(83.0, 0.068, 0.854), (199.4, 0.0054, 0.146)]
    make = partial(OtherStructure, modes, RATE, limits=(0.0, 100.0), stroke=100.0, lag=941.0, seed=3)
    (bottom, top), stage = travel(make(hysteresis=Relays(0.14))), make(hysteresis=Relays(0.14))
    middle, span, begins = (bottom + top) / 2, top - bottom, round(0.1 * RATE)
    slow = tone(np.arange(round(RATE)) / RATE, 5.0, 0.35 * span) * np.minimum(1, np.arange(round(RATE)) / begins)
    motion = np.concatenate([middle * rise(begins, RATE), np.add(slow, [[middle], [0], [0]])], axis=1).T
    kernel = AdaptiveController(sample_rate=RATE, stroke=100.0, voltage_limits=(0.0, 100.0), resonance=95.45)
    text = ReferenceController(kernel.settings)
    stage.open()
    for z_d, zdot_d, zddot_d in motion.tolist():
        volts = kernel.command(z_d, zdot_d, zddot_d)
        assert text.command(z_d, zdot_d, zddot_d) == volts
        z = float(stage.exchange(np.array([volts]))[0])
        kernel.adapt(z), text.adapt(z)
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert kernel.resonance == pytest.approx(95.45)


def test_the_verdict_names_both_resonances() -> None:
    """With the right dynamics there is no such reason, and the run is good."""
    for times, level in ((0.8, "doubtful"), (1.0, "good")):
        plant = StagePlant(replace(STAGE, hysteresis_kind="preisach"), seed=1)
        verdict = judge(run(wave(), AdaptiveController(**AXIS, dynamics=dynamics(times)), plant))
        assert verdict.level == level
        said = [reason for reason in verdict.reasons if "272 Hz" in reason and "showed one of 3" in reason]
        assert bool(said) == (times == 0.8)


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
def test_dynamics_that_are_right_stay() -> None:
    """Nothing is looked for, with any hysteresis, after a jump of 5 % and without one."""
    for kind in ("plays", "bouc-wen"):
        for change in (1.0, 0.95):
            plant = replace(STAGE, hysteresis_kind=kind, resonance_change=change, resonance_change_time=0.5)
            controller = AdaptiveController(**AXIS, dynamics=dynamics(1.0))
            run(wave(1.0), controller, StagePlant(plant, seed=1))
            assert controller.resonance == 340.0


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize("other", [24.0, 60.0, 150.0])
def test_the_sensor_of_another_axis_is_no_stage(other: float) -> None:
    """It shows a sine of another axis for half a second. Afterwards the dynamics that were given are in use."""
    controller, plant = AdaptiveController(**AXIS, dynamics=dynamics(1.0)), StagePlant(STAGE, seed=1)
    plant.open()
    motion, error = wave(2.5, 20.0), []
    for k, (z_d, zdot_d, zddot_d) in enumerate(zip(motion.position, motion.velocity, motion.acceleration, strict=True)):
        z = float(plant.exchange(np.array([controller.command(z_d, zdot_d, zddot_d)]))[0])
        failed = 1.0 <= k / RATE < 1.5
        controller.adapt(12.0 + 9.0 * math.sin(2 * math.pi * other * k / RATE) if failed else z)
        error.append(z - z_d)
    assert controller.resonance == 340.0
    assert np.std(error[-2500:]) < 0.01 * 18.0  # weights of half a second of another axis are forgotten slowly


@pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")
@pytest.mark.parametrize("known", [{"dynamics": dynamics(0.8)}, {"dynamics": dynamics(2.0)}, {"resonance": 250.0}])
def test_the_kernel_is_the_numpy_text(known: dict[str, Any]) -> None:
    """Commands, flags and innovations of every tick, with lost samples; the kernel is saved and restored on its way.

    Its covariance is that of the text, too, where it is read in the tick that puts the stage into the model.
    """
    settings = ControllerSettings(**AXIS, **known)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant, motion = StagePlant(replace(STAGE, hysteresis_kind="preisach"), seed=1), wave(0.5)
    plant.open()
    strain, before = kernel.strain(motion.position), kernel.resonance
    for k, (z_d, zdot_d, zddot_d) in enumerate(zip(motion.position, motion.velocity, motion.acceleration, strict=True)):
        if k in (700, 1500, 2500):
            restored = AdaptiveController.from_settings(settings)
            restored.restore(kernel.state())
            kernel = restored
        about = {} if strain is None else {"strain_d": strain[k]}
        x = kernel.command(z_d, zdot_d, zddot_d, **about)
        assert text.command(z_d, zdot_d, zddot_d, **about) == x
        z = math.nan if k % 901 == 900 else float(plant.exchange(np.array([x]))[0])
        kernel.adapt(z)
        text.adapt(z)
        assert kernel.flag_bits == text.flag_bits
        assert kernel.innovation == text.innovation
        if before != kernel.resonance and not math.isclose(kernel.diagnostics.trace_P, np.trace(text.law.P)):
            pytest.fail(f"tick {k}: the covariance is another one")
        before = kernel.resonance
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert kernel.resonance == pytest.approx(340.0, rel=0.1)


def test_a_stage_that_replaces_another_may_be_later() -> None:
    """It needs older strains than the one before: the NumPy text had dropped them."""
    early, late = (Stage(found(0.05, 1 / RATE, dead), 1) for dead in (0, MOST_DEAD))
    for k in range(60):
        early.strain[k] = float(k)
        early.expected()
        early.notched(float(k))
    late.go_on(early.ticks, early.strain, early.z)
    assert math.isfinite(late.expected())
