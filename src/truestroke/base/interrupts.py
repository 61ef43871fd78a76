"""Signals that ask a program to end, and temporary handlers of them."""

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from types import FrameType, MappingProxyType

from truestroke.base import system

CTRL_C = signal.SIGINT
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

    with handled(stop):
        yield asked


def ignore() -> None:
    """From now on none of them ends this process: it belongs to another, which ends it."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
