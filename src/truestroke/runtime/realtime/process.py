"""The processes of a run: ours while the loop runs, and those beside it, which learn when ours has ended."""

import gc
import os
import pickle
import select
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from truestroke.base import interrupts, streams, system
from truestroke.base.errors import TruestrokeError
from truestroke.runtime.realtime.settings import RealtimeSettings
from truestroke.runtime.realtime.shared import Shared

SWITCH = 20e-6  # s that another thread may keep the interpreter's lock when the loop wakes up


class RealtimeError(TruestrokeError, RuntimeError):
    """The run could not begin; the output was not touched."""


def require_realtime() -> None:
    """RealtimeError where the system has no watchdog that outlives the loop."""
    if not system.HAS_REALTIME:
        raise RealtimeError(
            f"{sys.platform} cannot watch the loop (no pidfd, no memfd), so the output would not be safe: use Linux "
            "5.3 or newer, or a microcontroller (truestroke export c); identify, invert and track work here"
        )


@contextmanager
def on_its_own(settings: RealtimeSettings) -> Iterator[None]:
    """Within it, new processes keep off the processor that the loop is going to have."""
    cpus = os.sched_getaffinity(0)
    if settings.cpu is None:
        yield
        return
    if settings.cpu not in cpus:
        raise RealtimeError(f"cpu = {settings.cpu}: this process may use {sorted(cpus)}")
    os.sched_setaffinity(0, cpus - {settings.cpu} or cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, cpus)


@contextmanager
def undisturbed(settings: RealtimeSettings) -> Iterator[None]:
    """Pinned and with priority as asked for; no garbage collection; other threads give way soon."""
    cpus, policy, priority = os.sched_getaffinity(0), os.sched_getscheduler(0), os.sched_getparam(0)
    interval, collecting = sys.getswitchinterval(), gc.isenabled()
    try:
        if settings.cpu is not None:
            os.sched_setaffinity(0, {settings.cpu})
        if settings.priority:
            _prioritise(settings.priority)
        sys.setswitchinterval(SWITCH)
        gc.collect()
        gc.freeze()
        gc.disable()
        yield
    finally:
        gc.unfreeze()
        if collecting:
            gc.enable()
        sys.setswitchinterval(interval)
        if settings.priority:
            os.sched_setscheduler(0, policy, priority)
        os.sched_setaffinity(0, cpus)


def _prioritise(priority: int) -> None:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        raise RealtimeError(
            f"priority = {priority}: not permitted; allow it by a line '@realtime - rtprio 99' in "
            "/etc/security/limits.conf and membership in that group, or leave priority at 0"
        ) from None


_CODE = "from truestroke.runtime.realtime.process import main; main()"


class Lifeline:
    """A pipe without a writer: it ends with the process that started us."""

    def gone(self, seconds: float) -> bool:
        """Sleep, unless the process that started us has ended, or ends meanwhile: then True at once."""
        return bool(select.select([sys.stdin.fileno()], [], [], seconds)[0])


def start(
    shared: Shared, job: Callable[..., None], *arguments: Any, keep: Sequence[int] = ()
) -> subprocess.Popen[bytes]:
    """Run job(lifeline, shared, *arguments) in a process of its own session, which has the descriptors `keep`, too.

    It is no fork: it has no share in the state of vendors' libraries, and does not run the caller's script again.
    Ctrl-C in the terminal does not reach it.
    """
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", _CODE],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        pass_fds=(shared.fd, *keep),
        start_new_session=True,
    )
    assert process.stdin
    for part in (sys.path, (job, (shared, *arguments))):
        pickle.dump(part, process.stdin)
    process.stdin.flush()
    return process


def main() -> None:
    """What the new process does."""
    streams.secure()
    interrupts.ignore()
    sys.path[:] = pickle.load(sys.stdin.buffer)
    job, arguments = pickle.load(sys.stdin.buffer)
    job(Lifeline(), *arguments)
