"""The loop: command, exchange, adapt, tick after tick. The page to read first."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Protocol

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.base.flags import BIT, BY_ADAPT, IN_SHORT
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.controller import Controller
from truestroke.signals.recording import Channel, Recording, versions
from truestroke.signals.timing import Timing
from truestroke.signals.trajectories import Trajectory

__all__ = ["Actuator", "RunInterrupted", "Timing", "about", "check_agreement", "run"]

SLOW_PERIOD = 0.01  # s between two entries of the slow channels
CHANNELS = {
    "time": ("s", "start of each tick"),
    "desired": ("um", "desired displacement"),
    "desired_velocity": ("um/s", "desired velocity"),
    "volts": ("V", "command at the D/A converter"),
    "measured": ("um", "measured displacement, mean over the tick"),
    "true": ("um", "displacement without sensor noise, mean over the tick"),
    "innovation": ("um", "measurement beyond the model, (15)"),
    "flags": ("", IN_SHORT),
}
SLOW_TIME = ("s", "start of the tick before the weights")
SLOW_CHANNELS = {
    "weights": ("um/V", "w = [a0, b0, a1, b1, ...], (21)"),
    "partial_slopes": ("um/V", "slopes of the hysteresis branches as the inverse used them"),
    "trace_P": ("1/V^2", "trace of the covariance"),
}


class Motion(Protocol):
    """What check and metadata know of a desired motion; a `Trajectory` is one."""

    @property
    def name(self) -> str:
        """What it is."""

    @property
    def sample_rate(self) -> float:
        """Ticks per second, Hz."""

    @property
    def settings(self) -> Mapping[str, object]:
        """What it was made from."""

    def __len__(self) -> int:
        """Ticks."""


class Actuator(Protocol):
    """Whatever can be driven: simulated or real. Two calls.

    A simulated one may also have `truth`, the noise-free counterpart of what the last exchange returned (um, same
    shape), and any one `describe()`, a dict of its settings for the recording.
    """

    def open(self) -> Timing:
        """Be ready, at rest, and tell the timing."""

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Apply one voltage (V) a tick; return as many displacements (um, each the mean over a tick).

        Shape (ticks,), ticks <= block; only the last block of a run may be shorter. Entry i belongs to the command
        `latency` ticks before volts[i].
        """


class RunInterrupted(TruestrokeError, RuntimeError):  # noqa: N818 (it is no error that Ctrl-C ends a run)
    """A run ended before its time; its cause is ``__cause__``.

    Attributes
    ----------
    recording : Recording
        The ticks that were completed.
    """

    def __init__(self, recording: Recording, cause: BaseException) -> None:
        self.recording = recording
        super().__init__(f"the run ended after {recording['time'].size} ticks: {type(cause).__name__} {cause}".rstrip())


