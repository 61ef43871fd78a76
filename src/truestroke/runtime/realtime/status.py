"""The status line: a process that reads the data of the loop and prints them on stderr."""

import sys
import time

import numpy as np

from truestroke.base.display import figures
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.shared import Helper, Shared, Slot, State

WINDOW = 0.5  # s over which rmse is taken
REFRESH = 0.1  # s between two looks
LINE = 5.0  # s between two lines where there is no terminal
STATES = ("preparing", "soft start", "running", "soft stop", "ended")


def show(lifeline: Lifeline, shared: Shared, names: list[str], sample_rate: float, live: bool) -> None:
    """Until the run has ended: a line that is renewed in place if `live`, else one every 5 s."""
    if live:
        _live(lifeline, shared, names, sample_rate)
        return
    shown = time.monotonic()
    while _goes_on(lifeline, shared):
        if shared.count[Slot.STATE] == State.LIVE and time.monotonic() - shown >= LINE:
            shown = time.monotonic()
            sys.stderr.write(line(shared, names, sample_rate) + "\n")


def _live(lifeline: Lifeline, shared: Shared, names: list[str], sample_rate: float) -> None:
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True, highlight=False)
    with Live(console=console, auto_refresh=False, transient=True) as display:
        while _goes_on(lifeline, shared):
            display.update(line(shared, names, sample_rate), refresh=True)


def _goes_on(lifeline: Lifeline, shared: Shared) -> bool:
    return not lifeline.gone(REFRESH) and shared.count[Slot.STATE] != State.ENDED


def line(shared: Shared, names: list[str], sample_rate: float) -> str:
    """State, time left, overruns, and for each axis rmse of the last half second and voltage."""
    done, ticks = shared.count[Slot.WRITTEN], shared.count[Slot.TICKS]
    parts = [
        STATES[shared.count[Slot.STATE]],
        f"{(ticks - done) / sample_rate:.1f} s left",
        f"overruns {shared.count[Slot.OVERRUNS]}",
    ]
    if shared.count[Slot.SERVER] == Helper.FAILED:
        parts.append("the server is gone")
    if done:
        for channel, name in enumerate(names):
            desired, measured, volts = shared.last(channel, done, round(WINDOW * sample_rate))
            square = (measured - desired) ** 2
            rmse = figures(np.sqrt(np.nanmean(square))) if np.isfinite(square).any() else "?"
            parts.append(f"{name}: rmse {rmse} um, {volts[-1]:+.3f} V")
    return "   ".join(parts)
