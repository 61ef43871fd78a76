"""What a scan asks of one axis: points on lines of constant speed, and the motion that makes them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base import system
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.dropins import motions
from truestroke.model.dynamics import Dynamics
from truestroke.signals.trajectories import BYTES, Trajectory

ALIKE = 1e-6  # relative: speeds that are one speed
SHORTEST = 2  # ticks of a line


@dataclass(frozen=True)
class Line:
    """Points on a line, each for a time: from `start` to `end`, um, at constant speed.

    >>> Line(0.0, 10.0, points=5, duration=0.1).edges.tolist()
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """

    start: float
    end: float
    points: int
    duration: float

    @property
    def edges(self) -> FloatArray:
        """Where each point begins, and the last one ends, um."""
        return np.linspace(self.start, self.end, self.points + 1)


def lines(lower: FloatArray, upper: FloatArray, duration: FloatArray, gap: Sequence[bool]) -> list[Line]:
    """The lines of a scan: each ends where a gap, or the way back, begins the next one.

    Parameters
    ----------
    lower, upper : ndarray, shape (points,)
        Where each point begins and ends, um.
    duration : ndarray, shape (points,)
        s.
    gap : sequence of bool
        Whether the axis must move between the point before and this one.

    Raises
    ------
    SettingError
        The speed changes within a line, or a point takes no time.

    Examples
    --------
    >>> edges = np.array([0.0, 1.0, 2.0, 3.0])
    >>> lines(edges[:-1], edges[1:], np.full(3, 0.1), [True, False, False])
    [Line(start=0.0, end=3.0, points=3, duration=0.3)]
    """
    if not (duration > 0).all():
        raise SettingError("duration of a point", f"{duration.min():g}", "above 0 s: 0.005 @ spec", "s")
    turned = np.diff(np.sign(upper - lower), prepend=0.0) != 0
    begins = [k for k, apart in enumerate(gap) if apart or turned[k] or k == 0]
    found = []
    for first, behind in zip(begins, [*begins[1:], len(lower)], strict=True):
        speed = (upper[first:behind] - lower[first:behind]) / duration[first:behind]
        if np.ptp(speed) > ALIKE * np.abs(speed).max():
            slowest, fastest = np.sort(speed)[[0, -1]]
            raise SettingError("speed", f"{slowest:g} to {fastest:g} within a line", "constant", "um/s")
        whole = round(float(duration[first:behind].sum()), 12)
        found.append(Line(float(lower[first]), float(upper[behind - 1]), behind - first, whole))
    return found


def flight(
    scan: Sequence[Line], sample_rate: float, *, speed: float, stage: Dynamics | None = None
) -> tuple[Trajectory, list[slice]]:
    """The motion along all lines, from the rest before the first run-up, and the ticks of each point.

    Between two lines the axis moves to the next run-up.

    Raises
    ------
    SettingError
        A line takes no two ticks, or all of them do not fit the memory.

    Examples
    --------
    >>> made, ticks = flight([Line(5.0, 15.0, 10, 0.1), Line(15.0, 5.0, 10, 0.1)], 2000.0, speed=500.0)
    >>> [round(float(made.position[k].mean()), 2) for k in (ticks[0], ticks[9], ticks[10])]
    [5.5, 14.5, 14.5]
    """
    whole = sum(line.duration for line in scan)
    if lacking := system.lacking(BYTES * whole * sample_rate):
        each = whole / max(1, sum(line.points for line in scan))
        most = system.free_memory() / (BYTES * sample_rate)
        bound = f"so short that all lines take at most {most:.3g} s, not {whole:.4g}: their ticks take {lacking}"
        raise SettingError("duration of a point", f"{each:g}", bound, "s")
    parts: list[Trajectory] = []
    places: list[slice] = []
    ticks = 0
    for line in scan:
        if line.duration < (least := SHORTEST / sample_rate):
            each, points = line.duration / line.points, f"a line of {line.points} points" if line.points > 1 else "it"
            bound = f"at least {least / line.points:g} s, so that {points} takes {SHORTEST} ticks"
            raise SettingError("duration of a point", f"{each:g}", bound, "s")
        made, on = motions.line(line.start, line.end, line.duration, sample_rate, stage=stage)
        if parts and parts[-1].position[-1] != made.position[0]:
            parts.append(motions.move(parts[-1].position[-1], made.position[0], sample_rate, speed=speed, stage=stage))
            ticks += len(parts[-1])
        begins = np.round(np.linspace(ticks + on.start, ticks + on.stop, line.points + 1)).astype(int)
        places += [slice(int(a), max(int(b), int(a) + 1)) for a, b in itertools.pairwise(begins)]
        parts.append(made)
        ticks += len(made)
    position, velocity, acceleration = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("position", "velocity", "acceleration")
    )
    return Trajectory("flight", sample_rate, position, velocity, {"lines": len(scan)}, acceleration), places


def of_spec(value: Any, axis: object, name: str) -> list[Line]:
    """The lines of a scanspec for an axis, which is one of the spec's axes, itself or by its name.

    Parameters
    ----------
    value : scanspec.specs.Spec, scanspec.core.Path or FlyMotorInfo
        Points with durations; of a `FlyMotorInfo` the line is one point.
    axis, name : object, str
        The device, and what it is called.

    Raises
    ------
    SettingError
        It has no such axis, another one that moves, or no duration; or the speed changes within a line.
    """
    if hasattr(value, "time_for_move"):
        return [Line(value.start_position, value.end_position, 1, value.time_for_move)]
    chunk = _path(value).consume()
    keys = [key for key in chunk.midpoints if key is axis or key == name]
    if not keys:
        raise SettingError("axis", ", ".join(map(str, chunk.midpoints)), f"{name}, the axis that flies")
    if others := [str(key) for key in chunk.midpoints if key != keys[0] and np.ptp(chunk.midpoints[key])]:
        raise SettingError("axis", ", ".join(others), f"left out: {name} flies alone")
    duration = chunk.duration
    if duration is None:
        raise SettingError("duration", None, "that of each point: 0.005 @ spec", "s")
    return lines(chunk.lower[keys[0]], chunk.upper[keys[0]], np.asarray(duration), list(chunk.gap))


def _path(value: Any) -> Any:
    from scanspec.core import Path
    from scanspec.specs import Fly, Spec

    if isinstance(value, Spec):
        value = value if isinstance(value, Fly) else Fly(value)
        return Path(value.calculate())
    if not isinstance(value, Path):
        words = "a scanspec, its Path, or a FlyMotorInfo"
        raise SettingError("prepare", f"a {type(value).__name__}", words)
    return value
