"""Play, record, refine: the error falls from pass to pass on actuators that are not of the model's structure."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import cont2discrete, lfilter

from truestroke import Dynamics, Mode, SettingError, trajectories
from truestroke.cli import main
from truestroke.control.repeating.passes import following
from truestroke.identification import (
    ActuatorModel,
    Record,
    Waveform,
    identify,
    load_model,
    load_waveform,
    refine,
    save_model,
    save_waveform,
    waveform,
)
from truestroke.plant import RealisticPlant, StagePlant, StageSettings

pytestmark = pytest.mark.usefixtures("each_picture_once")
FS, LIMITS = 2000.0, (-0.6, 3.6)
WAVE = trajectories.random_wave(duration=4.0, seed=9, peak_to_peak=24.0)
SWEEP = trajectories.random_wave(duration=8.0, seed=5, peak_to_peak=28.0).position / 12.0  # V


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def stack(volts, seed):
    """The simulated stack of the project: true and measured displacement, um."""
    plant = RealisticPlant(seed=seed)
    plant.open()
    measured = plant.exchange(volts)
    return plant.truth, measured


def bouc_wen(volts, seed, noise=0.01):
    """Bouc and Wen's hysteresis behind a lag of 0.4 ms, bent by 2 %: nothing of it is in the model."""
    h, hysteresis = 0.0, np.zeros(volts.size)
    for k, dx in enumerate(np.diff(volts, prepend=0.0)):
        h += 0.9 * dx - 1.4 * abs(dx) * h - 0.5 * dx * abs(h)
        hysteresis[k] = h
    z = 12.0 * volts - 5.0 * hysteresis
    z = lfilter([0.7], [1, -0.3], z * (1 + 0.02 * np.sin(z / 5.0)))
    return z, z + noise * np.random.Generator(np.random.PCG64(seed)).standard_normal(z.size)


def passes(actuator, model, count, correct):
    """True rmse and maximum of each pass, um."""
    errors, made = [], None
    for k in range(count):
        if made is None or not correct:
            made = waveform(model, WAVE.position, FS, velocity=WAVE.velocity, voltage_limits=LIMITS)
        true, measured = actuator(made.volts, 100 + k)
        errors.append((rms(true - WAVE.position), np.abs(true - WAVE.position).max()))
        found = refine(model, Record.from_arrays(made.volts, measured, sample_rate=FS), waveform=made)
        assert found.rmse == pytest.approx(rms(measured - WAVE.position), rel=1e-12)
        model, made = found.model, found.next(voltage_limits=LIMITS)
    return np.array(errors)


@pytest.fixture(scope="module", params=[(stack, 0.0134), (bouc_wen, 0.01)], ids=["stack", "Bouc-Wen"])
def bench(request):
    """An actuator, the noise of its sensor, um, and a model from its record, 3 % off: it is another day."""
    actuator, noise = request.param
    model = identify((SWEEP, actuator(SWEEP, 3)[1], FS), branches=False).model
    return actuator, noise, model.replace(weights=0.97 * model.weights)


def test_the_error_falls_from_pass_to_pass_to_the_noise(bench):
    actuator, noise, model = bench
    made = passes(actuator, model, 4, correct=True)
    assert made[0, 0] > 5 * noise
    assert made[1, 0] < 0.15 * made[0, 0]
    assert np.all(made[2:, 0] < 1.05 * made[1:-1, 0])
    assert made[-1, 0] < 0.8 * noise  # of a single sample


def test_refining_alone_is_enough_where_the_model_describes_the_actuator(bench):
    actuator, _, model = bench
    made = passes(actuator, model, 2, correct=False)
    if actuator is stack:
        assert made[1, 0] < 0.03 * made[0, 0]
    else:
        assert made[1, 0] == pytest.approx(made[0, 0])  # the weights stay


# ---- A model that needs nothing -----------------------------------------------------------------------------------

R, A, CREEP = (0.0, 0.2, 0.45, 0.8), (8.0, 1.5, 1.0, 0.7), 0.6  # V, um/V


