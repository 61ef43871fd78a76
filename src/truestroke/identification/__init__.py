"""From a record of voltage and displacement to a model (Sec. 2.2 to 2.4): read, examine, identify, save."""

from truestroke.identification.actuator import ActuatorModel
from truestroke.identification.examine import Findings, examine
from truestroke.identification.least_squares import FittedWeights, fit
from truestroke.identification.model_file import ModelFileError, load_model, save_model
from truestroke.identification.record import Record, read_record
from truestroke.identification.select import HeldOut, Identified, identify
from truestroke.identification.tables import RecordError

__all__ = [
    "ActuatorModel",
    "Findings",
    "FittedWeights",
    "HeldOut",
    "Identified",
    "ModelFileError",
    "Record",
    "RecordError",
    "examine",
    "fit",
    "identify",
    "load_model",
    "read_record",
    "save_model",
]
