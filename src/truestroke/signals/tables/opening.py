"""The table in a file, whatever it is."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ParamSpec, TypeVar

from truestroke.base import files
from truestroke.signals import formats
from truestroke.signals.tables.arrays import READERS
from truestroke.signals.tables.table import RecordError, Table
from truestroke.signals.tables.text import read_text

P = ParamSpec("P")
R = TypeVar("R")
ELSEWHERE = {
    ".xls": ".xlsx or .csv",
    ".ods": ".xlsx or .csv",
    ".tdm": ".tdms or .csv",
    ".mf4": ".csv or .h5",
    ".mdf": ".csv or .h5",
}


def open_table(path: Path, narrowest: int = 2) -> Table:
    """The table in a file, by its ending: .npz, .mat, .parquet, .feather, .h5, .hdf5, .xlsx, .tdms; else it is text.

    A text has `narrowest` columns or more.
    """
    ending = files.existing(path).suffix.lower()
    if ending in ELSEWHERE:
        raise RecordError(str(path), f"{ending} is not read; save or export it as {ELSEWHERE[ending]}")
    if reason := formats.other(path):
        raise RecordError(str(path), f"this is {reason}")
    table = _guarded(path, READERS.get(ending, partial(read_text, narrowest=narrowest)))(path)
    return replace(table, read=_guarded(path, table.read), locate=_guarded(path, table.locate))


def _guarded(path: Path, function: Callable[P, R]) -> Callable[P, R]:
    """It raises a RecordError for every error of its library at a damaged file."""

    def guarded(*arguments: P.args, **options: P.kwargs) -> R:
        with files.reading(path, lambda reason: RecordError(str(path), reason)):
            return function(*arguments, **options)

    return guarded
