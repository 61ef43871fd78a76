"""Waveforms from a model: they undo its prediction, keep the limits, and tell where they fall short."""

import dataclasses
import json
import re
import shlex
import warnings
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import example, given, settings
from hypothesis import strategies as st

from truestroke import LimitWarning, SettingError, trajectories
from truestroke.base.verdict import Verdict
from truestroke.cli import main
from truestroke.identification import (
    ActuatorModel,
    identify,
    load_model,
    load_waveform,
    read_record,
    save_model,
    save_waveform,
    waveform,
)
from truestroke.identification.waveform import verdict_of
from truestroke.model.sampled import respond
from truestroke.plant import RealisticPlant
from truestroke.signals.recording import Recording

FS = 2000.0


def straight(**changes):
    """10 um/V and nothing else."""
    return ActuatorModel(
        thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.zeros((3, 3)), stroke=20.0,
        voltage_range=(0.0, 2.0), velocity=100.0, **changes,
    )  # fmt: skip


def rich(delay=0.0, zero=0.0, lag=0.0, rate=0.6):
    """Every term: rate weights, two creep states, an offset, two terms of asymmetry."""
    terms = [8.0, -rate, 1.5, rate / 2, 1.0, 0.7, 0.5, 0.3, lag, 0.2, 0.4, -0.2]
    return ActuatorModel(
        thresholds=(0.0, 0.2, 0.45, 0.8), rate_dependent=(0, 1), creep_times=(0.02, 1.0), asymmetry=2, weights=terms,
        covariance=np.zeros((12, 12)), stroke=30.0, voltage_range=(-0.5, 3.0), rate_scale=1 / 1500, velocity=2000.0,
        delay=delay, zero=zero,
    )  # fmt: skip


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


# ---- The inverse ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "within"),
    [
        (rich(rate=0.0), 1e-9),
        (rich(rate=0.0, zero=-40.0), 1e-9),
        (rich(rate=0.0, delay=0.01), 1e-9),
        (rich(rate=0.0, delay=0.0102, lag=-1e-4), 3e-3),
        (rich(), 0.04),  # the forward model takes the velocity from a first prediction
    ],
    ids=["plain", "another zero", "delay of 20 samples", "lag and a part of a sample", "rate"],
)
def test_the_voltage_of_a_motion_makes_the_motion(model, within):
    """At 300 um/s, after a rest away from 0 V that is longer than the delay, with creep and asymmetry."""
    wave = trajectories.random_wave(duration=5.0, seed=3, peak_to_peak=20.0, velocity_limit=300.0)
    z_d = model.zero + 3.0 + np.concatenate([np.zeros(100), wave.position])
    volts = model.invert(z_d, FS)
    end = -round(model.delay * FS) - 2  # where there is nothing more to look ahead to
    assert np.ptp(volts) > 1.5
    assert np.abs(model.predict(volts, FS) - z_d)[:end].max() < within


def test_what_is_known_of_a_straight_line():
    """By hand: 10 um/V, 5 samples late, from 0.3 V."""
    z_d = np.array([3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 8.0, 4.0, 4.0, 4.0, 4.0, 4.0])
    volts = straight(delay=0.005).invert(z_d, 1000.0, velocity=np.zeros(12))
    np.testing.assert_allclose(volts, [0.3, 0.8, *[0.4] * 10], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    amplitude=st.floats(0.0, 80.0),
    frequency=st.floats(0.1, 60.0),
    low=st.floats(-1.0, 0.5),
    span=st.floats(0.1, 2.0),
    slew=st.floats(0.5, 500.0),
)
@example(amplitude=1.5, frequency=5.0, low=0.0, span=2.0, slew=114.0)  # the error comes a delay after the slew
def test_limits_are_never_exceeded(amplitude, frequency, low, span, slew):
    t = np.arange(600) / FS
    z_d = 10.0 + amplitude * np.sign(np.sin(2 * np.pi * frequency * t)) * np.abs(np.sin(2 * np.pi * 3 * t))
    made = waveform(rich(delay=0.003), z_d, FS, voltage_limits=(low, low + span), slew_limit=slew)
    assert low <= made.volts.min() <= made.volts.max() <= low + span
    assert np.abs(np.diff(made.volts)).max() <= slew / FS * (1 + 1e-9)
    if made.maximum > 0.05 * 30.0:  # a large error has a reason
        assert made.out_of_reach or made.too_fast


