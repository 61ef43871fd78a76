"""Scans: raster, spiral of constant angular or linear velocity, Lissajous curve, cycloid."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, system
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model.dynamics import EXPECTED, Dynamics
from truestroke.signals import shaping, trajectories
from truestroke.signals.scans.scan import Scan, table
from truestroke.signals.shaping import Motion, Move
from truestroke.signals.trajectories import Trajectory

MOST = 10**8  # ticks of a scan, whatever the memory
NEEDED = 750.0  # bytes of memory for a tick: motion, recording, images, page; 500 on hardware, more if simulated
NEWTON = 6  # iterations for the angle of a spiral: to the last bits
LEAD_IN = 0.5  # s before the image, by default
LEAD_OUT = 0.02  # s behind the image, in which all goes on as before: the end is not in the last line


def raster(
    *,
    width: float = 20.0,
    height: float | None = None,
    lines: int = 512,
    rate: float = 4.0,
    turn: float | Dynamics = 0.2,
    over_scan: float = 0.0,
    settle: Dynamics | None = None,
    slow: str = "steps",
    lead_in: int | None = None,
    lead_rows: int = 0,
    ramp: float = 0.25,
    lead_out: float = 0.0,
    offset: tuple[float, float] | None = None,
    sample_rate: float = 10_000.0,
) -> Scan:
    """Lines of constant speed along x, to and fro, one row after the other along y.

    Parameters
    ----------
    width, height : float
        Of the image, um; by default it is a square.
    lines : int
        Rows; each is passed twice, in trace and retrace.
    rate : float
        Rows per second, Hz.
    turn : float or Dynamics
        As of `trajectories.raster`: share of the period that both turns take, or dynamics of the x axis, which choose
        turns that leave no vibration.
    over_scan : float
        Part of the width by which the lines of constant speed are longer than the image, at each side, 0 to 1.
    settle : Dynamics, optional
        Of the y axis: its steps leave no vibration. By default a step is a minimum-jerk move as long as the time
        between two lines.
    slow : str
        "steps": y rests on each row, and steps in the turn behind the retrace, so that trace and retrace pass over the
        same row. "ramp": y moves at constant speed.
    lead_in : int, optional
        Periods of x before the image; by default as many as take half a second, the ramp and `lead_rows`.
    lead_rows : int
        Rows below the image over which y moves in the last of these periods, so that what a controller learns of its
        motion is learned before the image; by default y waits on the first row.
    ramp : float
        Time in which the motion builds up from 0 um, s.
    lead_out : float
        Time for which the motion goes on behind the image, s, as where hardware measures with latency; y moves on, too.
    offset : tuple[float, float], optional
        Centre of the image, um; by default such that x and y do not go below 0 um.
    sample_rate : float
        Hz.

    Returns
    -------
    Scan

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit, such as a rate at which the stage cannot turn.

    Examples
    --------
    >>> scan = raster(width=10.0, lines=64, rate=40.0, over_scan=0.05, sample_rate=10_000.0)
    >>> trace = scan.lines[0]
    >>> ends = scan.x.position[trace["first"]] - scan.origin[0], scan.x.position[trace["last"]] - scan.origin[0]
    >>> [round(float(x), 1) for x in ends], round(1000 * float(trace["end"] - trace["start"]), 2)
    ([0.0, 9.9], 9.09)
    """
    width = checks.positive("width", width, "um")
    height = width if height is None else checks.positive("height", height, "um")
    lines = checks.count("lines", lines, 1, 10**6)
    rate, sample_rate = checks.positive("rate", rate, "Hz"), checks.positive("sample_rate", sample_rate, "Hz")
    over = checks.within("over_scan", over_scan, 0.0, 1.0, "of the width")
    ramp = checks.within("ramp", ramp, 0.0, 3600.0, "s")
    early = checks.count("lead_rows", lead_rows, 0, 10**6)
    least = math.ceil((ramp + (LEAD_IN if lead_in is None else 0.0)) * rate) + early
    lead = least if lead_in is None else _lead(lead_in, least, rate, ramp, early)
    duration = _lasting((lead + lines) / rate, sample_rate, lead_out)
    usual = {"frequency": rate, "turn": turn, "sample_rate": sample_rate, "ramp": ramp}
    with checks.inside("", {"frequency": "rate"}):
        unit = trajectories.raster(peak_to_peak=1.0, duration=2 * ramp + 2 / rate, **usual)  # type: ignore[arg-type]
    span = width * (1 + 2 * over) / float(unit.settings["line"])  # type: ignore[arg-type]
    centre = (span / 2, height * (0.5 + early / lines)) if offset is None else _pair("offset", offset)
    x = trajectories.raster(peak_to_peak=span, offset=centre[0], duration=duration, **usual)  # type: ignore[arg-type]
    tau = float(x.settings["turn_time"])  # type: ignore[arg-type]
    line = 0.5 / rate - tau
    margin = line * over / (1 + 2 * over)
    first = (lead + np.arange(lines)) / rate + margin
    starts = np.column_stack([first, first + line + tau]).ravel()
    rows = np.repeat(np.arange(lines), 2)
    made = table(starts, starts + line - 2 * margin, rows, np.tile([1, -1], lines), sample_rate)
    on = _Rows(lead / rate, rate, early, lines + math.ceil(lead_out * rate), tau, margin)
    pitch = height / lines
    course = on.even if checks.one_of("slow", slow, ("steps", "ramp")) == "ramp" else on.steps(settle)

    def passed(ticks: slice) -> Motion:
        place, speed, change = course(np.arange(ticks.start, ticks.stop) / sample_rate)
        return centre[1] - height / 2 + pitch * (place + 0.5), pitch * speed, pitch * change

    settings: dict[str, object] = {"rate": rate, "period": 1 / rate, "rows": lines, "lead_in": lead, "slow": slow}
    settings |= {"over_scan": over, "turn": x.settings["turn"], "turn_time": tau, "line_time": line - 2 * margin}
    origin = (centre[0] - width / 2, centre[1] - height / 2)
    y = trajectories.by_parts(passed, len(x))
    slow_axis = _axis(slow, sample_rate, trajectories.ramped(x.time, y, ramp), settings)
    return Scan("raster", x, slow_axis, origin, (width, height), made, settings)


@dataclass(frozen=True)
class _Rows:
    """When the slow axis of a raster is where: row 0 begins at `begin`, s, and `early` rows are passed before it.

    `rows` are those of the image and what is passed behind it.

    Between two lines are a `turn` of the fast axis and the over-scan at its ends, a `margin` each, s.
    """

    begin: float
    rate: float
    early: int
    rows: int
    turn: float
    margin: float

    def even(self, time: FloatArray) -> Motion:
        """At constant speed, after a period in which it accelerates; in rows, each passed at its middle."""
        u = (time - self.begin) * self.rate + 1 + self.early
        speed, change = trajectories.smoothstep(u)
        return _integral(u) - 1.0 - self.early, self.rate * speed, self.rate**2 * change

    def steps(self, settle: Dynamics | None) -> Callable[[FloatArray], Motion]:
        """From row to row between two lines, in rows: a function of the time, s."""
        move = self._move(settle)

        def at(time: FloatArray) -> Motion:
            number = np.floor((time - self.begin - self.margin) * self.rate)  # of the row, from its trace on
            since = time - self.begin - (number + 1) / self.rate + self.turn + self.margin
            stepping = (number >= -self.early) & (number < self.rows - 1)
            s, velocity, acceleration = (np.where(stepping, one, 0.0) for one in move.at(np.maximum(since, 0.0)))
            return np.clip(number, -self.early, self.rows - 1) + s, velocity, acceleration

        return at

    def _move(self, settle: Dynamics | None) -> Move:
        """A step, which has the time between two lines."""
        pause = self.turn + 2 * self.margin
        if settle is None:
            return shaping.minimum_jerk(pause)
        move = shaping.settling_move(checks.instance("settle", settle, Dynamics, EXPECTED))
        if move.duration > pause * 1.0001:
            bound = f"dynamics whose steps take at most {1000 * pause:.3g} ms, the time between two lines, not"
            bound += f" {1000 * move.duration:.3g} ms: give longer turns (`turn`), more over_scan, or slow='ramp'"
            raise SettingError("settle", settle, bound)
        return move


def _integral(u: FloatArray) -> FloatArray:
    """Integral of `trajectories.smoothstep` from 0 on: u - 1/2 from u = 1 on."""
    inside = np.clip(u, 0.0, 1.0)
    return np.asarray(inside**4 * (2.5 + inside * (inside - 3.0)) + np.maximum(u - 1.0, 0.0))


def spiral(
    *,
    diameter: float = 20.0,
    pitch: float | None = None,
    turns: int | None = None,
    rotation: float = 10.0,
    velocity: str = "angular",
    fastest: float | None = None,
    lead_in: float = LEAD_IN,
    ramp: float = 0.25,
    lead_out: float = 0.0,
    offset: tuple[float, float] | None = None,
    sample_rate: float = 10_000.0,
) -> Scan:
    """An Archimedean spiral from its centre outwards, r = pitch phi / (2 pi), of constant angular or linear velocity.

    ::

        angular   phi = 2 pi rotation t
        linear    phi' sqrt(r^2 + (pitch / 2 pi)^2) = v, v = that of the last turn of `rotation` turns per second

    At constant linear velocity `rotation` is that of the outermost turn. The middle would turn very fast: `fastest`
    limits it.

    Parameters
    ----------
    diameter : float
        um.
    pitch, turns : float, int
        One of the two: distance of the turns, um, or their number, diameter / (2 pitch); by default 256 turns.
    rotation : float
        Turns per second, Hz.
    velocity : str
        What is constant: "angular" or "linear".
    fastest : float, optional
        Turns per second at most, at constant linear velocity, Hz; by default twice `rotation`.
    lead_in : float
        Time before the spiral begins, s: the ramp to its centre, and rest there.
    ramp, lead_out, offset, sample_rate
        As in `raster`.

    Returns
    -------
    Scan
        Its lines are the turns.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> scan = spiral(diameter=10.0, turns=50, rotation=100.0)
    >>> radius = np.hypot(scan.x.position - 5.0, scan.y.position - 5.0)
    >>> round(float(radius[-1]), 3), len(scan.lines), round(1000 * float(scan.lines["end"][0] - scan.lines["start"][0]))
    (4.999, 50, 10)
    >>> slow = spiral(diameter=10.0, turns=50, rotation=100.0, velocity="linear")
    >>> late = slow.time > 0.65
    >>> speed = np.hypot(slow.x.velocity[late], slow.y.velocity[late])
    >>> round(float(speed.min())), round(float(speed.max()))
    (3142, 3142)
    """
    diameter = checks.positive("diameter", diameter, "um")
    if pitch is not None and turns is not None:
        raise SettingError("turns", turns, "left out with `pitch`, which sets their number")
    number = 256 if turns is None else checks.count("turns", turns, 1, 10**6)
    if pitch is not None:
        if checks.positive("pitch", pitch, "um") > diameter / 2:
            raise SettingError("pitch", pitch, f"at most half of the diameter, {diameter / 2:g} um", "um")
        number = checks.count("pitch: turns", math.ceil(diameter / 2 / pitch), 1, 10**6)
    step = diameter / 2 / number
    sample_rate = checks.positive("sample_rate", sample_rate, "Hz")
    rotation = trajectories.below_nyquist("rotation", rotation, sample_rate)
    linear = checks.one_of("velocity", velocity, ("angular", "linear")) == "linear"
    ramp = checks.within("ramp", ramp, 0.0, 3600.0, "s")
    lead = checks.within("lead_in", lead_in, ramp, 3600.0, "s")
    if fastest is not None and not linear:
        raise SettingError("fastest", fastest, "left out at constant angular velocity, where all turns are alike", "Hz")
    limit = 2 * rotation if fastest is None else checks.within("fastest", fastest, rotation, sample_rate / 2, "Hz")
    course = _Linear(number, rotation, limit) if linear else _Angular(number, rotation)
    time = np.arange(round(_lasting(lead + course.duration, sample_rate, lead_out) * sample_rate)) / sample_rate
    phi, rate, change = course.at(np.maximum(time - lead, 0.0))
    begun = time >= lead
    rate, change = np.where(begun, rate, 0.0), np.where(begun, change, 0.0)
    b, turned = step / (2 * math.pi), np.exp(1j * phi)
    z = b * phi * turned
    zdot = b * rate * (1 + 1j * phi) * turned
    zddot = b * (change * (1 + 1j * phi) + rate**2 * (2j - phi)) * turned
    centre = (diameter / 2, diameter / 2) if offset is None else _pair("offset", offset)
    settings: dict[str, object] = {"rotation": rotation, "velocity": velocity, "pitch": step, "turns": number}
    settings |= {"lead_in": lead} | ({"fastest": course.fastest} if isinstance(course, _Linear) else {})
    x, y = (
        _axis("spiral", sample_rate, trajectories.ramped(time, (c + part(z), part(zdot), part(zddot)), ramp), settings)
        for c, part in zip(centre, (np.real, np.imag), strict=True)
    )
    edges = lead + course.times(np.linspace(0.0, 2 * math.pi * number, number + 1))
    made = table(edges[:-1], edges[1:], np.arange(number), np.ones(number), sample_rate)
    origin = (centre[0] - diameter / 2, centre[1] - diameter / 2)
    return Scan("spiral", x, y, origin, (diameter, diameter), made, settings)


class _Angular:
    """Angle of a spiral of constant angular velocity."""

    def __init__(self, turns: int, rotation: float) -> None:
        self.omega, self.duration = 2 * math.pi * rotation, turns / rotation

    def at(self, time: FloatArray) -> Motion:
        return self.omega * time, np.full_like(time, self.omega), np.zeros_like(time)

    def times(self, phi: FloatArray) -> FloatArray:
        return np.asarray(phi / self.omega)


class _Linear:
    """Angle of a spiral of constant linear velocity: its arc grows evenly, from where the angular velocity permits."""

    def __init__(self, turns: int, rotation: float, fastest: float) -> None:
        end = 2 * math.pi * turns
        self.omega = 2 * math.pi * fastest
        self.speed = 2 * math.pi * rotation * math.hypot(1.0, end)  # of arcs in units of pitch / (2 pi)
        self.fastest = min(fastest, self.speed / (2 * math.pi))  # turns per second, Hz: those in the middle
        self.angle = min(math.sqrt((self.speed / self.omega) ** 2 - 1), end) if self.speed > self.omega else 0.0
        self.begin = self.angle / self.omega
        self.duration = self.begin + float(_arc(np.array(end)) - _arc(np.array(self.angle))) / self.speed

    def at(self, time: FloatArray) -> Motion:
        inner = time < self.begin
        arc = _arc(np.array(self.angle)) + self.speed * np.maximum(time - self.begin, 0.0)
        phi = np.sqrt(2 * np.maximum(arc, 0.0))
        for _ in range(NEWTON):
            phi = phi - (_arc(phi) - arc) / np.sqrt(1 + phi**2)
        rate = self.speed / np.sqrt(1 + phi**2)
        change = -(self.speed**2) * phi / (1 + phi**2) ** 2
        outer = phi, rate, change
        middle = self.omega * time, np.full_like(time, self.omega), np.zeros_like(time)
        return tuple(np.where(inner, a, b) for a, b in zip(middle, outer, strict=True))  # type: ignore[return-value]

    def times(self, phi: FloatArray) -> FloatArray:
        outer = self.begin + (_arc(phi) - _arc(np.array(self.angle))) / self.speed
        return np.where(phi < self.angle, phi / self.omega, outer)


def _arc(phi: FloatArray) -> FloatArray:
    """Length of the spiral r = phi up to an angle."""
    return np.asarray((phi * np.sqrt(1 + phi**2) + np.arcsinh(phi)) / 2)


def lissajous(
    *,
    width: float = 20.0,
    height: float | None = None,
    rate: float = 40.0,
    lobes: int = 512,
    frames: int = 1,
    ramp: float = 0.25,
    lead_out: float = 0.0,
    offset: tuple[float, float] | None = None,
    sample_rate: float = 10_000.0,
) -> Scan:
    """Two sines, x of `rate` and y of rate (lobes - 1) / lobes: a pattern that repeats after lobes / rate seconds.

    The pattern is densest at the edges; in the middle its lines are pi width / (2 lobes) apart.

    Parameters
    ----------
    width, height : float
        um; by default it is a square.
    rate : float
        Periods of x per second, Hz.
    lobes : int
        Periods of x in a pattern, from 2 on.
    frames : int
        Patterns, one after the other.
    ramp, lead_out, offset, sample_rate
        As in `raster`; the first pattern begins at the first period of x behind the ramp.

    Returns
    -------
    Scan
        Its lines are the sweeps of x.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> scan = lissajous(width=10.0, rate=40.0, lobes=20)
    >>> len(scan.lines), scan.lines["direction"][:3].tolist(), round(scan.settings["frame_time"], 3)
    (40, [-1, 1, -1], 0.5)
    """
    width = checks.positive("width", width, "um")
    height = width if height is None else checks.positive("height", height, "um")
    lobes, frames = checks.count("lobes", lobes, 2, 10**6), checks.count("frames", frames, 1, 10**6)
    rate, sample_rate, ramp = _fast(rate, sample_rate, ramp)
    lead = math.ceil(ramp * rate) / rate
    end = lead + frames * lobes / rate + 0.25 / rate
    duration = _lasting(end, sample_rate, lead_out)
    centre = (width / 2, height / 2) if offset is None else _pair("offset", offset)
    slow = rate * (lobes - 1) / lobes
    usual = {"duration": duration, "sample_rate": sample_rate, "ramp": ramp}
    x = trajectories.sine(frequency=rate, peak_to_peak=width, offset=centre[0], **usual)
    y = trajectories.sine(frequency=slow, peak_to_peak=height, offset=centre[1], **usual)
    starts = lead + (np.arange(2.0 * frames * lobes) + 0.5) / (2 * rate)  # the crests of x
    settings = {"rate": rate, "period": 1 / rate, "slow_rate": slow, "frame_time": lobes / rate, "lobes": lobes}
    made = _sweeps(starts, rate, first=-1, sample_rate=sample_rate, duration=_lasting(end, sample_rate))
    origin = (centre[0] - width / 2, centre[1] - height / 2)
    return Scan("lissajous", x, y, origin, (width, height), made, settings)


def cycloid(
    *,
    width: float = 20.0,
    height: float = 20.0,
    pitch: float | None = None,
    rate: float = 40.0,
    ramp: float = 0.25,
    lead_out: float = 0.0,
    offset: tuple[float, float] | None = None,
    sample_rate: float = 10_000.0,
) -> Scan:
    """A circle that moves along y: x = r cos(2 pi rate t), y = r sin(2 pi rate t) + pitch rate t.

    Its circles have the diameter `width`; the image is `height` long, and begins where the first circle has passed.

    Parameters
    ----------
    width, height : float
        Of the image, um: the diameter of the circles, and the way of their centre.
    pitch : float, optional
        Way of the centre in a period, um; by default height / 256.
    rate : float
        Circles per second, Hz.
    ramp, lead_out, offset, sample_rate
        As in `raster`.

    Returns
    -------
    Scan
        Its lines are the sweeps of x; each place is passed in one of each direction.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> scan = cycloid(width=10.0, height=5.0, pitch=0.5, rate=40.0)
    >>> len(scan.lines), round(float(np.ptp(scan.y.position)), 2)
    (60, 27.13)
    """
    width, height = checks.positive("width", width, "um"), checks.positive("height", height, "um")
    step = height / 256 if pitch is None else checks.positive("pitch", pitch, "um")
    rate, sample_rate, ramp = _fast(rate, sample_rate, ramp)
    lead = max(math.ceil(2 * ramp * rate), 2) / rate
    periods = math.ceil((height + width) / step)
    duration = _lasting(lead + periods / rate, sample_rate, lead_out)
    time = np.arange(round(duration * sample_rate)) / sample_rate
    omega, radius = 2 * math.pi * rate, width / 2
    start = step * rate * lead / 4  # way of the centre until it has its speed, at `lead`
    centre = (radius, 2 * radius + start + height / 2) if offset is None else _pair("offset", offset)
    turned = radius * np.exp(1j * omega * time)
    begun = 2 * time / lead - 1
    way = _integral(begun) * lead / 2 - lead / 4
    speed, change = trajectories.smoothstep(begun)
    low = centre[1] - height / 2 - radius
    x = centre[0] + turned.real, -omega * turned.imag, -(omega**2) * turned.real
    y = (
        low + turned.imag + step * rate * way,
        omega * turned.real + step * rate * speed,
        -(omega**2) * turned.imag + step * rate * change / (lead / 2),
    )
    settings = {"rate": rate, "period": 1 / rate, "pitch": step}
    axes = [_axis("cycloid", sample_rate, trajectories.ramped(time, motion, ramp), settings) for motion in (x, y)]
    starts = lead + np.arange(2.0 * periods) / (2 * rate)
    made = _sweeps(starts, rate, first=-1, sample_rate=sample_rate, duration=duration)
    origin = (centre[0] - radius, centre[1] - height / 2)
    return Scan("cycloid", axes[0], axes[1], origin, (width, height), made, settings)


def _sweeps(
    starts: FloatArray, rate: float, *, first: int, sample_rate: float, duration: float
) -> npt.NDArray[np.void]:
    """Sweeps of half a period each, in directions that alternate; one that the motion cuts short is none."""
    starts = starts[starts + 0.5 / rate <= duration + 1e-9]
    number = np.arange(starts.size)
    direction = np.where(number % 2 == 0, first, -first)
    return table(starts, starts + 0.5 / rate, number // 2, direction, sample_rate)


def _fast(rate: float, sample_rate: float, ramp: float) -> tuple[float, float, float]:
    """The settings that all curves share, checked."""
    sample_rate = checks.positive("sample_rate", sample_rate, "Hz")
    rate = checks.positive("rate", rate, "Hz")
    if rate >= sample_rate / 4:
        raise SettingError("rate", rate, f"below a quarter of the sample rate, {sample_rate / 4:g} Hz", "Hz")
    return rate, sample_rate, checks.within("ramp", ramp, 0.0, 3600.0, "s")


def _lasting(duration: float, sample_rate: float, lead_out: float = 0.0) -> float:
    """A duration of whole ticks that memory can hold, s, with what comes behind it."""
    duration += checks.within("lead_out", lead_out, 0.0, 3600.0, "s")
    ticks = max(2, math.ceil(duration * sample_rate - 1e-6))
    free = min(system.free_memory(), MOST * NEEDED)
    if NEEDED * ticks > free:
        bound = (
            f"at most {free / NEEDED / sample_rate:.3g} s at {sample_rate:g} Hz, as a scan of {ticks:.3g} ticks and "
        )
        bound += f"its images take {NEEDED * ticks / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free: scan "
        bound += "faster, at a lower sample rate, or fewer lines or turns"
        raise SettingError("duration", float(f"{duration:.4g}"), bound, "s")
    return ticks / sample_rate


def _lead(lead_in: object, least: int, rate: float, ramp: float, early: int) -> int:
    """Rows before the image: at least those of the ramp and of what else comes before it."""
    rows = checks.count("lead_in", lead_in, 0, 10**6)
    if rows < least:
        what = f"the {ramp:g} s of the ramp" + (f" and {early} lead_rows" if early else "")
        bound = f"at least {least} at {rate:g} rows a second, for {what}: give as many, leave it out, or move slower"
        raise SettingError("lead_in", rows, bound, "rows")
    return rows


def _pair(name: str, value: tuple[float, float]) -> tuple[float, float]:
    given = checks.several(name, value, "um")
    if len(given) != 2:
        raise SettingError(name, value, "two numbers, x and y", "um")
    return checks.number(f"{name}[0]", given[0], "um"), checks.number(f"{name}[1]", given[1], "um")


def _axis(name: str, sample_rate: float, motion: Motion, settings: Mapping[str, object]) -> Trajectory:
    position, velocity, acceleration = motion
    return Trajectory(name, sample_rate, position, velocity, dict(settings), acceleration)
