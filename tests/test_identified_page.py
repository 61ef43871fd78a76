"""The page of an identified model: its numbers, its warnings and its pictures, for records of every kind."""

import dataclasses
import itertools
import json
import os
import re
from pathlib import Path
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from click.testing import CliRunner

from truestroke.cli import main
from truestroke.cli.identify import _files, _the_model_is_there
from truestroke.identification import HeldOut, Record, examine, identify, read_record
from truestroke.identification.fitting.regression import Structure
from truestroke.identification.fitting.select import Tried
from truestroke.report.identified import model_page
from truestroke.report.identified.page import line_rmse, structures, verdict
from truestroke.report.identified.plots import plots, weights
from truestroke.report.identified.view import View

SHARED = Path(os.environ.get("TRUESTROKE_SHARED", Path(__file__).parents[2] / "shared"))
MEASURED = SHARED / "data/p885_91/Model_Vi_Do.dat"
PLAYS = {0.0: 8.0, 0.2: 1.5, 0.45: 1.0, 0.8: 0.7}  # V: um/V
PLAIN = {"thresholds": tuple(PLAYS), "rate": False, "creep_times": (), "asymmetry": 0, "delay": 0.0}


def signals(samples, noise=0.01):
    """Time, the voltage of twelve sines from 0 V, the displacement of four plays in plain Python."""
    rng = np.random.Generator(np.random.PCG64(2))
    t = np.arange(samples) / 1000.0
    s = np.sin(2 * np.pi * rng.uniform(0.5, 20.0, 12) * t[:, None] + rng.uniform(0, 6.28, 12)).sum(axis=1)
    x = (s - s.min()) / np.ptp(s) * 2.6 * np.minimum(1.0, t / 0.1)
    z = noise * rng.standard_normal(samples)
    for r, a in PLAYS.items():
        y = 0.0
        for k, v in enumerate(x.tolist()):
            y = max(v - r, min(v + r, y))
            z[k] += a * y
    return t, x, z


T, X, Z = signals(3000)


@pytest.fixture(scope="module")
def record():
    return Record.from_arrays(X, Z, sample_rate=1000.0)


@pytest.fixture(scope="module")
def found(record):
    return identify(record)


def text(html):
    """What a reader reads; the page must be well-formed."""
    body = ElementTree.fromstring(re.sub("^<!DOCTYPE html>", "", html)).find("body")
    return " ".join("".join(body.itertext()).split())


def cells(html):
    """Rows of all tables, as text."""
    root = ElementTree.fromstring(re.sub("^<!DOCTYPE html>", "", html))
    return [[" ".join("".join(cell.itertext()).split()) for cell in row] for row in root.iter("tr")]


@pytest.mark.parametrize(
    ("creeps", "terms"), [((0.003, 0.03, 0.3, 0.95, 3.0, 9.5, 30.0), 2), ((0.003, 0.03, 0.3, 3.0), 1)]
)
def test_labels_of_the_weights_neither_meet_nor_leave_the_picture(record, creeps, terms):
    """0.003 was drawn over 0.03, and the heading of the asymmetry ended outside."""
    model = identify(record, **{**PLAIN, "creep_times": creeps, "rate": True, "asymmetry": terms})
    figure = weights(View.of(model))
    figure.canvas.draw()
    for panel in figure.axes:
        assert panel.title.get_window_extent().x1 < figure.bbox.x1, panel.get_title()
        drawn = [label for label in panel.get_xticklabels() if label.get_text()]
        for one, other in itertools.pairwise(drawn):
            before, after, turned = one.get_window_extent(), other.get_window_extent(), one.get_rotation() == 45
            free = (
                (after.x1 - before.x1) / 2**0.5 - one.get_size() * figure.dpi / 72 if turned else after.x0 - before.x1
            )
            assert free > 2, panel.get_title()  # pixels


