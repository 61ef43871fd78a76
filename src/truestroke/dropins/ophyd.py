"""Flyable piezo axes of ophyd-async, for plans of bluesky (extra `ophyd`)."""

from __future__ import annotations

import asyncio
import itertools
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.dropins import flights, needed
from truestroke.dropins.axes import Axes, Trace

with needed("ophyd-async", "ophyd"):
    import bluesky.plan_stubs as bps
    import bluesky.preprocessors as bpp
    from ophyd_async.core import (
        DEFAULT_TIMEOUT,
        Array1D,
        FlyableLogic,
        MovableLogic,
        StandardFlyable,
        StandardMovable,
        StandardReadable,
        observe_value,
        soft_signal_r_and_setter,
        soft_signal_rw,
    )
    from ophyd_async.core import StandardReadableFormat as Format
    from ophyd_async.epics.core import epics_signal_r, epics_signal_rw

CHANNELS = {"desired": "um", "measured": "um", "volts": "V"}
ARRIVED = 1e-6  # um
TOGETHER = 0.2  # s: what the server publishes at once comes within it
PATIENCE = 20.0  # s for the server to publish a flight
UNITS = {"units": "um", "precision": 4}


@dataclass
class Flown:
    """The points of a flight that has ended: one mean of each channel a point, and when its middle was, s."""

    timestamps: FloatArray
    channels: dict[str, FloatArray]

    @classmethod
    def of(cls, trace: Trace, ticks: list[slice], began: float) -> Flown:
        """From a motion that began at a time, s since 1970, and the ticks of each point, up to a stop."""
        rate = 1 / (trace.time[1] - trace.time[0])
        ticks = ticks if trace.stopped is None else [k for k in ticks if k.stop <= trace.stopped]
        middles = np.array([0.5 * (k.start + k.stop) for k in ticks]) / rate
        rows = {name: getattr(trace, name) for name in CHANNELS}
        return cls(began + middles, {name: np.array([_mean(row[k]) for k in ticks]) for name, row in rows.items()})


def _mean(samples: FloatArray) -> float:
    there = samples[np.isfinite(samples)]
    return float(there.mean()) if there.size else float("nan")


@dataclass
class _Flight:
    """What is known of a flight from `prepare` to `complete`."""

    trajectory: Any
    ticks: list[slice]
    done: Any = None
    began: float = 0.0


@dataclass
class _Logic(MovableLogic[float], FlyableLogic[Any, _Flight]):  # type: ignore[misc]
    """Moves and flights of an axis in this process."""

    device: PiezoAxis = field(kw_only=True)

    async def stop(self) -> None:
        """Come to rest on the way, without ringing; returns when the axis rests."""
        device = self.device
        ending = device.axes.stop(device.axis) if device.opened else None
        if ending is not None:
            await asyncio.wait([asyncio.wrap_future(ending)])  # whose error is that of the move

    async def check_move(self, new_position: float) -> None:
        """Refuse a target beyond the stroke."""
        self.device.axes.check(self.device.axis, new_position)

    async def move(self, new_position: float, timeout: Any) -> None:
        """Go there from rest to rest."""
        await self.setpoint.set(new_position)
        await self._ended(self.device.axes.move(**{self.device.axis: new_position})[self.device.axis])

    async def on_prepare(self, value: Any) -> _Flight:
        """Move to the run-up of the first line."""
        device = self.device
        axes, axis = device.axes, device.axis
        scan = flights.of_spec(value, device, device.name)
        rate, speed, stage = axes.timing.sample_rate, axes.speed(axis), axes.stage(axis)
        trajectory, ticks = flights.flight(scan, rate, speed=speed, stage=stage)
        axes.check_motion(axis, trajectory)
        device.flown = None
        await self.move(float(trajectory.position[0]), None)
        return _Flight(trajectory, ticks)

    async def on_kickoff(self, ctx: _Flight) -> _Flight:
        """Begin to fly."""
        ctx.began = time.time()
        ctx.done = self.device.axes.follow(self.device.axis, ctx.trajectory)
        return ctx

    async def on_complete(self, ctx: _Flight) -> None:
        """Wait for the end of the last line."""
        trace = await self._ended(ctx.done)
        self.device.flown = Flown.of(trace, ctx.ticks, ctx.began)
        self.device.refuse_stopped(trace.stopped is not None)

    async def _ended(self, future: Any) -> Trace:
        trace: Trace = await asyncio.shield(asyncio.wrap_future(future))  # who waits no more does not end the motion
        self.device.show()
        return trace


