"""The desired motion: position, exact velocity and acceleration, tick by tick.

Every motion starts at 0 um at rest. One that would start elsewhere is multiplied by the quintic smoothstep

    s(u) = 6 u^5 - 15 u^4 + 10 u^3,    u = t / ramp,

which leaves 0 and reaches 1 without velocity or acceleration; by the product rule the velocity is s v + s' z, the
acceleration s a + 2 s' v + s'' z.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke import _loops
from truestroke.base import checks, system
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model.dynamics import Dynamics
from truestroke.signals import shaping
from truestroke.signals.channels import Sampled
from truestroke.signals.columns import Wanted, even_rate, read_columns, refuse_bad_rows
from truestroke.signals.shaping import Motion, Move
from truestroke.signals.tables import OF_LANGUAGES, UNITS, RecordError, open_table

HEADINGS = {
    "position": ("z", "desired", "position", "displacement", *OF_LANGUAGES["displacement"]),
    "time": ("t", "time", *OF_LANGUAGES["time"]),
}
PART = 2**16  # ticks of a raster that are computed at a time
BLOCK = 4096  # ticks that are filtered at a time: what they need stays in the cache
FARTHEST = 1e9  # um of a motion
FEWEST_TICKS, MOST_TICKS = 2, 10**9  # of a motion
BYTES = 120.0  # of memory that a tick of a motion takes while it is made
LONGEST_TURNS = 0.99  # of the period of a raster
ESTIMATED = "central differences of the velocity"
"""What `settings["acceleration"]` of a trajectory states where nobody gave its acceleration."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Sampled):
    """A desired motion.

    Attributes
    ----------
    name : str
        What it is: "random wave", "sine", ...
    sample_rate : float
        Ticks per second, Hz.
    position : ndarray, shape (ticks,)
        Desired displacement z_d at the start of each tick, um.
    velocity : ndarray, shape (ticks,)
        Desired velocity zdot_d, um/s.
    settings : Mapping[str, object]
        What it was made from.
    acceleration : ndarray, shape (ticks,)
        Desired acceleration zddot_d, um/s^2. Left out or None, it is estimated by central differences of the velocity,
        (v(k+1) - v(k-1)) / (2 T), one-sided at both ends, and `settings["acceleration"]` says so.
    flat : ndarray of bool, shape (ticks,), or None
        In which ticks errors count, such as on the lines of a raster and not in its turns; None is in all.

    Raises
    ------
    SettingError
        Position, velocity or acceleration is empty or not finite, the arrays differ in length, or `flat` marks no tick.

    Examples
    --------
    >>> time = np.arange(5) / 1000.0
    >>> move = Trajectory("parabola", 1000.0, 50.0 * time**2, 100.0 * time)
    >>> move.acceleration.round(6).tolist(), move.settings["acceleration"]
    ([100.0, 100.0, 100.0, 100.0, 100.0], 'central differences of the velocity')
    """

    name: str
    sample_rate: float
    position: FloatArray
    velocity: FloatArray
    settings: Mapping[str, object] = field(default_factory=dict)
    acceleration: FloatArray = None  # type: ignore[assignment]  # an array from __post_init__ on
    flat: npt.NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        checks.positive("sample_rate", self.sample_rate, "Hz")
        if self.acceleration is None:
            velocity = checks.finite_array("velocity", self.velocity, "um/s")
            object.__setattr__(self, "acceleration", differences(velocity, self.sample_rate))
            object.__setattr__(self, "settings", {**self.settings, "acceleration": ESTIMATED})
        for argument, unit in (("position", "um"), ("velocity", "um/s"), ("acceleration", "um/s^2")):
            array = checks.finite_array(argument, getattr(self, argument), unit).copy()
            array.flags.writeable = False
            object.__setattr__(self, argument, array)
        if not self.position.size:
            raise SettingError("position", "an empty array", "at least one tick", "um")
        if self.flat is not None:
            flat = np.array(self.flat, dtype=bool)
            if not flat.any():
                raise SettingError("flat", "no tick", "at least one tick in which errors count, or None for all")
            flat.flags.writeable = False
            object.__setattr__(self, "flat", flat)
        super().__post_init__()

    @property
    def peak_to_peak(self) -> float:
        """Highest minus lowest position, um; it counts the start from 0 um."""
        return float(np.ptp(self.position))

    @property
    def peak_speed(self) -> float:
        """Largest absolute velocity, um/s."""
        return float(np.max(np.abs(self.velocity)))

    @property
    def peak_acceleration(self) -> float:
        """Largest absolute acceleration, um/s^2; a corner, where the velocity jumps, is not in it."""
        return float(np.max(np.abs(self.acceleration)))


