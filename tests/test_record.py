"""Reading of records: every format gives the same numbers, and what cannot be used is refused in words."""

from __future__ import annotations

import os
import sys
import tracemalloc
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from truestroke import Recording, SettingError
from truestroke.identification import Record, RecordError, examine, read_record
from truestroke.signals.recording import Channel

ROWS = 300
T = np.arange(ROWS) / 1000.0
V = np.round(1.8 - 1.8 * np.cos(30 * T), 6)
Z = np.round(-5.0 + 10.0 * V, 6)
SHARED = Path(os.environ.get("TRUESTROKE_SHARED", Path(__file__).parents[2] / "shared"))


def text(
    path: Path,
    *columns: np.ndarray,
    head: str = "",
    separator: str = ",",
    encoding: str = "utf-8",
    comma: bool = False,
    exponent: str = "",
) -> Path:
    style = ".8E" if exponent else ".9g"
    rows = "\n".join(separator.join(f"{value:{style}}" for value in row) for row in np.column_stack(columns))
    rows = rows.replace("E", exponent) if exponent else rows
    path.write_text(head + (rows.replace(".", ",") if comma else rows) + "\n", encoding=encoding)
    return path


def dated(path: Path) -> Path:
    """Time stamps of a day on which clocks change, through the hour in which they do."""
    start = np.datetime64("2024-03-31T01:59:59.900")
    rows = [f"{start + np.timedelta64(k, 'ms')},{V[k]:.9g},{Z[k]:.9g}".replace("T", " ") for k in range(ROWS)]
    path.write_text("timestamp,V,um\n" + "\n".join(rows))
    return path


