"""The watchdog: a process that ends ours when the loop stands still, and brings the output to safety by itself."""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Callable

from truestroke._typing import FloatArray
from truestroke.realtime.child import Lifeline
from truestroke.realtime.shared import Helper, Shared, Slot, State

PATIENCE = 5.0  # s that starting and stopping the hardware may take


def watch(
    lifeline: Lifeline, shared: Shared, pid: int, rescue: Callable[[FloatArray], None], safe: FloatArray, timeout: float
) -> None:
    """Look at the beat until the run has ended; without one for `timeout` seconds, kill `pid` and rescue.

    The process being gone is enough, whatever ended it.
    """
    process = os.pidfd_open(pid)
    shared.count[Slot.WATCHDOG] = Helper.READY
    beat, since = -1, time.monotonic()
    while not (gone := lifeline.gone(timeout / 8)):
        state = shared.count[Slot.STATE]
        if state == State.ENDED:
            return
        now, mark = time.monotonic(), shared.count[Slot.BEAT] * 8 + state
        if mark != beat or state == State.IDLE:
            beat, since = mark, now
        elif now - since > (timeout if state == State.LIVE else max(timeout, PATIENCE)):
            break
    if shared.count[Slot.STATE] in (State.IDLE, State.ENDED):
        return
    why = "the process is gone" if gone else f"no tick for {timeout:g} s: killed the process"
    if not gone:
        signal.pidfd_send_signal(process, signal.SIGKILL)
        select.select([process], [], [], 1.0)  # until it has let go of the hardware
    _bring_to_safety(shared, rescue, safe, why)


def _bring_to_safety(shared: Shared, rescue: Callable[[FloatArray], None], safe: FloatArray, why: str) -> None:
    volts = ", ".join(f"{v:g} V" for v in safe)
    try:
        rescue(safe)
    except Exception as error:
        shared.count[Slot.WATCHDOG] = Helper.NO_RESCUE
        sys.stderr.write(f"truestroke: watchdog: {why}; THE OUTPUT IS NOT SAFE, not at {volts}: {error}\n")
    else:
        shared.count[Slot.WATCHDOG] = Helper.RESCUED
        sys.stderr.write(f"truestroke: watchdog: {why}; output brought to {volts}\n")
