"""The whole controller in NumPy: what the C kernel does, readable beside the paper (Sec. 3, Fig. 5).

It is the oracle of the kernel's tests, equal to it to the last bit, and the place to try a law or a model first. It is
some hundred times slower: `AdaptiveController` is for the loop.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np

from truestroke import _check
from truestroke._check import SettingError
from truestroke._typing import FloatArray
from truestroke.adaptation import RLS, Law, UpdateRefused
from truestroke.models import lift_slopes, play_inverse
from truestroke.operators import dead_zone, dot, play
from truestroke.settings import ControllerSettings

HISTORY = 64
"""Commands that may wait for their measurement: `ago` is at most one less. TS_HISTORY of the kernel."""


@dataclass
class _Tick:
    """What a tick leaves behind, in the order in which Fig. 5 makes it."""

    play_states: FloatArray  # forward play states after the last command, V
    partial_slopes: FloatArray  # of the inverse, um/V
    lagged_states: FloatArray  # play states at the tick that was measured last, V
    lagged_tick: int = 0  # ticks that lagged_states has seen
    waiting: dict[int, tuple[float, float]] = field(default_factory=dict)  # tick: (x, zdot_d), not yet in lagged_states
    innovation: float = 0.0  # e_m of (15), um
    held: bool = False


class ReferenceController:
    """`AdaptiveController` in NumPy, with any law.

    Parameters
    ----------
    settings : ControllerSettings
        The same settings; `precision` must be "double".
    law : Law, optional
        What adapts the weights: an object with `weights`, shape (2 n,), um/V, and `update(u, e_m)`. By default `RLS`
        with the forgetting factor, regularization and covariance limit of the settings.

    Attributes
    ----------
    settings : ControllerSettings
        As given.
    law : Law
        The law in use; `reset` puts a copy of the one that was given in its place.
    counters : dict[str, int]
        Commands, adaptations, and saturated, projected and rejected ticks since the start or the last reset.

    Raises
    ------
    SettingError
        `precision` is not "double", or the law has another number of weights than the settings.

    Examples
    --------
    >>> settings = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> controller = ReferenceController(settings)
    >>> for tick in range(200):
    ...     z_d = 15.0 + 10.0 * np.sin(0.05 * tick)
    ...     volts = controller.command(z_d, 0.05 * 2000.0 * 10.0 * np.cos(0.05 * tick))
    ...     controller.adapt(10.0 * volts)
    >>> round(controller.command(20.0, 0.0), 3)
    2.0
    """

    def __init__(self, settings: ControllerSettings, law: Law | None = None) -> None:
        if settings.precision != "double":
            raise SettingError(
                "precision", repr(settings.precision), "'double': NumPy states the paper in double alone"
            )
        if law is None:
            law = RLS(
                settings.initial_weights,
                forgetting=settings.forgetting,
                regularization=settings.regularization,
                covariance_limit=settings.covariance_limit,
            )
        if np.shape(law.weights) != (2 * settings.plays,):
            raise SettingError(
                "law.weights", f"array of shape {np.shape(law.weights)}", f"{2 * settings.plays} numbers"
            )
        self.settings = settings
        self._fresh_law = law
        self.reset()

    def reset(self) -> None:
        """Back to the first tick: plays at 0 V, the law as it was given, counters at zero, not on hold."""
        s = self.settings
        self.law = copy.deepcopy(self._fresh_law)
        self._r, self._d, self._w_s = (np.array(v) for v in (s.thresholds, s.dead_zone_thresholds, s.dead_zone_weights))
        slopes, _ = lift_slopes(self._rate_weights(0.0), s.slope_min)
        self._tick = _Tick(np.zeros(s.plays), slopes, np.zeros(s.plays))
        self.counters = dict.fromkeys(("commands", "adaptations", "saturated", "projected", "rejected"), 0)
        self._saturated = self._projected = self._rejected = False

    # ---- The two calls ----------------------------------------------------------------------------------------------

    def command(self, z_d: float, zdot_d: float) -> float:
        """Voltage, V, for the desired displacement z_d, um, and velocity zdot_d, um/s; the play states advance.

        Raises
        ------
        SettingError
            z_d or zdot_d is NaN or infinite; nothing has changed.
        """
        z_d, zdot_d = _check.number("z_d", z_d, "um"), _check.number("zdot_d", zdot_d, "um/s")
        s, t = self.settings, self._tick
        y_d = self._through_dead_zones(z_d)  # (11)
        t.partial_slopes, self._projected = lift_slopes(self._rate_weights(zdot_d), s.slope_min)  # (7)
        x = play_inverse(y_d, t.partial_slopes, self._r, t.play_states)  # (12)
        low, high = s.voltage_limits
        self._saturated = not low <= x <= high
        x = min(x, high) if x >= low else low  # NaN, too, leaves as a voltage within limits
        t.play_states = play(x, self._r, t.play_states)  # (1)

        t.waiting[self.counters["commands"]] = (x, zdot_d)
        self.counters["commands"] += 1
        if len(t.waiting) > HISTORY:  # the oldest is too late now for its measurement
            self._lagged_states_to(self.counters["commands"] - 1 - HISTORY)
        self.counters["saturated"] += self._saturated
        self.counters["projected"] += self._projected
        return x

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Learn from the displacement, um, that answered the command `ago` commands before the last one, 0 to 63.

        NaN, infinity, and a measurement older than one already used are rejected, flagged and counted.
        """
        t, tick = self._tick, self.counters["commands"] - 1 - ago
        in_time = 0 <= ago < HISTORY and tick in t.waiting
        self._rejected = not (in_time and np.isfinite(z_measured))
        if self._rejected:
            self.counters["rejected"] += 1
            return
        zdot_d = self._lagged_states_to(tick)
        u = self._regressor(zdot_d)  # (20)
        t.innovation = self._through_dead_zones(z_measured) - float(dot(self.law.weights, u))  # (15)
        if t.held:
            return
        try:
            self.law.update(u, t.innovation)  # (23)
        except UpdateRefused:
            self._rejected = True
            self.counters["rejected"] += 1
        else:
            self.counters["adaptations"] += 1

    # ---- The arrows of Fig. 5 ---------------------------------------------------------------------------------------

    def _through_dead_zones(self, z: float) -> float:
        """(11) of a desired, (14) of a measured displacement; the settings hold the dead zones of the inverse."""
        return float(dot(dead_zone(z, self._d), self._w_s))

    def _rate_weights(self, zdot_d: float) -> FloatArray:
        """(7) in the scale of (20): w_h = a + c_b zdot_d b."""
        a, b = self.law.weights[0::2], self.law.weights[1::2]
        return a + self.settings.rate_scale * zdot_d * b

    def _lagged_states_to(self, tick: int) -> float:
        """Bring the lagged play states to this tick, whose zdot_d is returned, um/s."""
        t = self._tick
        for k in range(t.lagged_tick, tick + 1):
            x, zdot_d = t.waiting.pop(k)
            t.lagged_states = play(x, self._r, t.lagged_states)
        t.lagged_tick = tick + 1
        return zdot_d

    def _regressor(self, zdot_d: float) -> FloatArray:
        """(20): u = [H_0, c_b zdot_d H_0, H_1, ...], with c_a = 1."""
        H = self._tick.lagged_states
        u: FloatArray = np.column_stack([H, self.settings.rate_scale * zdot_d * H]).ravel()
        return u

    # ---- Hold, and what an outsider reads ----------------------------------------------------------------------------

    def hold(self) -> None:
        """Stop adapting; commands go on with the weights as they are."""
        self._tick.held = True

    def resume(self) -> None:
        """Adapt again."""
        self._tick.held = False

    @property
    def weights(self) -> FloatArray:
        """w = [a0, b0, a1, b1, ...] of (21), shape (2 n,), um/V."""
        return np.array(self.law.weights)

    @property
    def partial_slopes(self) -> FloatArray:
        """Slopes of the branches at the last rate, as the inverse used them, shape (n,), um/V."""
        return self._tick.partial_slopes.copy()

    @property
    def play_states(self) -> FloatArray:
        """Forward play states after the last command, shape (n,), V."""
        return self._tick.play_states.copy()

    @property
    def innovation(self) -> float:
        """e_m of (15) at the last measurement, um."""
        return self._tick.innovation

    @property
    def flag_bits(self) -> int:
        """The flags of the last tick as a bit mask: 1 saturated, 2 projected, 4 rejected, 8 held."""
        return self._saturated | self._projected << 1 | self._rejected << 2 | self._tick.held << 3
