"""A record of voltage and displacement, read from a file and checked, before anything is fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.identification.records import clock
from truestroke.signals import formats, tables
from truestroke.signals.channels import Signals
from truestroke.signals.columns import Column, Wanted, read_columns, refuse_bad_rows
from truestroke.signals.recording import Recording
from truestroke.signals.tables import RecordError, Table

FEWEST_ROWS = 50
COARSE = 0.2  # of the stamps repeat the one before, or more: rows that were measured would be left out with them
CALIBRATION = 0.2  # by which a scale may differ from a unit of length, for which it stands
ROUNDING, SMALLEST = 1e-12, 1e-100  # of the largest value, and in its unit: a smaller span is none
GAP = 2.5  # intervals; software-timed samples jitter by less, and one lost sample leaves no gap

HEADINGS = {
    "volts": (
        *("volts", "volt", "voltage", "v", "u", "vi", "vin", "v_in", "input", "command", "drive"),
        *tables.OF_LANGUAGES["volts"],
    ),
    "displacement": (
        *("measured", "displacement", "disp", "z", "y", "d", "do", "position", "pos", "stroke", "sensor", "output"),
        *tables.OF_LANGUAGES["displacement"],
    ),
    "time": ("time", "t", "timestamp", "x_value", *tables.OF_LANGUAGES["time"]),
}
"""By which a column is found where it is not named, the best first; of several languages."""

_LEAVES_OUT = "; `drop_bad_rows` leaves such rows out"

EXPECTED = "a Record, such as of truestroke.read_record(path)"


@dataclass(frozen=True, eq=False, repr=False)
class Record(Signals):
    """Voltage and displacement of the same instants; what is here can be fitted.

    Attributes
    ----------
    time : ndarray, shape (rows,)
        s, ascending.
    volts : ndarray, shape (rows,)
        V, not constant.
    displacement : ndarray, shape (rows,)
        um, not constant.
    sample_rate : float
        Hz: rows per second, gaps left out.
    source : str
        The file, or "arrays".
    columns : Mapping[str, Column]
        For "volts", "displacement" and, where time stamps were read, "time".
    segments : tuple[slice, ...]
        Rows between gaps; a gap is an interval of more than 2.5 times the median.
    dropped : int
        Rows left out: by `drop_bad_rows`, and at both ends those without a measurement.
    contradictions : tuple[str, ...]
        What the caller states against what the file says, a sentence each.
    unused : str
        That the file has time stamps which are not used, in words; else empty.
    flipped : bool
        Whether the sign of the displacement is turned.
    """

    time: FloatArray
    volts: FloatArray
    displacement: FloatArray
    sample_rate: float
    source: str
    columns: Mapping[str, Column] = field(default_factory=dict)
    segments: tuple[slice, ...] = ()
    dropped: int = 0
    contradictions: tuple[str, ...] = ()
    unused: str = ""
    flipped: bool = False

    @classmethod
    def from_arrays(
        cls,
        volts: npt.ArrayLike,
        displacement: npt.ArrayLike,
        *,
        sample_rate: float | None = None,
        time: npt.ArrayLike | None = None,
        source: str = "arrays",
    ) -> Record:
        """A record from arrays in V and um, with either a sample rate (Hz) or time stamps (s).

        Raises
        ------
        RecordError
            As `read_record`.
        SettingError
            Both or neither of sample rate and time are given.

        Examples
        --------
        >>> t = np.arange(200) / 1000.0
        >>> record = Record.from_arrays(1 - np.cos(20 * t), 10 - 10 * np.cos(20 * t), sample_rate=1000.0)
        >>> record.time[-1], record.segments
        (np.float64(0.199), (slice(0, 200, None),))
        """
        signals = {"volts": _axis(source, "volts", volts), "displacement": _axis(source, "displacement", displacement)}
        if (sample_rate is None) == (time is None):
            raise SettingError("sample_rate", sample_rate, "given where there are no time stamps, and only there", "Hz")
        if time is not None:
            signals["time"] = _axis(source, "time", time)
        columns = {role: Column(role, next(iter(tables.UNITS[role])), True) for role in signals}
        return _checked(source, signals, columns, sample_rate, False)


def read_record(
    path: str | Path,
    *,
    volts: str | int | None = None,
    displacement: str | int | None = None,
    time: str | int | None = None,
    volts_unit: str | None = None,
    displacement_unit: str | None = None,
    time_unit: str | None = None,
    volts_scale: float | None = None,
    displacement_scale: float | None = None,
    sample_rate: float | None = None,
    flip_displacement: bool = False,
    drop_bad_rows: bool = False,
) -> Record:
    r"""A record from a file: text with columns, NPZ, MATLAB, Parquet, HDF5, Excel, TDMS.

    Parameters
    ----------
    path : str or Path
        .npz, .mat, .parquet, .feather, .h5, .hdf5, .xlsx and .tdms are files of these formats; any other is text whose
        columns are separated by commas, semicolons, tabs or white space.
    volts, displacement, time : str or int, optional
        Columns, by name or counted from 1. Left out, they are found by heading (`HEADINGS`), else by unit. Without
        names, two columns are voltage and displacement; three, the first of which ascends, are time and these two.
    volts_unit, displacement_unit, time_unit : str, optional
        Of the file: V, mV, uV, kV; um, nm, mm, m; s, ms, us, ns, min, h, day. Left out, what the heading states, else
        V, um, s.
    volts_scale : float, optional
        V for one of the column, such as 10 of a monitor of 1:10; in place of its unit. The voltage is that which a
        controller or a waveform is to put out.
    displacement_scale : float, optional
        um for one of the column, such as um/V of a sensor in V; in place of its unit.
    sample_rate : float, optional
        Hz; needed where there is no time column. A time column is not used then.
    flip_displacement : bool
        Turn its sign: for a sensor that falls as the voltage rises.
    drop_bad_rows : bool
        Leave out rows that hold no finite numbers or whose time does not ascend, rather than refuse the record. A
        recording of truestroke does not need it: its ticks without a measurement are left out, and counted.

    Raises
    ------
    RecordError
        The record cannot be used; names the row and the reason.
    FileNotFoundError
        There is no such file.
    SettingError
        A unit is not known, or both `time` and `sample_rate` are given.

    Notes
    -----
    Text is parsed in chunks of 1 MB into arrays of the final size: 24 bytes for each row stay in memory.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "sweep.csv")
    ...     rows = [f"{k},{3 * abs(k % 50 - 25)},{abs(k % 50 - 25) / 1000}" for k in range(100)]
    ...     _ = path.write_text("time (ms),drive (mV),sensor (mm)\n" + "\n".join(rows))
    ...     record = read_record(path)
    >>> record.sample_rate, record.volts[:2], record.displacement[:2]
    (1000.0, array([0.075, 0.072]), array([25., 24.]))
    >>> record.columns["displacement"]
    Column(heading='sensor', unit='mm', stated=True)
    """
    path = checks.path("path", path)
    if sample_rate is not None:
        checks.positive("sample_rate", sample_rate, "Hz")
        if time is not None:
            raise SettingError("sample_rate", sample_rate, "left out where a time column is named", "Hz")
    scale, displacement_unit = _scale("displacement_scale", displacement_scale, displacement_unit, "um")
    of_volts, volts_unit = _scale("volts_scale", volts_scale, volts_unit, "V")
    asked = {"volts": (volts, volts_unit), "displacement": (displacement, displacement_unit), "time": (time, time_unit)}
    wanted = [Wanted(role, tables.UNITS[role], HEADINGS[role], *keys) for role, keys in asked.items()]
    table = tables.open_table(path)
    complete = drop_bad_rows or sample_rate is not None
    wanted[2] = dataclasses.replace(wanted[2], needed=sample_rate is None, instead="the `sample_rate`")
    signals, columns = _read(path, table, wanted, complete)
    signals["displacement"] *= -scale if flip_displacement else scale
    signals["volts"] *= of_volts
    if "time" in signals:
        signals["time"] = clock.over_midnight(signals["time"])
    if volts_scale is not None:
        columns["volts"] = dataclasses.replace(columns["volts"], of_file="")
    if displacement_scale is not None and _is_scale(displacement_scale, columns["displacement"].of_file):
        columns["displacement"] = dataclasses.replace(columns["displacement"], of_file="")
    contradictions = [*_of_units(columns, {"displacement": displacement_scale})]
    unused = ""
    if sample_rate is not None and "time" in columns:
        against, unused = clock.against(signals.pop("time"), columns.pop("time"), sample_rate)
        contradictions += [against] if against else []
    if "time" in columns and not columns["time"].stated:
        _refuse_far(str(path), float(signals["time"][0]) if signals["time"].size else 0.0)
    record = _checked(str(path), signals, columns, sample_rate, drop_bad_rows, table)
    return dataclasses.replace(record, contradictions=tuple(contradictions), unused=unused, flipped=flip_displacement)


def as_record(record: Any) -> Record:
    """A record as it is; of a `Recording` its volts and measurements, ticks without a measurement left out."""
    if not isinstance(record, Recording):
        return checks.instance("record", record, Record, EXPECTED)
    names = {"volts": "volts", "displacement": "measured", "time": "time"}
    signals = {role: _axis("recording", role, record[name]) for role, name in names.items()}
    columns = {role: Column(name, record.unit(name), True) for role, name in names.items()}
    table = Table((), (), np.zeros((0, 0)), lambda *_: [], marked=True)
    return _checked("recording", signals, columns, None, False, table)


def _read(
    path: Path, table: Table, wanted: Sequence[Wanted], complete: bool
) -> tuple[dict[str, FloatArray], dict[str, Column]]:
    """The columns; to the end where a first number is missing, or the last displacement that was read."""
    optional = [w for w in wanted if not w.needed]
    try:
        signals, columns = read_columns(path, table, wanted, _places(table), complete)
    except RecordError:
        if not optional:
            raise
        return _read(path, table, [w for w in wanted if w.needed], complete)
    first = [signal[0] for signal in signals.values() if signal.size]
    if not complete and np.isnan([*first, *signals["displacement"][-1:]]).any():
        return read_columns(path, table, wanted, _places(table), True)
    return signals, columns


def _is_scale(scale: float, of_file: str) -> bool:
    """Whether a scale, um, may take the place of what the file states: of no length, or where it is a length, about."""
    lengths = tables.UNITS["displacement"]
    return of_file not in lengths or any(abs(scale / size - 1) < CALIBRATION for size in lengths.values())


def _of_units(columns: Mapping[str, Column], scales: Mapping[str, float | None]) -> Iterator[str]:
    """Units that the caller states against those of the file."""
    for role, column in columns.items():
        if column.of_file and column.of_file != column.unit:
            says, scale = column.says(role, column.unit), scales.get(role)
            stated = f"`{role}_unit` is {column.unit}" if scale is None else f"`{role}_scale` is {figures(scale)}"
            against = f"{column.heading!r} is in {column.of_file}, as the file says, but {stated}"
            right = f"write {says}" if role == "time" else f"give {says} in its place"
            yield f"{against}; if the file is wrong, {right}"


def _places(table: Table) -> tuple[str, ...]:
    """Of a table without names: voltage, displacement; or time, voltage, displacement."""
    if table.width == 2:
        return "volts", "displacement"
    ascends = not table.names and table.width == 3 and np.all(np.diff(table.head[:, 0]) > 0)
    return ("time", "volts", "displacement") if ascends else ()


def _scale(name: str, scale: float | None, unit: str | None, ours: str) -> tuple[float, str | None]:
    """V or um for one of a column, beside its unit; a scale takes the place of the unit."""
    if scale is None:
        return 1.0, unit
    if unit is not None:
        raise SettingError(name, scale, "left out where a unit is given", ours)
    return checks.positive(name, scale, ours), ours


# ---- Checks --------------------------------------------------------------------------------------------------------


def _axis(source: str, name: str, value: npt.ArrayLike) -> FloatArray:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise RecordError(source, f"{name} is no array of numbers") from None
    if array.ndim != 1:
        raise RecordError(source, f"{name} has shape {array.shape}; one axis is needed")
    return array


def _checked(
    source: str,
    signals: Mapping[str, FloatArray],
    columns: Mapping[str, Column],
    sample_rate: float | None,
    drop: bool,
    table: Table | None = None,
) -> Record:
    """The record, or the first reason why there is none."""
    table = table or Table((), (), np.zeros((0, 0)), lambda *_: [])
    rows = signals["volts"].size
    for role, signal in signals.items():
        if signal.size != rows:
            raise RecordError(source, f"volts has {rows} rows, but {role} has {signal.size}")
    time = signals["time"] if "time" in signals else np.arange(rows) / (sample_rate or 1.0)
    ends = _measured(signals["displacement"])
    _refuse_unreadable_end(source, ends, rows, table)
    time, signals = time[ends], {role: signal[ends] for role, signal in signals.items()}
    table = dataclasses.replace(table, locate=partial(_from, table.locate, ends.start))
    _refuse_several(source, time, table)
    _refuse_empty(source, {**signals, "time": time}, columns, table)
    keep = _good_rows({**signals, "time": time})
    if drop or table.marked:
        time, signals = time[keep], {role: signal[keep] for role, signal in signals.items()}
    else:
        refuse_bad_rows(source, {**signals, "time": time}, table, _LEAVES_OUT if keep.sum() >= FEWEST_ROWS else "")
        _refuse_late_rows(source, time, table)
    if time.size < FEWEST_ROWS:
        left = f" that can be used, of {rows}" if time.size < rows else ""
        raise RecordError(source, f"{time.size} rows{left}; at least {FEWEST_ROWS} are needed")
    for role in ("volts", "displacement"):
        _refuse_constant(source, role, signals[role], columns[role].heading)
    segments = _segments(time)
    rate = sample_rate if sample_rate is not None else _rate(time, segments)
    dropped = rows - time.size
    return Record(time, signals["volts"], signals["displacement"], rate, source, columns, segments, dropped)


def _measured(displacement: FloatArray) -> slice:
    """Rows between the first and the last measurement: a driver's latency leaves none in the last ticks of a run."""
    known = np.flatnonzero(~np.isnan(displacement))
    return slice(int(known[0]), int(known[-1]) + 1) if known.size else slice(0, displacement.size)


