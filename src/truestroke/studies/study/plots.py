"""How soon the runs of a study converge, and the map of where they do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from truestroke.report import style
from truestroke.report.style import LIGHT, Theme
from truestroke.studies.engine import Row
from truestroke.studies.study.config import Study
from truestroke.studies.study.summary import informative

CELLS = (22, 12)  # of the map
UNLIKE = 0.5  # largest correlation of two numbers that are not the same
FAINT = 0.3  # opacity of a cell in which hardly any run failed


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


def failures(study: Study, rows: Sequence[Row], theme: Theme = LIGHT) -> Figure:
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


def plots(study: Study, rows: Sequence[Row], theme: Theme = LIGHT) -> dict[str, Figure]:
    """Both by name."""
    return {"times": times(study, rows, theme), "failures": failures(study, rows, theme)}
