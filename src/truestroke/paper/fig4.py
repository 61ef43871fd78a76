"""Fig. 4: the weights against velocity, by the procedure of Sec. 2.4."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke._typing import FloatArray
from truestroke.controller import AdaptiveController
from truestroke.loop import Actuator, run
from truestroke.paper import bench
from truestroke.paper.reproduction import Reproduction, Row
from truestroke.plant import MatchedPlant, MatchedSettings, RealisticPlant
from truestroke.report import style
from truestroke.trajectories import Trajectory, triangle

SPEEDS = (50.0, 100.0, 150.0, 200.0, 250.0, 300.0)  # um/s
STROKE = 38.0  # um: all that the stack has, so that all eight plays move
DURATION = 8.0  # s, five cycles of the slowest triangle
C_B = bench.SETTINGS.rate_scale


class OneWay:
    """The adaptive inverse of [20], which knows no rate, adapting while the desired velocity has one sign.

    The weights (7) of a rising and of a falling branch differ, but a controller without rate has only one set.

    Parameters
    ----------
    sign : float
        1 to adapt while it rises, -1 while it falls.
    """

    def __init__(self, sign: float) -> None:
        self.controller = AdaptiveController.from_settings(dataclasses.replace(bench.SETTINGS, rate_scale=0.0))
        self.sign = sign

    def command(self, z_d: float, zdot_d: float) -> float:
        """Of the inverse; adaptation is on hold in the other direction."""
        if self.sign * zdot_d > 0:
            self.controller.resume()
        else:
            self.controller.hold()
        return self.controller.command(z_d, zdot_d)

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Learn, unless on hold."""
        self.controller.adapt(z_measured, ago)


def converged_weights(actuator_for: Callable[[Trajectory], Actuator], velocity: float) -> FloatArray:
    """Weights of the plays at one velocity.

    Parameters
    ----------
    actuator_for : callable
        Gives the actuator for a trajectory.
    velocity : float
        Slope of the branches that are learned, um/s: above 0 the rising, below 0 the falling ones.

    Returns
    -------
    ndarray, shape (8,)
        After 8 s of the triangle, um/V.
    """
    wave = triangle(speed=abs(velocity), peak_to_peak=STROKE, duration=DURATION, ramp=0.0)
    one_way = OneWay(np.sign(velocity))
    run(wave, one_way, actuator_for(wave))
    return one_way.controller.weights[0::2]


def line(velocities: Sequence[float], weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best-fit lines (7) in the scale of the published weights, w_i = a_i + c_b zdot b_i.

    Parameters
    ----------
    velocities : sequence of float
        um/s.
    weights : ndarray, shape (velocities, plays)
        um/V.

    Returns
    -------
    a, b : ndarray, shape (plays,)
        um/V.
    """
    columns = np.column_stack([np.ones(len(velocities)), C_B * np.asarray(velocities)])
    a, b = np.linalg.lstsq(columns, weights, rcond=None)[0]
    return a, b


def matched(wave: Trajectory) -> Actuator:
    """The plant (13) with the published weights, whose lines are known."""
    return MatchedPlant(wave.velocity)


def realistic(wave: Trajectory) -> Actuator:
    """The realistic plant."""
    return RealisticPlant()


@cache
def branches(actuator_for: Callable[[Trajectory], Actuator]) -> dict[float, FloatArray]:
    """Weights at all velocities, rising and falling, um/V by um/s."""
    velocities = [sign * speed for sign in (-1, 1) for speed in SPEEDS]
    return {v: converged_weights(actuator_for, v) for v in velocities}


def fitted(weights: dict[float, FloatArray], sign: int = 0) -> tuple[FloatArray, FloatArray]:
    """Lines through the rising (1) or the falling (-1) branches, or through both (0)."""
    kept = [v for v in weights if v * sign >= 0]
    return line(kept, np.array([weights[v] for v in kept]))


def reproduce() -> Reproduction:
    """Lines through both directions of the matched plant, where the truth is known, and the realistic plant's."""
    plant = MatchedSettings()
    a, b = fitted(branches(matched))
    rising, falling = fitted(branches(realistic), 1), fitted(branches(realistic), -1)
    truth = [*((f"a{i}", x, y) for i, (x, y) in enumerate(zip(plant.a, a, strict=True)))]
    truth += [*((f"b{i}", x, y) for i, (x, y) in enumerate(zip(plant.b, b, strict=True)))]
    rows = (
        *(Row(f"{name}, matched plant", paper, ours, "um/V") for name, paper, ours in truth),
        *(Row(f"b{i}, realistic plant, rising", None, x, "um/V", 2) for i, x in enumerate(rising[1])),
        Row("a0, realistic plant, rising", None, rising[0][0], "um/V", 2),
        Row("a0, realistic plant, falling", None, falling[0][0], "um/V", 2),
    )
    sentence = (
        "Fig. 4 is of another stack and prints no number, so the procedure is tried where the lines are known, and "
        "finds them; on the realistic plant the first weights of the rising branches lean as the published ones do, "
        "but rising and falling branches do not meet at rest as (7) has it, because the asymmetry bends them apart "
        "and creep adds to it."
    )
    return Reproduction("fig4", "Fig. 4: weights against velocity", rows, sentence, draw)


def draw(theme: style.Theme) -> Figure:
    """Weight 0 above, the others below; left the matched plant with its known lines, right the realistic one."""
    plant = MatchedSettings()
    known = np.array(plant.a), np.array(plant.b)
    with style.use(theme):
        figure, axes = style.panels(5.2, 2, 2, sharex=True, height_ratios=[1, 2])
        for column, actuator_for in enumerate((matched, realistic)):
            weights = branches(actuator_for)
            for sign in (-1, 1):
                lines = known if actuator_for is matched else fitted(weights, sign)
                _draw_branch(axes[column], axes[column + 2], weights, sign, lines, theme)
            axes[column + 2].set_xlabel("desired velocity (µm/s)")
            ends = weights[SPEEDS[-1]]
            _name_ends(axes[column], ends[:1], 0, theme)
            _name_ends(axes[column + 2], ends[1:], 1, theme)
        style.title(axes[0], "Matched plant; lines: its own weights (7)")
        style.title(axes[1], "Realistic plant; lines: best fit of each branch")
        for panel in (axes[0], axes[2]):
            panel.set_ylabel("weights (µm/V)")
    return figure


def _draw_branch(
    top: Axes,
    rest: Axes,
    weights: dict[float, FloatArray],
    sign: int,
    lines: tuple[FloatArray, FloatArray],
    theme: style.Theme,
) -> None:
    velocities = np.array([v for v in weights if v * sign > 0])
    ends = np.array([0.0, sign * SPEEDS[-1]])
    for i, colour in enumerate(theme.series):
        panel = top if i == 0 else rest
        panel.plot(velocities, [weights[v][i] for v in velocities], "o", color=colour, ms=3.5)
        panel.plot(ends, lines[0][i] + C_B * ends * lines[1][i], color=colour, lw=1.0)


def _name_ends(panel: Axes, ends: FloatArray, first: int, theme: style.Theme) -> None:
    low, high = panel.get_ylim()
    for i, y in enumerate(style.spread(ends, 0.06 * (high - low), low, high), first):
        colour = theme.series[i]
        panel.text(1.02, y, f"$w_{i}$", transform=panel.get_yaxis_transform(), color=colour, fontsize=8, va="center")
