"""The fast half of the robustness study: stages of f0 from 50 to 2000 Hz, motions up to f0/2, three hystereses."""

from truestroke.studies.robustness.fast.sample import REACH, FastRun, sample
from truestroke.studies.robustness.fast.table import (
    FastRobustness,
    Result,
    failed,
    judge,
    metrics,
    record,
    results,
    sentences,
)

__all__ = [
    "REACH",
    "FastRobustness",
    "FastRun",
    "Result",
    "failed",
    "judge",
    "metrics",
    "record",
    "results",
    "sample",
    "sentences",
]
