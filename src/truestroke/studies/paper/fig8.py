"""Fig. 8: a typical convergence of the weights."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from truestroke.plant import MatchedSettings
from truestroke.report import plots, style
from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row


def reproduce() -> Reproduction:
    """The weights that the first wave ends with beside the published ones of the plant (Sec. 4.3)."""
    plant = MatchedSettings()
    runs = [bench.simulated_run(seed) for seed in bench.SEEDS]
    a, b = bench.adapted(runs[0])
    deviations = [np.abs(bench.adapted(run) - np.array([plant.a, plant.b])).max() for run in runs]
    rows = (
        *(Row(f"a{i}", paper, ours, "um/V") for i, (paper, ours) in enumerate(zip(plant.a, a, strict=True))),
        *(Row(f"b{i}", paper, ours, "um/V") for i, (paper, ours) in enumerate(zip(plant.b, b, strict=True))),
        Row("largest deviation, 5 waves", None, max(deviations), "um/V"),
        *(
            Row(
                f"first {n} partial slopes within 5 %",
                None,
                bench.mean([bench.settling_time(r, n) for r in runs]),
                "s",
                2,
            )
            for n in (5, 8)
        ),
    )
    sentence = (
        "The weights are those of the plant, to within what 50 nm of noise leaves open; on two of the five waves the "
        "last partial slopes wait for the first fall that is long enough to bring play 4 or 5 back."
    )
    return Reproduction("fig8", "Fig. 8: simulation, convergence of the weights", rows, sentence, lambda t: draw(t))


def draw(theme: style.Theme) -> Figure:
    """Five seconds; the plant's own weights are dashed."""
    plant = MatchedSettings()
    figure = plots.weights(bench.between(bench.simulated_run(bench.SEEDS[0]), 0, 5), theme)
    for panel, weights in zip(figure.axes, (plant.a, plant.b), strict=True):
        for weight, colour in zip(weights, theme.series, strict=True):
            panel.axhline(weight, color=colour, lw=0.8, ls=(0, (2, 3)))
    with style.use(theme):
        style.title(figure.axes[0], "Dotted: the weights of the plant")
    return figure
