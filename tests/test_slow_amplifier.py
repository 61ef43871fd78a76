"""An amplifier that is slower than the stage, with nothing given: it is found with the resonance, and undone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from truestroke import AdaptiveController, run
from truestroke.control.reference import ReferenceController
from truestroke.control.reference.found import LAGS, behind_lag, follow_slower
from truestroke.control.reference.terms import move_voltage
from truestroke.plant import StagePlant, StageSettings
from truestroke.studies.robustness.fast.sample import sample
from truestroke.studies.robustness.fast.table import record, stage_of

LIMITS = (-0.6, 3.6)
SPAN = 16.0  # um


def stage(rate: float, f0: float, corner: float, **changes) -> StageSettings:
    usual = {"dampings": (0.02,), "noise": 0.005, "hysteresis_kind": "preisach", "dead_time": 1.5 / rate}
    return StageSettings(
        sample_rate=rate, resonances=(f0,), amplifier_bandwidth=corner, voltage_limits=LIMITS, **usual | changes
    )


def tones(rate: float, f0: float, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three tones of up to f0 / 4, with their rates."""
    t, z = np.arange(round(duration * rate)) / rate, np.zeros((3, round(duration * rate)))
    for i, f in enumerate((f0 / 37, f0 / 11, f0 / 4)):
        w, phase = 2 * np.pi * f, 2.1 * i
        z += np.array([np.sin(w * t + phase), w * np.cos(w * t + phase), -w * w * np.sin(w * t + phase)]) / (i + 1)
    z *= SPAN / np.ptp(z[0])
    z[0] += 4 - z[0].min()
    return z[0], z[1], z[2]


