"""What a driver of hardware is: one or more axes, moved block by block, and a safe way out."""

from collections.abc import Callable
from typing import Protocol

from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import FloatArray
from truestroke.signals.timing import Timing

__all__ = ["Driver", "DriverError"]


class DriverError(TruestrokeError, RuntimeError):
    """The hardware, its library or its connection failed; the message names the call, the vendor's code and text."""


class Driver(Protocol):
    """Hardware of one or more axes. Arrays belong to the caller: float64, C-contiguous, axis 0 the channels.

    One that is simulated may have `rewind()`, too, which `truestroke run` calls after its axis check: what that has
    moved is then as `open` left it, and the output stays.
    """

    def open(self) -> Timing:
        """Connect, configure, check; the output stays where it is. Raises `DriverError`."""

    def start(self, volts: FloatArray) -> None:
        """Set the output to `volts` (V, shape (channels,)), hold it there, start the clocks."""

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """Apply `volts` (V), fill `measured` (um, means over the ticks), both of shape (channels, block).

        Returns when the block is over. Entry i of `measured` belongs to the command `latency` ticks before volts[:, i];
        a lost sample is NaN. Raises `DriverError`.
        """

    def stop(self, volts: FloatArray) -> None:
        """Set the output to the safe `volts` (V, shape (channels,)) and stop the clocks.

        Works from any state, after an error too, and a second time.
        """

    def close(self) -> None:
        """Let go of the hardware; a second call does nothing."""

    def rescue(self) -> Callable[[FloatArray], None]:
        """Return a function that sets the outputs to safe volts (V, shape (channels,)) from another process.

        It can be pickled and makes a connection of its own: the watchdog calls it after it has ended our process.
        """

    def describe(self) -> dict[str, object]:
        """Return the settings, for the recording; an entry `output_range` (V) bounds the voltage limits of a run."""
