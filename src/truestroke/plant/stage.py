"""The stage for fast motion: what limits a stage above a tenth of its resonance, in C."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from truestroke._plant import Stage
from truestroke.base import checks, declared
from truestroke.base.checks import SettingError
from truestroke.plant.settings import STAGE_SETTINGS, StageSettings
from truestroke.plant.simulated import Simulated


class StagePlant(Simulated):
    """Dead time, amplifier, hysteresis of three structures, creep, up to three modes, load, hum, sensor and noise.

    `truestroke.plant.stage_reference` is the same stage in readable Python; docs/plant.md explains every part.

    Parameters
    ----------
    settings : StageSettings
        Every number; the default is a stage of 30 um that rings at 700 Hz.
    seed : int
        Of the sensor noise, 0 or above. The same seed gives the same bits.
    dropouts : sequence of (int, int)
        Bursts without a measurement (NaN; the truth goes on): first tick of each, and the first after it.
    load : array_like, shape (ticks,), optional
        Static displacement of a load in each tick, um, beside that of the settings; 0 after its last entry.

    Attributes
    ----------
    truth : ndarray, shape (ticks,)
        Displacement without sensor and noise, the mean over each tick of the last exchange, um.

    least_slope : float
        Smallest slope of the loop over the mean one.

    Raises
    ------
    SettingError
        An argument is out of bounds, or `loop_width` so large that the stage would retract at a rising voltage.

    Examples
    --------
    >>> stage = StagePlant(StageSettings(noise=0.0, creep=0.0))
    >>> stage.open()
    Timing(sample_rate=10000.0, block=1, latency=0, channels=1, hardware_timed=False)
    >>> up, down = stage.exchange(np.full(5000, 3.6))[-1], stage.exchange(np.zeros(5000))[-1]
    >>> print(f"{up - down:.2f} um from 3.6 V back to 0 V")
    30.00 um from 3.6 V back to 0 V
    """

    kind = "stage"
    table = STAGE_SETTINGS

    def __init__(
        self,
        settings: StageSettings | None = None,
        seed: int = 0,
        dropouts: Sequence[tuple[int, int]] = (),
        load: npt.ArrayLike = (),
    ) -> None:
        given = StageSettings() if settings is None else settings
        self.settings = s = checks.instance("settings", given, StageSettings, "a StageSettings")
        self._samples = s.samples_per_tick
        self.load = np.ascontiguousarray(checks.finite_array("load", load, "um"))
        stage = Stage(declared.kernel_values(s, STAGE_SETTINGS), self.load)
        if stage.least_slope <= 0:
            bound = (
                f"smaller for {s.hysteresis_kind}: the stage would retract at a rising voltage, or no play would move"
            )
            raise SettingError("loop_width", s.loop_width, bound)
        self.least_slope = stage.least_slope
        super().__init__(stage, seed, dropouts)

    def describe(self) -> dict[str, object]:
        """Kind, settings, seed, dropouts, and length and largest of `load`, as plain data for a recording."""
        load = (
            {"load_ticks": self.load.size, "load_largest": float(np.max(np.abs(self.load)))} if self.load.size else {}
        )
        return super().describe() | load
