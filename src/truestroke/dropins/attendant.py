"""The process beside a host: it sets the outputs to the safe voltages when the host dies, or makes no more ticks."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress

from truestroke.base import system
from truestroke.base.system import Peer
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.runtime.realtime import process
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.shared import Helper, Layout, Pulse, Shared, Slot, State

STILL = 2.0  # s without a tick: a host may keep the interpreter's lock for a while, and a watchdog never kills it
LOOK = 0.1  # s between two looks, and between two attempts
READY = 60.0  # s for the process to come up
LONGEST = 600.0  # s of attempts
LEAST = Layout(channels=1, size=1, slow_size=1, slow_width=1)  # of the shared memory: nothing but the counters is used


class Attendant:
    """That process, from before the output is touched until it is safe again.

    It does not kill the host: it forbids it to go on, and sets the outputs itself.
    """

    def __init__(self, driver: Driver, safe: FloatArray) -> None:
        self._shared = Shared(LEAST)
        self._process = process.start(self._shared, attend, os.getpid(), driver.rescue(), safe)
        until = time.monotonic() + READY
        while self._shared.count[Slot.WATCHDOG] != Helper.READY:
            if self._process.poll() is not None or time.monotonic() > until:
                self.end()
                raise DriverError("the process that watches over the host did not start")
            time.sleep(0.01)
        self._shared.count[Slot.STATE] = State.LIVE

    @classmethod
    def beside(cls, driver: Driver, safe: FloatArray) -> Attendant | None:
        """One for this driver, or None where the system has not what it takes."""
        return cls(driver, safe) if system.HAS_PROCESSES else None

    def beat(self) -> None:
        """A tick was made; `DriverError` where the attendant has taken the outputs over, or has died."""
        self._shared.count[Slot.BEAT] += 1
        if self._shared.count[Slot.STOP]:
            raise DriverError(f"the host made no tick for {STILL:g} s: its attendant has set the outputs to safety")
        if self._process.poll() is not None:
            raise DriverError("the process that watches over the host has died")

    def end(self, safe: bool = True) -> None:
        """The outputs are safe; if they are not, it goes on trying, as if the host were gone."""
        if safe:
            self._shared.count[Slot.STATE] = State.ENDED
        if self._process.stdin:
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        if safe and self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._shared.close()


def attend(
    lifeline: Lifeline, shared: Shared, host: int, rescue: Callable[[FloatArray], None], safe: FloatArray
) -> None:
    """Look at the ticks until the outputs are safe; where they end, or the host does, `rescue` to `safe`, V."""
    system.protect()
    alive, pulse = Peer(host), Pulse()
    shared.count[Slot.WATCHDOG] = Helper.READY
    why = ""
    while not why:
        gone = lifeline.gone(LOOK) or alive.gone()
        if shared.count[Slot.STATE] == State.ENDED:
            return
        if gone:
            why = "the host is gone"
        elif pulse.still((shared.count[Slot.BEAT], shared.count[Slot.STATE])) > STILL:
            why = f"the host made no tick for {STILL:g} s"
    shared.count[Slot.STOP] = 1
    _bring_to_safety(shared, rescue, safe, why)


def _bring_to_safety(shared: Shared, rescue: Callable[[FloatArray], None], safe: FloatArray, why: str) -> None:
    """Try until it works, or until the host has done it."""
    volts, complained = ", ".join(f"{v:g} V" for v in safe), False
    until = time.monotonic() + LONGEST
    while shared.count[Slot.STATE] != State.ENDED and time.monotonic() < until:
        try:
            rescue(safe)
        except Exception as error:
            if not complained:
                words = " ".join(str(error).split())
                _tell(f"{why}; THE OUTPUT IS NOT SAFE, not at {volts}, and it is tried again: {words}")
            complained = True
            time.sleep(LOOK)
        else:
            _tell(f"{why}; output set to {volts}")
            return


def _tell(words: str) -> None:
    sys.stderr.write(f"truestroke: attendant: {words}\n")
    sys.stderr.flush()
