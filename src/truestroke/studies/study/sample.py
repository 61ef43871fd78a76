"""What is sampled, from which distributions; run i is a pure function of the study and i."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.settings import ControllerSettings
from truestroke.plant import Change, MatchedSettings, PlantSettings
from truestroke.signals import trajectories
from truestroke.signals.trajectories import Trajectory
from truestroke.studies.engine import Run

if TYPE_CHECKING:
    from truestroke.studies.study.config import Study

DISTRIBUTIONS = ("uniform", "log_uniform", "choice", "around")
WAVES: dict[str, Callable[..., trajectories.Trajectory]] = {
    "random_wave": trajectories.random_wave,
    "sine": trajectories.sine,
    "triangle": trajectories.triangle,
    "staircase": trajectories.staircase,
}
PLANTS: dict[str, type[MatchedSettings] | type[PlantSettings]] = {
    "matched": MatchedSettings,
    "realistic": PlantSettings,
}
CONTROLLERS: dict[str, Callable[..., ControllerSettings]] = {
    "default": ControllerSettings,
    "paper": ControllerSettings.paper,
}


@dataclass(frozen=True)
class Distribution:
    """A value that is sampled for each run anew.

    Attributes
    ----------
    kind : str
        "uniform" or "log_uniform" (values are the ends), "choice" (of values), "around" (each of values by itself
        times a factor that is uniform from 1 - spread to 1 + spread).
    values : tuple
        In the unit of what is sampled.
    spread : float
        Of "around".
    """

    kind: str
    values: tuple[Any, ...]
    spread: float = 0.0

    def sample(self, random: np.random.Generator) -> Any:
        """One value.

        Examples
        --------
        >>> Distribution("uniform", (1.0, 2.0)).sample(np.random.default_rng(0)).__round__(3)
        1.637
        """
        if self.kind == "choice":
            return self.values[random.integers(len(self.values))]
        if self.kind == "around":
            factors = 1 + self.spread * random.uniform(-1.0, 1.0, len(self.values))
            return tuple((factors * self.values).tolist())
        low, high = self.values
        part = random.random()
        return float(low * (high / low) ** part if self.kind == "log_uniform" else low + (high - low) * part)


def sample(study: Study, number: int) -> Run:
    """The run of this number, from the stream of SeedSequence([seed, number]).

    Beside every sampled number its `Run.sampled` has what follows from them: peak speed (um/s); of a matched plant also
    the share of its hysteresis, 1 - a_0 / sum of a, and peak speed over singular speed.

    Examples
    --------
    >>> import tomllib
    >>> from truestroke.studies.study import example, parse
    >>> run = sample(parse(tomllib.loads(example())), 7)
    >>> run.trajectory.name, round(run.plant.noise, 4), round(run.sampled["hysteresis share"], 3)
    ('random wave', 0.0569, 0.334)
    """
    number = checks.count("number", number, 0, 2**63 - 1)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([study.seed, number])))
    wave_seed, plant_seed = (int(seed) for seed in random.integers(2**63, size=2))
    sampled: dict[str, float] = {}
    plant = _sampled(study.plant, random, "", sampled)
    wave = _sampled(study.wave, random, "", sampled)
    laws = {name: _sampled(law, random, f"{name} ", sampled) for name, law in study.controllers.items()}
    if isinstance(change := plant.get("change"), Mapping):
        plant["change"] = _made("plant.change", Change, change)
    rate: dict[str, Any] = {"sample_rate": study.sample_rate}
    settings = _made("plant", PLANTS[plant.pop("kind")], plant | rate)
    seed = {"seed": wave_seed} if wave["kind"] == "random_wave" else {}
    trajectory = _made("wave", WAVES[wave.pop("kind")], wave | seed | rate)
    controllers = {
        name: _made(f"controllers.{name}", CONTROLLERS[law.pop("kind")], law | rate) for name, law in laws.items()
    }
    return Run(
        number=number,
        seed=plant_seed,
        plant=settings,
        trajectory=trajectory,
        controllers=controllers,
        sampled=sampled | _follows(settings, trajectory),
    )


def _made(section: str, make: Callable[..., Any], settings: Mapping[str, Any]) -> Any:
    """Its bounds are checked where it is made; a text or a number in place of a list may not get that far."""
    try:
        with checks.inside(f"{section}."):
            return make(**settings)
    except TypeError as error:
        raise SettingError(
            section, dict(settings), f"numbers and lists where its settings have them: {error}"
        ) from None


def _sampled(
    table: Mapping[str, Any], random: np.random.Generator, prefix: str, sampled: dict[str, float]
) -> dict[str, Any]:
    """The table with a value for each distribution; its numbers go to `sampled`."""
    values = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            values[key] = _sampled(value, random, f"{prefix}{key} ", sampled)
            continue
        values[key] = value.sample(random) if isinstance(value, Distribution) else value
        if isinstance(value, Distribution):
            sampled.update(_numbers(f"{prefix}{key}", values[key]))
    return values


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, tuple):
        for i, entry in enumerate(value):
            yield from _numbers(f"{name}_{i}", entry)
    elif isinstance(value, (int, float)):
        yield name.replace("_", " ") if not name[-1].isdigit() else name, float(value)


def _follows(plant: MatchedSettings | PlantSettings, trajectory: Trajectory) -> dict[str, float]:
    """What says more than single numbers. A partial sum of a + c_b zdot b vanishes at the singular speed."""
    peak = trajectory.peak_speed
    if not isinstance(plant, MatchedSettings):
        return {"peak speed": peak}
    slopes, rates = np.cumsum(plant.a), plant.rate_scale * np.abs(np.cumsum(plant.b))
    share = 1 - plant.a[0] / slopes[-1]
    return {
        "peak speed": peak,
        "hysteresis share": float(share),
        "peak speed / singular speed": float(peak * np.max(rates / slopes)),
    }
