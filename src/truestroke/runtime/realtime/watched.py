"""A driver of one axis whose motion is shown on the live page, and stopped from there: for `truestroke learn`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.runtime.realtime import server
from truestroke.runtime.realtime.live_page import LiveSettings
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import FIELDS, Shared, Slot, State
from truestroke.signals.timing import Timing

DESIRED, MEASURED, VOLTS = (FIELDS.index(name) for name in ("desired", "measured", "volts"))


class StoppedError(DriverError):
    """A person has pressed STOP on the live page; the output goes to the safe voltage."""


@contextmanager
def watched(driver: Driver, settings: LiveSettings, panel: Panel, sample_rate: float) -> Iterator[Watched]:
    """The same driver, shown on the live page until the block ends.

    Raises
    ------
    SettingError
        The driver puts out whole waveforms by itself: nothing could stop it within one.
    RealtimeError
        The page cannot be served.
    """
    if hasattr(driver, "playback"):
        name = type(driver).__name__
        raise SettingError("live", f"with {name}", "left out: its hardware plays a pass by itself, beyond STOP")
    with closing(server.blank(1, sample_rate)) as shared, server.served(settings, shared, [panel], sample_rate):
        shared.count[Slot.STATE] = State.LIVE
        yield Watched(driver, shared)


class Watched:
    """The driver, whose blocks can be seen; `Driver` says what its calls do."""

    def __init__(self, driver: Driver, shared: Shared) -> None:
        self._driver, self._shared, self._count = driver, shared, shared.count
        self._next = self._tick = self._latency = 0
        self._desired, self._from = np.empty(0), 0

    def expect(self, desired: FloatArray, after: int) -> None:
        """The period, um, of the motion from the next start on, `after` so many ticks."""
        self._desired, self._from = desired, after

    def open(self) -> Timing:
        """As the driver."""
        timing = self._driver.open()
        self._latency = timing.latency
        return timing

    def start(self, volts: FloatArray) -> None:
        """As the driver."""
        self._tick = 0
        self._driver.start(volts)

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """As the driver; `StoppedError` once after a person has pressed STOP; the way to the safe voltage is free."""
        self._driver.exchange(volts, measured)  # the guard has counted these volts as put out, so they are
        self._show(volts, measured)
        if self._count[Slot.STOP] and self._count[Slot.STATE] == State.LIVE:
            self._count[Slot.STATE] = State.STOPPING
            raise StoppedError("an operator asked for the end on the live page")

    def _show(self, volts: FloatArray, measured: FloatArray) -> None:
        ring, size, block = self._shared.ring[0], self._shared.layout.size, volts.shape[1]
        ticks, places = np.arange(self._next, self._next + block), np.arange(self._tick, self._tick + block)
        ring[VOLTS, ticks % size] = volts[0]
        ring[DESIRED, ticks % size] = self._wanted(places)
        ring[MEASURED, ticks % size] = np.nan
        known = ticks >= self._latency
        ring[MEASURED, (ticks[known] - self._latency) % size] = measured[0, :block][known]
        self._next, self._tick = self._next + block, self._tick + block
        self._count[Slot.WRITTEN] = max(self._next - self._latency, 0)

    def _wanted(self, places: Any) -> FloatArray:
        """um; NaN before the motion."""
        if not self._desired.size:
            return np.full(places.size, np.nan)
        wanted = self._desired[(places - self._from) % self._desired.size]
        return np.where(places >= self._from, wanted, np.nan)

    def stop(self, volts: FloatArray) -> None:
        """As the driver."""
        self._driver.stop(volts)

    def rescue(self) -> Callable[[FloatArray], None]:
        """As the driver."""
        return self._driver.rescue()

    def close(self) -> None:
        """As the driver."""
        self._driver.close()

    def describe(self) -> dict[str, object]:
        """As the driver."""
        return self._driver.describe()