def is_the_record(record: Record) -> None:
    np.testing.assert_allclose(record.volts, V, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(record.displacement, Z, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(record.time - record.time[0], T, atol=1e-9 if record.time[0] == 0 else 1e-6)
    assert record.sample_rate == pytest.approx(1000.0)
    assert record.segments == (slice(0, ROWS),)


# ---- Formats ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "write",
    [
        lambda p: text(p, T, V, Z, head="time (s),V (V),z (um)\n"),
        lambda p: text(p, Z, T, V, head="z,t,V\n"),  # any order
        lambda p: text(p, T, V, Z, head="Second,u,y\n"),
        lambda p: dated(p),
        lambda p: text(p, T, V, Z, head="t V z\n", separator=" ", exponent="D"),
        lambda p: text(p, 1e3 * T, 1e3 * V, 1e-3 * Z, head="Time [ms];Drive [mV];Sensor [mm]\n", separator=";"),
        lambda p: text(p, T, V, Z, head="Zeit (s);U (V);Weg (µm)\n", separator=";", comma=True, encoding="latin-1"),
        lambda p: text(p, T, V, 1e3 * Z, head="time_s\tdrive_V\tpos_nm\n", separator="\t", encoding="utf-16"),
        lambda p: text(p, T, V, Z, head="\ufeffModel,XY1\nStart,12:30\n\nTime,CH1,CH2\n(s),(V),(µm)\n"),
        lambda p: text(p, T, V, Z, head="# t volts z\n", separator="  "),
        lambda p: text(p, T, V, Z),  # no header, the time ascends
        lambda p: text(p, T, V, Z, np.zeros(ROWS), head='"t","V","z","error (um)"\n', separator=", "),
    ],
    ids=[
        "units",
        "order",
        "uy",
        "dates",
        "fortran",
        "other-units",
        "decimal-comma",
        "utf16",
        "preamble",
        "comment",
        "bare",
        "quoted",
    ],
)
def test_columns_and_units_of_text_are_found(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    is_the_record(read_record(write(tmp_path / "record.csv")))


def write_npz(path: Path) -> None:
    np.savez(path, time=T, volts=V, z=Z, sample_rate=1000.0)


def write_mat(path: Path) -> None:
    savemat(path, {"t": T, "u": V[:, None], "pos_mm": 1e-3 * Z, "note": "bench 3"})


def write_struct(path: Path) -> None:
    savemat(path, {"run": {"time": T, "voltage": V, "position": {"um": Z}}, "notes": np.array(["a", 3], dtype=object)})


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, data, unit in (("t", T, "s"), ("run/drive", 1e3 * V[None, :], "mV"), ("run/sensor", Z, "µm")):
            file.create_dataset(name, data=data).attrs["unit"] = unit


def write_recording(path: Path) -> None:
    wave = {"time": (T, "s"), "volts": (V, "V"), "desired": (0 * Z, "um"), "measured": (Z, "um"), "true": (0 * Z, "um")}
    Recording({name: Channel(data, unit, name) for name, (data, unit) in wave.items()}).save(path)


def write_parquet(path: Path) -> None:
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table({"time (s)": T, "drive (V)": V, "z (um)": Z}), path)


def write_feather(path: Path) -> None:
    import pyarrow.feather

    pyarrow.feather.write_feather(pyarrow.table({"time (s)": T, "drive (V)": V, "z (um)": Z}), str(path))


def write_excel(path: Path) -> None:
    """As an instrument's export: a title, names, units, and a note beside the table."""
    import openpyxl

    book = openpyxl.Workbook()
    for row in (["Bench 3"], [None, "time", "drive", "z"], [None, "ms", "V", "um"]):
        book.active.append(row)
    for t, v, z in zip(T, V, Z, strict=True):
        book.active.append([None, 1e3 * t, v, z, "checked"])
    book.save(path)


def write_tdms(path: Path) -> None:
    """As LabVIEW: no column of the time, but its increment."""
    import nptdms

    wave = {"wf_increment": 1e-3, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([
            nptdms.ChannelObject("run", "drive", 1e3 * V, {**wave, "unit_string": "mV"}),
            nptdms.ChannelObject("run", "z", Z, {**wave, "unit_string": "um"}),
        ])  # fmt: skip


@pytest.mark.parametrize(
    ("ending", "write"),
    [
        (".npz", write_npz),
        (".mat", write_mat),
        (".mat", write_struct),
        (".h5", write_hdf5),
        (".h5", write_recording),
        (".mat", write_hdf5),  # MATLAB 7.3 is HDF5
        (".parquet", write_parquet),
        (".feather", write_feather),
        (".xlsx", write_excel),
        (".tdms", write_tdms),
        (".npz", lambda path: np.savez(path, time=np.datetime64(0, "us") + (1e6 * T).astype(int), V=V, z=Z)),
        (".npz", lambda path: np.savez(path, time_ms=np.datetime64(0, "us") + (1e6 * T).astype(int), V=V, z=Z)),
        (".npz", lambda path: np.savez(path, data=np.column_stack([T, V, Z]))),
    ],
    ids=[
        "npz",
        "mat",
        "struct",
        "hdf5",
        "recording",
        "mat73",
        "parquet",
        "feather",
        "excel",
        "tdms",
        "dates",
        "dates called ms",
        "matrix",
    ],
)
def test_binary_formats(tmp_path: Path, ending: str, write: Callable[[Path], None]) -> None:
    path = tmp_path / f"record{ending}"
    write(path)
    is_the_record(read_record(path))


@pytest.mark.parametrize("stamp", ["%d.%m.%Y %H:%M:%S,%f", "%d.%m.%Y;%H:%M:%S,%f"])
def test_dates_with_dots_and_decimal_commas(tmp_path: Path, stamp: str) -> None:
    """As a German instrument or Excel writes them, date and time in one column or two."""
    start = datetime(2026, 12, 31, 13, 59, 59, 999000)
    moments = [(start + timedelta(microseconds=round(1e6 * t))).strftime(stamp) for t in T]
    rows = [f"{moment};{v:.9f};{z:.9f}" for moment, v, z in zip(moments, V, Z, strict=True)]
    rows = [";".join([*row.split(";")[:-2], *[n.replace(".", ",") for n in row.split(";")[-2:]]]) for row in rows]
    names = "Zeit;" if " " in stamp else "Datum;Zeit;"
    (tmp_path / "a.csv").write_text(f"{names}U (V);z (um)\n" + "\n".join(rows))
    record = read_record(tmp_path / "a.csv", time="Zeit")
    is_the_record(record)
    assert record.columns["time"].stated  # nothing is assumed: seconds they are
    assert not any("assumed" in text for text in examine(record).warnings)


@pytest.mark.parametrize("between", [" ", ","])
def test_dates_from_the_year_on_with_strokes(tmp_path: Path, between: str) -> None:
    """As LabVIEW and Chinese and Japanese instruments write them: 2026/11/30 can be of no other day."""
    start = datetime(2026, 11, 30, 13, 59, 59, 999000)
    stamps = [(start + timedelta(microseconds=round(1e6 * t))).strftime(f"%Y/%m/%d{between}%H:%M:%S.%f") for t in T]
    names = "Date,Time" if between == "," else "Time"
    rows = "\n".join(f"{stamp},{v:.9f},{z:.9f}" for stamp, v, z in zip(stamps, V, Z, strict=True))
    (tmp_path / "a.csv").write_text(f"{names},U (V),z (um)\n{rows}")
    is_the_record(read_record(tmp_path / "a.csv"))


def test_brackets_of_wide_keyboards_hold_units(tmp_path: Path) -> None:
    record = read_record(text(tmp_path / "a.csv", T, 1e3 * V, Z, head="时间（s）,电压（mV）,位移（μm）\n"))  # noqa: RUF001
    is_the_record(record)
    assert record.columns["displacement"].stated


def test_one_column_is_no_number_with_marks(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"it is one number: put voltage and displacement side by side in one file$"):
        read_record(text(tmp_path / "a.csv", V + 20.125, head="voltage\n"))


def test_dates_of_tables_are_in_seconds(tmp_path: Path) -> None:
    import openpyxl
    import pyarrow
    import pyarrow.parquet

    moments = [datetime(2026, 12, 31, 13, 59, 59) + timedelta(microseconds=round(1e6 * t)) for t in T]
    pyarrow.parquet.write_table(pyarrow.table({"Zeit": moments, "V": V, "um": Z}), tmp_path / "a.parquet")
    book = openpyxl.Workbook()
    for row in (("Zeit", "V", "um"), *zip(moments[:60], V[:60], Z[:60], strict=True)):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    for ending in ("parquet", "xlsx"):
        assert read_record(tmp_path / f"a.{ending}").columns["time"].stated


def test_a_sheet_of_a_german_instrument(tmp_path: Path) -> None:
    """Lines of its own above the headings, one with a date, and an empty one."""
    import openpyxl

    book = openpyxl.Workbook()
    above = ("Messung Piezoaktor",), ("Datum", datetime(2026, 11, 3)), (), ("Zeit [ms]", "Spannung (V)", "Weg (µm)")
    for row in (*above, *zip((1e3 * T).tolist(), V.tolist(), Z.tolist(), strict=True)):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    record = read_record(tmp_path / "a.xlsx")
    is_the_record(record)
    assert [record.columns[role].unit for role in ("time", "volts", "displacement")] == ["ms", "V", "um"]


@pytest.mark.parametrize(("ending", "words"), [("xls", "save or export it as .xlsx or .csv"), ("mf4", ".csv or .h5")])
def test_formats_that_are_not_read_are_named(tmp_path: Path, ending: str, words: str) -> None:
    (tmp_path / f"a.{ending}").write_bytes(b"any")
    with pytest.raises(RecordError, match=f".{ending} is not read; .*{words}"):
        read_record(tmp_path / f"a.{ending}")


def test_dates_that_may_be_of_two_days_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,V,z\n" + "\n".join(f"03/04/2026 10:00:{k:02},{k},{k}" for k in range(60)))
    with pytest.raises(RecordError, match="may be of two days: write 2026-04-03"):
        read_record(tmp_path / "a.csv")


def test_channels_of_tdms_are_read_at_the_rate_that_they_share(tmp_path: Path) -> None:
    import nptdms

    def write(rates: tuple[float, float]) -> Path:
        channels = [
            nptdms.ChannelObject("run", name, column, {"wf_increment": 1 / rate, "unit_string": unit})
            for name, column, unit, rate in zip(("drive", "z"), (V, Z), ("V", "um"), rates, strict=True)
        ]
        slow = nptdms.ChannelObject("run", "temperature", np.ones(5), {"wf_increment": 1.0})
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
            file.write_segment([*channels, slow])
        return tmp_path / "a.tdms"

    is_the_record(read_record(write((1000.0, 1000.0))))
    with pytest.raises(
        RecordError, match=r"different rates \(drive every 0.001 s, z every 0.002 s\); export them at one"
    ):
        read_record(write((1000.0, 500.0)))


@pytest.mark.parametrize(("ending", "module", "extra"), [("xlsx", "openpyxl", "excel"), ("tdms", "nptdms", "tdms")])
def test_what_to_install_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, module: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"a.{ending}").write_bytes(b"PK")
    with pytest.raises(RecordError, match=rf'needs {module}: pip install "truestroke\[{extra}\]"'):
        read_record(tmp_path / f"a.{ending}")


def test_parquet_without_pyarrow_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(RecordError, match=r'pip install "truestroke\[parquet\]"'):
        read_record(tmp_path / "a.parquet")


def test_a_sensor_in_volts_is_scaled(tmp_path: Path) -> None:
    path = text(tmp_path / "scope.csv", T, V, Z / 3, head="x-axis,1,2\nsecond,Volt,Volt\n")
    with pytest.raises(RecordError, match=r"displacement: column 3 '2' \(V\) .*displacement_scale"):
        read_record(path, volts=2, displacement=3)
    is_the_record(read_record(path, volts=2, displacement=3, displacement_scale=3.0))
    assert (
        read_record(path, volts=2, displacement=3, displacement_scale=3.0, flip_displacement=True).displacement[0] > 0
    )


@pytest.mark.parametrize("mark", ["9.91E+37", "-9.9e37", "1e308"])
def test_what_an_instrument_has_not_measured_is_missing(tmp_path: Path, mark: str) -> None:
    path = text(tmp_path / "scpi.csv", T, V, Z, head="t (s),V,z (um)\n")
    lines = path.read_text().splitlines()
    lines[41] = ",".join([*lines[41].split(",")[:2], mark])
    path.write_text("\n".join(lines))
    with pytest.raises(RecordError, match="line 42: displacement is missing or no number"):
        read_record(path)
    assert read_record(path, drop_bad_rows=True).dropped == 1


def test_a_scale_takes_the_place_of_the_volts_of_a_heading_and_of_no_other_length(tmp_path: Path) -> None:
    path = text(tmp_path / "gauge.csv", T, V, Z / 3, head="t (s),V,gauge (V)\n")
    assert read_record(path, displacement=3, displacement_scale=3.0).contradictions == ()
    path = text(tmp_path / "nm.csv", T, V, Z / 3, head="t (s),V,z (nm)\n")
    found = read_record(path, displacement=3, displacement_scale=3.0).contradictions[0]
    assert "in nm, as the file says, but `displacement_scale` is 3; if the file is wrong, give" in found


@pytest.mark.parametrize("scale", [1.0, 1000.0, 0.00102])
def test_a_scale_takes_the_place_of_a_wrong_length_or_calibrates_it(tmp_path: Path, scale: float) -> None:
    """A heading of nm above um: the unit and the scale of the caller were both refused against the file."""
    path = text(tmp_path / "nm.csv", T, V, Z / scale, head="t (s),V,z (nm)\n")
    record = read_record(path, displacement_scale=scale)
    assert record.contradictions == ()
    np.testing.assert_allclose(record.displacement, Z, rtol=1e-6, atol=1e-9)
    against = read_record(path, displacement_unit="um").contradictions[0]
    assert against.endswith("if the file is wrong, give `displacement_scale` 1 in its place")


def test_a_time_of_another_unit_is_corrected_in_the_file(tmp_path: Path) -> None:
    """Neither `time_unit` nor `sample_rate` is taken against the unit of the file."""
    path = text(tmp_path / "r.csv", T, V, Z, head="t (ms),V,z (um)\n")
    against = read_record(path, time_unit="s").contradictions[0]
    assert against.endswith("if the file is wrong, write s in the heading of the file")
    assert examine(read_record(path)).mistakes[0].endswith("are they in s (write s in the heading of the file)?")


def test_dates_in_arrays_are_in_seconds(tmp_path: Path) -> None:
    stamps = np.datetime64(0, "us") + (1e6 * T).astype(int)
    np.savez(tmp_path / "a.npz", time=stamps, V=V, z=Z)
    table = np.rec.fromarrays([stamps, V, Z], names="time,V,z")
    np.save(tmp_path / "b.npy", table)
    for name in ("a.npz", "b.npy"):
        assert read_record(tmp_path / name).columns["time"].stated


def test_stamps_since_1970_in_an_unstated_unit_are_refused(tmp_path: Path) -> None:
    path = text(tmp_path / "ms.csv", V, Z, head="V,z\n")
    rows = [f"{1_700_000_000_000 + k},{line}" for k, line in enumerate(path.read_text().splitlines()[1:])]
    path.write_text("t,V,z\n" + "\n".join(rows))
    with pytest.raises(RecordError, match="is it in ms"):
        read_record(path)
    is_the_record(read_record(path, time_unit="ms"))


@pytest.mark.parametrize("keys", [{"volts": 2, "displacement": 4}, {"volts": "a", "displacement": "B"}, {"volts": "2",
                                  "displacement": "b (um)"}])  # fmt: skip
def test_columns_by_number_and_name(tmp_path: Path, keys: dict[str, str | int]) -> None:
    path = text(tmp_path / "r.txt", 0 * T, V, 7 + T, 1e-3 * Z, head="zero,a,b2,b\n")
    is_the_record(read_record(path, sample_rate=1000.0, displacement_unit="mm", **keys))  # type: ignore[arg-type]


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=60, max_size=80, unique=True), st.integers(16, 400))
def test_numbers_come_through_exactly_whatever_the_chunk(values: list[float], chunk: int) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr("truestroke.signals.tables.text.CHUNK", chunk)
        path = Path(folder, "r.csv")
        path.write_text("# by hand\n\nvolts,z\n" + "".join(f"{v!r},{-v!r}\n\n" for v in values))
        record = read_record(path, sample_rate=10.0)
    assert record.volts.tolist() == values
    assert record.displacement.tolist() == [-v for v in values]


