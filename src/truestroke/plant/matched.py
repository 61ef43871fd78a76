"""The paper's plant (13): exactly the controller's structure, for the simulations of Sec. 4."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from truestroke._plant import Matched
from truestroke.base import checks, declared
from truestroke.base.checks import SettingError
from truestroke.base.copies import deep
from truestroke.base.display import Displayed, Rows
from truestroke.base.typing import FloatArray
from truestroke.plant.noise import Noise
from truestroke.plant.settings import MATCHED_SETTINGS, MatchedSettings
from truestroke.signals.timing import Timing


class MatchedPlant(Displayed):
    """z_a = w_s . S_d[(a_p + c_b zdot_d b_p) . H_r[x]], equation (13), plus white noise.

    A controller of the same structure can invert it exactly, so it tells nothing about a real actuator. Its weights
    follow the *desired* velocity, as (13) has it, so it is told the whole trajectory's velocity beforehand.

    Parameters
    ----------
    velocity : array_like, shape (ticks,)
        Desired velocity of each tick, um/s.
    settings : MatchedSettings
        Weights, thresholds, noise, change; the default is the published P-885.90.
    seed : int
        Of the noise and of the weights after a change, 0 or above. The same seed gives the same bits.

    Attributes
    ----------
    truth : ndarray, shape (ticks,)
        Displacement without noise over the ticks of the last exchange, um.

    Examples
    --------
    >>> plant = MatchedPlant(velocity=[0.0, 100.0], settings=MatchedSettings(noise=0.0))
    >>> plant.exchange(np.array([1.0, 1.0])).round(4)
    array([10.6038, 10.4913])
    """

    __copy__ = deep

    def _display(self) -> tuple[str, Rows]:
        ticks = ("ticks", f"{self._tick} of {self._velocity.size}")
        return f"MatchedPlant: seed {self.seed}", [*declared.rows(self.settings, MATCHED_SETTINGS), ticks]

    def __init__(self, velocity: npt.ArrayLike, settings: MatchedSettings | None = None, seed: int = 0) -> None:
        given = MatchedSettings() if settings is None else settings
        self.settings = checks.instance("settings", given, MatchedSettings, "a MatchedSettings")
        self.seed = checks.count("seed", seed, 0, 2**63 - 1)
        self._velocity = np.ascontiguousarray(checks.finite_array("velocity", velocity, "um/s"))
        self.changed_a, self.changed_b = _changed_weights(self.settings, self.seed)
        self._plant = Matched(self._kernel_settings())
        self.open()

    def open(self) -> Timing:
        """Rest at time 0, noise from its beginning; opening again repeats the same bits."""
        self._plant.reset()
        self._noise = Noise(self.seed)
        self._tick = 0
        self.truth: FloatArray = np.empty(0)
        return Timing(sample_rate=self.settings.sample_rate)

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Hold each voltage for a tick.

        Parameters
        ----------
        volts : ndarray, shape (ticks,)
            Voltages at the D/A converter, V; any number of ticks.

        Returns
        -------
        ndarray, shape (ticks,)
            Measured displacement of each tick, um.

        Raises
        ------
        SettingError
            A voltage is NaN or infinite, or the trajectory is over; nothing has moved.
        """
        volts = checks.signal("volts", volts, "V")
        end = self._tick + volts.size
        if end > self._velocity.size:
            raise SettingError("ticks", end, f"at most {self._velocity.size}, the length of velocity")
        measured, truth = np.empty(volts.shape), np.empty(volts.shape)
        velocity = self._velocity[self._tick : end]
        bad = self._plant.run(volts, velocity, self._noise.take(volts.size), measured, truth)
        if bad >= 0:
            self._noise.put_back(volts.size)
            raise SettingError(f"volts[{bad}]", volts[bad], "finite", "V")
        self._tick, self.truth = end, truth
        return measured

    def describe(self) -> dict[str, object]:
        """Kind, settings and seed, as plain data for a recording."""
        changed = {} if self.settings.change is None else {"changed_a": self.changed_a, "changed_b": self.changed_b}
        return {"kind": "matched", "seed": self.seed, **dataclasses.asdict(self.settings), **changed}

    def _kernel_settings(self) -> dict[str, float | list[float]]:
        s = self.settings
        return {
            "plays": len(s.thresholds),
            "thresholds": list(s.thresholds),
            "a": list(s.a),
            "b": list(s.b),
            "changed_a": self.changed_a,
            "changed_b": self.changed_b,
            "rate_scale": s.rate_scale,
            "dead_zones": len(s.dead_zone_thresholds),
            "dead_zone_thresholds": list(s.dead_zone_thresholds),
            "dead_zone_weights": list(s.dead_zone_weights),
            "noise": s.noise,
            "change_tick": s.change.tick(s.sample_rate) if s.change else -1,
        }


def _changed_weights(s: MatchedSettings, seed: int) -> tuple[list[float], list[float]]:
    """a_p and b_p after the change, um/V; drawn from a stream of their own, apart from the noise."""
    if s.change is None:
        return list(s.a), list(s.b)
    random = np.random.Generator(np.random.PCG64([seed, 1]))
    size = len(s.thresholds)
    factors = s.change.gain * (1 + s.weight_spread * random.uniform(-1, 1, (2, size)))
    factors[:, 1:] *= s.change.hysteresis
    return (factors[0] * s.a).tolist(), (factors[1] * s.b).tolist()
