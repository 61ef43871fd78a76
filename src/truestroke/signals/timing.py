"""The timing of an actuator, which `open` returns."""

from dataclasses import dataclass

from truestroke.base import checks

LONGEST_AGO = 1023
"""Ticks that a measurement may come after its command: TS_HISTORY of the kernel, less one."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """How commands and measurements follow each other.

    Attributes
    ----------
    sample_rate : float
        Ticks per second, Hz.
    block : int
        Ticks that one exchange moves, 1 to 1023.
    latency : int
        Ticks between a command and the exchange position at which its measurement comes back, 0 to 1023.
    channels : int
        Axes that move together, 1 to 64.
    hardware_timed : bool
        Whether a clock of the hardware paces the ticks; else the caller does.
    """

    sample_rate: float
    block: int = 1
    latency: int = 0
    channels: int = 1
    hardware_timed: bool = False

    def __post_init__(self) -> None:
        checks.positive("sample_rate", self.sample_rate, "Hz")
        checks.count("block", self.block, 1, LONGEST_AGO)
        checks.count("latency", self.latency, 0, LONGEST_AGO)
        checks.count("channels", self.channels, 1, 64)
