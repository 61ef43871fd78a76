"""Hardware whose sensors are turned against its axes, as hardware whose sensors stand along them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import frames
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import Driver
from truestroke.signals.timing import Timing


class Turned:
    """A driver whose measurements are those of the axes: F^-1 of what its sensors read.

    Parameters
    ----------
    driver : Driver
        Hardware of two or three channels.
    frame : array_like, shape (channels, channels)
        F: row i is what sensor i reads of a um of each axis, 1; `truestroke.sensor_frame` makes it from angles.

    Raises
    ------
    SettingError
        The sensors read almost the same, or `open` finds that the driver has another number of channels.
    """

    def __init__(self, driver: Driver, frame: npt.ArrayLike) -> None:
        self.driver = driver
        self.frame = frames.frame("frame", frame, len(np.atleast_1d(frame)))
        self._to_axes = np.linalg.inv(np.array(self.frame))

    def open(self) -> Timing:
        """As the driver."""
        timing = self.driver.open()
        if timing.channels != len(self.frame):
            self.driver.close()
            raise SettingError(
                "frame", f"of {len(self.frame)} axes", f"of {timing.channels}, the channels of the driver"
            )
        return timing

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """As the driver; a sample that one sensor has lost is lost on all axes."""
        self.driver.exchange(volts, measured)
        measured[:] = frames.turn(self._to_axes, measured)

    def __getattr__(self, name: str) -> Any:
        """What else the driver has: `truth` of a simulated one, as the axes move, and `rewind`; not `playback`."""
        if name.startswith("_") or name == "playback":  # which records what the sensors read
            raise AttributeError(name)
        value = getattr(self.driver, name)
        return frames.turn(self._to_axes, value) if name == "truth" else value

    def start(self, volts: FloatArray) -> None:
        """As the driver."""
        self.driver.start(volts)

    def stop(self, volts: FloatArray) -> None:
        """As the driver."""
        self.driver.stop(volts)

    def close(self) -> None:
        """As the driver."""
        self.driver.close()

    def rescue(self) -> Callable[[FloatArray], None]:
        """As the driver."""
        return self.driver.rescue()

    def describe(self) -> dict[str, object]:
        """As the driver, and the frame."""
        return {**self.driver.describe(), "frame": self.frame}
