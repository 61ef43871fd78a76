"""The paper's plant (13): exactly the controller's structure, for the simulations of Sec. 4."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke._plant import Matched
from truestroke.base import checks, declared
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.plant.settings import MATCHED_SETTINGS, MatchedSettings
from truestroke.plant.simulated import Simulated, checked_seed
from truestroke.signals.timing import Timing


class MatchedPlant(Simulated):
    """z_a = w_s . S_d[(a_p + c_b zdot_d b_p) . H_r[x]], equation (13), plus white noise.

    A controller of the same structure can invert it exactly, so it proves nothing about a real actuator. Its weights
    follow the *desired* velocity, as in (13), so it takes the velocity of the whole trajectory beforehand.

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

    kind = "matched"
    table = MATCHED_SETTINGS

    def __init__(self, velocity: npt.ArrayLike, settings: MatchedSettings | None = None, seed: int = 0) -> None:
        given = MatchedSettings() if settings is None else settings
        self.settings = s = checks.instance("settings", given, MatchedSettings, "a MatchedSettings")
        self._velocity = np.ascontiguousarray(checks.finite_array("velocity", velocity, "um/s"))
        self.changed_a, self.changed_b = _changed_weights(s, checked_seed(seed))
        weights: dict[str, Any] = {"a": (s.a, self.changed_a), "b": (s.b, self.changed_b)}
        super().__init__(Matched({**declared.kernel_values(s, MATCHED_SETTINGS), **weights}), seed)

    def open(self) -> Timing:
        """Rest at time 0, noise from its beginning; opening again repeats the same bits."""
        self._tick = 0
        return super().open()

    def exchange(self, volts: FloatArray) -> FloatArray:
        """As `RealisticPlant.exchange`; a SettingError, too, where `velocity` is over."""
        volts = checks.signal("volts", volts, "V")
        end = self._tick + volts.size
        if end > self._velocity.size:
            raise SettingError("ticks", end, f"at most {self._velocity.size}, the length of velocity")
        measured = super().exchange(volts)
        self._tick = end
        return measured

    def passed(self, truth: FloatArray) -> None:
        """As `Simulated.passed`."""
        self._tick += truth.size
        super().passed(truth)

    def follows(self, velocity: FloatArray) -> bool:
        """Whether the next ticks of this motion, um/s, are those that it knows."""
        return np.array_equal(velocity, self._velocity[self._tick :][: velocity.size])

    def _run(self, volts: FloatArray, noise: FloatArray, measured: FloatArray, truth: FloatArray) -> int:
        velocity = self._velocity[self._tick :][: volts.size]
        return int(self._plant.run(volts, velocity, noise, measured, truth))

    def describe(self) -> dict[str, object]:
        """Kind, settings and seed, as plain data for a recording; the weights after a change, if there is one."""
        changed = {} if self.settings.change is None else {"changed_a": self.changed_a, "changed_b": self.changed_b}
        return super().describe() | changed


def _changed_weights(s: MatchedSettings, seed: int) -> tuple[list[float], list[float]]:
    """a_p and b_p after the change, um/V; sampled from a random stream of their own, not that of the noise."""
    if s.change is None:
        return list(s.a), list(s.b)
    random = np.random.Generator(np.random.PCG64([seed, 1]))
    size = len(s.thresholds)
    factors = s.change.gain * (1 + s.weight_spread * random.uniform(-1, 1, (2, size)))
    factors[:, 1:] *= s.change.hysteresis
    return (factors[0] * s.a).tolist(), (factors[1] * s.b).tolist()
