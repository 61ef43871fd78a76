"""Files with columns: opened as a `Table` of names and units, from which the columns that are wanted are then read."""

import csv
import importlib
import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, TextIO, TypeVar

import numpy as np
import numpy.typing as npt

from truestroke.base import files, hdf5, npz
from truestroke.base.typing import FloatArray
from truestroke.signals import formats

P = ParamSpec("P")
R = TypeVar("R")
CHUNK = 1 << 20  # characters of text that are parsed at a time
PROBE = 200  # lines of text that are looked at to find the layout
COMMENTS = ("#", "%")
NUMBER_WITH_D = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)[dD][+-]?\d+")
DATE_AND_TIME = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
DOTTED_DATE = re.compile(
    r"(\d\d?)\.(\d\d?)\.(\d{4})(?:[T ]+(\d\d?:\d\d(?::\d\d(?:[.,]\d+)?)?))?"
)  # 31.12.2026 13:45:00,5
TIME_OF_DAY = re.compile(r"(\d\d?):(\d\d):(\d\d(?:\.\d+)?)")
SLASHED_DATE = re.compile(r"\d\d?/\d\d?/\d{4}")
ELSEWHERE = {
    ".xls": ".xlsx or .csv",
    ".ods": ".xlsx or .csv",
    ".tdm": ".tdms or .csv",
    ".mf4": ".csv or .h5",
    ".mdf": ".csv or .h5",
}


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
        The first rows of a file without names; empty where there are names.
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


def open_table(path: Path, narrowest: int = 2) -> Table:
    """The table in a file, by its ending: .npz, .mat, .parquet, .feather, .h5, .hdf5, .xlsx, .tdms; else it is text.

    A text has `narrowest` columns or more.
    """
    if not path.is_file():
        raise FileNotFoundError(2, "no such file", str(path))
    ending = path.suffix.lower()
    if ending in ELSEWHERE:
        raise RecordError(str(path), f"{ending} is not read; save or export it as {ELSEWHERE[ending]}")
    if reason := formats.other(path):
        raise RecordError(str(path), f"this is {reason}")
    table = _guarded(path, READERS.get(ending, partial(_text, narrowest=narrowest)))(path)
    return replace(table, read=_guarded(path, table.read), locate=_guarded(path, table.locate))


def _guarded(path: Path, function: Callable[P, R]) -> Callable[P, R]:
    """It raises a RecordError for every error of its library at a damaged file."""

    def guarded(*arguments: P.args, **options: P.kwargs) -> R:
        with files.reading(path, lambda reason: RecordError(str(path), reason)):
            return function(*arguments, **options)

    return guarded


# ---- Text ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Layout:
    """How a text is written: encoding, separator (None: white space), decimal comma, lines before the numbers."""

    path: Path
    encoding: str
    separator: str | None
    comma: bool
    lines_before: int

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
        text = self.plain(line).strip()
        quoted = self.separator and '"' in text
        split = next(csv.reader([text], delimiter=self.separator or ",")) if quoted else text.split(self.separator)
        fields = [field.strip().strip('"') for field in split]
        return fields[:-1] if len(fields) > 1 and not fields[-1] else fields


