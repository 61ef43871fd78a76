"""Pictures and page: what a reader must be able to rely on, checked on a recording made here."""

from __future__ import annotations

import io
import itertools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import PIL.Image
import pytest
from docs.site import look
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine, LayoutEngine

from truestroke import AdaptiveController, report, run, trajectories
from truestroke.plant import RealisticPlant
from truestroke.report import style
from truestroke.report.page import Page, Section, Table, svg
from truestroke.signals.recording import Channel, Recording

RATE, SECONDS = 2000.0, 4.0
UNITS = {"time": "s", "desired": "um", "measured": "um", "true": "um", "volts": "V", "flags": "", "uncompensated": "um"}


def build(simulated: bool = True) -> Recording:
    """A run of 4 s with an error of 0.05 um at 3 Hz, one spike of 0.7 um at 3.1 s, and 12 saturated ticks."""
    time = np.arange(int(SECONDS * RATE)) / RATE
    desired = 14.3 * (1 - np.cos(2 * np.pi * 4 * time))
    true = desired + 0.05 * np.sin(2 * np.pi * 3 * time) + 3.0 * np.exp(-time / 0.1)
    true[int(3.1 * RATE)] += 0.7
    flags = np.zeros(time.size, np.uint8)
    flags[100:112] = 1
    data = {
        "time": time,
        "desired": desired,
        "measured": true + 0.02 * np.random.Generator(np.random.PCG64(0)).standard_normal(time.size),
        "volts": desired / 12.6,
        "flags": flags,
    }
    if simulated:
        data |= {"true": true, "uncompensated": desired + 2 * np.sin(2 * np.pi * 4 * time)}
    channels = {name: Channel(values, UNITS[name], name) for name, values in data.items()}
    slow = time[::20]
    drift = np.outer(np.ones(slow.size), np.arange(16.0)) + np.sin(slow)[:, None]
    channels["weights_time"] = Channel(slow, "s", "time of the weights", time="weights_time")
    channels["weights"] = Channel(drift, "um/V", "weights", time="weights_time")
    metadata = {
        "trajectory": {"name": "sine", "settings": {"frequency": 4.0}},
        "controller": {"name": "AdaptiveController", "settings": {"voltage_limits": [-0.6, 3.6]}},
        "plant": {"name": "RealisticPlant", "settings": {"seed": 7, "change": {"time": 1.5}}},
        "versions": {"truestroke": "0.1.0"},
        "note": "<b>not bold</b>",
        "command": "truestroke track --seed 7",
    }
    return Recording(channels, metadata)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return build()


@pytest.fixture(scope="module")
def page(recording: Recording) -> str:
    return report.run_page(recording).html()


@given(st.integers(0, 20_000), st.integers(1, 400), st.integers(2, 20_001))
def test_thinning_keeps_every_peak(spike: int, columns: int, samples: int) -> None:
    spike %= samples
    values = np.sin(np.arange(samples) / 50.0)
    values[spike] = -9.0
    time, thinned = style.thin(np.arange(samples), values, columns)
    assert thinned.size <= 2 * columns + 2
    assert time[thinned.argmin()] == spike
    assert thinned.max() == values.max()
    assert (time[0], time[-1]) == (0, samples - 1)
    assert np.all(np.diff(time) > 0)
    np.testing.assert_array_equal(thinned, values[time.astype(int)])


def test_thinning_leaves_gaps_as_gaps() -> None:
    values = np.ones(10_000)
    values[4000:6000] = np.nan
    time, thinned = style.thin(np.arange(10_000), values, 100)
    assert np.isnan(thinned[(time > 4100) & (time < 5900)]).all()
    assert np.isfinite(thinned[(time < 3900) | (time > 6100)]).all()
    values[::2] = np.nan
    values[[1001, 7001]] = -3, 3
    _, thinned = style.thin(np.arange(10_000), values, 100)
    assert (np.nanmin(thinned), np.nanmax(thinned)) == (-3, 3)


