"""Fig. 6: simulation of a stationary plant."""

from __future__ import annotations

from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row


def reproduce() -> Reproduction:
    """The plant (13) with the published weights; numbers are means over five waves."""
    runs = [bench.simulated_run(seed) for seed in bench.SEEDS]
    rows = (
        Row("rmse, 10 to 20 s", None, bench.mean([bench.rmse(r, 10, 20) for r in runs]), "um", 4),
        Row("true rmse, 0.75 to 1 s", None, bench.mean([bench.rmse(r, 0.75, 1, "true") for r in runs]), "um", 4),
        Row("true rmse, 10 to 20 s", None, bench.mean([bench.rmse(r, 10, 20, "true") for r in runs]), "um", 4),
        Row("true maximum, 10 to 20 s", None, bench.mean([bench.maximum(r, 10, 20, "true") for r in runs]), "um", 4),
    )
    sentence = (
        "The paper prints no number; ours is the 50 nm of sensor noise and nothing else, because this plant is of the "
        "controller's own structure, which it inverts exactly."
    )
    title = "Fig. 6: simulation, stationary plant"
    return Reproduction("fig6", title, rows, sentence, lambda theme: bench.picture(runs[0], 0, 5, theme))
