"""A table in a text: its layout is found, its numbers are read chunk by chunk."""

import csv
import itertools
import math
import re
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TextIO

import numpy as np

from truestroke.base import files
from truestroke.base.typing import FloatArray
from truestroke.signals import formats
from truestroke.signals.tables import instruments
from truestroke.signals.tables.arrays import READERS
from truestroke.signals.tables.headings import names_and_units, stated_units
from truestroke.signals.tables.marks import of_blanks, two_marks
from truestroke.signals.tables.table import PROBE, RecordError, Table

CHUNK = 1 << 20  # characters of text that are parsed at a time
COMMENTS = ("#", "%")
NUMBER_WITH_D = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)[dD][+-]?\d+")
DATE_AND_TIME = re.compile(r"\d{4}([-/])\d\d\1\d\d(?:[T ]\d\d:\d\d|$)")  # of a date alone, 0:00
DOTTED_DATE = re.compile(
    r"(\d\d?)\.(\d\d?)\.(\d{4})(?:[T ]+(\d\d?:\d\d(?::\d\d(?:[.,]\d+)?)?))?"
)  # 31.12.2026 13:45:00,5
TIME_OF_DAY = re.compile(r"(\d\d?):(\d\d):(\d\d(?:\.\d+|:\d{3})?)")  # 13:45:00.5, 13:45:00:500
OF_GCS = re.compile(r"#\s*(NAME\d+|SAMPLE_TIME)\s*=\s*(.*?)\s*$")
BEFORE = 50  # rows, with which the last number of a text is compared
SLASHED_DATE = re.compile(r"\d\d?/\d\d?/\d{4}")


@dataclass(frozen=True)
class _Layout:
    """How a text is written: encoding, separator (None: white space), decimal comma, lines before the numbers.

    `width`: number of columns, where it is known; cells behind them are empty.
    """

    path: Path
    encoding: str
    separator: str | None
    comma: bool
    lines_before: int
    width: int = 0

    def open(self) -> TextIO:
        return self.path.open(encoding=self.encoding, errors="replace")

    def plain(self, line: str) -> str:
        """With decimal points; beside decimal commas a point is a mark between thousands, which is no number."""
        if not self.comma:
            return line
        if "." in line and not DOTTED_DATE.search(line):
            line = line.replace(".", "'")
        return line.replace(",", ".")

    def fields(self, line: str) -> list[str]:
        if not self.width:
            cells = self.cells(line.strip())
            return cells[:-1] if len(cells) > 1 and not cells[-1] else cells
        cells = self.cells(line)
        return cells[: max(self.width, _filled(cells))]

    def cells(self, line: str) -> list[str]:
        """All of them, those behind the last number, too."""
        text = self.plain(line).lstrip().rstrip(" \r\n" if self.separator else None)
        quoted = self.separator and '"' in text
        split = next(csv.reader([text], delimiter=self.separator or ",")) if quoted else text.split(self.separator)
        return [field.strip().strip('"') for field in split]


def _filled(cells: Sequence[str]) -> int:
    """How many there are up to the last that is not empty."""
    return next((k for k in range(len(cells), 0, -1) if cells[k - 1]), 0)


