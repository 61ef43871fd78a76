"""Simulated actuators, unknown to the controller.

`RealisticPlant` is a driven piezo stage with a structure of its own, `MatchedPlant` the paper's plant (13),
`StagePlant` a stage for fast motion: three structures of hysteresis, modes, dead time, loads; `MultiAxisStage` two or
three of them that disturb each other. All are actuators of the loop: ``open()``, then ``exchange(volts)`` tick by tick
or in blocks. docs/plant.md explains them.
"""

from truestroke.plant.axes import MultiAxisSettings, MultiAxisStage
from truestroke.plant.matched import MatchedPlant
from truestroke.plant.realistic import RealisticPlant
from truestroke.plant.settings import EFFECTS, Change, MatchedSettings, PlantSettings, StageSettings
from truestroke.plant.stage import StagePlant

__all__ = [
    "EFFECTS",
    "Change",
    "MatchedPlant",
    "MatchedSettings",
    "MultiAxisSettings",
    "MultiAxisStage",
    "PlantSettings",
    "RealisticPlant",
    "StagePlant",
    "StageSettings",
]