@pytest.mark.usefixtures("each_picture_once")
def test_the_numbers_are_those_that_were_found(found, record):
    html = model_page(found, record, model_file="stage.toml", next_commands=(("track", "drives it"),)).html()
    rows = {row[0]: row[1:] for row in cells(html)}
    h = found.held_out
    first = X.size - h.samples
    line = np.polyfit(X[:first], Z[:first], 1)
    off = Z[first:] - np.polyval(line, X[first:])
    for name, um, percent, of_line in (
        ("rmse", h.rmse_um, h.rmse_percent, np.sqrt(np.mean(off**2))),
        ("maximum", h.maximum_um, h.maximum_percent, np.abs(off).max()),
    ):
        (model, unit, share, _), (straight, *_) = (cell.split() for cell in rows[name])
        assert (float(model), unit) == (pytest.approx(1e3 * um, rel=0.005), "nm")
        assert float(share) == pytest.approx(percent, abs=0.005)
        assert float(straight) == pytest.approx(1e3 * of_line if of_line < 1 else of_line, rel=0.005)
    for name, weight, deviation in zip(found.model.names, found.model.weights, found.model.deviations, strict=True):
        assert [float(number) for number in rows[name][:2]] == pytest.approx([weight, deviation], rel=1e-3)
    words = text(html)
    assert f"{found.residual.size:,} samples of the fit's residual count for {found.effective_samples:,.0f}" in words
    for warning in examine(record).warnings:
        assert warning in words
    for name, value in examine(record).table():
        assert rows[name] == [value.replace(" um", " µm")]
    assert words.count("truestroke track") == words.count("drives it") == html.count("stage.toml") == 1


@pytest.mark.parametrize(
    ("samples", "scale", "gap", "options"),
    [
        (100, 1.0, 0.0, {}),
        (3000, 1.0, 0.0, {**PLAIN, "thresholds": (0.0,)}),
        (3000, 1.0, 3.0, {"thresholds": tuple(PLAYS)}),
        (1000, 1e-6, 0.0, {"rate": True, "creep_times": (0.1,), "asymmetry": 1}),
    ],
)
def test_a_page_of_every_record(samples, scale, gap, options):
    time = T[:samples] + gap * (T[:samples] >= 2.4)
    record = Record.from_arrays(scale * X[:samples], scale * Z[:samples], time=time)
    html = model_page(identify(record, **options), record).html()
    root = ElementTree.fromstring(re.sub("^<!DOCTYPE html>", "", html))
    svg = "{http://www.w3.org/2000/svg}"
    assert [picture.find(f"{svg}title") is not None for picture in root.iter(f"{svg}svg")] == [True] * 8
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(ids) == len(set(ids))
    assert not re.search(r"\b(nan|inf|None)\b", text(html))
    assert len(html) < 1e6
    assert ("are in gaps" in html) == (gap > 0)


def test_a_long_record_keeps_its_peaks_on_a_small_page(monkeypatch):
    """Where 50,000 samples are long, not 500,000."""
    monkeypatch.setattr("truestroke.identification.records.series.SAMPLES", 50_000)
    repeated, z = np.tile(X, 17), np.tile(Z, 17)
    z[50_003] += 3.0
    record = Record.from_arrays(repeated, z, sample_rate=1000.0)
    found = identify(record, **PLAIN)
    view = View.of(found)
    line = plots(found)["residual"].axes[0].get_lines()[-1].get_ydata()
    assert np.abs(line).max() == pytest.approx(found.held_out.maximum_um)  # um, as the label says
    assert found.held_out.maximum_um == pytest.approx(1.5, abs=0.2)  # half of it: means over two
    shown = view.loops()
    assert np.all(view.tested[shown])
    assert np.ptp(view.volts[shown]) == pytest.approx(np.ptp(X[300:]), rel=0.1)
    html = model_page(found, record).html()
    assert len(html) < 2e6
    assert "means over 2 samples were used, at 500 Hz" in html


@pytest.mark.usefixtures("each_picture_once")
def test_a_play_that_never_moves_is_known_from_the_prior(record):
    found = identify(record, **{**PLAIN, "thresholds": (*PLAYS, 9.0)})
    told = dict(zip(found.model.names, ~View.of(found).from_prior(), strict=True))
    assert told == {"a0": True, "a1": True, "a2": True, "a3": True, "a4": False, "lag": True, "offset": True}
    assert "the record is hardly informative about a4:" in model_page(found, record).html()


