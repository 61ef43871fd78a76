"""A model on another day: its zero is estimated, and said; a model that does not hold is told apart from that."""

import json

import numpy as np
import pytest
from benchmarks import foreign_records
from click.testing import CliRunner

import truestroke
from truestroke.base.checks import SettingError
from truestroke.cli import main
from truestroke.identification import Record, identify, save_model, score, waveform
from truestroke.report.identified.score import score_page

FS = 500.0


def day(seed, zero=0.0, gain=1.0):
    """Volts and displacement, um, of a Preisach actuator of 30 um on a wave of its own."""
    rng = np.random.Generator(np.random.PCG64(seed))
    v = foreign_records.wave(foreign_records.clock(10.0, FS), rng, 3.0)
    z = 30 * gain * foreign_records.preisach(v, np.random.Generator(np.random.PCG64(7)))
    return 100 * v, z + zero + rng.normal(0, 0.01, v.size), FS


@pytest.fixture(scope="module")
def model():
    return identify(day(1)).model


def test_the_zero_of_another_day_is_estimated_and_said(model):
    found = score(model, day(2, zero=1.1))
    assert found.offset_um - score(model, day(2)).offset_um == pytest.approx(1.1, abs=1e-6)
    assert found.rmse_percent < 0.6 < 3.0 < 100 * found.rmse_without_offset_um / 30
    assert 0.9 <= found.coverage <= 1.0
    assert found.half_width_um < 1.0
    assert found.verdict.level == "doubtful"
    assert "above that of the record" in found.verdict.reasons[0]


def test_a_model_that_is_bad_on_its_own_record_is_not_good_on_another(model):
    bad = model.replace(provenance={**model.provenance, "verdict": "bad"})
    assert not any("own record is bad" in reason for reason in score(model, day(2)).verdict.reasons)
    assert any("own record is bad" in reason for reason in score(bad, day(2)).verdict.reasons)


def test_an_error_that_is_not_that_of_the_sensor_is_not_good(model):
    """However large the residual of the model's own record: 0.3 um here, of which 0.01 um are noise."""
    volts, moved, fs = day(1)
    poor = model.replace(noise=0.3)
    found = score(poor, (volts, moved + 0.3 * np.sin(volts), fs))
    assert found.verdict.level == "doubtful"
    assert any("the sensor's noise of " in reason for reason in found.verdict.reasons)
    time = np.arange(volts.size) / fs + 300.0 * (np.arange(volts.size) > 2500)
    gap = Record.from_arrays(volts, moved + 0.3 * np.sin(volts), time=time)
    assert any("the sensor's noise of " in reason for reason in score(poor, gap).verdict.reasons)


def test_an_offset_that_is_given_is_taken(model):
    given = score(model, day(2, zero=1.1), offset=0.0)
    assert not given.estimated
    assert given.rmse_um == given.rmse_without_offset_um


def test_an_actuator_that_has_changed_is_no_matter_of_its_zero(model):
    found = score(model, day(3, gain=1.3))
    assert found.verdict.is_bad
    assert "anew" in found.verdict.reasons[0]


@pytest.mark.parametrize("gain", [0.1, 0.9, 1.3])
def test_another_gain_is_a_reason_of_its_own(model, gain):
    (said,) = (reason for reason in score(model, day(3, gain=gain)).verdict.reasons if "as far as predicted" in reason)
    assert float(said.split("moves ")[1].split(" times")[0]) == pytest.approx(gain, rel=0.01)
    assert "`displacement_scale`" in said


def said(found, words):
    (text,) = (reason for reason in found.verdict.reasons if words in reason)
    return text


def test_a_gain_that_a_day_changes_is_said_where_the_model_may_be_used(model):
    found = score(model, day(3, gain=1.04))
    assert found.verdict.level == "doubtful"
    assert "`refine` learns it" in said(found, "moves 1.0")
    assert "Another gain moves it, too" in said(found, "The zero is")


def test_a_shift_in_time_is_said_with_its_size(model):
    volts, moved, fs = day(3)
    late = score(model, (volts[5:], moved[:-5], fs))
    size = float(said(late, "than predicted").split("comes ")[1].split(" ms later")[0])
    assert size == pytest.approx(10.0, abs=2.0)
    assert "ms earlier" in said(score(model, (volts[:-5], moved[5:], fs)), "than predicted")


@pytest.mark.parametrize("times", [0.5, 4.0])
def test_a_wrong_sample_rate_is_said_with_the_right_one(model, times):
    """Of a model with 10 ms of dead time and a lag of 10 ms, of a record that states another rate than it has."""
    late = model.replace(delay=0.01, time_constant=0.01)
    volts, _, fs = day(3)
    moved = late.forward(volts, fs) + np.random.default_rng(1).normal(0, 0.01, volts.size)
    assert not [reason for reason in score(late, (volts, moved, fs)).verdict.reasons if "sample rate of" in reason]
    words = said(score(late, (volts, moved, times * fs)), "at a sample rate of")
    assert float(words.split("rate of ")[1].split(" Hz")[0]) == pytest.approx(fs, rel=0.05)


def test_a_drift_is_said_with_its_size(model):
    volts, moved, fs = day(3)
    found = score(model, (volts, moved + 0.2 * np.arange(volts.size) / fs, fs))
    assert float(said(found, "drifts by").split("by ")[1].split(" um/s")[0]) == pytest.approx(0.2, rel=0.2)


