"""Axes that a host moves: a thread of their own makes the ticks, in motion and at rest."""

from __future__ import annotations

import atexit
import math
import os
import threading
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.errors import PlaceWarning
from truestroke.base.typing import FloatArray
from truestroke.control.stage import FOUND_DAMPING
from truestroke.dropins import motions
from truestroke.dropins.attendant import Attendant
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.runtime.agreement import count_latency, wanted
from truestroke.runtime.drivers.guard import Guard, check_range
from truestroke.runtime.drivers.paced import Clock, Paced, let_go
from truestroke.runtime.drivers.protocol import Driver, DriverError, check_axes
from truestroke.runtime.realtime import config
from truestroke.runtime.realtime.axis_loop import REMEDY, SHARE
from truestroke.signals.timing import Timing
from truestroke.signals.trajectories import Trajectory

SPEED = 0.5  # of the slew limit: velocity of moves
STROKES = 50.0  # a second: the same; steps of a tenth of the stroke take what the stage needs, large moves excite less
LOST = 1.0  # s with a large error, after which an axis has lost its way,
FAR = 20  # times as soon with one of more than its stroke, which is another one or has another sensor
BOTH_SIDES = 0.5  # of the highest voltage: a lowest one that is as far below 0 moves the stage to both sides
AVERAGE = 0.01  # s of rest over which a reading is averaged
ZERO = 0.05  # s of rest before the first motion, for the zero of the sensor
SOON = 0.005  # s until a motion that is to be stopped slows down: what it needs is computed meanwhile
ARRIVED = 5e-4  # s: the end of a move, over which the sensor is averaged,
BESIDE = 0.01, 2e-4  # of the move, and of the stroke: a move that ends further from its place than both, and than
NOISY = 6.0  # standard deviations of that mean, has not arrived;
MISSES = 3, 8  # so many of so many moves show a stage that rings
SPIN = 0.0  # s: a thread that spins would take the interpreter from the host


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """A motion as it was made: one entry a tick, um and V; NaN where no measurement came.

    `stopped` is the tick from which on it was stopped.
    """

    time: FloatArray
    desired: FloatArray
    volts: FloatArray
    measured: FloatArray
    true: FloatArray | None
    stopped: int | None = None


def travel(stroke: float, low: float, high: float) -> tuple[float, float]:
    """Ends of the travel, um, with 0 um at 0 V: from 0 to the stroke, or on both sides where the voltages are.

    Examples
    --------
    >>> travel(30.0, -0.6, 3.6), travel(40.0, -10.0, 10.0)
    ((0.0, 30.0), (-20.0, 20.0))
    """
    lowest = stroke * low / (high - low) if -low >= BOTH_SIDES * high else 0.0
    return lowest, lowest + stroke