def _refuse_empty(source: str, signals: Mapping[str, FloatArray], columns: Mapping[str, Column], table: Table) -> None:
    """A column without any number, of which no row remains: another one is meant."""
    for role, signal in signals.items():
        if signal.size and not np.isfinite(signal).any() and not formats.thousands(table.locate(0)[1]):
            heading = columns[role].heading if role in columns else role
            column = f" ({heading})" if heading != role else ""
            instead = "; or leave it out of the file, and give the `sample_rate`" if role == "time" else ""
            reason = f"{role}{column} has no number in all {signal.size} rows: name the right column by `{role}`"
            raise RecordError(source, reason + instead)


def _refuse_unreadable_end(source: str, ends: slice, rows: int, table: Table) -> None:
    """Where the displacement is there in the first row that is left out, but in numbers that are not read."""
    left_out = [row for row in (ends.start - 1, ends.stop) if 0 <= row < rows]
    for row in left_out:
        number, text = table.locate(row)
        if reason := formats.thousands(text):
            raise RecordError(source, f"displacement is no number in {text}{reason}", number, table.where)


def _from(locate: Callable[[int], tuple[int, str]], first: int, index: int) -> tuple[int, str]:
    """Where a row is, counted behind the first ones, which are left out."""
    return locate(first + index)