def differences(velocity: FloatArray, sample_rate: float) -> FloatArray:
    """Acceleration by central differences of a velocity, one-sided at both ends; 0 of a single tick.

    Examples
    --------
    >>> differences(np.array([0.0, 1.0, 4.0]), 10.0).tolist()
    [10.0, 20.0, 30.0]
    """
    return np.gradient(velocity, 1 / sample_rate) if velocity.size > 1 else np.zeros_like(velocity)


# ---- Moving from rest ----------------------------------------------------------------------------------------------


def smoothstep(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimum-jerk move s(u) = 6 u^5 - 15 u^4 + 10 u^3 and its slope ds/du; 0 before u = 0, 1 after u = 1.

    Parameters
    ----------
    u : ndarray
        Time as a part of that of the whole move.

    Returns
    -------
    s, slope : ndarray
        In [0, 1] and [0, 15/8].

    Examples
    --------
    >>> s, slope = smoothstep(np.array([0.0, 0.5, 1.0]))
    >>> s.tolist(), slope.tolist()
    ([0.0, 0.5, 1.0], [0.0, 1.875, 0.0])
    """
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 + u * (6.0 * u - 15.0)), 30.0 * u**2 * (1.0 - u) ** 2


def smoothstep_curvature(u: FloatArray) -> FloatArray:
    """Second derivative of `smoothstep`, s''(u) = 60 u (1 - u) (1 - 2 u); 0 outside of the move.

    Examples
    --------
    >>> smoothstep_curvature(np.array([0.0, 0.25, 0.5, 0.75])).tolist()
    [0.0, 5.625, 0.0, -5.625]
    """
    u = np.clip(u, 0.0, 1.0)
    return 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


def ramped(time: FloatArray, motion: Motion, ramp: float) -> Motion:
    """The same arrays, of a motion that builds up from 0 um in `ramp`, s."""
    position, velocity, acceleration = motion
    if ramp == 0:
        return motion
    end = np.searchsorted(time, ramp)  # from there on s = 1
    u = time[:end] / ramp
    s, slope = smoothstep(u)
    curvature = smoothstep_curvature(u) / ramp**2
    acceleration[:end] = s * acceleration[:end] + 2 * slope / ramp * velocity[:end] + curvature * position[:end]
    velocity[:end] = s * velocity[:end] + slope / ramp * position[:end]
    position[:end] *= s
    return position, velocity, acceleration


def by_parts(motion: Callable[[slice], Motion], ticks: int) -> Motion:
    """A motion of many ticks from that of some at a time: what is computed on the way takes little memory."""
    made = np.empty(ticks), np.empty(ticks), np.empty(ticks)
    for start in range(0, ticks, PART):
        part = slice(start, min(start + PART, ticks))
        for whole, values in zip(made, motion(part), strict=True):
            whole[part] = values
    return made


def _made(
    name: str,
    sample_rate: float,
    motion: Motion,
    settings: Mapping[str, object],
    flat: npt.NDArray[np.bool_] | None = None,
) -> Trajectory:
    """Of a motion whose acceleration is known."""
    position, velocity, acceleration = motion
    return Trajectory(name, sample_rate, position, velocity, settings, acceleration, flat)


def _ticks(duration: float, sample_rate: float, ramp: float = 0.0) -> FloatArray:
    """Checks the settings that all motions share; start of each tick, s."""
    duration = checks.positive("duration", duration, "s")
    sample_rate = checks.positive("sample_rate", sample_rate, "Hz")
    if not 0.0 <= checks.number("ramp", ramp, "s") <= duration / 2:
        raise SettingError("ramp", ramp, f"from 0 to {duration / 2:g} s, half of the duration of {duration:g} s", "s")
    if not FEWEST_TICKS <= (ticks := round(min(duration * sample_rate, 2.0 * MOST_TICKS))) <= MOST_TICKS:
        ends = " to ".join(f"{number / sample_rate:.6g}" for number in (FEWEST_TICKS, MOST_TICKS))
        bound = f"from {ends} s, {FEWEST_TICKS} to {MOST_TICKS} ticks of {sample_rate:g} Hz"
        raise SettingError("duration", duration, bound, "s")
    if lacking := system.lacking(ticks * BYTES):
        most = f"at most {system.free_memory() / BYTES / sample_rate:.3g} s at {sample_rate:g} Hz"
        raise SettingError("duration", duration, f"{most}: {ticks:.3g} ticks take {lacking}", "s")
    return np.arange(ticks) / sample_rate


# ---- Periodic motions ----------------------------------------------------------------------------------------------


def sine(
    *,
    frequency: float = 12.0,
    peak_to_peak: float = 22.8,
    duration: float = 20.0,
    sample_rate: float = 2000.0,
    offset: float | None = None,
    ramp: float = 0.25,
) -> Trajectory:
    """A sine, z_d = offset + peak_to_peak / 2 sin(2 pi frequency t).

    Parameters
    ----------
    frequency : float
        Hz, below half of the sample rate.
    peak_to_peak : float
        um.
    duration, sample_rate : float
        s, Hz.
    offset : float, optional
        Centre, um; by default half of peak_to_peak, so that the sine begins at 0 um.
    ramp : float
        Time in which the motion builds up from 0 um, s, at most half of the duration.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> wave = sine(frequency=4.0, peak_to_peak=20.0, duration=1.0)
    >>> len(wave), round(wave.peak_to_peak, 4), round(wave.peak_speed, 4)
    (2000, 20.0, 251.3274)
    """
    time = _ticks(duration, sample_rate, ramp)
    omega = 2 * math.pi * below_nyquist("frequency", frequency, sample_rate)
    amplitude = checks.positive("peak_to_peak", peak_to_peak, "um") / 2
    centre = amplitude if offset is None else checks.number("offset", offset, "um")
    swing = np.sin(omega * time)
    motion = centre + amplitude * swing, omega * amplitude * np.cos(omega * time), -(omega**2) * amplitude * swing
    settings = {"frequency": frequency, "peak_to_peak": peak_to_peak, "offset": centre, "ramp": ramp}
    return _made("sine", sample_rate, ramped(time, motion, ramp), settings)


def triangle(
    *,
    speed: float | None = None,
    frequency: float | None = None,
    peak_to_peak: float = 22.8,
    duration: float = 20.0,
    sample_rate: float = 2000.0,
    offset: float | None = None,
    ramp: float = 0.25,
) -> Trajectory:
    """A triangle of constant speed (Sec. 2.4): after the ramp the velocity is +speed or -speed, to the last bit.

    Parameters
    ----------
    speed, frequency : float
        One of the two, um/s or Hz: speed = 2 peak_to_peak frequency.
    peak_to_peak, duration, sample_rate, offset, ramp : float
        As in `sine`. At a corner the velocity is that of the line which begins there, and the acceleration is that of
        the lines, 0: the jump of the velocity is not in it.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> wave = triangle(speed=300.0, peak_to_peak=20.0, duration=1.0)
    >>> sorted(set(wave.velocity[wave.time >= 0.25].tolist()))
    [-300.0, 300.0]
    """
    time = _ticks(duration, sample_rate, ramp)
    span = checks.positive("peak_to_peak", peak_to_peak, "um")
    if (speed is None) == (frequency is None):
        raise SettingError("speed", speed, "given, or frequency in its place, but not both", "um/s")
    if speed is None:
        speed = 2 * span * checks.positive("frequency", frequency, "Hz")
    speed = checks.positive("speed", speed, "um/s")
    cycles = below_nyquist("frequency", speed / (2 * span), sample_rate)  # per second
    centre = span / 2 if offset is None else checks.number("offset", offset, "um")
    cycle = np.mod(cycles * np.arange(time.size), sample_rate) / sample_rate  # corners on a tick stay there
    position = centre + span * (0.5 - np.abs(2 * cycle - 1))
    motion = position, np.where(cycle < 0.5, speed, -speed), np.zeros_like(position)
    settings: dict[str, object] = {"speed": speed, "frequency": cycles, "peak_to_peak": span}
    settings |= {"offset": centre, "ramp": ramp}
    return _made("triangle", sample_rate, ramped(time, motion, ramp), settings)


def raster(
    *,
    frequency: float = 4.0,
    turn: float | Dynamics = 0.2,
    peak_to_peak: float = 22.8,
    duration: float = 20.0,
    sample_rate: float = 2000.0,
    offset: float | None = None,
    ramp: float = 0.25,
) -> Trajectory:
    """Lines of constant speed, up and down, with turns of continuous acceleration and jerk between them.

    In a turn of tau seconds the velocity is v (1 - 2 s(t / tau)), with s of `shaping.reversal`; the line back begins
    where the line before has ended. `flat` marks the lines after the ramp, so that errors count there alone.

    Parameters
    ----------
    frequency : float
        Lines up per second, Hz.
    turn : float or Dynamics
        Share of the period that both turns take together, from 0.01 to 0.99. Dynamics of the stage choose it: each turn
        takes 1.8 periods of the first mode, or less where both would take more than 0.4 of the period, but at least
        1.4, and leaves no vibration, also where the mode is known within 5 % only.
    peak_to_peak : float
        With the turns, um; `settings["line"]` is the length of the lines.
    duration, sample_rate, offset, ramp : float
        As in `sine`.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit, such as a frequency for which the stage cannot turn.

    Examples
    --------
    >>> wave = raster(frequency=10.0, turn=0.2, peak_to_peak=20.0, duration=2.0)
    >>> speeds = sorted(set(wave.velocity[wave.flat].tolist()))
    >>> [round(speed, 1) for speed in speeds], round(wave.settings["line"], 2)
    ([-426.7, 426.7], 17.07)
    >>> from truestroke import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
    >>> fast = raster(frequency=97.0, turn=stage, peak_to_peak=20.0, sample_rate=10000.0)
    >>> round(fast.settings["turn"], 3), round(fast.settings["line"], 2)
    (0.4, 14.34)
    """
    time = _ticks(duration, sample_rate, ramp)
    cycles = below_nyquist("frequency", frequency, sample_rate)
    span = checks.positive("peak_to_peak", peak_to_peak, "um")
    centre = span / 2 if offset is None else checks.number("offset", offset, "um")
    share, course = _turn(turn, cycles)
    line, tau = (1 - share) / (2 * cycles), course.duration
    beyond = float(np.max(_turned(course, np.linspace(0.0, tau, 1001))[0]))  # of a line with unit speed, s
    speed = span / (line + 2 * beyond)
    edge, half = speed * line / 2, line + tau
    flat = np.zeros(time.size, dtype=bool)

    def passed(ticks: slice) -> Motion:
        k = np.arange(ticks.start, ticks.stop)
        cycle = np.mod(cycles * k, sample_rate) / (sample_rate * cycles)  # s from a line's beginning
        sign, within = np.where(cycle < half, 1.0, -1.0), np.mod(cycle, half)
        turning = within >= line
        flat[ticks] = ~turning
        place, rate, change = (np.zeros_like(cycle) for _ in range(3))
        place[~turning], rate[~turning] = speed * within[~turning] - edge, speed
        turned = _turned(course, within[turning] - line)
        place[turning], rate[turning], change[turning] = edge + speed * turned[0], speed * turned[1], speed * turned[2]
        return centre + sign * place, sign * rate, sign * change

    motion = by_parts(passed, time.size)
    settings: dict[str, object] = {"frequency": cycles, "turn": share, "turn_time": tau, "peak_to_peak": span}
    settings |= {"line": 2 * edge, "speed": speed, "offset": centre, "ramp": ramp}
    if isinstance(turn, Dynamics):
        settings["resonance"] = turn.modes[0].frequency
    return _made("raster", sample_rate, ramped(time, motion, ramp), settings, flat & (time >= ramp))


def _turn(turn: float | Dynamics, frequency: float) -> tuple[float, Move]:
    """Share of the period of both turns, and the course of one."""
    if not isinstance(turn, Dynamics):
        share = checks.within("turn", turn, 0.01, LONGEST_TURNS, "of the period")
        return share, shaping.reversal(share / (2 * frequency))
    tau = shaping.turn_time(turn, frequency)
    most = LONGEST_TURNS / (2 * tau)
    if frequency > most:
        bound = f"at most {most:.4g} Hz: a turn takes {1000 * tau:.3g} ms, {shaping.PERIODS} periods of the first mode,"
        bound += f" {turn.modes[0].frequency:.4g} Hz; or give `turn` as a share of the period, or a sine"
        raise SettingError("frequency", frequency, bound, "Hz")
    return 2 * tau * frequency, shaping.reversal(tau, turn)


def _turned(course: Move, time: FloatArray) -> Motion:
    """A turn after a line of unit speed: way, s, speed and its rate, 1/s, at times from its beginning."""
    s, rate, _ = course.at(time)
    return time - 2 * course.integral(time), 1 - 2 * s, -2 * rate


def step(
    *,
    peak_to_peak: float = 5.0,
    settle: Dynamics | None = None,
    shape: str = "polynomial",
    rise: float | None = None,
    hold: float = 0.1,
    velocity_limit: float = math.inf,
    acceleration_limit: float = math.inf,
    duration: float = 20.0,
    sample_rate: float = 2000.0,
    offset: float = 0.0,
    ramp: float = 0.25,
) -> Trajectory:
    """Steps up and down, each a move from rest to rest after which the stage is at rest, too.

    Parameters
    ----------
    peak_to_peak : float
        Height of a step, um.
    settle : Dynamics, optional
        Of the stage: a step takes 1.4 periods of its first mode, or as long as the limits demand, and leaves less than
        1 % of its height as vibration where the frequency of the mode is known within 5 %.
    shape : str
        Of a step with `settle`: "polynomial", or the input shaper "zv", "zvd" or "ei" (`shaping.settling_move`).
    rise : float, optional
        Time of a step without `settle`, a minimum-jerk move, s; by default a tenth of `hold`.
    hold : float
        Time from the beginning of a step to the beginning of the next, s. Steps begin on a tick.
    velocity_limit, acceleration_limit : float
        Largest values that are allowed in a step with `settle`, um/s and um/s^2.
    duration, sample_rate : float
        s, Hz.
    offset : float
        Where the first step begins, um.
    ramp : float
        Time of the move from 0 um to there, s; the first step begins one `hold` later.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> from truestroke import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
    >>> wave = step(settle=stage, hold=0.01, ramp=0.0, duration=0.03, sample_rate=10000.0)
    >>> wave.position[[0, 100, 110, 120, 200, 220]].round(3).tolist(), round(1000 * wave.settings["rise"], 2)
    ([0.0, 0.0, 2.554, 5.0, 5.0, 0.0], 2.0)
    """
    time = _ticks(duration, sample_rate, ramp)
    height = checks.positive("peak_to_peak", peak_to_peak, "um")
    start = checks.number("offset", offset, "um")
    fastest = _limit("velocity_limit", velocity_limit, "um/s")
    hardest = _limit("acceleration_limit", acceleration_limit, "um/s^2")
    period = max(1, round(checks.within("hold", hold, 2 / sample_rate, duration, "s") * sample_rate))
    if settle is None:
        move = shaping.minimum_jerk(hold / 10 if rise is None else checks.positive("rise", rise, "s"))
    elif rise is not None:
        raise SettingError("rise", rise, "left out with `settle`, which chooses it", "s")
    else:
        move = shaping.settling_move(settle, shape, velocity=fastest / height, acceleration=hardest / height)
    if move.duration > period / sample_rate:
        raise SettingError("hold", hold, f"at least {move.duration:.4g} s, the time of a step", "s")
    first = math.ceil(ramp * sample_rate) + period
    number, since = np.divmod(np.arange(time.size) - first, period)
    up, rest = np.mod(number, 2) == 0, number < 0
    s, rate, change = move.at(np.where(rest, 0, since) / sample_rate)
    sign = np.where(up, height, -height)
    motion = start + height * np.where(up | rest, s, 1 - s), sign * rate, sign * change
    settings: dict[str, object] = {"peak_to_peak": height, "rise": move.duration, "hold": hold, "offset": start}
    if settle is not None:
        limits = {"velocity_limit": fastest, "acceleration_limit": hardest}
        settings |= {"shape": shape, "resonance": settle.modes[0].frequency}
        settings |= {name: limit if math.isfinite(limit) else None for name, limit in limits.items()}
    settings["ramp"] = ramp
    return _made("step", sample_rate, ramped(time, motion, ramp), settings)


def _limit(name: str, value: float, unit: str) -> float:
    return value if value == math.inf else checks.positive(name, value, unit)


def staircase(
    *,
    steps: int = 5,
    hold: float = 0.2,
    velocity_limit: float = 300.0,
    peak_to_peak: float = 28.6,
    duration: float = 20.0,
    sample_rate: float = 2000.0,
) -> Trajectory:
    """Up from 0 um in equal steps, down again, and so on; each step is a minimum-jerk move, then a hold.

    A move of d um in T seconds has the peak speed 15/8 d / T, hence T = 15/8 d / velocity_limit.

    Parameters
    ----------
    steps : int
        Steps from the bottom to the top, 1 to 1000.
    hold : float
        Time at each level, s.
    velocity_limit : float
        Peak speed of a move, um/s.
    peak_to_peak, duration, sample_rate : float
        um, s, Hz.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> wave = staircase(steps=2, peak_to_peak=20.0, hold=0.1, velocity_limit=200.0, duration=1.0)
    >>> wave.position[::350].round(4).tolist(), round(wave.peak_speed, 1)  # a step takes 94 + 100 ms
    ([0.0, 10.0, 20.0, 10.0, 0.0, 10.0], 200.0)
    """
    time = _ticks(duration, sample_rate)
    steps = checks.count("steps", steps, 1, 1000)
    height = checks.positive("peak_to_peak", peak_to_peak, "um") / steps
    move = 15 / 8 * height / checks.positive("velocity_limit", velocity_limit, "um/s")
    period = move + checks.within("hold", hold, 0.0, duration, "s")
    number = np.floor(time / period)
    u = (time - number * period) / move
    (s, slope), curvature = smoothstep(u), smoothstep_curvature(u)
    step = np.mod(number, 2 * steps)
    up = step < steps
    position = height * np.where(up, step + s, 2 * steps - step - s)
    velocity = height / move * np.where(up, slope, -slope)
    acceleration = height / move**2 * np.where(up, curvature, -curvature)
    settings = {"steps": steps, "hold": hold, "velocity_limit": velocity_limit, "peak_to_peak": peak_to_peak}
    return _made("staircase", sample_rate, (position, velocity, acceleration), settings)


def below_nyquist(argument: str, frequency: object, sample_rate: float) -> float:
    """A frequency above 0 and below half of the sample rate, Hz."""
    result = checks.positive(argument, frequency, "Hz")
    if result >= sample_rate / 2:
        raise SettingError(argument, frequency, f"below half of the sample rate, {sample_rate / 2:g} Hz", "Hz")
    return result


# ---- The paper's random waves --------------------------------------------------------------------------------------


def random_wave(
    *,
    cutoff: float = 20.0,
    peak_to_peak: float = 28.6,
    duration: float = 20.0,
    sample_rate: float = 2000.0,
    seed: int = 0,
    low: float = 0.7,
    velocity_limit: float | None = None,
    ramp: float = 0.25,
) -> Trajectory:
    """The paper's wave (Sec. 5.3): uniform random numbers through a low pass.

    Each number is held for one tick and passes an analogue Butterworth filter of the fourth order. Its response to
    such steps is known in closed form, so position, velocity and acceleration are exact samples of one smooth motion.
    The ramp leads from 0 um to the middle of the wave; there the wave begins, and runs from `low` to
    `low + peak_to_peak`.

    Parameters
    ----------
    cutoff : float
        Frequency at which the filter has fallen by 3 dB, Hz, at most a tenth of the sample rate.
    peak_to_peak : float
        After the ramp, um.
    duration, sample_rate : float
        s, Hz.
    seed : int
        Of the random numbers; the same seed gives the same bits.
    low : float
        Lowest position after the ramp, um.
    velocity_limit : float, optional
        Peak speed that is allowed, um/s. It lowers the cut-off, not the stroke; `settings["cutoff"]` is the one
        in use. The paper asks for 300 um/s in Sec. 4.3; 20 Hz alone gives about 1300 um/s.
    ramp : float
        Time from 0 um to the middle, s, at most half of the duration.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> wave = random_wave(seed=1)
    >>> after = wave.position[wave.time >= 0.25]
    >>> [round(float(z), 4) for z in (after.min(), after.max())], round(wave.peak_speed)
    ([0.7, 29.3], 1299)
    >>> slow = random_wave(seed=1, velocity_limit=300.0)
    >>> slow.peak_speed <= 300.0, round(slow.settings["cutoff"], 2)
    (True, 4.62)
    """
    time = _ticks(duration, sample_rate, ramp)
    checks.within("sample_rate", sample_rate, 10 / duration, math.inf, "Hz")  # below it no cut-off is allowed
    cutoff = checks.within("cutoff", cutoff, 1 / duration, sample_rate / 10, "Hz")
    span = checks.within("peak_to_peak", checks.positive("peak_to_peak", peak_to_peak, "um"), 0.0, FARTHEST, "um")
    low = checks.within("low", low, -FARTHEST, FARTHEST, "um")
    seed = checks.count("seed", seed, 0, 2**63 - 1)
    numbers = np.random.Generator(np.random.PCG64(seed)).uniform(-1.0, 1.0, time.size)
    numbers[time < ramp] = 0.0  # a wave that begins earlier could exceed its bounds during the ramp
    limit = math.inf if velocity_limit is None else checks.positive("velocity_limit", velocity_limit, "um/s")
    used = cutoff
    while True:
        motion = _placed(time, _butterworth(numbers, used, sample_rate), low, span, ramp)
        position, velocity, _ = motion
        rise = 15 / 8 * abs(position[np.searchsorted(time, ramp)]) / ramp if ramp else 0.0
        if rise > limit:
            raise SettingError("ramp", ramp, f"longer: at the velocity limit it takes {ramp * rise / limit:.4g} s", "s")
        peak = float(np.max(np.abs(velocity)))
        if peak <= limit:
            break
        used *= min(limit / peak, 0.999)  # speed is nearly proportional to the cut-off: a few rounds
        if used < 1 / duration:
            raise SettingError("velocity_limit", limit, "higher: the wave would be slower than its duration", "um/s")
    settings: dict[str, object] = {"cutoff": used, "cutoff_asked": cutoff, "peak_to_peak": span, "seed": seed}
    settings |= {"low": low, "velocity_limit": velocity_limit, "ramp": ramp}
    return _made("random wave", sample_rate, motion, settings)


def _butterworth(numbers: FloatArray, cutoff: float, sample_rate: float) -> Motion:
    """Output of the analogue filter of order 4 and two derivatives, from rest, with each number held for a tick.

    In partial fractions H(s) = sum of r_i / (s - p_i), so each state obeys xdot_i = p_i x_i + u, exactly
    x_i <- exp(p_i T) x_i + (exp(p_i T) - 1) / p_i u. Then z = sum r_i x_i, zdot = sum r_i p_i x_i and
    zddot = sum r_i p_i^2 x_i, since the sums of r_i and of r_i p_i are 0 (relative degree 4). The poles come in
    conjugate pairs: twice the real part of one of each.
    """
    poles = 2 * math.pi * cutoff * np.exp(1j * math.pi * (2 * np.arange(4) + 5) / 8)
    z, zdot, zddot = np.zeros_like(numbers), np.zeros_like(numbers), np.zeros_like(numbers)
    for i in (0, 1):
        pole, others = complex(poles[i]), np.delete(poles, i)
        residue = complex(np.prod(-poles) / np.prod(pole - others))
        decay, state = complex(np.exp(pole / sample_rate)), np.zeros(BLOCK + 1, np.complex128)
        for start in range(0, numbers.size, BLOCK):
            block = slice(start, start + BLOCK)
            inputs = numbers[block] * (decay - 1) / pole
            _loops.first_order(decay.real, decay.imag, _pairs(inputs), _pairs(state[: inputs.size + 1]))
            x = state[: inputs.size]
            z[block] += 2 * (residue * x).real
            zdot[block] += 2 * (residue * pole * x).real
            zddot[block] += 2 * (residue * pole**2 * x).real
            state[0] = state[inputs.size]
    return z, zdot, zddot


def _pairs(z: npt.NDArray[np.complexfloating[Any, Any]]) -> FloatArray:
    """The same memory as real and imaginary parts, shape (ticks, 2)."""
    return z.view(np.float64).reshape(-1, 2)


def _placed(time: FloatArray, motion: Motion, low: float, span: float, ramp: float) -> Motion:
    """Scaled and shifted so that the part after the ramp runs from low to low + span; then ramped."""
    z, zdot, zddot = motion
    after = z[np.searchsorted(time, ramp) :]
    scale = span / np.ptp(after)
    position = z - after.min()
    position *= scale
    position += low
    return ramped(time, (position, scale * zdot, scale * zddot), ramp)


# ---- From a file, and as it comes ----------------------------------------------------------------------------------


def from_csv(
    path: str | Path,
    *,
    position: str | int | None = None,
    time: str | int | None = None,
    velocity: str | int | None = None,
    acceleration: str | int | None = None,
    unit: str | None = None,
    sample_rate: float | None = None,
    ramp: float = 0.25,
) -> Trajectory:
    r"""A motion from a file with columns: text, NPZ, MATLAB, Parquet, HDF5, as `read_record` reads them.

    Parameters
    ----------
    path : str or Path
        The file; its ending determines the format.
    position, time, velocity, acceleration : str or int, optional
        Columns, by name or counted from 1. Left out, position is the column "z", "desired", "position" or
        "displacement", or the only one; time is "t" or "time". Without names, two columns are time and position.
        Without a velocity it is the derivative of a cubic spline through the positions (not causal: it looks ahead, as
        a file allows). Without an acceleration it is estimated by central differences of the velocity, and
        `settings["acceleration"]` says so.
    unit : str, optional
        Of the position, um, nm, mm or m; of the velocity, that per second; of the acceleration, that per s^2. Left out,
        what the heading states, as "z (nm)", else um. Times are in the unit that their heading states, else s.
    sample_rate : float, optional
        Hz; needed where there is no time column, and equal to that of the times where there is one.
    ramp : float
        Time in which the motion builds up from 0 um, s; 0 takes the file as it is.

    Raises
    ------
    SettingError
        Names the argument, its value and the bound, such as of a motion that goes too far.
    RecordError
        Names the file, the row and the reason: not a number, times that are not even, a column that is not found.
    FileNotFoundError
        There is no such file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "move.csv")
    ...     _ = path.write_text("t (s),z (nm)\n" + "".join(f"{k / 1000},{k * k}\n" for k in range(5)))
    ...     move = from_csv(path, ramp=0.0)
    ...     same = from_csv(path, position=2, time=1, ramp=0.0)
    >>> move.sample_rate, move.position.round(4).tolist()
    (1000.0, [0.0, 0.001, 0.004, 0.009, 0.016])
    >>> move.velocity[1:].round(4).tolist(), bool(np.all(same.position == move.position))
    ([2.0, 4.0, 6.0, 8.0], True)
    """
    with checks.inside("", {"position_unit": "unit"}):
        wanted = [
            Wanted("position", UNITS["displacement"], HEADINGS["position"], position, unit, certain=True),
            Wanted("time", UNITS["time"], HEADINGS["time"], time, certain=True),
        ]
    for role, key, of in (("velocity", velocity, "um/s"), ("acceleration", acceleration, "um/s^2")):
        if key is not None:
            wanted.append(Wanted(role, {of: 1.0}, key=key, unit=of))
    return _of_columns(path, wanted, sample_rate, ramp)


def from_headings(path: str | Path, *, sample_rate: float | None = None, ramp: float = 0.25) -> Trajectory:
    r"""A motion from a file whose columns nobody names, as of a command: an error says how to head them.

    Arguments, result and errors as of `from_csv`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "move.csv")
    ...     _ = path.write_text("z (nm)\n" + "".join(f"{k * k}\n" for k in range(5)))
    ...     move = from_headings(path, sample_rate=1000.0, ramp=0.0)
    >>> move.position.round(4).tolist()
    [0.0, 0.001, 0.004, 0.009, 0.016]
    """
    wanted = [
        Wanted("position", UNITS["displacement"], HEADINGS["position"], certain=True, heading="z (um)"),
        Wanted("time", UNITS["time"], HEADINGS["time"], certain=True, heading="t (s)"),
    ]
    return _of_columns(path, wanted, sample_rate, ramp)


def _of_columns(path: str | Path, wanted: Sequence[Wanted], sample_rate: float | None, ramp: float) -> Trajectory:
    """The motion of a file, from the columns that are wanted, position and time first."""
    path = checks.path("path", path)
    position, time, *derivatives = wanted
    time = replace(time, needed=sample_rate is None, instead="the `sample_rate`")
    table = open_table(path, narrowest=1)
    places = {1: ("position",), 2: ("time", "position")}.get(table.width, ())
    signals, columns = read_columns(path, table, [position, time, *derivatives], places)
    refuse_bad_rows(str(path), signals, table)
    z = signals["position"]
    if z.size < 4:
        raise RecordError(str(path), f"{z.size} rows; at least 4 are needed")
    farthest = int(np.argmax(np.abs(z)))
    row = f"{path}, {table.where} {table.locate(farthest)[0]}"
    checks.within(row, z[farthest], -FARTHEST, FARTHEST, "um")
    rate = even_rate(path, table, signals.get("time"), sample_rate)
    seconds = np.arange(z.size) / rate
    factor = UNITS["displacement"][columns["position"].unit]
    if "velocity" in signals:
        zdot = factor * signals["velocity"]
    else:
        from scipy.interpolate import CubicSpline

        zdot = CubicSpline(seconds, z)(seconds, 1)
    given = "acceleration" in signals
    zddot = factor * signals["acceleration"] if given else differences(zdot, rate)
    checks.within("ramp", ramp, 0.0, z.size / rate / 2, "s")
    keys = {"velocity": None, "acceleration": ESTIMATED} | {w.role: w.key for w in wanted}
    settings: dict[str, object] = {"path": str(path), **keys, "unit": position.unit, "ramp": ramp}
    return _made("file", rate, ramped(seconds, (z, zdot, zddot), ramp), settings)


class VelocityEstimator:
    """Velocity of a motion that arrives sample by sample: the backward difference of second order.

        zdot(k) = (3 z(k) - 4 z(k-1) + z(k-2)) / (2 T)

    It is exact for quadratics; else its error is -T^2 z''' / 3 to the leading order (a sine of f Hz: (2 pi f T)^2 / 3
    of its peak velocity, 0.05 % at 12 Hz and 2 kHz). White noise of sd sigma on z gives sqrt(26) / (2 T) sigma, 5.1
    um/s per nm at 2 kHz. The first sample gives 0 (at rest), the second the plain difference.

    Parameters
    ----------
    sample_rate : float
        1 / T, Hz.

    Examples
    --------
    >>> estimator = VelocityEstimator(sample_rate=1000.0)
    >>> [round(estimator.update(0.001 * k * k), 4) for k in range(5)]
    [0.0, 1.0, 4.0, 6.0, 8.0]
    """

    def __init__(self, sample_rate: float) -> None:
        self.sample_rate = checks.positive("sample_rate", sample_rate, "Hz")
        self.reset()

    def reset(self) -> None:
        """Discard all samples."""
        self._last: float | None = None  # z(k-1)
        self._step: float | None = None  # z(k-1) - z(k-2)

    def update(self, z_d: float) -> float:
        """Velocity, um/s, at the sample z_d, um, that has just arrived.

        Raises
        ------
        SettingError
            z_d is not a finite number; nothing has changed.
        """
        z_d = checks.number("z_d", z_d, "um")
        step = 0.0 if self._last is None else z_d - self._last
        before = step if self._step is None else self._step
        self._step = None if self._last is None else step
        self._last = z_d
        return (1.5 * step - 0.5 * before) * self.sample_rate
