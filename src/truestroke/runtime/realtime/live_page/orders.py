"""What a person may ask of a run: STOP, hold, resume, set-point or speed of an axis; of a replay: time and pace."""

from __future__ import annotations

import json
from typing import Any

from truestroke.runtime.realtime.live_page.access import Refusal, RefusedError
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import Shared, Slot

SLOWEST = 1e-4  # of the highest speed
PACES = (0.01, 100.0)  # of a replay, times that of the run


class Orders:
    """Leaves in the shared memory what is asked; the loop looks there."""

    def __init__(self, shared: Shared, axes: list[Panel], sample_rate: float) -> None:
        self._count, self._targets, self._axes, self._rate = shared.count, shared.targets, axes, sample_rate

    def follow(self, content: bytes) -> None:
        """What a request says, JSON; `RefusedError` where it cannot be done."""
        match _asked(content):
            case {"do": "stop"}:
                self._count[Slot.STOP] = 1
            case {"do": "hold" | "resume" as do}:
                self._count[Slot.HOLD] = int(do == "hold")
            case {"do": "setpoint", "axis": int(channel), "um": float(um) | int(um)}:
                panel = self._moved(channel)
                _within("the set-point", um, *panel.reach, "um")
                self._targets[channel] = um
            case {"do": "speed", "axis": int(channel), "um_per_s": float(speed) | int(speed)}:
                panel = self._moved(channel)
                _within("the speed", speed, panel.speed * SLOWEST, panel.speed, "um/s")
                self._targets[len(self._axes) + channel] = speed
            case {"do": "seek", "s": float(time) | int(time)}:
                self._check_replay()
                _within("the time", time, 0.0, self._count[Slot.TICKS] / self._rate, "s")
                self._count[Slot.SEEK] = 1 + round(time * self._rate)
            case {"do": "pace", "factor": float(factor) | int(factor)}:
                self._check_replay()
                _within("the pace", factor, *PACES, "times that of the run")
                self._count[Slot.REPLAY] = round(1e3 * factor)
            case _:
                known = "stop, hold, resume, setpoint, speed, and of a replay seek, pace"
                raise RefusedError(Refusal.VALUE, f"that cannot be done; there are {known}")

    def _check_replay(self) -> None:
        if not self._count[Slot.REPLAY]:
            raise RefusedError(Refusal.VALUE, "this is no recording: it has no other time or pace than the run")

    def _moved(self, channel: int) -> Panel:
        if not 0 <= channel < len(self._axes) or not self._axes[channel].moved:
            raise RefusedError(Refusal.VALUE, f"axis {channel} has no set-point: its motion is in the configuration")
        return self._axes[channel]


def _within(what: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:  # nor a whole number that no float can hold
        raise RefusedError(Refusal.VALUE, f"{what} = {value} {unit}: must be {low:g} to {high:g} {unit}")


def _asked(content: bytes) -> dict[str, Any]:
    try:
        asked = json.loads(content)
    except (ValueError, RecursionError):
        raise RefusedError(Refusal.MALFORMED, "that is no JSON") from None
    if not isinstance(asked, dict):
        raise RefusedError(Refusal.MALFORMED, "that is no object of JSON")
    return asked
