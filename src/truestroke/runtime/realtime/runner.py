"""The loop in real time: pace, safety, recording. Begin with `run_realtime`; docs/run.md describes it."""

import dataclasses
import shutil
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from truestroke.base import checks, interrupts
from truestroke.base.checks import SettingError
from truestroke.base.errors import LatenessWarning
from truestroke.base.files import Growing, beside, check_growing, grow
from truestroke.control import feasibility
from truestroke.runtime import agreement, run_metadata
from truestroke.runtime.drivers.guard import check_range
from truestroke.runtime.drivers.protocol import Driver, Signal, check_axes
from truestroke.runtime.drivers.turned import Turned
from truestroke.runtime.realtime.helpers import Helpers
from truestroke.runtime.realtime.live import Live
from truestroke.runtime.realtime.outcome import Outcome
from truestroke.runtime.realtime.process import (
    RealtimeError,
    lateness_of_system,
    on_its_own,
    require_realtime,
    undisturbed,
)
from truestroke.runtime.realtime.recorder import Plan
from truestroke.runtime.realtime.server import Server
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings, files_of
from truestroke.runtime.realtime.shared import Layout, Shared, Slot
from truestroke.runtime.ticks import SlowLayout, recorded, stride
from truestroke.signals.recording import Recording, ticks
from truestroke.signals.timing import Timing

ROOM = 1.3  # bytes on the disk for one of data
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
    server: Server | None = None,
    begins: Callable[[], None] = lambda: None,
) -> Outcome:
    """Follow trajectories with hardware, in real time.

    Parameters
    ----------
    driver : Driver
        Hardware of as many channels as there are axes.
    axes : sequence of Axis
        Trajectory, controller and limits of each channel; trajectories of the same length.
    file : str or Path
        Recording, readable while it grows. Of several axes each has its own, with its name before the ending; further
        signals of the driver are in the first one.
    settings : RealtimeSettings, optional
        How to keep time, and when to give up.
    about : Mapping[str, object], optional
        What else belongs into the metadata.
    overwrite : bool
        Replace files that are there; without it they are an error.
    show : "live" or "lines", optional
        A status line on stderr.
    server : EpicsSettings or LiveSettings, optional
        Publish the run by EPICS or as a live page, from a process of its own.
    begins : callable, optional
        Called once, where nothing forbids the run, before anything moves.

    Returns
    -------
    Outcome
        The cause of its end and its punctuality. The output is at the safe voltages in every case.

    Raises
    ------
    SettingError
        Trajectories, controllers, limits and driver do not fit together.
    DriverError, RealtimeError, OSError
        The run could not begin. The output was not touched.

    Warns
    -----
    LimitWarning
        A limit will probably hold the motion back; the metadata has the sentence, too, as `notices`.
    LatenessWarning
        This system does not bound how late a tick is, or its timer is too coarse for these blocks; in `notices`, too.
    """
    require_realtime()
    settings = RealtimeSettings() if settings is None else settings
    paths = recordings(Path(file), axes, overwrite)
    with closing(driver):
        timing = driver.open()
        clock = {"utc": datetime.now(UTC).isoformat(), "monotonic_s": time.monotonic()}
        _check_agreement(axes, timing, settings, server)
        for axis in axes:
            agreement.count_latency(axis.controller, timing)
        _check_range(axes, driver)
        notices = _check_motions(axes)
        for notice in notices:
            warnings.warn(notice, feasibility.LimitWarning, stacklevel=2)
        late = lateness_of_system(settings, timing)
        for notice in late:
            warnings.warn(notice, LatenessWarning, stacklevel=2)
        notices += late
        _check_room(driver, axes, timing, paths[0].absolute().parent)
        begins()
        shared_metadata = {"realtime": settings, "clock": clock, "notices": notices, **(about or {})}
        abouts = [_about(driver, axis, timing, shared_metadata) for axis in axes]
        with grown(paths, overwrite) as (places, unused), closing(Shared(_layout(driver, axes, timing))) as shared:
            made = zip(axes, places, abouts, strict=True)
            plans = [_plan(driver, axis, timing, place, about) for axis, place, about in made]
            plans[0] = dataclasses.replace(plans[0], signals=_signals(driver))
            shared.count[Slot.TICKS] = len(axes[0].trajectory)
            with on_its_own(settings):
                helpers = Helpers(shared, plans, driver, axes, settings, show, server)
            with closing(helpers):
                helpers.wait_until_ready()  # Ctrl-C ends this at once: nothing has moved
                unused.pop_all()
                with interrupts.noted() as asked, undisturbed(settings):
                    live = Live(driver, axes, timing, settings, shared, helpers, asked)
                    cause, reason = live.run()
            names = zip(paths, places, strict=True)
            return live.outcome(cause, reason, tuple(p if at.where == at.final else beside(p) for p, at in names))