def follow(controller, plant: StageSettings, f0: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Volts, and the true error in % of peak to peak."""
    simulated, volts, error = StagePlant(plant, 1), [], []
    simulated.open()
    for z, zdot, zddot in zip(*tones(plant.sample_rate, f0, duration), strict=True):
        volts.append(controller.command(z, zdot, zddot))
        controller.adapt(simulated.exchange(np.array([volts[-1]]))[0])
        error.append(100 * (simulated.truth[0] - z) / SPAN)
    return np.array(volts), np.array(error)


def adaptive(rate: float, **changes) -> AdaptiveController:
    return AdaptiveController(sample_rate=rate, stroke=30.0, voltage_limits=LIMITS, **changes)


def late_rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error[error.size // 2 :] ** 2)))


@pytest.mark.parametrize(
    ("rate", "f0", "corner", "kind", "before"),
    [
        (5e3, 300.0, 66.0, "preisach", 0.35),
        (10e3, 500.0, 110.0, "preisach", 0.42),
        (10e3, 300.0, 60.0, "plays", 0.26),
    ],
)
def test_a_slow_amplifier_is_undone(rate: float, f0: float, corner: float, kind: str, before: float) -> None:
    """Rms of the second half, % of peak to peak; `before`: with its lag as a dead time of 8 ticks at most."""
    controller = adaptive(rate)
    _, error = follow(controller, stage(rate, f0, corner, hysteresis_kind=kind), f0, 3.0)
    kept = float(controller.state()["found_amplifier"][0])
    assert rate / (2 * np.pi) * (1 - kept) / kept == pytest.approx(corner, rel=0.3)
    assert late_rms(error) < before / 3


@pytest.mark.parametrize(("f0", "ticks"), [(300.0, 8), (600.0, 5), (900.0, 4), (700.0, 7)])
def test_a_dead_time_is_no_amplifier(f0: float, ticks: int) -> None:
    """It turns the resonance as far, but nothing of it is undone by a voltage that leads."""
    rate = 10e3
    controller = adaptive(rate)
    follow(controller, stage(rate, f0, 4000.0, dead_time=ticks / rate), f0, 2.0)
    assert controller.state()["found_dead"][0] > 2
    assert controller.state()["found_amplifier"][0] == 0


@pytest.mark.parametrize("ended", [False, True])
def test_the_kernel_is_the_numpy_text_behind_a_slow_amplifier(ended: bool) -> None:
    """Also where the stage is given up: the plays see the voltage itself again."""
    rate, f0 = 5e3, 300.0
    kernel = adaptive(rate)
    text = ReferenceController(kernel.settings)
    plant, motion = StagePlant(stage(rate, f0, 66.0), 1), tones(rate, f0, 0.6)
    plant.open()
    for k, (z, zdot, zddot) in enumerate(zip(*motion, strict=True)):
        if ended and k == 2500:
            assert text._state.amplifier > 0.9
            for one in (kernel, text):
                one.change(smoothing_time=0.01)  # the stage is known anew from here on
            assert text._state.amplifier == 0
        x = kernel.command(z, zdot, zddot)
        assert x == text.command(z, zdot, zddot)
        measured = plant.exchange(np.array([x]))[0]
        kernel.adapt(measured)
        text.adapt(measured)
    assert (text._state.amplifier > 0.9) or ended


def test_a_run_behind_a_slow_amplifier_goes_on_where_it_was_kept() -> None:
    rate, f0 = 5e3, 300.0
    plant, motion = StagePlant(stage(rate, f0, 66.0), 1), tones(rate, f0, 0.8)
    plant.open()
    whole, other = adaptive(rate), None
    for k, (z, zdot, zddot) in enumerate(zip(*motion, strict=True)):
        if k in (500, 3000):  # amid the first window, and with the amplifier
            other = adaptive(rate)
            other.restore(whole.state())
        x = whole.command(z, zdot, zddot)
        measured = plant.exchange(np.array([x]))[0]
        whole.adapt(measured)
        if other is not None:
            assert other.command(z, zdot, zddot) == x
            other.adapt(measured)
    assert whole.state()["found_amplifier"][0] > 0.9


@pytest.mark.parametrize("radians", [2.6, 3.1, 4.4, 6.0, 7.5])
def test_the_voltage_behind_a_lag_is_that_of_its_recursion(radians: float) -> None:
    """Between the lags that are followed, within 1 % of the range, in sines of up to a third of the centre."""
    state = ReferenceController(adaptive(5e3).settings)._state
    state.estimator.centre = 0.02
    ticks = radians / (2 * np.pi * 0.02)
    for f in (0.001, 0.003, 0.0066):
        u, state.slower = 2 + np.sin(2 * np.pi * f * np.arange(4000)), [0.0] * len(LAGS)
        for x in u.tolist():
            follow_slower(state, x)
        exact = lfilter([1 / (1 + ticks)], [1, -ticks / (1 + ticks)], u)[-1]
        assert behind_lag(state, ticks) == pytest.approx(exact, abs=0.02)


def test_plays_that_move_go_with_the_voltage_and_others_stay() -> None:
    state = ReferenceController(adaptive(5e3).settings)._state
    memory, r = state.now, state.thresholds
    memory.play = 2.0 - r  # all of them move upwards
    memory.play[3] += 1.2 * r[3]  # but one
    before = memory.play.copy()
    move_voltage(state, memory, 1.9)
    assert memory.play[0] == 1.9
    others = np.arange(r.size) != 3
    np.testing.assert_allclose(memory.play[others], before[others] - 0.1, rtol=1e-12)
    assert memory.play[3] == pytest.approx(min(before[3], 1.9 + r[3]))
    assert np.all(np.abs(memory.play - 1.9) <= r * (1 + 1e-12))


# ---- What was seen beside it, in runs of the fast study with nothing given ------------------------------------------


def rms_of(seed: int, number: int) -> float:
    """Of the second half, % of peak to peak."""
    recording = record(seed, number, "unknown")
    return late_rms(100 * (recording["true"] - recording["desired"]) / np.ptp(recording["desired"]))


def test_a_stage_that_was_given_up_is_not_put_into_the_model_again() -> None:
    """A sine on 1153 Hz that shows 800 Hz: six times it came back within 2 s, with 40 to 70 % each time; 12 %."""
    assert rms_of(9876, 132) < 2


def test_a_resonance_that_a_slow_raster_rings_at_is_no_load() -> None:
    """The 19th harmonic of 20.9 Hz at 397 Hz: a window has a single period of the motion, and it was a load; 2.0 %."""
    assert rms_of(8291, 45) < 0.1


def test_a_slow_amplifier_of_the_study() -> None:
    """One of 13 Hz before 67 Hz, in several tones: 0.9 % before."""
    one = sample(4343, 5, ["unknown"])
    plant = StagePlant(dataclasses.replace(stage_of(one), amplifier_bandwidth=18.6), one.seed)
    recording = run(one.motions["unknown"], AdaptiveController.from_settings(one.controllers["unknown"]), plant)
    error = 100 * (recording["true"] - recording["desired"]) / one.sampled["span"]["unknown"]
    assert late_rms(error) < 0.3
