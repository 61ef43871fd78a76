"""What a server of a run is, in a process of its own: `epics` and `live_page` are two."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from truestroke.runtime.realtime.motion import SetPoint
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.recorder import Plan
from truestroke.runtime.realtime.settings import Axis
from truestroke.runtime.realtime.shared import Shared
from truestroke.signals.trajectories import Trajectory


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
