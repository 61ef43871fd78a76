"""All that differs between operating systems: signals, files and their locks, processors, priority, other processes."""

from __future__ import annotations

import errno
import math
import mmap
import os
import platform
import re
import shlex
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

NAMES = {"SIGINT": "Ctrl-C", "SIGBREAK": "Ctrl-Break", "SIGTERM": "SIGTERM", "SIGHUP": "the terminal is gone"}
ENDING = {int(getattr(signal, name)): words for name, words in NAMES.items() if hasattr(signal, name)}
"""Signals that ask a program to end, and what is said of them."""


def exit_code(number: int) -> int:
    """Of a program that such a signal ended: 128 and its number, as shells say it; Ctrl-Break counts as SIGTERM."""
    return 128 + (int(signal.SIGTERM) if number == getattr(signal, "SIGBREAK", None) else number)


MAKE_FOLDER = ("mkdir",) if sys.platform == "win32" else ("mkdir", "-p")
"""The command that makes a folder, and those above it."""


def command_line(*words: str | Path) -> str:
    """Words as a terminal of this system takes them: in quotes where they have blanks."""
    texts = [str(word) for word in words]
    return subprocess.list2cmdline(texts) if sys.platform == "win32" else shlex.join(texts)


OPEN = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
"""Of `os.open`: bytes as they are, and not for the programs that this one starts."""

HAS_PROCESSES = sys.platform not in ("emscripten", "wasi")
"""Whether a process can start another one that outlives it, as a watchdog has to."""

INHERITS = sys.platform != "win32"
"""Whether a process can be given descriptors of open files by their numbers."""

SELECTED = 512 if sys.platform == "win32" else 1 << 16
"""Connections that a process can wait for at a time."""

SHARES_PORTS = sys.platform == "win32"
"""Whether SO_REUSEADDR lets another program listen at a port that is in use, too."""

_NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL
_LOCK = struct.Struct("@hhqqi4x")  # struct flock
_LOCKED_BYTE = 1 << 62  # far behind the end, where HDF5 and readers lock nothing


NAME = sys.platform
"""Of this system, in words of Python: linux, win32, darwin."""

MACHINE = (platform.system(), platform.machine())
"""System and processor, in words of the system: ("Linux", "x86_64")."""

UNCHECKED = 64e6  # bytes that are taken without a look at the memory that is free
CLOCKS = "/sys/devices/system/clocksource/clocksource0/"
"""Folder of Linux that holds the sources of its clock."""

TIMER_SLACK = "/proc/{}/timerslack_ns"
"""File of Linux in which a process, its number in place of {}, has the lateness of its timers."""

BOUNDS_LATENESS = hasattr(os, "sched_setscheduler")
"""Whether a priority bounds how late a process wakes: Linux."""


def timer_step() -> float:
    """By what steps a sleep ends, s: that of a microsecond, begun where another one has ended; the shortest of five."""
    took = []
    for _ in range(6):
        began = time.perf_counter()
        time.sleep(1e-6)
        took.append(time.perf_counter() - began)
    return min(took[1:])


def limit(name: str) -> float:
    """A limit of this process by its name of POSIX, such as "RTPRIO"; infinity where there is none."""
    try:
        import resource
    except ImportError:
        return math.inf
    found = resource.getrlimit(getattr(resource, f"RLIMIT_{name}"))[0]
    return math.inf if found == resource.RLIM_INFINITY else float(found)


def yield_to_others(steps: int) -> None:
    """A lower priority than other processes, where the system has such steps, 0 to 19.

    Linux may share the processors among sessions, and compares the steps of processes within one session only
    (sched(7), autogroup): the steps of a process that leads a session are those of its session, too.
    """
    if not hasattr(os, "nice"):
        return
    reached = os.nice(steps)
    if hasattr(os, "getsid") and os.getsid(0) == os.getpid():
        with suppress(OSError), open("/proc/self/autogroup", "w") as group:  # no such file: no such sharing
            group.write(str(reached))


def open_sockets() -> Iterator[socket.socket]:
    """Those of this process, each by a descriptor of its own; none where the system does not list them: but Linux."""
    try:
        names = os.listdir("/proc/self/fd")
    except OSError:
        return
    for name in names:
        with suppress(OSError):  # no socket, or gone
            yield socket.socket(fileno=os.dup(int(name)))


def keep_to_loopback(sockets: list[socket.socket]) -> bool:
    """Let nothing from outside reach these sockets, whatever address they listen at, and close them.

    Whether this system allows it: Linux from 5.7 on.
    """
    if not hasattr(socket, "SO_BINDTODEVICE"):
        return False
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
            for one in (trial, *sockets):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")
    except PermissionError:
        return False
    finally:
        for one in sockets:
            one.close()
    return True


