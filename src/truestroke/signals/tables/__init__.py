"""Files with columns: opened as a `Table` of names and units, from which the columns that are wanted are then read."""

from truestroke.signals.tables.arrays import READERS
from truestroke.signals.tables.headings import OF_LANGUAGES, OTHERS, UNITS, is_unit, name_and_unit, unit
from truestroke.signals.tables.opening import ELSEWHERE, open_table
from truestroke.signals.tables.table import RecordError, Table

__all__ = [
    "ELSEWHERE",
    "OF_LANGUAGES",
    "OTHERS",
    "READERS",
    "UNITS",
    "RecordError",
    "Table",
    "is_unit",
    "name_and_unit",
    "open_table",
    "unit",
]
