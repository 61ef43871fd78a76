"""Table, pictures and page of the fast half of a robustness study."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from truestroke.report import style, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.recording import Recording
from truestroke.studies.engine import Row
from truestroke.studies.robustness.fast.table import (
    HELD,
    SETTLED,
    START,
    Result,
    given_to,
    judge,
    lines_of,
    of_line,
    results,
)

SHOWN = 8  # runs with the largest errors
PERIODS = 8  # of f0 on each side of the largest error, in its picture
MARKERS = "os^D"
CAPTIONS = {
    "distribution": (
        "How the errors are distributed",
        "Part of the runs whose true rms is at most so much. Further left is better, and steeper: the same for every "
        "stage.",
    ),
    "baselines": (
        "Beside the better of two baselines",
        "A straight line through the same stage, and the same controller that learned on a slow wave and is held. "
        "Above the diagonal a run has failed: not to learn would have been better.",
    ),
    "worst": (
        "The run with the largest error",
        "Its motion and its error, around that error and in full. Both are parts of the peak-to-peak value.",
    ),
}
NOTE = (
    "True displacement, % of the peak-to-peak value of the motion: median / 95th percentile / worst. rms and maximum "
    f"are of the second half, the largest error is anywhere but in the first {START:g} s; the {SETTLED:g} s after a "
    "jump of f0 are in neither."
)
FAILED = (
    f"A run has failed where its rms is larger than that of the straight line, or {HELD:g} times that of the held "
    "controller."
)

Cells = tuple[list[str], list[list[str]]]


def three(values: tuple[float, float, float]) -> str:
    """Median, 95th percentile and worst, as text."""
    return " / ".join(f"{value:.3g}" if value < 1000 else f"{value:.0f}" for value in values)


def table(rows: Sequence[Row]) -> Cells:
    """Columns and rows of the table of the errors, as text."""

    def cells(one: Result) -> list[str]:
        goal = three(one.goal) if one.goal else ""
        return [one.name, str(one.runs), three(one.rms), goal, three(one.maximum), three(one.largest)]

    columns = ["% of peak to peak", "runs", "rms", "goal", "maximum", "largest"]
    return columns, [cells(one) for one in results(rows)]


def compared(rows: Sequence[Row]) -> Cells:
    """Columns and rows of the table of the baselines, as text."""
    columns = ["% rms of peak to peak", "controller", "straight line", "held", "failed"]
    return columns, [
        [one.name, three(one.rms), three(one.straight), three(one.held), str(len(one.failed))] for one in results(rows)
    ]


def worst_first(rows: Sequence[Row]) -> list[tuple[Row, str]]:
    """Runs and controllers by their rms, the largest first."""
    every = [(row, name) for row in rows for name in row.metrics]
    return sorted(every, key=lambda one: -float(one[0].metrics[one[1]]["rms"] or 0.0))


def worst_runs(rows: Sequence[Row]) -> Cells:
    """Columns and rows of the runs with the largest errors, as text."""
    cells = []
    for row, name in worst_first(rows)[:SHOWN]:
        found = row.metrics[name]
        numbers = [f"{found[key]:.3g}" for key in ("rms", "largest", "straight", "held")]
        cells.append([row.sampled["what"], name, str(row.number), *numbers])
    return ["the worst runs, % of peak to peak", "dynamics", "run", "rms", "largest", "straight line", "held"], cells


def page(rows: Sequence[Row], worst: tuple[Row, str], recording: Recording, command: str | None = None) -> Page:
    """The page; `recording` is of the run and controller `worst`; `command` repeats it."""
    (columns, cells), (beside_columns, beside), (worst_columns, worst_cells) = (
        made(rows) for made in (table, compared, worst_runs)
    )
    found = Table(columns=columns, rows=cells, note=NOTE)
    baselines_beside = Table(columns=beside_columns, rows=beside, note=FAILED)
    largest = Table(columns=worst_columns, rows=worst_cells)
    lead = f"{len(rows)} stages with a first resonance f0 of 50 to 2000 Hz. "
    lead += "Motions have contents to f0/2, to f0/3 where the dynamics are unknown."
    return Page(
        title=f"{len(rows)} fast stages, sampled at random",
        lead=lead,
        verdict=judge(rows),
        sections=[Section(tables=[found, baselines_beside, largest]), *captioned(CAPTIONS)],
        plots=lambda theme: {
            "distribution": distribution(rows, theme),
            "baselines": baselines([row for row in rows if not row.error], theme),
            "worst": trace(*worst, recording, theme),
        },
        command=command,
        footer=words.footer(recording),
    )


def distribution(rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """Part of the runs whose rms is at most so much, a line of the table a curve; a bar is its worst goal."""
    with style.use(theme):
        figure, (panel,) = style.panels(3.2)
        for i, line in enumerate(lines_of(given_to(rows))):
            ascending = np.sort([found["rms"] for _, found in of_line(line, rows)])
            if not ascending.size:
                continue
            part = 100 * np.arange(ascending.size + 1) / ascending.size
            panel.step(
                np.append(ascending[0], ascending), part, where="post", color=theme.series[i], label=line.name, lw=1.4
            )
            if line.goal:
                panel.plot(line.goal[2], 97 - 3 * i, "|", color=theme.series[i], ms=9, mew=2)
        style.logarithmic(panel, "x")
        panel.set(title="Runs", xlabel="true rms (% of peak to peak); bars: goals", ylabel="with at most that (%)")
        panel.legend(loc="lower right")
    return figure


def baselines(rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """The rms of each run against that of the better baseline, both logarithmic."""
    with style.use(theme):
        figure, (panel,) = style.panels(3.6)
        reached: list[float] = []
        for i, name in enumerate(rows[0].metrics):
            found = [row.metrics[name] for row in rows]
            best = [min(float(m["straight"] or 0), HELD * float(m["held"] or 0)) for m in found]
            rms = [float(m["rms"] or 0) for m in found]
            label = f"dynamics {name}"
            panel.plot(best, rms, MARKERS[i], color=theme.series[i], ms=4.5, alpha=0.75, label=label)
            reached += best
        ends = min(reached), max(reached)
        panel.plot(ends, ends, color=theme["alarm"], lw=1.2, ls="--", label="failed above")
        style.logarithmic(panel, "xy")
        panel.set(title="Each run", xlabel="the better baseline (% rms)", ylabel="the controller (% rms)")
        style.legend_above(panel)
    return figure


def trace(row: Row, controller: str, recording: Recording, theme: Theme = LIGHT) -> Figure:
    """Motion and error of one run around its largest error, and its error in full, % of peak to peak."""
    at, percent = float(row.metrics[controller]["largest_at"] or 0.0), 100 / float(row.sampled["span"][controller])
    time, desired = recording["time"], percent * recording["desired"]
    error = percent * recording["true"] - desired
    near, later = np.abs(time - at) < PERIODS / row.sampled["f0"], time >= START
    what = f"dynamics {controller}"
    with style.use(theme):
        figure, (motion, detail, full) = style.panels(5.4, 3, 1)
        motion.plot(*style.thin(time[near], desired[near]), color=theme["desired"], lw=1.2)
        motion.set(title=f"Run {row.number}, {what}: {row.sampled['motion']}", ylabel="desired (%)")
        for panel, part in ((detail, near), (full, later)):
            panel.plot(*style.thin(time[part], error[part]), color=theme["true"], lw=0.9)
            style.zero(panel, theme)
            panel.set_ylabel("true error (%)")
        detail.sharex(motion)
        full.set_xlabel("time (s)")
    return figure
