"""Which columns of a file are which signals, by heading, unit or place, and their numbers in our units."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.signals import formats
from truestroke.signals.tables import OTHERS, UNITS, RecordError, Table, is_unit, name_and_unit, unit
from truestroke.signals.tables.instruments import TIMES

NO_VALUE = 1e30  # instruments mark what they have not measured by 9.9e37 or 9.91e37 (SCPI), or by a larger number
LISTED = 24  # columns that an error names
TIME_TOLERANCE = 0.01  # of a tick: how far a time in a file may lie from its even grid


@dataclass(frozen=True)
class Wanted:
    """A signal that is looked for among the columns of a file.

    Attributes
    ----------
    role : str
        What it is: "volts", "displacement", ...
    units : Mapping[str, float]
        Those it can have in a file, and what one of each is in the first, which is assumed where none is stated.
    headings : tuple[str, ...]
        By which its column is found if it is not given, in lower case, the best first; of "run/u" the part after
        the group.
    key : str, int or None
        The column that the caller names, or its number from 1.
    unit : str or None
        Unit that the caller states.
    needed : bool
        Whether there must be one.
    certain : bool
        For what will be put out: no heading is better than another, none is found by its unit alone, and a unit that is
        not known is refused.
    heading : str
        What its column must be headed, where the caller cannot name it: "z (um)".
    instead : str
        What the caller can give in its place: "the `sample_rate`".
    """

    role: str
    units: Mapping[str, float]
    headings: tuple[str, ...] = ()
    key: str | int | None = None
    unit: str | None = None
    needed: bool = True
    certain: bool = False
    heading: str = ""
    instead: str = ""

    def __post_init__(self) -> None:
        if self.unit is not None and unit(self.unit) not in self.units:
            raise SettingError(f"{self.role}_unit", repr(self.unit), f"one of {', '.join(self.units)}")


@dataclass(frozen=True)
class Column:
    """Where a signal came from.

    Attributes
    ----------
    heading : str
        The column as the file calls it, such as "column 5" or "z".
    unit : str
        Unit of the file.
    stated : bool
        Whether file or caller stated the unit; False where V, um or s is assumed.
    of_file : str
        The unit that the file states, also where the caller states another; "" where it states none.
    asked : bool
        Whether the caller states the unit.
    other : str
        What the file states that is none of the units, such as mrad, where the caller states another one.
    besides : tuple[str, ...]
        Headings of further columns in a unit of this signal, where nobody named the one.
    """

    heading: str
    unit: str
    stated: bool
    of_file: str = field(default="", repr=False)
    asked: bool = field(default=False, repr=False)
    other: str = field(default="", repr=False)
    besides: tuple[str, ...] = field(default=(), repr=False)

    def says(self, role: str, unit: str = "") -> str:
        """The argument that states the unit, or this unit; against a unit of the file, a scale does, or its heading.

        Examples
        --------
        >>> [Column("z", "um", bool(of), of).says("displacement", "nm") for of in ("", "um")]
        ['`displacement_unit` nm', '`displacement_scale` 0.001']
        >>> Column("t", "ms", True, "ms").says("time", "s")
        's in the heading of the file'
        """
        if not self.of_file:
            return f"`{role}_unit`" + (f" {unit}" if unit else f" or `{role}_scale`")
        if role == "time":
            return f"{unit} in the heading of the file"
        size = f" {UNITS[role][unit]:g}" if unit else f", {next(iter(UNITS[role]))} for one of the column"
        return f"`{role}_scale`{size}"


def read_columns(
    path: Path, table: Table, wanted: Sequence[Wanted], places: Sequence[str], complete: bool = False
) -> tuple[dict[str, FloatArray], dict[str, Column]]:
    """Signals by their role, in the first of their units, and where they came from.

    `places` are the roles of the columns of a file without names, from the left. What is not a number, and a mark of an
    instrument in its place, is NaN; a text is read no further than the chunk with the first NaN unless `complete`.

    Raises
    ------
    RecordError
        A column is not found, is found twice, or is in a unit of something else.
    """
    source, found = str(path), {w.role: _named(str(path), table, w) for w in wanted if w.key is not None}
    named = set(found.values())
    for w in wanted:
        if w.role in found:
            continue
        by_place = places.index(w.role) if w.role in places else None
        index = _find(source, table, w, named) if table.names else by_place
        if index is not None and index not in found.values():
            found[w.role] = index
        elif w.needed:
            if {"volts", "displacement"} <= {each.role for each in wanted if each.needed}:
                _refuse_alone(source, table, w, found)
            known = f"Head it {w.heading}" if w.heading else f"Name it by `{w.role}`"
            remedy = f"{known} or give {w.instead}" if w.instead else known
            raise RecordError(source, f"which column is {w.role}? {remedy}; {_listing(table)}")
    for role, index in found.items():
        if both := " and ".join(other for other, place in found.items() if place == index and other != role):
            name = table.names[index] if table.names else ""
            number = f": {name} is its heading, which is taken before a number; give the headings" * name.isdigit()
            raise RecordError(source, f"{_heading(table, index)} is named twice, for {role} and {both}{number}")
    chosen = {w.role: w for w in wanted if w.role in found}
    columns = {role: _column(source, table, w, found[role], set(found.values())) for role, w in chosen.items()}
    signals = dict(zip(chosen, table.read([found[role] for role in chosen], complete), strict=True))
    for role, column in columns.items():
        signal = signals[role]
        signal[(np.abs(signal) >= NO_VALUE) & np.isfinite(signal)] = np.nan
        if (factor := chosen[role].units[column.unit]) != 1.0:
            signals[role] *= factor
    return signals, columns


def _refuse_alone(source: str, table: Table, wanted: Wanted, found: Mapping[str, int]) -> None:
    """RecordError where a file has nothing beside the time but one signal."""
    taken = {table.names[found["time"]].lower()} if "time" in found and table.names else set()
    others = [c for c, name in enumerate(table.names) if name and name.lower() not in ("t", *TIMES, *taken)]
    unnamed = [c for c, name in enumerate(table.names) if not name and c < table.head.shape[1]]
    if np.isfinite(table.head[:, unnamed]).all(axis=0).any():  # a signal, too, which the caller can name by its number
        return
    if len(others) == 1 < table.width and wanted.role in ("volts", "displacement"):
        reason = (
            f"{_heading(table, others[0])} is its only signal; put voltage and displacement side by side in one file"
        )
        raise RecordError(source, reason)


def _named(source: str, table: Table, wanted: Wanted) -> int:
    """Index of a column that the caller names."""
    key, role = wanted.key, wanted.role
    if isinstance(key, str):
        matches = [i for i, name in enumerate(table.names) if name.lower() == name_and_unit(key)[0].lower()]
        if len(matches) == 1:
            return matches[0]
        if matches:
            raise RecordError(source, f"{role}: more than one column {key!r}; {_listing(table)}")
        if not key.strip().isdigit():
            raise RecordError(source, f"{role}: no column {key!r}; {_listing(table)}", missing=key)
    number = int(key or 0)
    if not 1 <= number <= table.width:
        raise RecordError(source, f"{role}: no column {number}; they count from 1, {_listing(table)}")
    return number - 1


def _find(source: str, table: Table, wanted: Wanted, taken: set[int]) -> int | None:
    """By heading, else by unit; None where nothing fits, an error where several do."""
    fits = [i for i, u in enumerate(table.units) if i not in taken and (not is_unit(u) or u in wanted.units)]
    last = [table.names[i].lower().rsplit("/", 1)[-1] for i in fits]
    choices = [wanted.headings] if wanted.certain else [(heading,) for heading in wanted.headings]
    by_heading = ([i for i, name in zip(fits, last, strict=True) if name in choice] for choice in choices)
    matches = next(filter(None, by_heading), [])
    if not matches and not wanted.certain:
        matches = [i for i in fits if table.units[i] in wanted.units]
    if len(matches) > 1 and wanted.role == "time" and _are_one(table, matches):
        matches = matches[:1]
    if len(matches) > 1:
        several = ", ".join(_heading(table, i) for i in matches)
        remedy = "keep one of them in the file" if wanted.heading else f"name one by `{wanted.role}`"
        raise RecordError(source, f"{wanted.role}: several columns could be it ({several}); {remedy}")
    return matches[0] if matches else None


def _are_one(table: Table, columns: Sequence[int]) -> bool:
    """Whether columns have one name and the same first numbers, as the time that instruments write for each signal.

    Of signals the same first numbers may be a rest before the motion.
    """
    first = table.head[:, columns] if table.head.size else np.full((1, 2), np.nan)
    return len({table.names[c] for c in columns}) == 1 and bool(np.all(first == first[:, :1]))


def _listing(table: Table) -> str:
    shown = ", ".join(_heading(table, i, begins=True) for i in range(min(table.width, LISTED)))
    more = table.width - LISTED
    shown = f"there {'is' if table.width == 1 else 'are'} {shown}"
    return shown + (f" and {more} more: are the signals in rows? Transpose them" if more > 0 else "")


def _heading(table: Table, index: int, begins: bool = False) -> str:
    """A column as an error names it: by its name, if it has one, else, or if asked for, by its first values."""
    values = table.head[:3, index] if table.head.size and (begins or not table.names) else ()
    first = f" (begins {', '.join(f'{v:g}' for v in values)})" if len(values) else ""
    if not table.names:
        return f"column {index + 1}{first}"
    unit = f" ({table.units[index]})" if table.units[index] not in ("", table.names[index]) else ""
    return f"column {index + 1} {table.names[index]!r}{unit}{first}"


def _column(source: str, table: Table, wanted: Wanted, index: int, taken: set[int]) -> Column:
    heading, stated = (table.names[index], table.units[index]) if table.names else (f"column {index + 1}", "")
    foreign = stated and stated not in wanted.units and (wanted.certain or is_unit(stated) or stated.lower() in OTHERS)
    if wanted.unit is None and foreign:
        reason = f"{wanted.role}: {_heading(table, index)} is in {stated}; {wanted.role} is in "
        scale = {"displacement": "um", "volts": "" if wanted.certain else "V"}.get(wanted.role)
        help_ = f"; `{wanted.role}_scale` says how many {scale} one of them is" if scale else ""
        raise RecordError(source, reason + " or ".join(filter(None, wanted.units)) + help_)
    used = stated if wanted.unit is None else unit(wanted.unit)
    known = used in wanted.units
    of_file = stated if is_unit(stated) else ""
    other = stated if foreign and stated.lower() in OTHERS else ""
    free = () if wanted.key is not None else (i for i, u in enumerate(table.units) if u in wanted.units)
    besides = tuple(table.names[i] for i in free if i not in taken)
    read_in = used if known else next(iter(wanted.units))
    return Column(heading, read_in, known, of_file, wanted.unit is not None, other, besides)


def refuse_bad_rows(source: str, signals: Mapping[str, FloatArray], table: Table, remedy: str = "") -> None:
    """RecordError for the first row with a value that is no finite number; `remedy` is the advice."""
    for role, signal in signals.items():
        bad = ~np.isfinite(signal)
        if bad.any():
            number, text = table.locate(first := int(np.argmax(bad)))
            shown = f" in {text}" if text else ""
            reason = f"{role} is {'missing or no number' if np.isnan(signal[first]) else 'infinite'}{shown}"
            raise RecordError(source, reason + (formats.thousands(text) or remedy), number, table.where)


def even_rate(path: str | Path, table: Table, times: FloatArray | None, sample_rate: float | None = None) -> float:
    """Sample rate of even times, Hz; the given one where there are no times."""
    if times is None:
        return checks.positive("sample_rate", sample_rate, "Hz")
    if sample_rate is not None:
        checks.positive("sample_rate", sample_rate, "Hz")
    if times.size < 2:
        raise RecordError(str(path), f"{times.size} rows; two at least have a sample rate")
    tick = (times[-1] - times[0]) / (times.size - 1)
    if not tick > 0:
        raise _uneven(path, table, times, times.size - 1, f"above {times[0]} s")
    even = times[0] + tick * np.arange(times.size)
    off = np.abs(times - even)
    worst = int(np.argmax(off))
    if off[worst] > TIME_TOLERANCE * tick:
        raise _uneven(path, table, times, worst, f"{even[worst]:g} s, as even times are")
    if sample_rate is None:
        return float(round(1 / tick, 6))
    if abs(sample_rate * tick - 1) > TIME_TOLERANCE / times.size:
        raise SettingError("sample_rate", sample_rate, f"{1 / tick:g} Hz, as the times of {path}", "Hz")
    return float(sample_rate)


def _uneven(path: str | Path, table: Table, times: FloatArray, row: int, bound: str) -> RecordError:
    return RecordError(str(path), f"time is {times[row]:.9g} s: must be {bound}", table.locate(row)[0], table.where)
