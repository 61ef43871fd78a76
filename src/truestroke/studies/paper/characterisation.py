"""Fig. 4: the weights against velocity, by the procedure of Sec. 2.4."""

from __future__ import annotations

from functools import cache

import numpy as np
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.plant import MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant
from truestroke.report import style
from truestroke.studies.characterisation import Characterisation, characterise, sweep
from truestroke.studies.characterisation.page import name_weights, plot_lines, plot_points
from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row

STROKE = 38.0  # um: all that the stack has, so that all eight plays move


def found_on(plant: MatchedPlant | RealisticPlant) -> Characterisation:
    """The procedure as Sec. 2.4 has it: the paper's thresholds, weights and nothing else."""
    limits, thresholds = bench.SETTINGS.voltage_limits, bench.SETTINGS.thresholds
    return characterise(plant, stroke=STROKE, voltage_limits=limits, thresholds=thresholds, offset=False)


@cache
def matched() -> Characterisation:
    """The plant (13) with the published weights, whose lines are known."""
    return found_on(MatchedPlant(sweep(stroke=STROKE).velocity))


@cache
def realistic(settings: PlantSettings = PlantSettings()) -> Characterisation:  # noqa: B008 (it is frozen)
    """The realistic plant."""
    return found_on(RealisticPlant(settings))


def branch(found: Characterisation, sign: int) -> tuple[FloatArray, FloatArray]:
    """Lines a, b through the rising (1) or the falling (-1) branches alone, um/V."""
    there = found.velocities * sign > 0
    columns = np.column_stack([np.ones(there.sum()), bench.SETTINGS.rate_scale * found.velocities[there]])
    a, b = np.linalg.lstsq(columns, found.weights[there], rcond=None)[0]
    return a, b


def fig4() -> Reproduction:
    """Lines through both directions of the matched plant, where the truth is known, and the realistic plant's."""
    plant, found = MatchedSettings(), matched()
    rising, falling = branch(realistic(), 1), branch(realistic(), -1)
    truth = [*((f"a{i}", x, y) for i, (x, y) in enumerate(zip(plant.a, found.a, strict=True)))]
    truth += [*((f"b{i}", x, y) for i, (x, y) in enumerate(zip(plant.b, found.b, strict=True)))]
    rows = (
        *(Row(f"{name}, matched plant", paper, ours, "um/V") for name, paper, ours in truth),
        *(Row(f"b{i}, realistic plant, rising", None, x, "um/V", 2) for i, x in enumerate(rising[1])),
        Row("a0, realistic plant, rising", None, rising[0][0], "um/V", 2),
        Row("a0, realistic plant, falling", None, falling[0][0], "um/V", 2),
    )
    sentence = (
        "Fig. 4 is of another stack and prints no number, so the procedure is tried where the lines are known, and "
        "finds them; on the realistic plant they do not have the published slopes, because its rate dependence is lag "
        "and creep, and rising and falling branches differ at rest, in contrast to (7), because of asymmetry and "
        "creep."
    )
    return Reproduction("fig4", "Fig. 4: weights against velocity", rows, sentence, _plot)


def _plot(theme: style.Theme) -> Figure:
    """Weight 0 above, the others below; left the matched plant with its known lines, right the realistic one."""
    plant = MatchedSettings()
    with style.use(theme):
        figure, axes = style.panels(5.2, 2, 2, sharex=True, height_ratios=[1, 2])
        for column, found in enumerate((matched(), realistic())):
            panels = [axes[column], axes[column + 2]]
            plot_points(panels, found, theme)
            for sign in (-1, 1):
                a, b = branch(found, sign) if column else (np.array(plant.a), np.array(plant.b))
                plot_lines(panels, np.array([0.0, sign * found.velocities.max()]), a, b, theme)
            name_weights(panels, found.weights[-1])
            panels[1].set_xlabel("desired velocity (µm/s)")
        axes[0].set_title("Matched plant; lines: its own weights (7)")
        axes[1].set_title("Realistic plant; lines: best fit of each branch")
        for panel in (axes[0], axes[2]):
            panel.set_ylabel("weights (µm/V)")
    return figure
