"""A further mode that the dynamics do not have: law and feedback leave what is beyond the resonance alone."""

import numpy as np
import pytest
from benchmarks.unseen_mode import with_a_further_mode

from truestroke import AdaptiveController, ControllerSettings, Dynamics, run, trajectories
from truestroke.control.reference import ReferenceController
from truestroke.plant import StagePlant
from truestroke.signals.judgement import judge
from truestroke.signals.trajectories import Trajectory

pytestmark = pytest.mark.filterwarnings("ignore::truestroke.LimitWarning")


def sine(rate: float, frequency: float, duration: float = 2.0) -> Trajectory:
    return trajectories.sine(frequency=frequency, peak_to_peak=20.0, offset=12.0, duration=duration, sample_rate=rate)


def controller_of(dynamics: Dynamics, **more: object) -> AdaptiveController:
    return AdaptiveController.from_settings(settings_of(dynamics, **more))


def settings_of(dynamics: Dynamics, **more: object) -> ControllerSettings:
    axis = {"stroke": 24.0, "voltage_limits": (-0.6, 3.6), "slew_limit": 1e5}
    return ControllerSettings(sample_rate=dynamics.sample_rate, dynamics=dynamics, **axis | more)


@pytest.mark.parametrize(
    ("rate", "f0", "further", "share", "damping", "motion", "kind"),
    [
        (5000.0, 370.0, 2.26, 0.08, 0.008, 0.193, "plays"),
        (5000.0, 175.0, 3.48, 0.08, 0.006, 0.15, "preisach"),
        (20_000.0, 1401.0, 2.35, 0.07, 0.005, 0.4, "plays"),
    ],
)
def test_the_feedback_does_not_drive_a_mode_that_the_measurement_did_not_see(
    rate: float, f0: float, further: float, share: float, damping: float, motion: float, kind: str
) -> None:
    """It did until the end, with 20 % of the motion."""
    stage, seen = with_a_further_mode(rate, f0, further * f0, share, damping, kind)
    controller = controller_of(seen)
    recording = run(sine(rate, motion * f0), controller, StagePlant(stage, seed=1))
    error = (recording["true"] - recording["desired"])[round(rate) :]
    assert controller.beyond_resonance[0] == pytest.approx(further * f0, rel=0.06)
    assert "are not in the dynamics: measure them again" in str(controller)
    assert error.std() < 0.003 * 20.0
    assert np.abs(error).max() < 0.02 * 20.0
    heard, amplitude = controller.beyond_resonance
    assert recording.metadata["beyond_resonance"] == {"frequency_hz": heard, "amplitude_um": amplitude}
    rang = f"The stage rang at {heard:.4g} Hz with {amplitude:.2g} um"
    said = any(reason.startswith(rang) and "`truestroke bode`" in reason for reason in judge(recording).reasons)
    assert said is (amplitude > 0.005 * 20.0)


def test_the_law_does_not_take_a_further_mode_for_hysteresis() -> None:
    """The fifteenth harmonic of the motion meets the mode; learning made the error ten times larger within 3 s."""
    stage, seen = with_a_further_mode(20_000.0, 1952.0, 3.257 * 1952.0, 0.064, 0.003, "plays")
    controller = controller_of(seen, feedback=False)
    recording = run(sine(20_000.0, 423.0, 3.0), controller, StagePlant(stage, seed=1))
    error = (recording["true"] - recording["desired"])[40_000:]
    assert error.std() < 0.0015 * 20.0
    assert np.isnan(controller.load[0])  # it is no load from outside


def test_the_kernel_leaves_a_further_mode_alone_with_the_bits_of_the_numpy_text() -> None:
    stage, seen = with_a_further_mode(5000.0, 370.0, 2.26 * 370.0, 0.08, 0.008, "plays")
    settings = settings_of(seen)
    controller, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    plant, wave = StagePlant(stage, seed=1), sine(5000.0, 71.4)
    plant.open()
    for k, z_d in enumerate(wave.position[:3500].tolist()):
        motion = z_d, float(wave.velocity[k]), float(wave.acceleration[k])
        volts = controller.command(*motion)
        assert text.command(*motion) == volts, k
        z = float(plant.exchange(np.array([volts]))[0])
        if k % 197 != 5:
            controller.adapt(z)
            text.adapt(z)
    assert any(line.beyond for line in text._state.hum.heard)