# ---- Records that cannot be used -------------------------------------------------------------------------------------


def changed(column: np.ndarray, row: int, value: float) -> np.ndarray:
    column = column.copy()
    column[row] = value
    return column


@pytest.mark.parametrize(
    ("columns", "reason", "line"),
    [
        ((T, 0 * V + 1.8, Z), r"volts .*is 1.8 V in all 300 rows; it must move", None),
        ((T, V, 0 * Z), r"displacement .*is 0 um in all 300 rows", None),
        ((T, V, 1e-310 * Z), r"displacement .* um in all 300 rows; it must move", None),
        ((T, V, changed(Z, 7, np.nan)), r"line 9: displacement is missing or no number in '0.007", 9),
        ((T, changed(V, 0, np.inf), Z), r"line 2: volts is infinite", 2),
        ((changed(T, 20, T[19]), V, Z), r"line 22: time 0.019 s repeats that of the row before \(1 such", 22),
        ((changed(T, 20, 0.001), V, Z), r"line 22: time 0.001 s is earlier than", 22),
        ((T[:2], V[:2], Z[:2]), r"2 rows; at least 50 are needed", None),
    ],
    ids=[
        "constant-voltage",
        "constant-displacement",
        "denormal",
        "nan",
        "infinite",
        "repeated-time",
        "backwards",
        "two-samples",
    ],
)
def test_what_cannot_be_used_is_refused(
    tmp_path: Path, columns: tuple[np.ndarray, ...], reason: str, line: int | None
) -> None:
    with pytest.raises(RecordError, match=reason) as raised:
        read_record(text(tmp_path / "bad.csv", *columns, head="t,V,z\n"))
    assert (raised.value.row, raised.value.source) == (line, str(tmp_path / "bad.csv"))
    arrays = [np.asarray(column) for column in columns]
    with pytest.raises(RecordError):
        Record.from_arrays(arrays[1], arrays[2], time=arrays[0])


