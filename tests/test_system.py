"""Without the parts of Python that only POSIX has, all but the loop in real time works; that one says so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from truestroke.base import files, system

LOADED = (
    "import numpy, scipy.linalg, scipy.signal, scipy.optimize, h5py, matplotlib.pyplot, rich.console, tempfile\n"
    "import ctypes.util, subprocess, concurrent.futures.process\n"
)  # what others than we need of POSIX at import is there when they load
WITHOUT_POSIX = """
import os, signal, sys
for name in ("sched_getaffinity", "sched_setaffinity", "sched_getscheduler", "sched_setscheduler", "sched_getparam",
             "memfd_create", "pidfd_open", "fork", "pwrite", "sysconf", "O_CLOEXEC"):
    delattr(os, name)
for name in ("SIGHUP", "SIGKILL", "pthread_kill"):
    delattr(signal, name)
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
"""


def python(folder: Path, code: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", LOADED + WITHOUT_POSIX + code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return python(folder, f"from truestroke.cli import main\nmain({list(arguments)!r})")


def test_the_package_loads(tmp_path: Path) -> None:
    done = python(tmp_path, "import truestroke\nfor name in truestroke.__all__: getattr(truestroke, name)")
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("windows")


def test_a_run_and_its_page(folder: Path) -> None:
    done = call(folder, "track", "--duration", "2", "--output", "first")
    assert done.returncode == 0, done.stderr
    assert (folder / "first.html").exists()
    done = call(folder, "report", "first.h5", "--overwrite")
    assert done.returncode == 0, done.stderr


def test_the_loop_in_real_time_is_refused_before_it_touches_anything(folder: Path) -> None:
    (folder / "stage.toml").write_text(call(folder, "run", "--example").stdout)
    done = call(folder, "run", "--config", "stage.toml")
    assert done.returncode != 0
    assert "cannot watch the loop" in done.stderr
    assert not list(folder.glob("run*.h5"))


def test_doctor_says_so(folder: Path) -> None:
    done = call(folder, "doctor")
    assert "none on" in done.stdout, done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_bytes_are_written_at_their_place_without_pwrite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "pwrite")
    growing = files.grow(tmp_path / "a", overwrite=False, empty=lambda _: True)
    growing.write(4, b"later")
    growing.write(0, b"soon")
    growing.close()
    assert (tmp_path / "a").read_bytes() == b"soonlater"


def test_processors_and_memory_where_the_system_does_not_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.delattr(os, "sysconf")
    assert system.processors() == list(range(os.cpu_count() or 1))
    assert system.memory() == 16 * 2**30


def test_another_process_sees_the_lock(tmp_path: Path) -> None:
    growing = files.grow(tmp_path / "a", overwrite=False, empty=lambda _: True)
    code = (
        f"from pathlib import Path\nfrom truestroke.base import files\nprint(files.busy(Path({str(tmp_path / 'a')!r})))"
    )
    asked = [sys.executable, "-c", code]
    assert subprocess.run(asked, capture_output=True, text=True, check=True).stdout == "True\n"
    growing.close()
    assert subprocess.run(asked, capture_output=True, text=True, check=True).stdout == "False\n"
