"""Fig. 12: tracking of a random wave."""

from __future__ import annotations

from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row


def reproduce() -> Reproduction:
    """The first of the five waves; the paper's numbers are means over its five."""
    run = bench.random_run(bench.SEEDS[0])
    rows = (
        Row("rmse, 10 to 20 s", 0.0943, bench.rmse(run, 10, 20), "um"),
        Row("maximum, 10 to 20 s", 0.3899, bench.maximum(run, 10, 20), "um"),
        Row("maximum, 0 to 1 s", None, bench.maximum(run, 0, 1), "um"),
        Row("true rmse, 10 to 20 s", None, bench.rmse(run, 10, 20, "true"), "um"),
    )
    sentence = (
        "The wave is another one, of the same kind (the paper prints no seed); the error is smaller, as in Table 2, "
        "in part because our sensor is quieter."
    )
    title = "Fig. 12: tracking of a random wave"
    return Reproduction("fig12", title, rows, sentence, lambda theme: bench.picture(run, 0, 20, theme))
