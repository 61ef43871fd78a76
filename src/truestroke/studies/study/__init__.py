"""Studies from a file: a TOML table states the distribution of plants, waves and controllers, and what converged means.

Run i of a study is always the same plant, wave and noise; docs/study.md states how a study is written.
"""

from truestroke.studies.engine import Batch, Store, StoreError, StudyError, batches, first, run, simulate
from truestroke.studies.study.config import Study, example, load, parse, sample
from truestroke.studies.study.summary import informative, judge, lines

__all__ = [
    "Batch",
    "Store",
    "StoreError",
    "Study",
    "StudyError",
    "batches",
    "example",
    "first",
    "informative",
    "judge",
    "lines",
    "load",
    "parse",
    "run",
    "sample",
    "simulate",
]