def test_motion_beyond_the_record_is_no_reason_where_the_error_is_elsewhere(model):
    """A gain of 1.04; the fastest rows alone are 2 % faster than the record."""
    volts, moved, fs = day(3, gain=1.04)
    slower = model.replace(velocity=0.98 * float(np.abs(np.gradient(model.predict(volts, fs)) * fs).max()))
    found = score(slower, (volts, moved, fs))
    assert any("faster than the record" in warning for warning in found.beyond.warnings)
    assert not any("faster than the record" in reason for reason in found.verdict.reasons)


def test_another_curve_is_no_other_gain(model):
    volts, moved, fs = day(3)
    found = score(model, (volts, moved + 3.0 * np.sin(volts / 10), fs))
    assert found.verdict.is_bad
    assert not any("as far as predicted" in reason for reason in found.verdict.reasons)


def test_predict_invert_and_waveform_take_the_zero(model):
    volts = day(4)[0][:1500]
    moved = model.predict(volts, FS, offset=1.1)
    np.testing.assert_allclose(moved - model.predict(volts, FS), 1.1)
    np.testing.assert_allclose(model.invert(moved, FS, offset=1.1), model.invert(moved - 1.1, FS), atol=1e-9)
    made = waveform(model, moved, FS, offset=1.1)
    assert made.rmse < 0.05
    assert made.rmse < 0.1 * np.sqrt(np.mean((waveform(model, moved, FS).volts - made.volts) ** 2))
    with pytest.raises(SettingError, match="offset"):
        model.predict(volts, FS, offset=float("nan"))


def test_a_start_that_the_model_misses_is_a_reason(model):
    volts, moved, _ = day(2)
    moved[:100] += 3.0
    found = score(model, (volts, moved, FS))
    assert found.start_maximum_um > 2.5
    assert found.rmse_percent < 0.6
    assert any("start is missed" in reason for reason in found.verdict.reasons)
    assert not any("start is missed" in reason for reason in score(model, day(2)).verdict.reasons)


@pytest.fixture
def files(model, tmp_path, monkeypatch):
    """The model and three records on the disk."""
    monkeypatch.chdir(tmp_path)
    save_model("model.toml", model)
    for name, (volts, moved, _) in {"monday": day(1), "tuesday": day(2, zero=1.1), "loaded": day(3, gain=1.3)}.items():
        table = np.column_stack([np.arange(volts.size) / FS, volts, moved])
        np.savetxt(f"{name}.csv", table, delimiter=",", header="time (s),volts (V),z (um)", comments="")
    return tmp_path


def test_the_command_says_zero_errors_interval_and_verdict(files, model):
    done = CliRunner().invoke(main, ["score", "model.toml", "tuesday.csv"])
    assert (done.exit_code, done.stderr) == (0, "")
    found = score(model, day(2, zero=1.1))
    for words in (
        f"{found.rmse_um:.4f} um",
        f"{found.offset_um:+.4g} um above that of the model (estimated",
        f"holds {100 * found.coverage:.0f} % of the samples",
        "verdict    doubtful",
        "page       score.html",
    ):
        assert words in done.output
    assert "truestroke score model.toml tuesday.csv" in (files / "score.html").read_text()


@pytest.mark.usefixtures("each_picture_once")
def test_the_command_ends_with_the_verdict_of_an_actuator_that_has_changed(files):
    done = CliRunner().invoke(main, ["score", "model.toml", "loaded.csv", "--offset", "0", "--json"])
    assert done.exit_code == 4
    printed = json.loads(done.output)
    assert (printed["verdict"], printed["offset_um"], printed["estimated"]) == ("bad", 0.0, False)
    assert printed["rmse_um"] == printed["rmse_without_offset_um"]
    assert printed["page"] == "score.html"


@pytest.mark.usefixtures("each_picture_once")
def test_the_page_names_options_repeats_flags_and_says_who_made_it(files):
    """A record in nm below um, that `--force` scores."""
    volts, moved, _ = day(2)
    table = np.column_stack([np.arange(volts.size) / FS, volts, 1e3 * moved])
    np.savetxt("nm.csv", table, delimiter=",", header="time (s),volts (V),z (um)", comments="")
    done = CliRunner().invoke(main, ["score", "model.toml", "nm.csv", "--force"])
    assert done.exit_code == 4, done.stderr
    html = (files / "score.html").read_text()
    assert "is a unit or a scale wrong (<code>--displacement-scale</code>, <code>--volts-scale</code>)" in html
    assert "<code>truestroke score model.toml nm.csv --force</code>" in html
    assert f"<footer>nm.csv · truestroke {truestroke.__version__}</footer>" in html


@pytest.mark.parametrize("gain", [1.0, 1.02])
def test_the_interval_is_as_wide_as_the_day_shows(model, gain):
    """All of what another day may add was in it, on a day on which nothing had changed, too."""
    record = day(2, zero=1.1, gain=gain)
    found = score(model, record)
    judged = found.trace.judged
    error = np.abs(found.trace.displacement - found.trace.predicted)[judged]
    assert 0.9 <= found.coverage <= 0.99
    assert 0.7 < found.half_width_um / np.quantile(error, 0.95) < 1.5


def test_a_record_that_rests_where_it_is_judged_has_a_page(model, tmp_path):
    """A straight line through one voltage warned of its rank."""
    t = np.arange(1000) / FS
    volts = np.where(t < 0.2, 0.0, 50.0)
    moved = 15 * volts / 50 + np.random.Generator(np.random.PCG64(2)).normal(0, 0.01, t.size)
    assert score_page(score(model, (volts, moved, FS)), model).html().startswith("<!DOCTYPE")
