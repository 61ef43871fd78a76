"""A file is read as what it is, or refused by its name with the remedy."""

import bz2
import gzip
import json
import pickle
import re
import zipfile
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from truestroke.identification import RecordError, examine, read_record

T = np.arange(200) / 100.0
TABLE = np.column_stack([T, 5 - 5 * np.cos(9 * T), 2 - 2 * np.cos(9 * T - 0.1)])
VOLTS, MOVED = TABLE[:, 1], TABLE[:, 2]
LINES = [",".join(f"{v:.5f}" for v in row) for row in TABLE]
TEXT = "time (s),volts (V),z (um)\n" + "\n".join(LINES) + "\n"


def test_a_text_of_two_bytes_without_a_mark_and_decimal_commas_between_spaces(tmp_path: Path) -> None:
    (file := tmp_path / "a.csv").write_bytes(TEXT.encode("utf-16-le"))
    assert np.allclose(read_record(file).volts, TABLE[:, 1], atol=1e-5)
    spaced = TEXT.replace(" (", "(").replace(",", " ").replace(".", ",")
    (file := tmp_path / "b.dat").write_text(spaced)
    assert np.allclose(read_record(file).displacement, TABLE[:, 2], atol=1e-5)


GCS = """# REM E-727
# VERSION = 1
# SEPARATOR = 32
# DIM = 2
# SAMPLE_TIME = 0.000500
# NAME0 = Control Output of chan1
# NAME1 = Current Position of Axis1
# END_HEADER
"""


def test_the_header_of_a_pi_controller_has_names_and_sample_time(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_text(GCS + "\n".join(f"{v:.6f} {z:.6f}" for v, z in zip(VOLTS, MOVED, strict=True)))
    record = read_record(tmp_path / "a.dat", volts="Control Output of chan1", displacement="Current Position of Axis1")
    assert (record.sample_rate, record.time[-1]) == (pytest.approx(2000.0), pytest.approx((VOLTS.size - 1) / 2000.0))
    np.testing.assert_allclose(record.displacement, MOVED, atol=1e-6)
    with pytest.raises(RecordError, match=r"there are column 1 'Control Output of chan1'"):
        read_record(tmp_path / "a.dat")


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("0x00A{},2.5,5.1", "hexadecimal numbers: write decimal ones"),
        ("0.{}|2.5|5.1", "| between the columns: write commas"),
        ("11:22:0{}.5 PM,2.5,5.1", "AM or PM: write 13:45:00"),
        ("0.{} s,2.5 V,5.1 um", "units beside the numbers: write them in the heading"),
        ("t=0.{} V=2.5 z=5.1", "names beside the numbers"),
        ("[0.{} 2.5 5.1]", "brackets: write the numbers alone"),
        ("row,0.{},2.5,5.1", "a row has numbers alone"),
    ],
)
def test_what_keeps_rows_from_being_numbers_is_named(tmp_path: Path, row: str, says: str) -> None:
    (tmp_path / "a.csv").write_text("\n".join(row.format(k % 10) for k in range(60)))
    with pytest.raises(RecordError, match=re.escape(says)):
        read_record(tmp_path / "a.csv")


def test_signals_in_rows_are_named(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.vstack([VOLTS, MOVED]))
    with pytest.raises(RecordError, match="the signals are in rows; transpose the matrix"):
        read_record(tmp_path / "a.npy", sample_rate=100.0)
    (tmp_path / "a.csv").write_text("\n".join(",".join(f"{v:.4f}" for v in x) for x in (VOLTS, MOVED)))
    with pytest.raises(RecordError, match=r"and \d+ more: are the signals in rows\? Transpose them") as said:
        read_record(tmp_path / "a.csv", sample_rate=100.0)
    assert len(str(said.value)) < 2000


def test_objects_of_python_and_texts_are_named(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array({"volts": VOLTS}, dtype=object))
    with pytest.raises(RecordError, match=r"it holds objects of Python; np\.savez writes"):
        read_record(tmp_path / "a.npy", sample_rate=100.0)
    np.savez(tmp_path / "a.npz", volts=VOLTS.astype(str), z=MOVED)
    with pytest.raises(RecordError, match="write its numbers as numbers, not as text"):
        read_record(tmp_path / "a.npz", sample_rate=100.0)


