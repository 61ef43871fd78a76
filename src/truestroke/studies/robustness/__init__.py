"""Robustness: many actuators of a stated distribution under the default controller and the paper's.

Run `number` of seed `seed` is always the same plant, motion and accident; docs/robustness.md states the distribution.
"""

from truestroke.studies.engine import Row, Run
from truestroke.studies.robustness.metrics import METRICS, metrics
from truestroke.studies.robustness.sample import CONTROLLERS, change_tick, sample
from truestroke.studies.robustness.table import Line, Robustness, beyond, judge, lines, numbers, record, run, sentence

__all__ = [
    "CONTROLLERS",
    "METRICS",
    "Line",
    "Robustness",
    "Row",
    "Run",
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
