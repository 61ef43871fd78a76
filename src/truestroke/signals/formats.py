"""Of which format a file is by its first bytes, whatever its name ends with, and what its numbers are written like."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

KINDS: dict[bytes, tuple[str, tuple[str, ...], str]] = {
    b"\x1f\x8b": ("compressed by gzip", (), "unpack it: gunzip {path}"),
    b"BZh": ("compressed by bzip2", (), "unpack it: bunzip2 {path}"),
    b"\xfd7zXZ": ("compressed by xz", (), "unpack it: unxz {path}"),
    b"\x28\xb5\x2f\xfd": ("compressed by zstd", (), "unpack it: unzstd {path}"),
    b"7z\xbc\xaf": ("a 7-Zip archive", (), "unpack it"),
    b"\x93NUMPY": ("an array of NumPy", (".npy",), "call it .npy"),
    b"\x89HDF": ("HDF5", (".h5", ".hdf5", ".mat"), "call it .h5"),
    b"MATLAB 5.0": ("of MATLAB", (".mat",), "call it .mat"),
    b"PAR1": ("Parquet", (".parquet",), "call it .parquet"),
    b"ARROW1": ("Feather", (".feather",), "call it .feather"),
    b"TDSm": ("TDMS", (".tdms",), "call it .tdms"),
    b"\xd0\xcf\x11\xe0": ("an old Excel or Origin document", (), "save it as .xlsx or .csv"),
    b"RIFF": ("sound or video", (), "save its samples as .csv or .npz, with their scales"),
    b"MDF ": ("of a measurement system (MDF)", (), "export it as .csv or .h5"),
    b"%PDF": ("a PDF", (), "export the numbers as .csv"),
    b"<?xml": ("XML", (), "export the numbers as .csv"),
    b"<!DOCTYPE": ("a web page", (), "export the numbers as .csv"),
    b"<html": ("a web page", (), "export the numbers as .csv"),
    **dict.fromkeys((b'{"', b"[[", b"[{", b"{\n", b"[\n"), ("JSON", (), "write its arrays as .csv or .npz")),
    b"\x80\x04\x95": ("a pickle of Python", (), "write its arrays as .npz"),
    b"\x80\x05\x95": ("a pickle of Python", (), "write its arrays as .npz"),
}
"""By the first bytes: what it is, the endings that it may have, and the remedy for any other."""

ZIPPED = (".npz", ".xlsx", ".xlsm")
THOUSANDS = re.compile(
    r"(?<![\d.,])\d{1,3}(?:(?:\.\d{3})+,\d+|(?:,\d{3})+\.\d+|(?:(?:'|\\xa0|\\u202f)\d{3})+(?:[.,]\d+)?)(?![\d.,])"
)
EITHER = re.compile(r"(?:^|(?<=[;\t\"]))\s*([+-]?(?:\d+,\d+|\d{1,3}(?:\.\d{3})+))\s*(?=$|[;\t\"])")  # a field alone
EMPTY = re.compile(r"(;|,|\t|\\t)\s*(;|,|\t|\\t|'?$)")  # a field without a number
DECIMAL_COMMAS = re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?(\s+[+-]?\d+(,\d+)?([eE][+-]?\d+)?)+")


UNREADABLE = {
    re.compile(r"\u2212\d"): "has minus signs of typography: write -",
    re.compile(r"(^|[,;\t])\s*\"?\d+:\d\d([.,]\d+)?\"?\s*([,;\t]|$)"): "has times of minutes and seconds: write s",
    re.compile(r"\b0x[0-9a-f]+\b", re.IGNORECASE): "has hexadecimal numbers: write decimal ones",
    re.compile(r"\d\s*\|\s*[-+.\d]"): "has | between the columns: write commas, semicolons or tabs",
    re.compile(r"\d:\d\d(:\d\d[.\d]*)?\s*[AP]M", re.IGNORECASE): "has times with AM or PM: write 13:45:00, or s",
    re.compile(r"\d\s*(V|mV|um|µm|nm|mm|s|ms)\s*([,;\t]|$)"): "has units beside the numbers: write them in the heading",
    re.compile(
        r"\w\s*[=:]\s*[-+.\d]+.*\w\s*[=:]\s*[-+.\d]+"
    ): "has names beside the numbers: write them in the heading",
    re.compile(r"[\[({].*\d"): "has brackets: write the numbers alone",
}
"""What keeps a line from being numbers, and the remedy."""


def unreadable(line: str, usual: str = "; a row has numbers alone, between them , ; tabs or blanks") -> str:
    """Why a line is no row of numbers, and the remedy; `usual`, what such a row is, where nothing is known.

    Examples
    --------
    >>> unreadable("0x0000C6,2.2487"), unreadable("start,2.2487")
    ('; it has hexadecimal numbers: write decimal ones', '; a row has numbers alone, between them , ; tabs or blanks')
    """
    found = next((words for pattern, words in UNREADABLE.items() if pattern.search(line)), "")
    return f"; it {found}" if found else usual


def other(path: Path) -> str:
    """What a file is in fact, and the remedy, where it is not what its name ends with; else empty."""
    with path.open("rb") as file:
        start = file.read(16)
    ending = path.suffix.lower()
    if start.startswith(b"PK\x03\x04"):
        return "" if ending in ZIPPED else _zipped(path)
    plain = bool(start) and start.isascii() and b"\0" not in start
    if ending in ZIPPED[1:] and plain and not start.startswith(b"PK"):
        return "text; call it .csv"
    if ending == ".mat" and plain and not start.startswith(b"MATLAB"):  # of `save -ascii`
        return "text; call it .txt"
    for magic, (what, endings, remedy) in KINDS.items():
        if start.startswith(magic) and ending not in endings:
            return f"{what}; {remedy.format(path=path)}"
    return ""


def _zipped(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as parts:
            names = parts.namelist()
    except zipfile.BadZipFile:
        return "a damaged zip archive"
    if any(name.startswith("xl/") for name in names):
        return "an Excel workbook; call it .xlsx"
    if all(name.endswith(".npy") for name in names):
        return "arrays of NumPy; call it .npz"
    return f"a zip archive of {', '.join(names[:3])}; unpack it"


def wide(start: bytes) -> str:
    """Encoding of a text whose letters have two bytes, without a mark at its begin; else empty.

    Examples
    --------
    >>> wide("time,volts".encode("utf-16-le")), wide(b"time,volts")
    ('utf-16-le', '')
    """
    half = max(len(start) // 2, 1)
    for encoding, first in (("utf-16-le", 1), ("utf-16-be", 0)):
        if start[first::2].count(0) > 0.9 * half and start[1 - first :: 2].count(0) < 0.1 * half:
            return encoding
    return ""


def thousands(text: str) -> str:
    """That a number of a line has marks between its thousands, or may have, with the remedy; else empty.

    For a line that could not be read.

    Examples
    --------
    >>> thousands("0,25;5,29;1.001,4852")
    "; '1.001,4852' has marks between thousands: export the numbers without"
    >>> thousands('0.25,"1,234"')
    "; '1,234' may have a mark between thousands or a decimal one: export with decimal points, and no other marks"
    >>> thousands("0.25,5.29,1001.4852"), thousands("0.25;1.234;")
    ('', '')
    """
    if found := THOUSANDS.search(text):
        number = re.sub(r"\\xa0|\\u202f", " ", found[0])  # as repr writes spaces that do not break
        return f"; {number!r} has marks between thousands: export the numbers without"
    if not EMPTY.search(text) and (either := EITHER.findall(text.strip("'\n").replace("\\t", "\t"))):
        what = "may have a mark between thousands or a decimal one"
        return f"; {either[-1]!r} {what}: export with decimal points, and no other marks"
    return ""
