"""What a person may ask of a run: STOP, hold, resume, the set-point or the speed of an axis."""

from __future__ import annotations

import json
from typing import Any

from truestroke.runtime.realtime.live_page.access import Refusal, RefusedError
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import Shared, Slot

SLOWEST = 1e-4  # of the highest speed


class Orders:
    """Leaves in the shared memory what is asked; the loop looks there."""

    def __init__(self, shared: Shared, axes: list[Panel]) -> None:
        self._count, self._targets, self._axes = shared.count, shared.targets, axes

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
            case _:
                raise RefusedError(Refusal.VALUE, "that cannot be done; there are stop, hold, resume, setpoint, speed")

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