def test_the_legend_at_the_right_has_the_order_of_the_lines_ends(recording: Recording) -> None:
    panel = report.weights(recording).axes[0]
    named = [text.get_text() for text in panel.get_legend().get_texts()]
    assert named == ["a₇", "a₆", "a₅", "a₄", "a₃", "a₂", "a₁", "a₀"]  # the recording's weights ascend
    colours = {line.get_label(): line.get_color() for line in panel.lines}
    assert [text.get_color() for text in panel.get_legend().get_texts()] == [colours[name] for name in named]


def test_weights_of_the_states_of_duhem_have_a_row_with_their_lengths() -> None:
    controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    wave = trajectories.sine(frequency=5.0, peak_to_peak=20.0, duration=1.0)
    rows = report.weights(run(wave, controller, RealisticPlant())).axes
    named = {panel.get_ylabel(): {line.get_label() for line in panel.lines} for panel in rows}
    assert named["states of Duhem (µm/V)"] == {"4.2 V", "1.05 V"}
    assert named["creep (µm/V)"] == {"0.003 s", "0.03 s", "0.3 s", "3 s"}


@pytest.mark.parametrize("theme", [style.LIGHT, style.DARK], ids=lambda theme: theme.name)
def test_axes_have_labels_with_units_and_lines_have_names(recording: Recording, theme: style.Theme) -> None:
    drawn = report.run_plots(recording, theme)
    assert list(drawn) == ["tracking", "error", "spectrum", "loop", "weights", "voltage"]
    for name, figure in drawn.items():
        labels = [axes.get_ylabel() for axes in figure.axes] + [figure.axes[-1].get_xlabel()]
        assert all(re.search(r"\((µm|nm|V|s|µm/V|nm/√Hz|%)\)$", label) for label in labels if label), (name, labels)
        assert labels[0]
        assert labels[-1]
        assert figure.axes[0].get_legend() or name == "weights"
        assert matplotlib.colors.to_hex(figure.get_facecolor()) == theme["background"]


def test_pictures_leave_the_settings_of_matplotlib_alone(recording: Recording) -> None:
    before = dict(matplotlib.rcParams)
    report.tracking(recording, style.DARK)
    assert dict(matplotlib.rcParams) == before


def test_the_zoom_shows_the_largest_error_of_the_second_half(recording: Recording) -> None:
    low, high = report.tracking(recording).axes[1].get_xlim()
    assert low < 3.1 < high
    assert high - low == pytest.approx(0.5, abs=0.01)


def test_the_error_is_drawn_in_the_unit_of_its_axis(recording: Recording) -> None:
    start, whole = report.error(recording, 0.4).axes
    (line,) = [line for line in whole.lines if line.get_label() == "true"]
    x, y = line.get_data()
    assert y[x > 2].max() == pytest.approx(700, abs=60)  # nm, the spike at 3.1 s
    assert "nm" in whole.get_ylabel()
    assert "3 µm" in whole.get_title("left")  # how far the beginning is off the scale
    assert any("0.40 s" in text.get_text() for text in start.texts)


def test_without_truth_the_measured_run_is_shown() -> None:
    measured_only = build(simulated=False)
    drawn = report.run_plots(measured_only)
    assert "loop" not in drawn
    assert [text.get_text() for text in drawn["tracking"].axes[0].get_legend().get_texts()] == ["desired", "measured"]
    heads = report.run_page(measured_only).html().split("<thead>")[1].split("</thead>")[0]
    assert "measured" in heads
    assert "true" not in heads


def test_the_page_needs_nothing_from_outside(page: str) -> None:
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#)""", page)
    assert not re.search(r"@import|url\((?!#)", page)
    assert not re.search(r"<script[^>]*\bsrc", page)
    assert len(page) < 1.5e6


