"""One axis within the loop: its controller, its row of the ring, and the failure of its sensor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.runtime.realtime.ending import Cause, Stop
from truestroke.runtime.realtime.motion import motion, numbers
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings
from truestroke.runtime.realtime.shared import FIELDS, Shared
from truestroke.runtime.realtime.supervision import Supervision
from truestroke.runtime.ticks import TICK, TickRecorder
from truestroke.signals.timing import Timing

MOVED = (
    0.01  # of the voltage range: a sensor that shows the same to the last bit while the voltage moves so far has failed
)


class AxisLoop:
    """Commands and measurements of one axis; the tick's share of `truestroke.run`, in the same order.

    Attributes
    ----------
    lost : int
        Samples that did not come.
    zero : float
        What is subtracted from measurements, um.
    """

    def __init__(self, axis: Axis, shared: Shared, channel: int, timing: Timing, settings: RealtimeSettings) -> None:
        self.axis, self.lost, self.zero = axis, 0, 0.0
        controller: Any = axis.controller
        self._controller, self._command, self._adapt = controller, controller.command, controller.adapt
        self._motion = motion(axis.trajectory, shared.targets[channel : channel + 1])
        self._size, self._ring = shared.layout.size, shared.ring[channel]
        rows = {name: self._ring[FIELDS.index(name)] for name in FIELDS}
        self._ticks = TickRecorder(controller, timing, {name: rows[name] for name in TICK}, shared.slow[channel])
        noted = ("desired", "desired_velocity", "volts", "lateness")
        self._desired, self._velocity, self._volts, self._lateness = (numbers(rows[name]) for name in noted)
        self._latency = timing.latency
        self._patience = max(2, round(settings.sensor_timeout * timing.sample_rate))
        self._moved = MOVED * (axis.voltage_limits[1] - axis.voltage_limits[0])
        self._unusable = self._same = 0
        self._last, self._volts_then = math.nan, 0.0
        self._supervision = Supervision(axis, settings, timing.sample_rate)
        self._error_limit, self._next_look = self._supervision.limit, self._supervision.window

    def first(self) -> float:
        """The voltage of the first tick, as far as it can be known without taking it."""
        controller = self._controller
        if not (hasattr(controller, "state") and hasattr(controller, "restore")):
            return self.axis.safe_voltage
        state = controller.state()
        volts = float(self._command(*self._motion(0)))
        controller.restore(state)
        low, high = self.axis.voltage_limits
        return min(max(volts, low), high)

    def command(self, start: int, stop: int, volts: FloatArray) -> None:
        """The voltages of ticks `start` to `stop`; a longer block holds the last one."""
        for i, k in enumerate(range(start, stop)):
            (z_d, zdot_d), row = self._motion(k), k % self._size
            volts[i] = self._command(z_d, zdot_d)
            self._desired[row], self._velocity[row] = z_d, zdot_d
            self._ticks.commanded(k)
        volts[stop - start :] = volts[stop - start - 1]

    def leaving(self, start: int, stop: int, volts: FloatArray, late: float) -> None:
        """Record the output after the guard, `late` us after its time."""
        for i, k in enumerate(range(start, stop)):
            self._volts[k % self._size], self._lateness[k % self._size] = volts[i], late

    def learn(self, start: int, stop: int, measured: FloatArray, truth: FloatArray | None) -> None:
        """Adapt to the measurements of ticks `start` to `stop`; `Stop` where the sensor fails, or tracking is lost."""
        supervision = self._supervision
        if self.zero:
            measured, truth = measured - self.zero, None if truth is None else truth - self.zero
        for k, z, ago in self._ticks.answers(start, stop, measured[: stop - start], truth):
            try:
                self._adapt(z, ago)
            except SettingError as error:  # the first one, out of reach
                raise Stop(Cause.SENSOR, f"axis {self.axis.name}: {error}") from None
            row = k % self._size
            self._look_at_sensor(z, self._volts[row])
            desired = self._desired[row]
            if abs(z - desired) > self._error_limit:
                supervision.astray(desired, z, self._volts[row])
            elif not supervision.idle:
                supervision.on_track()

    def _look_at_sensor(self, z: float, volts: float) -> None:
        self.lost += z != z
        rejected = getattr(self._controller, "flag_bits", 0) & BIT["rejected"]
        self._unusable = self._unusable + 1 if rejected or not math.isfinite(z) else 0
        if self._unusable >= self._patience:
            raise Stop(Cause.SENSOR, f"axis {self.axis.name}: no usable measurement for {self._unusable} ticks")
        if z != self._last:
            self._last, self._same, self._volts_then = z, 0, volts
            return
        self._same += 1
        if self._same >= self._patience and abs(volts - self._volts_then) > self._moved:
            raise Stop(
                Cause.SENSOR,
                f"axis {self.axis.name}: the sensor shows {z:g} um for {self._same} ticks while the voltage moves",
            )

    def look_back(self, stop: int) -> None:
        """Raise `Stop` where the sensor has not followed the voltage for a while; now and then, after tick `stop`."""
        end, window = stop - self._latency, self._supervision.window
        if end < self._next_look or window > self._size // 2:
            return
        self._next_look = end + max(1, window // 4)
        rows = np.arange(end - window, end) % self._size
        self._supervision.look_back(*(self._ring[FIELDS.index(n)][rows] for n in ("desired", "measured", "volts")))
