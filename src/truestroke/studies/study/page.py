"""Tables, pictures and page of a study."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

import truestroke
from truestroke.report import style
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme
from truestroke.studies.engine import Row
from truestroke.studies.study.config import METRICS, Study
from truestroke.studies.study.summary import Line, informative, judge, lines

SHOWN = 5  # sampled numbers, the most informative
CELLS = (22, 12)  # of the map
UNLIKE = 0.5  # largest correlation of two numbers that are not the same
FAINT = 0.3  # opacity of a cell in which hardly any run failed
CAPTIONS = {
    "times": (
        "How soon",
        "Part of all runs that have converged by then. The line ends where all others have failed.",
    ),
    "failures": (
        "Where it fails",
        "The runs in cells of the two sampled numbers that are most informative about failure: the deeper the colour, "
        "the larger the share that did not converge. There is no run where there is no cell.",
    ),
}

Cells = tuple[list[str], list[list[str]]]


def shares(study: Study, rows: Sequence[Row]) -> Cells:
    """Columns and rows, as text: who converged, how often, how soon."""
    columns = ["controller", "runs", "converged", "%", "95 % interval", "time, s: median", "95 %", "longest"]
    return columns, [_share(line) for line in lines(study, rows)]


def _share(line: Line) -> list[str]:
    interval = f"{100 * line.low:.2f} to {100 * line.high:.2f}"
    time = [f"{value:.2f}" for value in line.time] if line.time else ["", "", ""]
    return [line.controller, str(line.runs), str(line.converged), f"{100 * line.share:.2f}", interval, *time]


def recorded(study: Study, rows: Sequence[Row]) -> Cells:
    """Columns and rows, as text: quantiles of what was recorded, over all runs."""
    found = []
    for name in study.record:
        metric = METRICS[name]
        for line in lines(study, rows):
            values = [f"{value:.4f}" for value in line.metrics[name]]
            found.append([f"{metric.words} ({metric.unit}), {line.controller}", *values])
    return ["over all runs", "median", "95 %", "largest"], found


def most_informative(study: Study, rows: Sequence[Row]) -> Cells:
    """Columns and rows, as text: what runs that fail have in common, controller by controller."""
    found = [
        [one.name, name, f"{one.higher:.2f}"]
        for name in study.controllers
        for one in informative(study, rows, name)[:SHOWN]
    ]
    return ["sampled number", "controller", "higher in a failed run"], found


def costs(runs: int, seconds: Mapping[str, float]) -> Cells:
    """Columns and rows, as text: time of the processor by part."""
    whole = sum(seconds.values()) or 1.0
    found = [
        [part, f"{spent:.1f}", f"{100 * spent / whole:.0f}", f"{1e3 * spent / runs:.2f}"]
        for part, spent in [*seconds.items(), ("all", whole)]
    ]
    return ["part", "core seconds", "%", "ms a run"], found


def result(study: Study, rows: Sequence[Row]) -> str:
    """Who converged how often, in a sentence."""
    parts = [
        f"{line.controller} in {100 * line.share:.2f} % ({100 * line.low:.2f} to {100 * line.high:.2f})"
        for line in lines(study, rows)
    ]
    return f"Of {len(rows)} runs converged: {'; '.join(parts)}."


def failures(failed: Sequence[Row]) -> str:
    """How many runs could not be simulated, and why the first of them; empty where all could."""
    if not failed:
        return ""
    runs = "run" if len(failed) == 1 else "runs"
    return f"{len(failed)} more {runs} could not be simulated, the first is run {failed[0].number}: {failed[0].error}."


def meaning(study: Study) -> str:
    """What converged means here."""
    within, level = study.converged.within, study.converged.level
    return (
        f"Converged: from some time of at most {within:g} s on, every 0.25 s has a true rms error of at most "
        f"{2e3 * level:g} nm. Intervals are exact binomial ones."
    )


def tables(study: Study, rows: Sequence[Row], cost: tuple[int, Mapping[str, float]]) -> list[tuple[Cells, str]]:
    """Each with a note, those with a row."""
    ticks, seconds = cost
    each = 1e9 * sum(seconds.values()) / ticks
    found = [
        (shares(study, rows), meaning(study)),
        (recorded(study, rows), "True displacement; the second half is that of the run."),
        (
            most_informative(study, rows),
            "Probability that the number is higher in a run that failed than in one that converged: 0.5 says nothing.",
        ),
        (costs(len(rows), seconds), f"{ticks / 1e6:.0f} million ticks of controller and plant, {each:.0f} ns each."),
    ]
    return [(table, note) for table, note in found if table[1]]


def page(
    study: Study,
    rows: Sequence[Row],
    cost: tuple[int, Mapping[str, float]],
    command: str = "",
    failed: Sequence[Row] = (),
) -> Page:
    """The page of a study; `command` is what repeats it."""
    found = [Table(columns=columns, rows=cells, note=note) for (columns, cells), note in tables(study, rows, cost)]
    return Page(
        title=study.title,
        lead=f"{result(study, rows)} {failures(failed)}".strip(),
        verdict=judge(study, rows, failed),
        sections=[Section(tables=found), *captioned(CAPTIONS)],
        plots=lambda theme: {"times": times(study, rows, theme), "failures": failure_map(study, rows, theme)},
        command=command,
        footer=f"truestroke {truestroke.__version__}, {len(rows)} of {study.runs} runs.",
    )


def times(study: Study, rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """Part of all runs that have converged after so many seconds."""
    with style.use(theme):
        figure, (panel,) = style.panels(2.9)
        within = study.converged.within
        for colour, name in zip(theme.series, study.controllers, strict=False):
            settled = [row.metrics[name]["convergence_time"] for row in rows if study.has_converged(row, name)]
            ascending = np.sort(np.array(settled, float))
            part = 100 * np.arange(1, ascending.size + 1) / len(rows)
            ends = np.append(ascending, within), np.append(part, part[-1] if part.size else 0.0)
            panel.step(*ends, where="post", color=colour, label=name, lw=1.5)
        panel.set(xlabel="time (s)", ylabel="runs that have converged (%)", ylim=(0, 101), xlim=(0, within))
        panel.set_xscale("symlog", linthresh=0.1)
        ticks = [t for t in (0, 0.1, 0.3, 1, 3, 10, 30, 100) if t <= within]
        panel.set_xticks(ticks, [f"{t:g}" for t in ticks])
        panel.set_xticks([], minor=True)
        style.legend_above(panel)
    return figure


def axes_of_map(study: Study, rows: Sequence[Row]) -> tuple[str, str]:
    """The most informative number, of the controller that fails most often, and the next that is not the same.

    Not the same: its correlation with the first is at most 0.5. Where none fails, what was sampled last counts.
    """
    most = max(study.controllers, key=lambda name: sum(not study.has_converged(row, name) for row in rows))
    names = [one.name for one in informative(study, rows, most)]
    names += [name for name in reversed(rows[0].sampled) if name not in names]
    first = [row.sampled[names[0]] for row in rows]
    for name in names[1:]:
        values = [row.sampled[name] for row in rows]
        if np.ptp(first) and np.ptp(values) and abs(np.corrcoef(first, values)[0, 1]) <= UNLIKE:
            return names[0], name
    return names[0], names[-1]


def failure_map(study: Study, rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """Share of the runs that failed, over two sampled numbers, a panel for each controller."""
    x_name, y_name = axes_of_map(study, rows)
    x, y = (np.array([row.sampled[name] for row in rows]) for name in (x_name, y_name))
    with style.use(theme):
        figure, panels = style.panels(3.3, 1, len(study.controllers), sharex=True, sharey=True)
        for panel, name in zip(panels, study.controllers, strict=True):
            failed = np.array([not study.has_converged(row, name) for row in rows])
            _cells(panel, x, y, failed, theme)
            panel.set_xlabel(_label(x_name))
            panel.set_title(f"{name}: {np.sum(failed)} of {len(rows)} failed")
        panels[0].set_ylabel(_label(y_name))
        shares = [Patch(fc=theme["grid"], label="none failed")]
        shares += [Patch(fc=theme["alarm"], alpha=_opacity(s), label=f"{100 * s:.0f} %") for s in (0.1, 0.5, 1.0)]
        figure.legend(handles=shares, loc="outside lower center", ncols=4, handlelength=1.2)
    return figure


def _cells(panel: Axes, x: np.ndarray, y: np.ndarray, failed: np.ndarray, theme: Theme) -> None:
    edges = [np.linspace(v.min(), v.max() + 1e-9 * (1 + np.ptp(v)), n + 1) for v, n in zip((x, y), CELLS, strict=True)]
    runs = np.histogram2d(x, y, edges)[0]
    bad = np.histogram2d(x[failed], y[failed], edges)[0]
    width, height = (float(e[1] - e[0]) for e in edges)
    for i, j in zip(*np.nonzero(runs), strict=True):
        share = bad[i, j] / runs[i, j]
        look = {"fc": theme["alarm"], "alpha": _opacity(share)} if share else {"fc": theme["grid"]}
        panel.add_patch(Rectangle((edges[0][i], edges[1][j]), 0.92 * width, 0.9 * height, lw=0, **look))
    panel.grid(visible=False)
    panel.set(xlim=(edges[0][0], edges[0][-1]), ylim=(edges[1][0], edges[1][-1]))


def _opacity(share: float) -> float:
    return FAINT + (1 - FAINT) * share


def _label(name: str) -> str:
    units = {"peak speed": "µm/s", "noise": "µm", "peak to peak": "µm", "velocity limit": "µm/s", "cutoff": "Hz"}
    unit = units.get(name, "µm/V" if name[:2] in ("a_", "b_") else "")
    return f"{name} ({unit})" if unit else name
