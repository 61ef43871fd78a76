"""How an object shows itself: names, values and units on one screen, as text and as a small table in a notebook."""

from __future__ import annotations

import html as _html
from collections.abc import Sequence
from typing import Any

import numpy as np

WIDTH = 120  # characters of a line
FEW = 6  # entries of a sequence that are shown; of a longer one the first, the last and their number

Row = tuple[str, Any, str]
"""Name, value and unit of one line; the unit is empty for a pure number or a word."""


def as_text(title: str, rows: Sequence[Row]) -> str:
    """A title, and a line of name, value and unit for each row.

    Examples
    --------
    >>> print(as_text("Stage", [("stroke", 30.0, "um"), ("voltage_limits", (-0.6, 3.6), "V"), ("law", "rls", "")]))
    Stage
      stroke          30 um
      voltage_limits  (-0.6, 3.6) V
      law             rls
    """
    width = max((len(name) for name, _, _ in rows), default=0)
    lines = [f"  {name:<{width}}  {shown(value)} {unit}".rstrip() for name, value, unit in rows]
    return "\n".join([title, *(line if len(line) <= WIDTH else f"{line[: WIDTH - 3]}..." for line in lines)])


def as_html(title: str, rows: Sequence[Row]) -> str:
    """The same as a table for a notebook, where um is written µm.

    Examples
    --------
    >>> as_html("Stage", [("stroke", 30.0, "um")])
    '<table><caption>Stage</caption><tr><th>stroke</th><td>30 µm</td></tr></table>'
    """
    cells = [(name, f"{shown(value)} {unit.replace('um', 'µm')}".strip()) for name, value, unit in rows]
    body = "".join(f"<tr><th>{_html.escape(name)}</th><td>{_html.escape(cell)}</td></tr>" for name, cell in cells)
    return f"<table><caption>{_html.escape(title)}</caption>{body}</table>"


def shown(value: Any) -> str:
    """A value in a few characters: six digits of a number, the ends of a long sequence, the shape of a matrix.

    Examples
    --------
    >>> shown(1 / 3), shown(True), shown((0.0, 1.5)), shown(range(37)), shown(np.eye(3)), shown(None)
    ('0.333333', 'yes', '(0, 1.5)', '37: 0, 1, ... 36', 'matrix of 3 x 3', '-')
    """
    if value is None:
        return "-"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, float, np.number)):
        return f"{value:.6g}" if isinstance(value, (float, np.floating)) else str(value)
    if isinstance(value, str) or not isinstance(value, (Sequence, np.ndarray)):
        return str(value)
    array = np.asarray(value)
    if array.ndim > 1:
        return f"matrix of {' x '.join(map(str, array.shape))}"
    if array.size <= FEW:
        return f"({', '.join(map(shown, value))})"
    return f"{array.size}: {shown(value[0])}, {shown(value[1])}, ... {shown(value[-1])}"
