"""All that differs between operating systems: signals, locks of files, writing at a place, processors, limits."""

from __future__ import annotations

import errno
import os
import signal
import struct
import sys
from collections.abc import Callable

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


def write_at(descriptor: int, data: bytes, offset: int) -> int:
    """Write bytes of an open file from a place on; how many were written."""
    at: Callable[[int, bytes, int], int] | None = getattr(os, "pwrite", None)
    if at:
        return at(descriptor, data, offset)
    os.lseek(descriptor, offset, os.SEEK_SET)
    return os.write(descriptor, data)


def lock(descriptor: int) -> None:
    """Lock an open file for as long as it is open here or in a process that inherits it.

    Raises
    ------
    BlockingIOError
        Another process has it.
    """
    if sys.platform == "win32":
        _windows_lock(descriptor)
    else:
        _posix_lock(descriptor, ask=False)


def locked(descriptor: int) -> bool:
    """Whether another process has locked the open file; False on a file system without locks."""
    if sys.platform == "win32":
        return _windows_locked(descriptor)
    return bool(_posix_lock(descriptor, ask=True))


def _posix_lock(descriptor: int, ask: bool) -> bool | None:
    """Set the lock, or ask whether another has it; None where there are no locks."""
    try:
        import fcntl
    except ImportError:
        return None
    command = getattr(fcntl, "F_OFD_GETLK" if ask else "F_OFD_SETLK", None)
    if command is None:  # macOS has locks of a process only, which end with any descriptor of the file
        return None
    wanted = _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_BYTE, 1, 0)
    try:
        return bool(_LOCK.unpack(fcntl.fcntl(descriptor, command, wanted))[0] != fcntl.F_UNLCK)
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EINVAL, errno.EOPNOTSUPP):
            raise
        return None


def _windows_lock(descriptor: int) -> None:
    """Lock one byte far behind the end, which no reader asks for."""
    import msvcrt

    os.lseek(descriptor, (1 << 31) - 2, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    except OSError as error:
        raise BlockingIOError(errno.EAGAIN, "another process has locked it") from error
    finally:
        os.lseek(descriptor, 0, os.SEEK_SET)


def _windows_locked(descriptor: int) -> bool:
    import msvcrt

    try:
        _windows_lock(descriptor)
    except BlockingIOError:
        return True
    os.lseek(descriptor, (1 << 31) - 2, os.SEEK_SET)
    msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    return False
