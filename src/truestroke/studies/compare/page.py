"""Pictures and page of controllers compared on the same actuator and waves."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from truestroke.report import style, units, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.plots import displacement
from truestroke.report.style import LIGHT, Theme
from truestroke.studies.compare.rivals import Rival
from truestroke.studies.compare.table import Row, judge

SECONDS = 1.0  # of the end of a run that is plotted
DECADES, TICKS = 100.0, 20  # of errors, from which on only powers of ten have labels; labels, at most
CAPTIONS = {
    "errors": (
        "Errors",
        "Root mean square and largest error of each controller over the second half of each run; further left is "
        "better. Mind the scale, which is logarithmic.",
    ),
    "traces": (
        "Errors against time",
        "Displacement minus desired displacement in the last second of the first wave, all at one scale. Look at the "
        "shape: what follows the motion is hysteresis, what is fast is resonance, what stays is creep.",
    ),
}
NOTE = (
    "All errors are of the second half of a run; per cent are of the peak-to-peak value of the desired motion in that "
    "time. A positive delay or phase lag means that the actuator comes late."
)


def tables(rows: Sequence[Row]) -> list[tuple[list[str], list[list[str]]]]:
    """A table for each wave, as text: its columns, the first of which names wave and time, and its rows.

    Errors are true where the actuator is simulated, else measured.
    """
    result = []
    for wave in _waves(rows):
        of_wave = [row for row in rows if row.wave == wave]
        has_phase = of_wave[0].phase_lag_deg is not None
        columns = [f"{wave}, {words.span(of_wave[0].summary)}", "rmse", "of p-p", "maximum", "of p-p", "delay"]
        result.append((columns + ["phase lag"] * has_phase, [_cells(row) for row in of_wave]))
    return result


def _waves(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row.wave for row in rows))


def _cells(row: Row) -> list[str]:
    (rmse, rmse_share), (maximum, maximum_share) = (cells[-1] for _, cells in words.table(row.summary))
    lag = [] if row.phase_lag_deg is None else [f"{_signed(row.phase_lag_deg)}°"]
    errors = [f"{rmse} um", rmse_share, f"{maximum} um", maximum_share]
    return [row.controller, *errors, f"{_signed(row.delay_ms)} ms", *lag]


def _signed(value: float) -> str:
    return f"{round(value, 2) + 0.0:.2f}"  # -0.00 is 0.00


def _error(row: Row, name: str) -> float:
    """Of the true displacement where it is known, um."""
    return float(getattr(row.summary, f"{words.kinds(row.summary)[-1]}_{name}_um"))


def errors(rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """The rmse and maximum of each controller, a panel for each wave, on a logarithmic scale, nm."""
    waves, names = _waves(rows), list(dict.fromkeys(row.controller for row in rows))
    with style.use(theme):
        figure, panels = style.panels(1.1 + 0.3 * len(names), 1, len(waves), sharey=True, sharex=True)
        for panel, wave in zip(panels, waves, strict=True):
            of_wave = [row for row in rows if row.wave == wave]
            places = [names.index(row.controller) for row in of_wave]
            rmse, largest = (np.array([1e3 * _error(row, name) for row in of_wave]) for name in ("rmse", "maximum"))
            panel.hlines(places, rmse, largest, color=theme["desired"], lw=2, zorder=2)
            panel.plot(rmse, places, "o", color=theme["true"], ms=7, label="rmse", zorder=3)
            panel.plot(largest, places, "D", color=theme["before"], ms=5, label="maximum", zorder=3)
            style.logarithmic(panel, "x")
            panel.set(title=wave, xlabel="error (nm)")
            wide = panel.get_xlim()[1] > DECADES * panel.get_xlim()[0]
            panel.xaxis.set_major_locator(LogLocator(subs=(1,) if wide else (1, 3), numticks=TICKS))
            panel.grid(axis="y", visible=False)
        panels[0].set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.4, -0.6))
        style.legend_above(panels[-1])
    return figure


def traces(rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
    """The error of each controller in the last second of the first wave, all panels at one scale, nm."""
    first = [row for row in rows if row.wave == rows[0].wave]
    limit = 2e3 * float(np.median([_error(row, "maximum") for row in first]))
    with style.use(theme):
        height = -(-len(first) // 2)
        figure, panels = style.panels(0.8 + 1.05 * height, height, 2, sharex=True, sharey=True, squeeze=False)
        for panel, row in zip(panels, first, strict=False):
            _trace(panel, row, limit, theme)
        for panel in panels[len(first) :]:
            panel.set_visible(False)
        figure.supylabel("error (nm)", fontsize=9)
        for panel in panels[-2:]:
            panel.set_xlabel("time (s)")
    return figure


def _trace(panel: Axes, row: Row, limit: float, theme: Theme) -> None:
    time, desired = row.recording["time"], row.recording["desired"]
    _, actual = displacement(row.recording)
    part = time >= time[-1] - SECONDS
    error = 1e3 * (actual - desired)[part]
    style.zero(panel, theme)
    panel.plot(*style.thin(time[part], error), color=theme["true"], lw=0.9)
    beyond = ", off scale" if np.max(np.abs(error)) > limit else ""
    title = f"{row.controller}: {units.length(_error(row, 'rmse'))} rmse{beyond}"
    panel.set(title=title, xlim=(time[part][0], time[part][-1]), ylim=(-limit, limit))


def page(rows: Sequence[Row], rivals: Sequence[Rival], command: str | None = None) -> Page:
    """The page of a comparison, from what `compare` and `prepare` gave; `command` is what repeats it."""
    by_wave = [Table(columns=columns, rows=cells) for columns, cells in tables(rows)]
    made_ready = [(rival.name, rival.source, rival.tuning) for rival in rivals]
    return Page(
        title=f"{len(rivals)} controllers on the same actuator",
        lead=_lead(rows),
        verdict=judge(rows),
        sections=[
            Section(tables=[*by_wave[:-1], dataclasses.replace(by_wave[-1], note=NOTE)]),
            *captioned(CAPTIONS),
            Section(
                heading="Identification and tuning of each controller",
                tables=[Table(columns=["controller", "source", "tuning"], rows=made_ready, kind="words")],
            ),
        ],
        plots=lambda theme: {"errors": errors(rows, theme), "traces": traces(rows, theme)},
        command=command,
        footer=words.footer(rows[0].recording),
    )


def _lead(rows: Sequence[Row]) -> str:
    best: Mapping[str, Row] = {
        wave: min((row for row in rows if row.wave == wave), key=lambda row: _error(row, "rmse"))
        for wave in _waves(rows)
    }
    smallest = "; ".join(
        f"on the {wave} {row.controller}, {units.length(_error(row, 'rmse'))}" for wave, row in best.items()
    )
    kind = {"true": "true motion, without sensor noise", "measured": "reading of the sensor"}
    return f"Errors are {kind[words.kinds(rows[0].summary)[-1]]}. The smallest rmse: {smallest}."
