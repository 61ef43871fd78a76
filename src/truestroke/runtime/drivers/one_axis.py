"""One axis of hardware as an actuator of the loop."""

from __future__ import annotations

import contextlib
from types import TracebackType

import numpy as np

from truestroke.base import interrupts
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.guard import Guard, Limits, check_range
from truestroke.runtime.drivers.paced import Clock, Paced, let_go
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.signals.timing import Timing

ONE_OF = "drivers.SingleChannel is one of several; in a file a table [[axis]] for each channel, and --axis NAME"


class OneAxis:
    """A driver of one channel as an actuator, for `truestroke.run` on hardware.

    Limits and slew are enforced here for every command. It has neither the watchdog nor the running
    record of `truestroke run`: use it for short experiments under supervision, in a ``with`` block, which leaves
    the output at the safe voltage.

    Parameters
    ----------
    driver : Driver
        Hardware of one channel.
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V.
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
        limits = Limits(voltage_limits=voltage_limits, slew=slew, safe_voltage=safe_voltage)
        self.driver, self.voltage_limits = driver, limits.voltage_limits
        self.slew, self.safe_voltage = limits.slew, limits.safe_voltage
        self._safe = np.array([self.safe_voltage])
        self._timing: Timing | None = None

    def __enter__(self) -> OneAxis:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def open(self) -> Timing:
        """Open the driver, again if it was open, and set the output to the safe voltage."""
        self.close()
        timing = self.driver.open()
        if timing.channels != 1:
            self.driver.close()  # the outputs stay where they are: the safe voltages of all are not known
            raise SettingError("channels of the driver", timing.channels, f"1; {ONE_OF}")
        try:
            check_range("voltage_limits", self.voltage_limits, self.driver.describe())
            self._guard = Guard(timing.sample_rate, [self.voltage_limits], [self.slew], [self.safe_voltage])
            self.driver.start(self._safe)
        except BaseException:
            let_go(self.driver, self._safe)
            raise
        self._timing = timing
        clock = Clock(timing.block / timing.sample_rate, hardware_timed=timing.hardware_timed)
        self._paced = Paced(self.driver, timing, self._guard, clock)
        return timing

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Apply `volts` (V, shape (ticks,), up to a block) within limits and slew; return the displacements, um."""
        return self._paced.exchange(self._checked(volts))[0, : len(volts)]

    def apply(self, volts: FloatArray) -> FloatArray:
        """`volts` (V, shape (ticks,)), however long, block by block.

        Returns
        -------
        ndarray, shape (ticks,)
            Displacement for each of them, um: the last voltage is held until all have arrived.
        """
        checked = self._checked(volts)
        latency = self._timing.latency if self._timing else 0
        came = self._paced.apply(np.pad(checked, ((0, 0), (0, latency)), mode="edge"))
        return came[0, latency : latency + len(volts)]

    def _checked(self, volts: FloatArray) -> FloatArray:
        if self._timing is None:
            raise SettingError("exchange", "called", "called after open")
        row = np.array([volts], dtype=np.float64)
        if np.isnan(row).any():  # before the guard takes a voltage that is not output for the last output
            raise SettingError("volts", "NaN", "a number", "V")
        return row

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
        """Set the output to the safe voltage, within slew where the driver still works, and close.

        No signal interrupts it.
        """
        if self._timing is None:
            return
        with interrupts.ignored():
            try:
                with contextlib.suppress(DriverError):
                    self._paced.apply(self._guard.ramp(self._safe.tolist()))
            finally:
                self._timing = None
                let_go(self.driver, self._safe)
