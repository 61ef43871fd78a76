"""Signals that ask a program to end, and temporary handlers of them."""

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from types import FrameType, MappingProxyType
from typing import Any

from truestroke.base import system

CTRL_C = signal.SIGINT
AGAIN = 0.02  # s after an interrupt that was dropped
ENDING: Mapping[int, str] = MappingProxyType(system.ENDING)
"""Those that ask a program to end, and what is said of them; its exit code is then that of `system.exit_code`."""


@contextmanager
def handled(handler: Callable[[int, FrameType | None], object] | signal.Handlers) -> Iterator[None]:
    """Within it, `handler` gets these signals; who had them before has them again behind it.

    A signal that is ignored stays so, as those who start programs by `nohup` ask for. In a thread other than the main
    one, which alone gets signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in heard}
    try:
        yield
    finally:
        for number, handler_before in before.items():
            signal.signal(number, signal.SIG_DFL if handler_before is None else handler_before)


def ignored() -> AbstractContextManager[None]:
    """Within it, none of them interrupts: the way to a safe voltage."""
    return handled(signal.SIG_IGN)


@contextmanager
def noted() -> Iterator[list[int]]:
    """Within it, they go into the list, and do nothing else."""
    asked: list[int] = []
    with handled(lambda number, _: asked.append(number)):
        yield asked


@contextmanager
def as_ctrl_c() -> Iterator[list[int]]:
    """Within it, all of them raise `KeyboardInterrupt`, and those other than Ctrl-C go into the list."""
    asked: list[int] = []

    def stop(number: int, frame: object) -> None:
        asked.extend([number] if number != CTRL_C else [])
        raise KeyboardInterrupt

    with handled(stop), _never_ignored():
        yield asked


@contextmanager
def _never_ignored() -> Iterator[None]:
    """Python drops what is raised in a finaliser, or in a callback of its garbage collector: it is raised again."""
    before, timers = sys.unraisablehook, list[threading.Timer]()

    def again(lost: Any) -> None:
        if lost.exc_type is not KeyboardInterrupt:
            before(lost)
            return
        timers.append(threading.Timer(AGAIN, _thread.interrupt_main))  # at once would still be in the callback
        timers[-1].start()

    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = before
        for timer in timers:
            timer.cancel()


def ignore() -> None:
    """From now on none of them ends this process: it belongs to another, which ends it."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