def test_the_page_is_well_formed_and_its_ids_are_unique(page: str) -> None:
    root = ET.fromstring(page.split("\n", 1)[1])
    assert root.attrib["lang"] == "en"
    ids = [element.attrib["id"] for element in root.iter() if "id" in element.attrib]
    assert len(ids) == len(set(ids))
    marked = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    for target in re.findall(r'"#([^"]+)"|url\(#([^)]+)\)', marked):
        assert (target[0] or target[1]) in ids
    pictures = root.findall(".//{http://www.w3.org/2000/svg}svg")
    assert len(pictures) == 12  # each as a phone shows it, too
    for picture in pictures:
        assert picture[0].tag.endswith("title")
        assert picture[0].text
        assert "width" not in picture.attrib  # it scales with the screen


def test_the_page_says_the_figures_the_settings_and_the_flags(page: str, recording: Recording) -> None:
    true, measured = (recording[name][4000:] - recording["desired"][4000:] for name in ("true", "measured"))
    table = page.split("<tbody>")[1].split("</tbody>")[0]
    assert f"{np.sqrt(np.mean(true**2)):.4f}" in table
    assert f"{np.abs(measured).max():.4f}" in table
    assert "12 ticks" in page
    assert "truestroke track --seed 7" in page
    assert "seed 7" in page.split("<footer>")[1]
    assert "4 Hz" in page.split("<main>")[0]
    assert "At 1.5 s it changed suddenly" in page
    assert "&lt;b&gt;not bold" in page


def test_colours_of_the_page_follow_the_reader(page: str) -> None:
    assert "prefers-color-scheme: dark" in page
    assert "var(--true)" in page
    assert not re.search(r"#0f[12]e", page)  # a placeholder that was not replaced
    assert set(re.findall(r"var\(--([a-z0-9-]+)\)", page)) <= set(style.LIGHT.variables)
    assert set(style.LIGHT.variables) == set(style.DARK.variables) == set(style.PAGE.variables)


def test_a_page_shows_each_part_of_its_sections() -> None:
    rows = [["gain", "2 um/V", "of um.csv"], ["flags", "none:\n1 um"]]
    table = Table(columns=["what", "found", "where"], rows=rows, text=True, note="per um")
    sections = [
        Section(heading="5 um", text="set `um = 1`", items=["maximum 3 um"], tables=[table], code="--unit um"),
        Section(heading="not made", plot="none"),
        Section(heading="later", text="folded", folded=True),
    ]
    shown = Page(title="1 um", lead="2 um", sections=sections, plots=lambda _: {}, command="--to um", footer="3 um")
    html = shown.html()
    ET.fromstring(html.split("\n", 1)[1])
    for part in ("<h1>1 µm</h1>", "<code>um = 1</code>", "<li>maximum 3 µm</li>", "<td>2 µm/V</td>", ">per µm<"):
        assert part in html
    assert '<td class="text">of um.csv</td>' in html
    assert '<td class="text" colspan="2">none:\n1 µm</td>' in html
    assert "<code>--unit um</code>" in html
    assert "not made" not in html
    assert html.index("--to um") < html.index("<summary>later</summary>") < html.index("3 µm</footer>")


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_saved_pictures_are_repeatable(recording: Recording, tmp_path: Path, ending: str) -> None:
    first = report.save(report.voltage(recording), tmp_path / f"one.{ending}").read_bytes()
    assert report.save(report.voltage(recording), tmp_path / f"two.{ending}").read_bytes() == first


def test_a_picture_of_a_page_stands_where_matplotlib_saves_it() -> None:
    """Panels beside an image: the places that `savefig` finds by plotting all once more, and the image's resolution."""

    def figure() -> matplotlib.figure.Figure:
        with style.use(style.PAGE):
            made, (left, right) = style.panels(2.0, columns=2)
            left.plot([0.0, 1e4], [0.0, 1e-4], label="a line")
            left.set(xlabel="time, s", ylabel="error, um", title="error")
            right.imshow(np.arange(400.0).reshape(20, 20))
        return made

    saved = figure()
    saved.savefig(io.StringIO(), format="svg")
    saved.set_layout_engine("none")
    places = svg(saved, "a", "a picture")
    assert svg(figure(), "a", "a picture") == places
    moved = figure()
    moved.set_layout_engine("none")
    assert svg(moved, "a", "a picture") != places


