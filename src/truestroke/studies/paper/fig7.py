"""Fig. 7: simulation of a plant that changes suddenly."""

from __future__ import annotations

from matplotlib.figure import Figure

from truestroke.report import style
from truestroke.signals.recording import Recording
from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row


def reproduce() -> Reproduction:
    """All weights of the plant (13) are redrawn within 30 % at 2.5 s; numbers are means over five waves."""
    runs = [bench.simulated_run(seed, bench.CHANGE) for seed in bench.SEEDS]

    def true_rmse(start: float, stop: float) -> Row:
        values = [bench.rmse(run, start, stop, "true") for run in runs]
        return Row(f"true rmse, {start:g} to {stop:g} s", None, bench.mean(values), "um")

    windows = ((1, 2.5), (2.5, 3), (3, 3.5), (4.5, 5), (9.5, 10), (19, 20))
    largest = max(bench.maximum(run, 2.5, 20, "true") for run in runs)
    rows = (*(true_rmse(*window) for window in windows), Row("largest true error of all", None, largest, "um", 1))
    sentence = (
        "The paper says that the controller adapts and prints no number; ours does, but slowly: by 2.5 s P has become "
        "small, and with a fixed forgetting factor of 0.9999 it takes seconds to grow again; the last plays, which "
        "such waves hardly move, are not relearned in 20 s on four of the five."
    )
    title = "Fig. 7: simulation, sudden change at 2.5 s"
    return Reproduction("fig7", title, rows, sentence, lambda theme: draw(runs[0], theme))


def draw(run: Recording, theme: style.Theme) -> Figure:
    """Ten seconds; the change is marked."""
    figure = bench.picture(run, 0, 10, theme)
    with style.use(theme):
        for panel in figure.axes:
            panel.axvline(2.5, color=theme["text"], lw=0.9, ls=(0, (4, 3)))
        below = figure.axes[1]
        below.text(2.4, 0.9, "sudden change", transform=below.get_xaxis_transform(), fontsize=8, ha="right")
    return figure
