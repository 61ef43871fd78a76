"""One channel of hardware that has several, as hardware of one channel."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.guard import check_range, range_of
from truestroke.runtime.drivers.playback import Recorded
from truestroke.runtime.drivers.protocol import Driver, check_axes
from truestroke.signals.timing import Timing


class SingleChannel:
    """A driver of one channel of several: the outputs of the others are set to their safe voltages and held there.

    `start`, or the first voltage of a `playback`, sets them at once: an output that was elsewhere jumps.

    Parameters
    ----------
    driver : Driver
        Hardware of several channels.
    axis : str
        The name of the one that moves.
    safe_voltages : Mapping[str, float]
        Safe voltage of each axis by its name, V, in the order of the channels, within the driver's `output_range`.
    voltage_limits : Mapping[str, tuple[float, float]], optional
        Lowest and highest voltage of each of the same axes, V: its safe voltage is within, and they are within the
        driver's `output_range`, also those of the axes that are held.

    Attributes
    ----------
    channel : int
        The one that moves, from 0.

    Raises
    ------
    SettingError
        No axis has this name, or a safe voltage is no finite number or beyond its limits; from `open`, which puts
        nothing out then: there is not one axis for each channel, or a safe voltage or limit is beyond the range of the
        driver.

    Examples
    --------
    >>> from truestroke.runtime.drivers import OneAxis, SimulatedDriver, SimulatedSettings
    >>> stage = SimulatedDriver(SimulatedSettings(channels=2))
    >>> driver = SingleChannel(stage, "y", {"x": 0.5, "y": 0.0})
    >>> with OneAxis(driver, voltage_limits=(-0.6, 3.6), slew=400.0) as axis:
    ...     timing = axis.open()
    ...     measured = axis.exchange(np.array([0.1]))
    ...     print(timing.channels, measured.shape, stage.output.tolist(), "V")
    1 (1,) [0.5, 0.1] V
    >>> stage.output.tolist()
    [0.5, 0.0]
    """

    def __init__(
        self,
        driver: Driver,
        axis: str,
        safe_voltages: Mapping[str, float],
        *,
        voltage_limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        checks.instance("safe_voltages", safe_voltages, Mapping, 'a mapping of each axis to its voltage, as {"x": 0.0}')
        self._names = tuple(safe_voltages)
        self._safe = np.array([checks.number(_called(name), value, "V") for name, value in safe_voltages.items()])
        if axis not in self._names:
            names = ", ".join(map(str, self._names)) or "no axis"
            raise SettingError("axis", repr(axis), f"one that has a safe voltage: {names}")
        self._limits = {} if voltage_limits is None else self._within(voltage_limits)
        self.driver, self.channel = driver, self._names.index(axis)
        self._is_open = False

    def _within(self, given: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """The limits of each axis, V, which its safe voltage is within."""
        checks.instance("voltage_limits", given, Mapping, 'a mapping of each axis to its limits, as {"x": (0.0, 10.0)}')
        if set(given) != set(self._names):
            words = f"one for each of the axes {', '.join(self._names)}"
            raise SettingError("voltage_limits", f"limits of {', '.join(map(str, given)) or 'no axis'}", words)
        limits = {name: checks.interval(f"voltage_limits of axis {name}", given[name], "V") for name in self._names}
        for name, volts in zip(self._names, self._safe.tolist(), strict=True):
            checks.within(_called(name), volts, *limits[name], "V")
        return limits

    def open(self) -> Timing:
        """As the driver, with one channel."""
        timing = self.driver.open()
        try:
            self._check(timing)
        except BaseException:
            self.driver.close()
            raise
        self._volts = np.repeat(self._safe[:, np.newaxis], timing.block, axis=1)
        self._measured = np.empty_like(self._volts)
        self._is_open = True
        return dataclasses.replace(timing, channels=1)

    def _check(self, timing: Timing) -> None:
        check_axes(len(self._names), timing.channels)
        description = self.driver.describe()
        for channel, (name, volts) in enumerate(zip(self._names, self._safe.tolist(), strict=True)):
            check_range(_called(name), [volts], description, channel)
            check_range(f"voltage_limits of axis {name}", self._limits.get(name, ()), description, channel)

    def start(self, volts: FloatArray) -> None:
        """As the driver; the other outputs are set to their safe voltages."""
        self.driver.start(_among(self._safe, self.channel, volts))

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """As the driver, of one channel."""
        self._volts[self.channel] = volts[0]
        self.driver.exchange(self._volts, self._measured)
        measured[0] = self._measured[self.channel]

    def stop(self, volts: FloatArray) -> None:
        """As the driver, all others at their safe voltages; nothing where it is not open: no output has been set."""
        if self._is_open:
            self.driver.stop(_among(self._safe, self.channel, volts))

    def close(self) -> None:
        """As the driver."""
        self._is_open = False
        self.driver.close()

    def rescue(self) -> Callable[[FloatArray], None]:
        """As the driver, with the safe voltage of this channel."""
        return functools.partial(_rescued, self.driver.rescue(), self._safe, self.channel)

    def describe(self) -> dict[str, object]:
        """As the driver, and the channel, with its own range."""
        described = self.driver.describe()
        reach = range_of(described, self.channel)
        return {**described, "channel": self.channel} | ({} if reach is None else {"output_range": reach})

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


def _called(name: str) -> str:
    """A safe voltage in errors."""
    return f"safe_voltage of axis {name}"


def _among(safe: FloatArray, channel: int, volts: FloatArray) -> FloatArray:
    """The safe voltages, and that of one channel."""
    return np.where(np.arange(len(safe)) == channel, volts[0], safe)


def _rescued(rescue: Callable[[FloatArray], None], safe: FloatArray, channel: int, volts: FloatArray) -> None:
    return rescue(_among(safe, channel, volts))
