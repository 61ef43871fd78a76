"""What a driver of hardware is: one or more axes, moved block by block, and a safe way out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import FloatArray
from truestroke.signals.channels import QUANTITIES
from truestroke.signals.timing import Timing

__all__ = ["Driver", "DriverError", "Signal", "check_signals"]


class DriverError(TruestrokeError, RuntimeError):
    """The hardware, its library or its connection failed; the message names the call, the vendor's code and text."""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """What a further input reads beside the sensors of the axes, such as the height of a sample.

    Attributes
    ----------
    name : str
        Of its channel in the recording: letters, digits, - and _, and no channel that each recording has.
    unit : str
        Such as "nm" or "V".
    source : str
        Where it comes from, in words.

    Raises
    ------
    SettingError
        The name cannot be that of a channel.
    """

    name: str
    unit: str = "V"
    source: str = ""

    def __post_init__(self) -> None:
        if not self.name or not all(c.isalnum() or c in "-_" for c in self.name) or self.name in QUANTITIES:
            bound = "letters, digits, - and _, and no channel that each recording has, such as measured"
            raise SettingError("name", repr(self.name), bound)


def check_signals(signals: Sequence[Signal]) -> tuple[Signal, ...]:
    """Signals of different names; SettingError where two are alike."""
    checks.distinct("signals: name", [one.name for one in signals], "signal")
    return tuple(signals)


def check_axes(axes: int, channels: int) -> None:
    """An axis for each channel of the driver; SettingError where there are more or fewer."""
    if axes != channels:
        each = "one for each channel of the driver (its key channels says so); in a file a table [[axis]] each"
        raise SettingError("the number of axes", axes, f"{channels}, {each}")


class Driver(Protocol):
    """Hardware of one or more axes. Arrays belong to the caller: float64, C-contiguous, axis 0 the channels.

    One that is simulated may have `rewind()`, too, which `truestroke run` calls after its axis check: what that has
    moved is then as `open` left it, and the output stays.

    One with further inputs has `signals`, a `Signal` for each, and after an exchange `readings`, shape (signals,
    block): what they read in the ticks of `measured`, NaN where a sample was lost.
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
        """Return the settings, for the recording.

        An entry `output_range` (V), for all channels, or a list with that of each, bounds the voltage limits of a run.
        """
