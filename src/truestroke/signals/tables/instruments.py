"""What the headers of instruments state of their columns: names, units, the time from row to row.

Oscilloscopes and LabVIEW write lines of a key and values above the names: "Vertical Units,V,um". Rigol's scopes have
the step of the time beside the names, Tektronix' TDS the whole header in columns of its own, beside the first rows.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from truestroke.signals.tables.headings import UNITS, name_and_unit, unit

UNIT_KEYS = "vertical units", "y_unit_label", "vunit"
TIME_UNIT_KEYS = "horizontal units", "hunit", "x_dimension"
STEP_KEYS = "delta_x", "hresolution", "sampling period", "sample interval"
TRACES = "tracename"  # of Yokogawa: the names, above rows whose first cell is empty
TIMES = "time", "x_value"  # in any column, as beside each signal
TIMES_IN_FRONT = "second", "x", "sequence", "t"  # in the first column alone: behind it x is a displacement
FIRST_OF_TDS = "record length"
OF_RIGOL = re.compile(r"tInc\s*=\s*([-+.\deE]+)\s*s?", re.IGNORECASE)
START_OF_RIGOL = re.compile(r"t0\s*=.*", re.IGNORECASE)
CHANNEL = re.compile(r"(CH\d)V", re.IGNORECASE)
OF_SIGLENT = re.compile(r"CH\d:", re.IGNORECASE)  # before a unit


@dataclass(frozen=True)
class Stated:
    """Of the columns of the numbers, as far as the header states it.

    Attributes
    ----------
    names, units : tuple[str, ...]
        Of each column; names are empty where the header has none.
    step : float
        s from row to row; 0 where it is not stated, or a column has the time.
    replaces : bool
        Whether the time takes the place of the first column, which counts the rows or is empty.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    step: float = 0.0
    replaces: bool = False


def stated(rows: Sequence[Sequence[str]], names: Sequence[str], units: Sequence[str], width: int) -> Stated | None:
    """What the lines above the numbers state beyond names and units; None where they have nothing of it.

    Parameters
    ----------
    rows : sequence
        Cells of the lines, from the first.
    names, units : sequence
        What was found of the columns; empty where they have no names.
    width : int
        Number of columns.

    Examples
    --------
    >>> stated([["Vertical Units", "V", "um"], ["TIME", "CH1", "CH2"]], ("TIME", "CH1", "CH2"), ("", "", ""), 3)
    Stated(names=('TIME', 'CH1', 'CH2'), units=('', 'V', 'um'), step=0.0, replaces=False)
    >>> rows = [["X", "CH1", "CH2", "Start", "Increment"], ["Sequence", "Volt", "Volt", "-0.5", "1e-3"]]
    >>> stated(rows, (), (), 3)
    Stated(names=('time', 'CH1', 'CH2'), units=('s', 'V', 'V'), step=0.001, replaces=True)
    >>> stated([["CH1V", "CH2V", "t0 = -0.5", "tInc = 1e-3"]], (), (), 2)
    Stated(names=('CH1', 'CH2'), units=('V', 'V'), step=0.001, replaces=False)
    """
    return _of_rigol(rows, width) or _of_keys(rows, names, units, width)


def _of_rigol(rows: Sequence[Sequence[str]], width: int) -> Stated | None:
    """Of its scopes, older and newer: the step is behind the names."""
    if not rows:
        return None
    head = [cell.lower() for cell in rows[-2][: width + 2]] if len(rows) > 1 else []
    if head[width:] == ["start", "increment"] and len(rows[-1]) >= width + 2:
        step, first = _number(rows[-1][width + 1]), rows[-1][0].lower()
        if first == "sequence" and step > 0:
            return Stated(("time", *rows[-2][1:width]), ("s", *map(unit, rows[-1][1:width])), step, True)
    steps = [match for cell in rows[-1] if (match := OF_RIGOL.fullmatch(cell))]
    columns = [cell for cell in rows[-1][:width] if not OF_RIGOL.fullmatch(cell) and not START_OF_RIGOL.fullmatch(cell)]
    if not steps or not columns or not all(columns):
        return None
    names, units = (tuple(each) for each in zip(*map(_of_channel, columns), strict=True))
    step = _number(steps[0][1])
    return Stated(names, units, 0.0 if any(_times(names)) or not step > 0 else step)


