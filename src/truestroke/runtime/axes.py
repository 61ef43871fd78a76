"""The loop of two or three axes: the same as of one, with a controller and a recorder for each."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke import _loops
from truestroke.base import checks, notebook
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.axes import AxesMotion, MultiAxisController, check_name, in_order
from truestroke.control.controller import AdaptiveController, Controller
from truestroke.plant import MultiAxisStage
from truestroke.runtime import agreement, native, run_metadata
from truestroke.runtime.ticks import MARK, SIMULATED, SlowLayout, TickRecorder, recorded, require_memory, stride
from truestroke.signals.channels import Array, channel, dtype
from truestroke.signals.recording import Recording, of_axis
from truestroke.signals.timing import Timing
from truestroke.signals.trajectories import Trajectory

TOGETHER = ("frame", "coupling")  # what axes have that know each other


@dataclass(frozen=True, eq=False)
class Wanted:
    """A motion for controllers that do not know each other: of each axis, and the arguments of each `command`."""

    axes: Mapping[str, Trajectory]
    commands: list[list[tuple[float, ...]]]


class SeparateControllers:
    """A controller for each axis, of any law, that knows nothing of the others.

    Parameters
    ----------
    axes : Mapping[str, Controller]
        By the name of the axis, in the order of the channels of the actuator.
    """

    learned: Mapping[str, Any] = {}

    def __init__(self, axes: Mapping[str, Controller]) -> None:
        made, names = "a controller, such as an AdaptiveController", ", ".join(map(str, axes)) or "no axis"
        for name, one in axes.items():
            check_name(name)
            if isinstance(one, MultiAxisController):
                bound = f"{made}; a MultiAxisController has all axes, and is given in place of the mapping"
                raise SettingError(f"controller[{name!r}]", "a MultiAxisController", bound)
            checks.able(f"controller[{name!r}]", one, ("command", "adapt"), made)
        if len({id(one) for one in axes.values()}) < max(len(axes), 1):
            raise SettingError("controller", f"a mapping of {names}", f"{made} of its own for each axis")
        self.axes = dict(axes)

    def prepare(self, motion: Mapping[str, Trajectory]) -> Wanted:
        """As of a `MultiAxisController`: one trajectory for each axis, of one sample rate and length."""
        own = dict(zip(self.axes, in_order(motion, tuple(self.axes), None), strict=True))
        columns = [agreement.wanted(one, axis) for one, axis in zip(own.values(), self.axes.values(), strict=True)]
        return Wanted(own, [list(zip(*(c.tolist() for c in one), strict=True)) for one in columns])

    def follow(self, known: Wanted, tick: int) -> FloatArray:
        """Voltages of a tick, V, shape (axes,)."""
        each = zip(self.axes.values(), known.commands, strict=True)
        return np.array([axis.command(*given[tick]) for axis, given in each])

    def adapt(self, measured: Sequence[float], ago: int = 0) -> None:
        """Each to its own sensor, um."""
        for axis, z in zip(self.axes.values(), measured, strict=True):
            axis.adapt(z, ago)


Axes = MultiAxisController | SeparateControllers


def run_axes(
    motion: Mapping[str, Trajectory],
    controllers: MultiAxisController | Mapping[str, Controller],
    actuator: Any,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """`truestroke.run` with a trajectory for each axis, as the sensors should read it.

    Returns
    -------
    Recording
        The channels of each axis, such as desired_x; `Recording.axis` gives the recording of one. Volts, innovation,
        flags and weights are those of the axes, all else is what the sensors read.
    """
    controller = SeparateControllers(controllers) if isinstance(controllers, Mapping) else controllers
    made = "a MultiAxisController, or a mapping of names to controllers, where the trajectory is one of trajectories"
    checks.instance("controller", controller, (MultiAxisController, SeparateControllers), made)
    checks.able("actuator", actuator, ("open", "exchange"), "an actuator, such as a plant.MultiAxisStage")
    timing = checks.instance("actuator.open()", actuator.open(), Timing, "a Timing(sample_rate=, channels=)")
    if len(controller.axes) != timing.channels:
        channels = "the one channel" if timing.channels == 1 else f"each of {timing.channels} channels"
        bound = f"one for {channels} of the actuator"
        raise SettingError("controller", f"controllers of {', '.join(controller.axes)}", bound)
    known = controller.prepare(motion)
    require_memory("trajectory", max(len(one) for one in motion.values()), len(motion))
    log = _Log(motion, known, controller, actuator, timing)
    for notice in log.notices():
        warnings.warn(notice, feasibility.LimitWarning, stacklevel=3)
    end, done = len(log), 0
    try:
        with notebook.progress("run", progress) as shown:
            for stop in _moved(known, controller, actuator, timing, log):
                start, done = done, stop
                if shown and 100 * stop // end > 100 * start // end:
                    shown(stop, end)
    except (Exception, KeyboardInterrupt) as error:
        log.interrupted = repr(error)
        raise run_metadata.RunInterrupted(log.recording(done), error) from error
    return log.recording(done)


def _moved(known: Any, controller: Axes, actuator: Any, timing: Timing, log: _Log) -> Iterator[int]:
    """The loop itself: how many ticks are done, after each block; natively where controllers and plant are native."""
    end = len(log)
    fast = _is_native(controller, actuator)
    by_ticks = min(end, native.FIRST) if fast else end
    volts = log.rows["volts"]
    for start in range(0, by_ticks, timing.block):
        stop = min(start + timing.block, by_ticks)
        for k in range(start, stop):
            volts[k] = controller.follow(known, k)
            for one in log.recorders:
                one.commanded(k)
        measured = _checked(actuator.exchange(volts[start:stop]), (stop - start, len(controller.axes)))
        log.answered(start, stop, measured, getattr(actuator, "truth", None), controller)
        yield stop
    if fast:
        yield from _natively(known, controller, actuator, by_ticks, log)  # type: ignore[arg-type]  # it is native


def _is_native(controller: Axes, actuator: Any) -> bool:
    """Whether no tick needs Python: a `MultiAxisStage`, and axes whose calls are those of the kernel."""
    moves = type(actuator) is MultiAxisStage and not {"open", "exchange"} & vars(actuator).keys()
    usual = type(controller) is MultiAxisController and not {"follow", "adapt"} & vars(controller).keys()
    return (
        moves and usual and all(type(a) is AdaptiveController and native.is_usual(a) for a in controller.axes.values())
    )


def _natively(
    known: AxesMotion, controller: MultiAxisController, plant: MultiAxisStage, start: int, log: _Log
) -> Iterator[int]:
    """Up to each entry of the slow channels, and each hundredth of the run, for its progress."""
    end = len(log)
    stops = sorted({*range(1, end, log.stride), *(-(-part * end // 100) for part in range(1, 101))})
    noise = np.empty(log.stride * plant._samples)
    for stop in (stop for stop in stops if stop > start):
        for part in between(start, stop, controller):
            numbers = noise[: (part.stop - part.start) * plant._samples]
            plant._noise.fill(numbers)
            rows = {name: log.rows[name][part] for name in SIMULATED}
            pass_natively(known, controller, plant, part, numbers, rows)
            plant.passed(rows["true"])
        for axis in controller.axes.values():
            axis._kernel.require_reach()
        for one in log.recorders:
            one.learned(stop - 1)
        start = stop
        yield stop


def pass_natively(
    known: AxesMotion,
    controller: MultiAxisController,
    plant: MultiAxisStage,
    part: slice,
    numbers: FloatArray,
    rows: Mapping[str, Array],
) -> None:
    """The ticks of a part that `between` gives, in the native loop, and what the axes learn of them.

    `numbers` are those of the plant's noise; the arrays of `rows`, by `SIMULATED` and in its order, are filled.
    """
    strain = known.strain[part]
    if controller.learned:
        strain = strain + controller.added(range(part.start, part.stop))
    given = known.motion(part), strain, known.others[part], controller.to_axes, numbers
    calls = [axis._kernel.native() for axis in controller.axes.values()]
    _loops.run_axes(calls, plant._plant.native(), *given, *rows.values())
    if controller.learned:
        controller.see(known, part.start, rows["measured"], rows["flags"])


def between(start: int, stop: int, controller: MultiAxisController) -> Iterator[slice]:
    """From one tick to another, cut where an axis learns what its period has shown."""
    while start < stop:
        ends = (end for one in controller.learned.values() for end in one.stops if end > start)
        part = slice(start, min(stop, min(ends, default=stop)))
        yield part
        start = part.stop


def _checked(measured: FloatArray, shape: tuple[int, int]) -> FloatArray:
    if getattr(measured, "shape", None) != shape:
        given = f"array of shape {measured.shape}" if hasattr(measured, "shape") else f"a {type(measured).__name__}"
        raise SettingError("exchange", given, f"of shape {shape}", "um")
    return measured


class _Log:
    """The arrays of a run, an entry for each axis in a tick, and what fills them."""

    def __init__(
        self,
        motion: Mapping[str, Trajectory],
        known: AxesMotion | Wanted,
        controller: Axes,
        actuator: Any,
        timing: Timing,
    ) -> None:
        self._motion, self._known, self._controller, self._actuator = motion, known, controller, actuator
        self._timing, self.stride = timing, stride(timing)
        size, axes = len(self), controller.axes
        self.rows = {
            name: np.full((size, len(axes)), 0 if name == "flags" else np.nan, dtype(name)) for name in SIMULATED
        }
        self._layouts = {name: SlowLayout.of(axis) for name, axis in axes.items()}
        self._slow = {name: np.empty((-(-size // self.stride), one.width)) for name, one in self._layouts.items()}
        self.recorders = [
            TickRecorder(axis, timing, {key: array[:, i] for key, array in self.rows.items()}, self._slow[name])
            for i, (name, axis) in enumerate(axes.items())
        ]
        self.interrupted: str | None = None
        self._before = {name: run_metadata.ticks_before(axis) for name, axis in axes.items()}
        self._notices: dict[str, tuple[str, ...]] = {}
        for name, axis in axes.items():
            agreement.check_agreement(known.axes[name], axis, timing)
            agreement.count_latency(axis, timing)
        self.recording(0)  # metadata that cannot be written are refused before anything moves

    def __len__(self) -> int:
        return len(next(iter(self._motion.values())))

    def notices(self) -> list[str]:
        """What will probably hold an axis back, each with its remedy; a default slew limit is raised."""
        for name, axis in self._controller.axes.items():
            own = self._known.axes[name]
            self._notices[name] = feasibility.raise_slew(own, axis) + feasibility.remedied(own, axis)
        return [f"axis {name}: {notice}" for name, notices in self._notices.items() for notice in notices]

    def answered(self, start: int, stop: int, measured: FloatArray, truth: FloatArray | None, controller: Axes) -> None:
        """The measurements of an exchange go to the tick that they belong to, and to the controllers."""
        each = [
            one.answers(start, stop, measured[:, i], None if truth is None else truth[:, i])
            for i, one in enumerate(self.recorders)
        ]
        for entries in zip(*each, strict=True):
            controller.adapt([z for _, z, _ in entries], entries[0][2])

    def recording(self, done: int) -> Recording:
        """Of the ticks that are done."""
        first = next(iter(self._motion.values()))
        channels = {"time": channel("time", first.time[:done])}
        about = {}
        for i, (name, axis) in enumerate(self._controller.axes.items()):
            wanted = self._motion[name]
            arrays = {"desired": wanted.position, "desired_velocity": wanted.velocity}
            if wanted.flat is not None:
                arrays[MARK] = wanted.flat.astype(dtype(MARK))
            names = recorded(wanted, axis, done > 0 and getattr(self._actuator, "truth", None) is not None)
            arrays |= {key: array[:, i] for key, array in self.rows.items() if key in names}
            channels |= {of_axis(key, name): channel(key, arrays[key][:done]) for key in names}
            about[name] = self._about(name, axis)
        if done and any(layout.width for layout in self._layouts.values()):
            channels["weights_time"] = channel("weights_time", first.time[: done : self.stride], "weights_time")
            for name, layout in self._layouts.items():
                slow = layout.split(self._slow[name][: -(-done // self.stride)])
                channels |= {of_axis(key, name): channel(key, data, "weights_time") for key, data in slow.items()}
        return Recording(channels, self._metadata() | {"axes": about})

    def _about(self, name: str, axis: Controller) -> dict[str, Any]:
        of_all = run_metadata.about(self._motion[name], axis, self._actuator, self._timing)
        own = {key: of_all[key] for key in ("trajectory", "controller")}
        own["controller"] |= {"ticks_before": self._before[name]}
        found = run_metadata.found(axis, self._controller.learned.get(name), self._timing.sample_rate)
        return own | {"notices": list(self._notices.get(name, ())), **found}

    def _metadata(self) -> dict[str, Any]:
        of_all = run_metadata.about(next(iter(self._motion.values())), self._controller, self._actuator, self._timing)
        kept = {key: of_all[key] for key in ("created", "plant", "timing", "versions")}
        together = {key: getattr(self._controller, key) for key in TOGETHER if hasattr(self._controller, key)}
        controller = {"name": type(self._controller).__name__, **together}
        return kept | {"interrupted": self.interrupted, "controller": controller}
