"""The fake NI card of tests/fakes/nidaqmx.c, compiled, found by the unmodified `nidaqmx`, and read from outside."""

from __future__ import annotations

import ctypes
import struct
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from truestroke.base.declared import kernel_values
from truestroke.plant import PlantSettings
from truestroke.plant.settings import NEVER, PLANT_SETTINGS

ROOT = Path(__file__).parents[1]
SONAME = "libnidaqmx.so.1"


def compile_library(folder: Path) -> Path:
    """The fake library in `folder`, with the default stack at 10 kHz: one sample a step of the converters."""
    plant = kernel_values(PlantSettings(sample_rate=10_000.0, samples_per_tick=1, steps_per_tick=2), PLANT_SETTINGS)
    members = ", ".join(f".{name} = {value!r}" for name, value in plant.items())
    members = members.replace("-inf", "-INFINITY").replace(" inf", " INFINITY").replace(str(NEVER), "TS_NEVER")
    sources = [ROOT / "tests/fakes/nidaqmx.c", ROOT / "c/plant/plant.c"]
    target = folder / SONAME
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-Wl,-soname,{SONAME}"]
    settings = f"-DPLANT_SETTINGS={{{members}}}"
    subprocess.run(["gcc", *flags, settings, f"-I{ROOT}/c/plant", *sources, "-o", target, "-lm"], check=True)
    (folder / "libnidaqmx.so").symlink_to(SONAME)
    return target


REGISTER = "4d4qdd4d"
SIZE = struct.calcsize(REGISTER)


@dataclass(frozen=True)
class Card:
    """What a voltmeter at the card's terminals, and the card's maker, see. Any process may look."""

    file: Path
    library: Path

    def _read(self) -> tuple:
        deadline = time.monotonic() + 30.0
        while len(found := self.file.read_bytes()) != SIZE and time.monotonic() < deadline:
            time.sleep(0.01)  # the card is being made
        return struct.unpack(REGISTER, found)

    @property
    def volts(self) -> list[float]:
        found = self._read()
        expired = 0 < found[9] < time.monotonic()  # by the card's own watchdog
        return list(found[10:14] if expired else found[:4])

    @property
    def edges(self) -> int:
        return self._read()[4]

    @property
    def tasks(self) -> int:
        return self._read()[5]

    @property
    def owner(self) -> int:
        return self._read()[6]

    @property
    def resets(self) -> int:
        return self._read()[7]

    @property
    def step(self) -> float:
        return self._read()[8]

    @property
    def deadline(self) -> float:
        """When the card's own watchdog expires, s; 0 if it is not armed."""
        return self._read()[9]

    def environment(self) -> dict[str, str]:
        """For a process that shall find this card."""
        return {"LD_LIBRARY_PATH": str(self.library.parent), "FAKE_NIDAQMX": str(self.file)}


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library, loaded: the wheel then finds it by its soname, as it would one that is installed."""
    path = compile_library(tmp_path_factory.mktemp("nidaqmx"))
    ctypes.CDLL(str(path), ctypes.RTLD_GLOBAL)
    return path


@pytest.fixture
def card(library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Card:
    """A card of its own for each test."""
    card = Card(tmp_path / "card", library)
    for name, value in card.environment().items():
        monkeypatch.setenv(name, value)
    return card
