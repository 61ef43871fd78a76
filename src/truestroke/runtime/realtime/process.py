"""Our process while the loop runs: collector and scheduler out of the way."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from truestroke.base.errors import TruestrokeError
from truestroke.runtime.realtime.settings import RealtimeSettings

SWITCH = 20e-6  # s that another thread may keep the interpreter's lock when the loop wakes up


class RealtimeError(TruestrokeError, RuntimeError):
    """The run could not begin; the output was not touched."""


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