def plays(x):
    """Plain Python: four plays and a creep state of 0.1 s."""
    z, c = np.zeros(x.size), x[0]
    states = [0.0] * 4
    for k, v in enumerate(x):
        c += (1 - np.exp(-1 / (0.1 * FS))) * ((x[k - 1] if k else x[0]) - c)
        states = [max(v - r, min(v + r, y)) for r, y in zip(R, states, strict=True)]
        z[k] = np.dot(A, states) + CREEP * c
    return z


def perfect(deviation=0.02, **changes):
    weights = [*A, CREEP, 0.0, 0.0]
    return ActuatorModel(
        thresholds=R, creep_times=(0.1,), weights=weights, covariance=deviation**2 * np.eye(len(weights)) / 100,
        stroke=30.0, voltage_range=(0.0, 2.6), velocity=1e4, noise=0.01, **changes,
    )  # fmt: skip


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_perfect_model_stays_as_it_is(noise):
    x = SWEEP[:6000]
    z = plays(x) + noise * np.random.Generator(np.random.PCG64(1)).standard_normal(x.size)
    found = refine(perfect(), Record.from_arrays(x, z, sample_rate=FS))
    assert np.abs(found.model.predict(x, FS) - plays(x)).max() < 0.3 * noise + 1e-6
    assert found.before == pytest.approx(noise, rel=0.03, abs=1e-9)
    assert 0.98 * found.before <= found.after + 1e-9 <= found.before + 2e-9
    assert found.error is found.rmse is found.maximum is None
    assert found.model.thresholds == R  # the structure is kept
    assert np.all(np.abs(found.model.weights[:5] - [*A, CREEP]) < 4 * found.model.deviations[:5] + 1e-6)


def test_plays_that_never_move_go_with_their_neighbours():
    """As the prior, which is correlated along the thresholds, has it: 1 % softer everywhere."""
    x = 0.1 + 0.1 * np.sin(np.arange(1000) / 30.0)
    found = refine(perfect(), Record.from_arrays(x, 0.99 * perfect().predict(x, FS), sample_rate=FS))
    np.testing.assert_allclose(found.model.weights[2:4], 0.99 * np.array(A[2:]), rtol=0.005)
    assert found.after < 0.1 * found.before


def test_a_softer_actuator_an_offset_and_a_wider_range_are_learned():
    x = 1.2 * SWEEP[:6000]
    old = perfect(zero=7.0)
    found = refine(old, Record.from_arrays(x, 7.3 + 0.9 * plays(x), sample_rate=FS))
    assert found.before > 0.5
    assert found.after < 0.02
    np.testing.assert_allclose(found.model.weights[:5], 0.9 * np.array([*A, CREEP]), atol=0.05)
    assert found.model.predict([0.0], FS)[0] == pytest.approx(7.3, abs=0.02)
    assert found.model.voltage_range == (0.0, pytest.approx(x.max()))
    assert found.model.stroke == old.stroke


def test_what_the_recording_does_not_tell_stays():
    """At 6 um/s with 20 nm of noise a delay is not seen."""
    x = np.linspace(0.5, 0.6, 400)
    old = perfect(delay=0.0102, deviation=1e-5)
    z = old.predict(x, FS) + 0.02 * np.random.Generator(np.random.PCG64(3)).standard_normal(x.size)
    found = refine(old, Record.from_arrays(x, z, sample_rate=FS)).model
    late = [model.delay - model.weights[model.names.index("lag")] for model in (old, found)]
    assert late[1] == pytest.approx(late[0], abs=5e-5)
    np.testing.assert_allclose(found.weights[1:4], old.weights[1:4], atol=0.05)


def test_the_scale_of_the_rate_weights_does_not_matter():
    """The same model with b ten times as large and c_b a tenth."""
    x, z = SWEEP[:4000], 1.05 * plays(SWEEP[:4000])
    weights, P = np.array([8.0, 0.2, 1.5, 1.0, 0.7, CREEP, 0.0, 0.0]), 1e-4 * np.eye(8)
    rate_dependent = {"rate_dependent": (0,), "rate_scale": 1 / 1500}
    one = perfect().replace(weights=weights, covariance=P, **rate_dependent)
    scale = np.where(np.arange(8) == 1, 10.0, 1.0)
    other = one.replace(weights=weights * scale, covariance=P * np.outer(scale, scale), rate_scale=1 / 15000)
    record = Record.from_arrays(x, z, sample_rate=FS)
    found = [refine(model, record) for model in (one, other)]
    assert found[0].before == pytest.approx(found[1].before, rel=1e-9)
    np.testing.assert_allclose(found[0].residual, found[1].residual, atol=0.02)


