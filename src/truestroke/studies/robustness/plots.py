"""How the errors of a robustness study are distributed, the largest of each run, and the worst run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.report import style
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.judgement import change_time
from truestroke.signals.recording import Recording
from truestroke.studies.engine import Row
from truestroke.studies.robustness.metrics import START
from truestroke.studies.robustness.table import LIMIT, NAMES, values

ROLES = {"adaptive": "true", "paper": "before"}
PANELS = {
    "rmse": "rmse, second half",
    "after_change": "0.1 to 0.5 s after a change",
    "cold": "0.75 to 1 s from a cold start",
}


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
        panel.axhline(1e3 * LIMIT, color=theme["alarm"], lw=1.2, ls="--", label=f"{LIMIT:g} µm")
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


def plots(rows: Sequence[Row], worst: Row, recording: Recording, theme: Theme = LIGHT) -> dict[str, Figure]:
    """All three by name; `recording` is that of the worst run with the first controller."""
    return {
        "distribution": distribution(rows, theme),
        "largest": largest(rows, theme),
        "worst": trace(worst, recording, theme),
    }
