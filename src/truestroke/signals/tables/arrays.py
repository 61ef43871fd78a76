"""A table of arrays, by the ending of its file: NumPy, MATLAB, HDF5, Parquet, Feather, TDMS, Excel."""

import importlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import files, hdf5, npz
from truestroke.base.typing import FloatArray
from truestroke.signals.tables.headings import name_and_unit, names_and_units, stated_units, unit
from truestroke.signals.tables.table import PROBE, RecordError, Table

LIKE_A_NUMBER = re.compile(r"[-+]?\d+([.,]\d+)*([eE][-+]?\d+)?")
FEWEST = 20  # rows: a matrix with fewer, and with more columns, has its signals in rows


def _arrays(path: Path, names: Sequence[str], units: Sequence[str], get: Callable[[str], npt.NDArray[Any]]) -> Table:
    """A table of arrays by name, one column each; one array with two axes is a table without names."""
    if len(names) == 1 and (whole := get(names[0]).squeeze()).ndim == 2 and whole.dtype.kind in "iuf":
        if whole.shape[0] < FEWEST < whole.shape[1]:
            reason = f"{whole.shape[0]} rows of {whole.shape[1]} numbers: the signals are in rows; transpose the matrix"
            raise RecordError(str(path), reason)
        head = whole[:PROBE].astype(np.float64)
        return Table((), (), head, lambda columns, _: [_floats(whole[:, c]) for c in columns])

    def read(columns: Sequence[int], _: bool) -> list[FloatArray]:
        arrays = [get(names[c]).squeeze() for c in columns]
        for c, array in zip(columns, arrays, strict=True):
            if array.ndim != 1 or array.dtype.kind not in "iufMm":
                kind = f"an array of shape {array.shape}" if array.dtype.kind in "iuf" else f"of type {array.dtype}"
                remedy = "; write its numbers as numbers, not as text" if array.dtype.kind in "OSU" else ""
                raise RecordError(str(path), f"{names[c]} is {kind}, not a row of numbers{remedy}")
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
    units = stated_units([""] * len(names), npz.moments(path, names, wrong))
    return _arrays(path, names, units, lambda name: npz.read(path, [name], wrong)[name])


def _npy(path: Path) -> Table:
    """A matrix, or an array with named fields."""
    with path.open("rb") as file:
        holds = np.lib.format
        version = holds.read_magic(file)
        header = holds.read_array_header_1_0 if version == (1, 0) else holds.read_array_header_2_0
        if header(file)[2].hasobject:
            raise RecordError(str(path), "it holds objects of Python; np.savez writes arrays by name, as .npz")
    whole = np.load(path, allow_pickle=False)
    if whole.dtype.names:
        names = whole.dtype.names
        units = stated_units([""] * len(names), [whole.dtype[name].kind in "Mm" for name in names])
        return _arrays(path, names, units, lambda name: whole[name])
    return _arrays(path, ["array"], [""], lambda _: whole)


def _mat(path: Path) -> Table:
    import h5py
    from scipy.io import loadmat, whosmat

    if h5py.is_hdf5(path):  # MATLAB 7.3
        return _hdf5(path)
    files.check_size(path, "its variables", sum(8 * math.prod(shape) for _, shape, _ in whosmat(path)))
    held = _flat({name: v for name, v in loadmat(path, simplify_cells=True).items() if not name.startswith("__")})
    held = _by_columns({name: np.asarray(value) for name, value in held.items()})
    if not held:
        reason = "it has no array of numbers by itself, only arrays of structs, or cells"
        raise RecordError(
            str(path), f"{reason}; save the fields of one, as by s = run(1); save('run1.mat', '-struct', 's')"
        )
    return _arrays(path, list(held), [""] * len(held), held.__getitem__)


def _by_columns(held: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """A matrix beside texts and single numbers alone; one beside signals, as of Simulink, by columns such as "y:1"."""
    signals = {name: a for name, a in held.items() if a.dtype.kind in "iuf" and a.size >= FEWEST}
    if len(signals) == 1 and next(iter(signals.values())).ndim == 2:
        return signals
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, a in held.items():
        wide = name in signals and a.ndim == 2 and 1 < a.shape[1] < FEWEST <= a.shape[0]
        columns |= {f"{name}:{k + 1}": a[:, k] for k in range(a.shape[1])} if wide else {name: a}
    return columns


def _flat(held: Mapping[str, Any], group: str = "") -> dict[str, Any]:
    """Fields of structs by names such as "run/u"."""
    flat: dict[str, Any] = {}
    for name, value in held.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{group}{name}/")
        elif not isinstance(value, list) and np.asarray(value).dtype.kind != "O":  # a cell array
            flat[group + name] = value
    return flat


def _hdf5(path: Path) -> Table:
    """Every dataset, also those in groups; the attribute "unit" or "units" is its unit, as in recordings.

    scale_factor and add_offset, as of netCDF, make the numbers of what is stored.
    """
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
            values = np.asarray(file[name][()])
            factor, above = (file[name].attrs.get(key) for key in ("scale_factor", "add_offset"))
            if factor is None and above is None:
                return values
            return values * (1.0 if factor is None else float(factor)) + (0.0 if above is None else float(above))

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
    others = [sheet.title for sheet in book.worksheets[1:]]
    book.close()
    numbers = [[_of_cell(cell) for cell in row] for row in cells]
    filled = [tuple(np.flatnonzero(~np.isnan(row))) for row in numbers]
    start = next((k for k in range(len(cells) - 1) if len(filled[k]) > 1 and filled[k] == filled[k + 1]), None)
    if start is None:
        reason = "the first sheet has no two rows with numbers in the same cells, two or more"
        if others:
            reason += f"; is the record on another sheet ({', '.join(others)})? Move it to the front"
        elif any(isinstance(cell, str) and LIKE_A_NUMBER.fullmatch(cell.strip()) for row in cells for cell in row):
            reason += "; its numbers are texts: convert the cells to numbers"
        raise RecordError(str(path), reason)
    places = filled[start]
    above = [[str(row[p]).strip() if p < len(row) and row[p] else "" for p in places] for row in cells[:start]]
    values = [[row[p] if p < len(row) else math.nan for p in places] for row in numbers[start:]]
    while values and np.isnan(values[-1]).all():
        values.pop()
    table = np.array(values, dtype=np.float64)
    names, units = _names_above(above)
    if names:
        units = stated_units(units, [isinstance(cells[start][p], datetime) for p in places])
    read = lambda columns, _: [table[:, c].copy() for c in columns]  # noqa: E731
    return Table(names, units, table[:PROBE], read, lambda index: (start + index + 1, ""))


def _names_above(above: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units from the row above the numbers, or from two: names, then units alone."""
    if not above or not all(above[-1]):
        return (), ()
    return names_and_units(above[-1], above[-2] if len(above) > 1 and all(above[-2]) else ())


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
