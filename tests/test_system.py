"""Without the parts of Python that only POSIX has all works, the loop in real time with its watchdog, too."""

from __future__ import annotations

import ctypes
import dataclasses
import fcntl
import gc
import math
import os
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import numpy as np
import psutil
import pytest
from running import configuration

import truestroke
from truestroke.base import files, system
from truestroke.runtime.doctor import Level, machine
from truestroke.runtime.realtime import RealtimeError, RealtimeSettings, process
from truestroke.signals.timing import Timing

# What others than we need of POSIX at import is there when they load; the loop loads no more than the first line.
LOADED = "import numpy, h5py, rich.console, tempfile, psutil, ctypes.util, subprocess, concurrent.futures.process\n"
PICTURES = "import scipy.linalg, scipy.signal, scipy.optimize, matplotlib.pyplot\n"
# What Python has on Linux and not on Windows, as its documentation lists it; less what Python itself needs on Linux.
ONLY_POSIX = {
    "os": "sched_getaffinity sched_setaffinity sched_getscheduler sched_setscheduler sched_getparam sched_yield getuid "
    "memfd_create pidfd_open fork forkpty pread pwrite preadv pwritev sysconf confstr O_CLOEXEC O_NONBLOCK O_DIRECTORY "
    "geteuid getgid getegid getpgid setsid setpgid getpriority setpriority killpg mkfifo "
    "mknod chown fchmod fchown openpty ttyname posix_fallocate posix_fadvise sendfile sync nice getrandom",
    "signal": "SIGHUP SIGUSR1 SIGUSR2 SIGALRM SIGPIPE SIGCHLD SIGCONT SIGSTOP SIGTSTP pthread_kill alarm pause "
    "pthread_sigmask setitimer sigwait siginterrupt pidfd_send_signal",
    "socket": "AF_UNIX SCM_RIGHTS",
    "select": "poll epoll",
    "time": "clock_gettime clock_gettime_ns CLOCK_MONOTONIC",
}
WITHOUT_POSIX = f"""
import os, select, signal, socket, sys, time
for module, names in {ONLY_POSIX!r}.items():
    for name in names.split():
        if hasattr(sys.modules[module], name):
            delattr(sys.modules[module], name)
signal.SIGBREAK = 21  # Windows has it
for name in ("fcntl", "resource", "pwd", "grp", "termios", "pty", "tty", "syslog"):
    sys.modules[name] = None
"""


WITHOUT_POSIX += "import truestroke.base.system\ntruestroke.base.system.INHERITS = False\n"
IN_A_HELPER = f"""
import sys
if "-P" in sys.orig_argv:
    import numpy, h5py, psutil, ctypes.util, subprocess, tempfile
    exec({WITHOUT_POSIX!r})
"""  # Python does it first: the processes of a run are begun with -P


def python(folder: Path, code: str, loaded: str = LOADED) -> subprocess.CompletedProcess[str]:
    (folder / "sitecustomize.py").write_text(IN_A_HELPER)
    command = [sys.executable, "-c", loaded + WITHOUT_POSIX + code]
    env = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=600, check=False)


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return python(folder, f"from truestroke.cli import main\nmain({list(arguments)!r})")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("windows")


COMMANDS = """
import numpy
import truestroke
for name in truestroke.__all__:
    getattr(truestroke, name)
from truestroke.cli import main
from truestroke.runtime.drivers import OneAxis, SimulatedDriver
sizes = "--sample-rate 2000 --stroke 30 --voltage-limits -0.6 3.6"
for line in ("track --duration 2 --output first", f"export c {sizes} --output chip"):
    try:
        main(line.split())
    except SystemExit as end:
        assert not end.code, line
driver = SimulatedDriver()
with OneAxis(driver, voltage_limits=(-0.6, 3.6), slew=400.0, safe_voltage=0.5) as axis:
    axis.open()
    for _ in range(50):
        axis.exchange(numpy.array([1.0]))
    assert driver.output[0] == 1.0
assert driver.output[0] == 0.5
"""


def test_the_package_loads_and_makes_a_run_and_its_page_a_chip_and_an_axis(folder: Path) -> None:
    done = python(folder, COMMANDS, LOADED + PICTURES)
    assert done.returncode == 0, done.stderr
    assert {"first.h5", "first.html", "chip"} <= {path.name for path in folder.iterdir()}


ABORT = '[{ kind = "abort", at = 1000 }]'


def test_the_loop_in_real_time(folder: Path) -> None:
    """It replaces a file while it has it open."""
    (folder / "run.toml").write_text(configuration(duration=1.0, watchdog_timeout=20.0))
    (folder / "run.h5").write_text("an older one")
    done = call(folder, "run", "--config", "run.toml", "--overwrite")
    assert done.returncode == 0, done.stderr
    assert "truestroke: nothing on linux bounds how late a tick is" in done.stderr
    recording = truestroke.Recording.load(folder / "run.h5")
    assert recording.metadata["interrupted"] is None
    assert len(recording.metadata["notices"]) == 1
    assert len(recording["time"]) == 2000
    assert np.fromfile(folder / "volts") == 0.25


