"""The realistic plant: a driven piezo stage whose structure is not the controller's model, in C."""

from __future__ import annotations

from collections.abc import Sequence

from truestroke._plant import Plant
from truestroke.base import checks, declared
from truestroke.plant.settings import PLANT_SETTINGS, PlantSettings
from truestroke.plant.simulated import Simulated


class RealisticPlant(Simulated):
    """Converters, amplifier, 60 plays of a smooth density, asymmetry, log creep, resonance, drift and noise.

    `truestroke.plant.reference` is the same plant in readable Python; docs/plant.md explains every effect.

    Parameters
    ----------
    settings : PlantSettings
        Every number; the default is a stage driven by a P-885.90 stack.
    seed : int
        Of the sensor noise, 0 or above. The same seed gives the same bits.
    dropouts : sequence of (int, int)
        Bursts without a measurement (NaN; the truth goes on): first tick of each, and the first after it.

    Attributes
    ----------
    truth : ndarray, shape (ticks,)
        Displacement without noise and A/D, the mean over each tick of the last exchange, um. Drift is part of it.

    Examples
    --------
    >>> plant = RealisticPlant(PlantSettings().without("noise"))
    >>> plant.open()
    Timing(sample_rate=2000.0, block=1, latency=0, channels=1, hardware_timed=False)
    >>> measured = plant.exchange(np.full(2000, 1.0))
    >>> print(f"{measured[0]:.2f} um in the first tick, {measured[-1]:.2f} um after a second")
    4.02 um in the first tick, 12.18 um after a second
    """

    kind = "realistic"
    table = PLANT_SETTINGS

    def __init__(
        self, settings: PlantSettings | None = None, seed: int = 0, dropouts: Sequence[tuple[int, int]] = ()
    ) -> None:
        given = PlantSettings() if settings is None else settings
        self.settings = checks.instance("settings", given, PlantSettings, "a PlantSettings")
        self._samples = self.settings.samples_per_tick
        super().__init__(Plant(declared.kernel_values(self.settings, PLANT_SETTINGS)), seed, dropouts)
