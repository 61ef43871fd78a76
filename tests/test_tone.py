"""A load of one frequency that nobody has named is no resonance of the stage, and what the stage does is no load."""

import math
import warnings

import numpy as np
import pytest
from benchmarks.unknown_loads import follow

from truestroke import AdaptiveController, ControllerSettings, LimitWarning, run, trajectories
from truestroke.base.typing import FloatArray
from truestroke.control.reference import ReferenceController
from truestroke.control.tone import ToneDetector
from truestroke.plant import StagePlant, StageSettings

RATE = 10_000.0
AXIS = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}


def heard(error: FloatArray, motion: float, centre: float, rate: float = RATE) -> ToneDetector:
    """An error, um, beside a sine of this frequency, Hz, about a centre, Hz."""
    tone = ToneDetector(centre / rate)
    for k, e in enumerate(error.tolist()):
        tone.update(e, math.cos(2 * math.pi * motion * k / rate))
    return tone


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("rate", [1000.0, 10_000.0, 50_000.0])
def test_frequency_and_amplitude_of_a_steady_tone(rate: float, seed: int) -> None:
    """Within 15 % of the centre, in noise of a tenth of it, beside an error of the motion ten times as large."""
    random = np.random.default_rng(seed)
    f = rate * math.exp(random.uniform(math.log(0.003), math.log(0.15)))
    centre, time = f * random.uniform(0.85, 1.15), np.arange(round(40 * rate / f)) / rate
    sine = 0.2 * np.sin(2 * np.pi * f * time + random.uniform(0, 2 * np.pi))
    slow = 2.0 * np.sin(2 * np.pi * 0.013 * f * time)
    tone = heard(sine + slow + 0.02 * random.standard_normal(time.size), 0.013 * f, centre, rate)
    assert tone.of_load * rate == pytest.approx(f, rel=0.01)
    assert tone.amplitude == pytest.approx(0.2 * (1 + np.cos(np.pi * 4 * (f / centre - 1) / 2)) / 2, rel=0.3)


@pytest.mark.parametrize("damping", [0.003, 0.01, 0.05, -0.005])
def test_what_decays_or_grows_is_no_load(damping: float) -> None:
    w = 2 * np.pi * 0.012 * np.arange(round(24 / 0.012))
    assert heard(np.exp(-damping * w) * np.sin(w), 3.0, 118.0).of_load == 0


@pytest.mark.parametrize(
    ("motion", "is_load"), [(40.0, False), (30.0, False), (6.0, False), (3.0, False), (32.0, True), (2.9, True)]
)
def test_a_harmonic_of_the_motion_is_no_load(motion: float, is_load: bool) -> None:
    """120 Hz is the third, fourth, twentieth and fortieth harmonic of 40, 30, 6 and 3 Hz; of 2.9 Hz it is none."""
    sine = np.sin(2 * np.pi * 120.0 * np.arange(9000) / RATE)
    assert (heard(sine, motion, 117.0).of_load > 0) is is_load


@pytest.mark.parametrize(("motion", "centre"), [(25.0, 16.394), (25.0, 19.48), (40.0, 17.57), (8.0, 27.0)])
def test_the_motion_beside_the_centre_is_no_load(motion: float, centre: float) -> None:
    """The blocks weaken it a thousand times, and what remains is as steady as a load of another frequency."""
    time, rate = np.arange(round(25 * 2000.0 / centre)) / 2000.0, 2000.0
    tone = heard(np.sin(2 * np.pi * motion * time), motion, centre, rate)
    assert tone.shown(0.0, 0) > 0  # as if nothing were known of the motion
    assert tone.shown(0.0, 20.5) == 0
    load = 0.01 * np.sin(2 * np.pi * 1.07 * centre * time)
    assert heard(load, motion, centre, rate).shown(0.9, 20.5) * rate == pytest.approx(1.07 * centre, rel=0.01)


def test_what_is_near_a_harmonic_is_no_load_beside_a_stage() -> None:
    """A harmonic that grows at a resonance turns its phase: 229.6 Hz in place of the fifth of 46.4 Hz, 232."""
    sine = np.sin(2 * np.pi * 229.6 * np.arange(9000) / 5000.0)
    tone = heard(sine, 46.4, 193.0, 5000.0)
    assert tone.shown(0.9, 40.5) * 5000.0 == pytest.approx(229.6, rel=0.01)  # what is listened for
    assert tone.of_load == 0  # beside a stage
    assert heard(sine, 44.5, 193.0, 5000.0).of_load * 5000.0 == pytest.approx(229.6, rel=0.01)  # 5.16 times that


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_no_load(seed: int) -> None:
    assert heard(np.random.default_rng(seed).standard_normal(4000), 5.0, 100.0).of_load == 0