def _good_rows(signals: Mapping[str, FloatArray]) -> npt.NDArray[np.bool_]:
    """Rows with finite numbers whose time is later than that of every good row before."""
    good = np.logical_and.reduce([np.isfinite(signal) for signal in signals.values()])
    latest = np.maximum.accumulate(np.where(good, signals["time"], -np.inf))
    good[1:] &= signals["time"][1:] > latest[:-1]
    return np.asarray(good)


def _refuse_several(source: str, time: FloatArray, table: Table) -> None:
    """Where the time starts again for as many rows as a record has: one stamp far ahead of the others is no start."""
    if not (np.isnan(time).any() or (time[1:] < time[:-1]).any()):
        return
    rows = np.flatnonzero(np.isfinite(time))
    t = time[rows]
    for k in np.flatnonzero(np.diff(t) < 0).tolist():
        if t[k + 1] < t[max(k - 1, 0)] and t[k + 1 : k + 1 + FEWEST_ROWS].max() < t[k] and t.size - k > FEWEST_ROWS:
            number, _ = table.locate(int(rows[k + 1]))
            reason = f"the time starts again, {t[k + 1]:.9g} s behind {t[k]:.9g} s: are several runs in one file? Read "
            raise RecordError(
                source, f"{reason}each by itself, or give the `sample_rate` if they are one", number, table.where
            )


