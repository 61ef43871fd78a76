"""A native controller against a native plant: many ticks without Python between them, the bits of single calls.

`run` and `simulate_many` use it. Anything else that has the two calls goes tick by tick: `runtime.loop`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from truestroke import _loops
from truestroke.base.typing import FloatArray
from truestroke.control.controller import AdaptiveController
from truestroke.plant import MatchedPlant, RealisticPlant, StagePlant
from truestroke.runtime.ticks import SIMULATED
from truestroke.signals.trajectories import Trajectory

FIRST = 64  # ticks within which a plant gives its first measurement, which may be refused: `AdaptiveController.adapt`
CALLS = {plant: (plant.open, plant.exchange) for plant in (RealisticPlant, MatchedPlant, StagePlant)}
"""Calls of the native plants that the native loop stands for."""


class Pair:
    """A controller and a plant, both native, and the motion between them.

    Parameters
    ----------
    controller : AdaptiveController
        The class itself: another one may do something else in each tick.
    plant : RealisticPlant, MatchedPlant or StagePlant
        The same. A `MatchedPlant` knows the velocity of this motion.
    desired : sequence of ndarray, shape (ticks,)
        The arguments of `command`, two to four of them, finite.

    Examples
    --------
    >>> from truestroke.signals import trajectories
    >>> wave = trajectories.sine(duration=1.0)
    >>> controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> pair = Pair(controller, RealisticPlant(), [wave.position, wave.velocity])
    >>> rows = {name: np.empty(len(wave), np.uint8 if name == "flags" else np.float64) for name in SIMULATED}
    >>> pair.run(slice(0, 2000), rows, np.empty(10_000))
    >>> controller.counters.commands
    2000
    """

    def __init__(
        self,
        controller: AdaptiveController,
        plant: RealisticPlant | MatchedPlant | StagePlant,
        desired: Sequence[FloatArray],
    ) -> None:
        self._controller, self._plant = controller, plant
        self._calls = controller._kernel.native(), plant._plant.native()
        z_d, zdot_d, *others = map(np.ascontiguousarray, desired)
        zddot_d, strain_d = [*others, None, None][:2]
        self._desired, self._known = (z_d, zdot_d), (zddot_d, strain_d)
        self.samples = plant._samples
        """Normal numbers that the plant takes in a tick."""

    def run(self, part: slice, rows: Mapping[str, Any], noise: FloatArray) -> None:
        """The ticks of `part`, start to stop, into the channels `SIMULATED` of `rows`.

        `noise` is an array for the normal numbers, `samples` for each of these ticks or more.

        Raises
        ------
        SettingError
            The first measurement is beyond the reach of the voltage.
        """
        numbers = noise[: (part.stop - part.start) * self.samples]
        self._plant._noise.fill(numbers)
        z_d, zdot_d = (array[part] for array in self._desired)
        zddot_d, strain_d = (None if array is None else array[part] for array in self._known)
        _loops.run(*self._calls, z_d, zdot_d, zddot_d, strain_d, numbers, *(rows[name][part] for name in SIMULATED))
        self._plant.passed(rows["true"][part])
        self._controller._kernel.require_reach()


def pair(trajectory: Trajectory, controller: Any, actuator: Any, desired: Sequence[FloatArray]) -> Pair | None:
    """The two as a `Pair`; None where one of them is not native, so that each tick is Python's."""
    if type(controller) is not AdaptiveController or type(actuator) not in CALLS:
        return None
    if not (is_usual(controller) and _moves_as_usual(actuator)):
        return None
    if isinstance(actuator, MatchedPlant) and not actuator.follows(trajectory.velocity):
        return None
    largest = np.finfo(np.float32 if controller.settings.precision == "single" else np.float64).max
    if not all(np.all(np.abs(array) <= largest) for array in desired):
        return None  # `command` refuses the first tick that is not
    return Pair(controller, actuator, desired)


def is_usual(controller: AdaptiveController) -> bool:
    """Whether its calls are those of the class and the kernel, and nobody put others in their place."""
    own = vars(controller)
    return bool("command" not in own and own.get("adapt") == controller._kernel.adapt)


def _moves_as_usual(plant: Any) -> bool:
    """The same of a plant."""
    kind = type(plant)
    return (kind.open, kind.exchange) == CALLS[kind] and not {"open", "exchange"} & vars(plant).keys()