class _Line:
    """One axis within the loop: its controller, the motion that is being made, where it rests."""

    def __init__(self, axis: config.Movable, timing: Timing) -> None:
        self.name, self.controller, self.limits = axis.name, axis.controller, axis.table
        self.zero = axis.table.zero if isinstance(axis.table.zero, float) else 0.0
        settings = axis.controller.settings
        self.stroke, self.timing = settings.stroke, timing
        low, high = axis.table.voltage_limits
        self.travel = travel(self.stroke, low, high)
        self.speed = min(SPEED * axis.table.slew / (high - low), STROKES) * self.stroke
        self.stage = _stage(settings, timing.sample_rate)
        self.at, self.volts, self.measured = 0.0, axis.table.safe_voltage, math.nan
        self.rest: deque[float] = deque(maxlen=max(1, round(AVERAGE * timing.sample_rate)))
        self._lost, self._patience = 0, max(2, round(LOST * timing.sample_rate))
        self._limit = axis.table.error_limit or SHARE * self.stroke
        self.future: Future[Trace] | None = None
        self.trace: Trace | None = None
        self.motion: Trajectory
        self._stopped: int | None = None
        self._tick = 0
        self._ends: deque[tuple[float, float]] = deque(maxlen=MISSES[1])  # of moves, um beside their place, and of what
        self.notice: str | None = None  # for the host's side; empty once it was given

    def begin(self, trajectory: Trajectory) -> Future[Trace]:
        """Make this motion from the next tick on."""
        self.motion, self._args, self._stopped = trajectory, self.arguments(trajectory), None
        self._sent = np.full(len(self._args), math.nan)
        self._came, self._true = np.full((2, len(self._args)), math.nan)
        self._tick = 0
        self.future = Future()
        self.future.set_running_or_notify_cancel()  # who waits for it no more cannot cancel the motion by that
        return self.future

    def arguments(self, trajectory: Trajectory) -> list[tuple[Any, ...]]:
        """Of `command`, for each tick of a motion, until all of it is measured."""
        made = wanted(trajectory, self.controller)
        args: list[tuple[Any, ...]] = list(zip(*(array.tolist() for array in made), strict=True))
        return args + [(float(trajectory.position[-1]), 0.0)] * (self.timing.latency + self.timing.block)

    def later(self, seconds: float) -> int | None:
        """A tick so much later, at least a block, of a motion that goes on there; None where it ends, or is stopped."""
        at = self._tick + max(round(seconds * self.timing.sample_rate), 2 * self.timing.block)
        goes_on = self.future is not None and self._stopped is None and at < len(self.motion)
        return at if goes_on else None

    def stop(self, shorter: Trajectory, args: list[tuple[Any, ...]], at: int) -> bool:
        """Make this motion in place of the present one, which it is up to a tick; False where that has passed."""
        if self.later(0.0) is None or self._tick + self.timing.block > at:
            return False
        self.motion, self._args, self._stopped = shorter, args, at
        for name in ("_sent", "_came", "_true"):
            before, made = getattr(self, name), np.full(len(args), math.nan)
            made[: before.size] = before[: made.size]
            setattr(self, name, made)
        return True

    def command(self, volts: FloatArray) -> None:
        """The voltages of the next block."""
        for i in range(volts.size):
            moving = self.future is not None and self._tick + i < len(self._args)
            args = self._args[self._tick + i] if moving else (self.at, 0.0)
            self.at = args[0]
            volts[i] = self.controller.command(*args)

    def learn(self, volts: FloatArray, measured: FloatArray, truth: FloatArray | None) -> None:
        """Adapt to what came back in the block of these voltages, V; `DriverError` where the axis has lost its way."""
        block, late = volts.size, self.timing.latency
        for i, reading in enumerate((measured - self.zero).tolist()):
            self.controller.adapt(reading, block - 1 - i + late)
            self._note(reading)
        self.volts = float(volts[-1])
        if self.future is None:
            self.rest.extend((measured[measured == measured] - self.zero).tolist())
            return
        first, size = self._tick, len(self._args)
        self._sent[first : first + block] = volts[: size - first]
        for into, came in ((self._came, measured - self.zero), (self._true, truth)):
            if came is not None:
                k = np.arange(first - late, first - late + block)
                there = (k >= 0) & (k < size)
                into[k[there]] = came[there]
        self._tick += block
        if self._tick >= len(self.motion) + late:
            self._arrive(truth is not None)

    def _arrive(self, simulated: bool) -> None:
        n, rate, desired = len(self.motion), self.timing.sample_rate, self.motion.position
        done, self.future = self.future, None
        self.rest.clear()
        moving = np.flatnonzero(desired != desired[-1])
        tail = self._came[moving[-1] + 1 if moving.size else 0 : self._tick - self.timing.latency]
        self.rest.extend(tail[tail == tail].tolist())
        true = self._true[:n] - self.zero if simulated else None
        made: dict[str, Any] = {"volts": self._sent[:n], "measured": self._came[:n], "true": true}
        trace = Trace(time=np.arange(n) / rate, desired=desired, stopped=self._stopped, **made)
        self.trace = trace
        if self.stage is None and self._stopped is None:
            self._ended(self._came[:n], desired)
        if done is not None:
            done.set_result(trace)

    def _ended(self, came: FloatArray, desired: FloatArray) -> None:
        """Whether a move has ended in its place, and what to say where several have not."""
        last = slice(-max(1, round(ARRIVED * self.timing.sample_rate)), None)
        off, way = came[last] - desired[last], abs(float(desired[-1] - desired[0]))
        if not way > 0 or not np.isfinite(off).all():
            return
        spread = float(np.nanstd(np.diff(came, 2))) / math.sqrt(6 * off.size)  # of the mean of white noise
        beside = abs(float(np.mean(off)))
        share, part = BESIDE
        far = beside > max(share * way, part * self.stroke, NOISY * spread)
        self._ends.append((beside if far else 0.0, way))
        missed = [one for one in self._ends if one[0]]
        if self.notice is None and len(missed) >= MISSES[0]:
            worst, of = max(missed, key=lambda one: one[0] / one[1])
            self.notice = (
                f"axis {self.name}: {len(missed)} of the last {len(self._ends)} moves ended beside their place, one of "
                f"{of:.3g} um by {worst:.2g} um, as of a stage that rings; its resonance is not stated. Give "
                "`resonance` (Hz) in its table [[axis]], or the dynamics of `truestroke bode` in its settings"
            )

    def _note(self, reading: float) -> None:
        self.measured = reading
        error = abs(reading - self.at)
        if not error > self._limit:
            self._lost = max(self._lost - 1, 0)
            return
        far = error > self.stroke
        self._lost += FAR if far else 1
        if self._lost < self._patience:
            return
        about = f"the sensor shows {reading:.4g} um, {self.at:.4g} um are asked for"
        if far:
            words = (
                f"further off than its stroke, {self.stroke:.3g} um; {about}: correct stroke, or scale of the sensor"
            )
        else:
            words = f"more than {self._limit:.3g} um (error_limit) off for {LOST:g} s; {about}"
        raise DriverError(f"axis {self.name}: tracking is lost: {words}. {REMEDY}")

    @property
    def reading(self) -> float:
        """The sensor's mean at rest, um, or its last sample in motion; without one where the axis should be."""
        if self.future is None and self.rest:
            return float(np.mean(self.rest))
        return self.at if math.isnan(self.measured) else self.measured