def _side_by_side() -> matplotlib.figure.Figure:
    """Two rows of three images of 20 x 10, with the labels of a row and a column where they stand once."""
    with style.use(style.PAGE):
        made, panels = style.panels(4.0, 2, 3, sharex=True, sharey=True)
        for i, panel in enumerate(panels):
            panel.imshow(np.random.Generator(np.random.PCG64(i)).random((10, 20)), interpolation="none")
            panel.set_title("abcdef"[i])
        panels[0].set_ylabel("y")
        panels[3].set_ylabel("y")
        for panel in panels[3:]:
            panel.set_xlabel("x")
    return made


def test_on_a_phone_the_columns_of_panels_are_rows() -> None:
    made = _side_by_side()
    assert style.for_phone(made)
    made.draw_without_rendering()
    places = {axes.get_title(loc="left"): axes.get_position() for axes in made.axes}
    for left, right in ("ad", "be", "cf"):
        assert places[left].x1 < places[right].x0
        assert places[left].y0 == pytest.approx(places[right].y0)
    assert places["a"].y0 > places["b"].y1 > places["b"].y0 > places["c"].y1
    assert made.get_size_inches()[0] == style.PHONE
    assert 0.6 < places["a"].width * 2 < 1
    assert 0.3 < places["a"].height * 3 < 1
    assert [axes.get_ylabel() for axes in made.axes] == ["y", "y", "y", "", "", ""]
    assert [axes.get_xlabel() for axes in made.axes] == ["", "", "x", "", "", "x"]
    one, _ = style.panels(2.0, width=style.PHONE)
    assert not style.for_phone(one)


def _inside(made: Figure) -> None:
    """Whether all words of a picture are within it, and no two of its panels meet."""
    made.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in made.axes if axes.get_visible()]
    for box in boxes:
        assert box is not None
        assert box.x0 >= 0
        assert box.x1 <= made.bbox.x1 + 1
        assert box.y0 >= 0
        assert box.y1 <= made.bbox.y1
    for above, below in itertools.combinations(boxes, 2):
        assert above.y0 > below.y1 or below.y0 > above.y1  # type: ignore[union-attr]


def test_panels_that_are_too_narrow_for_their_titles_are_one_column_on_a_phone() -> None:
    """Eight errors in two columns stood at their size, and two thirds of them beside the screen."""
    with style.use(style.PAGE):
        made, panels = style.panels(5.0, 4, 2, sharex=True, sharey=True)
        for panel in panels[:7]:
            panel.plot([-250.0, 250.0])
            panel.set_title("adaptive rate-independent inverse, of which there is much to say: 20.1 nm rmse")
        panels[7].set_visible(False)
        made.supylabel("error (nm)")
        panels[-2].set_xlabel("time (s)")
    assert style.for_phone(made)
    _inside(made)
    assert made.get_supylabel() == ""
    assert [panel.get_ylabel() for panel in panels[:7]] == ["error (nm)"] * 7
    assert [panel.get_xlabel() for panel in panels[:7]] == [""] * 6 + ["time (s)"]
    assert all("\n" in panel.get_title(loc="left") and not panel.get_title() for panel in panels[:7])


def test_what_has_one_time_stays_together_on_a_phone() -> None:
    with style.use(style.PAGE):
        made, panels = style.panels(5.0, 2, 2, sharex="col")
        panels[0].set_title("the whole of a run that is long")
        panels[1].set_title("around its largest error")
        for panel in panels[2:]:
            panel.set_xlabel("time (s)")
    assert style.for_phone(made)
    _inside(made)
    heights = [panel.get_position().y0 for panel in panels]
    assert heights[0] > heights[2] > heights[1] > heights[3]
    assert [panel.get_xlabel() for panel in panels] == ["", "", "time (s)", "time (s)"]