def followed(known: str, f0: float, load: float, amplitude: float, motion: float, **of: object) -> tuple[float, float]:
    """Largest true error after 0.5 s over the amplitude of the load; first resonance in the model over f0, or NaN."""
    stage = StageSettings(
        sample_rate=RATE, resonances=(f0,), dampings=(0.02,), hysteresis_kind="preisach", noise=0.01, hum=amplitude,
        hum_frequency=load, **of,
    )  # fmt: skip
    wave = trajectories.sine(frequency=motion, peak_to_peak=12.0, offset=10.0, duration=3.0, sample_rate=RATE)
    given = {"nothing": {}, "f0": {"resonance": f0}, "dynamics": {"dynamics": stage.dynamics()}}[known]
    controller = AdaptiveController(**AXIS, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LimitWarning)
        recording = run(wave, controller, StagePlant(stage, seed=2))
    error = np.abs(recording["true"] - recording["desired"])[round(0.5 * RATE) :]
    return float(error.max() / amplitude), controller.resonance / f0


@pytest.mark.parametrize(
    ("known", "f0", "load", "amplitude", "motion", "most"),
    [
        ("nothing", 461.0, 74.0, 0.024, 4.0, 4.0),  # was 6.1 times the load, for the model had a stage of 81 Hz
        ("f0", 282.0, 100.0, 0.5, 5.0, 10.0),  # was 82, 100 Hz
        ("f0", 420.0, 170.0, 0.12, 30.0, 4.0),  # was 12, 197 Hz
        ("f0", 480.0, 147.0, 0.18, 40.0, 4.0),  # was 185, 149 Hz
        ("dynamics", 480.0, 147.0, 0.18, 40.0, 4.0),  # was 168
    ],
)
def test_a_load_takes_no_place_in_the_model(known, f0, load, amplitude, motion, most) -> None:
    """A pump of a few nanometres, nothing given; others that are larger, beside f0 or dynamics that are right."""
    assert followed(known, f0, load, amplitude, motion)[0] < most


def test_a_load_beside_a_harmonic_of_the_motion_does_not_replace_dynamics_that_are_right() -> None:
    """100 Hz, and the fourth harmonic of 28.2 Hz: a stage of 109 Hz took the place of 191 Hz, and burst to 57 times."""
    _, largest, _ = follow(13211, "dynamics", fast=True, named=False)
    assert largest < 5


def test_the_kernel_is_the_numpy_text_where_a_load_is_beside_a_harmonic_of_the_motion() -> None:
    """With right dynamics; where a tone was a load from 0.95 on as without them, commands differ from tick 1235 on."""
    stage = StageSettings(
        sample_rate=2000.0, resonances=(190.7,), dampings=(0.02,), hysteresis_kind="plays", noise=0.01, hum=0.3,
        hum_frequency=100.0,
    )  # fmt: skip
    settings = ControllerSettings(**AXIS | {"sample_rate": 2000.0}, dynamics=stage.dynamics())
    kernel, text, plant = (
        AdaptiveController.from_settings(settings),
        ReferenceController(settings),
        StagePlant(stage, 13211),
    )
    wave = trajectories.sine(frequency=28.186, peak_to_peak=12.0, offset=10.0, duration=1.3, sample_rate=2000.0)
    plant.open()
    for motion in zip(wave.position[:1400], wave.velocity[:1400], wave.acceleration[:1400], strict=True):
        volts = kernel.command(*motion)
        assert text.command(*motion) == volts
        z = float(plant.exchange(np.array([volts]))[0])
        kernel.adapt(z), text.adapt(z)
    np.testing.assert_array_equal(kernel.weights, text.weights)


def test_the_kernel_is_the_numpy_text_beside_a_load() -> None:
    """Commands, innovations and weights, every tick: a load is seen, and counts as noise."""
    settings = ControllerSettings(**AXIS)
    kernel, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    stage = StageSettings(sample_rate=RATE, resonances=(461.0,), hysteresis_kind="preisach", noise=0.01)
    plant = StagePlant(stage, seed=2)
    plant.open()
    wave = trajectories.sine(frequency=4.0, peak_to_peak=12.0, offset=10.0, duration=0.6, sample_rate=RATE)
    seen = 0.0
    for k, (z_d, zdot_d) in enumerate(zip(wave.position, wave.velocity, strict=True)):
        x = kernel.command(z_d, zdot_d)
        assert text.command(z_d, zdot_d) == x
        z = float(plant.exchange(np.array([x]))[0]) + 0.3 * math.sin(2 * math.pi * 430.0 * k / RATE)
        kernel.adapt(z)
        text.adapt(z)
        assert kernel.innovation == text.innovation
        seen = max(seen, text.law.load)
    np.testing.assert_array_equal(kernel.weights, text.weights)
    assert kernel.flag_bits == text.flag_bits
    assert seen > 0


def test_a_load_is_no_oscillation_of_the_loop() -> None:
    """Before, it ended twice in the weights of the start: an error of 35 times the load once it was no resonance."""
    largest, _ = followed("nothing", 400.0, 127.0, 0.5, 4.0)
    assert largest < 8