def _stage(settings: Any, rate: float) -> Dynamics | None:
    """What of the stage decides how long a move takes: its dynamics, or its first resonance; None if none is known."""
    if settings.dynamics is not None:
        known: Dynamics = settings.dynamics
        return known
    if not settings.resonance:
        return None
    return Dynamics(sample_rate=rate, modes=(Mode(frequency=settings.resonance, damping=FOUND_DAMPING),))


class Axes:
    """The axes of a driver, moved from outside; the output is held at the safe voltage before `open` and after `close`.

    A thread makes the ticks: command, exchange, adapt, of all axes, also at rest. Of a simulated driver that is not
    `hardware_timed`, time passes in motion alone, as fast as the computer makes it, so that results repeat to the bit.
    Voltage limits, slew and the error limit hold as in `truestroke run`. On Linux a process of its own sets the outputs
    to the safe voltages when this one dies, or makes no tick for two seconds; it does not kill it.

    Parameters
    ----------
    driver : Driver
        Hardware, or the simulated one.
    axes : sequence of Movable
        One for each channel: `truestroke.runtime.realtime.config.movable` reads both from a file.

    Raises
    ------
    SettingError
        Their number is not that of the channels, or limits do not fit the driver.
    DriverError
        The hardware does not answer.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "stage.toml"
    ...     _ = file.write_text('''
    ... [driver]
    ... name = "simulated"
    ... [[axis]]
    ... name = "z"
    ... stroke = 30.0
    ... voltage_limits = [-0.6, 3.6]
    ... slew = 400.0
    ... ''')
    ...     with Axes.of(file) as axes:
    ...         trace = axes.move(z=10.0)["z"].result()
    ...         print(trace.desired[[0, -1]].tolist(), axes.at("z"), round(axes.reading("z")))
    [0.0, 10.0] 10.0 10
    """

    def __init__(self, driver: Driver, axes: Sequence[config.Movable]) -> None:
        self._driver, self._given = driver, tuple(axes)
        self._changed, self._lines = threading.Condition(), dict[str, _Line]()
        self._error: BaseException | None = None
        self._closing = False
        self.timing = Timing(sample_rate=1.0)  # that of the driver, once it is open
        self._thread: threading.Thread | None = None
        self._attendant: Attendant | None = None

    @classmethod
    def of(cls, path: str | os.PathLike[str]) -> Axes:
        """Those of a configuration, as `truestroke run` has one; its trajectories and recording are not used."""
        if not Path(path).exists():
            words = f"No such file: {os.fspath(path)}, in {Path.cwd()}; `truestroke run --example` prints one"
            raise FileNotFoundError(words)
        return cls(*config.movable(path))

    # ---- The host's side -------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Of the axes, in the order of their channels."""
        return tuple(axis.name for axis in self._given)

    def open(self) -> Timing:
        """Connect; the outputs are at the safe voltages, the axes at 0 um; a second call does nothing."""
        if self._thread is not None:
            return self.timing
        timing = self.timing = self._driver.open()
        safe = [axis.table.safe_voltage for axis in self._given]
        try:
            check_axes(len(self._given), timing.channels)
            for axis in self._given:
                count_latency(axis.controller, timing)
                check_range(f"voltage_limits of axis {axis.name}", axis.table.limits["voltage_limits"], self._about())
            self._lines = {axis.name: _Line(axis, timing) for axis in self._given}
            limits = [axis.table.limits for axis in self._given]
            ranges, slews = [one["voltage_limits"] for one in limits], [one["slew"] for one in limits]
            self._guard, self._safe = Guard(timing.sample_rate, ranges, slews, safe), np.array(safe)
            self._still = hasattr(self._driver, "rewind") and not timing.hardware_timed
            if not self._still:  # a simulation that stands still is none that has lost its host
                self._attendant = Attendant.beside(self._driver, self._safe)
            self._driver.start(self._safe)
        except BaseException:
            try:
                let_go(self._driver, np.array(safe))
            finally:
                self._dismiss()
            raise
        period = 1e-9 if self._still else timing.block / timing.sample_rate
        clock = Clock(period, spin=SPIN, hardware_timed=timing.hardware_timed or self._still)
        self._paced = Paced(self._driver, timing, self._guard, clock)
        self._closing, self._error = False, None
        self._thread = threading.Thread(target=self._serve, name="truestroke axes", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        return timing

    def _about(self) -> Mapping[str, object]:
        return self._driver.describe()

    def __enter__(self) -> Axes:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def move(self, **targets: float) -> dict[str, Future[Trace]]:
        """Move to targets, um, each from rest to rest as fast as stage and slew allow; returns at once.

        Raises
        ------
        SettingError
            There is no such axis, the target is beyond its stroke, or the axis is moving.
        DriverError
            The loop has ended.
        """
        lines = {self._line(name): self._within(self._line(name), value) for name, value in targets.items()}
        for line in lines:
            if line.notice:
                warnings.warn(line.notice, PlaceWarning, stacklevel=2)
                line.notice = ""
        rate = self.timing.sample_rate
        made = {
            line: motions.move(line.at, target, rate, speed=line.speed, stage=line.stage)
            for line, target in lines.items()
        }
        return self._begin(made)

    def follow(self, name: str, trajectory: Trajectory) -> Future[Trace]:
        """Make a motion that begins where the axis rests.

        Raises
        ------
        SettingError
            It begins elsewhere, leaves the stroke, or has another sample rate.
        """
        self.check_motion(name, trajectory)
        line, first = self._line(name), trajectory.position[0]
        if abs(first - line.at) > 1e-6:
            raise SettingError("trajectory", f"from {first:g} um", f"from {line.at:g} um, where {name} is")
        return self._begin({line: trajectory})[name]

    def stop(self, name: str) -> Future[Trace] | None:
        """Bring an axis to rest on its way, within a run-down; returns at once, with the future of its motion.

        None where it rests; a motion that ends sooner by itself does so.
        """
        line, waits = self._line(name), SOON
        while True:
            with self._changed:
                future, at = line.future, line.later(waits)
                motion = line.motion if at is not None else None
            if at is None or motion is None:
                return future
            shorter = motions.stopped(motion, at, stage=line.stage)
            args = line.arguments(shorter)  # meanwhile the motion goes on
            with self._changed:
                if line.motion is motion and line.stop(shorter, args, at):
                    return future
            waits *= 2

    def check(self, name: str, target: float) -> None:
        """SettingError where a target, um, is beyond the stroke."""
        self._within(self._line(name), target)

    def check_motion(self, name: str, trajectory: Trajectory) -> None:
        """SettingError where a motion leaves the stroke, or has another sample rate."""
        if trajectory.sample_rate != self.timing.sample_rate:
            bound = f"{self.timing.sample_rate} Hz, that of the driver"
            raise SettingError("trajectory.sample_rate", trajectory.sample_rate, bound, "Hz")
        low, high, ends = trajectory.position.min(), trajectory.position.max(), self._line(name).travel
        if not ends[0] <= low <= high <= ends[1]:
            bound = f"within {ends[0]:g} to {ends[1]:g} um, with its run-up and run-down"
            raise SettingError(f"motion of axis {name}", f"{low:.4g} to {high:.4g}", bound, "um")

    def _begin(self, made: Mapping[_Line, Trajectory]) -> dict[str, Future[Trace]]:
        with self._changed:
            self._check()
            for line in made:
                if line.future is not None:
                    raise SettingError("target", f"of axis {line.name}", "given when the axis is at rest: it moves")
            begun = {line.name: line.begin(trajectory) for line, trajectory in made.items()}
            self._changed.notify_all()
        return begun

    def _within(self, line: _Line, target: float) -> float:
        value = checks.number(f"target of axis {line.name}", target, "um")
        return checks.within(f"target of axis {line.name}", value, *line.travel, "um")

    def _line(self, name: str) -> _Line:
        self._check()
        if name not in self._lines:
            raise SettingError("axis", repr(name), f"one of {', '.join(self._lines)}")
        return self._lines[name]

    def _check(self) -> None:
        if self._error is not None:
            raise DriverError(f"the axes are at the safe voltage: {self._error}") from self._error
        if self._thread is None:
            raise DriverError("the axes are not open")

    def at(self, name: str) -> float:
        """Where an axis should be now, um."""
        return self._line(name).at

    def reading(self, name: str) -> float:
        """Where it is, um: the sensor's mean at rest; without a sensor where it should be."""
        return self._line(name).reading

    def volts(self, name: str) -> float:
        """What is at its output now, V."""
        return self._line(name).volts

    def trace(self, name: str) -> Trace:
        """The last motion that has ended.

        Raises
        ------
        LookupError
            None has.
        """
        if (found := self._line(name).trace) is None:
            raise LookupError(f"axis {name} has not moved")
        return found

    def busy(self, name: str) -> bool:
        """Whether it moves."""
        return self._line(name).future is not None

    def stage(self, name: str) -> Dynamics | None:
        """What decides how long its moves take; None if no resonance is known."""
        return self._line(name).stage

    def speed(self, name: str) -> float:
        """Fastest velocity of its moves, um/s."""
        return self._line(name).speed

    def close(self) -> None:
        """After the present motion, go to the safe voltages within slew and let go; a second call does nothing."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        atexit.unregister(self.close)
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        thread.join()

    # ---- The thread's side -----------------------------------------------------------------------------------------

    def _serve(self) -> None:
        error: BaseException | None = None
        safe = False
        try:
            self._zero()
            while self._waited():
                self._block(list(self._lines.values()))
            self._paced.apply(self._guard.ramp(self._safe.tolist()), after=self._beat)
        except BaseException as failure:
            error = failure
        try:
            let_go(self._driver, self._safe)
            safe = True
        except Exception as failure:
            error = error or failure
        finally:
            self._dismiss(safe)
        if error is not None:  # a future ends when the outputs are safe
            self._fail(error)

    def _beat(self) -> None:
        """A block was made, for the attendant to see; `DriverError` where it has taken over."""
        if self._attendant is not None:
            self._attendant.beat()

    def _dismiss(self, safe: bool = True) -> None:
        attendant, self._attendant = self._attendant, None
        if attendant is not None:
            attendant.end(safe)

    def _fail(self, error: BaseException) -> None:
        with self._changed:
            self._error = self._error or error
            for line in self._lines.values():
                waiting, line.future = line.future, None
                if waiting is not None:
                    waiting.set_exception(DriverError(f"the axes are at the safe voltage: {error}"))

    def _waited(self) -> bool:
        """Whether there is another block to be made; time that passes in motion alone waits for one."""
        with self._changed:
            while not (moving := any(line.future for line in self._lines.values())):
                if self._closing:
                    return False
                if not self._still:
                    return True
                self._changed.wait()
            return moving

    def _zero(self) -> None:
        """The zero of each sensor that is to be measured, from some rest at the safe voltage."""
        asked = [(i, line) for i, line in enumerate(self._lines.values()) if line.limits.zero == "measured"]
        if not asked:
            return
        ticks = round(ZERO * self.timing.sample_rate)
        rest = np.repeat(self._safe[:, None], ticks + self.timing.latency, axis=1)
        came = self._paced.apply(rest, after=self._beat)
        for channel, line in asked:
            line.zero = float(np.nanmean(came[channel, self.timing.latency :]))

    def _block(self, lines: Sequence[_Line]) -> None:
        volts = np.empty((len(lines), self.timing.block))
        with self._changed:
            for line, row in zip(lines, volts, strict=True):
                line.command(row)
        measured = self._paced.exchange(volts)
        self._beat()
        truth = getattr(self._driver, "truth", None)
        with self._changed:
            for channel, line in enumerate(lines):
                line.learn(volts[channel], measured[channel], None if truth is None else truth[channel].copy())
