"""What a reproduction is: rows of the paper's value and ours, a sentence, a picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from truestroke.report.style import Theme


@dataclass(frozen=True)
class Row:
    """One quantity.

    Attributes
    ----------
    quantity : str
        What it is.
    paper : float or None
        The number that the paper prints; None where it prints none.
    ours : float
        The number measured here.
    unit : str
        Of both; empty for a pure number.
    digits : int
        Decimals to print of ours.
    """

    quantity: str
    paper: float | None
    ours: float
    unit: str
    digits: int = 3

    def cells(self) -> tuple[str, str, str, str]:
        """Quantity, the paper's value ("-" for none), ours, unit, as text.

        Examples
        --------
        >>> Row("rmse, 10 to 20 s", 0.0584, 0.03262, "um").cells()
        ('rmse, 10 to 20 s', '0.0584', '0.033', 'um')
        """
        paper = "-" if self.paper is None else f"{self.paper:g}"
        return self.quantity, paper, f"{self.ours:.{self.digits}f}", self.unit


@dataclass(frozen=True, eq=False)
class Reproduction:
    """A figure or table of the paper beside ours. `print` shows it as plain text.

    Attributes
    ----------
    name : str
        "fig4", "table1", ...
    title : str
        What it shows.
    rows : tuple[Row, ...]
        The paper's values and ours.
    sentence : str
        What differs, and why.
    plot : callable
        plot(theme) -> matplotlib Figure, with a theme of `truestroke.report.style`.
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    sentence: str
    plot: Callable[[Theme], Figure]

    def as_dict(self) -> dict[str, Any]:
        """Everything but the picture, as plain numbers and text, for JSON."""
        rows = [{"quantity": r.quantity, "paper": r.paper, "ours": r.ours, "unit": r.unit} for r in self.rows]
        return {"name": self.name, "title": self.title, "rows": rows, "sentence": self.sentence}

    def __str__(self) -> str:
        table = [("quantity", "paper", "ours", "unit"), *(row.cells() for row in self.rows)]
        widths = [max(len(line[i]) for line in table) for i in range(4)]
        lines = [
            f"{quantity:{widths[0]}}  {paper:>{widths[1]}}  {ours:>{widths[2]}}  {unit}".rstrip()
            for quantity, paper, ours, unit in table
        ]
        return "\n".join([self.title, *lines, self.sentence])
