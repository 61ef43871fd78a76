"""Robustness: many actuators of a stated distribution under the default controller and the paper's.

Run `number` of seed `seed` is always the same plant, motion and accident; docs/robustness.md states the distribution.
"""

from truestroke.studies.robustness.sample import change_tick, sample
from truestroke.studies.robustness.table import (
    Robustness,
    beyond,
    judge,
    lines,
    metrics,
    numbers,
    record,
    run,
    sentence,
)

__all__ = [
    "Robustness",
    "beyond",
    "change_tick",
    "judge",
    "lines",
    "metrics",
    "numbers",
    "record",
    "run",
    "sample",
    "sentence",
]
