"""The fake controller of tests/fakes/gcs.py, in a process of its own, and what a voltmeter at its outputs reads."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

SERVER = Path(__file__).parent / "fakes/gcs.py"


@dataclass(frozen=True)
class Fake:
    port: int
    file: Path

    def make(self, **settings: object) -> None:
        """A new controller, at rest, with settings and faults of tests/fakes/gcs.py."""
        with socket.create_connection(("127.0.0.1", self.port)) as connection:
            connection.sendall(b"FAKE " + json.dumps(settings).encode() + b"\n")
            assert connection.recv(3) == b"ok\n"

    def _read(self) -> np.ndarray:
        return np.fromfile(self.file, np.float64)

    @property
    def volts(self) -> list[float]:
        """At the piezo outputs, V."""
        return self._read()[:2].tolist()

    @property
    def step(self) -> float:
        """The largest that an output has made, V."""
        return self._read()[2]

    def left(self) -> bool:
        """Whether all connections are closed, soon."""
        end = time.monotonic() + 30
        while self._read()[4] and time.monotonic() < end:
            time.sleep(0.01)
        return self._read()[4] == 0


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory):
    file = tmp_path_factory.mktemp("pi") / "outputs"
    process = subprocess.Popen([sys.executable, SERVER, file], stdout=subprocess.PIPE, text=True)
    try:
        yield Fake(int(process.stdout.readline()), file)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def fake(server: Fake) -> Fake:
    """A fresh controller for each test."""
    server.make()
    return server
