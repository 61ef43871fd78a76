"""The loop in real time: pace, safety, recording. `run_realtime` is the page to read; docs/run.md says what it does."""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from truestroke import _check, loop
from truestroke._check import SettingError
from truestroke.drivers.protocol import Driver
from truestroke.realtime.axis_loop import slow_values, stride
from truestroke.realtime.ending import Outcome
from truestroke.realtime.epics import EpicsSettings
from truestroke.realtime.helpers import Helpers
from truestroke.realtime.live import Live
from truestroke.realtime.process import RealtimeError, noted_signals, on_its_own, undisturbed
from truestroke.realtime.recorder import Plan
from truestroke.realtime.settings import Axis, RealtimeSettings
from truestroke.realtime.shared import Layout, Shared, Slot
from truestroke.recording import Recording
from truestroke.timing import Timing

BUFFER = 8.0  # s that the recorder may fall behind before the run ends


def run_realtime(
    driver: Driver,
    axes: Sequence[Axis],
    file: str | Path,
    *,
    settings: RealtimeSettings | None = None,
    about: Mapping[str, object] | None = None,
    overwrite: bool = False,
    show: Literal["live", "lines"] | None = None,
    epics: EpicsSettings | None = None,
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
    epics : EpicsSettings, optional
        Publish the run by EPICS, from a process of its own.

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
    paths = recordings(Path(file), axes, overwrite)
    with closing(driver):
        timing = driver.open()
        clock = {"utc": datetime.now(UTC).isoformat(), "monotonic_s": time.monotonic()}
        _check_agreement(axes, timing, settings, epics)
        _check_range(axes, driver)
        plans = _plans(driver, axes, timing, paths, {"realtime": settings, "clock": clock, **(about or {})})
        with closing(Shared(_layout(axes, timing))) as shared:
            shared.count[Slot.TICKS] = len(axes[0].trajectory)
            with on_its_own(settings):
                helpers = Helpers(shared, plans, driver, axes, settings, show, epics)
            with closing(helpers), noted_signals() as asked, undisturbed(settings):
                helpers.wait_until_ready()
                live = Live(driver, axes, timing, settings, shared, helpers, asked)
                cause, reason = live.run()
            return live.outcome(cause, reason, tuple(paths))


def _check_agreement(
    axes: Sequence[Axis], timing: Timing, settings: RealtimeSettings, epics: EpicsSettings | None
) -> None:
    _check.count("the number of axes", len(axes), timing.channels, timing.channels)
    if len({axis.name for axis in axes}) < len(axes):
        raise SettingError("name", ", ".join(axis.name for axis in axes), "different for each axis")
    if len({len(axis.trajectory) for axis in axes}) > 1:
        raise SettingError("trajectories", [len(axis.trajectory) for axis in axes], "of the same length", "ticks")
    if epics is not None:
        epics.check(axes)
    for axis in axes:
        loop.check_agreement(axis.trajectory, axis.controller, timing)
    _check.within("watchdog_timeout", settings.watchdog_timeout, 4 * timing.block / timing.sample_rate, 60.0, "s")


def _check_range(axes: Sequence[Axis], driver: Driver) -> None:
    """What may leave must be what the hardware can put out, or not even the safe voltage is sure to."""
    reach = driver.describe().get("output_range")
    if isinstance(reach, tuple | list):
        for axis in axes:
            for value in axis.voltage_limits:
                _check.within(f"voltage_limits of axis {axis.name}", value, reach[0], reach[1], "V")


def recordings(file: Path, axes: Sequence[Axis], overwrite: bool) -> list[Path]:
    """One file for each axis; OSError where it cannot be written."""
    if not file.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {file.parent}", str(file))
    paths = [file if len(axes) == 1 else file.with_name(f"{file.stem}-{axis.name}{file.suffix}") for axis in axes]
    for path in paths:
        if path.exists() and not overwrite:
            raise FileExistsError(errno.EEXIST, "a recording is there; choose another name, or overwrite it", str(path))
    return paths


def _plans(
    driver: Any, axes: Sequence[Axis], timing: Timing, paths: list[Path], about: Mapping[str, object]
) -> list[Plan]:
    """What goes into each file; an error now where it could not be written later."""
    plans = []
    for axis, path in zip(axes, paths, strict=True):
        has = {"true": hasattr(driver, "truth")}
        has |= {name: hasattr(axis.controller, n) for name, n in (("innovation", "innovation"), ("flags", "flag_bits"))}
        guard = {name: getattr(axis, name) for name in ("name", "voltage_limits", "slew", "safe_voltage")}
        metadata = loop.about(axis.trajectory, axis.controller, driver, timing) | {"axis": guard, **about}
        plan = Plan(
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