def test_a_run_says_where_nothing_bounds_lateness_and_where_the_timer_is_coarse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A system like Windows before its finer timers: a sleep ends by steps of 15.6 ms."""
    now = [0.003]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: now.append(now.pop() // 0.0156 * 0.0156 + 0.01560001))
    assert system.timer_step() == pytest.approx(0.0156, rel=1e-3)
    monkeypatch.undo()
    monkeypatch.setattr(system, "BOUNDS_LATENESS", False)
    monkeypatch.setattr(system, "timer_step", lambda: 0.0156)
    settings, timing = RealtimeSettings(), Timing(sample_rate=2000.0)
    bound, coarse = process.lateness_of_system(settings, timing)
    assert bound == "nothing on linux bounds how late a tick is: the recording has the lateness of each"
    assert coarse.startswith("the timer of this system goes by steps of 16 ms: blocks of 0.5 ms are up to 15 ms late")
    assert len(process.lateness_of_system(dataclasses.replace(settings, spin=0.016), timing)) == 1
    assert process.lateness_of_system(settings, dataclasses.replace(timing, hardware_timed=True)) == []
    found = {finding.what: finding for finding in machine.look(probe=0.01)}
    assert found["timer"].level is Level.WARNING
    assert "spin = 0.016 in [realtime]" in found["timer"].found
    assert found["real time"].level is Level.WARNING


def test_its_watchdog(folder: Path) -> None:
    (folder / "run.toml").write_text(
        configuration(ABORT, duration=1.0, watchdog_timeout=20.0).replace("run.h5", "dead.h5")
    )
    done = call(folder, "run", "--config", "run.toml")
    assert done.returncode == -signal.SIGABRT
    assert "truestroke: watchdog: the process is gone; output set to 0.25 V" in done.stderr
    assert np.fromfile(folder / "volts") == 0.25
    recording = truestroke.Recording.load(folder / "dead.h5")
    assert "the watchdog set the output to the safe voltage" in recording.metadata["interrupted"]


def test_a_system_that_can_start_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "HAS_PROCESSES", False)
    with pytest.raises(RealtimeError, match="cannot watch the loop"):
        process.require_realtime()
    found = {finding.what: finding for finding in machine.look()}
    assert (found["real time"].level, found["real time"].required) == (Level.MISSING, True)


def test_doctor_says_what_there_is(folder: Path) -> None:
    done = call(folder, "doctor")
    assert "none on" in done.stdout, done.stdout + done.stderr
    assert "lateness" in done.stdout
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
    monkeypatch.delattr(psutil.Process, "cpu_affinity")  # as on macOS
    assert system.processors() == list(range(os.cpu_count() or 1))
    assert system.memory() == 16 * 2**30


def scheduled(name: str) -> float:
    """What Linux says of the scheduling of this thread; NaN where it does not."""
    file = Path("/proc/thread-self/sched")
    rows = [line.split(":") for line in file.read_text().splitlines()] if file.exists() else []
    return next((float(row[1]) for row in rows if row[0].strip() == name), math.nan)


def test_the_loop_has_short_slices_and_its_priority_of_before() -> None:
    """Linux says so itself; of a kernel before 6.12, which has no `slice` of a thread, nothing is asked."""
    before = scheduled("se.slice"), scheduled("prio")
    with process.undisturbed(RealtimeSettings()):
        during = scheduled("se.slice"), scheduled("prio")
    assert math.isnan(before[0]) or during == (1e9 * process.SLICE, before[1])
    assert str((scheduled("se.slice"), scheduled("prio"))) == str(before)


def test_what_a_caller_has_frozen_is_frozen_after_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what a run freezes by itself is not."""
    monkeypatch.setattr(process, "gc", gc)  # not as tests/conftest.py has it
    gc.freeze()
    frozen = gc.get_freeze_count()
    with process.undisturbed(RealtimeSettings()):
        assert not gc.isenabled()
    assert (gc.get_freeze_count(), gc.isenabled()) == (frozen, True)
    gc.unfreeze()
    with process.undisturbed(RealtimeSettings()):
        assert gc.get_freeze_count()
    assert gc.get_freeze_count() == 0
    gc.freeze()


@pytest.mark.parametrize("said", [None, "another machine"])
def test_a_system_without_slices_runs_as_it_is(monkeypatch: pytest.MonkeyPatch, said: str | None) -> None:
    monkeypatch.setattr(sys, "platform", "linux" if said else "darwin")
    monkeypatch.setattr(os, "uname", lambda: types.SimpleNamespace(machine=said))
    before = scheduled("se.slice")
    with system.short_slices(process.SLICE):
        assert str(scheduled("se.slice")) == str(before)