# ---- Where the waveform is in the record ---------------------------------------------------------------------------


def recorded(x, z, before, rate, noise=0.0):
    """As an oscilloscope does it: earlier, later, at its own rate."""
    ticks = np.arange(-before, x.size / FS + 0.2, 1 / rate)
    at = np.clip(ticks, 0.0, (x.size - 1) / FS)
    v = np.interp(at, np.arange(x.size) / FS, x)
    v += noise * np.random.Generator(np.random.PCG64(2)).standard_normal(v.size)
    return Record.from_arrays(v, np.interp(at, np.arange(x.size) / FS, z), time=ticks + 17.0)


@pytest.mark.parametrize(("before", "rate"), [(0.0, 2000.0), (0.1234, 10000.0), (0.25, 2000.0), (0.07, 1700.0)])
def test_the_waveform_is_found_in_the_record(before, rate):
    made = waveform(perfect(), WAVE.position[:4000], FS, voltage_limits=LIMITS)
    z = plays(made.volts)
    found = refine(perfect(), recorded(made.volts, z, before, rate, noise=1e-3), waveform=made)
    assert found.measured.size == 4000
    assert np.abs(found.measured - z)[:-5].max() < 0.03  # of 1300 um/s: 25 us
    assert found.rmse == pytest.approx(rms(z - WAVE.position[:4000]), abs=0.005)


@pytest.mark.parametrize(
    ("volts", "displacement", "words"),
    [
        (lambda x: 1e3 * x, lambda z: z, "1000 times the waveform's: .* needs `volts_scale` 0.001"),
        (lambda x: x[::-1], lambda z: z, "is it the recording of this waveform"),
        (lambda x: x[:1500], lambda z: z[:1500], "at least as long as the waveform, 2 s: record until it has ended"),
        (lambda x: np.interp(np.arange(4000) * 1.05, np.arange(4000), x), lambda z: z, "at the sample rate"),
        (lambda x: 0.9 * x, lambda z: z, "differs from the waveform's by 0.1"),
    ],
)
def test_a_record_of_something_else_is_refused(volts, displacement, words):
    made = waveform(perfect(), WAVE.position[:4000], FS, voltage_limits=LIMITS)
    record = Record.from_arrays(volts(made.volts), displacement(plays(made.volts)), sample_rate=FS)
    with pytest.raises(SettingError, match=words):
        refine(perfect(), record, waveform=Waveform(volts=made.volts, desired=made.desired, sample_rate=FS))


@pytest.mark.parametrize("again", ["the same file", "the same voltage"])
def test_the_recording_of_an_earlier_pass_is_refused(bench, again):
    """The next waveform was not output, or not recorded: its correction would be made twice."""
    actuator, _, model = bench
    made = waveform(model, WAVE.position, FS, velocity=WAVE.velocity, voltage_limits=LIMITS)
    records = [Record.from_arrays(made.volts, actuator(made.volts, 100 + k)[1], sample_rate=FS) for k in range(2)]
    found = refine(model, records[0], waveform=made)
    made = found.next(voltage_limits=LIMITS)
    with pytest.raises(SettingError, match=r"the voltage and displacement of pass 1, .* output it, and record again"):
        refine(found.model, records[again == "the same voltage"], waveform=made)
    low = 0.99 * made.volts  # a monitor that reads 1 % too little
    refine(found.model, Record.from_arrays(low, actuator(made.volts, 102)[1], sample_rate=FS), waveform=made)


def test_a_record_in_other_units_is_refused():
    measured, model = stack(SWEEP, 1)[1], perfect()
    for volts, displacement in ((1.0, 1000.0), (1.0, 0.001), (1000.0, 1.0), (0.001, 1.0), (1.0, -1.0)):
        record = Record.from_arrays(volts * SWEEP, displacement * measured, sample_rate=FS)
        turned = ".*falls as the voltage rises: `flip_displacement` turns" if displacement < 0 else "[^;]*$"
        with pytest.raises(SettingError, match="same units" + turned):
            refine(model, record)