# ---- What Linux says of itself: empty elsewhere ---------------------------------------------------------------------


def read(path: str) -> str:
    """The text of a file of the system, empty where there is none."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def quota() -> float:
    """Processors whose time this process may use up; infinity where nothing limits it."""
    used, _, period = read("/sys/fs/cgroup/cpu.max").partition(" ")
    return int(used) / int(period) if used.isdigit() else math.inf


def governors() -> list[str]:
    """The frequency governors of the processors, each once."""
    files = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return sorted({read(str(file)) for file in files})


def swaps() -> list[str]:
    """The swap areas in use, a line each."""
    return read("/proc/swaps").splitlines()[1:]


def kernel() -> tuple[str, str]:
    """Its release, and how far it can be preempted: PREEMPT_RT, another word with PREEMPT, or nothing."""
    version = os.uname().version
    if read("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return os.uname().release, "PREEMPT_RT"
    return os.uname().release, next((word for word in version.split() if "PREEMPT" in word), "")


def clock_source() -> tuple[str, list[str]]:
    """The source of the clock, and those that can be chosen."""
    return read(f"{CLOCKS}current_clocksource"), read(f"{CLOCKS}available_clocksource").split()


def timer_slack() -> int | None:
    """By how much the timers of this process may be late, ns."""
    text = read(TIMER_SLACK.format("self"))
    return int(text) if text.isdigit() else None


# ---- Memory ---------------------------------------------------------------------------------------------------------


def memory() -> int:
    """Bytes of memory of this computer; 16 GiB where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 16 * 2**30


def free_memory() -> int:
    """Bytes that programs can take without swapping; all memory where the system does not say."""
    found = re.search(r"^MemAvailable:\s+(\d+) kB", read("/proc/meminfo"), re.MULTILINE)
    return 1024 * int(found[1]) if found else memory()


def return_memory() -> bool:
    """Give arrays of a MB and more back to the system as soon as they are freed; whether it is asked to.

    glibc keeps for the next one what is as large as an array that was freed before, up to 32 MB, and in each thread.
    """
    import ctypes

    mallopt = getattr(ctypes.CDLL(None) if sys.platform == "linux" else None, "mallopt", None)
    return bool(mallopt and mallopt(_MMAP_THRESHOLD, 1 << 20))


def lacking(needed: float) -> str:
    """How much memory something takes, bytes, and how much is free, in words; "" where that is enough."""
    free = free_memory() if needed > UNCHECKED else needed
    return "" if needed <= free else f"{needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free"


# ---- Processors and priority ---------------------------------------------------------------------------------------


def processors() -> list[int]:
    """The processors that this process may use; all of them where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    asked = getattr(_this_process(), "cpu_affinity", None)  # Windows
    return sorted(asked()) if asked else list(range(os.cpu_count() or 1))


def keep_to(processors: list[int]) -> None:
    """Use these processors alone; OSError where the system has no such call, as macOS."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, processors)
    elif asked := getattr(_this_process(), "cpu_affinity", None):
        asked(processors)
    else:
        raise OSError(errno.ENOTSUP, f"{sys.platform} does not let a process choose its processors")


@contextmanager
def prioritised(priority: int) -> Iterator[None]:
    """Within it, this process is before others: SCHED_FIFO of that `priority`, or, on Windows, the class "high".

    Raises
    ------
    PermissionError
        The system does not allow it to us.
    OSError
        The system has no such call, as macOS.
    """
    if hasattr(os, "sched_setscheduler"):
        policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        try:
            yield
        finally:
            os.sched_setscheduler(0, policy, parameter)
        return
    import psutil

    if not hasattr(psutil, "HIGH_PRIORITY_CLASS"):
        raise OSError(errno.ENOTSUP, f"{sys.platform} has no priority of its own for a process in real time")
    process = _this_process()
    before = process.nice()
    process.nice(psutil.HIGH_PRIORITY_CLASS)
    try:
        yield
    finally:
        process.nice(before)


@contextmanager
def short_slices(seconds: float) -> Iterator[None]:
    """Within it, this thread asks for time slices of `seconds` s, 1e-4 to 0.1: it waits less when it wakes.

    Linux from 6.12 on lets a thread that wakes go before one whose slice is longer, and before that one's slice has
    passed. Its share of the processor is the same, and it needs no permission. Nothing changes on another system, and
    for a thread that has a priority of real time.
    """
    before = _scheduling()
    if before is None:
        yield
        return
    _schedule(before, round(seconds * 1e9))
    try:
        yield
    finally:
        _schedule(before)


