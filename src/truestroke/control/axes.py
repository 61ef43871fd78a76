"""The controller of two or three axes: one `AdaptiveController` for each, which knows how the others move.

An axis i of a stage takes a part of the motion of the others, and the sensors may be turned against the axes::

    z_i = H_i[x_i] + sum_j c_ij z_j + l_ij z_j' + e_ij z_j'',    s = F z

Desired and measured motion of the sensors become those of the axes by F^-1, which is given. The desired motion of the
others is then known before the voltage is chosen: c, l and e are three more weights for each, which the law of the axis
learns while it runs (`other_axes` of `ControllerSettings`). A small error of F is such a coupling, too.

What is the same in each period of a motion that repeats is learned beside, by `learned_strain`.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, frames, snapshot
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows
from truestroke.base.flags import BIT, Flags
from truestroke.base.typing import FloatArray
from truestroke.control import stage
from truestroke.control.controller import AdaptiveController, Counters, State
from truestroke.control.repeating.learned_strain import BEGIN, LearnedStrain, whole_ticks
from truestroke.control.repeating.turns import Turns, turns_of
from truestroke.control.settings import ControllerSettings
from truestroke.model.dynamics import Dynamics
from truestroke.model.layout import MAX_OTHERS
from truestroke.signals.trajectories import Trajectory

PARTS = ("position", "velocity", "acceleration")
LIMITED = BIT["saturated"] | BIT["slewed"]
REJECTED = BIT["rejected"]


@dataclass(frozen=True, eq=False)
class AxesMotion:
    """A motion of all axes that is known ahead, in their own frame, as their controllers take it.

    Attributes
    ----------
    axes : Mapping[str, Trajectory]
        Motion of each axis.
    strain : ndarray, shape (ticks, axes)
        `AdaptiveController.strain` of each, um; NaN where its `dynamics` are not known.
    others : ndarray, shape (ticks, 3 axes (axes - 1))
        For each axis in turn, of each other one in turn: displacement, velocity and acceleration, through G^-1 of the
        axis that takes them.
    """

    axes: Mapping[str, Trajectory]
    strain: FloatArray
    others: FloatArray

    @functools.cached_property
    def _columns(self) -> list[FloatArray]:
        """Those of `motion`, whose memory is that of the trajectories."""
        return [getattr(one, part) for one in self.axes.values() for part in PARTS]

    def motion(self, ticks: slice) -> FloatArray:
        """Displacement, um, velocity, um/s, and acceleration, um/s^2, of each axis in turn, shape (ticks, 3 axes)."""
        return np.stack([column[ticks] for column in self._columns], axis=1)

    def at(self, tick: int) -> list[float]:
        """The same of one tick."""
        return [column.item(tick) for column in self._columns]

    def positions(self, ticks: slice) -> FloatArray:
        """Displacement of each axis, um, shape (ticks, axes)."""
        return np.stack([one.position[ticks] for one in self.axes.values()], axis=1)


class MultiAxisController(Displayed):
    """Two or three axes that disturb each other, each with an `AdaptiveController`.

    One tick is `command`, the actuator, `adapt`, as of one axis, with an entry for each axis. What an axis takes of the
    motion of the others is learned on line, static and dynamic.

    Parameters
    ----------
    axes : Mapping[str, ControllerSettings]
        Settings of each axis by its name: letters and digits, such as "x". Their `other_axes` are set here. Those of an
        identified model are ``AdaptiveController.from_model(...).settings``.
    frame : array_like, shape (axes, axes), optional
        F: row i is what the sensor of axis i reads of a um of each axis, 1; by default each stands along its axis.
        `truestroke.sensor_frame` makes it from angles. Errors of some per cent are learned.
    period : float, optional
        Of a motion that is known ahead and repeats on one axis or more, or has turns that grow, as a spiral, s: what is
        the same in each period of the error of each axis is learned, too, once half a second has passed. All axes need
        `dynamics` then. A whole number of ticks, 16 to 8192.

    Attributes
    ----------
    names : tuple of str
        Of the axes, in their order.
    axes : Mapping[str, AdaptiveController]
        Their controllers.

    Raises
    ------
    SettingError
        There are not two or three axes, their sample rates differ, the sensors read almost the same, or an axis has no
        `dynamics` where a period is given.

    Examples
    --------
    Two linear axes of 10 um/V; x takes 5 % of y:

    >>> one = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> controller = MultiAxisController({"x": one, "y": one})
    >>> for tick in range(4000):
    ...     a, b = 0.05 * tick, 0.03 * tick
    ...     volts = controller.command(
    ...         [15.0 + 10.0 * np.sin(a), 15.0 + 10.0 * np.sin(b)], [1000.0 * np.cos(a), 600.0 * np.cos(b)]
    ...     )
    ...     z = 10.0 * volts
    ...     controller.adapt([z[0] + 0.05 * z[1], z[1]])
    >>> (controller.coupling.round(3) + 0.0).tolist()
    [[0.0, 0.05], [0.0, 0.0]]
    """

    def __init__(
        self,
        axes: Mapping[str, ControllerSettings],
        frame: npt.ArrayLike | None = None,
        *,
        period: float | None = None,
    ) -> None:
        settings = _checked(axes)
        others = len(settings) - 1
        self.names = tuple(settings)
        self.axes = {name: AdaptiveController.from_settings(s.among(others)) for name, s in settings.items()}
        self.frame = frames.frame("frame", frame, len(settings))
        self.to_axes = np.linalg.inv(np.array(self.frame))
        self.sample_rate = next(iter(settings.values())).sample_rate
        self._rows = self.to_axes.tolist() if not np.array_equal(self.to_axes, np.eye(len(settings))) else None
        self._velocity: list[float] | None = None
        self.period = None if period is None else whole_ticks("period", period, self.sample_rate)
        self.learned = self._strains()
        self._known, self._tick = None, 0

    def _strains(self) -> dict[str, LearnedStrain]:
        """What each axis learns of each period."""
        if self.period is None:
            return {}
        return {
            name: LearnedStrain(_needed(name, axis.settings), self.period, others=i)
            for i, (name, axis) in enumerate(self.axes.items())
        }

    _known: AxesMotion | None

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    # ---- A tick ------------------------------------------------------------------------------------------------------

    def command(
        self, z_d: Sequence[float], zdot_d: Sequence[float], zddot_d: Sequence[float] | None = None
    ) -> FloatArray:
        """Voltages for this tick.

        Parameters
        ----------
        z_d, zdot_d : sequence of float, shape (axes,)
            Desired displacement, um, and velocity, um/s, as the sensors read them.
        zddot_d : sequence of float, optional
            Desired acceleration, um/s^2; by default it follows from the last two velocities.

        Returns
        -------
        ndarray, shape (axes,)
            Voltages at the D/A converter, V.

        Raises
        ------
        SettingError
            There are not as many numbers as axes, or one is NaN or infinite; nothing has changed.
        """
        z, v = self._of_axes("z_d", z_d, "um"), self._of_axes("zdot_d", zdot_d, "um/s")
        a = self._accelerations(v) if zddot_d is None else self._of_axes("zddot_d", zddot_d, "um/s^2")
        self._velocity, self._known = v, None  # what is measured from now on is of no period
        moving = list(zip(z, v, a, strict=True))
        volts = np.empty(len(z))
        for i, axis in enumerate(self.axes.values()):
            others = [number for j, entry in enumerate(moving) if j != i for number in entry]
            position, velocity, acceleration = moving[i]
            volts[i] = axis.command(position, velocity, acceleration, None, others)
        return volts

    def follow(self, known: AxesMotion, tick: int) -> FloatArray:
        """As `command`, for a tick of a motion that `prepare` has made ready: with what lies ahead of it.

        Returns
        -------
        ndarray, shape (axes,)
            V
        """
        n, motion, others = len(self.axes), known.at(tick), known.others[tick].tolist()
        self._velocity, self._known, self._tick = motion[1::3], known, tick
        added = [one.at(tick) for one in self.learned.values()] or [0.0] * n
        volts = np.empty(n)
        for i, (axis, strain) in enumerate(zip(self.axes.values(), known.strain[tick].tolist(), strict=True)):
            position, velocity, acceleration = motion[3 * i : 3 * i + 3]
            taken = others[3 * (n - 1) * i : 3 * (n - 1) * (i + 1)]
            whole = None if strain != strain else strain + added[i]
            volts[i] = axis.command(position, velocity, acceleration, whole, taken)
        return volts

    def adapt(self, z_measured: Sequence[float], ago: int = 0) -> None:
        """Adapt each axis to a measurement; as `AdaptiveController.adapt`.

        Parameters
        ----------
        z_measured : sequence of float, shape (axes,)
            What the sensors read, um, the mean over the tick. NaN and infinity are rejected, flagged and counted.
        ago : int
            Number of commands that were issued after the one of this measurement, 0 to 1023.
        """
        found = self._turned("z_measured", z_measured, "um")
        for axis, z in zip(self.axes.values(), found, strict=True):
            axis.adapt(z, ago)
        if self.learned and self._known is not None and ago <= self._tick:
            tick = self._tick - ago
            desired = self._known.at(tick)[::3]
            for i, (axis, z, one) in enumerate(zip(self.axes.values(), found, self.learned.values(), strict=True)):
                bits = axis.flag_bits
                one.put(tick, math.inf if bits & LIMITED else math.nan if bits & REJECTED else z - desired[i])

    def see(self, known: AxesMotion, tick: int, measured: FloatArray, flags: npt.NDArray[np.uint8]) -> None:
        """What the sensors read in a tick and those that follow it, um, shape (ticks, axes), and the flags of them.

        What is the same in each period of the error is learned, but where a limit held the voltage: there the axis does
        not do what is learned.
        """
        if self._rows is not None:
            turned = [sum(share * measured[:, j] for j, share in enumerate(row)) for row in self._rows]
            measured = np.stack(turned, axis=1)
        error = np.where(flags & REJECTED, np.nan, measured - known.positions(slice(tick, tick + len(measured))))
        error[(flags & LIMITED) > 0] = np.inf
        for i, one in enumerate(self.learned.values()):
            one.see(tick, error[:, i])

    def added(self, ticks: range) -> FloatArray:
        """The strain that is added in some ticks, um, shape (ticks, axes)."""
        return np.stack([one.of(ticks) for one in self.learned.values()], axis=1)

    def _turned(self, argument: str, values: Sequence[float], unit: str) -> list[float]:
        """What the sensors read, as displacements of the axes."""
        found = values.tolist() if isinstance(values, np.ndarray) else list(values)
        if len(found) != len(self.axes):
            words = f"{len(self.axes)} numbers, one for each of the axes {', '.join(self.names)}"
            raise SettingError(argument, values, words, unit)
        if self._rows is None:
            return found
        return [sum(share * value for share, value in zip(row, found, strict=True)) for row in self._rows]

    def _of_axes(self, argument: str, values: Sequence[float], unit: str) -> list[float]:
        """The same of a desired motion, which is finite: checked before any axis has changed."""
        found = values.tolist() if isinstance(values, np.ndarray) else list(values)
        return self._turned(argument, [checks.number(argument, value, unit) for value in found], unit)

    def _accelerations(self, velocity: list[float]) -> list[float]:
        before = velocity if self._velocity is None else self._velocity
        return [(v - last) * self.sample_rate for v, last in zip(velocity, before, strict=True)]

    # ---- A motion that is known ahead -----------------------------------------------------------------------------

    def prepare(self, motion: Mapping[str, Trajectory]) -> AxesMotion:
        """A motion of the sensors, a trajectory for each, as the axes have to follow it.

        Raises
        ------
        SettingError
            There is not one trajectory for each axis, their sample rates or lengths differ, or none repeats `period`,
            nor goes through it in turns that grow or shrink.
        """
        trajectories = in_order(motion, self.names, self.sample_rate)
        turns = None
        if self.period is not None:
            turns = turns_of(trajectories, self.period, round(BEGIN * self.sample_rate))
        own = self._motion_of_axes(trajectories)
        ticks, n = len(trajectories[0]), len(own)
        strain = np.full((ticks, n), np.nan)
        others = np.empty((ticks, 3 * n * (n - 1)))
        for i, (name, one) in enumerate(own.items()):
            if (known := self.axes[name].strain(one.position)) is not None:
                strain[:, i] = known
            del known  # before the next ones: of a long scan some ten MB
            self._take(name, own, others[:, 3 * (n - 1) * i : 3 * (n - 1) * (i + 1)])
        if turns is not None:
            self._follow(own, turns)
        return AxesMotion(axes=own, strain=strain, others=others)

    def _motion_of_axes(self, trajectories: Sequence[Trajectory]) -> dict[str, Trajectory]:
        """What the axes have to follow, so that the sensors read these trajectories."""
        if self._rows is None:
            return dict(zip(self.names, trajectories, strict=True))
        read = {part: np.stack([getattr(one, part) for one in trajectories], axis=1) for part in PARTS}
        turned = {part: values @ self.to_axes.T for part, values in read.items()}
        return {
            name: dataclasses.replace(one, **{part: turned[part][:, i] for part in PARTS})  # type: ignore[arg-type]
            for i, (name, one) in enumerate(zip(self.names, trajectories, strict=True))
        }

    def _follow(self, own: Mapping[str, Trajectory], turns: Turns) -> None:
        """What is learned of each period is of this motion from now on."""
        part, counts = turns.largest, np.ones(turns.period, dtype=bool)
        for one in own.values():
            counts = counts if one.flat is None or not one.flat[part].any() else counts & (one.flat[part] > 0)
        for learned in self.learned.values():
            learned.periods_that_count(turns)  # refused before any axis has changed
        for name, learned in self.learned.items():
            learned.follow(own[name].position[part].copy(), counts, turns)

    def _take(self, name: str, own: Mapping[str, Trajectory], taken: FloatArray) -> None:
        """What the controller of an axis takes of the others, into 3 (axes - 1) columns, one after the other."""
        dynamics = self.axes[name].settings.dynamics
        moving = (getattr(own[other], part) for other in self.names if other != name for part in PARTS)
        for j, column in enumerate(moving):
            taken[:, j] = column if dynamics is None else stage.strain(dynamics, column)

    # ---- All axes together -------------------------------------------------------------------------------------------

    @property
    def coupling(self) -> FloatArray:
        """What the displacement of axis j adds to that of axis i, as learned so far, um/um, shape (axes, axes)."""
        n = len(self.axes)
        found = np.zeros((n, n))
        for i, axis in enumerate(self.axes.values()):
            found[i, np.arange(n) != i] = axis.weights[axis.settings.columns["coupling"]]
        return found

    @property
    def flags(self) -> dict[str, Flags]:
        """The flags of the last tick of each axis."""
        return {name: axis.flags for name, axis in self.axes.items()}

    @property
    def counters(self) -> dict[str, Counters]:
        """How many ticks of each kind there were, of each axis."""
        return {name: axis.counters for name, axis in self.axes.items()}

    @property
    def settings(self) -> dict[str, ControllerSettings]:
        """Of each axis."""
        return {name: axis.settings for name, axis in self.axes.items()}

    def hold(self) -> None:
        """Stop adapting; commands go on with the weights, and with what was learned of each period, as they are."""
        for axis in self._parts().values():
            axis.hold()

    def resume(self) -> None:
        """Adapt again."""
        for axis in self._parts().values():
            axis.resume()

    def reset(self) -> None:
        """Back to the first tick."""
        self._velocity = self._known = None
        self._tick, self.learned = 0, self._strains()
        for axis in self.axes.values():
            axis.reset()

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The complete state after a tick, as named arrays, for `restore`: "x weights", and so on."""
        last = {} if self._velocity is None else {"velocity": np.array(self._velocity)}
        own = last | snapshot.made_with(self._made_with())
        return own | {f"{name} {entry}": a for name, one in self._parts().items() for entry, a in one.state().items()}

    def _parts(self) -> dict[str, AdaptiveController | LearnedStrain]:
        """What has a state, by the first word of its entries."""
        return {**self.axes, **{f"{name}-period": one for name, one in self.learned.items()}}

    def _made_with(self) -> dict[str, Any]:
        """Beside the settings of each axis, which are in its own state."""
        return {"axes": self.names, "frame": self.frame, "period": self.period}

    def restore(self, state: State) -> None:
        """Restore a state of `state`, of a controller with the same axes, settings, frame and period.

        Raises
        ------
        SettingError
            As of `AdaptiveController.restore`; nothing has changed.
        """
        remedy = "make this controller with those of the other one; or go on without its state"
        snapshot.check_made_with(state, self._made_with(), {"period": "ticks"}, remedy)
        before = self.state()
        try:
            for name, one in self._parts().items():
                with checks.inside(f"{name}."):
                    one.restore(_of(name, state))
        except SettingError:
            for name, one in self._parts().items():
                one.restore(_of(name, before))
            raise
        self._known = None
        self._velocity = np.asarray(state["velocity"]).tolist() if "velocity" in state else None

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, axis.settings.summary) for name, axis in self.axes.items()]
        taken = [
            (f"coupling {a} of {b}", f"{self.coupling[i, j]:.4f} um/um")
            for i, a in enumerate(self.names)
            for j, b in enumerate(self.names)
            if i != j
        ]
        return f"{type(self).__name__}: axes {', '.join(self.names)}", [*rows, *taken]