# ---- Where it falls short ------------------------------------------------------------------------------------------


def test_out_of_reach_is_told_where_and_how_far():
    """0 to 26 um and back in 2.6 s at 20 um/s, of which 20 um are in reach; then below 0 um."""
    t = np.arange(2700) / 1000.0
    z_d = np.where(t < 2.6, 26.0 - 20.0 * np.abs(t - 1.3), -1.0)
    made = waveform(straight(), z_d, 1000.0)
    up, down = made.out_of_reach
    assert up.start == pytest.approx(1.0, abs=2e-3)
    assert up.stop == pytest.approx(1.6, abs=2e-3)
    assert up.worst == pytest.approx(6.0, abs=0.02)
    assert (down.start, down.stop) == (2.6, 2.7)
    assert down.worst == pytest.approx(1.0)
    assert made.rmse == pytest.approx(rms(np.clip(z_d, 0, 20) - z_d))
    first, *_ = made.warnings
    assert first == (
        "out of reach: a voltage limit bounds it, 2 times, first at 1.001 s, 0.699 s in all, off by at most 6 um "
        "(1.001 to 1.600 s)"
    )


def test_too_fast_is_told_where_and_how_far():
    """A step of 10 um, 1 V, at 5 V/s: 0.2 s."""
    z_d = np.where(np.arange(1000) < 300, 4.0, 14.0)
    made = waveform(straight(), z_d, 1000.0, slew_limit=5.0)
    (late,) = made.too_fast
    assert (late.start, late.stop) == pytest.approx((0.3, 0.5), abs=2e-3)
    assert late.worst == pytest.approx(10.0, abs=0.06)
    assert made.out_of_reach == ()
    never = waveform(straight(), 4.0 + 0.01 * np.arange(1000.0), 1000.0, slew_limit=0.1)
    assert "holds the motion back in 100 % of the time" in " ".join(never.verdict.reasons)  # not in 1e+02 %


def test_what_the_record_never_showed_is_told():
    x = np.concatenate([np.full(100, 0.5), np.linspace(0.5, 2.5, 100), np.full(100, 2.5)])
    found = straight().beyond(x, 200.0)  # 2 V in 0.5 s: 40 um/s
    (volts,) = found.voltage
    assert volts.start == pytest.approx(0.875, abs=0.01)
    assert (volts.stop, volts.worst) == (1.5, 0.5)
    assert found.velocity == ()
    (fast,) = straight().beyond(x, 2000.0).velocity  # ten times as fast, of 100 um/s
    assert fast.worst == pytest.approx(300.0, rel=0.02)
    assert (fast.start, fast.stop) == pytest.approx((0.05, 0.1), abs=2e-3)
    same = straight().replace(velocity=40.4)  # a record whose text was rounded: its own speed is not beyond it
    assert same.beyond(x, 200.0).velocity == ()
    assert found.frequency == ()  # of a model that does not know what its record tests
    (below,) = straight().beyond([0.1, -0.3, 0.1], 10.0).voltage
    assert (below.start, below.stop, below.worst) == (0.1, 0.2, 0.3)
    made = waveform(straight(), np.full(50, 15.0), FS)
    assert made.warnings == ()
    assert made.beyond.voltage == made.beyond.velocity == ()