def _of_channel(text: str) -> tuple[str, str]:
    """Name and unit; CH1V is channel 1 in V."""
    match = CHANNEL.fullmatch(text)
    return (match[1], "V") if match else name_and_unit(text)


def _of_keys(rows: Sequence[Sequence[str]], names: Sequence[str], units: Sequence[str], width: int) -> Stated | None:
    """Of lines with a key and values, such as "Vertical Units,V,um"; the last of a key is the nearest."""
    held = {row[0].lower(): list(row) for row in rows if row}
    of_values = next((held[key] for key in UNIT_KEYS if key in held), None)
    if of_values is None:
        return None
    last, traces = list(rows[-1]), held.get(TRACES, [])
    replaces = len(traces) == width
    if replaces:
        names, units = ("time", *traces[1:]), ("s", *[""] * (width - 1))
    elif not names and last[0].lower() == "x_value" and held.get("x_columns", ["", ""])[1].lower() == "no":
        names, units = last[1 : width + 1], ("",) * width
    if len(names) != width:
        return None
    times = _times(names)
    values = [c for c, name in enumerate(names) if name and not times[c]]
    texts = [cell for cell in of_values[1:] if cell and cell.lower() not in UNIT_KEYS]
    found = list(units)
    for k, c in enumerate(values):
        text = texts[k] if len(texts) == len(values) else of_values[c] if c < len(of_values) else ""
        found[c] = found[c] or unit(OF_SIGLENT.sub("", text))
    of_time = next((held[key][1].lower() for key in TIME_UNIT_KEYS if len(held.get(key, [])) > 1), "")
    of_time = of_time.replace("time", "s")  # of LabVIEW, whose times are in s
    found = [of or unit(of_time) if time else of for time, of in zip(times, found, strict=True)]
    timed = not replaces and any(times)
    steps = [_number(cell) for key in STEP_KEYS for cell in held.get(key, [])[1:] if cell]
    step = 0.0 if timed or not steps or not steps[0] > 0 else steps[0] * UNITS["time"].get(unit(of_time), 1.0)
    return Stated(tuple(names), tuple(found), step, replaces and step > 0)


def beside(rows: Sequence[Sequence[str]], width: int) -> Stated | None:
    """Of a header in columns of its own, as of Tektronix' TDS: names and units of all columns; None where it is none.

    Columns of the header have no names. Each block is the header of the signals behind it.

    Examples
    --------
    >>> rows = [["Record Length", "3", "", "0.0", "1.5"], ["Source", "CH1", "", "0.1", "1.6"]]
    >>> beside([*rows, ["Vertical Units", "V", "", "0.2", "1.7"], ["", "", "", "0.3", "1.8"]], 5)
    Stated(names=('', '', '', 'TIME', 'CH1'), units=('', '', '', 's', 'V'), step=0.0, replaces=False)
    """
    if not rows or rows[0][0].lower() != FIRST_OF_TDS or width < 5:
        return None
    full = [row for row in rows if len(row) >= width]
    signals = [c for c in range(width) if all(not math.isnan(_number(row[c])) for row in full)]
    starts = [c for c, cell in enumerate(rows[0][: width - 1]) if cell.lower() == FIRST_OF_TDS]
    names, units = [""] * width, [""] * width
    for start, stop in zip(starts, [*starts[1:], width], strict=True):
        stated_here = {row[start].lower(): row[start + 1] for row in full if row[start]}
        columns = [c for c in signals if start < c < stop]
        for k, c in enumerate(columns):
            source = stated_here.get("source", "") or "CH"
            names[c] = "TIME" if not k else source if k == 1 else f"{source}:{k}"
            units[c] = unit(stated_here.get("vertical units", "")) if k == 1 else "" if k else "s"
    return Stated(tuple(names), tuple(units)) if signals else None


def _times(names: Sequence[str]) -> list[bool]:
    """Whether each column is the time, by its name."""
    return [name.lower() in TIMES or (c == 0 and name.lower() in TIMES_IN_FRONT) for c, name in enumerate(names)]


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan
