"""The last check before the output: limits and slew, for any request."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray

ROUNDING = 1e-9  # of the slew step: what a controller that keeps the same limit may differ by


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What an output must not exceed.

    Attributes
    ----------
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V.
    slew : float
        Fastest change, V/s.
    safe_voltage : float
        Where the output starts and ends, V, within the limits.

    Raises
    ------
    SettingError
        One is out of its bounds.
    """

    voltage_limits: tuple[float, float]
    slew: float
    safe_voltage: float = 0.0

    def __post_init__(self) -> None:
        limits = checks.interval("voltage_limits", self.voltage_limits, "V")
        object.__setattr__(self, "voltage_limits", limits)
        object.__setattr__(self, "slew", checks.positive("slew", self.slew, "V/s"))
        object.__setattr__(self, "safe_voltage", checks.within("safe_voltage", self.safe_voltage, *limits, "V"))


class Guard:
    """Keeps the voltages that leave within limits and slew, from these and the last output alone.

    Of each axis: the lowest and highest voltage (V), the fastest change (`slew`, V/s, may be infinite), and what is at
    the output now (`volts`, V), then `last`. `limited` counts the voltages that it has changed.

    >>> guard = Guard(1000.0, [(0.0, 1.0)], [100.0], [0.5])
    >>> volts = np.array([[0.55, 0.9, math.nan, 0.68]])
    >>> guard(volts)
    False
    >>> volts.round(6).tolist(), guard.limited
    ([[0.55, 0.65, 0.65, 0.68]], 2)
    """

    def __init__(
        self,
        sample_rate: float,
        voltage_limits: Sequence[tuple[float, float]],
        slew: Sequence[float],
        volts: Sequence[float],
    ) -> None:
        rate = checks.positive("sample_rate", sample_rate, "Hz")
        self._limits = [checks.interval("voltage_limits", pair, "V") for pair in voltage_limits]
        for value in slew:
            if not value > 0:
                raise SettingError("slew", value, "above 0 V/s", "V/s")
        self._steps = [value / rate * (1 + ROUNDING) for value in slew]
        self.last = [checks.within("volts", v, *limits, "V") for v, limits in zip(volts, self._limits, strict=True)]
        self.limited = 0

    def __call__(self, volts: FloatArray) -> bool:
        """Limit `volts` (V, shape (channels, ticks)) in place to limits and slew; False if one was no number.

        In place of what is not a number the last output is held.
        """
        numbers = True
        for channel, row in enumerate(volts):
            (low, high), step, last = self._limits[channel], self._steps[channel], self.last[channel]
            for k, asked in enumerate(row.tolist()):
                x = asked
                if x != x:
                    numbers, x = False, last
                x = min(max(x, low, last - step), high, last + step)
                if x != asked:
                    row[k] = x
                    self.limited += 1
                last = x
            self.last[channel] = last
        return numbers

    def ramp(self, target: Sequence[float]) -> FloatArray:
        """Straight lines from the last output to `target` (V): shape (channels, ticks), as short as slew allows.

        The target itself is the next step after the ramp.

        >>> Guard(1000.0, [(0.0, 1.0)], [100.0], [0.5]).ramp([0.25]).round(6).tolist()
        [[0.416667, 0.333333]]
        """
        moves = [(b - a) for a, b in zip(self.last, target, strict=True)]
        steps = max(1, *(math.ceil(abs(move) / step) for move, step in zip(moves, self._steps, strict=True)))
        part = np.arange(1, steps) / steps
        return np.array([a + move * part for a, move in zip(self.last, moves, strict=True)]).reshape(len(moves), -1)


def range_of(description: Mapping[str, object], channel: int) -> tuple[float, float] | None:
    """The `output_range` of a channel, V, in the description of a driver: one for all, or one for each."""
    reach = description.get("output_range")
    if not isinstance(reach, tuple | list):
        return None
    low, high = reach[channel] if isinstance(reach[0], tuple | list) else reach
    return low, high


def check_range(argument: str, voltages: Sequence[float], description: Mapping[str, object], channel: int = 0) -> None:
    """Refuse voltages (V) beyond the `output_range` of a driver, if it has one: one for all channels, or for each.

    Raises
    ------
    SettingError
        One of them is outside.
    """
    reach = range_of(description, channel)
    if reach is None:
        return
    for value in voltages:
        if not reach[0] <= value <= reach[1]:
            bound = f"from {reach[0]:g} to {reach[1]:g} V, the output_range of the driver: "
            bound += "V, not mV, and before an amplifier, not behind it"
            raise SettingError(argument, value, bound, "V")