def test_counts_of_hdf5_with_scale_and_offset_are_numbers(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["volts"] = VOLTS
        file["z"] = np.round(1e3 * (MOVED - 2.0)).astype(np.int16)
        file["z"].attrs.update(scale_factor=1e-3, add_offset=2.0, units="um")
    np.testing.assert_allclose(read_record(tmp_path / "a.h5", sample_rate=100.0).displacement, MOVED, atol=6e-4)


def test_another_sheet_and_cells_of_text_are_named(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["Operator", "me"])
    book.create_sheet("Data").append([0.0, 1.0])
    book.save(tmp_path / "a.xlsx")
    with pytest.raises(RecordError, match=r"is the record on another sheet \(Data\)\? Move it to the front"):
        read_record(tmp_path / "a.xlsx")
    book.remove(book["Data"])
    book.active.append(["0,5", "1,5"])
    book.save(tmp_path / "b.xlsx")
    with pytest.raises(RecordError, match="its numbers are texts: convert the cells to numbers"):
        read_record(tmp_path / "b.xlsx")


def test_an_array_of_numpy_is_a_table(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", TABLE)
    record = read_record(tmp_path / "a.npy", time=1, volts=2, displacement=3)
    assert np.array_equal(record.displacement, TABLE[:, 2])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.csv.gz", gzip.compress(TEXT.encode()), "compressed by gzip; unpack it: gunzip"),
        ("a.csv", bz2.compress(TEXT.encode()), "compressed by bzip2"),
        ("a.xlsx", TEXT.encode(), "this is text; call it .csv"),
        ("a.json", json.dumps({"t": [1, 2]}).encode(), "JSON; write its arrays"),
        ("a.pkl", pickle.dumps({"t": [1.0]}), "a pickle of Python"),
        ("a.wav", b"RIFF0000WAVE", "sound or video"),
        ("a.csv", b"PAR1", "call it .parquet"),
        ("a.csv", TEXT.replace(".", ",").encode(), "3 names stand above 6 whole numbers"),
        ("a.csv", TEXT.replace(",", ";").replace(".", "0.123,").encode(), "has marks between thousands"),
        (
            "a.csv",
            b"t,v,z\n" + b'0.5,"1.25","2.5"\n' * 60 + b'0.6,"1,001.25","2,002.5"\n',
            "line 62: .*'1,001.25' has marks",
        ),
        ("a.csv", b"t,v,z\n" + b'0.5,"1","2"\n' * 60 + b'0.6,"1,001","2,002"\n', "line 62: .*'2,002' may have a mark"),
        ("a.csv", b"t;v;z\n" + b"0,5;1;2\n" * 60 + b"0,6;1.001;2.002\n", "line 62: .*'2.002' may have a mark"),
        ("a.csv", b"t,v,z\n" + b"0.5,1,25,2,5\n" * 60, "3 names stand above 4 whole numbers"),
    ],
)
def test_any_other_is_refused_by_its_name(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    (file := tmp_path / name).write_bytes(content)
    with pytest.raises(RecordError, match=says):
        read_record(file)


@pytest.mark.parametrize(
    ("inside", "says"), [("xl/book.xml", "an Excel workbook"), ("a.csv", "a zip archive of a.csv")]
)
def test_archives(tmp_path: Path, inside: str, says: str) -> None:
    with zipfile.ZipFile(file := tmp_path / "a.csv", "w") as parts:
        parts.writestr(inside, TEXT)
    with pytest.raises(RecordError, match=says):
        read_record(file)


@pytest.mark.parametrize("heading", ["time (h)", "t/h", "time (hours)"])
def test_hours(tmp_path: Path, heading: str) -> None:
    lines = [f"{t / 3600:.9f},{line.split(',', 1)[1]}" for t, line in zip(T, LINES, strict=True)]
    (file := tmp_path / "a.csv").write_text(f"{heading},volts (V),z (um)\n" + "\n".join(lines))
    assert read_record(file).sample_rate == pytest.approx(100.0)


def test_days_of_a_spreadsheet_are_asked_for_and_read(tmp_path: Path) -> None:
    lines = [f"{46000.5 + t / 86400:.10f},{line.split(',', 1)[1]}" for t, line in zip(T, LINES, strict=True)]
    (file := tmp_path / "a.csv").write_text("time,volts (V),z (um)\n" + "\n".join(lines))
    assert "are they in days, as of a spreadsheet (`time_unit` day)?" in examine(read_record(file)).mistakes[0]
    assert read_record(file, time_unit="day").sample_rate == pytest.approx(100.0, rel=1e-3)


def test_a_row_of_units_above_the_names(tmp_path: Path) -> None:
    (file := tmp_path / "a.csv").write_text("s,V,nm\ntime,volts,z\n" + "\n".join(LINES))
    assert np.allclose(read_record(file).displacement, 1e-3 * MOVED, atol=1e-8)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("45:00.198,18.5360,5.4669", "has times of minutes and seconds: write s"),
        ("0.198,\u221231.4640,5.4669", "has minus signs of typography: write -"),
    ],
)
def test_times_and_minus_signs_that_are_no_numbers(tmp_path: Path, line: str, words: str) -> None:
    (file := tmp_path / "a.csv").write_text("time,volts,z\n" + f"{line}\n" * 60)
    with pytest.raises(RecordError, match=words):
        read_record(file)


def test_thousands_behind_a_space_that_does_not_break(tmp_path: Path) -> None:
    (file := tmp_path / "a.csv").write_text(TEXT.replace(",", ";") + "2.0;1\u00a0005.0;2.0\n2.01;5.0;2.0\n")
    with pytest.raises(RecordError, match=r"'1 005\.0' has marks between thousands"):
        read_record(file)


