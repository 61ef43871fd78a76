"""The adaptive inverse controller (Sec. 3, Fig. 5): `command`, then `adapt`, once a tick, in the C kernel."""

from __future__ import annotations

import copy
import dataclasses
import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, Unpack

import numpy as np
import numpy.typing as npt

from truestroke import _kernel, _kernel32
from truestroke.base import checks, declared, snapshot
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.flags import Flags
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility, stage
from truestroke.control.options import ChangeableOptions, SettingsOptions
from truestroke.control.settings import CHANGEABLE, SETTINGS, ControllerSettings, kernel_settings

if TYPE_CHECKING:
    from truestroke.control.actuator import ActuatorModel

State = Mapping[str, npt.NDArray[Any]]
REMEDY = (
    "make this controller with the settings of the other one, restore, then `change` it; or go on without its state"
)


class Controller(Protocol):
    """A controller of the loop: a command before the tick, a measurement after it."""

    def command(self, z_d: float, zdot_d: float) -> float:
        """Voltage (V) for the desired displacement (um) and velocity (um/s) of this tick."""

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Adapt to the displacement (um) measured for the command `ago` commands before the last one."""


@dataclass(frozen=True, slots=True)
class Counters:
    """How often it happened since the start or the last reset: ticks, by kind."""

    commands: int
    adaptations: int
    saturated: int
    projected: int
    rejected: int
    changed: int
    slewed: int
    oscillating: int
    restored: int


@dataclass(frozen=True, slots=True, eq=False)
class Diagnostics:
    """State of the model after the last tick.

    Attributes
    ----------
    innovation : float
        e_m of (15): measurement minus model, um.
    weights : ndarray, shape (m,)
        w = [a0, b0, a1, b1, ...] of (21), um/V, and those of the other terms, as `ControllerSettings` orders them.
    partial_slopes : ndarray, shape (n,)
        Slopes of the hysteresis branches at the last rate, as the inverse used them, um/V.
    play_states : ndarray, shape (n,)
        Forward play states after the last command, V.
    trace_P : float
        Trace of the covariance, 1/V^2.
    """

    innovation: float
    weights: FloatArray
    partial_slopes: FloatArray
    play_states: FloatArray
    trace_P: float  # noqa: N815 (the paper's symbol)


def controller_rows(
    settings: ControllerSettings, weights: FloatArray, innovation: float, counters: Mapping[str, int]
) -> list[tuple[str, str]]:
    """What a controller shows of itself: settings of the actuator, first weight and offset, counts."""
    listed = (
        "sample_rate",
        "stroke",
        "voltage_limits",
        "slew_limit",
        "measurement_limit",
        "smoothing_time",
        "trim_rate",
    )
    names = dict(zip(settings.names, weights.tolist(), strict=True))
    shown = [name for name in ("a0", "offset") if name in names]
    return [
        *declared.rows(settings, {name: SETTINGS[name] for name in listed}),
        *([("feedback", settings.feedback.summary)] if settings.dynamics is not None else []),
        *[(f"weight {name}", quantity(names[name], settings.units[settings.names.index(name)])) for name in shown],
        ("innovation", quantity(innovation, "um")),
        *[(name, quantity(count, "ticks")) for name, count in counters.items()],
    ]


@contextmanager
def _as_setting(settings: ControllerSettings) -> Iterator[None]:
    """What the kernel refuses, of settings that are within their bounds, is too much for its number type."""
    try:
        yield
    except ValueError as error:
        raise SettingError("precision", repr(settings.precision), f"wider for these settings: {error}") from None


class AdaptiveController(Displayed):
    """Feedforward through the inverse of a rate-dependent hysteresis model that learns while it runs.

    One tick is `command`, the actuator, `adapt`::

        x(t)   = Gamma^-1[z_d, zdot_d](t)                      (9)-(12)
        e_m(t) = w_s'.S_d'[z_a] - w.u(t)                       (15)
        w     += mu e_m                                        (23)

    The default law is a Kalman filter of weights that vary about a prior, which follows from stroke and voltage
    limits; it stays bounded under any input. The model has more plays than the paper's, and terms of creep, lag, offset
    and asymmetry that are known before the voltage is chosen. `paper` is the literal algorithm.

    Parameters
    ----------
    sample_rate : float
        Ticks per second, Hz.
    stroke : float
        Length of the travel that is asked for, um.
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V at the D/A converter.
    **settings
        Any other member of `ControllerSettings`.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    A linear actuator of 10 um/V is learned in a few ticks:

    >>> controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> for tick in range(200):
    ...     z_d = 15.0 + 10.0 * np.sin(0.05 * tick)
    ...     volts = controller.command(z_d, 0.05 * 2000.0 * 10.0 * np.cos(0.05 * tick))
    ...     controller.adapt(10.0 * volts)
    >>> round(controller.command(7.5, 0.0), 2)
    0.75
    """

    def __init__(
        self,
        *,
        sample_rate: float,
        stroke: float,
        voltage_limits: tuple[float, float],
        **settings: Unpack[SettingsOptions],
    ) -> None:
        checks.known(settings, SETTINGS)
        others: dict[str, Any] = {**settings}  # None is filled in
        self._start(ControllerSettings(sample_rate=sample_rate, stroke=stroke, voltage_limits=voltage_limits, **others))

    @classmethod
    def from_settings(cls, settings: ControllerSettings) -> AdaptiveController:
        """A controller with these settings."""
        words = "a ControllerSettings; AdaptiveController(sample_rate=, ...) takes its members"
        checks.instance("settings", settings, ControllerSettings, words)
        controller = cls.__new__(cls)
        controller._start(settings)
        return controller

    @classmethod
    def from_model(
        cls,
        model: ActuatorModel | str | os.PathLike[str],
        *,
        sample_rate: float,
        voltage_limits: tuple[float, float] | None = None,
        **settings: Unpack[SettingsOptions],
    ) -> AdaptiveController:
        """A controller that starts with an identified model, as sure of it as the record allows.

        Parameters
        ----------
        model : ActuatorModel, str or PathLike
            The model or its file. Displacements are counted from its `zero`.
        sample_rate : float
            Ticks per second, Hz.
        voltage_limits : tuple[float, float], optional
            Lowest and highest output voltage, V; by default those of the record.
        **settings
            Any other member of `ControllerSettings` that is not about the model. `dynamics`, of
            `truestroke.measure_dynamics` or the path of its file, replace delay, time constant, lag and resonances of
            the record.

        Raises
        ------
        SettingError
            A setting is out of bounds, or the `dynamics` are of a stage with another first resonance than the record.
        ModelFileError
            The file is no model.
        BadModelError
            The verdict of the model in the file is bad; `load_model` reads it all the same.

        Warns
        -----
        ModelWarning
            The verdict of the model in the file is doubtful, or that of an `ActuatorModel` bad; once for each model.

        Notes
        -----
        The covariance of the prior is that of the record, plus a share of the default one: `ActuatorModel.another_day`.
        """
        from truestroke.control.model_file import taken

        known = taken(model)
        limits = {} if voltage_limits is None else {"voltage_limits": voltage_limits}
        checks.known(settings, SETTINGS)
        return cls.from_settings(known.start(sample_rate, **limits, **settings))

    @classmethod
    def paper(cls, *, sample_rate: float, stroke: float, voltage_limits: tuple[float, float]) -> AdaptiveController:
        """The literal algorithm of the paper: the baseline that everything else is compared with.

        8 plays, w(0) = [5, 0, ...], c_b = 0.007 s/um, recursive least squares with a fixed forgetting factor. Added
        are only the guards without which it is not defined: partial slopes are kept above 5 % of q in the inverse,
        P stops growing at `covariance_limit`, and a measurement beyond `measurement_limit` is rejected.

        Examples
        --------
        >>> controller = AdaptiveController.paper(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
        >>> controller.command(10.0, 0.0)
        2.0
        """
        return cls.from_settings(
            ControllerSettings.paper(sample_rate=sample_rate, stroke=stroke, voltage_limits=voltage_limits)
        )

    def _start(self, settings: ControllerSettings) -> None:
        self.settings = settings
        self._written: tuple[ControllerSettings, snapshot.Arrays] | None = None
        kernel = _kernel.Kernel if settings.precision == "double" else _kernel32.Kernel
        with _as_setting(settings):
            self._kernel = kernel(kernel_settings(settings))
        self._motion = feasibility.UnknownMotion(settings)
        if type(self) is AdaptiveController:  # the kernel's own call saves a frame of Python, 35 ns
            vars(self).update(adapt=self._kernel.adapt)

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def _display(self) -> tuple[str, Rows]:
        found = [("resonance", quantity(self.resonance, "Hz")), ("noise", quantity(self.noise, "um"))]
        frequency, amplitude = self.load
        if amplitude > 0:
            found.append(("load", f"{quantity(amplitude, 'um')} at {quantity(frequency, 'Hz')}, which `hum` names"))
        frequency, amplitude = self.beyond_resonance
        if amplitude > 0:
            heard = f"{quantity(amplitude, 'um')} at {quantity(frequency, 'Hz')}"
            found.append(("beyond the resonance", f"{heard} are not in the dynamics: measure them again"))
        return f"{type(self).__name__}: {self.settings.summary}", [
            *controller_rows(self.settings, self.weights, self.innovation, dataclasses.asdict(self.counters)),
            *found,
        ]

    def __getstate__(self) -> dict[str, Any]:
        own = {
            name: value
            for name, value in vars(self).items()
            if name not in ("_kernel", "_written") and getattr(value, "__self__", None) is not self._kernel
        }
        return {"own": own, "kernel": self._kernel.state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state["own"])
        self._start(self.settings)
        self._kernel.restore(state["kernel"])

    def command(
        self,
        z_d: float,
        zdot_d: float,
        zddot_d: float | None = None,
        strain_d: float | None = None,
        others: Sequence[float] | None = None,
    ) -> float:
        """Voltage for this tick; the forward play states advance.

        Parameters
        ----------
        z_d : float
            Desired displacement, um.
        zdot_d : float
            Desired velocity, um/s.
        zddot_d : float, optional
            Desired acceleration, um/s^2: used where the stage's `dynamics` are known, or the model has the term
            `inertia`. By default it follows from the last two velocities, a tick late.
        strain_d : float, optional
            Where the stage's `dynamics` are known and the motion, too: the entry of `strain` for this tick, um. By
            default it follows from the three others, which is right for motion that is slow against the resonance.
        others : sequence of float, optional
            Where `other_axes` are set: desired displacement, um, velocity, um/s, and acceleration, um/s^2, of each of
            them in turn. By default they rest at 0. `MultiAxisController` does this by itself.

        Returns
        -------
        float
            Voltage at the D/A converter, V, within `voltage_limits`.

        Raises
        ------
        SettingError
            An argument is no number, NaN or infinite; nothing has changed.

        Warns
        -----
        LimitWarning
            The default slew limit has held a motion back for 0.1 s: once, with what it needs.
        """
        volts = self._kernel.command(z_d, zdot_d, zddot_d, strain_d, others)
        if abs(zdot_d) > self._motion.unhindered and (words := self._motion.held(z_d, zdot_d, self.flags)):
            warnings.warn(words, feasibility.LimitWarning, stacklevel=2)
        return volts

    def strain(self, position: npt.ArrayLike) -> FloatArray | None:
        """The displacement to ask of the hysteresis for a motion that is known ahead: `strain_d` of `command`.

        Parameters
        ----------
        position : array_like, shape (ticks,)
            The whole motion, um, from rest.

        Returns
        -------
        ndarray, shape (ticks,), or None
            G^-1 z_d, um; None where `dynamics` are not known. `truestroke.run` does this by itself.

        Examples
        --------
        >>> from truestroke import Dynamics, Mode
        >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
        >>> known = AdaptiveController(sample_rate=10000.0, stroke=30.0, voltage_limits=(0.0, 4.0), dynamics=stage)
        >>> time = np.arange(10000) / 10000.0
        >>> wave = 5 - 5 * np.cos(2 * np.pi * 70.0 * time)
        >>> round(float(np.ptp(known.strain(wave)[3000:7000])), 2), round(float(np.ptp(wave)), 2)
        (9.9, 10.0)
        """
        return stage.strain_of(self.settings.dynamics, checks.finite_array("position", position, "um"))

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Adapt to a measurement; it may be left out for a tick.

        Parameters
        ----------
        z_measured : float
            Displacement, um, the mean over the tick. NaN and infinity are rejected, flagged and counted.
        ago : int
            Number of commands that were issued after the one of this measurement, 0 to 1023. Measurements come in
            the order of their commands; one that is older than a measurement already used is rejected.

        Raises
        ------
        SettingError
            The first measurement since the start, within 1024 ticks, is further from 0 than
            `ControllerSettings.reach` of the voltage: the sensor is not zeroed, or another's. Nothing has changed.
        """
        self._kernel.adapt(z_measured, ago)

    def process(
        self,
        z_d: npt.ArrayLike,
        zdot_d: npt.ArrayLike,
        z_measured: npt.ArrayLike | None = None,
        *,
        ago: int = 0,
    ) -> FloatArray:
        """A block of ticks: `command`, then `adapt` with the measurement that came in at that tick, for each of them.

        Parameters
        ----------
        z_d, zdot_d : array_like, shape (ticks,)
            Desired displacement, um, and velocity, um/s.
        z_measured : array_like, shape (ticks,), optional
            Measurements, um; each belongs to the command `ago` ticks before its own. Left out: commands alone.
        ago : int
            Latency between a command and its measurement, ticks, 0 to 1023.

        Returns
        -------
        ndarray, shape (ticks,)
            Voltages, V.
        """
        z_d, zdot_d = checks.finite_array("z_d", z_d, "um"), checks.finite_array("zdot_d", zdot_d, "um/s")
        volts = np.empty_like(z_d)
        measured = None if z_measured is None else checks.signal("z_measured", z_measured, "um")
        ago = checks.count("ago", ago, 0, _kernel.HISTORY - 1)
        self._kernel.process(np.ascontiguousarray(z_d), np.ascontiguousarray(zdot_d), measured, volts, ago)
        return volts

    def hold(self) -> None:
        """Stop adapting; commands go on with the weights as they are."""
        self._kernel.hold(True)

    def resume(self) -> None:
        """Adapt again."""
        self._kernel.hold(False)

    def reset(self) -> None:
        """Back to the first tick: plays at 0 V, w(0), P(0), counters at zero."""
        self._kernel.reset()

    def start(self, volts: float, z: float) -> None:
        """Start with an actuator that rests at z (um) under `volts` (V), without a jump: the command for z is `volts`.

        Everything that was learned is forgotten, as by `reset`.

        Raises
        ------
        SettingError
            `volts` are beyond their limits, or z is further from 0 than `ControllerSettings.reach` of `volts`: zero the
            sensor, or subtract its reading at rest. Nothing has changed.

        Examples
        --------
        >>> controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
        >>> controller.start(volts=1.5, z=11.0)
        >>> round(controller.command(11.0, 0.0), 12)
        1.5
        """
        low, high = self.settings.voltage_limits
        volts, z = checks.within("volts", volts, low, high, "V"), checks.number("z", z, "um")
        self.settings.check_reach("z", z, volts)
        self._kernel.start(volts, z)

    def change(
        self, *, voltage_limits: tuple[float, float] | None = None, **settings: Unpack[ChangeableOptions]
    ) -> None:
        """Change settings while running; what was learned stays, and the command does not jump.

        Parameters
        ----------
        voltage_limits : tuple[float, float], optional
            Lowest and highest output voltage, V.
        **settings
            Members of `ControllerSettings` that are about the law or about safety. The terms of the model, its
            thresholds, the law and the precision stay as they are: for others make a new controller.

        Raises
        ------
        SettingError
            The setting does not exist, is out of bounds, or would change the model; nothing has changed.

        Examples
        --------
        >>> controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
        >>> controller.change(trim_rate=20.0)
        >>> controller.settings.trim_rate
        20.0
        """
        given: dict[str, Any] = (
            {**settings} if voltage_limits is None else {"voltage_limits": voltage_limits, **settings}
        )
        checks.known(given, SETTINGS)
        for name in given.keys() - set(CHANGEABLE):
            words = f"left out: it is fixed while a controller runs, which can change {', '.join(CHANGEABLE)}"
            raise SettingError(name, given[name], words, SETTINGS[name].unit)
        changed = self.settings.changed(given)
        with _as_setting(changed):
            self._kernel.change(kernel_settings(changed))
        if changed.slew_limit != self.settings.slew_limit:
            self._motion = feasibility.UnknownMotion(changed)
        self.settings = changed

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The complete state after a tick, as named arrays, for `restore`.

        A run that is interrupted, saved with ``np.savez(file, **controller.state())``, restored and continued is
        equal to the last bit to one that was not.
        """
        return self._kernel.state() | self._made_with()

    def _made_with(self) -> snapshot.Arrays:
        """The settings as an entry of the state; made once for each settings, as that takes a millisecond."""
        if self._written is None or self._written[0] is not self.settings:
            self._written = self.settings, snapshot.made_with(self.settings.to_dict())
        return self._written[1]

    def restore(self, state: State) -> None:
        """Restore a state of `state`, of a controller with the same settings.

        Raises
        ------
        SettingError
            The state is of other settings, which are named. An entry is missing, has another size, is not finite, or
            is impossible (a negative variance, a flag that is neither 0 nor 1, counters that contradict each other).
            Nothing has changed.

        Examples
        --------
        >>> saved = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(0.0, 4.0)).state()
        >>> other = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(0.0, 4.0), trim_rate=20.0)
        >>> other.restore(saved)
        Traceback (most recent call last):
            ...
        truestroke.SettingError: state = one made with trim_rate 0 1/s: must be one made with trim_rate 20 1/s, as \
