"""Tables and page of a robustness study."""

from __future__ import annotations

from collections.abc import Sequence

from truestroke.report import words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.signals.recording import Recording
from truestroke.studies.engine import Row
from truestroke.studies.robustness import plots
from truestroke.studies.robustness.metrics import METRICS
from truestroke.studies.robustness.table import LEFT_OUT, NAMES, judge, lines, sentence

SHOWN = 5  # runs with the largest errors
CAPTIONS = {
    "distribution": (
        "How the errors are distributed",
        "Part of the runs whose true rmse is at most so much. Further left is better, and steeper: the same for every "
        "actuator. Mind the scale, which is logarithmic.",
    ),
    "largest": (
        "The largest error of each run",
        "A burst shows here even where the rmse forgives it: the higher above the diagonal, the rarer and the larger.",
    ),
    "worst": (
        "The worst run",
        "The run with the largest error that counts: its motion and its error after the first 0.5 s, and around that "
        "error. A triangle marks what is off the scale.",
    ),
}
WORST_NOTE = (
    "µm. Ringing is the free oscillation of the stage 50 ms after the jump of a change; no controller can correct it."
)
NOTE = (
    "True displacement. rmse and maximum are of the second half of the motion without 0.1 s after a change; the "
    f"largest error that counts leaves out {LEFT_OUT}, which have a row of their own. The ratio is run by run."
)

Cells = tuple[list[str], list[list[str]]]


def table(rows: Sequence[Row]) -> Cells:
    """Columns and rows of the table, as text: median, 95th percentile and worst, um, and the ratio to the paper's."""
    found, cells = lines(rows), []
    ratio = any(line.ratio for line in found)
    for line in found:
        row = [f"{METRICS[line.metric]}, {NAMES[line.controller]}", str(line.runs)]
        row += [f"{value:.4f}" for value in (line.median, line.p95, line.worst)]
        if ratio:
            row.append("1/" + " 1/".join(f"{1 / part:.0f}" for part in line.ratio) if line.ratio else "")
        cells.append(row)
    return ["true displacement, um", "runs", "median", "95 %", "worst"] + ["of the paper's"] * ratio, cells


def worst_first(rows: Sequence[Row]) -> list[Row]:
    """The runs by their largest error with the first controller."""
    return sorted(rows, key=lambda row: -_first(row)["largest"])


def _first(row: Row) -> dict[str, float]:
    """Metrics of the first controller: the one that is looked at."""
    return {name: float(value or 0.0) for name, value in next(iter(row.metrics.values())).items()}


def worst_runs(rows: Sequence[Row]) -> Cells:
    """Columns and rows of the runs with the largest errors, as text."""
    cells = []
    for row in worst_first(rows)[:SHOWN]:
        found = _first(row)
        values = [f"{found['rmse']:.4f}", f"{found['largest']:.3f}", f"{found['largest_at']:.2f} s"]
        values += [f"{found[name]:.3f}" for name in ("ringing", "left_out")]
        cells.append([str(row.number), *values, row.sampled["what"]])
    return ["run", "rmse", "largest", "at", "ringing", "left out", "what happened"], cells


def page(rows: Sequence[Row], recording: Recording, command: str | None = None) -> Page:
    """The page of a robustness study.

    Parameters
    ----------
    rows : sequence of Row
        The runs.
    recording : Recording
        Of the worst run, with the first controller.
    command : str, optional
        What makes this page again.
    """
    (columns, cells), (worst_columns, worst_cells) = table(rows), worst_runs(rows)
    found = Table(columns=columns, rows=cells, note=NOTE)
    worst = Table(columns=worst_columns, rows=worst_cells, note=WORST_NOTE, text=True)
    return Page(
        title=f"{len(rows)} plants, sampled at random",
        lead=" ".join(sentence(rows, name) for name in rows[0].metrics),
        verdict=judge(rows),
        sections=[Section(tables=[found, worst]), *captioned(CAPTIONS)],
        plots=lambda theme: plots.plots(rows, worst_first(rows)[0], recording, theme),
        command=command,
        footer=words.footer(recording),
    )
