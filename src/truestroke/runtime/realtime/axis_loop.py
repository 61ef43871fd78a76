"""One axis within the loop: controller, row of the ring, failure of its sensor, and whether it still tracks."""

import math
from typing import Any, NoReturn

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.axes import LIMITED
from truestroke.runtime import run_metadata
from truestroke.runtime.realtime.ending import Cause, Stop
from truestroke.runtime.realtime.motion import motion, numbers
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings
from truestroke.runtime.realtime.shared import FIELDS, Shared
from truestroke.runtime.ticks import MARK, TICK, TickRecorder
from truestroke.signals import metrics
from truestroke.signals.channels import Array
from truestroke.signals.timing import Timing

SHARE = 0.3  # of the length of the motion: an axis that is further off does not follow it
LEAST = 0.05  # of the stroke: of motions that are shorter than that
OFF = 1 << 62  # ticks: of what is switched off
LARGE = 1 / 3  # of the error limit: rms of a sensor that no longer follows the voltage, and now
MOVED = 0.05  # of the voltage range: standard deviation of a voltage that the sensor should follow
ALIKE = 0.5  # correlation of voltage and sensor: a stack with any hysteresis has more than 0.9
ABOVE = 6.0  # times the noise of a sensor: a limit of so much is met by an error only
FROZEN = 0.01  # of the voltage range: a sensor that shows the same bits while the voltage moves so far has failed
REMEDY = "Look at sensor, cable, sign and amplifier, and whether the stage shakes"


def error_limit(axis: Axis) -> float:
    """Largest error of an axis, um: as configured, or 30 % of the motion, and at least 5 % of the stroke."""
    if axis.error_limit is not None:
        return axis.error_limit
    low, high = feasibility.reach(axis.trajectory)
    return max(SHARE * (high - low), LEAST * axis.known.stroke if axis.known else 0.0)


