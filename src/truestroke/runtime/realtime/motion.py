"""Desired motion of an axis: a trajectory that is known, or a set-point that changes during the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.control.repeating.learned_strain import LearnedStrain
from truestroke.runtime.agreement import wanted
from truestroke.signals.trajectories import Trajectory

UNIT = 2**32  # of whole numbers in a um: their sums are exact, however long a run lasts

Motion = Callable[[int], tuple[Any, ...]]
"""Tick k, which never goes back, to desired displacement (um) and velocity (um/s), and what else `command` takes."""


@dataclass(frozen=True, kw_only=True)
class SetPoint:
    """A target that an operator moves while the loop runs, in place of a trajectory; the axis starts at 0 um.

    The axis goes to the target at constant speed, with smooth beginning and end: the straight line is averaged twice
    over half of `ramp`. So it never overshoots, and arrives ``distance / speed + ramp`` after the last change.

    Attributes
    ----------
    reach : tuple[float, float]
        Lowest and highest target, um, with 0 between them; targets beyond are limited to the nearer one.
    speed : float
        Highest velocity, um/s.
    ramp : float
        From rest to full speed, s: the acceleration is at most ``2 * speed / ramp``, twice that where the motion is
        reversed.
    duration : float
        Longest run, s: the recording must have space on the disk.
    sample_rate : float
        Ticks per second, Hz.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> point = SetPoint(reach=(0.0, 30.0), speed=100.0, ramp=0.04, duration=1.0)
    >>> target = memoryview(bytearray(8)).cast("d")
    >>> motion = point.motion(target)
    >>> target[0] = 12.0
    >>> [round(motion(k)[0], 3) for k in (0, 40, 160, 319, 320, 400)]
    [0.0, 0.333, 6.0, 12.0, 12.0, 12.0]
    >>> motion(400)
    (12.0, 0.0)
    """

    reach: tuple[float, float]
    speed: float
    ramp: float = 0.05
    duration: float = 3600.0
    sample_rate: float = 2000.0
    name: str = field(default="set-point", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "reach", checks.interval("reach", self.reach, "um"))
        checks.within("0 um", 0.0, *self.reach, "um")
        checks.positive("speed", self.speed, "um/s")
        checks.positive("sample_rate", self.sample_rate, "Hz")
        checks.within("ramp", self.ramp, 2.0 / self.sample_rate, 10.0, "s")
        checks.within("duration", self.duration, 1.0 / self.sample_rate, 1e7, "s")

    def __len__(self) -> int:
        return max(1, round(self.duration * self.sample_rate))

    @property
    def settings(self) -> Mapping[str, object]:
        """For the recording."""
        return {key: getattr(self, key) for key in ("reach", "speed", "ramp", "duration")}

    def motion(self, target: memoryview[float]) -> Motion:
        """Follow what is at target[0], um, at each tick; what is no number changes nothing.

        A second number, if there is one, is the speed, um/s, up to `speed`; at 0 or less it is that.
        """
        return _Pursuit(self, target)


class _Pursuit:
    """The line to the target and its two averages, as whole numbers."""

    def __init__(self, point: SetPoint, target: memoryview[float]) -> None:
        rate = point.sample_rate
        self._target, self._reach, self._goal = target, point.reach, 0
        self._step, self._half_rate = max(1, round(point.speed / rate * UNIT)), 0.5 * rate
        half = max(1, round(0.5 * point.ramp * rate))
        self._line, self._sum, self._sum_of_sums = 0, 0, 0
        self._lines, self._sums, self._place = [0] * half, [0] * half, 0
        self._scale = half * half * UNIT
        self._tick, self._before, self._now, self._after = 0, 0.0, 0.0, 0.0
        self._fastest, self._asked, self._timed = self._step, 0.0, len(target) > 1

    def __call__(self, k: int) -> tuple[float, float]:
        while self._tick < k:
            self._advance()
        return self._now, (self._after - self._before) * self._half_rate

    def _advance(self) -> None:
        """One tick; the averages are a tick ahead, for the velocity at the tick itself."""
        low, high = self._reach
        asked = self._target[0]
        if asked == asked:
            self._goal = round(min(max(asked, low), high) * UNIT)
        if self._timed and self._target[1] != self._asked:
            self._asked = self._target[1]
            step = round(self._asked * UNIT / (2 * self._half_rate)) if math.isfinite(self._asked) else 0
            self._step = min(step, self._fastest) if step > 0 else self._fastest
        self._line += min(max(self._goal - self._line, -self._step), self._step)
        i = self._place
        self._sum += self._line - self._lines[i]
        self._lines[i] = self._line
        self._sum_of_sums += self._sum - self._sums[i]
        self._sums[i] = self._sum
        self._place = (i + 1) % len(self._lines)
        self._before, self._now, self._after = self._now, self._after, self._sum_of_sums / self._scale
        self._tick += 1


def motion(
    trajectory: Trajectory | SetPoint,
    target: memoryview[float],
    controller: object,
    others: FloatArray | None = None,
    learned: LearnedStrain | None = None,
) -> Motion:
    """The arguments of `command`: of a trajectory its entries, of a set-point the way to `target`.

    Beside `others` with the strain that was `learned`.
    """
    if isinstance(trajectory, SetPoint):
        return trajectory.motion(target)
    if others is not None:
        return _among(trajectory, controller, others, learned)
    z_d, zdot_d, *known = (numbers(array) for array in wanted(trajectory, controller))
    if not known:
        return lambda k: (z_d[k], zdot_d[k])
    zddot_d, *ahead = known
    if not ahead:
        return lambda k: (z_d[k], zdot_d[k], zddot_d[k])
    return lambda k: (z_d[k], zdot_d[k], zddot_d[k], ahead[0][k])


def _among(trajectory: Trajectory, controller: Any, others: FloatArray, learned: LearnedStrain | None) -> Motion:
    """The same of an axis beside others, with their motion."""
    strain = controller.strain(trajectory.position)
    z_d, zdot_d, zddot_d = (numbers(a) for a in (trajectory.position, trajectory.velocity, trajectory.acceleration))
    if strain is None:
        return lambda k: (z_d[k], zdot_d[k], zddot_d[k], None, others[k].tolist())
    strain_d = numbers(strain)
    if learned is None:
        return lambda k: (z_d[k], zdot_d[k], zddot_d[k], strain_d[k], others[k].tolist())
    at = learned.at
    return lambda k: (z_d[k], zdot_d[k], zddot_d[k], strain_d[k] + at(k), others[k].tolist())


def numbers(array: FloatArray) -> memoryview[float]:
    """The same memory, where one number is read and written faster than by NumPy."""
    return array.data.cast("B").cast("d")