def check_name(name: object) -> None:
    """SettingError for the name of an axis that a file cannot have."""
    if not (isinstance(name, str) and name.isascii() and name.isalnum()):
        raise SettingError("the name of an axis", repr(name), "of letters and digits, such as 'x'")


def in_order(motion: Mapping[str, Trajectory], names: Sequence[str], sample_rate: float | None) -> list[Trajectory]:
    """The trajectory of each axis, in the order of these names.

    Raises
    ------
    SettingError
        There is not one for each axis, or their lengths or sample rates differ, also from `sample_rate`, Hz.
    """
    checks.instance("trajectory", motion, Mapping, "a mapping of the name of each axis to its Trajectory")
    if set(motion) != set(names):
        words = f"one for each of the axes {', '.join(names)}"
        raise SettingError("trajectory", f"motions of {', '.join(map(str, motion)) or 'no axis'}", words)
    for name in names:
        checks.instance(f"trajectory[{name!r}]", motion[name], Trajectory, "a Trajectory")
    first = motion[names[0]]
    whose = f"that of {names[0]}" if sample_rate is None else "that of the controllers"
    rate = first.sample_rate if sample_rate is None else sample_rate
    for name, one in ((name, motion[name]) for name in names):
        if one.sample_rate != rate:
            raise SettingError(f"trajectory[{name!r}].sample_rate", one.sample_rate, f"{rate:g} Hz, {whose}", "Hz")
        if len(one) != len(first):
            bound = f"{len(first)}, as of {names[0]}, {len(first) / rate:g} s"
            raise SettingError(f"trajectory[{name!r}]", len(one), bound, "ticks")
    return [motion[name] for name in names]