@pytest.mark.parametrize("cell", ["", "abc", "1.2.3", "1,5"])
def test_a_bad_cell_is_named_by_its_line(tmp_path: Path, cell: str) -> None:
    path = text(tmp_path / "bad.csv", T, V, Z, head="# bench 3\n\nt,V,z\n")
    lines = path.read_text().splitlines()
    lines[103] = f"0.1,{cell}" if cell == "" else f"0.1,{cell}x,3"
    path.write_text("\n".join(lines))
    with pytest.raises(RecordError, match=r"line 104: \w+ is missing or no number in '0\.1,") as raised:
        read_record(path)
    assert raised.value.row == 104
    assert read_record(path, drop_bad_rows=True).volts.tolist() == np.delete(V, 100).tolist()


def test_bad_rows_are_left_out_on_request_only(tmp_path: Path) -> None:
    """Rows 10 to 14 without numbers make a gap; a time stamp far ahead of its neighbours costs what it overtakes."""
    z, t = Z.copy(), changed(T, 200, T[199])
    z[10:15] = np.nan
    record = read_record(text(tmp_path / "bad.csv", t, V, z, head="t,V,z\n"), drop_bad_rows=True)
    assert record.dropped == 6
    assert record.segments == (slice(0, 10), slice(10, ROWS - 6))
    assert record.volts.tolist() == np.delete(V, [*range(10, 15), 200]).tolist()
    assert record.sample_rate == pytest.approx(1000.0, rel=0.01)