def _is_row(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(COMMENTS)


def read_text(path: Path, narrowest: int) -> Table:
    """The table in a text of `narrowest` columns or more."""
    encoding = _encoding(path)
    with path.open(encoding=encoding, errors="replace") as file:
        lines = list(itertools.islice(file, PROBE))
    if table := _of_tds(path, encoding, lines):
        return table
    layout = _layout(path, encoding, lines, narrowest)
    rows = [line for line in lines[layout.lines_before :] if _is_row(line)]
    if layout.separator == ",":
        _refuse_mixed(layout, lines)
    _refuse_two_marks(path, lines, 0)
    width = len(layout.fields(rows[0]))
    above = lines[: layout.lines_before]
    if found := _general_command_set(above, width):
        names, step = found
        return _timed(layout, *names_and_units(names), step)
    names, units = _header(path, layout, above, width)
    if names:
        units = stated_units(units, map(_is_moment, layout.fields(rows[0])))
    cells = [layout.fields(re.sub(r"^\s*[#%]+", "", line)) for line in above if line.strip(" \t\r\n#%")]
    if stated := instruments.stated(cells, names, units, width):
        names, units = stated.names, stated.units
        if stated.step:
            return _timed(layout, names, units, stated.step, stated.replaces)
    head = _parse_slowly(rows, layout, range(width))
    if not names:
        _refuse_split(path, layout, above, head)
    return Table(names, units, head, partial(_columns, layout), partial(_locate, layout), "line")


def _general_command_set(above: Sequence[str], width: int) -> tuple[tuple[str, ...], float] | None:
    """Names and sample time, s, of an array in a file of a PI controller (GCS), whose header has both.

    Examples
    --------
    >>> _general_command_set(["# SAMPLE_TIME = 0.0005", "# NAME0 = Voltage", "# NAME1 = Position"], 2)
    (('Voltage', 'Position'), 0.0005)
    """
    stated = {match[1]: match[2] for line in above if (match := OF_GCS.match(line))}
    names = [stated.get(f"NAME{k}") for k in range(width)]
    step = _number(stated.get("SAMPLE_TIME", ""))
    return (tuple(map(str, names)), step) if all(names) and step > 0 else None


def _of_tds(path: Path, encoding: str, lines: Sequence[str]) -> Table | None:
    """The table of a text whose header is in columns of its own, beside the first rows; None where it is none."""
    if not lines or not lines[0].lstrip('" ').lower().startswith(instruments.FIRST_OF_TDS):
        return None
    layout = _Layout(path, encoding, _separator(lines[0]), False, 0)
    cells = [layout.cells(line) for line in lines if _is_row(line)]
    width = _filled(cells[0])
    stated = instruments.beside(cells, width)
    if stated is None:
        return None
    layout = replace(layout, width=width)
    head = _parse_slowly(lines, layout, range(width))
    return Table(stated.names, stated.units, head, partial(_columns, layout), partial(_locate, layout), "line")


def _timed(
    layout: _Layout, names: tuple[str, ...], units: tuple[str, ...], step: float, replaces: bool = False
) -> Table:
    """A table with a time that the file has in its header alone: s from row to row.

    It is a further column, behind those of the file, whose numbers stay, or replaces the first.
    """
    place = 0 if replaces else len(names)

    def read(columns: Sequence[int], complete: bool) -> list[FloatArray]:
        wanted = [c for c in columns if c != place] or [1 if replaces else 0]
        held = dict(zip(wanted, _columns(layout, wanted, complete), strict=True))
        time = step * np.arange(held[wanted[0]].size, dtype=np.float64)
        return [time if c == place else held[c] for c in columns]

    if not replaces:
        names, units = (*names, "time"), (*units, "s")
    return Table(names, units, np.zeros((0, 0)), read, partial(_locate, layout), "line")


def _refuse_split(path: Path, layout: _Layout, above: Sequence[str], head: FloatArray) -> None:
    """RecordError where names stand above twice as many whole numbers: decimal commas between commas."""
    lines = [layout.fields(line) for line in above if _is_row(line)] if layout.separator == "," else []
    names: list[str] = next((line for line in reversed(lines) if all(math.isnan(_number(f)) for f in line)), [])
    # the rows may have whole numbers, and so fewer commas; a column with decimal points may stand beside the others
    whole = int(((head == np.round(head)) | np.isnan(head)).all(axis=0).sum())
    if 1 < len(names) < head.shape[1] <= 2 * len(names) and whole >= 2 * (head.shape[1] - len(names)):
        reason = f"{len(names)} names stand above {whole} whole numbers: are they decimal commas between commas?"
        raise RecordError(str(path), f"{reason} Write decimal points, or export with ; between the columns")


def _encoding(path: Path) -> str:
    """Enough for a micro sign in the names: the numbers are the same in all of them."""
    with path.open("rb") as file:
        start = file.read(1 << 16)
    if b"\0" in start and not start.startswith((b"\xff\xfe", b"\xfe\xff")):
        if encoding := formats.wide(start):
            return encoding
        raise RecordError(str(path), f"this is no text; known endings are .csv, .txt, {', '.join(READERS)}")
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        start[: start.rfind(b"\n") + 1].decode("utf-8-sig")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _layout(path: Path, encoding: str, lines: Sequence[str], narrowest: int) -> _Layout:
    """The first two rows with nothing but numbers or gaps, and as many columns in each, begin the table."""
    previous, before = 0, 0
    for number, line in enumerate(lines):
        if not _is_row(line):
            continue
        separator = _separator(line)
        comma = separator in (";", "\t") and "," in line and "." not in DOTTED_DATE.sub("", line)
        if separator == "," and formats.DECIMAL_COMMAS.fullmatch(line.strip()):
            separator, comma = None, True
        layout = _Layout(path, encoding, separator, comma, before)
        fields = layout.fields(line)
        width = len(fields) if len(fields) >= narrowest and _numeric(fields) else 0
        if width and width == previous:
            return _from_the_first(_of_blanks(layout, lines), lines)
        previous, before = width, number
    shown = f"; line {len(lines)} is {_shown(lines[-1])}" if lines else ""
    columns = "the same number of columns, two or more" if narrowest > 1 else "the same number of columns"
    if not any(map(str.strip, lines)):
        raise RecordError(str(path), "the file is empty: was its program ended before it wrote?")
    _refuse_two_marks(path, lines, 0)
    reason = f"no two rows of numbers with {columns}, in the first {PROBE} lines"
    rows = list(filter(_is_row, lines))
    if narrowest > 1 and rows and not math.isnan(_number(rows[-1].strip())):
        shown += "; it is one number: put voltage and displacement side by side in one file"
        raise RecordError(str(path), reason + shown)
    marks = next(filter(None, map(formats.thousands, lines)), "")
    shown += marks or formats.unreadable(lines[-1].strip() if lines else "")
    if any(SLASHED_DATE.search(line) for line in lines):
        shown += "; dates such as 03/04/2026 may be of two days: write 2026-04-03, or leave out the column"
    raise RecordError(str(path), reason + shown)


def _separator(line: str) -> str | None:
    """Between the cells of a row; None for white space, as of tabs beside blanks."""
    separator = next((s for s in (";", "\t", ",") if s in line), None)
    if separator == "\t" and of_blanks([line]) and "," not in line and _numeric(line.split()):
        return None
    return separator


def _of_blanks(layout: _Layout, lines: Sequence[str]) -> _Layout:
    """The same for white space, where tabs separate some rows and blanks others."""
    if layout.separator != "\t" or layout.comma:
        return layout
    rows = [line for line in lines[layout.lines_before :] if _is_row(line)]
    return replace(layout, separator=None) if of_blanks(rows) else layout


def _from_the_first(layout: _Layout, lines: Sequence[str]) -> _Layout:
    """The same with its width, and the rows before that lack their last numbers; separators may end each row."""
    if layout.separator is None:
        return layout
    rows = [layout.cells(line) for line in lines[layout.lines_before :] if _is_row(line)]
    most = statistics.mode(map(len, rows))
    start = layout.lines_before
    while start and _is_row(lines[start - 1]) and len(row := layout.cells(lines[start - 1])) == most and _numeric(row):
        start -= 1
    names = layout.cells(lines[start - 1]) if start else []
    named = _filled(names) if all(math.isnan(_number(name)) for name in names) else 0
    width = max(_filled(row) for row in rows if len(row) == most)
    return replace(layout, lines_before=start, width=max(width, named if named <= most else 0))


def _header(path: Path, layout: _Layout, lines: Sequence[str], width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units from the line above the numbers, or from two lines: names, then units alone."""
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line.strip(" \t\r\n#%")]
    texts = [re.sub(r"^\s*[#%]+", "", line).rstrip("\r\n") for _, line in numbered]
    above = [_titles(layout, text, width) for text in texts]
    if not above or len(above[-1]) != width:
        return (), ()
    last = above[-1]
    if not all(math.isnan(_number(field)) for field in last):
        number, line = numbered[-1]
        reason = f"{_shown(line)} is neither names nor numbers only; begin such a line with #, or leave it out"
        raise RecordError(str(path), reason + formats.unreadable(line, ""), number, "line")
    return names_and_units(last, above[-2] if len(above) > 1 and len(above[-2]) == width else ())


def _titles(layout: _Layout, text: str, width: int) -> list[str]:
    """The cells of a line above `width` columns; LabVIEW names one more, of comments."""
    fields = layout.fields(text)
    if len(fields) == width + 1 and fields[-1].lower() in ("", "comment"):
        return fields[:-1]
    if layout.separator is None and len(fields) != width:  # white space also before the unit, or in names: drive (mV)
        ways = (re.split(between, text.strip()) for between in (r"\s+(?![(\[])", r"\s{2,}|\t"))
        return next(([name.strip('"') for name in names] for names in ways if len(names) == width), fields)
    return fields


def _columns(layout: _Layout, columns: Sequence[int], complete: bool) -> list[FloatArray]:
    """Parse chunk by chunk into arrays of the final size, so that no more than a chunk of text is ever in memory."""
    length = _count_lines(layout.path)
    files.check_size(layout.path, f"{length} lines of {len(columns)} columns", 8 * length * len(columns))
    table = np.empty((len(columns), length))
    rows = 0
    with layout.open() as file:
        for _ in range(layout.lines_before):
            next(file)
        passed = layout.lines_before
        while lines := file.readlines(CHUNK):
            if layout.separator == "," and layout.width:
                _refuse_more(layout, lines, passed)
            passed += len(lines)
            block = _parse(lines, layout, columns)
            if not np.isfinite(block).all():
                _refuse_two_marks(layout.path, lines, passed - len(lines))
            table[:, rows : rows + len(block)] = block.T
            rows += len(block)
            if not complete and not np.isfinite(block).all():
                break
            if _is_cut(layout, lines):
                table[:, rows - 1] = np.nan
    return list(table[:, :rows])


def _refuse_two_marks(path: Path, lines: Sequence[str], passed: int) -> None:
    """RecordError for decimal commas in some rows and points in others: without the one kind half of the motion is."""
    if reason := two_marks((number, line) for number, line in enumerate(lines, passed + 1) if _is_row(line)):
        raise RecordError(str(path), f"{reason}: write decimal points in all rows")


def _refuse_more(layout: _Layout, lines: Sequence[str], passed: int) -> None:
    """RecordError for a row between commas that has more numbers than there are columns: it has decimal commas.

    Its columns would be others: of 2,5 the 5 is one more. `passed`: lines of the file before these.
    """
    counts = [line.count(",") for line in lines]
    usual = statistics.mode(counts[:PROBE])
    for number, (line, count) in enumerate(zip(lines, counts, strict=True), passed + 1):
        if count > usual and _is_row(line):
            _refuse_wider(layout, line, number, layout.width)


def _refuse_mixed(layout: _Layout, lines: Sequence[str]) -> None:
    """The same at the beginning of a text, where some rows have as many numbers as there are names, and others more."""
    before = [line for line in lines[: layout.lines_before] if _is_row(line)]
    names = layout.fields(before[-1]) if before else []
    rows = [(k, line) for k, line in enumerate(lines, 1) if k > layout.lines_before and _is_row(line)]
    named = len(names) > 1 and all(math.isnan(_number(name)) for name in names)
    if named and any(_filled(layout.cells(line)) == len(names) for _, line in rows):
        for number, line in rows:
            _refuse_wider(layout, line, number, len(names))


def _refuse_wider(layout: _Layout, line: str, number: int, width: int) -> None:
    cells = layout.cells(line)
    cells = cells[: _filled(cells)]
    if len(cells) > width and not any(math.isnan(_number(cell)) for cell in cells):
        reason = f"{_shown(line)} has {len(cells)} numbers, the columns are {width}: are there decimal commas between "
        reason += "commas? Write decimal points in all rows, or export with ; between the columns"
        raise RecordError(str(layout.path), reason, number, "line")


def _is_cut(layout: _Layout, lines: Sequence[str]) -> bool:
    """Whether a text ends within its last number, as of a program that was ended or a disk that was full.

    No end of a line is behind it, and it has fewer digits than in any row before: behind the point, with an exponent.
    """
    if lines[-1].endswith("\n") or not _is_row(lines[-1]):
        return False
    last, *before = (layout.fields(line)[-1] for line in list(filter(_is_row, lines))[: -BEFORE - 2 : -1])
    return bool(before) and _written(last) < min(map(_written, before))


def _written(number: str) -> int:
    """Characters of a number behind its point, or of all of it.

    >>> _written("12.34e-01"), _written("12"), _written("-12")
    (6, 2, 2)
    """
    whole, point, behind = number.partition(".")
    return len(behind) if point else len(whole.lstrip("+-"))


def _count_lines(path: Path) -> int:
    with path.open("rb") as file:
        return 1 + sum(chunk.count(b"\n") or chunk.count(b"\r") for chunk in iter(lambda: file.read(1 << 20), b""))


def _parse(lines: Sequence[str], layout: _Layout, columns: Sequence[int]) -> FloatArray:
    if not any(map(_is_row, lines[:3])):  # loadtxt warns of nothing to read
        lines = list(filter(_is_row, lines))
        if not lines:
            return np.empty((0, len(columns)))
    if any(".#" in line for line in lines):  # -1.#IND is no number; loadtxt would read -1 before a comment
        return _parse_slowly(lines, layout, columns)
    plain = map(layout.plain, lines) if layout.comma else lines
    try:
        return np.loadtxt(plain, delimiter=layout.separator, usecols=columns, quotechar='"', ndmin=2)
    except ValueError:
        return _parse_slowly(lines, layout, columns)


def _parse_slowly(lines: Sequence[str], layout: _Layout, columns: Sequence[int]) -> FloatArray:
    """With NaN for what is missing or no number."""
    rows = [layout.fields(line) for line in lines if _is_row(line)]
    values = [[_number(row[c]) if c < len(row) else math.nan for c in columns] for row in rows]
    return np.array(values, dtype=np.float64).reshape(len(values), len(columns))


def _number(field: str) -> float:
    """Of a number, with Fortran's exponent D too; of a date and time, s since 1970 (UTC if not said).

    Dates as in ISO 8601, also with / in place of -, or as 31.12.2026 13:45:00; of a time of day, s since midnight.
    """
    try:
        return float(field)
    except ValueError:
        if NUMBER_WITH_D.fullmatch(field):
            return float(re.sub("[dD]", "e", field))
        if dotted := DOTTED_DATE.fullmatch(field):
            day, month, year, time = dotted.groups()
            return _seconds(f"{year}-{int(month):02}-{int(day):02}T{(time or '00:00').replace(',', '.').zfill(5)}")
        if clock := TIME_OF_DAY.fullmatch(field):
            return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3].replace(":", "."))
        return _seconds(field) if DATE_AND_TIME.match(field) else math.nan


def _is_moment(field: str) -> bool:
    return bool(DOTTED_DATE.fullmatch(field) or TIME_OF_DAY.fullmatch(field) or DATE_AND_TIME.match(field))


def _seconds(stamp: str) -> float:
    try:
        moment = datetime.fromisoformat(stamp.replace("/", "-"))
    except ValueError:
        return math.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _numeric(fields: Sequence[str]) -> bool:
    """Numbers only; some may be missing."""
    missing = [math.isnan(_number(field)) for field in fields]
    return not all(missing) and all(f.lower() in ("", "nan") for f, gone in zip(fields, missing, strict=True) if gone)


def _locate(layout: _Layout, index: int) -> tuple[int, str]:
    with layout.open() as file:
        lines = itertools.islice(enumerate(file, 1), layout.lines_before, None)
        number, line = next(itertools.islice((numbered for numbered in lines if _is_row(numbered[1])), index, None))
    return number, _shown(line)


def _shown(line: str) -> str:
    text = line.strip(" \r\n")
    return repr(text if len(text) <= 60 else text[:57] + "...")