def test_the_array_of_a_motion_that_a_limit_forbids_is_warned_of():
    z = 10.0 - 8.0 * np.cos(np.arange(400) / 30.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        straight().invert(z, 1000.0)
        straight().invert(z + 2.3, 1000.0)  # by 0.3 um: less than is tolerable
    with pytest.warns(LimitWarning, match=r"0 to 2 V .* off by at most 6 um") as said:
        straight().invert(z + 8.0, 1000.0)
    assert said[0].filename == __file__
    with pytest.warns(LimitWarning, match="too fast"):
        straight().invert(z, 1000.0, slew_limit=20.0)


# ---- The verdict ---------------------------------------------------------------------------------------------------

CLEAN = {"held_out_rmse_um": 0.02}


@pytest.mark.parametrize(
    ("changes", "motion", "limits", "level", "reason"),
    [
        ({}, (16.0, 1.0), {}, "good", ""),
        ({}, (22.0, 1.0), {}, "doubtful", "out of reach of 0 to 2 V, those of the model's record: off by up to 1 um"),
        ({}, (26.0, 1.0), {}, "bad", "It asks for -3 to 23 um, and 0 to 20 um are predicted. Move it"),
        ({}, (26.0, 1.0), {"voltage_limits": (-1.0, 3.0)}, "doubtful", "The voltage is beyond that of the model's"),
        ({}, (48.0, 0.5), {"voltage_limits": (-2.0, 4.0)}, "bad", "by up to 70 % of its range"),
        ({}, (16.0, 6.0), {}, "good", ""),  # three times as fast as the record: 0.06 um may be hidden
        ({}, (16.0, 25.0), {}, "doubtful", "The motion is 13 times as fast as the model's record"),
        ({"metrics": {"held_out_rmse_um": 0.2}}, (16.0, 25.0), {}, "bad", "such as that of a lag, may be 2.5"),
        ({"tested_frequency": 2.0}, (16.0, 6.0), {}, "doubtful", "above 2 Hz, where the record tests no response"),
        ({"metrics": {"held_out_rmse_um": 0.5}}, (16.0, 1.0), {}, "doubtful", "The error of the model itself is 0.5"),
        ({"metrics": {"held_out_rmse_um": 0.5}}, (2.0, 1.0), {}, "bad", "25 % of the motion's peak-to-peak"),
        ({}, (16e-6, 1.0), {}, "doubtful", "The motion, 1.6e-05 um, is hidden by the error of the model itself, 0.02"),
        ({}, (0.2, 1.0), {}, "good", ""),
        ({"provenance": {"verdict": "doubtful", "reason_1": "Noise."}}, (16.0, 1.0), {}, "doubtful", "is doubtful: "),
        ({"provenance": {"verdict": "bad", "reason_1": "Swapped."}}, (16.0, 1.0), {}, "bad", "is bad: Swapped."),
        ({}, (16.0, 1.0), {"slew_limit": 3.0}, "bad", "The slew limit holds the motion back in"),
    ],
)  # fmt: skip
def test_the_verdict_says_whether_the_motion_is_made(changes, motion, limits, level, reason):
    """A sine about 10 um of (peak-to-peak, frequency); the record: 0 to 2 V, 100 um/s."""
    peak_to_peak, frequency = motion
    t = np.arange(4000) / 2000.0
    z = 10.0 - peak_to_peak / 2 * np.cos(2 * np.pi * frequency * t)
    made = waveform(straight(**{"metrics": CLEAN, **changes}), z, 2000.0, **limits)
    assert made.verdict.level == level, made.verdict
    assert reason in " ".join(made.verdict.reasons)


def test_a_motion_whose_range_is_reached_elsewhere_is_told_by_its_place():
    """It begins where hysteresis does not let it come back to."""
    model = rich(rate=0.0).replace(voltage_range=(0.0, 3.0))
    wanted = np.concatenate([np.linspace(0.4, 30.0, 400), np.linspace(30.0, 0.4, 400)])
    (reason,) = waveform(model, wanted, FS, rest=np.inf).verdict.reasons
    assert "At 0.3995 s it asks for 0.4 um, and 1." in reason


def test_a_step_that_the_slew_limit_delays_for_a_moment_is_not_bad():
    z_d = np.where(np.arange(1000) < 300, 4.0, 14.0)
    fast = straight(metrics=CLEAN).replace(velocity=1e5)
    assert waveform(fast, z_d, 1000.0, slew_limit=2000.0).verdict.level == "good"
    late = waveform(fast, z_d, 1000.0, slew_limit=20.0).verdict
    assert (late.level, len(late.reasons)) == ("doubtful", 1)


@pytest.mark.parametrize("model", [rich(rate=0.0), rich(rate=0.0, delay=0.01, zero=-40.0)])
@pytest.mark.parametrize("rest", [0.0, 0.5, 30.0])
def test_creep_that_has_not_ended_in_the_rest_goes_on(model, rest):
    """As behind a voltage that really rested for so long, from 0 V; and the inverse takes it off."""
    x = 1.5 + np.sin(np.arange(4000) / 300.0)
    before = np.concatenate([np.zeros(10), np.full(round(rest * FS), x[0])])
    np.testing.assert_allclose(
        model.predict(x, FS, rest=rest)[100:], model.predict(np.append(before, x), FS)[before.size :][100:], atol=2e-5
    )
    z = model.zero + 12.0 + 3.0 * np.sin(np.maximum(np.arange(4000) - 50, 0) / 300.0)  # still for longer than the delay
    volts = model.invert(z, FS, rest=rest)
    np.testing.assert_allclose(model.predict(volts, FS, rest=rest)[100:], z[100:], atol=1e-7)
    endless = model.predict(model.invert(z, FS), FS, rest=rest)
    assert np.abs(endless - z)[100:].max() > (0.1 if rest < 1.0 else 0.0)


def test_bad_arguments_are_named():
    with pytest.raises(SettingError, match=r"rest = -1.0 s: must be"):
        waveform(rich(), [1.0, 2.0], FS, rest=-1.0)
    with pytest.raises(SettingError, match=r"displacement.*at least two"):
        waveform(straight(), [1.0], FS)
    with pytest.raises(SettingError, match=r"displacement\[1\]"):
        waveform(straight(), [1.0, np.nan], FS)
    with pytest.raises(SettingError, match=r"csv or .npz"):
        save_waveform("wave.txt", waveform(straight(), [1.0, 2.0], FS))


@pytest.mark.parametrize("name", ["wave.csv", "wave.npz"])
def test_a_file_carries_what_speaks_against_its_waveform(tmp_path, name):
    """And one that is good is a table alone."""
    z = 10.0 - 10.0 * np.cos(np.arange(300) / 20.0)
    for scale, level in ((0.9, "good"), (1.12, "doubtful"), (2.0, "bad")):
        made = waveform(straight(metrics=CLEAN).replace(velocity=1e5), scale * z, FS, voltage_limits=(0.0, 2.3))
        save_waveform(tmp_path / name, made)
        read = load_waveform(tmp_path / name)
        assert (read.verdict, read.verdict.level) == (made.verdict, level)
        np.testing.assert_allclose(read.volts, made.volts, rtol=1e-11)
    if name == "wave.csv":
        whole = np.loadtxt(tmp_path / name, delimiter=",", skiprows=1)
        np.testing.assert_allclose(whole[:, 2], 2.0 * z, rtol=1e-11)
        assert (tmp_path / name).read_text().splitlines()[301] == "# verdict = bad"


@pytest.mark.parametrize("name", ["wave.csv", "wave.npz"])
@pytest.mark.usefixtures("no_waiting")
def test_playback_refuses_a_bad_waveform_and_says_a_doubtful_one(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("stage.toml").write_text(
        '[driver]\nname = "simulated"\n[[axis]]\nstroke = 30.0\nvoltage_limits = [-0.6, 3.6]\nslew = 400.0\n'
    )

    def playback(level, *words):
        made = waveform(straight(), 5.0 - 5.0 * np.cos(np.arange(400) / 50.0), 2000.0)
        save_waveform(name, dataclasses.replace(made, verdict=Verdict(level, ("It asks for more, by far.",))))
        command = ["playback", name, "--config", "stage.toml", "--overwrite", *words]
        return CliRunner().invoke(main, command)

    refused = playback("bad")
    assert (refused.exit_code, refused.stdout, Path("record.csv").exists()) == (4, "", False)
    assert "the verdict of this waveform is bad: It asks for more, by far. Make it anew" in refused.stderr
    for level, words in (("bad", ["--force"]), ("doubtful", [])):
        done = playback(level, *words)
        assert (done.exit_code, Path("record.csv").exists()) == (0, True), done.output
        assert "It asks for more, by far." in done.stdout
        assert json.loads(playback(level, *words, "--json").stdout)["waveform"]["verdict"] == level
    assert "verdict" not in playback("good").stdout


def test_comments_of_others_are_no_verdict(tmp_path):
    (tmp_path / "wave.csv").write_text("time,volts,desired\n0,0,0\n1,1,1\n2,2,2\n# verdict = fine\n# verdict\n")
    assert verdict_of(tmp_path / "wave.csv").level == "good"
    (tmp_path / "wave.csv").write_text("t,volts\r\n0,0\r\n1,1\r\n# verdict = bad,\r\n# reason_1 = Far, off.,\r\n")
    assert verdict_of(tmp_path / "wave.csv") == Verdict("bad", ("Far, off.",))  # as a spreadsheet saves it again


# ---- The command ---------------------------------------------------------------------------------------------------


@pytest.fixture
def call(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_model("model.toml", straight(zero=5.0))
    return lambda *words: CliRunner().invoke(main, ["invert", *words, "--model", "model.toml"])


def test_what_the_page_says_to_repeat_it_writes_the_same_again(call):
    """To the same names; a switch has no value, as --strict True had."""
    words = ["sine", "--duration", "1", "--peak-to-peak", "10", "--output", "wave one.npz", "--report", "one.html"]
    assert call(*words, "--strict").exit_code == 1  # there are warnings
    before = Path("one.html").read_text()
    (command,) = re.findall(r"<h2>To repeat it</h2>\s*<pre><code>(.*?)</code>", before)
    waveform = Path("wave one.npz").read_bytes()
    Path("wave one.npz").unlink()
    done = CliRunner().invoke(main, shlex.split(unescape(command))[1:])
    assert done.exit_code == 1, done.output
    assert Path("wave one.npz").read_bytes() == waveform
    assert f"<code>{command}</code>" in Path("one.html").read_text()


def test_command_writes_what_it_says(call):
    time = np.arange(400) / 1000.0
    z = 12.0 - 6.0 * np.cos(15.0 * time)
    np.savetxt("move.csv", np.column_stack([time, z]), delimiter=",", header="t,z", comments="")
    np.savetxt("alone.csv", z)
    for words in (["move.csv"], ["alone.csv", "--sample-rate", "1000"], ["move.csv", "--output", "wave.npz"]):
        done = call(*words)
        assert done.exit_code == 0, done.output
        assert "rmse       0.0000 um" in done.stdout
        assert "begins at 0.1 V" in done.stdout
        file = words[-1] if words[-1].endswith("npz") else "waveform.csv"
        played = load_waveform(file)
        assert played.sample_rate == pytest.approx(1000.0)
        np.testing.assert_allclose(played.desired, z, atol=1e-9)
        np.testing.assert_allclose(played.volts, (z - 5.0) / 10.0, atol=1e-9)
    with open("waveform.csv", encoding="utf-8") as file:
        assert file.readline() == "time (s),volts (V),desired (um)\n"
    with np.load("wave.npz") as arrays:
        assert set(arrays.files) == {"time", "volts", "desired", "predicted"}
    again = call("waveform.csv", "--output", "again.csv")  # a waveform is a trajectory
    assert again.exit_code == 0, again.output
    assert read_record("again.csv", displacement="desired").volts == pytest.approx(played.volts)


def test_command_has_a_verdict_and_is_strict_when_asked(call):
    words = ["triangle", "--frequency", "1", "--peak-to-peak", "24", "--duration", "2"]
    done = call(*words)
    assert done.exit_code == 4
    assert "- out of reach: a voltage limit bounds it" in done.stdout
    assert "verdict    BAD" in done.stdout
    assert "of 0 to 2 V, those of the model's record: off by up to 4 um, 17 %" in " ".join(done.stdout.split())
    assert "give other --voltage-limits" in " ".join(done.stdout.split())
    assert "Do not output it for this motion." in Path("waveform.html").read_text()
    done = call(*words, "--strict", "--json")
    assert done.exit_code == 4
    printed = json.loads(done.stdout)
    assert printed["out_of_reach_um"][0]["worst"] == pytest.approx(4.0, abs=0.05)
    assert len(printed["warnings"]) == 1
    assert (printed["verdict"], len(printed["reasons"])) == ("bad", 1)
    done = call(*words, "--voltage-limits", "-1", "3", "--slew", "1000", "--strict", "--plots", "pictures")
    assert {path.name for path in Path("pictures").iterdir()} == {"waveform-light.png", "waveform-dark.png"}
    assert done.exit_code == 1
    assert "- outside of the voltages of the record, 2 times" in done.stdout
    assert "verdict    doubtful" in done.stdout  # 0.2 V of 2 V
    assert call(*words[:3], "--duration", "2", "--peak-to-peak", "14", "--strict").exit_code == 0


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (["zigzag"], "neither one of random", 2),
        (["sine", "--output", "wave.txt"], "ends in neither", 2),
        (["sine", "--output", "no/wave.csv"], "there is no folder no", 1),
        (["sine", "--slew", "0"], "--slew = 0.0", 2),
        (["sine", "--voltage-limits", "2", "1"], "--voltage-limits", 2),
        (["sine", "--voltage-limits", "-600", "3600"], "times the range of the model's record: both must be volts", 2),
        (["mm.csv"], "5000 to 6000 um, is nowhere within reach: the model comes to ", 2),
        (["sine", "--model", "wrong.toml"], "not a truestroke model", 1),
        (["wrong.toml"], "no two rows of numbers", 1),
    ],
)
def test_command_fails_in_one_line(call, words, message, code):
    with open("wrong.toml", "w", encoding="utf-8") as file:
        file.write("x = 1\n")
    np.savetxt("mm.csv", 5.0 + np.arange(500) / 499, header="desired (mm)", comments="")
    at = ["--sample-rate", "1000"] if words == ["mm.csv"] else []
    done = CliRunner().invoke(main, ["invert", "--model", "model.toml", *words, *at])
    assert done.exit_code == code
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


# ---- A controller from the model -----------------------------------------------------------------------------------


def test_track_starts_from_the_model(tmp_path, monkeypatch):
    """Also with limits of -2 to 10 V, where a fresh controller has to learn the slopes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("truestroke.cli.common.save_page", lambda *_: [])
    sweep = trajectories.random_wave(duration=3.0, peak_to_peak=28.0, seed=5).position / 12.0
    stage = RealisticPlant(seed=3)
    stage.open()
    save_model("stage.toml", identify((sweep, stage.exchange(sweep), FS)).model)
    errors = {}
    for name, words in {"fresh": [], "known": ["--model", "stage.toml"]}.items():
        options = ["--trajectory", "sine", "--duration", "1", "--voltage-limits", "-2", "10", "--output", name]
        done = CliRunner().invoke(main, ["track", *options, *words])
        assert done.exit_code == 0, done.output
        recording = Recording.load(f"{name}.h5")
        errors[name] = rms(recording["true"] - recording["desired"])
    assert errors["known"] < errors["fresh"]


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (["--controller", "paper"], "--controller paper knows no model", 2),
        (["--voltage-limits", "3", "1"], "--voltage-limits", 2),
        (["--model", "none.toml"], "none.toml", 2),
        (["--model", "wrong.toml"], "not a truestroke model", 1),
        (["--model", "other.toml"], "not the same actuator", 2),
    ],
)
def test_track_refuses_what_does_not_fit(call, words, message, code):
    with open("wrong.toml", "w", encoding="utf-8") as file:
        file.write("x = 1\n")
    other = load_model(Path("model.toml"))
    save_model("other.toml", other.replace(voltage_range=(0.0, 150.0)))
    done = CliRunner().invoke(main, ["track", "--duration", "1", "--model", "model.toml", *words])
    assert done.exit_code == code
    assert message in done.stderr


@pytest.mark.parametrize(("speed", "asked"), [(0.9, False), (5.0, True)])
def test_a_lag_that_the_record_leaves_open_is_said_of_faster_motion(speed, asked):
    """1 ms of it; at 0.9 of the speed of the record other weights make up for it."""
    covariance = np.diag([0.0, 1e-3, 0.0]) ** 2
    model = straight(noise=1e-3).replace(covariance=covariance)
    assert model.names[1] == "lag"
    desired = 10.0 + 5.0 * np.sin(speed * 100.0 / 5.0 * np.arange(4000) / FS)
    said = [reason for reason in waveform(model, desired, FS).verdict.reasons if "times as fast" in reason]
    assert bool(said) == asked
    if asked:
        stated = float(said[0].split("may be ")[1].split(" um")[0])
        assert stated == pytest.approx(1e-3 * speed * 100.0 / np.sqrt(2), rel=0.05)


def lagging(seconds, deviation):
    """The same with a lag's weight, as of a record up to 100 um/s."""
    return straight().replace(weights=[10.0, -seconds, 0.0], covariance=np.diag([0.0, deviation, 0.0]) ** 2)


def test_what_is_faster_than_the_record_lags_as_far_as_is_proven():
    """A step of 10 um behind two deviations less than 4 ms, by hand; none where these are more, or not known."""
    fs, t = 10_000.0, np.arange(300) / 10_000.0
    step = np.where(t < 0.005, 0.5, 1.5)
    since = np.maximum(t - 0.005, 0.0)
    predicted = lagging(0.004, 0.001).predict(step, fs)
    np.testing.assert_allclose(predicted[60:], 15.0 - 10.0 * np.exp(-since / 0.002)[60:], atol=0.3)
    for deviation in (0.0, 0.0021):
        assert lagging(0.004, deviation).predict(step, fs)[52] == pytest.approx(15.0)
    slow = 1.0 + 0.9 * np.sin(11.0 * t)
    same = lagging(0.004, 0.0).predict(slow, fs)
    np.testing.assert_array_equal(lagging(0.004, 0.001).predict(slow, fs), same)


@pytest.mark.parametrize("frequency", [5.0, 20.0, 60.0])
def test_the_voltage_of_a_fast_motion_is_ahead_of_a_lag_that_is_proven(frequency):
    """10 um/V behind a lag of 2 ms: sines up to 19 times as fast as the record."""
    desired = 10.0 + 5.0 * np.sin(2 * np.pi * frequency * np.arange(2000) / FS)
    volts = lagging(0.002, 1e-6).invert(desired, FS, voltage_limits=(-1.0, 3.0))
    moved = respond(10.0 * volts, 0.0, 0.002 * FS)
    assert rms((moved - desired)[200:]) < 0.05 * rms(desired - 10.0)  # late by the lag they miss 6 to 60 %