here: make this controller with the settings of the other one, restore, then `change` it; or go on without its state
        >>> other.change(trim_rate=0.0)
        >>> other.restore(saved)
        """
        units = {name: setting.unit for name, setting in SETTINGS.items()}
        follow = [name for name, setting in SETTINGS.items() if setting.rule is not None]
        snapshot.check_made_with(state, self.settings.to_dict(), units, REMEDY, follow)
        arrays = {name: np.ascontiguousarray(value) for name, value in state.items()}
        try:
            self._kernel.restore(arrays)
        except ValueError as error:
            raise SettingError(
                "state", f"{len(arrays)} entries", f"what `state` gave, with these settings and this version: {error}"
            ) from None

    @property
    def weights(self) -> FloatArray:
        """w = [a0, b0, a1, b1, ...] of (21), um/V, and those of the other terms, shape (m,)."""
        return np.asarray(self._kernel.weights(), dtype=np.float64)

    @property
    def innovation(self) -> float:
        """e_m of (15) at the last measurement, um."""
        return self._kernel.innovation()

    @property
    def covariance(self) -> FloatArray:
        """P, shape (m, m), in the squares of the units of the weights (for (23): 1/V^2)."""
        return np.asarray(self._kernel.covariance(), dtype=np.float64).reshape(self.weights.size, -1)

    @property
    def resonance(self) -> float:
        """First resonance of the stage in the model, Hz: as it was found while the loop ran, or as set; or NaN."""
        known = self._kernel.resonance() * self.settings.sample_rate
        given = self.settings.dynamics
        return known if given is None or known > 0 else given.modes[0].frequency

    @property
    def load(self) -> tuple[float, float]:
        """Frequency, Hz, and amplitude, um, of a load that nobody has named with `hum`, and that was heard; or NaN.

        The louder one, where there are two; one that does not exceed `noise` is not stated. It is listened for below
        half of the first resonance; below 125 Hz where that is not known.
        """
        turns, amplitude = self._kernel.load()
        return turns * self.settings.sample_rate, amplitude

    @property
    def beyond_resonance(self) -> tuple[float, float]:
        """Frequency, Hz, and amplitude, um, of a tone above 2.2 f0 that the given dynamics do not explain; or NaN.

        Such as a further mode that the measurement did not see. The louder one, where there are two, with the amplitude
        in the error when it was heard; one that does not exceed `noise` is not stated. From then on law and feedback
        work without it, so that it may have become quiet.
        """
        turns, amplitude = self._kernel.beyond()
        return turns * self.settings.sample_rate, amplitude

    @property
    def filter_frequency(self) -> float:
        """Present corner of the law's filter, Hz: lower than set where the law excited a resonance; NaN for "rls"."""
        return -math.log1p(-self._kernel.filter()) * self.settings.sample_rate / (2 * math.pi)

    @property
    def noise(self) -> float:
        """Standard deviation of the measurement as estimated on line, um; NaN for "rls", which has no estimate."""
        return self._kernel.noise()

    @property
    def flag_bits(self) -> int:
        """The flags of the last tick as a bit mask; `truestroke.base.flags` and docs/conventions.md have the bits."""
        return self._kernel.flags()

    @property
    def flags(self) -> Flags:
        """The flags of the last tick."""
        return Flags.from_bits(self._kernel.flags())

    @property
    def counters(self) -> Counters:
        """How many ticks of each kind there were."""
        return Counters(*map(int, self._kernel.counters()))

    @property
    def diagnostics(self) -> Diagnostics:
        """State of the model after the last tick; a copy, so that it stays as it is."""
        arrays = [
            np.asarray(a, dtype=np.float64)
            for a in (self._kernel.weights(), self._kernel.slopes(), self._kernel.play())
        ]
        for array in arrays:
            array.flags.writeable = False
        weights, slopes, play = arrays
        return Diagnostics(self._kernel.innovation(), weights, slopes, play, self._kernel.trace())
