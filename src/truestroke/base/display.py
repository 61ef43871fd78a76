"""How an object shows itself: a title and a small table, as text on one screen and as HTML in a notebook."""

import html
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

WIDTH = 120  # characters of a line
TAKEN = {1e3: ("nm", "mm"), 1e-3: ("mm", "nm"), 1e6: ("pm", "m"), 1e-6: ("m", "pm")}
"""Units of sensor and stroke in place of um, by how many times too many um the sensor shows then."""
ABOUT = 4.0  # times: how far the gain of an actuator may be from that of its settings, too
WRITTEN_OUT = 1e7  # below it a number has no exponent
FEW = 6  # entries of a sequence that are shown; of a longer one two, the last, and how many there are

Rows = Sequence[Sequence[str]]


class Displayed:
    """What has a `_display`: its title, and rows of a name and other cells; `repr` and a notebook show them."""

    def _display(self) -> tuple[str, Rows]:
        raise NotImplementedError

    def __repr__(self) -> str:
        return as_text(*self._display())

    def _repr_html_(self) -> str:
        return as_html(*self._display())


def as_text(title: str, rows: Rows) -> str:
    """The title, and a line for each row, in columns.

    >>> print(as_text("Stage", [("stroke", quantity(30.0, "um")), ("limits", quantity((-0.6, 3.6), "V"))]))
    Stage
      stroke  30 um
      limits  (-0.6, 3.6) V
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=False)]
    lines = ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    return "\n".join([title, *(line if len(line) <= WIDTH else f"{line[: WIDTH - 3]}..." for line in lines)])


def as_html(title: str, rows: Rows) -> str:
    """The same as a table; it says µm.

    >>> as_html("Stage", [("stroke", "30 um")])
    '<table><caption>Stage</caption><tr><th>stroke</th><td>30 µm</td></tr></table>'
    """
    escaped = [[re.sub(r"\bum\b", "µm", html.escape(cell)) for cell in row] for row in rows]
    body = "".join(f"<tr><th>{name}</th>{''.join(f'<td>{c}</td>' for c in cells)}</tr>" for name, *cells in escaped)
    return f"<table><caption>{html.escape(title)}</caption>{body}</table>"


def duration(seconds: float) -> str:
    """A duration in the unit that it is thought of in.

    Examples
    --------
    >>> duration(36.2), duration(150.0), duration(40_000.0), duration(400_000.0)
    ('36 s', '2.5 minutes', '11 hours', '4.6 days')
    """
    for unit, least in (("days", 172_800.0), ("hours", 7200.0), ("minutes", 120.0)):
        if seconds >= least:
            return f"{seconds / (least / 2):.2g} {unit}"
    return f"{seconds:.0f} s"


def micrometres(um: float) -> str:
    """A length, um: four decimals, or three digits where these would be fewer; below a femtometre it is rounding.

    Examples
    --------
    >>> micrometres(12.34567), micrometres(0.0021349), micrometres(3.87e-6), micrometres(7e-16)
    ('12.3457 um', '0.00213 um', '3.87e-06 um', '0.0000 um')
    """
    return f"{um:.4f} um" if um >= 0.01 or um < 1e-9 else f"{um:.3g} um"


def figures(value: float, digits: int = 3) -> str:
    """A number in so many digits, and without an exponent up to ten millions: readers compare 870 with 1130.

    >>> figures(1127.3), figures(0.0452831), figures(99.7, 2), figures(2.5e8)
    ('1130', '0.0453', '100', '2.5e+08')
    """
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < WRITTEN_OUT else text


def at_least(value: float, digits: int = 2) -> str:
    """A number that is needed, in so many digits: rounded up, as less would not do.

    >>> at_least(1.021), at_least(0.18), at_least(137.0)
    ('1.1', '0.18', '140')
    """
    if not value > 0:
        return figures(value, digits)
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return figures(math.ceil(value / step * (1 - 1e-9)) * step, digits)


def taken_for_um(times: float, otherwise: str = "") -> str:
    """What is said of a sensor that shows so many times the um of a stroke: the unit of one of them, where that is it.

    >>> taken_for_um(920.0)
    'the sensor seems to report in nm, not in um, or the stroke to be in mm'
    >>> taken_for_um(12.0, "this is not its scale")
    'this is not its scale'
    """
    for factor, (unit, stroke) in TAKEN.items():
        if factor / ABOUT < abs(times) < factor * ABOUT:
            return f"the sensor seems to report in {unit}, not in um, or the stroke to be in {stroke}"
    return otherwise


def quantity(value: Any, unit: str = "") -> str:
    """A value with its unit in a few characters: six digits, the ends of a long sequence, the shape of a matrix.

    >>> quantity(1 / 3, "um"), quantity(True), quantity((0.0, 1.5), "V"), quantity(range(37)), quantity(np.eye(3))
    ('0.333333 um', 'yes', '(0, 1.5) V', '37: 0, 1, ... 36', 'matrix of 3 x 3')
    >>> quantity(None), quantity(np.nan, "Hz")
    ('-', '-')
    """
    if isinstance(value, Displayed):
        return value._display()[0]
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if value is None or (number and not np.isfinite(value)):
        return "-"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if number:
        text = f"{value:.6g}" if isinstance(value, (float, np.floating)) else str(value)
    elif isinstance(value, str) or not isinstance(value, (Sequence, np.ndarray)):
        text = str(value)
    elif np.ndim(value) > 1:
        text = f"matrix of {' x '.join(map(str, np.shape(value)))}"
    elif len(value) <= FEW:
        text = f"({', '.join(map(quantity, value))})"
    else:
        text = f"{len(value)}: {quantity(value[0])}, {quantity(value[1])}, ... {quantity(value[-1])}"
    return f"{text} {unit}".rstrip()
