"""From a record to a model (Sec. 2.2 to 2.4): read, examine, identify, save; then to a waveform, and refine."""

from truestroke.control.actuator import ActuatorModel
from truestroke.control.model_file import ModelFileError, load_model, save_model
from truestroke.control.spans import Beyond, Span
from truestroke.identification.examination.examine import examine
from truestroke.identification.examination.findings import Findings
from truestroke.identification.fitting.least_squares import FittedWeights, fit
from truestroke.identification.held_out.trace import HeldOut, Trace
from truestroke.identification.identified import Identified, identify
from truestroke.identification.records.record import Record, read_record
from truestroke.identification.refine import Refined, refine
from truestroke.identification.score import Score, score
from truestroke.identification.waveform import PredictedWaveform, Waveform, load_waveform, save_waveform, waveform
from truestroke.signals.tables import RecordError

__all__ = [
    "ActuatorModel",
    "Beyond",
    "Findings",
    "FittedWeights",
    "HeldOut",
    "Identified",
    "ModelFileError",
    "PredictedWaveform",
    "Record",
    "RecordError",
    "Refined",
    "Score",
    "Span",
    "Trace",
    "Waveform",
    "examine",
    "fit",
    "identify",
    "load_model",
    "load_waveform",
    "read_record",
    "refine",
    "save_model",
    "save_waveform",
    "score",
    "waveform",
]