def _check_agreement(axes: Sequence[Axis], timing: Timing, settings: RealtimeSettings, server: Server | None) -> None:
    check_axes(len(axes), timing.channels)
    checks.distinct("name", [axis.name for axis in axes], "axis")
    if len({len(axis.trajectory) for axis in axes}) > 1:
        raise SettingError("trajectories", [len(axis.trajectory) for axis in axes], "of the same length", "ticks")
    if server is not None:
        server.check(axes)
    for axis in axes:
        agreement.check_agreement(axis.trajectory, axis.controller, timing)
    checks.within("watchdog_timeout", settings.watchdog_timeout, 4 * timing.block / timing.sample_rate, 60.0, "s")


def _check_range(axes: Sequence[Axis], driver: Driver) -> None:
    """Refuse voltage limits beyond the range of the hardware: else even the safe voltage could fail."""
    for channel, axis in enumerate(axes):
        check_range(f"voltage_limits of axis {axis.name}", axis.voltage_limits, driver.describe(), channel)


def _check_motions(axes: Sequence[Axis]) -> list[str]:
    """Refuse a motion that its axis cannot make; sentences on the limits that hold one back."""
    notices: list[str] = []
    for axis in axes:
        if axis.known is None:
            continue
        words = {**feasibility.NAMES, "slew": "slew"}
        names = {name: f"{word} of axis {axis.name}" for name, word in words.items()}
        notices += feasibility.raise_slew(axis.trajectory, axis.controller, axis.slew, names["slew"])
        settings = axis.known
        limits: dict[str, Any] = {"voltage_limits": axis.limits, "slew": min(axis.slew, settings.slew_limit)}
        needs = feasibility.demands(axis.trajectory, settings, feasibility.first_mode(axis.controller))
        feasibility.check(needs, settings, **limits, names=names)
        notices += feasibility.notices(needs, settings, **limits, names=names)
    return notices


def recordings(file: Path, axes: Sequence[Axis], overwrite: bool) -> list[Path]:
    """What the file of each axis is called when it is complete; SettingError or OSError where it cannot be written."""
    paths = files_of("file", file, [axis.name for axis in axes])
    for path in paths:
        check_growing(path, overwrite, _empty)
    return paths


def _empty(path: Path) -> bool:
    """Whether an earlier run left a file that has not a single tick."""
    return ticks(path) == 0


@contextmanager
def grown(paths: Sequence[Path], overwrite: bool) -> Iterator[tuple[list[Growing], ExitStack]]:
    """The files, made and locked, and what removes them at the end unless `pop_all` is called of it."""
    with ExitStack() as opened, ExitStack() as unused:
        places = []
        for path in paths:
            places.append(place := grow(path.absolute(), overwrite, _empty))
            opened.callback(place.close)
            unused.callback(place.discard)
        yield places, unused


def _about(driver: Any, axis: Axis, timing: Timing, about: Mapping[str, object]) -> dict[str, Any]:
    """Metadata of a file; an error now where it could not be written later."""
    guard = {name: getattr(axis, name) for name in ("name", "voltage_limits", "slew", "safe_voltage")}
    metadata = run_metadata.about(axis.trajectory, axis.controller, driver, timing) | {"axis": guard, **about}
    metadata["plant"]["name"] = type(driver.driver if isinstance(driver, Turned) else driver).__name__
    return Recording({}, metadata).metadata


def _plan(driver: Any, axis: Axis, timing: Timing, place: Growing, about: dict[str, Any]) -> Plan:
    """The metadata of a file."""
    return Plan(
        place=place,
        about=about,
        channels=recorded(axis.trajectory, axis.controller, simulated=hasattr(driver, "truth")),
        slow=SlowLayout.of(axis.controller),
        sample_rate=timing.sample_rate,
        stride=stride(timing),
    )


def _check_room(driver: Driver, axes: Sequence[Axis], timing: Timing, folder: Path) -> None:
    """The disk has space for the whole run."""
    sizes = ((len(axis.trajectory), SlowLayout.of(axis.controller).width) for axis in axes)
    values = sum(80 * ticks + 8 * ticks // stride(timing) * width for ticks, width in sizes)
    needed = round(ROOM * (values + 8 * len(_signals(driver)) * len(axes[0].trajectory)))
    if (free := shutil.disk_usage(folder).free) < needed:
        raise RealtimeError(f"{folder}: the run writes {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free")


def _signals(driver: Any) -> tuple[Signal, ...]:
    """What a driver reads beside its axes; it stands in the recording of the first one."""
    return getattr(driver, "signals", ())


def _layout(driver: Driver, axes: Sequence[Axis], timing: Timing) -> Layout:
    size = round(BUFFER * timing.sample_rate) + timing.block + timing.latency
    return Layout(
        channels=len(axes),
        size=size,
        slow_size=size // stride(timing) + 2,
        slow_width=max(SlowLayout.of(axis.controller).width for axis in axes),
        signals=len(_signals(driver)),
    )
