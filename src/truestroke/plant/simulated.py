"""What the simulated plants have in common: a native plant, noise from a seed, a measurement for each voltage."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from truestroke.base import checks, declared
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows
from truestroke.base.typing import FloatArray
from truestroke.plant.noise import Noise
from truestroke.signals.timing import Timing


def checked_seed(seed: int) -> int:
    """A seed of a plant's random numbers."""
    return checks.count("seed", seed, 0, 2**63 - 1)


class Simulated(Displayed):
    """An actuator with the two calls `open` and `exchange`; `_run` moves the native plant `_plant`.

    Attributes
    ----------
    truth : ndarray, shape (ticks,)
        Displacement without noise and A/D, the mean over each tick of the last exchange, um.
    """

    kind: ClassVar[str]
    table: ClassVar[declared.Table]
    settings: Any
    _samples = 1  # of noise in a tick

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def __init__(self, plant: Any, seed: int, dropouts: Sequence[tuple[int, int]] = ()) -> None:
        self._plant = plant
        self.seed = checked_seed(seed)
        ticks = [(checks.count("dropouts", a, 0, 10**9), checks.count("dropouts", b, 0, 10**9)) for a, b in dropouts]
        self.dropouts = tuple(ticks)
        self.open()

    def _display(self) -> tuple[str, Rows]:
        return f"{type(self).__name__}: seed {self.seed}", declared.rows(self.settings, self.table)

    def open(self) -> Timing:
        """Rest at time 0, noise from its beginning; opening again repeats the same bits."""
        self._plant.reset()
        self._noise = Noise(self.seed, [(self._samples * a, self._samples * b) for a, b in self.dropouts])
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
            Measured displacement, the mean over each tick, um.

        Raises
        ------
        SettingError
            A voltage is NaN or infinite; nothing has moved.
        """
        volts = checks.signal("volts", volts, "V")
        measured, truth = np.empty(volts.shape), np.empty(volts.shape)
        noise = self._noise.take(volts.size * self._samples)
        bad = self._run(volts, noise, measured, truth)
        if bad >= 0:
            self._noise.put_back(noise.size)
            raise SettingError(f"volts[{bad}]", volts[bad], "finite", "V")
        self.truth = truth
        return measured

    def _run(self, volts: FloatArray, noise: FloatArray, measured: FloatArray, truth: FloatArray) -> int:
        """Index of the first voltage that is not finite, with nothing moved; or -1."""
        return int(self._plant.run(volts, noise, measured, truth))

    def passed(self, truth: FloatArray) -> None:
        """Ticks have passed in a native loop, which took their numbers of `noise`; `truth` of each, um."""
        self.truth = truth[-1:].copy()

    def describe(self) -> dict[str, object]:
        """Kind, settings, seed and dropouts, as plain data for a recording."""
        silent = {"dropouts": [list(burst) for burst in self.dropouts]} if self.dropouts else {}
        return {"kind": self.kind, "seed": self.seed, **dataclasses.asdict(self.settings), **silent}
