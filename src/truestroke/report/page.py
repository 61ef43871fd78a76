"""One self-contained HTML page of a recording: what was run, the figures in a table, the pictures."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import jinja2
import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from truestroke.base import checks, files
from truestroke.report import figures, style, words
from truestroke.report.style import LIGHT, Theme
from truestroke.signals import judgement
from truestroke.signals.recording import Recording


def pictures(recording: Recording, theme: Theme = LIGHT) -> dict[str, Figure]:
    """Every picture that the channels of `recording` allow, by name, in the order of a page."""
    converged = judgement.summary(recording).convergence_time_s
    drawn = {
        "tracking": figures.tracking(recording, theme),
        "error": figures.error(recording, converged, theme),
    }
    before = figures.uncompensated(recording)
    if before is not None:
        drawn["loop"] = figures.loop(before, recording, theme)
    if "weights" in recording.channels:
        drawn["weights"] = figures.weights(recording, theme)
    drawn["voltage"] = figures.voltage(recording, words.voltage_limits(recording), theme)
    return drawn


def save_pictures(recording: Recording, directory: str | Path) -> list[Path]:
    """Write every picture as PNG, light and dark, into `directory`; the paths."""
    return save_all(lambda theme: pictures(recording, theme), directory)


def save_all(draw: Callable[[Theme], Mapping[str, Figure]], directory: str | Path) -> list[Path]:
    """Write the pictures that `draw` gives by name, as NAME-light.png and NAME-dark.png; the paths."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    return [
        style.save(figure, directory / f"{name}-{theme.name}.png")
        for theme in (style.LIGHT, style.DARK)
        for name, figure in draw(theme).items()
    ]


def save_page(recording: Recording, path: str | Path) -> Path:
    """Write the page of `recording` to `path`; nothing outside the file is needed to read it."""
    order = "a Recording, such as of truestroke.run or Recording.load(path); the order is recording, path"
    checks.instance("recording", recording, Recording, order)
    return files.write(checks.path("path", path), page(recording), files.PAGE)


def sentence(reason: str) -> Markup:
    """A sentence of the terminal as HTML: lengths in µm, keys and commands as code.

    Examples
    --------
    >>> print(sentence("1 um < 2 um: change `um_per_volt = 10`, or um_per_unit"))
    1 µm &lt; 2 µm: change <code>um_per_volt = 10</code>, or um_per_unit
    """
    parts = re.split("`([^`]*)`", re.sub(r" um\b", " µm", reason))  # text, code, text, ...
    return Markup("").join(Markup("<code>{}</code>").format(p) if i % 2 else p for i, p in enumerate(parts))


def page(recording: Recording) -> str:
    """The page of `recording` as HTML; it is also well-formed XML."""
    summary = judgement.summary(recording)
    drawn, verdict = pictures(recording, style.PAGE), judgement.judge(recording)
    return render(
        "recording",
        title=words.title(recording, summary, verdict),
        verdict=verdict.level,
        reasons=[sentence(reason) for reason in verdict.reasons],
        lead=words.run(recording, summary, verdict),
        span=words.span(summary),
        columns=words.kinds(summary),
        table=[{"name": name, "cells": cells} for name, cells in words.table(summary)],
        course=words.course(summary),
        flags=words.flags(summary),
        peak_to_peak=f"{summary.peak_to_peak_um:.1f}",
        simulated="true" in recording.channels,
        figures=[
            {"heading": heading, "caption": caption, "svg": svg(drawn[name], name, caption)}
            for name, (heading, caption) in words.CAPTIONS.items()
            if name in drawn
        ],
        command=words.command(recording),
        settings=list(_flat(recording.metadata)),
        footer=words.footer(recording),
    )


def render(template: str, **content: Any) -> str:
    """One of the templates, in the colours of both themes."""
    environment = jinja2.Environment(loader=jinja2.PackageLoader("truestroke.report"), autoescape=True)
    colours = {theme.name: _variables(theme) for theme in (style.LIGHT, style.DARK)}
    return environment.get_template(f"{template}.html.j2").render(**colours, **content)


def svg(figure: Figure, name: str, description: str) -> str:
    """The figure, drawn in the theme "page", as SVG for inside a page.

    Its colours are CSS variables, its ids begin with `name` so that they are unique on the page, and it says
    `description` to a screen reader.
    """
    file = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style type=.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|"#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for variable, colour in style.PAGE.variables.items():
        text = text.replace(colour, f"var(--{variable})")
    box = re.search(r'viewBox="[^"]*"', text)
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {box[0] if box else ""} '
        f'role="img" aria-labelledby="{name}-title"><title id="{name}-title">{escape(description)}</title>'
    )
    return re.sub(r"<svg[^>]*>", lambda _: opening, text, count=1)


def _variables(theme: Theme) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in theme.variables.items())


def _flat(metadata: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as rows: dotted name, value in short."""
    for name, value in metadata.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, _short(value)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        shown = [_short(entry) for entry in value[:12]]
        return ", ".join(shown) + (f", ... ({len(value)} in all)" if len(value) > 12 else "")
    return str(value)


__all__ = ["page", "pictures", "render", "save_all", "save_page", "save_pictures", "svg"]