def test_the_verdict_is_of_the_held_out_part(found, record):
    findings, view = examine(record), View.of(found)
    line = line_rmse(view)

    def said(rmse):
        h = HeldOut(rmse, 3 * rmse, 100 * rmse / view.model.stroke, 300 * rmse / view.model.stroke, 1200, 0.95)
        return verdict(dataclasses.replace(found, held_out=h), view, findings)

    assert "within the noise of the sensor" in said(findings.noise_um)
    assert "5 times better than a straight line" in said(line / 5)
    assert "hardly better than a straight line" in said(0.9 * line)
    assert "worse than a straight line" in said(2 * line)


def test_what_each_part_of_the_structure_is_worth(found):
    best = Structure(
        thresholds=tuple(np.arange(16) * 0.1), rate_dependent=(0, 4, 8), creep_times=(0.3, 3.0), asymmetry=2
    )
    small = dataclasses.replace(best, thresholds=best.thresholds[:8], rate_dependent=())
    tried = [Tried(best, 10, 0.2), Tried(best, 1, 0.1), Tried(small, 1, 0.05)]
    tried += [Tried(dataclasses.replace(best, rate_dependent=()), w, 0.5) for w in (1, 10)]
    tried += [Tried(dataclasses.replace(best, creep_times=()), 1, 0.4), Tried(best, 1, 0.1)]
    compared = structures(tried)
    assert [(one.differs, one.rmse) for one in compared] == [
        (None, 0.05),
        ("", 0.1),
        ("no creep", 0.4),
        ("no rate", 0.5),
    ]
    assert compared[1].words == "16 plays to 1.5 V, 3 rate weights, creep 0.3, 3 s, 2 asymmetry terms, no resonance"
    assert any(one.differs == "" for one in structures(found.tried))


def command(*arguments):
    return CliRunner().invoke(main, ["identify", *arguments])


@pytest.mark.usefixtures("each_picture_once")
def test_the_command_writes_model_page_and_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savetxt(tmp_path / "sweep.csv", np.column_stack([T, X, Z])[:400], delimiter=",", header="time (s),V (V),z (um)")
    done = command("sweep.csv", "--output", "stage.toml", "--plots", "drawn")
    assert (done.exit_code, done.stderr) == (0, "")
    for words in ("model      stage.toml", "page       stage.html", "track --model stage.toml", "invert wave.csv"):
        assert words in done.stdout
    assert "truestroke identify sweep.csv" in text((tmp_path / "stage.html").read_text())
    names = {
        f"{name}-{theme}.png" for name in ("loop", "residual", "spectrum", "weights") for theme in ("light", "dark")
    }
    assert {path.name for path in (tmp_path / "drawn").iterdir()} == names
    told = json.loads(command("sweep.csv", "--report", "other.html", "--json").stdout)
    assert (told["model"], told["page"], told["pictures"]) == ("model.toml", "other.html", [])
    assert (tmp_path / "other.html").exists()
    refused = command("sweep.csv", "--output", "model.html")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    for report in ("nowhere/page.html", "."):
        with pytest.raises(click.ClickException, match=f"--report {report}"):
            _files("model.toml", report)


@pytest.mark.skipif(not MEASURED.exists(), reason=f"{MEASURED} is not there: the measured record is not in the project")
def test_the_measured_stack():
    record = read_record(MEASURED, volts=1, displacement=5, sample_rate=200.0)
    found = identify(record)
    view = View.of(found)
    assert 100 * line_rmse(view) / view.model.stroke == pytest.approx(6.8, abs=0.1)  # as its README says
    words = text(model_page(found, record).html())
    assert f"{found.held_out.rmse_percent:.2f} % of stroke rmse" in words
    assert "the record is not informative about rate dependence" in words


def test_an_interrupted_page_says_that_the_model_is_there(capsys):
    with pytest.raises(KeyboardInterrupt), _the_model_is_there(Path("model.toml")):
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "truestroke: model.toml has the model; its page and pictures are not complete\n"
