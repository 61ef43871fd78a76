"""A sensor that is silent now and then."""

from __future__ import annotations

import numpy as np

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.runtime.loop import Actuator
from truestroke.signals.timing import Timing


class Dropouts:
    """An actuator whose sensor drops out in bursts: its measurements are NaN there, its truth is not.

    Parameters
    ----------
    actuator : Actuator
        What is measured.
    bursts : sequence of (int, int)
        First tick of each burst and the first tick after it.

    Examples
    --------
    >>> from truestroke.plant import RealisticPlant
    >>> plant = Dropouts(RealisticPlant(), [(1, 3)])
    >>> _ = plant.open()
    >>> np.isnan(plant.exchange(np.zeros(4))).tolist(), np.isnan(plant.truth).any()
    ([False, True, True, False], np.False_)
    """

    def __init__(self, actuator: Actuator, bursts: tuple[tuple[int, int], ...] | list[tuple[int, int]]) -> None:
        self.actuator = actuator
        self.bursts = [tuple(checks.count("bursts", tick, 0, 10**9) for tick in burst) for burst in bursts]
        self._tick = 0

    @property
    def truth(self) -> FloatArray:
        """That of the actuator, um."""
        truth: FloatArray = self.actuator.truth  # type: ignore[attr-defined]
        return truth

    def open(self) -> Timing:
        """Open the actuator; the bursts begin to count."""
        self._tick = 0
        return self.actuator.open()

    def exchange(self, volts: FloatArray) -> FloatArray:
        """That of the actuator, with NaN within the bursts, um."""
        measured = self.actuator.exchange(volts)
        first, self._tick = self._tick, self._tick + measured.size
        for start, stop in self.bursts:
            if start < self._tick and stop > first:
                measured[max(start - first, 0) : max(stop - first, 0)] = np.nan
        return measured

    def describe(self) -> dict[str, object]:
        """That of the actuator, and the bursts."""
        about = self.actuator.describe() if hasattr(self.actuator, "describe") else {}
        return {**about, "dropouts": [list(burst) for burst in self.bursts]}
