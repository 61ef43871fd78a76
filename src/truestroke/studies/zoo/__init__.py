"""A zoo of plants: many actuators of a stated distribution under the default controller and the paper's.

Run `number` of zoo `seed` is always the same plant, motion and accident; docs/zoo.md states the distribution.
"""

from truestroke.studies.zoo.draw import Run, draw
from truestroke.studies.zoo.dropouts import Dropouts
from truestroke.studies.zoo.figures import Figures, figures
from truestroke.studies.zoo.table import CONTROLLERS, Line, Result, beyond, lines, play, record, run

__all__ = [
    "CONTROLLERS",
    "Dropouts",
    "Figures",
    "Line",
    "Result",
    "Run",
    "beyond",
    "draw",
    "figures",
    "lines",
    "play",
    "record",
    "run",
]