@pytest.mark.parametrize(
    ("head", "options", "reason"),
    [
        (
            "t (s),V (V),z (um)\n",
            {"volts": 3, "displacement": 2},
            r"volts: column 3 'z' \(um\) is in um; volts is in V",
        ),
        ("t,V,z\n", {"volts": "U"}, r"no column 'U'; there are column 1 't' \(begins 0, 0.001, 0.002\), column 2 'V' "),
        ("t,V,z\n", {"volts": 0}, r"no column 0; they count from 1"),
        ("t,V,z\n", {"volts": 2, "displacement": 2}, r"column 2 'V' is named twice, for volts and displacement$"),
        (
            "x-axis,1,2\nsecond,Volt,Volt\n",
            {"volts": "2", "displacement": "3"},
            r"is named twice, for volts and displacement: 2 is its heading, which is taken before a number; give the h",
        ),
        ("a,V,z\n", {}, r"which column is time\? Name it by `time` or give the `sample_rate`"),
        ("t,V,b\n", {}, r"which column is displacement\? Name it by `displacement`; there are column 1 't'"),
        ("t (s),V (um),b (um)\n", {"volts": 2}, r"volts: column 2 'V' \(um\) is in um"),
        (
            "t (s),a (V),b (V)\n",
            {},
            r"several columns could be it \(column 2 'a' \(V\), column 3 'b' \(V\)\); name one by `volts`",
        ),
        ("t,0.5,z\n", {}, r"line 1: 't,0.5,z' is neither names nor numbers only"),
    ],
)
def test_columns_that_cannot_be_found_are_told(
    tmp_path: Path, head: str, options: dict[str, str | int], reason: str
) -> None:
    with pytest.raises(RecordError, match=reason):
        read_record(text(tmp_path / "r.csv", T, V, Z, head=head), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("ending", [".csv", ".npz", ".mat", ".h5", ".parquet", ".feather", ".xlsx", ".tdms"])
@pytest.mark.parametrize(
    "content", [b"", b"no numbers here", b"\x89PNG\r\n\0\0\0\0", b"PK\3\4 torn", b"\x89HDF\r\n\x1a\n torn"]
)
def test_no_file_that_is_no_record_gets_further(tmp_path: Path, ending: str, content: bytes) -> None:
    path = tmp_path / f"odd{ending}"
    path.write_bytes(content)
    with pytest.raises(RecordError, match="odd"):
        read_record(path)
    with pytest.raises(FileNotFoundError):
        read_record(tmp_path / f"none{ending}")


def test_an_angle_is_no_displacement_until_its_scale_is_stated(tmp_path: Path) -> None:
    path = text(tmp_path / "r.csv", T, V, Z, head="t (s),V (V),z (mrad)\n")
    with pytest.raises(RecordError, match=r"'z' .mrad. is in mrad; .*`displacement_scale`"):
        read_record(path)
    record = read_record(path, displacement_scale=25.0)
    np.testing.assert_allclose(record.displacement, 25 * Z, rtol=1e-6)
    assert any("'z' is in mrad, and um are what the scale makes of it" in words for words in examine(record).warnings)


def test_a_share_is_neither_displacement_nor_voltage_until_its_scale_is_stated(tmp_path: Path) -> None:
    path = text(tmp_path / "r.csv", T, V, Z, head="t (s),V (%),z (percent)\n")
    with pytest.raises(RecordError, match=r"'V' .%. is in %; .*`volts_scale`"):
        read_record(path)
    with pytest.raises(RecordError, match=r"'z' .percent. is in percent; .*`displacement_scale`"):
        read_record(path, volts_scale=1.5)
    np.testing.assert_allclose(read_record(path, volts_scale=1.5, displacement_scale=0.3).volts, 1.5 * V, rtol=1e-6)


@pytest.mark.parametrize(("off", "said"), [(1.0, False), (1.0004, False), (1.01, True)])
def test_a_sample_rate_that_is_a_little_off_the_stamps_is_said(tmp_path: Path, off: float, said: bool) -> None:
    path = text(tmp_path / "r.csv", T, V, Z, head="t (s),V (V),z (um)\n")
    stamps = 1 / (T[1] - T[0])
    record = read_record(path, sample_rate=off * stamps)
    assert record.contradictions == ()
    assert (f"not used, although they have {stamps:.6g} Hz" in record.unused) == said
    assert any("although they have" in words for words in examine(record).warnings) == said


def test_settings_that_contradict_are_refused(tmp_path: Path) -> None:
    path = text(tmp_path / "r.csv", T, V, Z, head="t,V,z\n")
    with pytest.raises(SettingError, match="displacement_unit = 'V': must be one of um, nm, mm, m"):
        read_record(path, displacement_unit="V")
    with pytest.raises(SettingError, match="sample_rate = 5"):
        read_record(path, sample_rate=5.0, time="t")
    with pytest.raises(SettingError, match="sample_rate"):
        Record.from_arrays(V, Z)
    with pytest.raises(RecordError, match="volts has 300 rows, but displacement has 299"):
        Record.from_arrays(V, Z[1:], sample_rate=1e3)


def test_sample_rate_survives_coarse_time_stamps() -> None:
    """3 kHz stamped in steps of 0.1 ms: intervals of 0.3 and 0.4 ms, whose median would say 3333 Hz."""
    t = np.round(np.arange(ROWS) / 3000.0, 4)
    assert Record.from_arrays(V, Z, time=t).sample_rate == pytest.approx(3000.0, rel=1e-3)


def test_memory_for_text_is_that_of_the_result(tmp_path: Path) -> None:
    """Of 400,000 rows (14 MB of text): 24 bytes a row stay; on the way some chunks of 1 MB, however long the file."""
    rows = 400_000
    t = np.arange(rows) / 1e4
    block = "\n".join(f"{a:.4f},{b:.5f},{c:.4f},0.000000000" for a, b, c in zip(t, np.sin(t), np.cos(t), strict=True))
    (tmp_path / "long.csv").write_text("t,V,z,other\n" + block)
    del block
    tracemalloc.start()
    record = read_record(tmp_path / "long.csv")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert record.time.size == rows
    assert peak < 24 * rows + 16 * rows + 8e6  # result, temporary differences of the time, chunks


def test_the_measured_record() -> None:
    path = SHARED / "data/p885_91/Model_Vi_Do.dat"
    if not path.is_file():
        pytest.skip(f"the measured record is not at {path}; TRUESTROKE_SHARED names the folder")
    record = read_record(path, volts=1, displacement=5, sample_rate=200.0)
    assert record.volts.size == 8027
    assert (record.volts.min(), record.volts.max()) == (0.0, 3.6)
    assert record.displacement[0] == -123.059139


def test_units_of_columns_that_white_space_separates(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(
        "# bench 3\n# time (ms)  drive (V)  z (mm)\n"
        + "\n".join(f"{1e3 * t:.9g} {v:.9g} {1e-3 * z:.9g}" for t, v, z in zip(T, V, Z, strict=True))
    )
    is_the_record(read_record(tmp_path / "a.txt"))


@pytest.mark.parametrize("style", [".4f", ".6e", ".0f"])
def test_a_last_number_that_is_cut_off_is_left_out(tmp_path: Path, style: str) -> None:
    """A file that ends within its last number: 12.3 of 12.3456 is no measurement; a whole one without a line end is."""
    z = 1000 + 500 * np.sin(20 * T)
    rows = "t (s),V (V),z (um)\n" + "\n".join(f"{a:.4f},{b:.6f},{c:{style}}" for a, b, c in zip(T, V, z, strict=True))
    path = tmp_path / "r.csv"
    path.write_text(rows)
    whole = read_record(path)
    for cut in (1, 2):
        path.write_text(rows[:-cut])
        record = read_record(path)
        assert (record.dropped, whole.dropped) == (1, 0)
        np.testing.assert_array_equal(record.displacement, whole.displacement[:-1])
    path.write_text(rows + "\n")
    assert read_record(path).dropped == 0


def test_what_old_c_libraries_write_for_no_number_is_missing(tmp_path: Path) -> None:
    """-1.#IND was read as -1, before a comment."""
    path = text(tmp_path / "r.csv", T, V, Z, head="t,V,z\n")
    lines = path.read_text().splitlines()
    lines[100] = lines[100].rpartition(",")[0] + ",-1.#IND"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordError, match=r"line 101: displacement is missing or no number in '.*-1.#IND'"):
        read_record(path)


@pytest.mark.parametrize("separator", [",", "\t", ";"])
@pytest.mark.parametrize("missing", [1, 2])
def test_a_header_belongs_to_rows_that_begin_without_measurement(tmp_path: Path, separator: str, missing: int) -> None:
    """The names, and with them the units, were lost where the first rows end with empty cells."""
    rows = [[f"{1e3 * a:.1f}", f"{1e3 * b:.3f}", f"{1e3 * c:.2f}"] for a, b, c in zip(T, V, Z, strict=True)]
    for row in rows[:4]:
        row[-missing:] = [""] * missing
    head = [["time (ms)", "volts (mV)", "z (nm)"]]
    path = tmp_path / "r.txt"
    path.write_text("\n".join(map(separator.join, head + rows)) + "\n")
    record = read_record(path)
    assert record.dropped == 4
    np.testing.assert_allclose(record.displacement, Z[4:], atol=1e-5)
    np.testing.assert_allclose(record.volts, V[4:], atol=1e-6)


@pytest.mark.parametrize(
    ("head", "separator"),
    [
        ("time,volts,z,remark\nms,mV,nm,\n", ","),  # a row of units is not complete
        ("time\tvolts\tz\tremark\n(ms)\t(mV)\t(nm)\t\n", "\t"),
        ("time (milliseconds),volts (millivolts),z (Nanometers),remark\n", ","),
        ("Time (ms)  Control voltage (mV)  Measured position (nm)  Row number\n", "  "),  # blanks in names
    ],
)
def test_units_are_read_whatever_stands_beside_them(tmp_path: Path, head: str, separator: str) -> None:
    record = read_record(
        text(tmp_path / "r.txt", 1e3 * T, 1e3 * V, 1e3 * Z, np.arange(ROWS), head=head, separator=separator),
        displacement=3,
    )
    is_the_record(record)


@pytest.mark.parametrize("separator", [",", "\t", ";"])
@pytest.mark.parametrize("behind", [1, 2])
@pytest.mark.parametrize("missing", [0, 1, 3])
def test_separators_may_end_each_row(tmp_path: Path, separator: str, behind: int, missing: int) -> None:
    """As of a table that has empty columns behind: the header was lost, or the numbers taken for decimal commas."""
    z = [""] * missing + [f"{value:.4f}" for value in 1e3 * Z[missing:]]
    rows = [separator.join([f"{a:.1f}", f"{b:.3f}", c]) for a, b, c in zip(1e3 * T, 1e3 * V, z, strict=True)]
    lines = [separator.join(["time (ms)", "volts (mV)", "z (nm)"]), *(row + separator * behind for row in rows)]
    (tmp_path / "r.txt").write_text("\n".join(lines) + "\n")
    record = read_record(tmp_path / "r.txt")
    np.testing.assert_allclose(record.displacement, Z[missing:], atol=1e-6)
    assert record.columns["displacement"].unit == "nm"


def test_a_file_of_labview_names_one_column_more_than_it_has(tmp_path: Path) -> None:
    head = "LabVIEW Measurement\t\nChannels\t2\t\t\n***End_of_Header***\t\t\nX_Value\tPosition\tVoltage\tComment\n"
    is_the_record(read_record(text(tmp_path / "r.lvm", T, Z, V, head=head, separator="\t")))


@pytest.mark.parametrize("between", ["", "\nRun 2\nt,V,z\n"])
def test_several_runs_in_one_file_are_none(tmp_path: Path, between: str) -> None:
    """With `drop_bad_rows` all but the first run were left out."""
    path = text(tmp_path / "r.csv", T, V, Z, head="t,V,z\n")
    first = path.read_text()
    path.write_text(first + between + first.partition("\n")[2])
    with pytest.raises(RecordError, match=r"line \d+: the time starts again, 0 s behind 0.299 s: are several runs"):
        read_record(path, drop_bad_rows=True)


def _clock(seconds: float, point: str) -> str:
    """The time of day, 23:59:59.900, from s since midnight of the first day."""
    s = round(1000 * seconds) % 86_400_000
    return f"{s // 3_600_000:02}:{s // 60_000 % 60:02}:{s // 1000 % 60:02}{point}{s % 1000:03}"


@pytest.mark.parametrize(
    ("head", "stamp"),
    [
        ("time", lambda s: _clock(s, ".")),
        ("time", lambda s: _clock(s, ":")),  # as LabVIEW and loggers write milliseconds
        ("date,time", lambda s: f"{'2026-12-31' if s < 86400 else '2027-01-01'},{_clock(s, '.')}"),
        ("time (s)", lambda s: f"{s % 86400:.3f}"),
        ("time (ms)", lambda s: f"{1000 * (s % 86400):.0f}"),
    ],
)
def test_a_record_goes_on_over_midnight(tmp_path: Path, head: str, stamp: Callable[[float], str]) -> None:
    rows = [f"{stamp(86399.9 + t)},{v:.6f},{z:.6f}" for t, v, z in zip(T, V, Z, strict=True)]
    (tmp_path / "r.csv").write_text("\n".join([f"{head},volts (V),z (um)", *rows]))
    record = read_record(tmp_path / "r.csv")
    np.testing.assert_allclose(record.time - record.time[0], T, atol=1e-6)
    assert record.sample_rate == pytest.approx(1000.0)


def test_two_runs_of_a_day_each_are_no_record_over_midnight(tmp_path: Path) -> None:
    """Nor is a run whose clock was set back by some hours, or that goes on after hours."""
    for first, second in ((0.0, 0.0), (80_000.0, 0.0), (86_399.9, 7200.0)):
        day = np.concatenate([first + np.linspace(0.0, 86_399.7 - first, T.size) * (first == 0.0) + T, second + T])
        np.savetxt(tmp_path / "r.csv", np.column_stack([day, *np.tile([V, Z], 2)]), fmt="%.4f", header="time (s),V,z")
        with pytest.raises(RecordError, match="the time starts again"):
            read_record(tmp_path / "r.csv")


@pytest.mark.parametrize("digits", [1, 2])
def test_stamps_that_are_too_coarse_ask_for_the_sample_rate(tmp_path: Path, digits: int) -> None:
    """Of rows with one stamp `drop_bad_rows` would leave all but one out."""
    path = text(tmp_path / "r.csv", np.floor(T * 10**digits + 1e-9) / 10**digits, V, Z, head="t,V,z\n")
    with pytest.raises(RecordError, match=r"too coarse; give the `sample_rate`, by them about 1000 Hz$"):
        read_record(path)


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        (lambda i: i >= 30, 32),
        (lambda i: i == 450, 452),
        (lambda i: i < 5, 2),
    ],
    ids=["from within what the layout is found by", "one row", "at the beginning"],
)
@pytest.mark.parametrize("columns", [(0, 1, 2), (2,)], ids=["all columns", "the last column"])
def test_decimal_commas_of_some_rows_between_commas_are_named(rows, line, columns, tmp_path):
    """22,5 in the last column was read as 22, and no word said; in all columns the time repeated."""
    lines = ["time (s),volts (V),z (um)"]
    for i in range(500):
        cells = [f"{value:.3f}" for value in (i / 100, np.sin(i / 20), 10 * np.sin(i / 20 - 0.2))]
        for k in columns if rows(i) else ():
            cells[k] = cells[k].replace(".", ",")
        lines.append(",".join(cells))
    path = tmp_path / "half.csv"
    path.write_text("\n".join(lines) + "\n")
    words = (
        rf"line {line}: .* has {3 + len(columns)} numbers, the columns are 3: are there decimal commas between commas"
    )
    with pytest.raises(RecordError, match=words):
        read_record(path)


