"""What a server of a run is, in a process of its own: `epics` and `live_page` are two."""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from truestroke.runtime.realtime import process
from truestroke.runtime.realtime.motion import SetPoint
from truestroke.runtime.realtime.process import Lifeline, RealtimeError
from truestroke.runtime.realtime.recorder import Plan
from truestroke.runtime.realtime.settings import Axis
from truestroke.runtime.realtime.shared import FIELDS, Helper, Layout, Shared, Slot, State, Text
from truestroke.signals.trajectories import Trajectory

GLANCE = 0.02  # s between two looks at whether it is ready
LAST_WORDS = 2.0  # s for it to end
KEPT = 8.0  # s that a page can show, and more


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Data of an axis for the server: name, voltages, the range of the displacement, size of the weights."""

    name: str
    voltage_limits: tuple[float, float]
    reach: tuple[float, float]
    moved: bool
    weights: int
    speed: float = 0.0


class Server(Protocol):
    """Settings of a server; they are sent to its process."""

    def check(self, axes: Sequence[Axis]) -> None:
        """Before anything moves: RealtimeError where a package is missing, SettingError where the axes do not fit."""

    def serve(self, lifeline: Lifeline, shared: Shared, axes: list[Panel], sample_rate: float) -> None:
        """Publish until the run has ended, or its process is gone."""


def panels(axes: Sequence[Axis], plans: Sequence[Plan]) -> list[Panel]:
    """Of each axis."""
    return [
        Panel(
            name=axis.name,
            voltage_limits=axis.voltage_limits,
            reach=_reach(axis.trajectory),
            moved=isinstance(axis.trajectory, SetPoint),
            speed=axis.trajectory.speed if isinstance(axis.trajectory, SetPoint) else 0.0,
            weights=math.prod(plan.slow.shapes.get("weights", (0,))),
        )
        for axis, plan in zip(axes, plans, strict=True)
    ]


def _reach(motion: Trajectory | SetPoint) -> tuple[float, float]:
    if isinstance(motion, SetPoint):
        return motion.reach
    return float(motion.position.min()), float(motion.position.max())


def start(lifeline: Lifeline, shared: Shared, server: Server, axes: list[Panel], sample_rate: float) -> None:
    """`serve`, as the process of the server calls it."""
    server.serve(lifeline, shared, axes, sample_rate)


def blank(channels: int, sample_rate: float) -> Shared:
    """Memory for `served`: the last `KEPT` seconds of so many axes, of which nothing is known yet."""
    shared = Shared(Layout(channels=channels, size=round(KEPT * sample_rate) + 1, slow_size=1, slow_width=1))
    shared.ring[:] = np.nan
    shared.ring[:, FIELDS.index("flags")] = 0.0
    return shared


@contextmanager
def served(server: Server, shared: Shared, axes: list[Panel], sample_rate: float) -> Iterator[None]:
    """While it serves what is in the memory, of something else than a run of `run_realtime`.

    Raises
    ------
    RealtimeError
        It did not start.
    """
    serving = process.start(shared, start, server, axes, sample_rate)
    try:
        while serving.poll() is None and shared.count[Slot.SERVER] == Helper.ABSENT:
            time.sleep(GLANCE)
        if shared.count[Slot.SERVER] != Helper.READY:
            raise RealtimeError(f"the server did not start: {shared.read(Text.SERVER) or 'it died'}")
        yield
    finally:
        shared.count[Slot.STATE] = State.ENDED
        if serving.stdin:
            serving.stdin.close()
        try:
            serving.wait(LAST_WORDS)
        except subprocess.TimeoutExpired:
            serving.kill()
            serving.wait()
