"""The page of a simulated scan: what a microscopist sees, side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.report import images, spectra, style, units, words
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.page import Page, Section, Table, captioned, closer
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.scans.images import Image
from truestroke.studies.scanning.imaging import NAMES, PIXELS, ROTATION, Imaged, Scanned

PART = 96  # pixels of the texture that are shown enlarged
EDGES = {"left": 0.09, "right": 0.99, "wspace": 0.1}  # of the panels
CAPTIONS = {
    "grating": (
        "A calibration grating",
        "Square pits in straight rows, 3 um apart: the trace and the retrace of the same rows.",
    ),
    "texture": (
        "Trace and retrace, laid over one another",
        "A part of the texture, 96 x 96 pixels: the trace in red, the retrace in cyan. Grey is where they agree; "
        "where the same thing is in two places, its edges are coloured.",
    ),
    "errors": (
        "Where along a line",
        "True minus desired position, in pixels, of x in the trace and in the retrace: the median and the range of all "
        "rows. The scales differ. The shaded band is a tenth of a pixel.",
    ),
    "spectrum": words.spectrum((), "of x, turns included,"),
}
WORDS = {"good": "The image is straight.", "doubtful": "Nearly.", "bad": "Do not measure in it."}
HEADS = ["controller", "distortion", "rms", "trace-retrace", "seen shift", "x rms", "y rms"]


def rows(found: Scanned) -> list[list[str]]:
    """A row for each controller; pixels, and lengths."""
    made = []
    for one in found.imaged.values():
        moved = one.distortion
        pixels = (moved.largest, moved.rms, moved.trace_retrace, float(np.hypot(*one.shift)))
        cells = [f"{value:.2f} px" if value < 100 else f"{value:.0f} px" for value in pixels]
        made.append([NAMES[one.name], *cells, *(units.length(value) for value in moved.rms_um())])
    return made


def page(found: Scanned, command: str | None = None) -> Page:
    """The page; `command` is what repeats it."""
    best = found.imaged["truestroke"].distortion
    rate, lines = (float(found.scan.settings[name]) for name in ("rate", "lead_in"))  # type: ignore[arg-type]
    first = " and ".join(f"{one.resonances[0]:g}" for one in found.stage.axes)
    of_each = [one.hysteresis_kind for one in found.stage.axes]
    kinds = " and ".join(kind if kind == "plays" else kind.title() for kind in of_each)  # Preisach, Bouc-Wen
    lead = (
        f"Two samples, scanned by a simulated XY stage at {rate:g} rows a second, {PIXELS} x {PIXELS} pixels: with "
        f"truestroke no pixel is more than {best.largest:.2g} pixels from its place."
    )
    stage, width = found.stage, found.scan.size[0]
    note = (
        f"Pixels of {1e3 * width / PIXELS:.0f} nm. Distortion: largest distance of a pixel from its place. "
        "Trace-retrace: largest distance between both, in a mean of 16 rows. Seen shift: by the images alone. The "
        f"stage: resonances of {first} Hz, {100 * stage.coupling[1][0]:g} % of x on y, hysteresis of {kinds}, "
        f"sensor noise of {1e3 * stage.axes[0].noise:g} nm. truestroke knows the resonances, and has had "
        f"{lines / rate:g} s of lines before the image. The paper's law knows neither resonance nor other axes, and "
        "was not made for this speed."
    )
    spiral = (
        f"A spiral of {ROTATION:g} turns per second and {width:g} um, by the same stage and controllers, is "
        f"{found.spiral:.2g} % of its diameter off, rms."
    )
    return Page(
        title=f"An image of {found.scan.size[0]:g} um at {rate:g} rows a second",
        lead=lead,
        verdict=found.verdict,
        remark=WORDS[found.verdict.level],
        sections=[
            Section(tables=[Table(columns=HEADS, rows=rows(found), note=note)]),
            *captioned(CAPTIONS),
            closer(chart(found)),
            Section(heading="A spiral", text=spiral),
        ],
        plots=lambda theme: plots(found, theme),
        command=command,
        footer=words.made_now(),
    )


def plots(found: Scanned, theme: Theme = LIGHT) -> dict[str, Figure]:
    """All of them by name, in the order of the page."""
    return {
        "grating": grating(found, theme),
        "texture": texture(found, theme),
        "errors": errors(found, theme),
        "spectrum": spectrum(found, theme),
    }


def chart(found: Scanned) -> Chart:
    """Errors of x under each controller, and the motion, to zoom into."""
    panels = [
        Panel("desired (µm)", [Line("x", "true", found.scan.x.position), Line("y", "before", found.scan.y.position)])
    ]
    for one in found.imaged.values():
        factor, unit = units.scaled_length(float(np.abs(one.error).max()))
        panels.append(Panel(f"{NAMES[one.name]} ({unit})", [Line("error of x", "true", factor * _error(one))]))
    return Chart(panels, 0.0, 1.0 / found.scan.sample_rate)


def spectrum(found: Scanned, theme: Theme = LIGHT) -> Figure:
    """Spectrum and histogram of the error of x under each controller."""
    inside = np.flatnonzero(found.scan.inside)
    part = slice(inside[0], inside[-1] + 1)
    roles = ("before", "alarm", "true")
    of_x = {NAMES[one.name]: (role, _error(one)[part]) for role, one in zip(roles, found.imaged.values(), strict=True)}
    return spectra.spectrum(of_x, found.scan.sample_rate, theme)


def _error(one: Imaged) -> FloatArray:
    """True minus desired position of x, um."""
    return one.error.astype(np.float64)


def grating(found: Scanned, theme: Theme = LIGHT) -> Figure:
    """Trace and retrace below it, a column for each controller."""
    with style.use(theme):
        edges = {**EDGES, "bottom": 0.09, "top": 0.95, "hspace": 0.12}
        figure, panels = style.panels(5.1, 2, len(found.imaged), edges=edges, sharex=True, sharey=True)
        limits = images.contrast(found.imaged["truestroke"].images["grating"]["trace"])
        for column, one in enumerate(found.imaged.values()):
            for row, direction in enumerate(("trace", "retrace")):
                panel = panels[row * len(found.imaged) + column]
                images.show(panel, one.images["grating"][direction], limits=limits)
                panel.set_title(f"{NAMES[one.name]}, {direction}")
                if column == 0:
                    panel.set(ylabel="y (µm)")
                if row:
                    panel.set(xlabel="x (µm)")
    return figure


def texture(found: Scanned, theme: Theme = LIGHT) -> Figure:
    """A part of the texture, trace and retrace in two colours."""
    with style.use(theme):
        edges = {**EDGES, "bottom": 0.15, "top": 0.92}
        figure, panels = style.panels(2.9, 1, len(found.imaged), edges=edges, sharex=True, sharey=True)
        for column, (panel, one) in enumerate(zip(panels, found.imaged.values(), strict=True)):
            trace, retrace = (one.images["texture"][direction] for direction in ("trace", "retrace"))
            images.lay_over(panel, trace, retrace, part=_part(trace))
            panel.set_title(NAMES[one.name])
            panel.set(xlabel="x (µm)")
            if column == 0:
                panel.set(ylabel="y (µm)")
    return figure


def _part(image: Image) -> tuple[slice, slice]:
    return images.middle(image, PART)


def errors(found: Scanned, theme: Theme = LIGHT) -> Figure:
    """Mean and range over the rows of the error of x along a line, a panel for each controller."""
    with style.use(theme):
        edges = {**EDGES, "bottom": 0.17, "top": 0.83, "wspace": 0.28}
        figure, panels = style.panels(2.8, 1, len(found.imaged), edges=edges)
        for column, (panel, one) in enumerate(zip(panels, found.imaged.values(), strict=True)):
            moved = one.distortion
            x = found.scan.origin[0] + (np.arange(PIXELS) + 0.5) * moved.size[0]
            panel.axhspan(-0.1, 0.1, color=theme["grid"], lw=0, zorder=0)
            for direction, colour, name in ((1, "alarm", "trace"), (-1, "true", "retrace")):
                kept = moved.dx[moved.directions == direction]
                low, middle, high = np.percentile(kept, [0, 50, 100], axis=0)
                panel.fill_between(x, low, high, color=theme[colour], alpha=0.25, lw=0)
                panel.plot(x, middle, color=theme[colour], lw=1.0, label=name)
            panel.set_title(NAMES[one.name])
            panel.set(xlabel="x (µm)")
            if column == 0:
                panel.set(ylabel="error (pixels)")
            if column == len(found.imaged) - 1:
                most = max(0.2, 1.1 * float(np.abs(moved.dx).max()))
                panel.set_ylim(-most, most)
        entries, corner = panels[0].get_legend_handles_labels(), (EDGES["left"] - 0.02, 1.0)
        figure.legend(*entries, loc="upper left", bbox_to_anchor=corner, ncols=2, handlelength=1.2)
    return figure
