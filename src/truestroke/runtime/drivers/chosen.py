"""One axis of hardware that has several, as hardware of one axis."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.playback import Recorded
from truestroke.runtime.drivers.protocol import Driver
from truestroke.signals.timing import Timing


class Chosen:
    """A driver of one channel: one of several, while the others are held at their safe voltages.

    Parameters
    ----------
    driver : Driver
        Hardware of several channels.
    channel : int
        The one that moves, from 0.
    safe : sequence of float, shape (channels,)
        Safe voltage of each channel, V; that of `channel` does not count.

    Raises
    ------
    SettingError
        `open` finds that the driver has another number of channels.
    """

    def __init__(self, driver: Driver, channel: int, safe: Sequence[float]) -> None:
        self.driver, self.channel = driver, channel
        self._safe = np.array(safe, dtype=np.float64)

    def open(self) -> Timing:
        """As the driver, with one channel."""
        timing = self.driver.open()
        if timing.channels != len(self._safe):
            self.driver.close()
            raise SettingError("axis", f"{len(self._safe)} tables", f"one for each of {timing.channels} channels")
        self._volts = np.repeat(self._safe[:, np.newaxis], timing.block, axis=1)
        self._measured = np.empty_like(self._volts)
        return dataclasses.replace(timing, channels=1)

    def start(self, volts: FloatArray) -> None:
        """As the driver; the other outputs are set to their safe voltages."""
        self.driver.start(_among(self._safe, self.channel, volts))

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """As the driver, of one channel."""
        self._volts[self.channel] = volts[0]
        self.driver.exchange(self._volts, self._measured)
        measured[0] = self._measured[self.channel]

    def stop(self, volts: FloatArray) -> None:
        """As the driver; all others are at their safe voltages."""
        self.driver.stop(_among(self._safe, self.channel, volts))

    def close(self) -> None:
        """As the driver."""
        self.driver.close()

    def rescue(self) -> Callable[[FloatArray], None]:
        """As the driver, with the safe voltage of this channel."""
        return functools.partial(_rescued, self.driver.rescue(), self._safe, self.channel)

    def describe(self) -> dict[str, object]:
        """As the driver, and the channel."""
        return {**self.driver.describe(), "channel": self.channel}

    def __getattr__(self, name: str) -> Any:
        """What else the driver has: `truth` and `output` of this channel, `playback` with the others at rest."""
        if name.startswith("_") or name == "driver":
            raise AttributeError(name)
        value = getattr(self.driver, name)
        if name == "playback":
            return functools.partial(self._played, value)
        return value[self.channel : self.channel + 1] if name in ("truth", "output") else value

    def _played(self, play: Callable[[FloatArray, float], Recorded], volts: npt.ArrayLike, rate: float) -> Recorded:
        waves = np.repeat(self._safe[:, np.newaxis], np.shape(volts)[1], axis=1)
        waves[self.channel] = np.asarray(volts)[0]
        made, part = play(waves, rate), slice(self.channel, self.channel + 1)
        return Recorded(made.volts[part], made.displacement[part], made.sample_rate)


def _among(safe: FloatArray, channel: int, volts: FloatArray) -> FloatArray:
    """The safe voltages, and that of one channel."""
    return np.where(np.arange(len(safe)) == channel, volts[0], safe)


def _rescued(rescue: Callable[[FloatArray], None], safe: FloatArray, channel: int, volts: FloatArray) -> None:
    return rescue(_among(safe, channel, volts))
