"""A model file that cannot be used says so, with its name and the reason."""

import warnings
from contextlib import suppress

import numpy as np
import pytest

from truestroke import AdaptiveController, BadModelError, ModelWarning, SettingError, learn, trajectories, usable_model
from truestroke.base.verdict import Verdict
from truestroke.identification import ActuatorModel, ModelFileError, load_model, save_model
from truestroke.plant import RealisticPlant

MODEL = ActuatorModel(
    thresholds=(0.0, 0.1 + 0.2),
    rate_dependent=(1,),
    creep_times=(1e-3,),
    asymmetry=1,
    weights=np.array([8.0, 1 / 3, -1e-17, 5e-324, -1.5e-4, 1e29, 0.25]),
    covariance=np.diag([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]),
    stroke=30.0,
    voltage_range=(-0.6, 3.6),
    rate_scale=1 / 1500,
    metrics={"held_out_rmse_um": 0.1},
    provenance={"source": 'C:\\new "run"\tµ\x7f.csv'},
)


@pytest.fixture
def file(tmp_path):
    save_model(tmp_path / "m.toml", MODEL)
    return tmp_path / "m.toml"


def test_extreme_numbers_and_strings_come_back(file):
    again = load_model(file)
    assert again.weights.tobytes() == MODEL.weights.tobytes()
    assert again.thresholds == MODEL.thresholds
    assert again.provenance == MODEL.provenance
    assert '"a1" = 0.3333333333333333 # +- 0.45 um/V' in file.read_text(encoding="utf-8")


def test_a_file_with_the_old_names_is_read(file):
    text = file.read_text(encoding="utf-8")
    for new, old in (
        ("rate_dependent =", "rated ="),
        ("asymmetry =", "bends ="),
        ('"asymmetry 1"', '"bend 1"'),
        ("[metrics]", "[figures]"),
    ):
        assert new in text
        text = text.replace(new, old)
    file.write_text(text, encoding="utf-8")
    again = load_model(file)
    assert (again.rate_dependent, again.asymmetry, again.names) == ((1,), 1, MODEL.names)
    assert again.metrics == MODEL.metrics


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 1", "version = 2", "version = 2: must be 1"),
        ('"truestroke model"', '"something"', "format = 'something': must be 'truestroke model'"),
        ("[weights]", "[wieghts]", "wieghts = a table: must be left out; did you mean weights"),
        ("stroke_um = 30.0\n", "", "model.stroke_um = missing: must be given"),
        ("stroke_um", "stroke_mm = 1\nstroke_um", "model.stroke_mm = 1: must be left out; did you mean stroke_um"),
        ("stroke_um = 30.0", "stroke_um = -30.0", "stroke = -30.0 um: must be above 0 um"),
        ("stroke_um = 30.0", 'stroke_um = "long"', "model.stroke_um = 'long': must be a number, without quotes"),
        ("rate_dependent = [1]", "rate_dependent = 1", "model.rate_dependent = 1: must be a list"),
        ("rate_dependent = [1]", "rate_dependent = []", "initial_weights"),
        ('"a0" =', '"a9" =', "must be a0"),
        ('"a0" = 8.0', '"a0" = nan', "finite"),
        ("  [0.1],\n", "", "lower_triangle"),
        ("  [0.1],", "  [-9.0],", "positive semidefinite"),
        ("version = 1", "version = ", "line 2"),
    ],
)
def test_what_is_wrong_is_said(file, old, new, words):
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ModelFileError, match=words) as error:
        load_model(file)
    assert str(file) in str(error.value)


def test_a_missing_file_and_a_bad_number(tmp_path):
    with pytest.raises(ModelFileError, match="nowhere"):
        load_model(tmp_path / "nowhere.toml")
    with pytest.raises(ModelFileError, match="finite"):
        save_model(tmp_path / "m.toml", MODEL.replace(metrics={"x": float("inf")}))


def test_what_a_model_was_refined_from_comes_back_with_it(tmp_path):
    refined = MODEL.replace(weights=2 * MODEL.weights, before=MODEL, provenance={"pass_1": "better"})
    save_model(tmp_path / "m.toml", refined)
    again = load_model(tmp_path / "m.toml")
    np.testing.assert_array_equal(again.weights, refined.weights)
    np.testing.assert_array_equal(again.before.weights, MODEL.weights)
    np.testing.assert_array_equal(again.before.covariance, MODEL.covariance)
    assert (again.before.provenance, again.before.before) == (MODEL.provenance, None)
    text = (tmp_path / "m.toml").read_text()
    (tmp_path / "m.toml").write_text(text.replace("[before.weights]", "[before.masses]"))
    with pytest.raises(
        ModelFileError, match=r"m.toml: before.masses = a table: must be left out; there are model, weights"
    ):
        load_model(tmp_path / "m.toml")


def test_what_speaks_against_a_model_is_said_where_it_is_used(tmp_path):
    for level in ("good", "doubtful", "bad"):
        found = Verdict(level, ("The sensor was noisy.", "It crept.")[: 2 * (level != "good")]).entries
        save_model(tmp_path / f"{level}.toml", MODEL.replace(provenance=found))
    assert usable_model(tmp_path / "good.toml").verdict.level == "good"
    with pytest.warns(ModelWarning, match=r"doubtful\.toml: .* is doubtful: The sensor was noisy\.$"):
        usable_model(tmp_path / "doubtful.toml")
    with pytest.raises(BadModelError, match=r"bad\.toml: .* is bad: The sensor was noisy\. Record again"):
        usable_model(tmp_path / "bad.toml")
    with pytest.warns(ModelWarning, match="is bad: The sensor was noisy"):
        forced = usable_model(tmp_path / "bad.toml", force=True)
    assert forced.verdict.is_bad


@pytest.mark.parametrize("level", ["good", "doubtful", "bad"])
def test_python_is_warned_of_a_model_as_the_commands_are(tmp_path, level):
    """A controller and the first pass of `learn` took a bad one in silence."""
    found = Verdict(level, ("The sensor was noisy.",)[: level != "good"]).entries
    file, wave = tmp_path / "m.toml", trajectories.sine(frequency=20.0, peak_to_peak=2e3, duration=0.5)
    save_model(file, MODEL.replace(provenance=found))
    for use in (
        lambda model: AdaptiveController.from_model(model, sample_rate=2000.0),
        lambda model: learn(RealisticPlant(), wave, voltage_limits=(-0.6, 3.6), slew=1e4, model=model),  # out of reach
    ):
        for given in (file, load_model(file)):
            with warnings.catch_warnings(record=True) as seen, suppress(SettingError, BadModelError):
                warnings.simplefilter("always")
                use(given)
            warned = level == ("doubtful" if given is file else "bad")
            assert [w.category for w in seen] == [ModelWarning] * warned, (level, given)
            assert all(w.filename == __file__ for w in seen)
    if level == "bad":
        with pytest.raises(BadModelError, match="`load_model`"):
            learn(RealisticPlant(), wave, voltage_limits=(-0.6, 3.6), slew=1e4, model=file)
