"""NPZ files, whose sizes are checked before memory is taken."""

import math
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import files
from truestroke.base.files import FileError

HEADERS: dict[tuple[int, int], Callable[..., Any]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def names(path: Path, wrong: Callable[[str], FileError]) -> list[str]:
    """Names of the arrays; ``wrong(reason)`` is raised where there are none to be read."""
    with files.reading(path, wrong), zipfile.ZipFile(path) as file:
        return [name.removesuffix(".npy") for name in file.namelist()]


def read(path: Path, wanted: Sequence[str], wrong: Callable[[str], FileError]) -> dict[str, npt.NDArray[Any]]:
    """Arrays by name; ``wrong(reason)`` is raised where one cannot be read."""
    with files.reading(path, wrong):
        with zipfile.ZipFile(path) as file:
            members = {info.filename.removesuffix(".npy"): info for info in file.infolist()}
            sizes = [_size(file, name, members[name], wrong) for name in wanted]
        files.check_size(path, "its arrays", sum(sizes))
        with np.load(path) as held:
            return {name: np.asarray(held[name]) for name in wanted}


def moments(path: Path, names: Sequence[str], wrong: Callable[[str], FileError]) -> list[bool]:
    """Of which of these arrays the values are dates, times or durations."""
    with files.reading(path, wrong), zipfile.ZipFile(path) as file:
        held = {info.filename for info in file.infolist()}
        return [f"{name}.npy" in held and _is_moment(file, f"{name}.npy") for name in names]


def _is_moment(file: zipfile.ZipFile, member: str) -> bool:
    with file.open(member) as stream:
        read = HEADERS.get(np.lib.format.read_magic(stream))
        return read is not None and read(stream)[2].kind in "Mm"


def _size(file: zipfile.ZipFile, name: str, member: zipfile.ZipInfo, wrong: Callable[[str], FileError]) -> int:
    """Bytes that an array takes; they must be there."""
    with file.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        if version not in HEADERS:
            raise wrong(f"{name} is no array of numbers")
        shape, _, dtype = HEADERS[version](stream)
    size = int(math.prod(shape) * dtype.itemsize)
    if size > member.file_size:
        raise wrong(f"{name} of shape {shape} needs {size} bytes: must be {member.file_size} at most, as in the file")
    return size
