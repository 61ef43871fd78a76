"""Pictures and page of the costs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from benchmarks.bench import table
from benchmarks.bench.cost import Cost
from matplotlib.figure import Figure

from truestroke.report import style
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme

CAPTIONS = {
    "updates": (
        "The same recursive least squares",
        "One update of 16 parameters, from the best window of steps (dot) to the 99.9th percentile of single steps "
        "(bar). On a machine with other load the percentile includes it. Mind the scale.",
    ),
    "ticks": (
        "A tick of the controller",
        "Command and adapt against the number of plays, best window of steps, double.",
    ),
}
NOTE = (
    "best: mean of the best window of steps, which is what ratios are made of; median, 99.9 % and worst: of single "
    "steps, less what reading the clock takes. Seconds do not repeat on shared machines; ratios of one run do."
)
WAYS = {"C": "o", "Python, blocks of 1000": "s", "Python, step by step": "D"}


def updates(costs: Sequence[Cost], theme: Theme = LIGHT) -> Figure:
    """Each update as a bar from its best window to its 99.9th percentile."""
    found = [c for c in table.updates(costs) if c.precision == "double"]
    names = [
        "limit of the machine" if c.what == "limit" else ", ".join(filter(None, (c.name, c.variant))) for c in found
    ]
    with style.use(theme):
        figure, (panel,) = style.panels(0.9 + 0.3 * len(found))
        for place, c in enumerate(found):
            own = c.way == "C" and c.what == "update"
            colour = theme["true"] if own else theme["muted"] if c.what == "limit" else theme["before"]
            panel.hlines(place, c.best_ns, max(c.p999_ns, c.best_ns), color=theme["desired"], lw=2, zorder=2)
            panel.plot(c.best_ns, place, "o", color=colour, ms=7, zorder=3)
            panel.annotate(f"{c.best_ns:.0f}", (c.best_ns, place), (0, 4), textcoords="offset points", ha="center",
                           va="bottom", fontsize=8, color=theme["text"])  # fmt: skip
        style.logarithmic(panel, "x")
        panel.set(xlabel="one update (ns)", yticks=range(len(names)), yticklabels=names)
        panel.set_xlim(left=min((c.best_ns for c in found), default=1.0) / 3)
        panel.invert_yaxis()
        panel.grid(axis="y", visible=False)
    return figure


def ticks(costs: Sequence[Cost], theme: Theme = LIGHT) -> Figure:
    """Cost of a tick against plays, a panel for each law."""
    with style.use(theme):
        figure, panels = style.panels(3.2, 1, 2, sharey=True)
        for panel, law in zip(panels, ("paper", "default"), strict=True):
            for colour, (way, marker) in zip(theme.series, WAYS.items(), strict=False):
                found = [c for c in _fastest(costs) if (c.what, c.name, c.way) == ("tick", law, way)]
                found.sort(key=lambda c: c.plays)
                if found:
                    xs, ys = [c.plays for c in found], [c.best_ns for c in found]
                    panel.plot(xs, ys, marker=marker, ms=4.5, lw=1.4, color=colour, label=way)
            style.logarithmic(panel, "y")
            panel.set(title=law, xlabel="plays")
        panels[0].set(ylabel="one tick (ns)", yticks=[50, 100, 200, 500, 1000, 2000])
        panels[1].legend(loc="lower right")
    return figure


def _fastest(costs: Sequence[Cost]) -> list[Cost]:
    """Of the variants in C, the fastest alone; double."""
    own = table.reference(costs)
    return [c for c in costs if c.precision == "double" and c.variant in ("", own.variant if own else "")]


def pictures(costs: Sequence[Cost], theme: Theme = LIGHT) -> dict[str, Figure]:
    """Both by name."""
    return {"updates": updates(costs, theme), "ticks": ticks(costs, theme)}


def page(costs: Sequence[Cost], missing: Sequence[str], command: str | None = None) -> Page:
    """The page of the costs; `missing` says what could not be measured, `command` is what repeats it."""
    notes = [NOTE, " ".join(["Not measured.", *missing]) if missing else NOTE]
    tables = (table.update_table(costs), table.tick_table(costs), table.axes_table(costs))
    found = zip(tables, [*notes, ""], strict=True)
    return Page(
        title="What a step costs",
        lead=table.verdict(costs),
        sections=[
            Section(tables=[Table(columns=columns, rows=rows, note=note) for (columns, rows), note in found]),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: pictures(costs, theme),
        command=command,
        footer=f"{table.machine()} · made {datetime.now(UTC).isoformat(timespec='seconds')}",
    )
