"""A file is read as what it is, or refused by its name with the remedy."""

import bz2
import gzip
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from truestroke.identification import RecordError, read_record

T = np.arange(200) / 100.0
TABLE = np.column_stack([T, 5 - 5 * np.cos(9 * T), 2 - 2 * np.cos(9 * T - 0.1)])
LINES = [",".join(f"{v:.5f}" for v in row) for row in TABLE]
TEXT = "time (s),volts (V),z (um)\n" + "\n".join(LINES) + "\n"


def test_a_text_of_two_bytes_without_a_mark_and_decimal_commas_between_spaces(tmp_path: Path) -> None:
    (file := tmp_path / "a.csv").write_bytes(TEXT.encode("utf-16-le"))
    assert np.allclose(read_record(file).volts, TABLE[:, 1], atol=1e-5)
    spaced = TEXT.replace(" (", "(").replace(",", " ").replace(".", ",")
    (file := tmp_path / "b.dat").write_text(spaced)
    assert np.allclose(read_record(file).displacement, TABLE[:, 2], atol=1e-5)


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
