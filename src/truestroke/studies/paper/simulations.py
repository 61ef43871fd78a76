"""Figs. 6 to 8: the simulations of Sec. 4 on the plant (13); numbers are means over five waves."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from truestroke.plant import MatchedSettings
from truestroke.report import plots, style
from truestroke.signals.recording import Recording
from truestroke.studies.paper import bench
from truestroke.studies.paper.bench import window
from truestroke.studies.paper.reproduction import Reproduction, Row


def fig6() -> Reproduction:
    """The plant with the published weights."""
    runs = [bench.simulated_run(seed) for seed in bench.SEEDS]
    rows = (
        window(runs, 10, 20, digits=4),
        window(runs, 0.75, 1, channel="true", digits=4),
        window(runs, 10, 20, channel="true", digits=4),
        window(runs, 10, 20, "maximum", channel="true", digits=4),
    )
    sentence = (
        "The paper prints no number; ours is the 50 nm of sensor noise and nothing else, because this plant is of the "
        "controller's own structure, which it inverts exactly."
    )
    title = "Fig. 6: simulation, stationary plant"
    return Reproduction("fig6", title, rows, sentence, lambda theme: bench.picture(runs[0], 0, 5, theme))


def fig7() -> Reproduction:
    """All weights of the plant change within 30 % at 2.5 s."""
    runs = [bench.simulated_run(seed, bench.CHANGE) for seed in bench.SEEDS]
    times = ((1, 2.5), (2.5, 3), (3, 3.5), (4.5, 5), (9.5, 10), (19, 20))
    largest = max(bench.maximum(run, 2.5, 20, "true") for run in runs)
    rows = (
        *(window(runs, *time, channel="true") for time in times),
        Row("largest true error of all", None, largest, "um", 1),
    )
    sentence = (
        "The paper says that the controller adapts and prints no number; ours does, but slowly: by 2.5 s P has become "
        "small, and with a fixed forgetting factor of 0.9999 it takes seconds to grow again; the last plays, which "
        "such waves hardly move, are not relearned in 20 s on four of the five."
    )
    title = "Fig. 7: simulation, sudden change at 2.5 s"
    return Reproduction("fig7", title, rows, sentence, lambda theme: _change(runs[0], theme))


def _change(run: Recording, theme: style.Theme) -> Figure:
    """Ten seconds; the change is marked."""
    figure = bench.picture(run, 0, 10, theme)
    with style.use(theme):
        for panel in figure.axes:
            panel.axvline(2.5, color=theme["text"], lw=0.9, ls=(0, (4, 3)))
        below = figure.axes[1]
        below.text(2.4, 0.9, "sudden change", transform=below.get_xaxis_transform(), fontsize=8, ha="right")
    return figure


def fig8() -> Reproduction:
    """The weights that the first wave ends with beside the published ones of the plant (Sec. 4.3)."""
    plant = MatchedSettings()
    runs = [bench.simulated_run(seed) for seed in bench.SEEDS]
    a, b = bench.adapted(runs[0])
    deviations = [np.abs(bench.adapted(run) - np.array([plant.a, plant.b])).max() for run in runs]
    rows = (
        *(Row(f"a{i}", paper, ours, "um/V") for i, (paper, ours) in enumerate(zip(plant.a, a, strict=True))),
        *(Row(f"b{i}", paper, ours, "um/V") for i, (paper, ours) in enumerate(zip(plant.b, b, strict=True))),
        Row("largest deviation, 5 waves", None, max(deviations), "um/V"),
        *(Row(f"first {n} partial slopes within 5 %", None, bench.settling(runs, n), "s", 2) for n in (5, 8)),
    )
    sentence = (
        "The weights are those of the plant, within the uncertainty by 50 nm of noise; on two of the five waves the "
        "last partial slopes converge only with the first fall that is long enough to move play 4 or 5 back."
    )
    return Reproduction("fig8", "Fig. 8: simulation, convergence of the weights", rows, sentence, _weights)


def _weights(theme: style.Theme) -> Figure:
    """Five seconds; the plant's own weights are dashed."""
    plant = MatchedSettings()
    figure = plots.weights(bench.between(bench.simulated_run(bench.SEEDS[0]), 0, 5), theme)
    for panel, weights in zip(figure.axes, (plant.a, plant.b), strict=True):
        for weight, colour in zip(weights, theme.series, strict=True):
            panel.axhline(weight, color=colour, lw=0.8, ls=(0, (2, 3)))
    with style.use(theme):
        figure.axes[0].set_title("Dotted: the weights of the plant")
    return figure
