"""Fig. 13: a section of Fig. 12."""

from __future__ import annotations

from truestroke.studies.paper import bench
from truestroke.studies.paper.reproduction import Reproduction, Row


def reproduce() -> Reproduction:
    """The wave of Fig. 12 from 5 to 8 s."""
    run = bench.random_run(bench.SEEDS[0])
    rows = (
        Row("rmse, 5 to 8 s", None, bench.rmse(run, 5, 8), "um"),
        Row("maximum, 5 to 8 s", None, bench.maximum(run, 5, 8), "um"),
        Row("true rmse, 5 to 8 s", None, bench.rmse(run, 5, 8, "true"), "um"),
    )
    sentence = (
        "The paper prints no number for this section; ours is not yet as good as the same wave's 10 to 20 s (Fig. 12): "
        "four fifths of the square of its true error are creep, without which both are the same."
    )
    title = "Fig. 13: the wave of Fig. 12, 5 to 8 s"
    return Reproduction("fig13", title, rows, sentence, lambda theme: bench.picture(run, 5, 8, theme))
