"""Motions that a host asks for: from rest to rest, and along a line at constant speed."""

from __future__ import annotations

import math

import numpy as np

from truestroke.base import checks, system
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model.dynamics import Dynamics
from truestroke.signals import shaping
from truestroke.signals.trajectories import BYTES, MOST_TICKS, Trajectory

SHORTEST = 8  # ticks of a move or a run-up: in fewer its shape is lost
REST = 0.5  # periods of the first mode, or so many `SLOWEST` without one: rest on both sides of a motion
TURN = 1.5  # periods of the first mode: time of a run-up
RUN_UP = 0.02  # s: of a run-up, or shortest move, where no mode is known


def move(start: float, end: float, sample_rate: float, *, speed: float, stage: Dynamics | None = None) -> Trajectory:
    """From rest at one place to rest at another, so that the stage rests there, too.

    Parameters
    ----------
    start, end : float
        um.
    sample_rate : float
        Ticks per second, Hz.
    speed : float
        Fastest velocity, um/s.
    stage : Dynamics, optional
        Its modes do not swing after the move (`shaping.settling_move`); without them the move is of minimum jerk and
        takes 20 ms, or as long as `speed` demands.

    Raises
    ------
    SettingError
        An argument is none, or the move takes more ticks than the memory holds.

    Examples
    --------
    >>> made = move(2.0, 12.0, 2000.0, speed=500.0)
    >>> made.position[[0, -1]].tolist(), round(made.duration, 4), round(abs(made.velocity).max())
    ([2.0, 12.0], 0.0385, 500)
    """
    rate = checks.positive("sample_rate", sample_rate, "Hz")
    height = checks.number("end", end, "um") - checks.number("start", start, "um")
    limit = checks.positive("speed", speed, "um/s") / max(abs(height), 1e-9)
    ticks = 2 * rate / limit  # about: its peak is not its mean
    if ticks > MOST_TICKS or system.lacking(ticks * BYTES):
        bound = f"faster: {abs(height):.4g} um take {1 / limit:.3g} s, too many ticks of {rate:g} Hz for the memory"
        raise SettingError("speed", speed, bound, "um/s")
    if stage is not None:
        shape = shaping.settling_move(stage, velocity=limit)
    else:
        shape = shaping.minimum_jerk(max(1.875 / limit, RUN_UP))  # 1.875: peak of its velocity
    still = _rest(stage, rate)
    time = np.arange(2 * still + math.ceil(shape.duration * rate)) / rate
    s, first, second = shape.at(time - still / rate)
    s[time >= still / rate + shape.duration] = 1.0
    return Trajectory("move", rate, start + height * s, height * first, {"end": end}, height * second)


def stopped(motion: Trajectory, at: int, *, stage: Dynamics | None = None) -> Trajectory:
    """A motion that comes to rest on its way: from tick `at` on it is made ever more slowly, within a run-down.

    Parameters
    ----------
    motion : Trajectory
        With its acceleration.
    at : int
        Its tick from which on it slows down, from 0 on.
    stage : Dynamics, optional
        Its modes do not swing at the end: as of `line`.

    Examples
    --------
    >>> made = stopped(line(5.0, 15.0, 0.1, 2000.0)[0], 100)
    >>> len(made), made.position[[100, -1]].round(1).tolist(), made.velocity[[100, -1]].tolist()
    (142, [8.0, 9.0], [100.0, 0.0])
    """
    rate, ticks = motion.sample_rate, np.arange(len(motion), dtype=np.float64)
    edge, still = _run_up(stage, rate), _rest(stage, rate)
    turn, since = shaping.reversal(edge / rate, stage), np.arange(1, edge + 1) / rate
    done, first, _ = turn.at(since)
    done[-1], first[-1] = 1.0, 0.0
    places = np.minimum(at + rate * (since - turn.integral(since)), ticks[-1])
    slowing = 1.0 - done
    speed = np.interp(places, ticks, motion.velocity) * slowing
    change = np.interp(places, ticks, motion.acceleration) * slowing**2
    change -= np.interp(places, ticks, motion.velocity) * first
    way = _between(motion.position, motion.velocity / rate, places)
    parts = (motion.position, way), (motion.velocity, speed), (motion.acceleration, change)
    rest = [np.full(still, way[-1]), np.zeros(still), np.zeros(still)]
    position, velocity, acceleration = (
        np.concatenate([before[: at + 1], slow, last]) for (before, slow), last in zip(parts, rest, strict=True)
    )
    return Trajectory(motion.name, rate, position, velocity, {**motion.settings, "stopped": at}, acceleration)