@pytest.mark.parametrize("unit", ["A", "in"])
def test_a_unit_that_is_not_read_is_not_taken_for_um(tmp_path: Path, unit: str) -> None:
    (file := tmp_path / "a.csv").write_text(TEXT.replace("um", unit))
    with pytest.raises(RecordError, match="`displacement_scale` says how many um one of them is"):
        read_record(file)


def _commas(line: str) -> str:
    return line.replace(".", ",")


@pytest.mark.parametrize("head", ["time (s){0}volts (V){0}z (um)\n", ""])
@pytest.mark.parametrize("separator", [";", "\t", " ", ","])
@pytest.mark.parametrize("options", [{}, {"drop_bad_rows": True}])
def test_decimal_commas_in_some_rows_are_named(
    tmp_path: Path, separator: str, head: str, options: dict[str, bool]
) -> None:
    """Without the rows of one kind half of the motion is lost, in silence."""
    rows = [line.replace(".", ",").replace(" ", separator) if k % 3 == 0 else line.replace(" ", separator)
            for k, line in enumerate(each.replace(",", " ") for each in LINES)]  # fmt: skip
    (file := tmp_path / "a.csv").write_text(head.format(separator) + "\n".join(rows))
    with pytest.raises(RecordError, match=r"has decimal commas .* decimal points .*: write decimal points in all rows"):
        read_record(file, **options)


def test_decimal_commas_from_some_row_on_are_named(tmp_path: Path) -> None:
    """Behind the rows of which the layout is found; one such row alone is a damaged one."""
    lines = [line.replace(",", ";") for line in LINES] * 3
    times = [f"{k / 100:.2f};{line.split(';', 1)[1]}" for k, line in enumerate(lines)]
    rows = times[:250] + [_commas(line) for line in times[250:]]
    (file := tmp_path / "a.csv").write_text("time (s);volts (V);z (um)\n" + "\n".join(rows))
    with pytest.raises(RecordError, match=r"line 252 has decimal commas .*line 2 decimal points"):
        read_record(file, drop_bad_rows=True)
    rows = [*times[:250], _commas(times[250]), *times[251:]]
    file.write_text("time (s);volts (V);z (um)\n" + "\n".join(rows))
    assert read_record(file, drop_bad_rows=True).dropped == 1


@pytest.mark.parametrize("head", ["time\tvolts\tz\n", "time volts z\n", ""])
def test_tabs_and_blanks_separate_alike(tmp_path: Path, head: str) -> None:
    ways = "{}\t{}\t{}", "{}  {} {}", "{} {}\t{}"
    rows = [ways[k % 3].format(*line.split(",")) for k, line in enumerate(LINES)]
    for first in range(3):
        (file := tmp_path / "a.txt").write_text(head + "\n".join(rows[first:]))
        assert np.allclose(read_record(file).displacement, MOVED[first:], atol=1e-4)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("\n \n", "the file is empty"),
        (
            "time,volts,z\n" + "0.1,2.0,\u22123.0\n" + "\n".join(LINES),
            "leave it out; it has minus signs of .*: write -",
        ),
    ],
)
def test_what_is_wrong_at_the_beginning_is_said(tmp_path: Path, text: str, words: str) -> None:
    (file := tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordError, match=words):
        read_record(file)


def test_matrices_of_matlab_beside_other_variables(tmp_path: Path) -> None:
    """A scope writes one beside its settings, Simulink one beside the time."""
    matrix = np.array([[float(cell) for cell in line.split(",")] for line in LINES])
    savemat(file := tmp_path / "scope.mat", {"ScopeData": matrix, "note": "bench 3", "gain": 2.0})
    assert np.allclose(read_record(file).displacement, matrix[:, 2])
    savemat(file, {"out": {"time": matrix[:, 0], "signals": {"values": matrix[:, 1:], "label": "a"}}})
    record = read_record(file, volts="out/signals/values:1", displacement="out/signals/values:2")
    assert np.allclose(record.displacement, matrix[:, 2])
    with pytest.raises(RecordError, match="column 2 'out/signals/values:1'"):
        read_record(file)
    each = np.array([(matrix[:, 0], matrix[:, 1])] * 2, dtype=[("t", "O"), ("u", "O")])
    savemat(file, {"run": each})
    with pytest.raises(RecordError, match=r"no array of numbers by itself.*'-struct'"):
        read_record(file)


@pytest.mark.parametrize(("role", "unit"), [("volts", "kV/cm"), ("volts", "mA"), ("displacement", "microstrain")])
def test_a_field_and_a_strain_need_a_scale(tmp_path: Path, role: str, unit: str) -> None:
    units = {"volts": "V", "displacement": "um"} | {role: unit}
    (file := tmp_path / "a.csv").write_text(
        "time (s),a ({volts}),b ({displacement})\n".format(**units) + "\n".join(LINES)
    )
    with pytest.raises(RecordError, match=f"`{role}_scale` says how many"):
        read_record(file, volts=2, displacement=3)
    assert read_record(file, volts=2, displacement=3, **{f"{role}_scale": 2.0}).columns[role].stated
