"""The one loop of blocks: each within limits and slew, at its time, and at the end the safe voltage."""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, MutableSequence
from contextlib import suppress
from time import perf_counter_ns  # on Windows, before Python 3.13, `monotonic_ns` goes by steps of 16 ms

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, interrupts
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.guard import Guard
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.signals.timing import Timing

MARGIN = 1.5  # a tick is at least as much longer than the commands in it
TRIALS = 20  # of the commands in a tick
SPIN = 150e-6  # s before the tick when sleep ends: later than that a sleeper may wake too late
EDGES_US = (*(float(digit * 10**power) for power in range(6) for digit in (1, 2, 5)), 1e6)
"""Upper edges of the bins of lateness, us; one more bin holds what is later."""
_EDGES_NS = tuple(int(1000 * edge) for edge in EDGES_US)


class Clock:
    """Waits for the beginning of each block, and counts how late it was.

    A sleeping thread has let go of the interpreter's lock and may have to wait for it; so it wakes early, and then
    spins with the lock held until the time has come. After an overrun the later ticks are late by as much: they are
    never hurried through.

    From block to block `period` s pass, of which the last `spin` s are spun; 0 only sleeps. Where the hardware paces
    the blocks (`hardware_timed`) it does not wait, it only looks how much more than a period passed since the last one,
    of which less is negative: their clocks may differ, so nothing is summed up. `histogram`, with one bin more than
    `EDGES_US`, may be shared with another process.

    `overruns` counts blocks that began more than a period late, `streak` the last ones of them in a row, `missed` the
    whole periods lost by them; `worst` is the latest beginning, ns.

    >>> clock = Clock(1e-3)
    >>> clock.start()
    >>> lateness = [clock.wait() for _ in range(10)]
    >>> sum(clock.histogram), max(lateness) == clock.worst
    (10, True)
    """

    def __init__(
        self,
        period: float,
        spin: float = SPIN,
        hardware_timed: bool = False,
        histogram: MutableSequence[int] | memoryview[int] | None = None,
    ) -> None:
        self._period = round(checks.positive("period", period, "s") * 1e9)
        self._spin = round(checks.within("spin", spin, 0.0, 1.0, "s") * 1e9)
        self._hardware_timed = hardware_timed
        self.histogram = [0] * (len(EDGES_US) + 1) if histogram is None else histogram
        self.overruns = self.streak = self.missed = self.worst = 0
        self._due = 0

    def start(self) -> None:
        """The first block begins now."""
        self._due = perf_counter_ns()
        self.streak = 0

    def wait(self) -> int:
        """Return when the block begins, of hardware that paces itself at once; how late that is, ns."""
        due = self._due
        if not self._hardware_timed:
            rest = due - perf_counter_ns() - self._spin
            if rest > 0:
                time.sleep(rest * 1e-9)
            while perf_counter_ns() < due:
                pass
        now = perf_counter_ns()
        late = now - due
        if late > self._period:
            self.overruns += 1
            self.streak += 1
            self.missed += late // self._period
            due = now
        else:
            self.streak = 0
        self._due = (now if self._hardware_timed else due) + self._period
        self.worst = max(self.worst, late)
        self.histogram[bisect_right(_EDGES_NS, max(late, 0) - 1)] += 1
        return late


def coarse(step: float, period: float, spin: float) -> str:
    """What is to be done where sleeps end by steps (s) that make blocks of `period` (s) late; empty where they do not.

    >>> coarse(60e-6, 5e-4, 150e-6), coarse(0.0156, 5e-4, 150e-6)
    ('', 'blocks of 0.5 ms are up to 15 ms late; spin = 0.016 in [realtime] waits without sleep')
    """
    late = step - spin
    if late <= period / 2:
        return ""
    remedy = f"spin = {math.ceil(1e3 * step) / 1e3:g} in [realtime] waits without sleep"
    return f"blocks of {1e3 * period:.2g} ms are up to {1e3 * late:.2g} ms late; {remedy}"


class Paced:
    """Voltages to a started driver of this timing: they pass the guard, and wait for the clock of its blocks."""

    def __init__(self, driver: Driver, timing: Timing, guard: Guard, clock: Clock) -> None:
        self._driver, self._block, self._guard, self._clock = driver, timing.block, guard, clock
        self._measured = np.full((timing.channels, timing.block), np.nan)
        clock.start()

    def exchange(self, volts: FloatArray) -> FloatArray:
        """One block of voltages, V, shape (channels, up to block), of which the last is held; what came back, um."""
        block = padded(volts, self._block)
        self._guard(block)
        self._clock.wait()
        self._driver.exchange(block, self._measured)
        return self._measured.copy()

    def apply(
        self, volts: FloatArray, before: Callable[[], None] = lambda: None, after: Callable[[], None] = lambda: None
    ) -> FloatArray:
        """Blocks one after the other, from now on, each between a call of `before` and one of `after`.

        `volts` (V) has shape (channels, ticks), and what comes back (um) the same, up to the end of the last block.
        """
        self._clock.start()
        came = [np.empty((len(volts), 0))]
        for start in range(0, volts.shape[1], self._block):
            before()
            came.append(self.exchange(volts[:, start : start + self._block]))
            after()
        return np.concatenate(came, axis=1)


def require_time(tick: Callable[[], object], sample_rate: float, remedy: str = "") -> None:
    """DriverError if the commands of a tick, the slow end of a few trials, take longer than two thirds of it."""
    took = []
    for _ in range(TRIALS):
        begin = time.perf_counter()
        tick()
        took.append(time.perf_counter() - begin)
    slow = float(np.quantile(took, 0.9)) * MARGIN
    if slow * sample_rate > 1:
        raise DriverError(
            f"sample_rate = {sample_rate:g} Hz: a set-point and a position take {1e3 * slow / MARGIN:.4g} ms here, so "
            f"at most {1 / slow:.4g} Hz{remedy}"
        )


def padded(volts: npt.NDArray[np.float64], ticks: int) -> FloatArray:
    """`volts`, shape (channels, up to ticks), held at its last entry until it is `ticks` long: a copy."""
    given = volts.shape[1]
    held = np.empty((volts.shape[0], ticks))  # np.pad takes ten times as long, in each tick
    held[:, :given], held[:, given:] = volts, volts[:, -1:]
    return held


def let_go(driver: Driver, safe: FloatArray) -> None:
    """Set the output to the `safe` voltages (V, shape (channels,)) and close; no signal interrupts that.

    Where `stop` fails, by the rescue of the driver; its error is raised all the same.
    """
    with interrupts.ignored():
        try:
            driver.stop(safe)
        except DriverError:
            with suppress(DriverError, OSError):  # the caller gets the first one
                driver.rescue()(safe)
            raise
        finally:
            driver.close()