class _Flyer(StandardReadable, StandardMovable[float], StandardFlyable[Any, Any]):  # type: ignore[misc]
    """What bluesky asks of any back end: points of a flight as events."""

    flown: Flown | None = None
    _fails = False  # whether what is stopped has failed

    async def stop(self, success: bool = False) -> None:
        """Bring the axis to rest on its way; the move or the flight has failed then, unless `success`."""
        self._fails = not success
        await super().stop(success)

    def refuse_stopped(self, stopped: bool) -> None:
        """RuntimeError, as of a move in ophyd-async, for a flight that was stopped and has failed by that."""
        if stopped and self._fails:
            raise RuntimeError(f"Device {self.name} was stopped.")

    async def describe_collect(self) -> dict[str, Any]:
        """Keys of a point: NAME-desired and NAME-measured, um, and NAME-volts, V."""
        return {
            f"{self.name}-{channel}": {"source": self.source, "dtype": "number", "shape": [], "units": unit}
            for channel, unit in CHANNELS.items()
        }

    def collect(self) -> Iterator[dict[str, Any]]:
        """One event a point of the flight that has ended."""
        flown, self.flown = self.flown, None
        if flown is None:
            return
        for k, at in enumerate(flown.timestamps.tolist()):
            data = {f"{self.name}-{channel}": float(row[k]) for channel, row in flown.channels.items()}
            yield {"data": data, "timestamps": dict.fromkeys(data, at), "time": at}

    @property
    def source(self) -> str:
        """Where the data come from."""
        raise NotImplementedError


class PiezoAxis(_Flyer):
    """An axis of a driver of truestroke, simulated or real, that bluesky moves and flies.

    `read` gives NAME (the sensor, or without one the place where the axis should be, um) and NAME-volts, V. `prepare`
    takes a scanspec, its `Path`, or a `FlyMotorInfo`; `kickoff`, `complete` and `collect` follow.

    Parameters
    ----------
    path : str or PathLike
        Configuration as of `truestroke run`, of which driver and axes are used.
    axis : str
        One of its names.
    name : str
        Of the device; by default that of the axis.

    Raises
    ------
    SettingError
        From `set` and `prepare`: the target or the motion leaves the stroke, or the scan is not for this axis.

    Examples
    --------
    >>> PiezoAxis("stage.toml", "x").name
    'x'
    """

    def __init__(self, path: str | os.PathLike[str], axis: str = "x", name: str = "") -> None:
        self.path, self.axis = path, axis
        with self.add_children_as_readables(Format.HINTED_SIGNAL):
            self.readback, self._set_readback = soft_signal_r_and_setter(float, 0.0, **UNITS)
        with self.add_children_as_readables():
            self.volts, self._set_volts = soft_signal_r_and_setter(float, 0.0, units="V", precision=4)
        self.setpoint = soft_signal_rw(float, 0.0, **UNITS)
        self._opened: Axes | None = None
        super().__init__(name=name or axis)

    @cached_property
    def movable_logic(self) -> _Logic:
        """How it moves, and how it flies."""
        return _Logic(setpoint=self.setpoint, readback=self.readback, device=self)

    @cached_property
    def flyable_logic(self) -> _Logic:
        """The same."""
        return self.movable_logic

    @property
    def source(self) -> str:
        """Its configuration and name in it."""
        return f"truestroke://{os.fspath(self.path)}#{self.axis}"

    @property
    def opened(self) -> bool:
        """Whether it is connected."""
        return self._opened is not None

    @property
    def axes(self) -> Axes:
        """The axes of the configuration, from `connect` on."""
        if self._opened is None:
            raise RuntimeError(f"{self.name}: connect() must be called before it moves")
        return self._opened

    async def connect(self, mock: Any = False, timeout: float = DEFAULT_TIMEOUT, force_reconnect: bool = False) -> None:
        """Open the driver; the output goes to the safe voltage, the axis is at 0 um."""
        await super().connect(mock, timeout, force_reconnect)
        if not mock and self._opened is None:
            opened = Axes.of(self.path)
            await asyncio.to_thread(opened.open)
            opened.at(self.axis)
            self._opened = opened

    async def read(self) -> dict[str, Any]:
        """NAME, um, and NAME-volts, V, now."""
        if self._opened is not None:
            self.show()
        found: dict[str, Any] = await super().read()
        return found

    def show(self) -> None:
        """What the axis says, in the signals."""
        self._set_readback(float(self.axes.reading(self.axis)))
        self._set_volts(self.axes.volts(self.axis))

    def close(self) -> None:
        """Let the outputs go to the safe voltages; a second call does nothing."""
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()


