"""The run while the output is live: soft start, the ticks, soft stop."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.guard import Guard
from truestroke.runtime.drivers.paced import EDGES_US, Clock, Paced, padded
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.runtime.realtime import axis_check
from truestroke.runtime.realtime.axis_check import Found
from truestroke.runtime.realtime.axis_loop import AxisLoop
from truestroke.runtime.realtime.ending import AS_ASKED, SIGNALS, Cause, Stop
from truestroke.runtime.realtime.helpers import Helpers
from truestroke.runtime.realtime.outcome import Outcome
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings
from truestroke.runtime.realtime.shared import Shared, Slot, State
from truestroke.runtime.ticks import stride
from truestroke.signals.timing import Timing

GLANCE = 0.02  # s between two checks of the helping processes
LONGEST = 4000  # characters of a reason that fit in a recording


class Live:
    """One run; `run` is all that is called of it, once."""

    def __init__(
        self,
        driver: Driver,
        axes: Sequence[Axis],
        timing: Timing,
        settings: RealtimeSettings,
        shared: Shared,
        helpers: Helpers,
        asked: list[int],
    ) -> None:
        self._driver, self._timing, self._settings, self._shared = driver, timing, settings, shared
        self._helpers, self._asked, self._count = helpers, asked, shared.count
        self._axes = [AxisLoop(axis, shared, channel, timing, settings) for channel, axis in enumerate(axes)]
        self._safe = np.array([axis.safe_voltage for axis in axes])
        limits, slew = [axis.voltage_limits for axis in axes], [axis.slew for axis in axes]
        self._guard = Guard(timing.sample_rate, limits, slew, self._safe.tolist())
        period = timing.block / timing.sample_rate
        self._pace = (period, settings.spin, timing.hardware_timed)
        self._clock = Clock(*self._pace, histogram=shared.histogram)
        self._volts = np.zeros((len(axes), timing.block))
        self._measured = np.full((len(axes), timing.block), np.nan)
        self._ticks, self._done, self._began = len(axes[0].trajectory), 0, time.monotonic()
        self._found, self._held = [Found() for _ in axes], False
        self._glance, self._next_glance = max(1, round(GLANCE * timing.sample_rate)), 0

    def run(self) -> tuple[Cause, str]:
        """All of it; why it ended. The output is safe, and the recording complete, when it returns."""
        self._count[Slot.STATE] = State.STARTING
        cause, reason = self._until_it_ends()
        self._seconds = time.monotonic() - self._began
        self._count[Slot.STATE] = State.STOPPING
        complaint = self._stop(softly=cause is not Cause.DRIVER)
        if complaint:
            reason = "; ".join(filter(None, (reason, complaint)))
            cause = Cause.DRIVER if cause is Cause.FINISHED else cause
        self._count[Slot.WRITTEN] = self._done
        if complaint := self._helpers.finish(json.dumps(self._ending(cause, reason))):
            if cause is not Cause.RECORDER:  # which has reported it already
                reason = "; ".join(filter(None, (reason, complaint)))
            cause = Cause.RECORDER if cause in AS_ASKED else cause
            self._helpers.note(json.dumps(self._ending(cause, reason)))
        return cause, reason

    def _until_it_ends(self) -> tuple[Cause, str]:
        try:
            self._heed_signals()
            self._driver.start(self._safe)
            self._examine()
            self._ramp([axis.first() for axis in self._axes])
            self._began = time.monotonic()
            self._follow()
        except Stop as stop:
            return stop.cause, stop.reason
        except DriverError as error:
            return Cause.DRIVER, str(error)
        except BaseException as error:  # a driver that exits, too, does not leave the output where it is
            return Cause.ERROR, f"{type(error).__name__}: {error}"
        return Cause.FINISHED, ""

    def _examine(self) -> None:
        """The axis check; a simulated stack is then again as it was before."""
        axes = [axis.axis for axis in self._axes]
        self._found = axis_check.examine(axes, self._timing, self._move, self._settings.axis_check)
        for axis, found in zip(self._axes, self._found, strict=True):
            axis.zero = found.zero
        if rewind := getattr(self._driver, "rewind", None):
            rewind()

    def _follow(self) -> None:
        """The ticks. Between two of them: learn from the last measurement, compute the next command, wait."""
        axes, volts, measured, count, block = self._axes, self._volts, self._measured, self._count, self._timing.block
        latency, stride_ = self._timing.latency, stride(self._timing)
        count[Slot.STATE] = State.LIVE
        self._clock.start()
        for start in range(0, self._ticks, block):
            stop = min(start + block, self._ticks)
            for axis, row in zip(axes, volts, strict=True):
                axis.command(start, stop, row)
            numbers = self._guard(volts)
            late = self._clock.wait() * 1e-3
            for axis, row in zip(axes, volts, strict=True):
                axis.leaving(start, stop, row, late)
            self._driver.exchange(volts, measured)
            self._note_signals(start, stop)
            truth: FloatArray | None = getattr(self._driver, "truth", None)
            for channel, axis in enumerate(axes):
                axis.learn(start, stop, measured[channel], None if truth is None else truth[channel])
            self._done = stop
            count[Slot.WRITTEN] = max(stop - latency, 0)
            count[Slot.SLOW_WRITTEN] = (stop - 1) // stride_ + 1
            self._beat()
            if not numbers:
                raise Stop(Cause.ERROR, "a controller asked for a voltage that is no number")
            self._look(stop)

    def _note_signals(self, start: int, stop: int) -> None:
        """Further signals of the driver to the ticks of their commands; those of `start` to `stop` are to come."""
        if not self._shared.layout.signals:
            return
        ring, size = self._shared.signals, self._shared.layout.size
        ticks, readings = np.arange(start, stop), self._driver.readings  # type: ignore[attr-defined]
        ring[:, ticks % size] = np.nan
        answered = ticks - self._timing.latency
        ring[:, answered[answered >= 0] % size] = readings[:, : stop - start][:, answered >= 0]

    def _look(self, stop: int) -> None:
        """End the run on a request, of a person or a process."""
        self._heed_signals()
        if 0 < self._settings.overrun_streak <= self._clock.streak:
            remedy = "end other programs, look at `truestroke doctor`, or raise `overrun_streak` (0: never end)"
            raise Stop(Cause.OVERRUN, f"{self._clock.streak} blocks in a row were more than a period late: {remedy}")
        if stop >= self._next_glance:
            self._next_glance = stop + self._glance
            for axis in self._axes:
                axis.look_back(stop)
            self._hold_or_resume()
            self._count[Slot.OVERRUNS] = self._clock.overruns
            if trouble := self._helpers.trouble():
                raise Stop(*trouble)
            behind = stop - self._count[Slot.SAVED]
            if behind + self._glance + self._timing.block > self._shared.layout.size:
                raise Stop(Cause.RECORDER, f"the recorder is {behind / self._timing.sample_rate:.1f} s behind")

    def _hold_or_resume(self) -> None:
        """Learn, or not, as an operator asks."""
        held = self._count[Slot.HOLD] != 0
        if held is not self._held:
            self._held = held
            for axis in self._axes:
                axis.hold(held)

    def _heed_signals(self, expected: int = 0) -> None:
        """End a ramp if a signal came beyond those that caused it, or an operator asks."""
        if len(self._asked) > expected:
            raise Stop(*SIGNALS[self._asked[-1]])
        if self._count[Slot.STOP] and self._count[Slot.STATE] != State.STOPPING:
            raise Stop(Cause.STOPPED, "an operator asked for it")

    def _beat(self) -> None:
        self._count[Slot.BEAT] += 1

    def _ramp(self, target: Sequence[float], expected: int = 0) -> None:
        """Move the output to near `target`, within slew; a signal beyond those `expected` ends it early."""
        self._apply(self._guard.ramp(target), expected)

    def _move(self, volts: FloatArray) -> FloatArray:
        """Apply `volts`, shape (channels, ticks), hold the last one, and return the displacements, um, same shape."""
        latency = self._timing.latency
        return self._apply(padded(volts, volts.shape[1] + latency))[:, latency : latency + volts.shape[1]]

    def _apply(self, moves: FloatArray, expected: int = 0) -> FloatArray:
        """Apply voltages, shape (channels, ticks), and return what came back meanwhile, um."""
        paced = Paced(self._driver, self._timing, self._guard, Clock(*self._pace))
        return paced.apply(moves, before=lambda: self._heed_signals(expected), after=self._beat)

    def _stop(self, softly: bool) -> str:
        """Output to the safe voltages, by all means that still work; those that failed, in words."""
        complaints = []
        try:
            if softly:
                self._ramp(self._safe.tolist(), max(1, len(self._asked)))  # the first signal asks for nothing else
        except BaseException as error:  # a driver that exits, too
            complaints.append(f"no soft stop: {error}")
        try:
            self._driver.stop(self._safe)
        except BaseException as error:
            complaints.append(f"the driver did not stop: {error}")
            try:
                self._driver.rescue()(self._safe)
            except Exception as another:
                complaints.append(f"THE OUTPUT IS NOT SAFE: {another}")
        return "; ".join(complaints)

    def _ending(self, cause: Cause, reason: str) -> dict[str, Any]:
        """The end of the run for the recording."""
        punctuality = {
            "ticks_per_second": self._done / self._seconds,
            "overruns": self._clock.overruns,
            "missed_periods": self._clock.missed,
            "worst_us": self._clock.worst * 1e-3,
            "upper_edges_us": EDGES_US,
            "blocks": list(self._shared.histogram),
        }
        ended = {
            "cause": cause.name.lower(),
            "exit_code": cause.value,
            "at": datetime.now(UTC).isoformat(),
            "ticks": self._done,
            "lost_samples": sum(axis.lost for axis in self._axes),
            "limited_by_the_guard": self._guard.limited,
        }
        interrupted = None if cause is Cause.FINISHED else reason[:LONGEST]
        seen = {axis.axis.name: _plain(found) for axis, found in zip(self._axes, self._found, strict=True)}
        of_axes = {axis.axis.name: axis.found for axis in self._axes}
        about = {what: {name: found[what] for name, found in of_axes.items()} for what in next(iter(of_axes.values()))}
        return {"interrupted": interrupted, "ended": ended, "lateness": punctuality, "axis_check": seen, **about}

    def outcome(self, cause: Cause, reason: str, files: tuple[Path, ...]) -> Outcome:
        """For the caller."""
        return Outcome(
            cause=cause,
            reason=reason,
            files=files,
            ticks=self._done,
            all_ticks=self._ticks,
            overruns=self._clock.overruns,
            missed=self._clock.missed,
            worst_us=self._clock.worst * 1e-3,
            histogram=tuple(self._shared.histogram),
            limited=self._guard.limited,
            lost=sum(axis.lost for axis in self._axes),
            found={axis.axis.name: found for axis, found in zip(self._axes, self._found, strict=True)},
        )


def _plain(found: Found) -> dict[str, float | None]:
    """For JSON, which has no NaN."""
    return {name: value if value == value else None for name, value in asdict(found).items()}
