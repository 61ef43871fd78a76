"""The page of a run, from its recording alone."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from truestroke.base import checks, toml
from truestroke.control.feedback import Feedback
from truestroke.report import plots, words
from truestroke.report.page import Number, Page, Section, Table, captioned, closer
from truestroke.report.style import LIGHT, Theme
from truestroke.signals import judgement
from truestroke.signals.metrics import TrackingSummary
from truestroke.signals.recording import Recording


def run_page(recording: Recording) -> Page:
    """The page of a run: its errors, its verdict, its plots and all its settings.

    Parameters
    ----------
    recording : Recording
        Of at least 20 ticks, with a measurement in the second half; of several axes with one of each.

    Returns
    -------
    Page
        `save` writes it, `save_plots` writes its plots.
    """
    if recording.axes:
        return _page_of_axes(recording)
    summary, verdict = judgement.summary(recording), judgement.judge(recording)
    settings = Table(rows=list(_flat(recording.metadata)), kind="words")
    return Page(
        title=words.title(recording, summary, verdict),
        lead=words.run(recording, summary, verdict),
        verdict=verdict,
        remark=words.REMARKS[verdict.level],
        sections=[
            Section(tables=[_table(summary, [*_feedback(recording), *words.repeated(recording)])]),
            closer(plots.closer(recording)),
            *captioned(words.CAPTIONS | {"spectrum": _of_what(recording)}),
            Section(heading="All settings", tables=[settings], folded=True),
        ],
        plots=lambda theme: run_plots(recording, theme),
        command=words.command(recording),
        footer=words.footer(recording),
    )


def _page_of_axes(recording: Recording) -> Page:
    """The pages of all axes in one, one after the other."""
    pages = {name: run_page(recording.axis(name)) for name in recording.axes}
    verdict = judgement.judge(recording)
    sections = []
    for name, page in pages.items():
        for section in page.sections:
            heading = f"Axis {name}: {section.heading.lower()}" if section.heading else f"Axis {name}"
            plot = f"{section.plot}-{name}" if section.plot else ""
            sections.append(dataclasses.replace(section, heading=heading, plot=plot))
    return Page(
        title="; ".join(f"{name}: {page.title}" for name, page in pages.items()),
        lead=" ".join(f"Axis {name}: {page.lead}" for name, page in pages.items()),
        verdict=verdict,
        remark=words.REMARKS[verdict.level],
        sections=sections,
        plots=lambda theme: {
            f"{plot}-{name}": figure for name, page in pages.items() for plot, figure in page.plots(theme).items()
        },
        command=words.command(recording),
        footer=words.footer(recording),
    )


def save_page(recording: Recording, path: str | Path) -> Path:
    """Write the page of a run to `path`, which is returned; nothing outside the file is needed to read it."""
    order = "a Recording, such as of truestroke.run or Recording.load(path); the order is recording, path"
    checks.instance("recording", recording, Recording, order)
    return run_page(recording).save(path)


def run_plots(recording: Recording, theme: Theme = LIGHT) -> dict[str, Figure]:
    """Every plot that the channels of `recording` allow, by name, in the order of the page."""
    converged = judgement.summary(recording).convergence_time_s
    made = {
        "tracking": plots.tracking(recording, theme),
        "error": plots.error(recording, converged, theme),
        "spectrum": plots.spectrum(recording, theme),
    }
    before = plots.uncompensated(recording)
    if before is not None:
        made["loop"] = plots.loop(before, recording, theme)
    if "weights" in recording.channels:
        made["weights"] = plots.weights(recording, theme)
    made["voltage"] = plots.voltage(recording, words.voltage_limits(recording), theme)
    return made


def _of_what(recording: Recording) -> tuple[str, str]:
    """Heading and caption of the spectrum."""
    return words.spectrum(plots.settled_errors(recording).values(), "of the second half")


def _feedback(recording: Recording) -> list[tuple[str, str]]:
    """The row of the feedback, of a controller that has dynamics."""
    settings = recording.metadata.get("controller", {}).get("settings", {})
    if not settings.get("dynamics"):
        return []
    return [("feedback", toml.decode(Feedback, settings["feedback"]).summary)]


def _table(summary: TrackingSummary, also: Sequence[tuple[str, str]] = ()) -> Table:
    """Errors, when they became small, what happened on the way, and other rows."""
    flags = words.flags(summary) or ["none: no limit was met, nothing was rejected"]
    note = (
        f"Per cent are of the peak-to-peak value of the desired motion in that time, {summary.peak_to_peak_um:.1f} um."
    )
    if summary.true_rmse_um is not None:
        note += " Measured is the reading of the sensor, with its noise; true is the motion of the simulated actuator."
    errors: list[Sequence[str | Number]] = [
        [row, *(Number(um, "um", share) for um, share in cells)] for row, cells in words.table(summary)
    ]
    return Table(
        columns=[words.span(summary), *words.kinds(summary)],
        rows=[*errors, *words.course(summary), *also, ("flags", "\n".join(flags))],
        kind="summary",
        note=note,
    )


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
