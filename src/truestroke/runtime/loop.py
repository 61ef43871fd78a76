"""The loop: command, exchange, adapt, tick after tick. The page to read first."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from truestroke.base import checks, notebook
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.axes import MultiAxisController
from truestroke.control.controller import Controller
from truestroke.runtime import native
from truestroke.runtime.agreement import check_agreement, count_latency, wanted
from truestroke.runtime.axes import run_axes
from truestroke.runtime.run_metadata import RunInterrupted, about, found
from truestroke.runtime.ticks import MARK, SIMULATED, SlowLayout, TickRecorder, recorded, require_memory, stride
from truestroke.signals.channels import channel, dtype
from truestroke.signals.recording import Recording
from truestroke.signals.timing import Timing
from truestroke.signals.trajectories import Trajectory


class Actuator(Protocol):
    """An actuator, simulated or real: two calls.

    A simulated one may also have `truth`, the noise-free counterpart of what the last exchange returned (um, same
    shape), and any one `describe()`, a dict of its settings for the recording.
    """

    def open(self) -> Timing:
        """Be ready, at rest; the timing."""

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Apply one voltage (V) a tick; return as many displacements (um, each the mean over a tick).

        Shape (ticks,), ticks <= block; only the last block of a run may be shorter. Entry i belongs to the command
        `latency` ticks before volts[i].
        """


