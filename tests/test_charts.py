"""Charts of pages: no peak is lost, and a browser shows them and zooms into them without a network."""

from __future__ import annotations

import base64
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from chromium import dom
from docs.site import look
from hypothesis import given
from hypothesis import strategies as st

from truestroke import measure_bode, plant, run, trajectories
from truestroke.control.controller import AdaptiveController
from truestroke.report import charts, dynamics, run_page, spectra, words
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.page import Page, Section, Table, closer
from truestroke.report.style import DARK, LIGHT


def decoded(line: dict[str, object]) -> np.ndarray:
    """As the script reads it."""
    levels = np.frombuffer(base64.b64decode(str(line["data"])), "<u2")
    values = line["low"] + (line["high"] - line["low"]) / 65534 * levels
    return np.where(levels == 65535, np.nan, values)


@given(st.integers(2, 60_000), st.integers(0, 60_000), st.integers(200, 60_000))
def test_a_peak_of_one_tick_is_in_the_chart(samples: int, spike: int, budget: int) -> None:
    values = np.cos(np.arange(samples) / 300.0)
    values[spike % samples] = 7.0
    made = Chart([Panel("error (nm)", [Line("true", "true", values)])], 10.0, 0.5).encoded(budget)
    shown = decoded(made["panels"][0]["lines"][0])
    assert len(made["panels"][0]["lines"][0]["data"]) <= budget + 16
    at = made["start"] + made["step"] * int(np.argmax(shown))
    assert np.max(shown) == pytest.approx(7.0)
    group = 1 if made["step"] == 0.5 else 2 * made["step"] / 0.5
    assert abs(at - (10.0 + 0.5 * (spike % samples))) <= 0.5 * group


def test_what_is_not_known_is_a_gap() -> None:
    values = np.array([1.0, np.nan, -2.0, np.inf])
    shown = decoded(Chart([Panel("a (V)", [Line("a", "true", values)])], 0.0, 1.0).encoded()["panels"][0]["lines"][0])
    np.testing.assert_array_equal(np.isnan(shown), [False, True, False, True])
    assert (
        decoded(
            Chart([Panel("a (V)", [Line("a", "true", np.full(3, 5.0))])], 0.0, 1.0).encoded()["panels"][0]["lines"][0]
        ).tolist()
        == [5.0] * 3
    )


def test_a_logarithmic_panel_keeps_small_values_beside_large_ones() -> None:
    values, places = np.array([1e-4, 1.0, 1e4, 0.0, -2.0]), np.array([1.0, 10.0, 100.0, 1e3, 1e4])
    made = Chart([Panel("a", [Line("a", "true", values)], logarithmic=True)], places=places).encoded(40)
    np.testing.assert_allclose(10 ** decoded(made["panels"][0]["lines"][0])[:3], values[:3], rtol=1e-3)
    np.testing.assert_array_equal(decoded(made["panels"][0]["lines"][0])[3:], np.nan)
    assert made["places"] == places.tolist()


def test_a_browser_draws_the_chart_of_a_stage_over_frequency(tmp_path: Path) -> None:
    limits = {"voltage_limits": (-0.6, 3.6), "slew_limit": 504.0, "safe_voltage": 0.0}
    found = measure_bode(plant.StagePlant(), **limits, duration=0.5)  # type: ignore[arg-type]
    file = dynamics.page(found, (-0.6, 3.6), 504.0).save(tmp_path / "bode.html")
    part = dom(file, "#from=300&to=1200")
    assert re.search(r'class="chart" data-shown="300 1200"', part)
    assert part.count("<canvas") == 3


def test_a_line_in_the_spectrum_stays_where_it_is_when_samples_are_missing() -> None:
    """A quarter of the samples is missing; cut out, they would move 50 Hz to 67 Hz."""
    rate = 2000.0
    error = np.sin(2 * np.pi * 50.0 * np.arange(12_000) / rate)
    error[(np.arange(12_000) % 8) < 2] = np.nan
    figure = spectra.spectrum({"measured": ("measured", error)}, rate, LIGHT)
    x, y = figure.axes[0].lines[0].get_data()
    assert abs(x[np.argmax(y)] - 50.0) < 2.0
    assert "3,000 of 12,000 samples are missing" in words.spectrum([error])[1]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    wave = trajectories.random_wave(duration=2.0)
    controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    recording = run(wave, controller, plant.RealisticPlant(seed=0))
    return run_page(recording).save(tmp_path_factory.mktemp("page") / "run.html")


