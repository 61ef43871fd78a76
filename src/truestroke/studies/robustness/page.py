"""Tables, pictures and page of a robustness study."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.report import style, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.judgement import change_time
from truestroke.signals.recording import Recording
from truestroke.studies.engine import Row
from truestroke.studies.robustness.table import LEFT_OUT, LIMIT, METRICS, NAMES, START, judge, lines, sentence, values

SHOWN = 5  # runs with the largest errors
ROLES = {"adaptive": "true", "paper": "before"}
PANELS = {
    "rmse": "rmse, second half",
    "after_change": "0.1 to 0.5 s after a change",
    "cold": "0.75 to 1 s from a cold start",
}
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
    """The page of a robustness study; `recording` is the worst run with the first controller; `command` repeats it."""
    (columns, cells), (worst_columns, worst_cells) = table(rows), worst_runs(rows)
    found = Table(columns=columns, rows=cells, note=NOTE)
    worst = Table(columns=worst_columns, rows=worst_cells, note=WORST_NOTE, text=True)
    return Page(
        title=f"{len(rows)} plants, sampled at random",
        lead=" ".join(sentence(rows, name) for name in rows[0].metrics),
        verdict=judge(rows),
        sections=[Section(tables=[found, worst]), *captioned(CAPTIONS)],
        plots=lambda theme: {
            "distribution": distribution(rows, theme),
            "largest": largest(rows, theme),
            "worst": trace(worst_first(rows)[0], recording, theme),
        },
        command=command,
        footer=words.footer(recording),
    )


def distribution(rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """Part of the runs whose error is at most so much, nm on a logarithmic scale."""
    with style.use(theme):
        figure, panels = style.panels(2.7, 1, 3, sharey=True)
        for panel, (name, title) in zip(panels, PANELS.items(), strict=True):
            for controller in rows[0].metrics:
                ascending = np.sort([1e3 * value for value in values(rows, controller, name)])
                part = 100 * np.arange(1, ascending.size + 1) / max(ascending.size, 1)
                panel.step(
                    ascending, part, where="post", color=theme[ROLES[controller]], label=NAMES[controller], lw=1.4
                )
            style.logarithmic(panel, "x")
            panel.set(title=title, xlabel="true rmse (nm)", ylim=(0, 101))
        panels[0].set_ylabel("runs with at most that (%)")
        panels[-1].legend(loc="lower right")
    return figure


def largest(rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """The largest error of each run against its rmse, nm, both logarithmic."""
    markers = {"adaptive": "o", "paper": "D"}
    with style.use(theme):
        figure, (panel,) = style.panels(3.4)
        for controller in rows[0].metrics:
            rmse, highest = ([1e3 * v for v in values(rows, controller, name)] for name in ("rmse", "largest"))
            colour, name = theme[ROLES[controller]], NAMES[controller]
            panel.plot(rmse, highest, markers[controller], color=colour, ms=4.5, alpha=0.75, label=name)
        panel.axhline(1e3 * LIMIT, color=theme["alarm"], lw=1.2, ls="--", label=f"{1e3 * LIMIT:g} nm")
        style.logarithmic(panel, "xy")
        panel.set(title="Each run", xlabel="true rmse, second half (nm)", ylabel="largest error that counts (nm)")
        style.legend_above(panel)
    return figure


def trace(row: Row, recording: Recording, theme: Theme = LIGHT) -> Figure:
    """Motion and error of one run, in full and around its largest error."""
    found = next(iter(row.metrics.values()))
    highest, at = (float(found[name] or 0.0) for name in ("largest", "largest_at"))
    change = change_time(recording)
    time, desired = recording["time"], recording["desired"]
    error = 1e3 * (recording["true"] - desired)
    near = np.abs(time - at) < 0.15
    with style.use(theme):
        figure, panels = style.panels(4.2, 2, 2, sharex="col")
        for column, part in enumerate((time >= START, near)):
            above, below = panels[column], panels[2 + column]
            above.plot(*style.thin(time[part], desired[part]), color=theme["true"], lw=1.0)
            below.plot(*style.thin(time[part], error[part]), color=theme["true"], lw=0.9)
            below.set_xlabel("time (s)")
            if change is not None and time[part][0] < change < time[part][-1]:
                below.axvline(change, color=theme["before"], lw=1.0, ls="--", label="change")
                below.legend(loc="upper right")
        limit = 1.3e3 * highest
        for panel, part in zip(panels[2:], (time >= START, near), strict=True):
            style.zero(panel, theme)
            panel.set_ylim(-limit, limit)
            _mark_off_scale(panel, time[part], error[part], limit, theme)
        panels[0].set(title=f"Run {row.number}, the worst: {row.sampled['motion']}", ylabel="desired (µm)")
        panels[1].set(title="Around its largest error")
        panels[2].set(ylabel="true error (nm)")
    return figure


def _mark_off_scale(panel: Axes, time: FloatArray, error: FloatArray, limit: float, theme: Theme) -> None:
    """A triangle at the edge where the error leaves the panel, and how far it goes, um."""
    beyond = np.abs(error) > limit
    if not beyond.any():
        return
    peak = int(np.argmax(np.abs(error)))
    side = 1 if error[peak] > 0 else -1
    place = float(time[peak]), side * 0.95 * limit
    panel.plot(*place, "^" if side > 0 else "v", color=theme["wrong"], ms=6, zorder=4)
    style.note(panel, f"off scale: {1e-3 * error[peak]:.2f} µm", place, theme, color=theme["wrong"])
