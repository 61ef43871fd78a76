"""The loop in real time: pace, safety, recording. `run_realtime` is the page to read; docs/run.md says what it does."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from truestroke import _check, loop
from truestroke._check import SettingError
from truestroke._typing import FloatArray
from truestroke.drivers.clock import EDGES_US, Clock
from truestroke.drivers.guard import Guard, padded
from truestroke.drivers.protocol import Driver, DriverError
from truestroke.realtime import helper, recorder, status, watchdog
from truestroke.realtime.axis_loop import AxisLoop, slow_values, stride
from truestroke.realtime.ending import SIGNALS, Cause, Outcome, Stop
from truestroke.realtime.process import RealtimeError, noted_signals, on_its_own, undisturbed
from truestroke.realtime.settings import Axis, RealtimeSettings
from truestroke.realtime.shared import Helper, Layout, Shared, Slot, State, Text
from truestroke.recording import Recording
from truestroke.timing import Timing

BUFFER = 8.0  # s that the recorder may fall behind before the run ends
GLANCE = 0.02  # s between two looks at the helping processes
PATIENCE = 60.0  # s for the helping processes to start
LAST_WORDS = 15.0  # s for the recorder to write the rest


def run_realtime(
    driver: Driver,
    axes: Sequence[Axis],
    file: str | Path,
    *,
    settings: RealtimeSettings | None = None,
    about: Mapping[str, object] | None = None,
    overwrite: bool = False,
    show: Literal["live", "lines"] | None = None,
) -> Outcome:
    """Follow trajectories with hardware, in real time.

    Parameters
    ----------
    driver : Driver
        Hardware of as many channels as there are axes.
    axes : sequence of Axis
        Trajectory, controller and limits of each channel; trajectories of the same length.
    file : str or Path
        Recording, readable while it grows. Of several axes each has its own, with its name before the ending.
    settings : RealtimeSettings, optional
        How to keep time, and when to give up.
    about : Mapping[str, object], optional
        What else belongs into the metadata.
    overwrite : bool
        Replace files that are there; without it they are an error.
    show : "live" or "lines", optional
        A status line on stderr.

    Returns
    -------
    Outcome
        Why it ended and how punctual it was. Whatever happened, the output is at the safe voltages.

    Raises
    ------
    SettingError
        Trajectories, controllers, limits and driver do not fit together.
    DriverError, RealtimeError, OSError
        The run could not begin. The output was not touched.
    """
    settings = RealtimeSettings() if settings is None else settings
    paths = _paths(Path(file), axes, overwrite)
    with closing(driver):
        timing = driver.open()
        clock = {"utc": datetime.now(UTC).isoformat(), "monotonic_s": time.monotonic()}
        _check_agreement(axes, timing, settings)
        plans = _plans(driver, axes, timing, paths, {"realtime": settings, "clock": clock, **(about or {})})
        with closing(Shared(_layout(axes, timing))) as shared:
            shared.count[Slot.TICKS] = len(axes[0].trajectory)
            with on_its_own(settings):
                helpers = _Helpers(shared, plans, driver, axes, settings, show)
            with closing(helpers), noted_signals() as asked, undisturbed(settings):
                helpers.wait_until_ready()
                live = _Live(driver, axes, timing, settings, shared, helpers, asked)
                cause, reason = live.run()
            return live.outcome(cause, reason, tuple(paths))


def _check_agreement(axes: Sequence[Axis], timing: Timing, settings: RealtimeSettings) -> None:
    _check.count("the number of axes", len(axes), timing.channels, timing.channels)
    if len({axis.name for axis in axes}) < len(axes):
        raise SettingError("name", ", ".join(axis.name for axis in axes), "different for each axis")
    if len({len(axis.trajectory) for axis in axes}) > 1:
        raise SettingError("trajectories", [len(axis.trajectory) for axis in axes], "of the same length", "ticks")
    for axis in axes:
        loop.check_agreement(axis.trajectory, axis.controller, timing)
    _check.within("watchdog_timeout", settings.watchdog_timeout, 4 * timing.block / timing.sample_rate, 60.0, "s")


def _paths(file: Path, axes: Sequence[Axis], overwrite: bool) -> list[Path]:
    """One file for each axis."""
    if not file.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {file.parent}", str(file))
    paths = [file if len(axes) == 1 else file.with_name(f"{file.stem}-{axis.name}{file.suffix}") for axis in axes]
    for path in paths:
        if path.exists() and not overwrite:
            raise FileExistsError(errno.EEXIST, "a recording is there; choose another name, or overwrite it", str(path))
    return paths


def _plans(
    driver: Any, axes: Sequence[Axis], timing: Timing, paths: list[Path], about: Mapping[str, object]
) -> list[recorder.Plan]:
    """What goes into each file; an error now where it could not be written later."""
    plans = []
    for axis, path in zip(axes, paths, strict=True):
        has = {"true": hasattr(driver, "truth")}
        has |= {name: hasattr(axis.controller, n) for name, n in (("innovation", "innovation"), ("flags", "flag_bits"))}
        guard = {name: getattr(axis, name) for name in ("name", "voltage_limits", "slew", "safe_voltage")}
        metadata = loop.about(axis.trajectory, axis.controller, driver, timing) | {"axis": guard, **about}
        plan = recorder.Plan(
            path=path.absolute(),
            about=Recording({}, metadata).metadata,
            channels=tuple(name for name in loop.CHANNELS if name != "time" and has.get(name, True)),
            slow=tuple((name, value.shape) for name, value in slow_values(axis.controller).items()),
            sample_rate=timing.sample_rate,
            stride=stride(timing),
        )
        plans.append(plan)
    needed = sum(80 * len(a.trajectory) + 8 * len(a.trajectory) // stride(timing) * _width(a) for a in axes)
    folder = paths[0].absolute().parent
    if (free := shutil.disk_usage(folder).free) < needed:
        raise RealtimeError(f"{folder}: the run writes {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free")
    return plans


def _width(axis: Axis) -> int:
    return sum(value.size for value in slow_values(axis.controller).values())


def _layout(axes: Sequence[Axis], timing: Timing) -> Layout:
    size = round(BUFFER * timing.sample_rate) + timing.block + timing.latency
    return Layout(
        channels=len(axes),
        size=size,
        slow_size=size // stride(timing) + 2,
        slow_width=max(_width(axis) for axis in axes),
    )


class _Helpers:
    """Recorder, watchdog and status line, each in its process."""

    def __init__(
        self,
        shared: Shared,
        plans: list[recorder.Plan],
        driver: Driver,
        axes: Sequence[Axis],
        settings: RealtimeSettings,
        show: Literal["live", "lines"] | None,
    ) -> None:
        safe, rescue = np.array([axis.safe_voltage for axis in axes]), driver.rescue()
        self._shared, self._plans = shared, plans
        self.recorder = helper.start(shared, recorder.record, plans)
        self.watchdog = helper.start(shared, watchdog.watch, os.getpid(), rescue, safe, settings.watchdog_timeout)
        self._all = [self.recorder, self.watchdog]
        if show is not None:
            names = [axis.name for axis in axes]
            self._all.append(helper.start(shared, status.show, names, plans[0].sample_rate, show == "live"))

    def wait_until_ready(self) -> None:
        """RealtimeError if they do not come up."""
        count, until = self._shared.count, time.monotonic() + PATIENCE
        while not (count[Slot.RECORDER] == count[Slot.WATCHDOG] == Helper.READY):
            if count[Slot.RECORDER] == Helper.FAILED:
                raise RealtimeError(f"the recording cannot be written: {self._shared.read(Text.COMPLAINT)}")
            if self.trouble() or time.monotonic() > until:
                raise RealtimeError("recorder and watchdog did not start")
            time.sleep(0.01)

    def trouble(self) -> tuple[Cause, str] | None:
        """Which of them no longer works, and why."""
        if self._shared.count[Slot.RECORDER] == Helper.FAILED:
            return Cause.RECORDER, f"the recording cannot be written: {self._shared.read(Text.COMPLAINT)}"
        if self.recorder.poll() is not None:
            return Cause.RECORDER, "the recorder died"
        if self.watchdog.poll() is not None:
            return Cause.WATCHDOG, "the watchdog died"
        return None

    def finish(self, ending: str) -> None:
        """Let the recording be completed; where its recorder is dead, write at least how the run ended."""
        self._shared.write(Text.ENDING, ending)
        self._shared.count[Slot.STATE] = State.ENDED
        try:
            completed = self.recorder.wait(LAST_WORDS) == 0
        except subprocess.TimeoutExpired:
            self.recorder.kill()
            completed = False
        for axis, plan in enumerate(self._plans):
            if not completed and self._shared.count[Slot.ENDINGS + axis]:
                recorder.write_ending(plan.path, self._shared.count[Slot.ENDINGS + axis], ending)

    def close(self) -> None:
        """End them all."""
        for process in self._all:
            if process.stdin:
                process.stdin.close()
            try:  # a terminal that nobody reads holds up the status line
                process.wait(LAST_WORDS if process is self.recorder else 2.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


class _Live:
    """The run while the output is live: soft start, the ticks, soft stop."""

    def __init__(
        self,
        driver: Driver,
        axes: Sequence[Axis],
        timing: Timing,
        settings: RealtimeSettings,
        shared: Shared,
        helpers: _Helpers,
        asked: list[int],
    ) -> None:
        self._driver, self._timing, self._settings, self._shared = driver, timing, settings, shared
        self._helpers, self._asked, self._count = helpers, asked, shared.count
        self._axes = [
            AxisLoop(axis, shared, channel, timing, settings.sensor_timeout) for channel, axis in enumerate(axes)
        ]
        self._safe = np.array([axis.safe_voltage for axis in axes])
        limits, slew = [axis.voltage_limits for axis in axes], [axis.slew for axis in axes]
        self._guard = Guard(timing.sample_rate, limits, slew, self._safe.tolist())
        period = timing.block / timing.sample_rate
        self._pace = (period, settings.spin, timing.hardware_timed)
        self._clock = Clock(*self._pace, histogram=shared.histogram)
        self._volts = np.zeros((len(axes), timing.block))
        self._measured = np.full((len(axes), timing.block), np.nan)
        self._ticks, self._done, self._began = len(axes[0].trajectory), 0, time.monotonic()
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
        self._helpers.finish(json.dumps(self._ending(cause, reason)))
        return cause, reason

    def _until_it_ends(self) -> tuple[Cause, str]:
        try:
            self._driver.start(self._safe)
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
            if not self._guard(volts):
                raise Stop(Cause.ERROR, "a controller asked for a voltage that is no number")
            late = self._clock.wait() * 1e-3
            for axis, row in zip(axes, volts, strict=True):
                axis.leaving(start, stop, row, late)
            self._driver.exchange(volts, measured)
            truth: FloatArray | None = getattr(self._driver, "truth", None)
            for channel, axis in enumerate(axes):
                axis.learn(start, stop, measured[channel], None if truth is None else truth[channel])
            self._done = stop
            count[Slot.WRITTEN] = max(stop - latency, 0)
            count[Slot.SLOW_WRITTEN] = (stop - 1) // stride_ + 1
            self._beat()
            self._look(stop)

    def _look(self, stop: int) -> None:
        """End the run where somebody or something asks for it."""
        if self._asked:
            raise Stop(*SIGNALS[self._asked[0]])  # type: ignore[index]
        if 0 < self._settings.overrun_streak <= self._clock.streak:
            raise Stop(Cause.OVERRUN, f"{self._clock.streak} blocks in a row were more than a period late")
        if stop >= self._next_glance:
            self._next_glance = stop + self._glance
            self._count[Slot.OVERRUNS] = self._clock.overruns
            if trouble := self._helpers.trouble():
                raise Stop(*trouble)
            if stop + self._glance + self._timing.block - self._count[Slot.SAVED] > self._shared.layout.size:
                raise Stop(Cause.RECORDER, f"the recorder is more than {BUFFER:g} s behind")

    def _beat(self) -> None:
        self._count[Slot.BEAT] += 1

    def _ramp(self, target: Sequence[float]) -> None:
        """Bring the output near `target`, within slew; a second signal cuts it short."""
        ramp, block = self._guard.ramp(target), self._timing.block
        clock = Clock(*self._pace)
        clock.start()
        for start in range(0, ramp.shape[1], block):
            if len(self._asked) > 1:
                return
            volts = padded(ramp[:, start : start + block], block)
            self._guard(volts)
            clock.wait()
            self._driver.exchange(volts, self._measured)
            self._beat()

    def _stop(self, softly: bool) -> str:
        """Output to the safe voltages, by whatever still works; what did not, in words."""
        complaints = []
        try:
            if softly:
                self._ramp(self._safe.tolist())
        except Exception as error:
            complaints.append(f"no soft stop: {error}")
        try:
            self._driver.stop(self._safe)
        except Exception as error:
            complaints.append(f"the driver did not stop: {error}")
            try:
                self._driver.rescue()(self._safe)
            except Exception as another:
                complaints.append(f"THE OUTPUT IS NOT SAFE: {another}")
        return "; ".join(complaints)

    def _ending(self, cause: Cause, reason: str) -> dict[str, Any]:
        """What the recording says at its end."""
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
        interrupted = None if cause is Cause.FINISHED else reason
        return {"interrupted": interrupted, "ended": ended, "lateness": punctuality}

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
        )