def _of(name: str, state: State) -> dict[str, npt.NDArray[Any]]:
    """The entries of a part of a state."""
    return {key.removeprefix(f"{name} "): a for key, a in state.items() if key.startswith(f"{name} ")}


def _needed(name: str, settings: ControllerSettings) -> Dynamics:
    """The dynamics of an axis, which learns what repeats through them."""
    if settings.dynamics is None:
        bound = "the dynamics of the axis where a period is given, as `truestroke bode` measures them"
        raise SettingError(f"axes[{name!r}].dynamics", None, bound)
    return settings.dynamics


def _checked(axes: Mapping[str, ControllerSettings]) -> dict[str, ControllerSettings]:
    """Two or three settings of one sample rate, by names that a file can have."""
    checks.instance("axes", axes, Mapping, "a mapping of the name of each axis to its ControllerSettings")
    checks.count("the number of axes", len(axes), 2, MAX_OTHERS + 1)
    words = "a ControllerSettings; that of an AdaptiveController is its attribute settings"
    first = next(iter(axes))
    for name, settings in axes.items():
        check_name(name)
        checks.instance(f"axes[{name!r}]", settings, ControllerSettings, words)
        if settings.law != "kalman":
            raise SettingError(f"axes[{name!r}].law", repr(settings.law), "'kalman': (23) has no scale for coupling")
        if settings.sample_rate != (rate := axes[first].sample_rate):
            raise SettingError(
                f"axes[{name!r}].sample_rate", settings.sample_rate, f"{rate:g} Hz, that of {first}", "Hz"
            )
    return dict(axes)
