"""The columns of a file, and the error of one that cannot be used."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from truestroke.base import files
from truestroke.base.typing import FloatArray

PROBE = 200  # lines of text that are looked at to find the layout, and rows of arrays without names


class RecordError(files.FileError):
    """A file with columns, or a record in arrays, that cannot be used.

    Attributes
    ----------
    source : str
        The file, or "arrays".
    reason : str
        Why, and what would help.
    row : int or None
        Where: the line of a text file, else the row, both counted from 1; None where it is not one row.
    missing : str or None
        The column that was asked for by this name, where that is why.
    """

    def __init__(
        self, source: str, reason: str, row: int | None = None, where: str = "row", *, missing: str | None = None
    ) -> None:
        self.source, self.reason, self.row, self.missing = source, reason, row, missing
        super().__init__(f"{source}: {'' if row is None else f'{where} {row}: '}{reason}")


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a file.

    Attributes
    ----------
    names : tuple[str, ...]
        Of the columns; empty where the file has none.
    units : tuple[str, ...]
        As the file states them; "" where it does not.
    head : ndarray, shape (rows, columns)
        The first rows; empty where the file is read by its names.
    read : callable
        Columns by their indices -> an array each. What is not a number is NaN. A text is read no further than the
        chunk with the first NaN unless `complete`.
    locate : callable
        Index of a row -> its number for people, and its text.
    where : str
        What that number counts: "line" or "row".
    marked : bool
        Whether NaN marks a missing measurement, as in a recording of truestroke: no fault of the file.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    head: FloatArray
    read: Callable[[Sequence[int], bool], list[FloatArray]]
    locate: Callable[[int], tuple[int, str]] = lambda index: (index + 1, "")
    where: str = "row"
    marked: bool = False

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names) or self.head.shape[1]
