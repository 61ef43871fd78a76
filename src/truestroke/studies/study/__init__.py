"""Studies: thousands of runs drawn from stated ranges, on this machine or a cluster, that continue where they stopped.

Run i of a study is always the same plant, wave and noise; docs/study.md states how a study is written.
"""

from truestroke.studies.study.config import Draw, Study, example, load, parse
from truestroke.studies.study.draw import Run, draw, first
from truestroke.studies.study.play import Batch, Row, play
from truestroke.studies.study.run import batches, run
from truestroke.studies.study.store import Store, StoreError
from truestroke.studies.study.summary import Line, Telling, lines, telling

__all__ = [
    "Batch",
    "Draw",
    "Line",
    "Row",
    "Run",
    "Store",
    "StoreError",
    "Study",
    "Telling",
    "batches",
    "draw",
    "example",
    "first",
    "lines",
    "load",
    "parse",
    "play",
    "run",
    "telling",
]
