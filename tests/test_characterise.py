"""Sec. 2.4 on any actuator: known lines are found, bars tell the truth, nothing is lost when something fails."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import linregress, t

from truestroke import Characterisation, RunInterrupted, SettingError, Timing, characterise
from truestroke.cli import main
from truestroke.identification import load_model, save_model
from truestroke.plant import MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant
from truestroke.runtime.realtime import config
from truestroke.signals.recording import Recording
from truestroke.signals.trajectories import random_wave
from truestroke.studies.characterisation import NotConverged, fit_lines, page, sweep
from truestroke.studies.characterisation.lines import RATE_SCALE

pytestmark = pytest.mark.usefixtures("each_picture_once", "no_waiting")
A_P = np.array([8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23])  # um/V, Sec. 4.3
B_P = np.array([-0.9, 1.03, -0.244, 0.1, 0.05, -0.02, 0.01, -0.01])
THRESHOLDS = MatchedSettings().thresholds
LIMITS = (-0.6, 3.6)
SWEEP = {"stroke": 38.0, "speeds": (75.0, 150.0, 300.0), "duration": 2.0}
KNOWN = {**SWEEP, "voltage_limits": LIMITS, "thresholds": THRESHOLDS}


@cache
def matched(seed: int = 0) -> Characterisation:
    return characterise(MatchedPlant(sweep(**SWEEP).velocity, seed=seed), **KNOWN)


@cache
def realistic(*without: str, **settings: float) -> Characterisation:
    return characterise(RealisticPlant(PlantSettings(**settings).without(*without)), voltage_limits=LIMITS, **SWEEP)


class Wrapped:
    """A matched plant, with something between it and the world."""

    def __init__(self, change) -> None:
        self.plant, self.change, self.done = MatchedPlant(sweep(**SWEEP).velocity), change, 0
        self.volts: list[float] = []

    def open(self) -> Timing:
        return self.plant.open()

    def exchange(self, volts):
        self.volts += volts.tolist()
        self.done += volts.size
        return self.change(self.plant.exchange(volts), self.done)


# ---- Lines that are known ------------------------------------------------------------------------------------------


def test_known_lines_lie_within_the_stated_intervals_as_often_as_stated() -> None:
    found = [matched(seed) for seed in range(12)]
    errors = np.array([[f.a - A_P, f.b - B_P] for f in found])
    deviations = np.array([[f.a_deviations, f.b_deviations] for f in found])
    inside = np.abs(errors) < t.ppf(0.975, 4) * deviations  # six velocities, two parameters
    assert found[0].quantile() == pytest.approx(t.ppf(0.975, 4))
    assert 0.88 < inside.mean() < 0.995
    assert np.sqrt(np.mean(errors**2)) < 0.03  # um/V
    assert all(f.converged.all() for f in found)
    assert [f.misfit for f in found] == pytest.approx([0.05] * 12, rel=0.1)  # um: the sensor noise and nothing else


def test_lines_and_bars_are_those_of_any_textbook() -> None:
    found = matched()
    for i in range(8):
        line = linregress(RATE_SCALE * found.velocities, found.weights[:, i])
        assert (found.a[i], found.b[i]) == pytest.approx((line.intercept, line.slope))
        assert (found.a_deviations[i], found.b_deviations[i]) == pytest.approx((line.intercept_stderr, line.stderr))
        assert found.r_squared[i] == pytest.approx(line.rvalue**2)


def test_the_model_drives_another_motion_without_a_sensor(tmp_path: Path) -> None:
    wave = random_wave(velocity_limit=250.0, duration=4.0, seed=5)
    save_model(tmp_path / "stage.toml", matched().actuator_model)
    models = (
        matched().model.invert(wave.position, wave.velocity),
        load_model(tmp_path / "stage.toml").invert(wave.position, 2000.0, velocity=wave.velocity),
    )
    for volts in models:
        plant = MatchedPlant(wave.velocity)
        plant.exchange(volts)
        assert np.sqrt(np.mean((plant.truth - wave.position) ** 2)) < 0.05  # um, of 28.6


# ---- What an actuator does not do, is not found --------------------------------------------------------------------


def test_no_rate_dependence_is_seen_where_there_is_none() -> None:
    for found in (realistic("asymmetry", "creep"), realistic()):
        assert not found.branches.rate_dependent.any()
        sentence = page.verdict(found)[0]
        leans = bool(np.any(np.abs(found.b) > found.quantile() * found.b_deviations))
        assert ("No rate dependence" in sentence) is not leans  # never beside a b that is not 0 by its interval
        assert ("Within a direction no weight is seen to change" in sentence) is leans
    symmetrical, real = realistic("asymmetry", "creep"), realistic()
    assert f"That of the line through both directions, {real.b[0]:.3f} ± " in page.verdict(real)[0]
    assert "is the step between them" in page.verdict(real)[0]
    assert np.all(np.abs(symmetrical.b) < symmetrical.quantile(0.99) * symmetrical.b_deviations)
    assert np.abs(symmetrical.b).max() < 0.05
    assert np.abs(symmetrical.branches.jump).max() < 0.1 < 0.5 < np.abs(real.branches.jump).max()
    assert real.branches.parted.any()
    assert matched().branches.rate_dependent[:3].all()
    assert not matched().branches.parted.any()


def test_a_slower_amplifier_is_a_delay_and_no_rate_dependence() -> None:
    fast, slow = (realistic("asymmetry", "creep", amplifier_bandwidth=hz).branches for hz in (1000.0, 250.0))
    assert slow.lag - fast.lag == pytest.approx(-(1 / 250 - 1 / 1000) / (2 * np.pi), rel=0.3)  # s
    assert not slow.rate_dependent.any()


def test_zero_point_of_the_sensor_and_lost_samples_do_not_matter() -> None:
    def bad_sensor(z, done):
        return np.where(done % 17 == 0, np.nan, z + 1.5)

    found = characterise(Wrapped(bad_sensor), **KNOWN)
    assert found.offset == pytest.approx(1.5, abs=0.03)
    np.testing.assert_allclose(found.a, A_P, atol=0.1)
    np.testing.assert_allclose(found.b, B_P, atol=0.1)
    assert np.isnan(found.recording["measured"]).sum() > 500


# ---- Safety --------------------------------------------------------------------------------------------------------


def test_what_was_recorded_before_a_failure_is_kept_and_enough_for_lines() -> None:
    wave = sweep(**SWEEP)
    last = int(np.flatnonzero(wave.velocity == 300.0)[2000])

    def broken(z, done):
        if done == last:
            raise OSError("the cable came off")
        return z

    with pytest.raises(RunInterrupted, match="cable") as stop:
        characterise(Wrapped(broken), **KNOWN)
    recording = stop.value.recording
    assert recording["time"].size == last - 1
    found = fit_lines(recording, thresholds=THRESHOLDS)
    assert found.velocities[found.converged].tolist()[1:5] == [-150.0, -75.0, 75.0, 150.0]
    np.testing.assert_allclose(found.a, A_P, atol=0.2)


def test_an_actuator_that_does_not_follow_is_told_and_stays_within_its_limits() -> None:
    reversed_sensor = Wrapped(lambda z, _: -z)
    with pytest.raises(NotConverged, match=r"0 of the speeds \(75, 150, 300 um/s\)") as stop:
        characterise(reversed_sensor, **KNOWN, slew_limit=40.0)
    volts = np.array(reversed_sensor.volts)
    assert LIMITS[0] <= volts.min() < volts.max() <= LIMITS[1]
    assert np.abs(np.diff(volts, prepend=0.0)).max() <= 40.0 / 2000.0 * (1 + 1e-9)
    assert stop.value.recording["volts"].size == volts.size


def test_a_speed_that_is_not_followed_is_left_out() -> None:
    """Its measurement saturates while the wave is fast, as a sensor does that is too slow or too short."""
    start = int(np.flatnonzero(sweep(**SWEEP).velocity == 300.0)[0])
    found = characterise(Wrapped(lambda z, done: np.minimum(z, 30.0) if done > start else z), **KNOWN)
    assert found.converged.tolist() == [False, True, True, True, True, False]
    np.testing.assert_allclose(found.a, A_P, atol=0.2)
    verdict = page.judged(found)
    assert verdict.level != "good"
    assert verdict.reasons[-1] == "Not followed, and left out: 300 um/s."
    assert page.speed_table(found)[1][-1][-1] == "no"


def test_triangles_start_slowly_and_never_jump() -> None:
    wave = sweep(stroke=30.0, speeds=(300.0, 70.0), duration=2.0)
    assert wave.position[0] == wave.velocity[0] == 0.0
    assert np.abs(np.diff(wave.position)).max() <= 300.0 / 2000.0 * (1 + 1e-9)
    slow = wave.time[np.abs(wave.velocity) == 70.0]
    assert slow[0] == 1.0  # s: the ramp
    for speed in (70.0, 300.0):
        assert np.sum(np.diff(wave.velocity) == -2 * speed) >= 5  # upper corners


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speeds": (100.0,)}, "speeds = .*at least two"),
        ({"speeds": (100.0, -5.0)}, "speeds = -5"),
        ({"stroke": 0.0}, "stroke"),
        ({"duration": np.nan}, "duration"),
        ({"voltage_limits": (3.0, 1.0)}, "voltage_limits"),
    ],
)
def test_settings_are_checked_before_anything_moves(change: dict[str, object], message: str) -> None:
    actuator = Wrapped(lambda z, _: z)
    with pytest.raises(SettingError, match=message):
        characterise(actuator, **{**KNOWN, **change})
    assert not actuator.volts


def test_a_play_that_does_not_move_is_refused() -> None:
    with pytest.raises(SettingError, match=r"largest of thresholds = 1.9 V"):
        fit_lines(matched().recording, thresholds=(0.0, 0.5, 1.9))


@pytest.mark.parametrize("ticks", [0, 1, 4000])
def test_a_recording_without_passes_is_told(ticks: int) -> None:
    whole = matched().recording.channels
    fast = {name: c for name, c in whole.items() if c.time == "time"}
    with pytest.raises(NotConverged, match="none complete"):
        fit_lines(Recording({name: dataclasses.replace(c, data=c.data[:ticks]) for name, c in fast.items()}))
    with pytest.raises(SettingError, match="recording = without desired"):
        fit_lines(Recording({"time": whole["time"]}))


# ---- The command ---------------------------------------------------------------------------------------------------


def call(*arguments: str):
    return CliRunner().invoke(main, ["characterise", *arguments])


def test_the_command_writes_model_recording_and_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = call("--speeds", "100,200,300", "--duration", "2", "--output", "stage", "--plots", "pictures", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pictures", "stage.h5", "stage.html", "stage.toml"]
    assert len(told["pictures"]) == len(list((tmp_path / "pictures").iterdir())) == 4
    assert load_model("stage.toml").weights[0:16:2].tolist() == told["a"]
    text = (tmp_path / "stage.html").read_text()
    assert "truestroke characterise --speeds 100,200,300 --duration 2 --output stage<" in text
    assert f"{told['a'][0]:.3f}" in text
    again = call("--record", "stage.h5", "--output", "again")
    assert again.exit_code == 0, again.output
    assert load_model("again.toml").weights.tolist() == load_model("stage.toml").weights.tolist()
    assert not (tmp_path / "again.h5").exists()
    for words in (f"{told['a'][0]:.3f}", "300 um/s", "again.toml"):
        assert words in again.output


def test_the_command_drives_hardware_within_its_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(config.example().replace("[-0.6, 3.6]", "[-0.1, 1.5]"))
    short = ("--stroke", "10", "--speeds", "200,300", "--duration", "1.5", "--output", "stage")
    done = call("--config", "bench.toml", *short)
    assert done.exit_code == 0, done.output
    volts = Recording.load("stage.h5")["volts"]
    assert volts.min() >= -0.1
    assert volts.max() <= 1.5
    assert "--plant: means nothing with --config" in call("--config", "bench.toml", "--plant", "matched").output


def test_the_command_tells_what_it_cannot_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "is not numbers with commas" in call("--speeds", "fast").output
    done = call("--stroke", "60", "--speeds", "200,300", "--duration", "1", "--output", "far")
    assert done.exit_code == 1
    assert "0 of the speeds (200, 300 um/s) were followed" in done.output
    assert "far.h5" in done.output
    assert Recording.load("far.h5")["volts"].max() <= 3.6


def test_the_command_keeps_what_it_has_when_the_actuator_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    healthy, ticks = RealisticPlant.exchange, iter(range(12000))

    def exchange(self, volts):
        if next(ticks, None) is None:
            raise OSError("the cable came off")
        return healthy(self, volts)

    monkeypatch.setattr(RealisticPlant, "exchange", exchange)
    done = call("--speeds", "200,250,300", "--duration", "2", "--output", "part")
    assert done.exit_code == 1
    assert "the cable came off; the 12000 ticks so far are in part.h5" in done.output
    rest = call("--record", "part.h5", "--output", "rest", "--json")
    assert rest.exit_code == 0
    assert json.loads(rest.output)["verdict"] == "doubtful"
