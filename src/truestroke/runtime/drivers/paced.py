"""The one loop of blocks: each within limits and slew, at its time, and at the end the safe voltage."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
import numpy.typing as npt

from truestroke.base import interrupts
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.clock import Clock
from truestroke.runtime.drivers.guard import Guard
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.signals.timing import Timing


class Paced:
    """Voltages to an open, started driver: they pass the guard, and wait for the clock.

    Parameters
    ----------
    driver : Driver
        Started.
    timing : Timing
        As its `open` returned it.
    guard : Guard
        Of all its channels.
    clock : Clock
        With the period of its blocks.
    """

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


def padded(volts: npt.NDArray[np.float64], ticks: int) -> FloatArray:
    """`volts`, shape (channels, up to ticks), held at its last entry until it is `ticks` long: a copy."""
    return np.ascontiguousarray(np.pad(volts, ((0, 0), (0, ticks - volts.shape[1])), mode="edge"))


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