def run(
    trajectory: Trajectory | Mapping[str, Trajectory],
    controller: Controller | MultiAxisController | Mapping[str, Controller],
    actuator: Actuator,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Follow a trajectory.

    Parameters
    ----------
    trajectory : Trajectory, or Mapping[str, Trajectory]
        Desired motion; of several axes one for each, by its name.
    controller : Controller, MultiAxisController, or Mapping[str, Controller]
        Gives the voltages and adapts to the measurements. It continues from its present state. Of several axes a
        mapping has a controller of any law for each, which knows nothing of the others.
    actuator : Actuator
        Is opened, then moves a block of ticks at each exchange; of several axes arrays of shape (ticks, axes).
    progress : callable, optional
        Called as progress(ticks done, all ticks), about a hundred times. By default a notebook shows a bar.

    Returns
    -------
    Recording
        Entry k of each channel belongs to tick k, for any block and latency: time [s], desired [um],
        desired_velocity [um/s], volts [V], measured [um], and what there is of true [um], innovation [um], flags
        (the bits of `base.flags`), flat (1 where errors count, of a trajectory that marks it). Every 10 ms, with
        weights_time [s]: weights [um/V], partial_slopes [um/V], trace_P [1/V^2]. NaN marks a missing measurement, and
        the innovation of a rejected one. Of several axes each name ends with that of its axis, as in measured_x;
        `Recording.axis` gives the recording of one.

    Raises
    ------
    SettingError
        An argument is not of its kind, the sample rates of trajectory, controller and actuator differ, block and
        latency are too long, or the settings cannot be written as JSON.
    RunInterrupted
        Anything went wrong on the way, or Ctrl-C was pressed: it holds the recording so far.

    Warns
    -----
    LimitWarning
        The slew limit or the voltage limits of the controller will probably hold the motion back, corners of the motion
        excite the known resonance, or the default slew limit was raised to twice what the motion needs. The metadata
        has the sentences, too, as `notices`.

    Examples
    --------
    >>> from truestroke import AdaptiveController
    >>> from truestroke.signals import trajectories
    >>> class Spring:
    ...     def open(self):
    ...         return Timing(sample_rate=2000.0)
    ...     def exchange(self, volts):
    ...         return 10.0 * volts
    >>> wave = trajectories.sine(frequency=8.0, peak_to_peak=20.0, duration=1.0)
    >>> controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> recording = run(wave, controller, Spring())
    >>> error = recording["measured"] - recording["desired"]
    >>> round(float(abs(error[1000:]).max()), 3)
    0.0
    """
    if isinstance(trajectory, Mapping) or isinstance(controller, Mapping) or hasattr(controller, "axes"):
        return run_axes(trajectory, controller, actuator, progress)  # type: ignore[arg-type]  # it checks them
    _check_types(trajectory, controller, actuator, progress)
    timing = checks.instance("actuator.open()", actuator.open(), Timing, "a Timing(sample_rate=...)")
    check_agreement(trajectory, controller, timing)
    count_latency(controller, timing)
    checks.count("channels of the actuator", timing.channels, 1, 1)
    require_memory("trajectory", len(trajectory))
    notices = feasibility.raise_slew(trajectory, controller) + feasibility.remedied(trajectory, controller)
    for notice in notices:
        warnings.warn(notice, feasibility.LimitWarning, stacklevel=2)
    metadata = about(trajectory, controller, actuator, timing) | {"notices": list(notices)}
    log = _Log(trajectory, controller, timing)
    end, done = len(trajectory), 0
    try:
        with notebook.progress("run", progress) as shown:
            for stop in _moved(trajectory, controller, actuator, timing, log):
                start, done = done, stop
                if shown and 100 * stop // end > 100 * start // end:
                    shown(stop, end)
    except (Exception, KeyboardInterrupt) as error:
        metadata["interrupted"] = repr(error)
        raise RunInterrupted(log.recording(done, metadata, controller, actuator), error) from error
    return log.recording(done, metadata, controller, actuator)


def _moved(
    trajectory: Trajectory, controller: Controller, actuator: Actuator, timing: Timing, log: _Log
) -> Iterator[int]:
    """The loop itself: how many ticks are done, after each block.

    A native controller and a native plant go on without Python once the first measurement is accepted: the same bits.
    """
    desired, end = wanted(trajectory, controller), len(trajectory)
    pair = native.pair(trajectory, controller, actuator, desired)
    by_ticks = end if pair is None else min(end, native.FIRST)
    command, adapt = controller.command, controller.adapt
    motion = zip(*(array[:by_ticks].tolist() for array in desired), strict=True)
    volts = log.rows["volts"]
    for start in range(0, by_ticks, timing.block):
        stop = min(start + timing.block, by_ticks)
        for k in range(start, stop):
            x = command(*next(motion))
            volts[k] = x if isinstance(x, float) and math.isfinite(x) else checks.number("controller.command()", x, "V")
            log.ticks.commanded(k)
        measured = _checked(actuator.exchange(volts[start:stop]), stop - start)
        for _, z, ago in log.ticks.answers(start, stop, measured, getattr(actuator, "truth", None)):
            adapt(z, ago)
        yield stop
    if pair is not None:
        yield from _natively(pair, by_ticks, end, log)


def _natively(pair: native.Pair, start: int, end: int, log: _Log) -> Iterator[int]:
    """As `_moved`: up to each entry of the slow channels, and each hundredth of the run, for its progress."""
    hundredths = (-(-part * end // 100) for part in range(1, 101))
    stops = sorted({*range(1, end, log.stride), *hundredths})
    noise = np.empty(log.stride * pair.samples)
    for stop in stops:
        if stop > start:
            pair.run(slice(start, stop), log.rows, noise)
            log.ticks.learned(stop - 1)
            start = stop
            yield stop


def _check_types(trajectory: Trajectory, controller: Controller, actuator: Actuator, progress: Any) -> None:
    """SettingError where an argument is none of its kind, before anything moves; two that are swapped are such."""
    order = "; the order is trajectory, controller, actuator"
    made = f"a Trajectory, such as of truestroke.trajectories.sine(){order}"
    checks.instance("trajectory", trajectory, Trajectory, made)
    checks.able("controller", controller, ("command", "adapt"), f"a controller, such as an AdaptiveController{order}")
    checks.takes("controller.command", controller.command, 0.0, 0.0, form="command(z_d, zdot_d)")
    checks.takes("controller.adapt", controller.adapt, 0.0, 0, form="adapt(z_measured, ago=0)")
    checks.able("actuator", actuator, ("open", "exchange"), f"an actuator, such as a plant.RealisticPlant{order}")
    checks.takes("actuator.exchange", actuator.exchange, np.zeros(1), form="exchange(volts)")
    if progress is not None:
        checks.able("progress", progress, ("__call__",), "a function of ticks done and all ticks")


def _checked(measured: FloatArray, ticks: int) -> FloatArray:
    if (shape := getattr(measured, "shape", None)) != (ticks,):
        given = f"a {type(measured).__name__}" if shape is None else f"array of shape {shape}"
        raise SettingError("exchange", given, f"of shape ({ticks},)", "um")
    return measured


class _Log:
    """The arrays of a run, and what fills them."""

    def __init__(self, trajectory: Trajectory, controller: Controller, timing: Timing) -> None:
        self.trajectory, self.stride, self.layout = trajectory, stride(timing), SlowLayout.of(controller)
        size = len(trajectory)
        self.rows = {name: np.full(size, 0 if name == "flags" else np.nan, dtype(name)) for name in SIMULATED}
        self.slow = np.empty((-(-size // self.stride), self.layout.width))
        self.ticks = TickRecorder(controller, timing, self.rows, self.slow)

    def recording(self, done: int, metadata: dict[str, Any], controller: Any, actuator: Any) -> Recording:
        """Of the ticks that are done."""
        motion = {"desired": self.trajectory.position, "desired_velocity": self.trajectory.velocity}
        if self.trajectory.flat is not None:
            motion[MARK] = self.trajectory.flat.astype(dtype(MARK))
        names = recorded(self.trajectory, controller, done > 0 and getattr(actuator, "truth", None) is not None)
        arrays = {"time": self.trajectory.time, **{name: (motion | self.rows)[name] for name in names}}
        channels = {name: channel(name, data[:done]) for name, data in arrays.items()}
        if self.layout.width:
            slow = self.layout.split(self.slow[: -(-done // self.stride)])
            arrays = {"weights_time": self.trajectory.time[: done : self.stride], **slow}
            channels |= {name: channel(name, data, "weights_time") for name, data in arrays.items()}
        return Recording(channels, metadata | found(controller))
