"""Rows of one text that are written in two ways: with decimal commas and points, with tabs and blanks."""

import re
from collections.abc import Iterable, Sequence

WITH_COMMAS = re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?")
WITH_POINTS = re.compile(r"[+-]?\d+(\.\d*)?([eE][+-]?\d+)?")
TWICE = 2  # rows of each kind: one alone is a damaged one


def _between(line: str, separator: str | None) -> list[str]:
    """Its cells, without empty ones at the end."""
    cells = [cell.strip().strip('"') for cell in line.strip().split(separator)]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def decimal_mark(line: str, numbers: int = 0) -> str:
    """The decimal mark of a row of two numbers and more, "," or "."; empty where it has none, or is no such row.

    Between commas a row of whole numbers has decimal commas where it has more of them, but at most twice as many, than
    the `numbers` of other rows.

    Examples
    --------
    >>> decimal_mark("0,5;2;1,25"), decimal_mark("0.5 2.25"), decimal_mark("0.5;2,25"), decimal_mark("1;2")
    (',', '.', '', '')
    >>> decimal_mark("0.5,2.25"), decimal_mark("0,5,2", 2), decimal_mark("1,2", 2)
    ('.', ',', '')
    """
    cells = _between(line, next((s for s in (";", "\t") if s in line), None))
    for mark, number in ((",", WITH_COMMAS), (".", WITH_POINTS)):
        if len(cells) > 1 and mark in line and all(map(number.fullmatch, cells)):
            return mark
    cells = _between(line, ",")
    if len(cells) > 1 and all(map(WITH_POINTS.fullmatch, cells)):
        return "." if "." in line else "," if numbers < len(cells) <= 2 * numbers else ""
    return ""


def two_marks(rows: Iterable[tuple[int, str]]) -> str:
    """Where rows, each with its number, have both decimal marks, two of each and more; empty where they do not.

    Examples
    --------
    >>> two_marks([(2, "0,5;1,5"), (3, "0.6;1.6"), (4, "0,7;1,7"), (5, "0.8;1.8")])
    "line 2 has decimal commas ('0,5;1,5'), line 3 decimal points ('0.6;1.6')"
    """
    rows = list(rows)
    numbers = next((line.count(",") + 1 for _, line in rows if decimal_mark(line) == "."), 0)
    found: dict[str, list[tuple[int, str]]] = {",": [], ".": [], "": []}
    for number, line in rows:
        found[decimal_mark(line, numbers)].append((number, line.strip()[:60]))
    if min(len(found[mark]) for mark in ",.") < TWICE:
        return ""
    (comma, with_comma), (point, with_point) = found[","][0], found["."][0]
    return f"line {comma} has decimal commas ({with_comma!r}), line {point} decimal points ({with_point!r})"


def of_blanks(rows: Sequence[str]) -> bool:
    r"""Whether rows, of which some have tabs, are of one width between blanks and tabs alike, but not between tabs.

    Examples
    --------
    >>> of_blanks(["0.1  2.0", "0.2\t2.5"]), of_blanks(["0.1\t\t2.0", "0.2\t1.0\t2.5"])
    (True, False)
    """
    widths = {len(row.split()) for row in rows}
    return len(widths) == 1 and any({len(row.strip().split("\t"))} != widths for row in rows)
