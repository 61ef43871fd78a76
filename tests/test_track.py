"""`truestroke track` with the simulated stage: its dynamics from `truestroke bode`, and what does not fit them."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import truestroke
from truestroke import Dynamics, Mode
from truestroke.cli import main
from truestroke.control.baselines import ConstantGain
from truestroke.studies import tracking

RASTER = ("track", "--trajectory", "raster", "--frequency", "60", "--peak-to-peak", "15", "--duration", "1", "--json")


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stage(700.0).save("dynamics.toml")


def stage(frequency, rate=10_000.0):
    return Dynamics(sample_rate=rate, modes=(Mode(frequency=frequency, damping=0.02),), amplifier_bandwidth=3000.0)


def call(*arguments):
    return CliRunner().invoke(main, [*RASTER, *arguments])


@pytest.mark.usefixtures("each_picture_once")
def test_dynamics_make_a_fast_raster_follow():
    found = {}
    for name, given in (("without", ("--plant", "stage")), ("with", ("--dynamics", "dynamics.toml"))):
        done = call(*given, "--output", name)
        found[name] = json.loads(done.stdout)["true_rmse_um"]
    assert found["with"] < 0.05
    assert found["without"] > 1.5 * found["with"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--dynamics", "none.toml"), "none.toml"),
        (("--dynamics", "dynamics.toml", "--plant", "realistic"), "--dynamics are of the simulated stage"),
        (("--dynamics", "dynamics.toml", "--controller", "paper"), "paper knows no dynamics"),
        (("--dynamics", "dynamics.toml", "--sample-rate", "5000"), "5000"),
        (("--dynamics", "other.toml"), "first resonance at 300 Hz, the simulated stage at 700 Hz"),
        (("--plant", "stage", "--change-at", "0.5"), "change"),
        (("--force",), "--force uses a --model whose verdict is bad: add --model FILE, or leave --force out."),
    ],
)
def test_what_does_not_fit_the_stage_is_refused(given, words):
    stage(300.0).save("other.toml")
    done = call(*given)
    assert done.exit_code in (1, 2), done.output
    assert words in " ".join(done.output.split())


def test_a_long_run_says_before_it_begins_how_long_it_takes(tmp_path, monkeypatch):
    monkeypatch.setattr(truestroke, "run", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    result = CliRunner().invoke(main, ["track", "--duration", "2500", "--output", str(tmp_path / "x")])
    assert "5e+06 ticks take about 35 s." in result.stderr


@pytest.mark.parametrize(("kind", "change_at"), [("realistic", 0.3), ("matched", 0.3), ("stage", None)])
def test_what_a_line_makes_of_the_motion_has_the_bits_of_its_run(kind, change_at, monkeypatch):
    monkeypatch.setattr(tracking, "BLOCK", 700)
    rate = tracking.STAGE_RATE if kind == "stage" else 2000.0
    wave = truestroke.trajectories.random_wave(duration=0.75, sample_rate=rate, peak_to_peak=25.0)
    plant = tracking.plant(kind, wave, 3, change_at)
    first = truestroke.run(wave, ConstantGain(tracking.SENSITIVITY, tracking.VOLTAGE_LIMITS), plant)
    shown = tracking.with_uncompensated(first, wave, plant)["uncompensated"]
    offset, gain = np.polynomial.Polynomial.fit(first["volts"], first["true"], 1).convert().coef
    line = ConstantGain(float(gain), tracking.VOLTAGE_LIMITS, offset=float(offset))
    assert shown.tobytes() == truestroke.run(wave, line, plant)["true"].tobytes()
