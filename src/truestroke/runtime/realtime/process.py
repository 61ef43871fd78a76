"""The processes of a run: ours while the loop runs, and those beside it, which learn when ours has ended."""

import gc
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from truestroke.base import interrupts, streams, system
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.runtime.drivers.paced import coarse
from truestroke.runtime.realtime.shared import Shared
from truestroke.signals.timing import Timing

if TYPE_CHECKING:  # the processes beside the loop have no controller
    from truestroke.runtime.realtime.settings import RealtimeSettings

SLICE = 1e-4  # s, the shortest that Linux gives: the loop works for less, and another program waits for it no longer
SWITCH = 20e-6  # s that another thread may keep the interpreter's lock when the loop wakes up


class RealtimeError(TruestrokeError, RuntimeError):
    """The run could not begin; the output was not touched."""


def require_realtime() -> None:
    """RealtimeError where the system has no watchdog that outlives the loop."""
    if not system.HAS_PROCESSES:
        raise RealtimeError(
            f"{system.NAME} cannot watch the loop (it starts no process beside this one), so the output would not be "
            "safe: use Linux, Windows or macOS, or a microcontroller (truestroke export c); identify, invert and track "
            "work here"
        )


def lateness_of_system(settings: "RealtimeSettings", timing: Timing) -> list[str]:
    """Sentences on what this system lacks for punctual ticks; none of hardware that has a clock of its own."""
    if timing.hardware_timed:
        return []
    found = []
    if not system.BOUNDS_LATENESS:
        found.append(f"nothing on {system.NAME} bounds how late a tick is: the recording has the lateness of each")
    step, period = system.timer_step(), timing.block / timing.sample_rate
    if remedy := coarse(step, period, settings.spin):
        found.append(f"the timer of this system goes by steps of {1e3 * step:.2g} ms: {remedy}")
    return found


@contextmanager
def on_its_own(settings: "RealtimeSettings") -> Iterator[None]:
    """Within it, new processes keep off the processor that the loop is going to have."""
    if settings.cpu is None:
        yield
        return
    cpus = system.processors()
    if settings.cpu not in cpus:
        some = ", ".join(map(str, cpus))
        raise SettingError("cpu", settings.cpu, f"one of {some}, the processors that this process may use")
    _keep_to([cpu for cpu in cpus if cpu != settings.cpu] or cpus, settings.cpu)
    try:
        yield
    finally:
        system.keep_to(cpus)


def _keep_to(cpus: list[int], asked: int) -> None:
    try:
        system.keep_to(cpus)
    except OSError as error:
        raise RealtimeError(f"cpu = {asked}: {error.strerror}; leave it out") from error


@contextmanager
def undisturbed(settings: "RealtimeSettings") -> Iterator[None]:
    """Pinned and with priority as asked for; no garbage collection; other threads and programs give way soon."""
    with ExitStack() as before:
        before.callback(sys.setswitchinterval, sys.getswitchinterval())
        if gc.isenabled():
            before.callback(gc.enable)
        if settings.cpu is not None:
            cpus = system.processors()
            _keep_to([settings.cpu], settings.cpu)
            before.callback(system.keep_to, cpus)
        before.enter_context(system.short_slices(SLICE))
        if settings.priority:
            before.enter_context(_prioritised(settings.priority))
        sys.setswitchinterval(SWITCH)
        gc.collect()
        if not gc.get_freeze_count():  # what the caller has frozen remains so
            gc.freeze()
            before.callback(gc.unfreeze)
        gc.disable()
        yield


@contextmanager
def _prioritised(priority: int) -> Iterator[None]:
    with ExitStack() as before:
        try:
            before.enter_context(system.prioritised(priority))
        except PermissionError:
            raise RealtimeError(
                f"priority = {priority}: not permitted; allow it by a line '@realtime - rtprio 99' in "
                "/etc/security/limits.conf and membership in that group, or leave priority at 0"
            ) from None
        except OSError as error:
            raise RealtimeError(f"priority = {priority}: {error.strerror}; leave it at 0") from None
        yield


# What imports make is no garbage: to look for some among it is a tenth of what such a process computes.
_CODE = "import gc; gc.disable(); from truestroke.runtime.realtime.process import main; main()"


class Lifeline:
    """A pipe without a writer: it ends with the process that started us."""

    def __init__(self) -> None:
        self._gone = threading.Event()
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        with suppress(OSError):  # Windows: the pipe is broken
            while os.read(0, 1):
                pass
        self._gone.set()

    def gone(self, seconds: float) -> bool:
        """Sleep, unless the process that started us has ended, or ends meanwhile: then True at once."""
        return self._gone.wait(seconds)


def start(
    shared: Shared, job: Callable[..., None], *arguments: Any, keep: Sequence[int] = (), terminal: bool = False
) -> subprocess.Popen[bytes]:
    """Run job(lifeline, shared, *arguments) in a process of its own session, which has the descriptors `keep`, too.

    It is no fork: it has no share in the state of vendors' libraries, and does not run the caller's script again.
    Ctrl-C in the terminal does not reach it. `terminal`: it writes to the terminal, and may end with it.
    """
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", _CODE, job.__name__],  # the name for those who list processes
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        **system.detached((*shared.descriptors, *keep), terminal),
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
    gc.freeze()
    gc.enable()
    job(Lifeline(), *arguments)
