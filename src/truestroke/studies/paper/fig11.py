"""Fig. 11: the weights converge, random wave."""

from __future__ import annotations

from truestroke.report import plots
from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row


def reproduce() -> Reproduction:
    """Weights of the first random wave; times are means over the five waves."""
    runs = [bench.random_run(seed) for seed in bench.SEEDS]
    rows = (
        Row("first 3 partial slopes within 5 %", 1.0, bench.mean([bench.settling_time(r, 3) for r in runs]), "s", 2),
        Row("all 8 partial slopes within 5 %", None, bench.mean([bench.settling_time(r, 8) for r in runs]), "s", 2),
        Row("rmse, 0.75 to 1 s", None, bench.mean([bench.rmse(r, 0.75, 1) for r in runs]), "um"),
        Row("rmse, 10 to 20 s", 0.0943, bench.mean([bench.rmse(r, 10, 20) for r in runs]), "um"),
    )
    sentence = (
        "The slopes that every motion uses settle within a second, as the paper says; the last plays move only at the "
        "largest strokes, so their weights follow creep and asymmetry for as long as the run lasts."
    )
    title = "Fig. 11: convergence of the weights, random wave"
    return Reproduction("fig11", title, rows, sentence, lambda theme: plots.weights(runs[0], theme))
