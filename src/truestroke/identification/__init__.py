"""Weights from a record of voltage and displacement (Sec. 2.2 to 2.4)."""

from truestroke.identification.examine import Findings, examine
from truestroke.identification.least_squares import FittedWeights, fit
from truestroke.identification.record import Record, read_record
from truestroke.identification.tables import RecordError

__all__ = ["Findings", "FittedWeights", "Record", "RecordError", "examine", "fit", "read_record"]