def test_panels_of_different_widths_are_one_column_on_a_phone() -> None:
    with style.use(style.PAGE):
        made = Figure(figsize=(style.WIDTH, 4.6), layout=style.Places())
        panels = made.subplot_mosaic("TTT;VRC", height_ratios=[1.1, 1])
        panels["R"].sharey(panels["V"])
        panels["V"].set(ylabel="error (nm)")
        for name in "TVRC":
            panels[name].set(title=f"{name}: against voltage", xlabel="voltage (V)")
    assert style.for_phone(made)
    _inside(made)
    assert panels["R"].get_ylabel() == "error (nm)"


def test_words_and_legends_of_a_picture_stay_within_a_phone() -> None:
    with style.use(style.PAGE):
        made, (panel,) = style.panels(3.0)
        panel.plot([0.0, 1000.0], [0.0, 1.0])
        panel.annotate("901.2 Hz", (990.0, 0.5), (4, 0), textcoords="offset points", fontsize=8)
        for words in ("weight and its deviation", "prior and its deviation", "hardly informative"):
            panel.plot([0.0, 1.0], label=words)
        style.legend_above(panel)
    assert style.for_phone(made)
    _inside(made)
    (legend,) = made.legends
    box = legend.get_window_extent()
    assert box.x1 <= made.bbox.x1
    assert box.y0 >= panel.get_window_extent().y1


def test_labels_of_an_image_that_is_larger_on_a_phone_are_within_the_picture() -> None:
    with style.use(style.PAGE):
        made, panels = style.panels(2.0, 1, 3, edges={"left": 0.09, "right": 0.99}, sharex=True, sharey=True)
        for panel in panels:
            panel.imshow(np.zeros((2, 2)), extent=(12.2, 16.0, 12.2, 16.0))
        panels[0].set(ylabel="y (um)")
    svg(made, "wide", "")
    assert style.for_phone(made)
    with style.placed(made, style.VECTOR_DPI):
        made.dpi = style.VECTOR_DPI
        made.draw_without_rendering()
    for panel in panels:
        assert panel.yaxis.label.get_window_extent().x0 >= 0


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-1e-4, 1e-4), (99_000.0, 99_900.0), (-40.0, 1234.5)])
def test_all_labels_of_a_picture_for_a_phone_are_within_it(low: float, high: float) -> None:
    with style.use(style.PAGE):
        made, panels = style.panels(2.8, 1, 3)
        for panel in panels:
            panel.plot([low, high], [low, high])
            panel.set(title="the worst of them", xlabel="position (um)", ylabel="error (pixels)")
    assert style.for_phone(made)
    made.draw_without_rendering()
    for panel in panels:
        box = panel.get_tightbbox()
        assert box is not None
        assert 0 <= box.x0 < 0.12 * made.bbox.width
        assert box.x1 <= made.bbox.width
        assert 0 <= box.y0 < box.y1 <= made.bbox.height
    boxes = [panel.get_tightbbox() for panel in panels]
    assert all(above.y0 > below.y1 for above, below in itertools.pairwise(boxes))  # type: ignore[union-attr]


def test_a_scale_of_colours_is_whole_on_a_phone() -> None:
    with style.use(style.PAGE):
        made, panels = style.panels(3.0, 1, 2, sharey=True)
        shown = [panel.imshow(np.array([[0.0, 12_345.0]])) for panel in panels]
        made.colorbar(shown[0], ax=panels, shrink=0.8, pad=0.02).set_label("height (nm)")
    assert style.for_phone(made)
    made.draw_without_rendering()
    image, scale = panels[0].get_position(), made.axes[-1]
    box = scale.get_tightbbox()
    assert box is not None
    assert image.x1 * made.bbox.width < scale.get_position().x0 * made.bbox.width < box.x1 <= made.bbox.width
    assert box.x1 > 0.9 * made.bbox.width


