"""What the live page shows, as a frame: the last seconds of the ring, thinned to what a screen can show."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from truestroke.report import charts
from truestroke.runtime.drivers.paced import EDGES_US
from truestroke.runtime.realtime.live_page.access import WORDS
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import FIELDS, Shared, Slot
from truestroke.runtime.realtime.status import STATES, WINDOW

POINTS = 600  # of a line
DIGITS = 6  # of a value


def frame(shared: Shared, axes: list[Panel], sample_rate: float, window: float, settled: int) -> dict[str, Any]:
    """State, counters and the signals of each axis up to tick `settled`; `window`, s, of them."""
    count = shared.count
    return {
        "state": STATES[count[Slot.STATE]],
        "time": settled / sample_rate,
        "left": max(0, ticks - settled) / sample_rate if (ticks := count[Slot.TICKS]) else None,
        "overruns": count[Slot.OVERRUNS],
        "late_us": lateness(list(shared.histogram), 0.99),
        "held": bool(count[Slot.HOLD]),
        "replay": count[Slot.REPLAY] / 1000,
        "stop": bool(count[Slot.STOP]),
        "refused": {words: n for n, words in zip(shared.refused(len(WORDS)), WORDS, strict=True) if n},
        "axes": [_axis(shared, channel, panel, sample_rate, window, settled) for channel, panel in enumerate(axes)],
    }


def encoded(made: dict[str, Any]) -> bytes:
    """One line of JSON; what is no number is null."""
    return json.dumps(made, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def lateness(blocks: list[int], share: float) -> float | None:
    """The upper edge, us, of the class below which `share` of the blocks were; None before the first, or in the last.

    Examples
    --------
    >>> lateness([0] * 3, 0.99) is None
    True
    >>> lateness([99, 1, *[0] * 50], 0.99) == EDGES_US[0]
    True
    """
    total = sum(blocks)
    if not total:
        return None
    place = int(np.searchsorted(np.cumsum(blocks), math.ceil(share * total)))
    return float(EDGES_US[place]) if place < len(EDGES_US) else None


def _axis(shared: Shared, channel: int, panel: Panel, rate: float, window: float, settled: int) -> dict[str, Any]:
    desired, measured, volts = shared.last(channel, settled, round(window * rate))
    group = charts.thinning(desired.size, POINTS)
    error = measured - desired
    recent = error[-round(WINDOW * rate) :]
    known = recent[np.isfinite(recent)]
    ticks = np.arange(max(0, settled - recent.size), settled) % shared.layout.size
    flags = np.bitwise_or.reduce(shared.ring[channel, FIELDS.index("flags"), ticks].astype(np.uint64))
    every = slice(None, None, -(-max(1, desired.size) // POINTS))
    shown = {"desired": desired, "measured": measured, "error": error, "volts": volts}
    return {
        "rmse": _number(float(np.sqrt(np.mean(known**2)))) if known.size else None,
        "flags": int(flags),
        "target": _number(shared.targets[channel]) if panel.moved else None,
        "start": max(0, settled - desired.size) / rate,
        "step": 1.0 / rate if group == 1 else group / 2 / rate,
        "loop": [[_number(x) for x in line[every].tolist()] for line in (volts, measured)],
        **{name: [_number(x) for x in charts.extremes(line, group).tolist()] for name, line in shown.items()},
    }


def _number(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


def about(axes: list[Panel], flags: list[str]) -> dict[str, Any]:
    """What does not change: names, limits, reach, what moves, whether any axis learns, the names of the flags."""
    return {
        "flags": flags,
        "learns": any(panel.weights for panel in axes),
        "axes": [
            {
                "name": panel.name,
                "limits": panel.voltage_limits,
                "reach": panel.reach,
                "moved": panel.moved,
                "speed": panel.speed,
            }
            for panel in axes
        ],
    }
