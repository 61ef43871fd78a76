"""Tables and page of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import truestroke
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.studies.engine import Row
from truestroke.studies.study import plots
from truestroke.studies.study.config import Study
from truestroke.studies.study.metrics import METRICS
from truestroke.studies.study.summary import Line, informative, judge, lines

SHOWN = 5  # sampled numbers, the most informative
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
        plots=lambda theme: plots.plots(study, rows, theme),
        command=command,
        footer=f"truestroke {truestroke.__version__}, {len(rows)} of {study.runs} runs.",
    )