_SCHEDULING = struct.Struct("=IIQiIQQQ")  # struct sched_attr, its first version
_SLICE = 5  # of its members: sched_runtime, ns
_CALLS = {"x86_64": (315, 314), "aarch64": (275, 274), "riscv64": (275, 274)}  # sched_getattr, sched_setattr
_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of mallopt
_SHARING = (0, 3)  # SCHED_OTHER, SCHED_BATCH: the policies that have slices


def _scheduling() -> tuple[int, ...] | None:
    """Policy, priority and slice of this thread; None where it has no slice, or the system does not say."""
    calls = _CALLS.get(os.uname().machine) if sys.platform == "linux" and sys.maxsize > 1 << 32 else None
    if calls is None:
        return None
    import ctypes

    found = ctypes.create_string_buffer(_SCHEDULING.size)
    if ctypes.CDLL(None).syscall(calls[0], 0, found, _SCHEDULING.size, 0) != 0:
        return None
    members = _SCHEDULING.unpack(found.raw)
    return members if members[1] in _SHARING else None


def _schedule(members: tuple[int, ...], slice_ns: int | None = None) -> None:
    """Set what `_scheduling` found, with another slice; a system that refuses leaves it as it is."""
    import ctypes

    asked = list(members)
    if slice_ns is not None:
        asked[_SLICE] = slice_ns
    call = _CALLS[os.uname().machine][1]
    ctypes.CDLL(None).syscall(call, 0, ctypes.create_string_buffer(_SCHEDULING.pack(*asked)), 0)


def _this_process() -> Any:
    import psutil

    return psutil.Process()


