"""The whole controller in NumPy: the algorithm of the C kernel, readable beside the paper (Sec. 3, Fig. 5).

The kernel's tests compare with it to the last bit. Use it to try a law or a model first. It is
some hundred times slower: `AdaptiveController` is for the loop.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows
from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import RLS, Law
from truestroke.control.controller import controller_rows
from truestroke.control.reference.adapt import check_weights, measure, pass_over
from truestroke.control.reference.command import (
    HANDS_OVER,
    acceleration,
    ahead_of,
    bounded,
    inverse,
    keep_command,
    others_of,
    rate_dependent_slopes,
    sum_of_plays,
    wanted,
    wanted_of_plays,
    within_limits,
)
from truestroke.control.reference.found import forget_stage
from truestroke.control.reference.hum import Hum, subtracted
from truestroke.control.reference.learned import keep_start
from truestroke.control.reference.state import HISTORY, Command, Memory, State, StateShown, kalman_settings, law_of
from truestroke.control.reference.terms import before_amplifier, of_known_terms, remember_creep, remember_voltage
from truestroke.control.settings import CHANGEABLE, SETTINGS, ControllerSettings
from truestroke.control.stage import strain_of
from truestroke.model.models import Motion
from truestroke.model.operators import play


class ReferenceController(StateShown, Displayed):
    """`AdaptiveController` in NumPy, with any law.

    Parameters
    ----------
    settings : ControllerSettings
        The same settings; `precision` must be "double".
    law : Law, optional
        What adapts the weights: an object with `weights`, shape (m,), in the order of the settings, and
        `update(u, e_m)`. By default the one of the settings: `BoundedKalman` or `RLS`. A law of your own is updated at
        every measured tick; spikes, changes and the limits of the slopes are those of `BoundedKalman` alone.

    Attributes
    ----------
    settings : ControllerSettings
        As given.
    law : Law
        The law in use; `reset` puts a copy of the one that was given in its place.
    counters : dict[str, int]
        Commands, adaptations, and saturated, projected, rejected, changed and slewed ticks since the start or the last
        reset.

    Raises
    ------
    SettingError
        `precision` is not "double", or the law has no update(u, e_m), or other weights than an array of as many finite
        numbers as the settings have parameters.

    Examples
    --------
    >>> settings = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> controller = ReferenceController(settings)
    >>> for tick in range(200):
    ...     z_d = 15.0 + 10.0 * np.sin(0.05 * tick)
    ...     volts = controller.command(z_d, 0.05 * 2000.0 * 10.0 * np.cos(0.05 * tick))
    ...     controller.adapt(10.0 * volts)
    >>> round(controller.command(10.0, 0.0), 2)
    1.0
    """

    def __init__(self, settings: ControllerSettings, law: Law | None = None) -> None:
        checks.instance("settings", settings, ControllerSettings, "a ControllerSettings, and a law comes after it")
        if settings.precision != "double":
            raise SettingError(
                "precision", repr(settings.precision), "'double': NumPy states the paper in double alone"
            )
        law = law_of(settings) if law is None else law
        checks.able("law", law, ("update",), "a law, an object with weights and update(u, e_m)")
        checks.takes("law.update", law.update, None, 0.0, form="update(u, e_m)")
        check_weights(law, settings.parameters)
        self._state = State(settings, law)
        self.reset()

    @property
    def settings(self) -> ControllerSettings:
        """As given, or as `change` made them."""
        return self._state.settings

    @property
    def law(self) -> Law:
        """The law in use; `reset` puts a copy of the one that was given in its place."""
        return self._state.law

    @property
    def counters(self) -> dict[str, int]:
        """Ticks of each kind since the start or the last reset."""
        return self._state.counters

    def reset(self) -> None:
        """Back to the first tick: plays at 0 V, the law as it was given, counters at zero, not on hold."""
        c = self._state
        c.begin()
        forget_stage(c)
        keep_start(c)
        c.slopes, _ = rate_dependent_slopes(c, 0.0)

    def start(self, volts: float, z: float) -> None:
        """Start with an actuator that rests at z, um, under `volts`, V: the command for z is `volts`.

        The difference between z and the model is added to the offset where there is one, otherwise to the next
        commands.
        """
        c, s = self._state, self.settings
        low, high = s.voltage_limits
        volts, z = checks.within("volts", volts, low, high, "V"), checks.number("z", z, "um")
        s.check_reach("z", z, volts)
        self.reset()
        creep, duhem = np.full(c.creep_rates.size, volts), np.full(c.duhem_lengths.size, volts)
        c.now = Memory(play(volts, c.thresholds, c.now.play), creep, duhem)
        c.lagged = copy.deepcopy(c.now)
        missing = wanted_of_plays(c, Motion(z, 0.0)) - sum_of_plays(c)
        if s.offset:
            weights = self.weights
            weights[s.columns["offset"]] += missing
            c.law.weights = weights
        else:
            c.bumpless = -missing
        c.stage.older = c.stage.newer = self.weights
        keep_start(c)

    def strain(self, position: FloatArray) -> FloatArray | None:
        """`strain_d` of a motion that is known ahead, um; None where the dynamics are not known."""
        return strain_of(self.settings.dynamics, checks.finite_array("position", position, "um"))

    def change(self, settings: ControllerSettings | None = None, **changes: Any) -> None:
        """New settings while running, or some of them by name, without a jump of the command.

        Only those in `CHANGEABLE` may differ.

        Raises
        ------
        SettingError
            Another differs; nothing has changed.
        """
        checks.known(changes, SETTINGS)
        settings = (settings or self.settings).changed(changes)
        for name in SETTINGS.keys() - set(CHANGEABLE):
            if getattr(settings, name) != getattr(self.settings, name):
                words = "as it was: a controller that runs keeps its law, model and prior"
                raise SettingError(name, getattr(settings, name), words, SETTINGS[name].unit)
        c, before = self._state, self._state.members
        c.take(settings)
        c.stage.detector.settings = c.oscillation
        c.kept.guard.settings = c.kept.recall.settings = c.guarding
        if any(before[name] != c.members[name] for name in ("kalman.filter", "smoothing", "resonance")):
            forget_stage(c)
        if before["hum.lines"] != c.members["hum.lines"]:  # each begins anew
            c.hum = replace(
                Hum(), turn=c.hum.turn, ears=c.hum.ears, subtracted=c.hum.subtracted, unexplained=c.hum.unexplained
            )
        if c.filtering is not None:
            c.filtering.take(kalman_settings(settings))
        elif isinstance(c.law, RLS):
            c.law.forgetting, c.law.covariance_limit = settings.forgetting, settings.covariance_limit
        if not settings.trim_rate > 0:
            c.integral = 0.0  # its share goes into the bumpless transfer
        keep_command(c)

    def command(
        self,
        z_d: float,
        zdot_d: float,
        zddot_d: float | None = None,
        strain_d: float | None = None,
        others: Sequence[float] | None = None,
    ) -> float:
        """Voltage, V, for the desired displacement z_d, um, and velocity zdot_d, um/s; the play states advance.

        zddot_d, um/s^2, and strain_d, um, of `AdaptiveController.strain` are used where they are known, and so are
        `others`: displacement, velocity and acceleration of each other axis, um, um/s, um/s^2.

        Raises
        ------
        SettingError
            An argument is NaN or infinite; nothing has changed.
        """
        c = self._state
        z_d, zdot_d = bounded("z_d", z_d, "um"), bounded("zdot_d", zdot_d, "um/s")
        zddot_d = None if zddot_d is None else bounded("zddot_d", zddot_d, "um/s^2")
        strain_d = None if strain_d is None else bounded("strain_d", strain_d, "um")
        moving = others_of(others, c.settings.other_axes)
        if c.counters["commands"] - c.measured_ticks >= c.patience:
            pass_over(c)  # a measurement of it would be too late now
        remember_creep(c, c.now)
        zddot_d = acceleration(c, zdot_d) if zddot_d is None else zddot_d
        ahead = (
            ahead_of(c, zdot_d, zddot_d, c.counters["commands"])
            if strain_d is None or c.stage.found
            else strain_d - z_d
        )
        c.hum.subtracted, against_hum = subtracted(c)
        motion = Motion(z_d, zdot_d, zddot_d, ahead - against_hum, moving)
        known = of_known_terms(c, motion)
        y_d = wanted(c, motion) - known  # (11)
        c.slopes, c.projected = rate_dependent_slopes(c, zdot_d)  # (7)
        x = within_limits(c, before_amplifier(c, c.now, inverse(c, y_d)))
        remember_voltage(c, c.now, x)  # (1)
        c.bumpless *= c.stage.smoothing
        c.handed *= 1 - c.members["dynamics.first"] / HANDS_OVER
        c.fastest = max(c.fastest, min(abs(zdot_d), c.settings.velocity_limit))
        c.last = Command(x, motion, c.saturated or c.slewed)
        if c.filtering is not None:
            tick = c.counters["commands"]
            c.stage.strain[tick] = sum_of_plays(c) + (of_known_terms(c, motion) if c.now.duhem.size else known)
            c.stage.strain.pop(tick - HISTORY, None)
            if c.path is not None:
                c.path.strain[tick] = c.stage.strain[tick]
        c.waiting[c.counters["commands"]] = c.last
        c.count(commands=True, saturated=c.saturated, projected=c.projected, slewed=c.slewed)
        return x

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Adapt to the displacement, um, measured for the command `ago` commands before the last one, 0 to 1023.

        NaN, infinity, a spike, and a measurement older than one already used are rejected, flagged and counted.

        Raises
        ------
        SettingError
            The first measurement, within 1024 ticks, is beyond the reach of the voltage, or an argument is no number:
            nothing has changed.
        """
        c = self._state
        z_measured, ago = checks.measurement(z_measured, ago)
        if 0 <= ago < min(HISTORY, c.counters["commands"]):
            ago += c.sensor.ticks
            c.answered = ago + 1
            if ago >= c.counters["commands"]:  # it shows what was before the first command
                c.changed = c.rejected = False
                return
        tick = c.counters["commands"] - 1 - ago
        in_time = 0 <= ago < c.waits and c.measured_ticks <= tick and tick in c.waiting
        if in_time and c.measured_ticks == 0 and math.isfinite(z_measured):
            c.settings.check_reach("z_measured", z_measured, c.waiting[tick].x)
        used = in_time and abs(z_measured) <= c.settings.measurement_limit
        c.changed = False
        if used:
            while c.measured_ticks < tick:
                pass_over(c)
            used = measure(c, z_measured)
        elif in_time and c.measured_ticks > 0:  # lost: in its own tick, so that the next one does not take long
            while c.measured_ticks <= tick:
                pass_over(c)
        c.rejected = not used
        c.count(rejected=c.rejected, adaptations=not (c.rejected or c.held), changed=c.changed)

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def _display(self) -> tuple[str, Rows]:
        title = f"ReferenceController: {type(self.law).__name__}, {self.settings.summary}"
        return title, controller_rows(self.settings, self.weights, self.innovation, self.counters)

    def hold(self) -> None:
        """Stop adapting; commands continue with the weights as they are."""
        self._state.held = True

    def resume(self) -> None:
        """Adapt again."""
        self._state.held = False

    @property
    def play_states(self) -> FloatArray:
        """Forward play states after the last command, shape (n,), V."""
        return self._state.now.play.copy()