GIVES_WAY = """
import os, sys, time
from truestroke.base import system
system.yield_to_others(7)
print(os.getpriority(os.PRIO_PROCESS, 0))
if os.path.exists("/proc/self/autogroup"):
    print(open("/proc/self/autogroup").read().split()[-1])
"""


@pytest.mark.parametrize("leads", [True, False], ids=["a session of its own", "the session of another"])
def test_who_gives_way_gives_way_to_other_sessions_too(leads: bool) -> None:
    """Linux compares priorities within a session only; that of another program keeps its own."""
    command = [sys.executable, "-c", GIVES_WAY]
    if not leads:
        command = [sys.executable, "-c", f"import subprocess; subprocess.run({command!r}, check=True)"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, start_new_session=True)
    mine = os.getpriority(os.PRIO_PROCESS, 0)
    priority, *group = map(int, done.stdout.split())
    assert priority == mine + 7
    assert group in ([], [mine + 7 if leads else 0])


AS_MACOS = "import fcntl\nfor name in ('F_OFD_GETLK', 'F_OFD_SETLK', 'F_OFD_SETLKW'): vars(fcntl).pop(name, None)\n"


@pytest.mark.parametrize("macos", [False, True], ids=["Linux", "macOS"])
def test_another_process_sees_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, macos: bool) -> None:
    if macos:
        monkeypatch.delattr(fcntl, "F_OFD_GETLK")
        monkeypatch.delattr(fcntl, "F_OFD_SETLK")
    growing = files.grow(tmp_path / "a", overwrite=False, empty=lambda _: True)
    code = (
        f"{AS_MACOS * macos}from pathlib import Path\nfrom truestroke.base import files\nprint(files.busy(Path('a')))"
    )
    asked = {"args": [sys.executable, "-c", code], "cwd": tmp_path, "capture_output": True, "text": True, "check": True}
    assert subprocess.run(**asked).stdout == "True\n"
    assert files.busy(tmp_path / "a")  # asked from here, it is not lost
    assert subprocess.run(**asked).stdout == "True\n"
    growing.close()
    assert subprocess.run(**asked).stdout == "False\n"


class Kernel32:
    """LockFile and UnlockFile, whose locks belong to a handle."""

    def __init__(self) -> None:
        self.locks: dict[tuple[int, int], int | None] = {}

    def LockFile(self, handle: ctypes.c_void_p, low: int, high: int, count: int, _: int) -> int:
        assert (max(low, high) < 2**32, count) == (True, 1)
        return int(self.locks.setdefault((low, high), handle.value) == handle.value)

    def UnlockFile(self, handle: ctypes.c_void_p, low: int, high: int, *_: int) -> int:
        return int(self.locks.pop((low, high), None) == handle.value)

    class CreateFileW:
        """Handles are descriptors and 1000; 7 lets others read, write, rename."""

        def __new__(cls, path: str, access: int, share: int, _: None, kind: int, *more: object) -> int:  # type: ignore[misc]
            assert (access, share) == (0xC0000000, 7)
            return os.open(path, os.O_RDWR | (os.O_CREAT | os.O_EXCL if kind == 1 else 0)) + 1000


def test_the_lock_of_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel, msvcrt = Kernel32(), types.ModuleType("msvcrt")
    msvcrt.get_osfhandle = lambda descriptor: descriptor + 1000  # type: ignore[attr-defined]
    msvcrt.open_osfhandle = lambda handle, flags: handle - 1000  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "msvcrt", msvcrt)
    monkeypatch.setattr(ctypes, "WinDLL", {"kernel32": kernel}.__getitem__, raising=False)
    monkeypatch.setattr(sys, "platform", "win32")
    growing = files.grow(tmp_path / "a", overwrite=False, empty=lambda _: True)
    (place,) = kernel.locks
    assert (place[1] << 32) + place[0] > 2**60  # no recording is so long; writing into a locked byte fails
    assert files.busy(tmp_path / "a")
    os.close(system.reopen(tmp_path / "a"))
    with (tmp_path / "a").open() as other, pytest.raises(BlockingIOError):
        system.lock(other.fileno())
    growing.close()
    kernel.locks.clear()  # as Windows does
    assert not files.busy(tmp_path / "a")
    assert kernel.locks == {}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc")
def test_arrays_that_are_freed_are_given_back_to_the_system():
    """Three of 16 MB in turn: from the second one on glibc keeps them."""
    script = """
import numpy as np
from truestroke.base import system
if {asked}: assert system.return_memory()
def taken():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
def use():
    a = np.ones(1_000_000)
    b = np.ones(2_000_000)
    del a, b
before = taken()
for _ in range(3):
    use()
print(taken() - before)
"""
    kept = [
        int(subprocess.run([sys.executable, "-c", script.format(asked=asked)], capture_output=True, check=True).stdout)
        for asked in (False, True)
    ]
    assert kept[1] < 4e6 < kept[0]
