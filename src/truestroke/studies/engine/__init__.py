"""The engine of studies: thousands of runs, each a function of its number, that continue where they stopped.

A study gives the distribution of its runs and the metrics of each (`Study`). The engine samples and simulates them in
threads, by dask or on a SLURM cluster, and keeps a row of each in a store.
"""

from truestroke.studies.engine.executors import batches, first, run
from truestroke.studies.engine.rows import Batch, Channels, Number, Row, Run, Study, StudyError, quantiles, simulate
from truestroke.studies.engine.store import Store, StoreError

__all__ = [
    "Batch",
    "Channels",
    "Number",
    "Row",
    "Run",
    "Store",
    "StoreError",
    "Study",
    "StudyError",
    "batches",
    "first",
    "quantiles",
    "run",
    "simulate",
]
