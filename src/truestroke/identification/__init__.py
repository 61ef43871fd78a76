"""Weights from a record of voltage and displacement (Sec. 2.2 to 2.4)."""

from truestroke.identification.actuator import ActuatorModel
from truestroke.identification.least_squares import FittedWeights, fit
from truestroke.identification.model_file import ModelFileError, load_model, save_model
from truestroke.identification.select import HeldOut, Identified, identify

__all__ = [
    "ActuatorModel",
    "FittedWeights",
    "HeldOut",
    "Identified",
    "ModelFileError",
    "fit",
    "identify",
    "load_model",
    "save_model",
]