@dataclass
class _RemoteLogic(MovableLogic[float], FlyableLogic[Any, list[flights.Line]]):  # type: ignore[misc]
    """Moves and flights of an axis that `truestroke serve` runs."""

    device: EpicsPiezoAxis = field(kw_only=True)

    async def stop(self) -> None:
        """Go back to where the axis should be now, as smoothly as it moves."""
        device = self.device
        if device.goal is not None:
            device.goal = place = await device.desired.get_value()
            device.stopped = True
            await self.setpoint.set(place)

    async def check_move(self, new_position: float) -> None:
        """Refuse a target beyond `reach`."""
        if not abs(new_position) < float("inf"):
            raise SettingError("target", new_position, "a number", "um")

    async def move(self, new_position: float, timeout: Any) -> None:
        """Go there at the speed that is set."""
        await self._begin(new_position)
        await self._until_there()

    async def on_prepare(self, value: Any) -> list[flights.Line]:
        """Move to the run-up of the line, at full speed; then set that of the line."""
        device = self.device
        (line, *others) = flights.of_spec(value, device, device.name)
        if others:
            raise SettingError("scan", f"{1 + len(others)} lines", "one line: each needs a flight of its own")
        speed = abs(line.end - line.start) / line.duration
        checks.within("speed", speed, 0.0, await device.fastest(), "um/s")
        room = device.run_up * speed * (1 if line.end > line.start else -1)
        device.flown, device.ends = None, (line.start - room, line.end + room)
        await device.speed.set(await device.fastest())
        await self.move(device.ends[0], None)
        await device.speed.set(speed)
        return [line]

    async def on_kickoff(self, ctx: list[flights.Line]) -> list[flights.Line]:
        """Begin to fly."""
        await self._begin(self.device.ends[1])
        return ctx

    async def on_complete(self, ctx: list[flights.Line]) -> None:
        """Wait for the end of the line, and for the waves that show it."""
        device = self.device
        await self._until_there()
        device.flown = None if device.stopped else await device.waves(ctx[0])
        await device.speed.set(await device.fastest())
        device.refuse_stopped(device.stopped)

    async def _begin(self, target: float) -> None:
        self.device.goal, self.device.stopped = target, False
        await self.setpoint.set(target)

    async def _until_there(self) -> None:
        device = self.device
        async for shown in observe_value(device.desired):
            if device.goal is None or abs(shown - device.goal) <= ARRIVED:
                device.goal = None
                return


