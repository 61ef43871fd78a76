"""Plots: weights against velocity as in Fig. 4, and the loops at each speed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.report import style
from truestroke.report.style import Theme
from truestroke.studies.characterisation.lines import RATE_SCALE, Characterisation


def plots(found: Characterisation, theme: Theme) -> dict[str, Figure]:
    """All of them by name, in the order of the page."""
    return {"weights": weights(found, theme), "loops": loops(found, theme)}


def weights(found: Characterisation, theme: Theme) -> Figure:
    """Fig. 4: weight 0 above, the others below, with their lines."""
    with style.use(theme):
        figure, panels = style.panels(5.4, 2, sharex=True, height_ratios=[1, 2])
        ends = np.array([-1.0, 1.0]) * np.abs(found.velocities).max()
        plot_points(panels, found, theme)
        plot_lines(panels, ends, found.a, found.b, theme)
        name_weights(panels, found.a + RATE_SCALE * ends[1] * found.b)
        panels[0].set(ylabel="weights (µm/V)")
        panels[1].set(ylabel="weights (µm/V)", xlabel="desired velocity (µm/s)")
    return figure


def plot_points(panels: list[Axes], found: Characterisation, theme: Theme) -> None:
    """Means with twice their standard error; hollow where the speed was not followed."""
    errors = 2 * found.deviations / np.sqrt(np.maximum(found.passes, 1))[:, None]
    for i in range(found.thresholds.size):
        for kept, face in ((found.converged, None), (~found.converged, "none")):
            x, y, bar = found.velocities[kept], found.weights[kept, i], np.nan_to_num(errors[kept, i])
            look: dict[str, Any] = {"color": _colour(theme, i), "mfc": face, "fmt": "o", "ms": 3.5}
            look |= {"elinewidth": 0.8, "capsize": 1.5, "label": None if face else f"$w_{{{i}}}$"}
            panels[i > 0].errorbar(x, y, bar, **look)


def plot_lines(panels: list[Axes], ends: FloatArray, a: FloatArray, b: FloatArray, theme: Theme) -> None:
    """The lines (7) between two velocities, um/s."""
    for i in range(a.size):
        panels[i > 0].plot(ends, a[i] + RATE_SCALE * ends * b[i], color=_colour(theme, i), lw=1.0)


def name_weights(panels: list[Axes], ends: FloatArray) -> None:
    """The name of each weight at the right, in the order in which they end, um/V."""
    style.legend_right(panels[0], ends[:1])
    style.legend_right(panels[1], ends[1:])


def loops(found: Characterisation, theme: Theme) -> Figure:
    """The last loop of each speed, and what it is beyond one straight line."""
    volts, measured = found.recording["volts"], found.recording["measured"]
    velocity = found.recording["desired_velocity"]
    line = np.polynomial.Polynomial.fit(volts[there := np.isfinite(measured)], measured[there], 1)
    with style.use(theme):
        figure, (above, below) = style.panels(5.4, 2, sharex=True, height_ratios=[1.2, 1])
        for i, speed in enumerate(found.velocities[found.velocities > 0]):
            last = np.flatnonzero(np.abs(velocity) == speed)[-round(found.cycle(speed)) :]
            for panel, z in ((above, measured[last]), (below, measured[last] - line(volts[last]))):
                panel.plot(volts[last], z, color=_colour(theme, i), lw=0.9, label=f"{speed:g}")
        above.set(title="Speeds (µm/s)", ylabel="displacement (µm)")
        below.set(ylabel="beyond a straight line (µm)", xlabel="voltage (V)")
        style.legend_above(above)
    return figure


def _colour(theme: Theme, i: int) -> str:
    return theme.series[i % len(theme.series)]
