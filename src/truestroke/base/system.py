"""All that differs between operating systems: signals, locks of files, writing at a place, processors, limits."""

from __future__ import annotations

import errno
import os
import signal
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

NAMES = {"SIGINT": "Ctrl-C", "SIGBREAK": "Ctrl-Break", "SIGTERM": "SIGTERM", "SIGHUP": "the terminal is gone"}
ENDING = {int(getattr(signal, name)): words for name, words in NAMES.items() if hasattr(signal, name)}
"""Signals that ask a program to end, and what is said of them."""

OPEN = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
"""Of `os.open`: bytes as they are, and not for the programs that this one starts."""

HAS_REALTIME = all(hasattr(os, name) for name in ("memfd_create", "pidfd_open", "sched_setaffinity", "fork"))
"""Whether a loop can be watched by a process that outlives it: Linux 5.3 and newer."""

_LOCK = struct.Struct("@hhqqi4x")  # struct flock
_LOCKED_BYTE = 1 << 62  # far behind the end, where HDF5 and readers lock nothing


def processors() -> list[int]:
    """The processors that this process may use; all of them where the system does not say."""
    asked: Callable[[int], set[int]] | None = getattr(os, "sched_getaffinity", None)
    return sorted(asked(0)) if asked else list(range(os.cpu_count() or 1))


def memory() -> int:
    """Bytes of memory of this computer; 16 GiB where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 16 * 2**30


def allow_many_files() -> None:
    """As many open files, and so connections, as the system allows this process without asking."""
    with suppress(ImportError):  # of systems without POSIX: they have no such limit
        import resource

        highest = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (highest, highest))


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


def _windows(call: str, descriptor: int) -> bool:
    """LockFile or UnlockFile of the byte, whose place is too far for `msvcrt.locking`."""
    import ctypes
    import msvcrt

    kernel: Any = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined,unused-ignore]
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