class EpicsPiezoAxis(_Flyer):
    """An axis that `truestroke serve --epics` runs, in another process or on another computer.

    As `PiezoAxis`; a scan is one line, whose points come from the waves of the server: `window` of its configuration
    must be longer than the line and half a second.

    Parameters
    ----------
    prefix : str
        That of the server and the name of the axis in capitals: "STAGE:X".
    name : str
        Of the device; by default the last part of the prefix in small letters.
    run_up : float
        Time before and after the line in which the axis gains and loses its speed, s: at least `ramp` of the server.
    protocol : str
        "ca" or "pva".
    """

    def __init__(self, prefix: str, name: str = "", run_up: float = 0.05, protocol: str = "ca") -> None:
        pv = f"{protocol}://{prefix}:"
        self.prefix, self.run_up, self.ends = pv, checks.positive("run_up", run_up, "s"), (0.0, 0.0)
        with self.add_children_as_readables(Format.HINTED_SIGNAL):
            self.readback = epics_signal_r(float, f"{pv}READBACK")
        with self.add_children_as_readables():
            self.volts = epics_signal_r(float, f"{pv}VOLTS")
        self.setpoint = epics_signal_rw(float, f"{pv}SETPOINT")
        self.speed = epics_signal_rw(float, f"{pv}SPEED")
        self.desired = epics_signal_r(float, f"{pv}DESIRED")
        self.rate = epics_signal_r(float, f"{protocol}://{prefix.rpartition(':')[0]}:SAMPLE_RATE")
        wave = {channel: epics_signal_r(Array1D[np.float64], f"{pv}{channel.upper()}:WAVE") for channel in CHANNELS}
        self.desired_wave, self.measured_wave, self.volts_wave = (wave[channel] for channel in CHANNELS)
        self._fastest: float | None = None
        self.goal: float | None = None  # of the present motion, um
        self.stopped = False  # whether the last motion was
        super().__init__(name=name or prefix.rpartition(":")[2].lower())

    @cached_property
    def movable_logic(self) -> _RemoteLogic:
        """How it moves, and how it flies."""
        return _RemoteLogic(setpoint=self.setpoint, readback=self.readback, device=self)

    @cached_property
    def flyable_logic(self) -> _RemoteLogic:
        """The same."""
        return self.movable_logic

    @property
    def source(self) -> str:
        """The first part of its variables."""
        return self.prefix

    async def fastest(self) -> float:
        """The `speed` of the server's configuration, um/s: the upper limit of SPEED."""
        if self._fastest is None:
            described = (await self.speed.describe())[self.speed.name]
            self._fastest = float(described["limits"]["control"]["high"])
        return self._fastest

    async def waves(self, line: flights.Line) -> Flown:
        """The points of a line that has just ended, when the server has published them all."""
        rate = await self.rate.get_value()
        async with asyncio.timeout(PATIENCE):
            while True:
                read = [await one.read() for one in (self.desired_wave, self.measured_wave, self.volts_wave)]
                values, stamps = zip(*((v["value"], v["timestamp"]) for r in read for v in r.values()), strict=True)
                if abs(values[0][-1] - self.ends[1]) <= ARRIVED and np.ptp(stamps) < TOGETHER:
                    break
                await asyncio.sleep(0.1)
        ticks = _on_line(values[0], line)
        trace = Trace(
            time=np.arange(values[0].size) / rate, desired=values[0], measured=values[1], volts=values[2], true=None
        )
        return Flown.of(trace, ticks, float(stamps[0]) - values[0].size / rate)


def _on_line(desired: FloatArray, line: flights.Line) -> list[slice]:
    """The ticks of each point of a line that was flown last, from the desired positions, um.

    Raises
    ------
    SettingError
        Its beginning is not there any more.

    Examples
    --------
    >>> _on_line(np.array([0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 5.0]), flights.Line(1.0, 5.0, 2, 0.1))
    [slice(2, 4, None), slice(4, 6, None)]
    """
    sign = 1.0 if line.end > line.start else -1.0
    way = sign * desired
    still = np.flatnonzero(np.diff(way) < 0)
    first = int(still[-1]) + 1 if still.size else 0
    if way[first] > sign * line.start:
        raise SettingError("window", f"{desired.size} ticks", "longer than the line and half a second: [epics]", "")
    places = first + np.searchsorted(way[first:], sign * line.edges - 1e-9)
    return [slice(int(a), max(int(b), int(a) + 1)) for a, b in itertools.pairwise(places)]


def fly(axis: _Flyer, scan: Any, *, stream: str = "primary", md: dict[str, Any] | None = None) -> Any:
    """A plan: one run, in which the axis flies along a scan and collects its points.

    Parameters
    ----------
    axis : PiezoAxis or EpicsPiezoAxis
        Connected.
    scan : scanspec.specs.Spec
        With durations, such as ``Line("x", 0, 10, 100) @ 0.01``.
    stream : str
        Of the events.
    md : dict, optional
        Metadata of the run.
    """

    def inner() -> Any:
        yield from bps.prepare(axis, scan, wait=True)
        yield from bps.declare_stream(axis, name=stream, collect=True)
        yield from bps.kickoff(axis, wait=True)
        yield from bps.complete(axis, wait=True)
        yield from bps.collect(axis, name=stream, return_payload=False)

    run = bpp.run_wrapper(inner(), md={"plan_name": "fly", **(md or {})})
    return (yield from bpp.stage_wrapper(run, [axis]))