def run(
    trajectory: Trajectory,
    controller: Controller,
    actuator: Actuator,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Follow a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        Desired motion.
    controller : Controller
        Gives the voltages and learns from the measurements. It goes on from the state that it is in.
    actuator : Actuator
        Is opened, then moves a block of ticks at each exchange.
    progress : callable, optional
        Called as progress(ticks done, all ticks), about a hundred times.

    Returns
    -------
    Recording
        Entry k of each channel belongs to tick k, whatever block and latency are: time [s], desired [um],
        desired_velocity [um/s], volts [V], measured [um], and what there is of true [um], innovation [um], flags
        (the bits of `base.flags`). Every 10 ms, with weights_time [s]: weights [um/V], partial_slopes [um/V],
        trace_P [1/V^2]. NaN stands where no measurement came, and for the innovation of a rejected one.

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
        The slew limit or the voltage limits of the controller will probably hold the motion back.

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
    _check_types(trajectory, controller, actuator)
    timing = checks.instance("actuator.open()", actuator.open(), Timing, "a Timing(sample_rate=...)")
    check_agreement(trajectory, controller, timing)
    checks.count("channels of the actuator", timing.channels, 1, 1)
    for notice in feasibility.remedied(trajectory, controller):
        warnings.warn(notice, feasibility.LimitWarning, stacklevel=2)
    notes = _Notes(trajectory, controller, actuator, timing)
    z_d, zdot_d, volts = trajectory.position.tolist(), trajectory.velocity.tolist(), notes.volts
    command, adapt, latency = controller.command, controller.adapt, timing.latency
    try:
        for start in range(0, len(z_d), timing.block):
            stop = min(start + timing.block, len(z_d))
            for k in range(start, stop):
                volts[k] = command(z_d[k], zdot_d[k])
                notes.commanded(k)
            measured = actuator.exchange(volts[start:stop])
            for k, z in enumerate(notes.exchanged(start, stop, measured), start):
                if k >= latency:  # what comes back before answers no command
                    adapt(z, stop - 1 - k + latency)
                    notes.adapted(k - latency)
                if k % notes.stride == 0:
                    notes.snapshot()
            notes.done = stop
            if progress and notes.is_hundredth(start, stop):
                progress(stop, len(z_d))
    except (Exception, KeyboardInterrupt) as error:
        raise RunInterrupted(notes.recording(interrupted=repr(error)), error) from error
    return notes.recording()


def _check_types(trajectory: Trajectory, controller: Controller, actuator: Actuator) -> None:
    """SettingError where an argument is none of its kind, before anything moves; two that are swapped are such."""
    order = "; the order is trajectory, controller, actuator"
    made = f"a Trajectory, such as of truestroke.trajectories.sine(){order}"
    checks.instance("trajectory", trajectory, Trajectory, made)
    checks.able("controller", controller, ("command", "adapt"), f"a controller, such as an AdaptiveController{order}")
    checks.able("actuator", actuator, ("open", "exchange"), f"an actuator, such as a plant.RealisticPlant{order}")


def check_agreement(trajectory: Motion, controller: Controller, timing: Timing) -> None:
    """One sample rate everywhere, and measurements that a controller can still place; SettingError otherwise."""
    settings = getattr(controller, "settings", None)
    for whose, rate in (("actuator", timing.sample_rate), ("controller", getattr(settings, "sample_rate", None))):
        if rate is not None and rate != trajectory.sample_rate:
            raise SettingError(
                "trajectory.sample_rate", trajectory.sample_rate, f"{rate} Hz, that of the {whose}", "Hz"
            )
    checks.count("block - 1 + latency", timing.block - 1 + timing.latency, 0, 63)  # `ago` of Controller.adapt


class _Notes:
    """What a run writes down; a measurement goes to the tick of the command that it answers."""

    def __init__(self, trajectory: Trajectory, controller: Any, actuator: Any, timing: Timing) -> None:
        self.trajectory, self.controller, self.actuator, self.timing = trajectory, controller, actuator, timing
        self.metadata = about(trajectory, controller, actuator, timing)
        self.done = 0
        ticks = len(trajectory)
        self.volts, self.measured, self.true, self.innovation = np.full((4, ticks), np.nan)
        self.flags = np.zeros(ticks, np.uint8)
        self.simulated = False  # until the actuator shows its truth
        self.innovative = hasattr(controller, "innovation")
        self.flagged = hasattr(controller, "flag_bits")
        self.stride = max(1, round(SLOW_PERIOD * timing.sample_rate))
        self.slow: list[Any] = []  # what the controller believed after tick 0, stride, 2 stride, ...

    def commanded(self, k: int) -> None:
        if self.flagged:
            self.flags[k] = self.controller.flag_bits & ~BY_ADAPT

    def exchanged(self, start: int, stop: int, measured: FloatArray) -> list[float]:
        if (shape := getattr(measured, "shape", None)) != (stop - start,):
            given = f"a {type(measured).__name__}" if shape is None else f"array of shape {shape}"
            raise SettingError("exchange", given, f"of shape ({stop - start},)", "um")
        latency = self.timing.latency
        if stop > latency:
            first = max(latency - start, 0)  # entries before it answer no command
            self.measured[start + first - latency : stop - latency] = measured[first:]
            if (truth := getattr(self.actuator, "truth", None)) is not None:
                self.simulated = True
                self.true[start + first - latency : stop - latency] = truth[first:]
        values: list[float] = measured.tolist()
        return values

    def adapted(self, k: int) -> None:
        bits = self.controller.flag_bits & BY_ADAPT if self.flagged else 0
        self.flags[k] |= bits
        if self.innovative and not bits & BIT["rejected"]:
            self.innovation[k] = self.controller.innovation

    def snapshot(self) -> None:
        source = getattr(self.controller, "diagnostics", self.controller)
        values = ((name, getattr(source, name, None)) for name in SLOW_CHANNELS)
        self.slow.append({name: np.array(value, np.float64) for name, value in values if value is not None})

    def is_hundredth(self, start: int, stop: int) -> bool:
        """Whether another hundredth of the run was completed between these ticks."""
        ticks = len(self.trajectory)
        return 100 * stop // ticks > 100 * start // ticks

    def recording(self, interrupted: str | None = None) -> Recording:
        """Of the ticks that are done."""
        arrays = {
            "time": self.trajectory.time,
            "desired": self.trajectory.position,
            "desired_velocity": self.trajectory.velocity,
            "volts": self.volts,
            "measured": self.measured,
            **({"true": self.true} if self.simulated else {}),
            **({"innovation": self.innovation} if self.innovative else {}),
            **({"flags": self.flags} if self.flagged else {}),
        }
        channels = {name: Channel(data[: self.done], *CHANNELS[name]) for name, data in arrays.items()}
        ending = {"interrupted": interrupted, "resonance": resonance(self.controller)}
        return Recording(channels | self._slow_channels(), self.metadata | ending)

    def _slow_channels(self) -> dict[str, Channel]:
        slow = self.slow[: -(-self.done // self.stride)]
        names = [name for name in SLOW_CHANNELS if slow and name in slow[0]]
        if not names:
            return {}
        time = self.trajectory.time[: self.done : self.stride]
        return {"weights_time": Channel(time, *SLOW_TIME, "weights_time")} | {
            name: Channel(np.array([entry[name] for entry in slow]), *SLOW_CHANNELS[name], "weights_time")
            for name in names
        }


def resonance(controller: Any) -> float | None:
    """First resonance of the stage, Hz, that the controller was told or has found by now; None if it knows none."""
    known = getattr(controller, "resonance", None)
    return known if isinstance(known, float) and math.isfinite(known) else None


def about(trajectory: Motion, controller: Any, actuator: Any, timing: Timing) -> dict[str, Any]:
    """Metadata of a recording: what is run; SettingError where it cannot be written, before anything moves."""
    metadata = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "interrupted": None,
        "trajectory": {
            "name": trajectory.name,
            "sample_rate": trajectory.sample_rate,
            "ticks": len(trajectory),
            "settings": trajectory.settings,
        },
        "controller": {
            "name": type(controller).__name__,
            "settings": getattr(controller, "settings", {}),
            "parameters": getattr(getattr(controller, "settings", None), "names", ()),
        },
        "plant": {
            "name": type(actuator).__name__,
            "settings": actuator.describe() if hasattr(actuator, "describe") else {},
        },
        "timing": timing,
        "versions": versions(),
    }
    return Recording({}, metadata).metadata