def _is_row(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(COMMENTS)


def _text(path: Path, narrowest: int) -> Table:
    encoding = _encoding(path)
    with path.open(encoding=encoding, errors="replace") as file:
        lines = list(itertools.islice(file, PROBE))
    layout = _layout(path, encoding, lines, narrowest)
    rows = [line for line in lines[layout.lines_before :] if _is_row(line)]
    width = len(layout.fields(rows[0]))
    names, units = _header(path, layout, lines[: layout.lines_before], width)
    if names:
        units = _stated(units, map(_is_moment, layout.fields(rows[0])))
    head = np.zeros((0, 0)) if names else _parse_slowly(rows, layout, range(width))
    _refuse_split(path, layout, lines[: layout.lines_before], head)
    return Table(names, units, head, partial(_read_text, layout), partial(_locate, layout), "line")


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
        separator = next((s for s in (";", "\t", ",") if s in line), None)
        comma = separator in (";", "\t") and "," in line and "." not in DOTTED_DATE.sub("", line)
        if separator == "," and formats.DECIMAL_COMMAS.fullmatch(line.strip()):
            separator, comma = None, True
        layout = _Layout(path, encoding, separator, comma, before)
        fields = layout.fields(line)
        width = len(fields) if len(fields) >= narrowest and _numeric(fields) else 0
        if width and width == previous:
            return layout
        previous, before = width, number
    shown = f"; line {len(lines)} is {_shown(lines[-1])}" if lines else ""
    columns = "the same number of columns, two or more" if narrowest > 1 else "the same number of columns"
    reason = f"no two rows of numbers with {columns}, in the first {PROBE} lines"
    shown += next(filter(None, map(formats.thousands, lines)), "")
    if any(SLASHED_DATE.search(line) for line in lines):
        shown += "; dates such as 03/04/2026 may be of two days: write 2026-04-03, or leave out the column"
    raise RecordError(str(path), reason + shown)


def _header(path: Path, layout: _Layout, lines: Sequence[str], width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units from the line above the numbers, or from two lines: names, then units alone."""
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line.strip(" \t\r\n#%")]
    texts = [re.sub(r"^\s*[#%]+", "", line).strip() for _, line in numbered]
    above = [layout.fields(text) for text in texts]
    if layout.separator is None and above and len(above[-1]) != width:  # white space also before the unit: z (mm)
        above[-1] = [field.strip('"') for field in re.split(r"\s+(?![(\[])", texts[-1])]
    if not above or len(above[-1]) != width:
        return (), ()
    last = above[-1]
    if not all(math.isnan(_number(field)) for field in last):
        number, line = numbered[-1]
        raise RecordError(str(path), f"{_shown(line)} is neither names nor numbers only", number, "line")
    alone = [field.strip("()[] ") for field in last]
    if len(above) > 1 and len(above[-2]) == width and all(map(is_unit, alone)):
        return tuple(above[-2]), tuple(map(unit, alone))
    names, units = zip(*map(name_and_unit, last), strict=True)
    return names, units


def _read_text(layout: _Layout, columns: Sequence[int], complete: bool) -> list[FloatArray]:
    """Parse chunk by chunk into arrays of the final size, so that no more than a chunk of text is ever in memory."""
    length = _count_lines(layout.path)
    files.check_size(layout.path, f"{length} lines of {len(columns)} columns", 8 * length * len(columns))
    table = np.empty((len(columns), length))
    rows = 0
    with layout.open() as file:
        for _ in range(layout.lines_before):
            next(file)
        while lines := file.readlines(CHUNK):
            block = _parse(lines, layout, columns)
            table[:, rows : rows + len(block)] = block.T
            rows += len(block)
            if not complete and not np.isfinite(block).all():
                break
    return list(table[:, :rows])


def _count_lines(path: Path) -> int:
    with path.open("rb") as file:
        return 1 + sum(chunk.count(b"\n") or chunk.count(b"\r") for chunk in iter(lambda: file.read(1 << 20), b""))


def _parse(lines: Sequence[str], layout: _Layout, columns: Sequence[int]) -> FloatArray:
    if not any(map(_is_row, lines[:3])):  # loadtxt warns of nothing to read
        lines = list(filter(_is_row, lines))
        if not lines:
            return np.empty((0, len(columns)))
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

    Dates as in ISO 8601 or as 31.12.2026 13:45:00; of a time of day, s since midnight.
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
            return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3])
        return _seconds(field) if DATE_AND_TIME.match(field) else math.nan


def _stated(units: Sequence[str], moments: Iterable[bool]) -> tuple[str, ...]:
    """The units, and s of dates and times of the day, which are read as seconds."""
    return tuple("s" if moment and not unit else unit for unit, moment in zip(units, moments, strict=True))


def _is_moment(field: str) -> bool:
    return bool(DOTTED_DATE.fullmatch(field) or TIME_OF_DAY.fullmatch(field) or DATE_AND_TIME.match(field))


def _seconds(stamp: str) -> float:
    try:
        moment = datetime.fromisoformat(stamp)
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
    text = line.strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")


# ---- Names and units -----------------------------------------------------------------------------------------------

UNITS: Mapping[str, Mapping[str, float]] = {
    "volts": {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "displacement": {"um": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
}
"""What one of each unit is in V, um and s."""

OTHERS = ("rad", "mrad", "urad", "nrad", "deg", "°", "arcsec", "arcmin", "pm", "å", "angstrom", "inch", "mil", "counts")
"""Further units, in lower case, that a column is not read in."""

_SPELLINGS = {"V": ("v", "volt", "volts"), "um": ("micron", "microns"), "s": ("sec", "second", "seconds")}


_CYRILLIC = str.maketrans("\u043c\u043d\u0441\u0412\u043a", "mnsVk")


def unit(text: str) -> str:
    """A unit as `UNITS` spells it, also of Greek and Cyrillic letters.

    Examples
    --------
    >>> unit("µm"), unit("Volts"), unit("mV"), unit("мкм")
    ('um', 'V', 'mV', 'um')
    """
    text = text.strip().replace("µ", "u").replace("\u03bc", "u").replace("\u043c\u043a", "u").translate(_CYRILLIC)
    return next((usual for usual, others in _SPELLINGS.items() if text.lower() in others), text)


def is_unit(text: str) -> bool:
    """Whether `UNITS` has it."""
    return any(unit(text) in units for units in UNITS.values())


def name_and_unit(text: str) -> tuple[str, str]:
    """Name and unit of a column from its heading.

    Examples
    --------
    >>> name_and_unit("z (µm)"), name_and_unit("Drive [mV]"), name_and_unit("time_s"), name_and_unit("CH1")
    (('z', 'um'), ('Drive', 'mV'), ('time', 's'), ('CH1', ''))
    """
    text = text.strip()
    if match := re.fullmatch(r"(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]", text):
        return match[1] or match[2], unit(match[2])
    match = re.fullmatch(r"(.+?)\s*[_/, ]\s*([^_/, ]+)", text)
    if match and is_unit(match[2]) and unit(match[2]) != "m":  # z_m is more often "measured" than metres
        return match[1], unit(match[2])
    return text, unit(text) if is_unit(text) and text != "m" else ""


# ---- Arrays --------------------------------------------------------------------------------------------------------


def _arrays(path: Path, names: Sequence[str], units: Sequence[str], get: Callable[[str], npt.NDArray[Any]]) -> Table:
    """A table of arrays by name, one column each; one array with two axes is a table without names."""
    if len(names) == 1 and (whole := get(names[0]).squeeze()).ndim == 2 and whole.dtype.kind in "iuf":
        head = whole[:PROBE].astype(np.float64)
        return Table((), (), head, lambda columns, _: [_floats(whole[:, c]) for c in columns])

    def read(columns: Sequence[int], _: bool) -> list[FloatArray]:
        arrays = [get(names[c]).squeeze() for c in columns]
        for c, array in zip(columns, arrays, strict=True):
            if array.ndim != 1 or array.dtype.kind not in "iufMm":
                kind = f"an array of shape {array.shape}" if array.dtype.kind in "iuf" else f"of type {array.dtype}"
                raise RecordError(str(path), f"{names[c]} is {kind}, not a row of numbers")
            if array.size != arrays[0].size:
                reason = f"{names[columns[0]]} has {arrays[0].size} rows, but {names[c]} has {array.size}"
                raise RecordError(str(path), reason)
        return [_floats(array) for array in arrays]

    split = [name_and_unit(name) for name in names]
    known = tuple(stated or found for stated, (_, found) in zip(units, split, strict=True))
    return Table(tuple(name for name, _ in split), known, np.zeros((0, 0)), read)


def _floats(array: npt.NDArray[Any]) -> FloatArray:
    """Numbers; times and dates as s from the first."""
    if array.dtype.kind in "Mm":
        return np.asarray((array - array[:1]) / np.timedelta64(1, "s"), dtype=np.float64)
    return np.array(array, dtype=np.float64, order="C")


def _npz(path: Path) -> Table:
    def wrong(reason: str) -> RecordError:
        return RecordError(str(path), f"not an NPZ file, or a damaged one: {reason}")

    names = npz.names(path, wrong)
    units = _stated([""] * len(names), npz.moments(path, names, wrong))
    return _arrays(path, names, units, lambda name: npz.read(path, [name], wrong)[name])


def _npy(path: Path) -> Table:
    """A matrix, or an array with named fields."""
    whole = np.load(path, allow_pickle=False)
    if whole.dtype.names:
        names = whole.dtype.names
        units = _stated([""] * len(names), [whole.dtype[name].kind in "Mm" for name in names])
        return _arrays(path, names, units, lambda name: whole[name])
    return _arrays(path, ["array"], [""], lambda _: whole)


def _mat(path: Path) -> Table:
    import h5py
    from scipy.io import loadmat, whosmat

    if h5py.is_hdf5(path):  # MATLAB 7.3
        return _hdf5(path)
    files.check_size(path, "its variables", sum(8 * math.prod(shape) for _, shape, _ in whosmat(path)))
    held = _flat({name: v for name, v in loadmat(path, simplify_cells=True).items() if not name.startswith("__")})
    return _arrays(path, list(held), [""] * len(held), lambda name: np.asarray(held[name]))


def _flat(held: Mapping[str, Any], group: str = "") -> dict[str, Any]:
    """Fields of structs by names such as "run/u"."""
    flat: dict[str, Any] = {}
    for name, value in held.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{group}{name}/")
        elif not isinstance(value, list):  # a cell array
            flat[group + name] = value
    return flat


def _hdf5(path: Path) -> Table:
    """Every dataset, also those in groups; the attribute "unit" or "units" is its unit, as in recordings."""
    import h5py

    if not h5py.is_hdf5(path):
        raise RecordError(str(path), "not an HDF5 file")
    found: dict[str, str] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf":
            found[name] = unit(str(item.attrs.get("unit", item.attrs.get("units", ""))))

    def get(name: str) -> npt.NDArray[Any]:
        with hdf5.opened(path) as file:
            files.check_size(path, name, file[name].nbytes)
            return np.asarray(file[name][()])

    with hdf5.opened(path) as file:
        marked = file.attrs.get("format") == hdf5.FORMAT
        if not hdf5.intact(file):
            raise RecordError(str(path), "the file is damaged (the checksum of what describes it is wrong)")
        file.visititems(note)
    return replace(_arrays(path, list(found), list(found.values()), get), marked=marked)


def _library(path: Path, module: str, kind: str, extra: str) -> Any:
    """A library that an extra installs."""
    try:
        return importlib.import_module(module)
    except ImportError:
        library = module.split(".")[0]
        raise RecordError(str(path), f'reading {kind} needs {library}: pip install "truestroke[{extra}]"') from None


def _parquet(path: Path) -> Table:
    parquet = _library(path, "pyarrow.parquet", "Parquet", "parquet")
    schema = parquet.read_schema(path)
    names = list(schema.names)
    rows = int(parquet.read_metadata(path).num_rows)
    files.check_size(path, f"a column of {rows} rows", 8 * rows)

    def get(name: str) -> npt.NDArray[Any]:
        return np.asarray(parquet.read_table(path, columns=[name])[name].to_numpy())

    return _arrays(path, names, _of_types(schema), get)


def _of_types(schema: Any) -> list[str]:
    """Units that the types of Arrow's columns state: dates and times are read as seconds."""
    return ["s" if str(kind).startswith(("timestamp", "time", "duration", "date")) else "" for kind in schema.types]


def _feather(path: Path) -> Table:
    feather = _library(path, "pyarrow.feather", "Feather", "parquet")
    table = feather.read_table(path)
    names = list(table.column_names)
    return _arrays(path, names, _of_types(table.schema), lambda name: np.asarray(table[name].to_numpy()))


def _tdms(path: Path) -> Table:
    """Channels of all groups; where no channel is the time, the waveform's increment makes it."""
    nptdms = _library(path, "nptdms", "TDMS", "tdms")
    channels = [
        channel for group in nptdms.TdmsFile.read(path).groups() for channel in group.channels() if len(channel)
    ]
    held = {channel.name: np.asarray(channel[:]) for channel in channels}
    if len(held) < len(channels):
        held = {f"{channel.group_name}/{channel.name}": np.asarray(channel[:]) for channel in channels}
    stated = [next((str(c.properties[k]) for k in ("unit_string", "NI_UnitDescription") if c.properties.get(k)), "")
              for c in channels]  # fmt: skip
    steps = [channel.properties.get("wf_increment") for channel in channels]
    if not any(steps) or any(name_and_unit(name)[0].lower() in ("time", "t") for name in held):
        return _arrays(path, list(held), [unit(text) for text in stated], held.__getitem__)
    table = _arrays(path, ["time", *held], ["s", *map(unit, stated)], held.__getitem__)
    return replace(table, read=partial(_of_one_rate, path, table, steps))


def _of_one_rate(
    path: Path, table: Table, steps: Sequence[float | None], columns: Sequence[int], complete: bool
) -> list[FloatArray]:
    """Columns of a TDMS, the first of which is the time; those that are read must share their increment."""
    wanted = {c: steps[c - 1] for c in columns if c}
    if len(set(wanted.values())) > 1:
        each = ", ".join(f"{table.names[c]} every {s} s" for c, s in wanted.items())
        raise RecordError(str(path), f"its channels have different rates ({each}); export them at one")
    held = dict(zip(wanted, table.read(list(wanted), complete), strict=True))
    step = next(iter(wanted.values()), None)
    rows = next(iter(held.values())).size
    return [held[c] if c else _floats(float(step or math.nan) * np.arange(rows)) for c in columns]


def _xlsx(path: Path) -> Table:
    """The first sheet: the first two rows with numbers in the same cells, two at least, begin the table."""
    import zipfile

    openpyxl = _library(path, "openpyxl", "Excel", "excel")
    with zipfile.ZipFile(path) as parts:
        files.check_size(path, "its sheets", sum(part.file_size for part in parts.infolist()))
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    cells = [list(row) for row in book.worksheets[0].iter_rows(values_only=True)]
    book.close()
    numbers = [[_of_cell(cell) for cell in row] for row in cells]
    filled = [tuple(np.flatnonzero(~np.isnan(row))) for row in numbers]
    start = next((k for k in range(len(cells) - 1) if len(filled[k]) > 1 and filled[k] == filled[k + 1]), None)
    if start is None:
        raise RecordError(str(path), "the first sheet has no two rows with numbers in the same cells, two or more")
    places = filled[start]
    above = [[str(row[p]).strip() if p < len(row) and row[p] else "" for p in places] for row in cells[:start]]
    values = [[row[p] if p < len(row) else math.nan for p in places] for row in numbers[start:]]
    while values and np.isnan(values[-1]).all():
        values.pop()
    table = np.array(values, dtype=np.float64)
    names, units = _names_above(above)
    if names:
        units = _stated(units, [isinstance(cells[start][p], datetime) for p in places])
    head = np.zeros((0, 0)) if names else table[:PROBE]
    read = lambda columns, _: [table[:, c].copy() for c in columns]  # noqa: E731
    return Table(names, units, head, read, lambda index: (start + index + 1, ""))


def _names_above(above: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units from the row above the numbers, or from two: names, then units alone."""
    if not above or not all(above[-1]):
        return (), ()
    alone = [text.strip("()[] ") for text in above[-1]]
    if len(above) > 1 and all(above[-2]) and all(map(is_unit, alone)):
        return tuple(above[-2]), tuple(map(unit, alone))
    names, units = zip(*map(name_and_unit, above[-1]), strict=True)
    return names, units


def _of_cell(cell: Any) -> float:
    """Of a number or a date, s since 1970; NaN for all else."""
    if isinstance(cell, datetime):
        return cell.replace(tzinfo=UTC).timestamp()
    return float(cell) if isinstance(cell, int | float) and not isinstance(cell, bool) else math.nan


READERS: Mapping[str, Callable[[Path], Table]] = {
    **{
        ".npz": _npz,
        ".npy": _npy,
        ".mat": _mat,
        ".h5": _hdf5,
        ".hdf5": _hdf5,
        ".parquet": _parquet,
        ".feather": _feather,
    },
    **{".xlsx": _xlsx, ".xlsm": _xlsx, ".tdms": _tdms},
}
"""By the ending of the file; any other is read as text."""