def line(
    start: float, end: float, duration: float, sample_rate: float, *, stage: Dynamics | None = None
) -> tuple[Trajectory, slice]:
    """Along a line at constant speed, with a run-up before and a run-down after it, from rest to rest.

    Parameters
    ----------
    start, end : float
        Of the line, um.
    duration : float
        From start to end, s.
    sample_rate : float
        Ticks per second, Hz.
    stage : Dynamics, optional
        Its modes do not swing on the line: run-up and run-down take 1.5 periods of the first one, else 20 ms.

    Returns
    -------
    Trajectory, slice
        The motion, and its ticks on the line: the desired position of each is that of its middle.

    Examples
    --------
    >>> made, on = line(5.0, 15.0, 0.1, 2000.0)
    >>> made.position[on][[0, -1]].round(3).tolist(), set(made.velocity[on].round(6).tolist())
    ([5.025, 14.975], {100.0})
    >>> made.position[[0, -1]].round(3).tolist()
    [4.0, 16.0]
    """
    rate = checks.positive("sample_rate", sample_rate, "Hz")
    checks.within("duration", duration, 2 / rate, 1e6, "s")
    speed = (end - start) / duration
    edge, still = _run_up(stage, rate), _rest(stage, rate)
    turn = shaping.reversal(edge / rate, stage)
    along = round(duration * rate)
    middles = np.arange(2 * (still + edge) + along + 1, dtype=np.float64) - (
        still - 0.5
    )  # a tick is measured as its mean
    time: FloatArray = np.divide(middles, rate)
    rise, down = edge / rate, (edge + along) / rate

    def courses(since: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Integral of the course of the speed, s, the course, and its derivative, 1/s."""
        s, first, _ = turn.at(since)
        inside = np.clip(since, 0.0, rise)
        return turn.integral(inside) + np.maximum(since - rise, 0.0), np.where(since >= rise, 1.0, s), first

    up, falls = courses(time), courses(time - down)
    way, part, change = (a - b for a, b in zip(up, falls, strict=True))
    position = start + speed * (way - rise / 2)
    made = Trajectory("line", rate, position, speed * part, {"start": start, "end": end}, speed * change)
    return made, slice(still + edge, still + edge + along)


def _between(position: FloatArray, steps: FloatArray, places: FloatArray) -> FloatArray:
    """Positions between ticks, by a cubic with their velocities; without SciPy, which a stop would have to load."""
    k = np.minimum(places.astype(int), len(position) - 2)
    u = places - k
    rise = position[k + 1] - position[k]
    bent = (1 - u) * (steps[k] - rise) - u * (steps[k + 1] - rise)
    return np.asarray(position[k] + u * rise + u * (1 - u) * bent)


def _run_up(stage: Dynamics | None, rate: float) -> int:
    """Ticks in which an axis gains or loses its speed."""
    period = RUN_UP if stage is None else TURN / stage.modes[0].frequency
    return max(SHORTEST, math.ceil(period * rate))


def _rest(stage: Dynamics | None, rate: float) -> int:
    """Ticks of rest before and after a motion, in which an inverse that looks ahead begins and ends."""
    return 1 if stage is None else math.ceil(REST / stage.modes[0].frequency * rate)
