"""Damaged files: read, or refused in one line that says why, without taking the memory that they ask for."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from truestroke import Recording, trajectories
from truestroke.base import hdf5
from truestroke.base.files import FileError
from truestroke.identification import RecordError, load_model, read_record
from truestroke.signals.recording import Channel

FUZZ = Path(__file__).parents[1] / "benchmarks/fuzz_readers.py"


def test_damaged_files_of_all_kinds_are_read_or_refused_in_one_line() -> None:
    """A seeded part of benchmarks/fuzz_readers.py."""
    command = [sys.executable, FUZZ, "--cases", "300", "--seed", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout == "300 damaged files, 0 neither read nor refused in one line\n"


def recording(path: Path) -> Path:
    time = np.arange(200) / 2000.0
    return Recording({"time": Channel(time, "s", "t"), "volts": Channel(time, "V", "x")}, {"a": "text"}).save(path)


def test_a_recording_with_a_flipped_bit_is_refused_or_the_same(tmp_path: Path) -> None:
    path = recording(tmp_path / "run.h5")
    good, data = Recording.load(path), path.read_bytes()
    refused = 0
    for bit in np.random.default_rng(0).integers(0, 8 * len(data), 300).tolist():
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        path.write_bytes(broken)
        try:
            held = Recording.load(path)
        except FileError as error:
            refused += "\n" not in str(error)
            continue
        assert held.metadata == good.metadata, bit
        for name, channel in good.channels.items():
            other = held.channels[name]
            assert (other.unit, other.description, other.time) == (channel.unit, channel.description, channel.time)
            assert other.data.tobytes() == channel.data.tobytes(), bit
    assert refused > 50


def test_an_npz_that_asks_for_7_tib_is_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(header, about)
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as file:
        for name in ("time", "volts", "z"):
            file.writestr(f"{name}.npy", header.getvalue())
    with pytest.raises(RecordError, match=r"needs 8000000000000 bytes: must be \d+ at most, as in the file"):
        read_record(tmp_path / "huge.npz")
    with pytest.raises(RecordError, match="needs 8000000000000 bytes"):
        trajectories.from_csv(tmp_path / "huge.npz")


def test_an_hdf5_that_asks_for_more_than_it_can_hold_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        for name in ("time", "volts", "z"):
            file.create_dataset(name, shape=(10**9,), chunks=(1000,), dtype=float)
    with pytest.raises(FileError, match=r"huge.h5: \w+ needs 8 GB of memory: must be of .* MB at most"):
        read_record(tmp_path / "huge.h5")
    path = recording(tmp_path / "run.h5")
    with h5py.File(path, "r+", libver="latest") as file:
        for name in ("time", "volts"):
            attributes = dict(file[name].attrs)
            del file[name]
            file.create_dataset(name, shape=(10**9,), chunks=(1000,), dtype=float).attrs.update(attributes)
        file.attrs["checksum"] = hdf5.digest(file)
    with pytest.raises(FileError, match="the recording needs 16 GB of memory"):
        Recording.load(path)


def test_a_heap_of_texts_that_goes_in_a_circle_is_refused(tmp_path: Path) -> None:
    """HDF5 itself would not come back."""
    path = recording(tmp_path / "run.h5")
    data = bytearray(path.read_bytes())
    heap = data.index(hdf5.HEAP)
    data[heap + 16 : heap + 32] = bytes(16)
    path.write_bytes(data)
    with pytest.raises(FileError, match="a heap of texts has an object of no size"):
        Recording.load(path)


@pytest.mark.parametrize("weights", ["a0 = [1, [2]]", 'a0 = "x"', "a0 = 1e999"])
def test_a_model_with_strange_weights_is_one_line(tmp_path: Path, weights: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text('format = "truestroke model"\nversion = 1\n[model]\n[weights]\n' + weights)
    with pytest.raises(FileError) as told:
        load_model(path)
    assert "\n" not in str(told.value)
