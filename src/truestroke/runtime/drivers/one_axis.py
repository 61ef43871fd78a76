"""One axis of hardware as an actuator of the loop."""

from __future__ import annotations

import contextlib
from types import TracebackType

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.clock import Clock
from truestroke.runtime.drivers.guard import Guard, check_range, padded
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.signals.timing import Timing


class OneAxis:
    """A driver of one channel as an actuator, for `truestroke.run` on hardware.

    Limits and slew are enforced here, whatever the controller asks for. It has neither the watchdog nor the running
    record of `truestroke run`: use it for short experiments that somebody watches, in a ``with`` block, which leaves
    the output at the safe voltage.

    Parameters
    ----------
    driver : Driver
        Hardware of one channel.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage that may leave, V.
    slew : float
        Fastest change of the voltage, V/s.
    safe_voltage : float
        Where the output starts and ends, V, within the limits.

    Raises
    ------
    SettingError
        A setting is out of its bounds, or the driver has more than one channel.

    Examples
    --------
    >>> from truestroke.runtime.drivers import SimulatedDriver
    >>> driver = SimulatedDriver()
    >>> with OneAxis(driver, voltage_limits=(-0.6, 3.6), slew=400.0) as axis:
    ...     timing = axis.open()
    ...     measured = axis.exchange(np.array([0.1]))
    ...     print(timing.sample_rate, measured.shape, driver.output[0])
    2000.0 (1,) 0.1
    >>> float(driver.output[0])
    0.0
    """

    def __init__(
        self, driver: Driver, *, voltage_limits: tuple[float, float], slew: float, safe_voltage: float = 0.0
    ) -> None:
        self.driver = driver
        self.voltage_limits = checks.interval("voltage_limits", voltage_limits, "V")
        self.slew = checks.positive("slew", slew, "V/s")
        self.safe_voltage = checks.within("safe_voltage", safe_voltage, *self.voltage_limits, "V")
        self._safe = np.array([self.safe_voltage])
        self._timing: Timing | None = None

    def __enter__(self) -> OneAxis:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def open(self) -> Timing:
        """Open the driver, from anew if it was open, and bring the output to the safe voltage."""
        self.close()
        timing = self.driver.open()
        try:
            if timing.channels != 1:
                raise SettingError("channels of the driver", timing.channels, "1")
            check_range("voltage_limits", self.voltage_limits, self.driver.describe())
            self._guard = Guard(timing.sample_rate, [self.voltage_limits], [self.slew], [self.safe_voltage])
            self._clock = Clock(timing.block / timing.sample_rate, hardware_timed=timing.hardware_timed)
            self._measured = np.full((1, timing.block), np.nan)
            self.driver.start(self._safe)
        except BaseException:
            self._let_go()
            raise
        self._timing = timing
        self._clock.start()
        return timing

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Apply `volts` (V, shape (ticks,), up to a block) within limits and slew; return the displacements, um."""
        if self._timing is None:
            raise SettingError("exchange", "called", "called after open")
        block = padded(np.array([volts], dtype=np.float64), self._timing.block)
        if np.isnan(block).any():  # before the guard takes what will not leave for the last output
            raise SettingError("volts", "NaN", "a number", "V")
        self._guard(block)
        self._clock.wait()
        self.driver.exchange(block, self._measured)
        return self._measured[0, : len(volts)].copy()

    @property
    def truth(self) -> FloatArray:
        """Of a simulated driver: the noise-free counterpart of what the last exchange returned, um."""
        truth: FloatArray = self.driver.truth[0]  # type: ignore[attr-defined]
        return truth

    def describe(self) -> dict[str, object]:
        """Settings of driver and limits, for the recording."""
        own = {name: getattr(self, name) for name in ("voltage_limits", "slew", "safe_voltage")}
        return {**self.driver.describe(), "axis": own}

    def close(self) -> None:
        """Bring the output to the safe voltage, within slew where the driver still works, and let go."""
        if self._timing is None:
            return
        try:
            with contextlib.suppress(DriverError):
                self._ramp_down(self._timing.block)
        finally:
            self._timing = None
            self._let_go()

    def _ramp_down(self, block: int) -> None:
        ramp = self._guard.ramp(self._safe.tolist())[0]
        for start in range(0, ramp.size, block):
            self.exchange(ramp[start : start + block])

    def _let_go(self) -> None:
        try:
            self.driver.stop(self._safe)
        finally:
            self.driver.close()