def protect() -> bool:
    """Keep the system from choosing this process when memory runs out; whether it is allowed to us."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("-1000")
        return True
    return False


def allow_many_files() -> None:
    """As many open files, and so connections, as the system allows this process without asking."""
    with suppress(ImportError):  # of systems without POSIX: they have no such limit
        import resource

        highest = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (highest, highest))


def create(path: Path) -> int:
    """Make a file for reading and writing and open it; FileExistsError where there is one.

    It can be renamed while it is open, which Windows has to be asked for.
    """
    return _open_shared(path, new=True) if sys.platform == "win32" else os.open(path, _NEW | OPEN, 0o666)


def reopen(path: Path) -> int:
    """Open a file for reading and writing, which another process has open by `create`."""
    return _open_shared(path, new=False) if sys.platform == "win32" else os.open(path, os.O_RDWR | OPEN)


def _open_shared(path: Path, new: bool) -> int:
    """CreateFile with the right to rename and remove for everybody, which `os.open` does not give."""
    import ctypes
    import msvcrt

    kernel = _kernel32()
    kernel.CreateFileW.restype = ctypes.c_void_p
    read_write, share_all, create_new, open_existing, ordinary = 0xC0000000, 7, 1, 3, 0x80
    kind = create_new if new else open_existing
    handle = kernel.CreateFileW(str(path), read_write, share_all, None, kind, ordinary, None)
    if handle == ctypes.c_void_p(-1).value:
        number = kernel.GetLastError()
        raise OSError(None, ctypes.FormatError(number).strip(), str(path), number)  # type: ignore[attr-defined,unused-ignore]
    return int(msvcrt.open_osfhandle(handle, os.O_RDWR | OPEN))  # type: ignore[attr-defined,unused-ignore]


def name_of(descriptor: int, path: Path) -> str:
    """A name by which a library can open the open file, whatever `path` names by now; `path` where there is none."""
    by_number = f"/proc/self/fd/{descriptor}"
    return by_number if INHERITS and os.path.exists(by_number) else str(path)


def write_at(descriptor: int, data: bytes, offset: int) -> int:
    """Write bytes of an open file from a place on; how many were written."""
    at: Callable[[int, bytes, int], int] | None = getattr(os, "pwrite", None)
    if at:
        return at(descriptor, data, offset)
    os.lseek(descriptor, offset, os.SEEK_SET)
    return os.write(descriptor, data)


def lock(descriptor: int) -> None:
    """Lock an open file for as long as it is open here or, but for Windows, in a process that inherits it.

    Raises
    ------
    BlockingIOError
        Another process has it.
    """
    taken = _windows("LockFile", descriptor) if sys.platform == "win32" else _posix(descriptor, ask=False)
    if not taken:
        raise BlockingIOError(errno.EAGAIN, "another process has locked it")


def locked(descriptor: int) -> bool:
    """Whether another process has locked the open file; False on a file system without locks."""
    if sys.platform != "win32":
        return not _posix(descriptor, ask=True)
    if not _windows("LockFile", descriptor):
        return True
    _windows("UnlockFile", descriptor)
    return False


def _kernel32() -> Any:
    import ctypes

    return ctypes.WinDLL("kernel32")  # type: ignore[attr-defined,unused-ignore]


def _windows(call: str, descriptor: int) -> bool:
    """LockFile or UnlockFile of the byte, whose place is too far for `msvcrt.locking`."""
    import ctypes
    import msvcrt

    kernel = _kernel32()
    handle = ctypes.c_void_p(msvcrt.get_osfhandle(descriptor))  # type: ignore[attr-defined,unused-ignore]
    return bool(getattr(kernel, call)(handle, _LOCKED_BYTE & 0xFFFFFFFF, _LOCKED_BYTE >> 32, 1, 0))


def _posix(descriptor: int, ask: bool) -> bool:
    """Take the lock, or ask whether it could be taken; True, too, where there are no locks."""
    try:
        import fcntl
    except ImportError:
        return True
    try:
        if hasattr(fcntl, "F_OFD_SETLK"):
            wanted = _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_BYTE, 1, 0)
            said = fcntl.fcntl(descriptor, fcntl.F_OFD_GETLK if ask else fcntl.F_OFD_SETLK, wanted)
            return not ask or bool(_LOCK.unpack(said)[0] == fcntl.F_UNLCK)
        # macOS: the other locks of a byte end with any descriptor of the file, so it is the whole file. HDF5 asks for
        # the same lock: a reader of a file that grows needs HDF5_USE_FILE_LOCKING=FALSE there.
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if ask:
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EINVAL, errno.EOPNOTSUPP):
            raise
    return True


# ---- Other processes -----------------------------------------------------------------------------------------------


def detached(keep: tuple[int, ...], terminal: bool = False) -> dict[str, Any]:
    """Options of `subprocess.Popen` for a process that lives on when the terminal closes, and does not hear its Ctrl-C.

    It has the descriptors `keep`, where processes can be given any. With `terminal` it may write to that terminal,
    which on Windows is only for those that end with it.
    """
    if INHERITS:
        return {"pass_fds": keep, "start_new_session": True}
    if sys.platform != "win32":
        return {"start_new_session": True}
    return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP if terminal else subprocess.CREATE_NO_WINDOW}


class Peer:
    """Another process, by its number: a later process with the same number is not taken for it."""

    def __init__(self, pid: int) -> None:
        import psutil

        self._process: Any = None
        with suppress(psutil.NoSuchProcess):
            self._process = psutil.Process(pid)

    def gone(self) -> bool:
        """Whether it has ended; one that nobody has waited for has, too."""
        import psutil

        try:
            return not (self._process and self._process.is_running() and self._process.status() != psutil.STATUS_ZOMBIE)
        except psutil.NoSuchProcess:
            return True

    def kill(self, patience: float) -> None:
        """End it at once, and wait up to `patience` seconds until it has let go of everything."""
        import psutil

        with suppress(psutil.Error):
            if self._process:
                self._process.kill()
        end = time.monotonic() + patience
        while not self.gone() and time.monotonic() < end:
            time.sleep(0.002)


class Memory:
    """Memory of `size` bytes that processes share; it goes when the last of them has ended.

    On Linux it has no name, and is given by its descriptor. Elsewhere it is `multiprocessing.shared_memory`, which has
    a name until `close`, and on Linux would take from /dev/shm, of which containers have 64 MB.

    Attributes
    ----------
    handle : int or str
        What another process opens it with: ``Memory(size, handle)``. An int is a descriptor that it must inherit.
    buffer : memoryview
        The bytes.
    """

    def __init__(self, size: int, handle: int | str | None = None) -> None:
        self._named: Any = None
        if isinstance(handle, int) or (handle is None and hasattr(os, "memfd_create")):
            self.handle: int | str = os.memfd_create("truestroke") if handle is None else handle
            if handle is None:
                os.ftruncate(self.handle, size)
            self.buffer = memoryview(mmap.mmap(self.handle, size))
            return
        self._named = _named_memory(size, handle)
        self._owner = handle is None
        self.handle = self._named.name
        self.buffer = self._named.buf[:size]

    @property
    def descriptors(self) -> tuple[int, ...]:
        """What a process has to inherit to open it."""
        return (self.handle,) if isinstance(self.handle, int) else ()

    def close(self) -> None:
        """Let go of its descriptor or name; the memory itself is freed with the last view of it."""
        if isinstance(self.handle, int):
            os.close(self.handle)
        elif self._owner:
            self._named.unlink()


def _named_memory(size: int, name: str | None) -> Any:
    """New memory, or that of another process, which alone removes it: Python before 3.13 would do so here, too."""
    from multiprocessing import resource_tracker, shared_memory

    class Named(shared_memory.SharedMemory):
        def __del__(self) -> None:
            """Views of it may live longer."""

    if name is None:
        return Named(create=True, size=size)
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return Named(name=name)
    finally:
        resource_tracker.register = register
