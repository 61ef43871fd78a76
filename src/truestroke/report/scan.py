"""The page of a scan on hardware: its images, trace and retrace laid over one another, its errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.report import images, spectra, style, units, words
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.page import Page, Section, Table, captioned, closer
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.recording import Recording
from truestroke.signals.scans.recorded import Recorded

CAPTIONS = {
    "image": ("The image", "As it was recorded, row by row; grey from the lowest to the highest signal."),
    "places": ("The image", "The samples at their measured places; grey from the lowest to the highest signal."),
    "over": ("Trace and retrace", images.LAID_OVER),
    "lines": (
        "Where along a line",
        "Measured minus desired position of x and y in the trace and in the retrace: the median of all rows, and where "
        "four of five of them are. The noise of the sensors is in it.",
    ),
    "errors": ("Errors", "Measured minus desired position of x and y, with the noise of the sensors."),
    "spectrum": words.CAPTIONS["spectrum"],
}
WORDS = {"good": "The image is straight, by the sensors.", "doubtful": "Read this before you use it.",
         "bad": "Do not measure in it."}  # fmt: skip
BAR = 0.9  # in of the scale beside an image
FLAT = 0.5  # height over width: images that are flatter stand one above the other
BAND = 10, 50, 90  # % of the rows
SCANS = {"lissajous": "Lissajous curve"}  # where it is no word
POINTS = 4000  # of a plot over time


def rows(found: Recorded, recordings: Mapping[str, Recording] | None = None) -> list[list[str]]:
    """What was found, in words, with what each axis learned where there are their recordings."""
    shown = next(iter(found.images.values()))
    x, y = (units.length(one) if one else "within the noise" for one in found.rms_um())
    lines = {"raster": "rows", "spiral": "turns"}.get(found.scan.name, "lines")
    across, down = shown.data.shape[::-1]
    pixels = f"{across} x {down} of {' x '.join(map(units.length, shown.pixel))}"
    made = [[lines, f"{found.rows[0]} of {found.rows[1]}"], ["pixels", pixels]]
    made.append([f"rms error of {', '.join(found.axes)}", f"{x}, {y}"])
    if found.distortion is not None:
        apart = found.distortion.trace_retrace
        shown_apart = f"{apart:.2f} pixels" + (", within the noise" if apart <= found.noise_apart else "")
        made.append(["trace and retrace apart, by the sensors", shown_apart])
    if found.shift is not None:
        made.append(["trace and retrace apart, in the images", f"{np.hypot(*found.shift):.2f} pixels"])
    learned = {name: words.repeated(recordings[name]) for name in found.axes} if recordings else {}
    return made + [[f"{name} {head}", text] for name, row in learned.items() for head, text in row]


def page(
    found: Recorded,
    verdict: Verdict,
    command: str | None = None,
    recordings: Mapping[str, Recording] | None = None,
) -> Page:
    """The page; `verdict` is that of the image and of the axes, `command` what repeats the scan."""
    shown = next(iter(found.images.values()))
    width, height = shown.size
    across, down = shown.data.shape[::-1]
    name, kind = shown.name.split(",")[0], SCANS.get(found.scan.name, found.scan.name)
    return Page(
        title=f"{name.capitalize()} of {width:.4g} x {height:.4g} um",
        lead=f"A {kind} of {found.scan.x.duration:.3g} s, {across} x {down} pixels.",
        verdict=verdict,
        remark=WORDS[verdict.level],
        sections=[
            Section(tables=[Table(rows=rows(found, recordings), kind="words")]),
            *captioned(_captions(found)),
            closer(chart(found)),
        ],
        plots=lambda theme: plots(found, theme),
        command=command,
        footer=words.made_now(),
    )


def _captions(found: Recorded) -> dict[str, tuple[str, str]]:
    """With the names of the axes."""
    named = {name: (head, text.replace("x and y", " and ".join(found.axes))) for name, (head, text) in CAPTIONS.items()}
    shown = _shown(found)
    turns = len(shown) - int(np.count_nonzero(found.scan.inside))
    return named | {"spectrum": words.spectrum(shown.T, "within the lines", turns)}


def plots(found: Recorded, theme: Theme = LIGHT) -> dict[str, Figure]:
    """All of them by name, in the order of the page."""
    with style.use(theme):
        made = {"image" if found.distortion else "places": _images(found)}
        if found.distortion is not None:
            figure, panel = images.alone(found.scan.size, 5.0, 4.2)
            images.lay_over(panel, found.images["trace"], found.images["retrace"])
            images.label(panel, *found.axes)
            made |= {"over": figure, "lines": _lines(found, theme)}
        else:
            made["errors"] = _errors(found, theme)
        each = zip(found.axes, ("true", "before"), _shown(found).T, strict=True)
        errors = {name: (role, error) for name, role, error in each}
        made["spectrum"] = spectra.spectrum(errors, found.scan.sample_rate, theme)
    return made


def chart(found: Recorded) -> Chart:
    """Motion and errors of both axes within the lines, to zoom into."""
    factor, unit = units.scaled_length(float(np.nanmax(np.abs(found.error), initial=0.0)))
    axes = list(zip(found.axes, ("true", "before"), found.scan.axes, found.error.T, strict=True))
    panels = [
        Panel("desired position (µm)", [Line(name, role, axis.position) for name, role, axis, _ in axes]),
        Panel(f"error ({unit})", [Line(name, role, factor * error) for name, role, _, error in axes]),
    ]
    return Chart(panels, 0.0, 1.0 / found.scan.sample_rate)


def _shown(found: Recorded) -> FloatArray:
    """Errors from the first line to the last, um, NaN in the turns between them, of shape (ticks, 2)."""
    inside = np.flatnonzero(found.scan.inside)
    return found.error[inside[0] : inside[-1] + 1]


def _images(found: Recorded) -> Figure:
    """Side by side; one above the other where they are flat."""
    shown, size = list(found.images.items()), next(iter(found.images.values())).size
    if len(shown) == 1:
        figure, panel = images.alone(size, 5.0, 4.2, BAR)
        panels = [panel]
    elif images.aspect(size) < FLAT:
        figure, panels = style.panels(2 * images.height(size, 5.4, 4.7), len(shown), sharex=True)
    else:
        figure, panels = style.panels(images.height(size, 2.8, 5.0), 1, len(shown), sharey=True)
    limits = images.contrast(shown[0][1])
    for panel, (name, image) in zip(panels, shown, strict=True):
        images.show(panel, image, limits=limits)
        panel.set_title(f"{image.name.split(',')[0]}, {name}" if len(shown) > 1 else image.name)
        images.label(panel, *found.axes)
        panel.label_outer()
    name, unit = shown[0][1].name.split(",")[0], shown[0][1].unit
    colours = figure.colorbar(panels[-1].images[0], ax=list(panels), shrink=0.8, pad=0.02)
    colours.set_label(f"{name} ({unit})" if unit else name)
    return figure


def _lines(found: Recorded, theme: Theme) -> Figure:
    """A panel for each axis."""
    moved = found.distortion
    assert moved is not None
    figure, panels = style.panels(2.8, 1, 2)
    x = found.scan.origin[0] + (np.arange(moved.dx.shape[1]) + 0.5) * moved.size[0]
    for panel, errors, name, size in zip(panels, (moved.dx, moved.dy), found.axes, moved.size, strict=True):
        for direction, colour, word in ((1, "alarm", "trace"), (-1, "true", "retrace")):
            kept = 1e3 * size * errors[moved.directions == direction]
            low, middle, high = np.percentile(kept, BAND, axis=0)
            panel.fill_between(x, low, high, color=theme[colour], alpha=0.25, lw=0)
            panel.plot(x, middle, color=theme[colour], lw=1.0, label=word)
        panel.set_title(f"error of {name}")
        panel.set(xlabel=f"{found.axes[0]} (µm)")
    panels[0].set(ylabel="error (nm)")
    style.legend_above(panels[0])
    return figure


def _errors(found: Recorded, theme: Theme) -> Figure:
    figure, panels = style.panels(2.8, 1, 2, sharey=True)
    step = max(1, len(found.error) // POINTS)
    time = found.scan.time[::step]
    for panel, error, name in zip(panels, found.error[::step].T, found.axes, strict=True):
        panel.plot(time, 1e3 * error, color=theme["true"], lw=0.6)
        panel.set_title(f"error of {name}")
        panel.set(xlabel="time (s)")
    panels[0].set(ylabel="error (nm)")
    return figure
