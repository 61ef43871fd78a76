"""HDF5 files, also those that are being written or whose writer was killed.

HDF5 itself opens such files by its single-writer multiple-reader mode; where they are damaged, it then tries again for
hours. Here they are opened as they would be had they been closed, and a checksum that is wrong is an error at once.
"""

import hashlib
import io
import json
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

FORMAT = "truestroke recording"
ENDING = "ending"  # dataset of a recording that grew while it ran: JSON that is known only at its end, bytes
SIGNATURE = b"\x89HDF\r\n\x1a\n"
SUPERBLOCK = 48  # bytes of it in version 3: signature, version, sizes, flags, four addresses, checksum
FLAGS = 11  # place of the mark "open for writing"
END = slice(28, 36)  # where the file ended when it was opened
WORD = 0xFFFFFFFF
HEAP = b"GCOL\1\0\0\0"  # begins a heap of texts
BLOCK = 1 << 24  # bytes that are looked at at a time


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An HDF5 file to read."""
    import h5py

    _check_heaps(path)
    with ExitStack() as held:
        try:
            file = h5py.File(path, "r")
        except OSError:
            if (head := _closed(path)) is None:
                raise
            file = h5py.File(held.enter_context(_Unfinished(path, head)), "r")
        yield held.enter_context(file)


@contextmanager
def written(path: Path, **options: Any) -> Iterator[Any]:
    """An HDF5 file to write, `options` as of `h5py.File`; an OSError of the disk is raised when HDF5 has closed it.

    HDF5 itself crashes at the end of the process where the disk has refused a part of a file.
    """
    import h5py

    with path.open("wb+", buffering=0) as disk, _Refusable(disk) as place, h5py.File(place, "w", **options) as file:
        yield file


class _Refusable:
    """A file whose disk may refuse to take more: all of it is in memory from then on, and leaving it is an error."""

    def __init__(self, file: io.FileIO) -> None:
        self._file: io.FileIO | io.BytesIO = file
        self._refused: OSError | None = None

    def __enter__(self) -> "_Refusable":
        return self

    def __exit__(self, *_: object) -> None:
        if self._refused is not None:
            raise self._refused

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: memoryview) -> int:
        """All of the data."""
        done = 0
        try:
            while done < len(data):
                done += self._file.write(data[done:])
        except OSError as error:
            self._refused = error
            self._to_memory()
            self._file.write(data[done:])
        return len(data)

    def truncate(self, size: int) -> int:
        """To a size, be it larger."""
        try:
            return self._file.truncate(size)
        except OSError as error:
            self._refused = error
            self._to_memory()
            return self._file.truncate(size)

    def _to_memory(self) -> None:
        place, disk = self._file.tell(), self._file
        disk.seek(0)
        self._file = io.BytesIO(disk.read())
        self._file.seek(place)


def _closed(path: Path) -> bytes | None:
    """First bytes of a file as if it were closed and ended where it does; None where they are not right."""
    with path.open("rb") as file:
        head = bytearray(file.read(SUPERBLOCK))
        size = file.seek(0, io.SEEK_END)
    if len(head) < SUPERBLOCK or head[:9] != SIGNATURE + b"\3" or head[-4:] != checksum(head[:-4]):
        return None
    head[FLAGS] = 0
    head[END] = size.to_bytes(8, "little")
    return bytes(head[:-4] + checksum(head[:-4]))


def _check_heaps(path: Path) -> None:
    """ValueError where HDF5 would loop endlessly: a heap of texts with an object of no size or too large."""
    with path.open("rb") as file:
        for start in range(0, os.fstat(file.fileno()).st_size, BLOCK):
            file.seek(start)
            block = file.read(BLOCK + len(HEAP) - 1)
            for found in re.finditer(re.escape(HEAP), block):
                file.seek(start + found.start())
                size = int.from_bytes(file.read(16)[8:], "little")
                file.seek(start + found.start())
                _walk(file.read(min(size, BLOCK)), size)


def _walk(heap: bytes, whole: int) -> None:
    """Over the objects of a heap: each has index, size and data; the size of the free space, index 0, is all of it."""
    place = 16
    while len(heap) - place >= 16:
        index, size = (int.from_bytes(heap[place + a : place + b], "little") for a, b in ((0, 2), (8, 16)))
        if index == size == 0:
            raise ValueError("a heap of texts has an object of no size")
        if size > whole - place:
            raise ValueError("a heap of texts has an object that is larger than the heap")
        place += 16 + (size + 7) // 8 * 8 if index else size


def channels(file: Any) -> dict[str, Any]:
    """Datasets of a recording that are channels: they have a unit; an index of columns and the `ENDING` have none."""
    return {name: data for name, data in file.items() if "unit" in data.attrs}


def digest(file: Any) -> str:
    """SHA-256 over all that describes the channels of a recording; HDF5 itself has no checksum of texts."""
    texts = ("unit", "description", "time")
    about = {
        name: [str(data.dtype), list(data.shape[1:]), *(str(data.attrs[key]) for key in texts)]
        for name, data in channels(file).items()
    }
    return hashlib.sha256(json.dumps([file.attrs["metadata"], about]).encode()).hexdigest()


def intact(file: Any) -> bool:
    """Whether a file is no recording, or one without checksums, or matches its digest."""
    if file.attrs.get("format") != FORMAT or int(file.attrs["format_version"]) < 2:
        return True
    return bool(file.attrs["checksum"] == digest(file))


class _Unfinished(io.FileIO):
    """A file whose first bytes are others."""

    def __init__(self, path: Path, head: bytes) -> None:
        super().__init__(path, "rb")
        self._head = head

    def readinto(self, buffer: Any, /) -> int:
        start, view = self.tell(), memoryview(buffer).cast("B")
        size = super().readinto(view) or 0
        if start < len(self._head):
            part = self._head[start : start + size]
            view[: len(part)] = part
        return size


def checksum(data: bytes | bytearray) -> bytes:
    """Bob Jenkins' lookup3, as HDF5 has it behind its tables.

    >>> checksum(b"Four score and seven years ago").hex()  # 0x17770551 in its author's own test
    '51057717'
    """
    a = b = c = (0xDEADBEEF + len(data)) & WORD
    *blocks, last = (bytes(data[i : i + 12]).ljust(12, b"\0") for i in range(0, len(data), 12))
    for block in blocks:
        a, b, c = _added(a, b, c, block)
        for shift in (4, 6, 8, 16, 19, 4):
            a, b, c = _mixed(a, b, c, shift)
    a, b, c = _added(a, b, c, last)
    for shift in (14, 11, 25, 16, 4, 14, 24):  # each word in turn: c, a, b, c, ...
        c = ((c ^ b) - _rotated(b, shift)) & WORD
        a, b, c = b, c, a
    return b.to_bytes(4, "little")


def _added(a: int, b: int, c: int, block: bytes) -> tuple[int, int, int]:
    x, y, z = (int.from_bytes(block[i : i + 4], "little") for i in (0, 4, 8))
    return (a + x) & WORD, (b + y) & WORD, (c + z) & WORD


def _mixed(a: int, b: int, c: int, shift: int) -> tuple[int, int, int]:
    """A step of its mixing, and the words turned by one."""
    a = ((a - c) & WORD) ^ _rotated(c, shift)
    return b, (c + b) & WORD, a


def _rotated(word: int, shift: int) -> int:
    return (word << shift | word >> (32 - shift)) & WORD