def test_a_picture_for_a_phone_needs_no_layout_and_no_pixels_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both together were a third of the time of the pictures of a page of `scan`."""
    made = _side_by_side()
    made.set_layout_engine("none")
    encoded: list[tuple[int, int]] = []
    save = PIL.Image.Image.save

    def counted(image: PIL.Image.Image, *arguments: Any, **options: Any) -> None:
        encoded.append(image.size)
        save(image, *arguments, **options)

    monkeypatch.setattr(PIL.Image.Image, "save", counted)
    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: pytest.fail("a layout"))
    Page(title="", lead="", sections=[Section(plot="a")], plots=lambda _: {"a": made}).html()
    assert encoded.count((20, 10)) == 6


def test_minor_ticks_of_a_logarithmic_axis_are_one_line_where_matplotlib_has_them() -> None:
    with style.use(style.LIGHT):
        made, (above, below) = style.panels(3.0, 2, sharex=True)
        above.plot([3.0, 2500.0], [1.0, 2.0])
        style.logarithmic(below, "x")
        below.set_xlim(3.0, 2500.0)
        expected, (alone, _) = style.panels(3.0, 2, sharex=True)
        alone.set(xscale="log", xlim=(3.0, 2500.0))
        alone.xaxis.set_minor_formatter("")
    assert not below.xaxis.get_minorticklocs().size
    places = [[float(x) for x in re.findall(r'<use [^>]*x="([^"]*)"', one)] for one in map(_ticks, (made, expected))]
    assert len(places[0]) == 2 * (7 + 8 + 8 + 1)
    assert sorted(set(places[0])) == pytest.approx(sorted(set(places[1])), abs=0.02)


def _ticks(figure: matplotlib.figure.Figure) -> str:
    """The picture without what is no tick of the horizontal axis."""
    for axes in figure.axes:
        axes.yaxis.set_visible(False)
        axes.tick_params(axis="x", length=0)
        axes.set_xticks([])
    return svg(figure, "a", "")


def test_a_panel_keeps_its_own_labels_on_a_phone() -> None:
    with style.use(style.PAGE):
        made, (left, right) = style.panels(2.0, 1, 2)
        left.set(xlabel="frequency", ylabel="density")
        right.set(xlabel="error", ylabel="share")
        left.plot([0.0, 1.0], label="measured")
        made.legend(*left.get_legend_handles_labels(), loc="upper left")
    assert style.for_phone(made)
    made.draw_without_rendering()
    assert [(axes.get_xlabel(), axes.get_ylabel()) for axes in made.axes] == [
        ("frequency", "density"),
        ("error", "share"),
    ]
    assert left.get_position().y0 > right.get_position().y1
    assert left.get_tightbbox().y1 < made.bbox.height - 0.2 * made.dpi  # type: ignore[union-attr]  # for the legend


WHERE = """(svg) => {
  const [frame, box] = [svg.getBoundingClientRect(), svg.viewBox.baseVal];
  return Array.from(svg.querySelectorAll("image, use")).map((one) => one.getBoundingClientRect())
    .filter((one) => one.width > 30)
    .map((one) => [one.left - frame.left, one.top - frame.top, one.width, one.height])
    .map((place) => place.map((x) => x * box.width / frame.width));
}"""


def test_a_page_has_pixels_once_and_a_phone_shows_them_in_their_places(tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    Page(title="", lead="", sections=[Section(plot="a")], plots=lambda _: {"a": _side_by_side()}).save(file)
    turned = _side_by_side()
    svg(turned, "before", "")
    style.for_phone(turned)
    assert file.read_text().count("data:image/png") == 6
    with look.chromium() as browser:
        for width, name, figure in ((390, "a-phone", turned), (1280, "a", _side_by_side())):
            page = browser.new_page(viewport={"width": width, "height": 844})
            page.goto(file.as_uri())
            seen = page.locator("figure svg:visible")
            assert seen.get_attribute("aria-labelledby") == f"{name}-title"
            assert not look.too_wide(page)
            assert page.evaluate(
                "Array.from(document.querySelectorAll('.scroll')).every(one => one.scrollWidth <= one.clientWidth)"
            )
            by_itself = re.findall(r"<image[^>]*matrix\(([^)]*)", svg(figure, "b", ""))
            places = [[float(x) for x in one.split()] for one in by_itself]
            expected = [[left, top, 20 * wide, 10 * high] for wide, _, _, high, left, top in places]
            assert np.allclose(seen.evaluate(WHERE), expected, atol=0.1)
            page.close()


def test_panels_stand_where_matplotlib_puts_them_and_are_measured_again_only_where_labels_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within a tenth of a point of its own engine, which measures each panel twice."""

    def figure(engine: LayoutEngine | None) -> matplotlib.figure.Figure:
        with style.use(style.LIGHT):
            made, (left, right) = style.panels(2.0, columns=2)
            left.set(xticks=[0.0, 1e4], yticks=[0.0, 1.0])
            right.plot([0.0, 1.0], [0.0, 1e-4])
            right.yaxis.set_major_formatter(lambda y, _: f"{y:.{1 + round(10 * right.get_position().x0)}f}")
            made.set_layout_engine(engine or made.get_layout_engine())
        return made

    measured = []
    once = Axes.get_tightbbox
    monkeypatch.setattr(Axes, "get_tightbbox", lambda self, *a, **b: measured.append(self) or once(self, *a, **b))
    ours, its = figure(None), figure(ConstrainedLayoutEngine(h_pad=0.07, w_pad=0.06))
    counts = []
    for made in (ours, its):
        measured.clear()
        made.draw_without_rendering()
        counts.append([measured.count(axes) for axes in made.axes])
    for panel, other in zip(ours.axes, its.axes, strict=True):
        np.testing.assert_allclose(panel.get_position().extents, other.get_position().extents, atol=0.1 / 504)
    assert counts == [[1, 2], [2, 2]]


