"""Whether an axis still tracks: how far it is from where it should be, for how long, and at which voltage."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.settings import ControllerSettings
from truestroke.runtime.realtime.ending import Cause, Stop
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings

SHARE = 0.3  # of the length of the motion: an axis that is further off does not follow it
LEAST = 0.05  # of the stroke: of motions that are shorter than that
OFF = 1 << 62  # ticks: of what is switched off
LARGE = 1 / 3  # of the error limit: rms of a sensor that no longer follows the voltage, and now
MOVED = 0.05  # of the voltage range: standard deviation of a voltage that the sensor should follow
ALIKE = 0.5  # correlation of voltage and sensor: a stack with any hysteresis has more than 0.9
REMEDY = "Look at sensor, cable, sign and amplifier, and whether the stage shakes"


def error_limit(axis: Axis) -> float:
    """Largest error of an axis, um: as configured, or 30 % of the motion, and at least 5 % of the stroke."""
    if axis.error_limit is not None:
        return axis.error_limit
    low, high = feasibility.reach(axis.trajectory)
    settings = getattr(axis.controller, "settings", None)
    return max(SHARE * (high - low), LEAST * settings.stroke if isinstance(settings, ControllerSettings) else 0.0)


class Supervision:
    """Counts the ticks in which an axis is off; the others take them back, one by one.

    Attributes
    ----------
    limit : float
        An error up to it is none of its business, um: it need not be asked.
    idle : bool
        Whether there is nothing to take back.
    window : int
        Ticks that `look_back` should be given.
    """

    def __init__(self, axis: Axis, settings: RealtimeSettings, sample_rate: float) -> None:
        self._axis, self._settings, self._rate = axis, settings, sample_rate
        self.limit, self.idle = error_limit(axis), True
        given = getattr(axis.controller, "settings", None)
        limits = [axis.voltage_limits] + ([given.voltage_limits] if isinstance(given, ControllerSettings) else [])
        self._low, self._high = max(low for low, _ in limits), min(high for _, high in limits)
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

    def astray(self, desired: float, measured: float, volts: float) -> None:
        """A tick with an error beyond the limit, um, um, V; `Stop` where that has lasted too long."""
        self.idle = False
        self._off += 1
        at_limit = not self._low < volts < self._high
        self._held += at_limit
        if self._off >= self._longest_off or self._held >= self._longest_held:
            self._stop(desired, measured, volts)

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

    def _stop(self, desired: float, measured: float, volts: float) -> NoReturn:
        held = self._held >= self._longest_held
        seconds = (self._held if held else self._off) / self._rate
        key = "limit_time" if held else "error_time"
        where = f"stands at a voltage limit, {volts:.4g} V" if held else f"is at {volts:.4g} V"
        raise Stop(
            Cause.NOT_TRACKING,
            f"axis {self._axis.name}: tracking is lost: more than {self.limit:.3g} um (error_limit) off for "
            f"{seconds:.2g} s ({key}); the output {where}, the sensor shows {measured:.4g} um, {desired:.4g} um are "
            f"asked for. {REMEDY}; if the motion needs more than voltage_limits give, make it smaller",
        )


def _alike(volts: FloatArray, measured: FloatArray) -> float:
    """Their correlation; 0 of a sensor that shows the same all the time."""
    v, z = volts - volts.mean(), measured - measured.mean()
    return float(v @ z / (np.sqrt((v @ v) * (z @ z)) or 1.0))
