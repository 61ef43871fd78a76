"""Recordings that are shown again on the live page, in their own time."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.paced import EDGES_US
from truestroke.runtime.realtime import server
from truestroke.runtime.realtime.live_page import LiveSettings
from truestroke.runtime.realtime.live_page.orders import PACES
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import FIELDS, Shared, Slot, State
from truestroke.signals.recording import Recording

GLANCE = 0.02  # s between two looks at the clock and the buttons
SHORTEST = 2  # ticks


def replay(recordings: Mapping[str, Recording], settings: LiveSettings, *, speed: float = 1.0) -> None:
    """Show recordings on the live page, as the run was: until End is pressed there.

    It pauses at the end; from there it begins again. The page has a slider for the time, and a choice of speeds.

    Parameters
    ----------
    recordings : Mapping[str, Recording]
        One for each axis, by its name.
    settings : LiveSettings
        Of the page, whose address is printed on stderr.
    speed : float
        Times that of the run, 0.01 to 100, until another one is chosen on the page.

    Raises
    ------
    SettingError
        The recordings are not of one run: their sample rates differ; or one is shorter than two ticks.
    RealtimeError
        The page cannot be served.
    """
    checks.within("speed", speed, *PACES)
    settings.check([])
    rates = {name: _rate(name, one) for name, one in recordings.items()}
    rate = next(iter(rates.values()))
    for name, other in rates.items():
        if abs(other / rate - 1.0) > 1e-6:
            raise SettingError(f"sample rate of {name}", other, f"that of the others, {rate:g} Hz", "Hz")
    ticks = min(one["time"].size for one in recordings.values())
    with closing(server.blank(len(recordings), rate)) as shared:
        shared.count[Slot.TICKS], shared.count[Slot.REPLAY] = ticks, round(1e3 * speed)
        shared.count[Slot.STATE] = State.LIVE
        panels = [_panel(name, one) for name, one in recordings.items()]
        with server.served(settings, shared, panels, rate):
            _Tape(shared, list(recordings.values()), ticks, rate).play()


def _rate(name: str, recording: Recording) -> float:
    """Ticks per second, Hz."""
    at = recording["time"]
    if at.size < SHORTEST:
        raise SettingError(name, f"{at.size} ticks", f"at least {SHORTEST} ticks, which can be shown")
    return float((at.size - 1) / (at[-1] - at[0]))


def _panel(name: str, recording: Recording) -> Panel:
    """What the page must know of an axis; without limits in the file those that the voltage met."""
    volts, desired = recording["volts"], recording["desired"]
    axis = recording.metadata.get("axis") or {}
    limits = axis.get("voltage_limits") or (float(np.nanmin(volts)), float(np.nanmax(volts)))
    reach = float(np.nanmin(desired)), float(np.nanmax(desired))
    return Panel(name=name, voltage_limits=(limits[0], limits[1]), reach=reach, moved=False, weights=0)


class _Tape:
    """Writes the ticks into the ring as the loop does; of the run, `rate` of them were a second."""

    def __init__(self, shared: Shared, recordings: list[Recording], ticks: int, rate: float) -> None:
        self._shared, self._count, self._ticks, self._rate = shared, shared.count, ticks, rate
        self._lines: list[dict[int, FloatArray]] = [
            {row: np.asarray(one[name], np.float64) for row, name in enumerate(FIELDS) if name in one}
            for one in recordings
        ]
        self._late = recordings[0]["lateness"] if "lateness" in recordings[0] else np.zeros(0)

    def play(self) -> None:
        """Until somebody presses STOP."""
        count, place, before = self._count, 0.0, time.monotonic()
        while not count[Slot.STOP]:
            time.sleep(GLANCE)
            now = time.monotonic()
            step, before = (now - before) * self._rate * count[Slot.REPLAY] / 1000, now
            if asked := count[Slot.SEEK]:
                count[Slot.SEEK], place = 0, self._wound(min(asked - 1, self._ticks))
            if count[Slot.HOLD]:
                continue
            if place >= self._ticks:  # from the beginning, as a person asks
                place = self._wound(0)
            self._write(int(place), int(min(place + step, self._ticks)))
            place += step
            if place >= self._ticks:
                count[Slot.HOLD] = 1

    def _wound(self, tick: int) -> float:
        """That tick, with all that the page shows of the run up to there."""
        self._shared.histogram[:] = memoryview(bytes(self._shared.histogram.nbytes)).cast("Q")
        self._write(0, tick)
        return float(tick)

    def _write(self, start: int, stop: int) -> None:
        ring, size = self._shared.ring, self._shared.layout.size
        ticks = np.arange(max(start, stop - size), stop)
        for channel, lines in enumerate(self._lines):
            for row, line in lines.items():
                ring[channel, row, ticks % size] = line[ticks]
        classes = np.bincount(np.searchsorted(EDGES_US, self._late[start:stop]), minlength=len(EDGES_US) + 1)
        for place, number in enumerate(classes.tolist()):
            self._shared.histogram[place] += number
        self._count[Slot.WRITTEN] = stop