class Supervision:
    """Counts the ticks in which an axis is off; the others take them back, one by one, until it is `idle`.

    It need not be asked about an error up to `limit`, um; `look_back` should be given `window` ticks.
    """

    def __init__(self, axis: Axis, settings: RealtimeSettings, sample_rate: float) -> None:
        self._axis, self._settings, self._rate = axis, settings, sample_rate
        self.limit, self.idle = error_limit(axis), True
        self._low, self._high = axis.limits
        self._off = self._held = 0
        self._longest_off, self._longest_held = (
            max(2, round(seconds * sample_rate)) if seconds else OFF
            for seconds in (settings.error_time, settings.limit_time)
        )
        self.window = self._longest_off

    def on_track(self) -> None:
        """A tick with an error within the limit."""
        self._off = max(self._off - 1, 0)
        self._held = max(self._held - 1, 0)
        self.idle = not (self._off or self._held)

    def astray(self, volts: float) -> bool:
        """A tick with an error beyond the limit, under this voltage: whether that has lasted too long."""
        self.idle = False
        self._off += 1
        at_limit = not self._low < volts < self._high
        self._held += at_limit
        return self._off >= self._longest_off or self._held >= self._longest_held

    def look_back(self, desired: FloatArray, measured: FloatArray, volts: FloatArray) -> None:
        """The last ticks, um, um, V: `Stop` where the sensor does not follow the voltage and the axis is off."""
        known = np.isfinite(measured)
        if 2 * np.count_nonzero(known) < known.size:
            return  # others report that
        desired, measured, volts = desired[known], measured[known], volts[known]
        quarter = slice(-(measured.size // 4), None)  # now, too, or the worst is over
        if not all(self._ignored(desired[s], measured[s], volts[s]) for s in (slice(None), quarter)):
            return
        rms = np.sqrt(np.mean((measured - desired) ** 2))
        raise Stop(
            Cause.NOT_TRACKING,
            f"axis {self._axis.name}: tracking is lost: for {known.size / self._rate:.2g} s (error_time) the sensor "
            f"has not followed the voltage ({volts.min():.3g} to {volts.max():.3g} V, correlation "
            f"{_alike(volts, measured):.2f}); it shows {measured[-1]:.4g} um, {desired[-1]:.4g} um are asked for, "
            f"{rms:.3g} um off (rms). {REMEDY}",
        )

    def _ignored(self, desired: FloatArray, measured: FloatArray, volts: FloatArray) -> bool:
        """Whether the sensor does not follow a voltage that moves, or should move, with an error that matters."""
        if float(np.mean((measured - desired) ** 2)) <= (LARGE * self.limit) ** 2:
            return False
        moves = volts.std() > MOVED * (self._high - self._low) or desired.std() > LARGE * self.limit
        return bool(moves and _alike(volts, measured) < ALIKE)

    def stop(self, desired: FloatArray, measured: FloatArray, volts: FloatArray) -> NoReturn:
        """`Stop` with what the last of the last ticks shows, um, um, V."""
        held = self._held >= self._longest_held
        seconds = (self._held if held else self._off) / self._rate
        key = "limit_time" if held else "error_time"
        where = f"stands at a voltage limit, {volts[-1]:.4g} V" if held else f"is at {volts[-1]:.4g} V"
        raise Stop(
            Cause.NOT_TRACKING,
            f"axis {self._axis.name}: tracking is lost: more than {self.limit:.3g} um (error_limit) off for "
            f"{seconds:.2g} s ({key}); the output {where}, the sensor shows {measured[-1]:.4g} um, "
            f"{desired[-1]:.4g} um are asked for. {self._remedy(measured - desired)}",
        )

    def _remedy(self, errors: FloatArray) -> str:
        """Of a limit that the noise exceeds by itself, from the last errors, um; of a sensor that has not failed."""
        noise, stroke = metrics.noise(errors), self._axis.known.stroke if self._axis.known else math.inf
        if not self.limit < noise < LEAST * stroke:
            return f"{REMEDY}; if the motion needs more than voltage_limits give, make it smaller"
        return (
            f"That limit is below the noise of the sensor, {noise:.2g} um rms: set error_limit to "
            f"{figures(ABOVE * noise, 2)} um or more, or average more in the sensor"
        )


def _alike(volts: FloatArray, measured: FloatArray) -> float:
    """Their correlation; 0 of a sensor that shows the same all the time."""
    v, z = volts - volts.mean(), measured - measured.mean()
    return float(v @ z / (np.sqrt((v @ v) * (z @ z)) or 1.0))


class AxisLoop:
    """Commands and measurements of one axis; the tick's share of `truestroke.run`, in the same order.

    `lost` samples did not come; `zero`, um, is subtracted from the others.
    """

    def __init__(self, axis: Axis, shared: Shared, channel: int, timing: Timing, settings: RealtimeSettings) -> None:
        self.axis, self.lost, self.zero = axis, 0, 0.0
        controller: Any = axis.controller
        self._controller, self._command, self._adapt = controller, controller.command, controller.adapt
        targets = shared.targets[channel :: shared.layout.channels]
        self._motion = motion(axis.trajectory, targets, controller, axis.others, axis.learned)
        self._learned = axis.learned
        self._size, self._shared, self._channel = shared.layout.size, shared, channel
        rows = dict(zip(FIELDS, shared.ring[channel], strict=True))
        self._ticks = TickRecorder(controller, timing, {name: rows[name] for name in TICK}, shared.slow[channel])
        noted = ("desired", "desired_velocity", "volts", "lateness")
        self._desired, self._velocity, self._volts, self._lateness = (numbers(rows[name]) for name in noted)
        self._flat: Array | None = getattr(axis.trajectory, MARK, None)
        self._mark = numbers(rows[MARK])
        self._latency, self._sample_rate = timing.latency, timing.sample_rate
        self._patience = max(2, round(settings.sensor_timeout * timing.sample_rate))
        self._moved = FROZEN * (axis.voltage_limits[1] - axis.voltage_limits[0])
        self._unusable = self._same = 0
        self._last, self._volts_then = math.nan, 0.0
        self._supervision = Supervision(axis, settings, timing.sample_rate)
        self._error_limit, self._next_look = self._supervision.limit, self._supervision.window

    def first(self) -> float:
        """The voltage of the first tick, as far as it can be known without taking it."""
        controller: Any = getattr(self._controller, "controller", self._controller)  # a correction begins at 0
        if not (hasattr(controller, "state") and hasattr(controller, "restore")):
            return self.axis.safe_voltage
        state = controller.state()
        volts = float(controller.command(*self._motion(0)))
        controller.restore(state)
        low, high = self.axis.voltage_limits
        return min(max(volts, low), high)

    def command(self, start: int, stop: int, volts: FloatArray) -> None:
        """The voltages of ticks `start` to `stop`; a longer block holds the last one."""
        for i, k in enumerate(range(start, stop)):
            desired, row = self._motion(k), k % self._size
            volts[i] = self._command(*desired)
            self._desired[row], self._velocity[row] = desired[:2]
            if self._flat is not None:
                self._mark[row] = self._flat[k]
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
            desired = self._desired[row]
            if self._learned is not None:
                self._learned.put(k, math.nan if self._controller.flag_bits & LIMITED else z - desired)
            self._look_at_sensor(z, self._volts[row])
            if abs(z - desired) > self._error_limit:
                if supervision.astray(self._volts[row]):
                    supervision.stop(*self._shared.last(self._channel, k + 1, min(supervision.window, self._size // 2)))
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

    def hold(self, held: bool) -> None:
        """Learn nothing, or go on; a controller that does not learn goes on."""
        for one in (self._controller, self._learned):
            if change := getattr(one, "hold" if held else "resume", None):
                change()

    @property
    def found(self) -> dict[str, object]:
        """What the controller found, for the recording."""
        return run_metadata.found(self._controller, self._learned, self._sample_rate)

    def look_back(self, stop: int) -> None:
        """Raise `Stop` where the sensor has not followed the voltage for a while; now and then, after tick `stop`."""
        end, window = stop - self._latency, self._supervision.window
        if end >= self._next_look and window <= self._size // 2:
            self._next_look = end + max(1, window // 4)
            self._supervision.look_back(*self._shared.last(self._channel, end, window))