@pytest.mark.parametrize(("role", "heading"), [("time", "t"), ("volts", "V"), ("displacement", "z")])
def test_of_a_column_without_numbers_the_remedy_is_another_column(tmp_path: Path, role: str, heading: str) -> None:
    """`drop_bad_rows` was named, which left no row; so it was with fewer rows than a record has."""
    columns = {"time": T, "volts": V, "displacement": Z} | {role: np.full(ROWS, np.nan)}
    path = text(tmp_path / "a.csv", *columns.values(), Z + 1.0, head="t (s),V,z (um),other\n")
    for drop in (False, True):
        with pytest.raises(
            RecordError, match=rf"{role}( \({heading}\))? has no number in all \d+ rows: name .* `{role}`"
        ):
            read_record(path, drop_bad_rows=drop)
    assert read_record(path, **{role: "other"}).time.size == ROWS if role == "displacement" else True
    assert read_record(path, sample_rate=1000.0).time.size == ROWS if role == "time" else True


def test_rows_are_not_to_be_dropped_where_too_few_remain(tmp_path: Path) -> None:
    moved = np.where(np.arange(ROWS) % (ROWS // 20) == 0, Z, np.nan)
    with pytest.raises(RecordError, match="displacement is missing") as caught:
        read_record(text(tmp_path / "a.csv", T, V, moved, head="t (s),V,z (um)\n"))
    assert "drop_bad_rows" not in str(caught.value)