def test_a_table_of_many_columns_does_not_scroll_sideways_on_a_phone(tmp_path: Path) -> None:
    """The names of the columns are beside the numbers there; at a desk they are above them."""
    columns = ["controller", "distortion", "rms", "trace-retrace", "seen shift", "x rms", "y rms"]
    rows = [["truestroke", "60.99 px", "33.31 px", "66.96 px", "67.55 px", "1.09 um", "713 nm"], ["none", "no image"]]
    long = ["first resonance", "699.997 Hz +- 0.014 Hz, damping 0.02", "of 1 mode, trusted to 1161.7 Hz"]
    fast = ["% rms of peak to peak", "controller", "straight line", "held", "failed"]
    runs = ["after f0 jumps, dynamics measured", "0.352 / 11.2 / 13.4", "1.35 / 11.2 / 13.4", "0.35 / 11.2 / 1034", "0"]
    sensor = ["displacement, overcompensated", "12.5 nm", "699.997 Hz", "0.5 um"]
    tables = (
        Table(columns=columns, rows=rows),
        Table(columns=["", "found", "beside"], rows=[long]),
        Table(columns=fast, rows=[runs]),
        Table(columns=["sensor", "measured", "frequency", "amplitude"], rows=[sensor]),
        Table(columns=["harmonic", "amplitude", "phase", "gain"], rows=[["1", "12.5 nm", "0.2 rad", "3"]]),
    )
    assert [table.many for table in tables] == [True, False, True, True, False]
    made = Page(title="a scan", lead="", sections=(Section(heading="", tables=tables),), plots=lambda _: {})
    file = made.save(tmp_path / "page.html")
    with look.chromium() as browser:
        for width, display in ((360, "grid"), (1000, "table-row")):
            seen = browser.new_page(viewport={"width": width, "height": 800})
            seen.goto(file.as_uri())
            assert seen.evaluate("[...document.querySelectorAll('.scroll')].every(e => e.scrollWidth <= e.clientWidth)")
            assert seen.evaluate("getComputedStyle(document.querySelector('tbody tr')).display") == display
            assert look.too_wide(seen) + look.inaccessible(seen) == []