def test_a_browser_draws_the_chart_of_a_run_and_shows_the_part_of_the_address(page: Path) -> None:
    part = dom(page, "#from=1.1&to=1.3")
    assert re.search(r'class="chart" data-shown="1.1 1.3"', part)
    assert part.count("<canvas") == 3
    assert re.search(r'class="chart" data-shown="0 1.9995"', dom(page, "#from=-5&to=400"))  # no further than the run
    assert re.search(r'class="chart" data-shown="0 1.9995"', dom(page, "#from=1.1&to=half"))  # a mangled address


def test_legends_of_a_chart_follow_the_reader_to_dark(page: Path) -> None:
    with look.chromium() as browser:
        shown = browser.new_page(color_scheme="light")
        shown.goto(page.as_uri())
        for theme in (LIGHT, DARK):
            shown.emulate_media(color_scheme=theme.name)  # type: ignore[arg-type]
            colours = look.marked(shown)
            assert {theme["desired"], theme["true"]} <= colours <= set(theme.variables.values())


def test_a_page_with_a_chart_is_well_formed_small_and_needs_no_network(page: Path) -> None:
    text = page.read_text()
    ET.fromstring(text.split("\n", 1)[1])
    assert len(text) < 2_000_000
    assert not re.search(r'(?:src|href)="(?!#)', text.replace('xlink:href="#', ""))
    assert "https://" not in text.replace("https://github.com/leeoniya/uPlot", "")


def test_the_charts_of_a_page_share_its_size() -> None:
    long = Chart([Panel("a (V)", [Line("a", "true", np.random.default_rng(0).normal(size=10**6))])], 0.0, 1.0)
    assert len(long.encoded(charts.BUDGET // 3)["panels"][0]["lines"][0]["data"]) < charts.BUDGET // 3


def test_on_a_phone_lines_between_many_gaps_are_seen_and_words_are_whole(tmp_path: Path) -> None:
    """Of a scan, whose errors are those within its lines, a chart was empty in a third of its width."""
    error = np.cos(np.arange(12_000.0))
    error[np.arange(12_000) % 50 < 25] = np.nan
    error[6000:8000] = np.nan
    table = Table(
        columns=["a", "b", "c"], rows=[["a controller", "Widrow, normalised", "such words " * 9]], kind="words"
    )
    chart = Chart([Panel("error (µm)", [Line("x", "true", error)])], 0.0, 5e-4)
    sections = [Section(tables=[table]), closer(chart)]
    file = Page(title="", lead="", sections=sections, plots=lambda _: {}).save(tmp_path / "page.html")
    with look.chromium() as browser:
        shown = browser.new_page(viewport={"width": 390, "height": 800})
        shown.goto(file.as_uri())
        assert not look.too_wide(shown)
        dark = """() => {const c = document.querySelector(".chart canvas"), y = Math.round(c.height / 3);
            const all = c.getContext("2d").getImageData(0, 0, c.width, c.height).data, found = [];
            for (let x = 0; x < c.width; x++) { let n = 0; for (let y = 20; y < c.height - 40; y++) {
              const at = 4 * (y * c.width + x), [r, g, b] = [all[at], all[at + 1], all[at + 2]];
              n += all[at + 3] > 200 && Math.max(r, g, b) - Math.min(r, g, b) > 60; }
              found.push(n > 20); } return found; }"""
        drawn = np.flatnonzero(shown.evaluate(dark))
        words = "td => td.getClientRects().length && (() => { const r = document.createRange(), t = td.firstChild; "
        words += "r.setStart(t, 8); r.setEnd(t, 18); return r.getClientRects().length; })()"
        assert shown.eval_on_selector(".words td", words) == 1
    wide = drawn[-1] - drawn[0]
    empty = np.diff(drawn) - 1
    assert np.sort(empty)[-2] <= 2  # px
    assert empty.max() == pytest.approx(wide / 6, rel=0.1)  # the gap of a second