def test_a_gap_in_the_waveform_is_refused():
    made = waveform(perfect(), WAVE.position[:4000], FS, voltage_limits=LIMITS)
    kept = np.delete(np.arange(4000), slice(1500, 1600))
    record = Record.from_arrays(made.volts[kept], plays(made.volts)[kept], time=kept / FS)
    with pytest.raises(SettingError, match="at least as long as the waveform"):
        refine(perfect(), record, waveform=made)


def test_a_short_record_is_refused():
    with pytest.raises(SettingError, match="at least 200 samples"):
        refine(perfect(), Record.from_arrays(SWEEP[:150], SWEEP[:150], sample_rate=FS))


# ---- The command ---------------------------------------------------------------------------------------------------


def test_command_goes_from_pass_to_pass(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(*words):
        done = CliRunner().invoke(main, list(words))
        assert done.exit_code == 0, done.output
        return done.stdout

    model = perfect()
    save_model("model0.toml", model.replace(metrics={"held_out_rmse_um": 0.01}, provenance={"source": "a.csv"}))
    save_waveform("pass0.csv", waveform(model, WAVE.position[:4000], FS, voltage_limits=LIMITS))
    errors = []
    for k in range(3):
        x = np.genfromtxt(f"pass{k}.csv", delimiter=",", names=True)["volts_V"]
        z = bouc_wen(x, k, noise=0.0)[0]
        np.savetxt(f"rec{k}.csv", np.column_stack([x, z]), delimiter=",", header="drive (V),z (um)", comments="")
        options = ["--volts", "drive", "--sample-rate", "2000", "--voltage-limits", "-0.6", "3.6", "--json"]
        files = ["--waveform", f"pass{k}.csv", "--output", f"model{k + 1}.toml", "--next", f"pass{k + 1}.csv"]
        printed = json.loads(call("refine", f"rec{k}.csv", "--model", f"model{k}.toml", *files, *options))
        errors.append(printed["pass_rmse_um"])
        assert printed["next"]["waveform"] == f"pass{k + 1}.csv"
    assert errors[0] > 0.4
    assert errors[2] < 0.05
    with open("model3.toml", "rb") as file:
        told = tomllib.load(file)
    assert told["metrics"]["pass_rmse_um"] == errors[2]
    assert told["provenance"]["source"] == "a.csv"
    assert told["provenance"]["pass_3"].startswith(f"rec2.csv: error {errors[2]:.4g} um rmse")
    assert "held_out_rmse_um" not in told["metrics"]  # which is not of this model
    assert "held_out" in told["provenance"]

    text = call("refine", "rec1.csv", "--model", "model1.toml", "--sample-rate", "2000", "--volts", "drive")
    assert "prediction, refined" in text
    assert "this pass" not in text  # nothing is desired
    assert "pass_2" in load_model("refined.toml").provenance


def test_command_refuses_what_does_not_fit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_model("model.toml", perfect())
    x = SWEEP[:2000]
    for name, rows in {"rec.csv": np.column_stack([x, plays(x)]), "wave.csv": np.column_stack([x[::-1], x])}.items():
        header = "volts,desired" if name == "wave.csv" else "volts,z"
        table = np.column_stack([np.arange(2000) / FS, rows])
        np.savetxt(name, table, delimiter=",", header=f"time,{header}", comments="")
    before = {name: (tmp_path / name).read_bytes() for name in ("model.toml", "wave.csv")}
    for words, message, code in (
        (["--next", "next.csv"], "--next needs --waveform", 2),
        (["--waveform", "wave.csv"], "RECORD = a voltage that differs from the waveform's by", 2),
        (["--waveform", "rec.csv"], "no column desired, what the waveform should have moved", 1),
        (["--output", "no/model.toml"], "there is no folder no", 1),
        (["--output", "model.toml"], "would replace the file that --model names; choose another name", 2),
        (["--waveform", "wave.csv", "--next", "wave.csv"], "would replace the file that --waveform names", 2),
    ):
        done = CliRunner().invoke(main, ["refine", "rec.csv", "--model", "model.toml", *words])
        assert done.exit_code == code
        assert message in done.stderr
        assert done.stderr.count("\n") == 1
    done = CliRunner().invoke(main, ["identify", "model.toml"])  # whose default --output it is
    assert "RECORD model.toml is a model; it must be a table of numbers or a recording." in done.stderr
    assert before == {name: (tmp_path / name).read_bytes() for name in before}


# ---- A pass that is worse ------------------------------------------------------------------------------------------

TRIANGLE = trajectories.triangle(frequency=40.0, peak_to_peak=20.0, duration=0.6, sample_rate=FS)


def ringing(volts, seed):
    """Bouc and Wen's hysteresis on a stage of 900 Hz with a damping of 0.02, at a rate that hardly sees it."""
    w = 2 * np.pi * 900.0
    b, a, _ = cont2discrete(([w * w], [1, 0.04 * w, w * w]), 1 / FS, "zoh")
    z = lfilter(b.ravel(), a, bouc_wen(volts, seed, noise=0.0)[0])
    return z + 0.01 * np.random.Generator(np.random.PCG64(seed)).standard_normal(z.size)


@pytest.fixture(scope="module")
def rung():
    return identify((SWEEP, ringing(SWEEP, 3), FS), branches=False).model


def test_a_pass_that_is_worse_is_undone_and_told(rung):
    """In the fourth pass something shakes the stage."""
    model, found, time = rung, [], np.arange(len(TRIANGLE)) / FS
    made = waveform(model, TRIANGLE.position, FS, velocity=TRIANGLE.velocity, voltage_limits=LIMITS)
    for k in range(5):
        z = ringing(made.volts, 100 + k) + 0.1 * (k == 3) * np.sin(2 * np.pi * 13.0 * time)
        record = Record.from_arrays(made.volts, z, sample_rate=FS)
        found.append(refine(model, record, waveform=made))
        model, made = found[-1].model, found[-1].next(voltage_limits=LIMITS)
    worse = [bool(f.undone) for f in found]
    assert worse[:4] == [False, False, False, True]
    at = worse.index(True)
    undone = found[at]
    assert undone.verdict.is_bad
    best = min(f.rmse for f in found[:at])
    assert f"{undone.rmse:.4g} um rmse where the best one had {best:.4g}" in undone.undone
    np.testing.assert_array_equal(undone.model.weights, found[at - 2].model.weights)  # with which the best one was made
    assert "undone" in undone.model.provenance[f"pass_{at + 1}"]
    assert undone.after == rms(undone.residual)
    assert not found[0].undone
    assert found[0].verdict.level == "good"


def test_another_motion_is_not_compared(rung):
    made = waveform(rung, TRIANGLE.position, FS, velocity=TRIANGLE.velocity, voltage_limits=LIMITS)
    best = rung.replace(
        metrics={"best_pass_um": 1e-6, "samples": 1200.0, "spread_um": float(np.std(TRIANGLE.position))}
    )
    record = Record.from_arrays(made.volts, ringing(made.volts, 1), sample_rate=FS)
    found = refine(best, record, waveform=made)
    assert "the refinement of this pass is not taken" in found.undone  # the model before is not known
    np.testing.assert_array_equal(found.model.weights, rung.weights)
    half = best.replace(metrics={**best.metrics, "spread_um": best.metrics["spread_um"] / 2})
    assert not refine(half, record, waveform=made).undone


def test_the_command_undoes_it_and_exits_with_4(rung, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = waveform(rung, TRIANGLE.position, FS, velocity=TRIANGLE.velocity, voltage_limits=LIMITS)
    first = refine(rung, Record.from_arrays(made.volts, ringing(made.volts, 1), sample_rate=FS), waveform=made)
    save_model("stage1.toml", first.model)
    assert load_model("stage1.toml").before.weights.tolist() == rung.weights.tolist()
    save_waveform("wave.csv", made)
    time = np.arange(made.volts.size) / FS
    worse = ringing(made.volts, 2) + 0.5 * np.sin(60 * time)
    np.savetxt("rec.csv", np.column_stack([time, made.volts, worse]), delimiter=",", header="t (s),v (V),z (um)")
    options = ["--model", "stage1.toml", "--waveform", "wave.csv", "--output", "stage2.toml", "--next", "wave2.csv"]
    done = CliRunner().invoke(main, ["refine", "rec.csv", *options])
    assert done.exit_code == 4, done.output
    assert "verdict    BAD" in done.output
    assert "This pass was worse" in done.output
    assert load_model("stage2.toml").weights.tolist() == rung.weights.tolist()
    told = json.loads(CliRunner().invoke(main, ["refine", "rec.csv", *options[:-2], "--json"]).stdout)
    assert told["verdict"] == "bad"


def test_refine_refuses_a_record_that_contradicts_itself(tmp_path, monkeypatch):
    """A sample rate that its time stamps deny; `--force` goes on."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(4000) / 2000.0
    x = 1.5 - 1.5 * np.cos(9 * t) * np.cos(t)
    save_model("model.toml", perfect())
    np.savez("record.npz", time=t, volts=x, measured=plays(x))
    command = ["refine", "record.npz", "--model", "model.toml", "--sample-rate", "10000"]
    refused = CliRunner().invoke(main, command)
    assert (refused.exit_code, Path("refined.toml").exists()) == (1, False)
    assert "but the time stamps of the file" in refused.stderr
    assert CliRunner().invoke(main, [*command, "--force"]).exit_code == 0
    assert Path("refined.toml").exists()


# ---- Fast triangles ------------------------------------------------------------------------------------------------

FAST = 10_000.0


def staged(volts, seed):
    """A stage of 900 Hz, damping 0.02: true and measured displacement, um."""
    two = {"resonances": (900.0, 2610.0), "dampings": (0.02, 0.01), "shares": (0.95, 0.05)}
    plant = StagePlant(StageSettings(hysteresis_kind="bouc-wen", dead_time=1e-4, **two), seed=seed)
    plant.open()
    plant.exchange(np.full(2000, volts[0]))
    measured = plant.exchange(volts)
    return plant.truth, measured


@pytest.fixture(scope="module")
def slow():
    """A model from a slow record, which does not show the resonance."""
    x = trajectories.random_wave(duration=2.0, peak_to_peak=28.0, seed=5, cutoff=40.0, sample_rate=FAST).position / 12
    model = identify((x, staged(x, 3)[1], FAST), branches=False).model
    assert model.dynamics is None
    return model


@pytest.mark.parametrize(("frequency", "left"), [(20.0, 0.05), (100.0, 0.6)])
@pytest.mark.parametrize("known", [None, 927.0])
def test_triangles_do_not_diverge(slow, frequency, left, known):
    """20 and 100 Hz at 900 Hz, resonance unknown or 3 % wrong: no pass above the first, corners included."""
    wave = trajectories.triangle(frequency=frequency, peak_to_peak=20.0, duration=0.7, sample_rate=FAST)
    dynamics = None if known is None else Dynamics(sample_rate=FAST, modes=(Mode(frequency=known, damping=0.02),))
    model, errors = slow, []
    made = waveform(model, wave.position, FAST, voltage_limits=LIMITS)
    for k in range(6):
        true, measured = staged(made.volts, 100 + k)
        errors.append(100 * rms((true - wave.position)[3000:]) / 20.0)
        record = Record.from_arrays(made.volts, measured, sample_rate=FAST)
        found = refine(model, record, waveform=made, dynamics=dynamics if k == 0 else None)
        model, made = found.model, found.next(voltage_limits=LIMITS)
    assert errors[0] > 2.5
    assert max(errors[1:]) < errors[0]
    assert min(errors) < left
    assert errors[-1] < 4 * left
    assert "the weights stay" in found.kept
    if known is not None:
        assert model.dynamics.modes[0].frequency == known


def test_a_slow_error_beside_a_fast_motion_is_no_response():
    """A zero of 0.5 um and what settles in 0.05 s, at 12 Hz of 10 um: the next pass takes them off."""
    t = np.arange(4000) / 2000.0
    desired, slow = 10 + 5 * np.sin(2 * np.pi * 12 * t), 0.5 + 0.5 * np.exp(-t / 0.05)
    change = following([(desired, desired + slow)], desired, 2000.0, best=0).change
    assert rms(change + slow) < 0.02


@pytest.mark.parametrize("name", ["next.csv", "next.npz"])
def test_the_passes_go_with_the_waveform(slow, tmp_path, name):
    wave = trajectories.triangle(frequency=50.0, peak_to_peak=20.0, duration=0.6, sample_rate=FAST)
    made = waveform(slow, wave.position, FAST, voltage_limits=LIMITS)
    for k in range(6):
        measured = staged(made.volts, 100 + k)[1]
        found = refine(slow, Record.from_arrays(made.volts, measured, sample_rate=FAST), waveform=made)
        made = found.next(voltage_limits=LIMITS)
    assert 4 <= len(found.passes) <= 5
    np.testing.assert_array_equal(found.passes[-1][1], measured)
    save_waveform(tmp_path / name, made)
    read = load_waveform(tmp_path / name)
    np.testing.assert_allclose(read.passes, found.passes, rtol=1e-11)
    np.testing.assert_allclose(read.volts, made.volts, rtol=1e-11)
    save_waveform(tmp_path / name, made)  # it is one of ours


def test_a_limit_holds_the_next_waveform(slow):
    wave = trajectories.triangle(frequency=50.0, peak_to_peak=20.0, duration=0.6, sample_rate=FAST)
    made = waveform(slow, wave.position, FAST, voltage_limits=LIMITS)
    found = refine(slow, Record.from_arrays(made.volts, staged(made.volts, 1)[1], sample_rate=FAST), waveform=made)
    tight = found.next(voltage_limits=(0.0, 1.0), slew_limit=150.0)
    assert (tight.volts.min(), tight.volts.max()) >= (0.0, 1.0)
    assert tight.volts.max() <= 1.0
    assert np.abs(np.diff(tight.volts)).max() * FAST <= 150.0 * (1 + 1e-9)
    assert tight.out_of_reach
    with pytest.raises(SettingError, match="waveform = None: must be given to refine"):
        refine(slow, Record.from_arrays(made.volts, found.measured, sample_rate=FAST)).next()


def test_dynamics_of_another_stage_are_refused(slow):
    wave = trajectories.triangle(frequency=50.0, peak_to_peak=20.0, duration=0.6, sample_rate=FAST)
    made = waveform(slow, wave.position, FAST, voltage_limits=LIMITS)
    record = Record.from_arrays(made.volts, made.desired, sample_rate=FAST)
    other = Dynamics(sample_rate=FAST, modes=(Mode(frequency=300.0, damping=0.02),))
    own = slow.replace(dynamics=Dynamics(sample_rate=FAST, modes=(Mode(frequency=900.0, damping=0.02),)))
    with pytest.raises(SettingError, match="first resonance 300 Hz"):
        refine(own, record, waveform=made, dynamics=other)


def creeping():
    """Plays and creep of 1 and 100 s; motion in the middle of the travel."""
    model = ActuatorModel(
        thresholds=(0.0, 0.3),
        weights=[9.0, 1.0, 0.3, 0.9, 0.0, 0.0],
        creep_times=(1.0, 100.0),
        covariance=1e-3 * np.eye(6),
        stroke=40.0,
        voltage_range=LIMITS,
        noise=1e-3,
    )
    return model, 20.0 + 3.0 * np.sin(2 * np.pi * np.arange(8000) / FS)


@pytest.mark.parametrize("rest", [0.5, 20.0])
def test_creep_that_goes_on_behind_the_rest_is_predicted(rest):
    model, desired = creeping()
    made = waveform(model, desired, FS, rest=rest)
    actuator = model.replace(weights=1.02 * model.weights)
    noise = 1e-3 * np.random.Generator(np.random.PCG64(4)).standard_normal(desired.size)
    measured = actuator.forward(made.volts, FS, rest=rest) + noise
    found = refine(model, Record.from_arrays(made.volts, measured, sample_rate=FS), waveform=made, rest=rest)
    assert found.before == pytest.approx(0.02 * rms(measured), rel=0.05)
    assert found.after < 1.2 * model.noise
    assert not found.kept
    following = found.next()
    assert rms(actuator.forward(following.volts, FS, rest=rest) - desired) < 0.02 * found.rmse
    assert following.rmse < 0.02 * found.rmse


def test_a_negative_rest_is_refused():
    model, desired = creeping()
    made = waveform(model, desired, FS)
    record = Record.from_arrays(made.volts, made.desired, sample_rate=FS)
    with pytest.raises(SettingError, match=r"rest = -1.0 s: must be from 0"):
        refine(model, record, waveform=made, rest=-1.0)