def _refuse_late_rows(source: str, time: FloatArray, table: Table) -> None:
    """The first row whose time does not ascend, and how many there are."""
    late = np.diff(time) <= 0
    if late.any():
        number, _ = table.locate(first := int(np.argmax(late)) + 1)
        how = "repeats" if time[first] == time[first - 1] else "is earlier than"
        reason = f"time {time[first]:.9g} s {how} that of the row before ({late.sum()} such rows)"
        new = np.flatnonzero(np.diff(time) > 0)
        if late.mean() > COARSE and new.size > 1:
            rate = (new[-1] - new[0]) / (time[new[-1] + 1] - time[new[0] + 1])
            reason += f": the stamps are too coarse; give the `sample_rate`, by them about {rate:.4g} Hz"
        else:
            reason += "; `drop_bad_rows` leaves them out, or give the `sample_rate` instead of a time column"
        raise RecordError(source, reason, number, table.where)


def _refuse_far(source: str, first: float) -> None:
    """Stamps of no stated unit that begin later than the year 5000: milliseconds and the like since 1970."""
    if first > 1e11:
        unit = "ms" if first < 1e14 else "us" if first < 1e17 else "ns"
        raise RecordError(source, f"time begins at {first:.6g} s, unlikely: is it in {unit}? Say so by `time_unit`")


def _refuse_constant(source: str, role: str, signal: FloatArray, heading: str) -> None:
    if signal.max() - signal.min() <= max(ROUNDING * float(np.abs(signal).max()), SMALLEST):
        column = f" ({heading})" if heading != role else ""
        reason = f"{role}{column} is {signal[0] + 0.0:g} {next(iter(tables.UNITS[role]))} in all {signal.size} rows"
        raise RecordError(source, f"{reason}; it must move for anything to be learnt")


def _segments(time: FloatArray) -> tuple[slice, ...]:
    """Rows between intervals of more than `GAP` times the median."""
    steps = np.diff(time)
    ends = (np.flatnonzero(steps > GAP * np.median(steps)) + 1).tolist()
    return tuple(slice(a, b) for a, b in zip([0, *ends], [*ends, time.size], strict=True))


def _rate(time: FloatArray, segments: Sequence[slice]) -> float:
    """Rows per second of the time within segments; time stamps may be rounded coarsely, so no median of intervals."""
    spans = [(s.stop - s.start - 1, float(time[s.stop - 1] - time[s.start])) for s in segments]
    return float(sum(n for n, _ in spans) / sum(seconds for _, seconds in spans))
