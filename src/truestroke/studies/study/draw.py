"""Run i of a study: a pure function of the study and i."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.settings import ControllerSettings
from truestroke.plant import Change, MatchedSettings, PlantSettings
from truestroke.signals.trajectories import Trajectory
from truestroke.studies.study.config import CONTROLLERS, PLANTS, WAVES, Draw, Study

TRIES = 20  # draws of which one at least must be possible


@dataclass(frozen=True, eq=False)
class Run:
    """One draw.

    Attributes
    ----------
    number : int
        Which.
    seed : int
        Of the plant's noise.
    plant : MatchedSettings or PlantSettings
        The actuator.
    trajectory : Trajectory
        The wave.
    controllers : dict of str to ControllerSettings
        By name.
    told : dict of str to float
        Every number that was drawn, by name, and what follows from them: peak speed (um/s); of a matched plant also
        the share of its hysteresis, 1 - a_0 / sum of a, and peak speed over singular speed.
    """

    number: int
    seed: int
    plant: MatchedSettings | PlantSettings
    trajectory: Trajectory
    controllers: dict[str, ControllerSettings]
    told: dict[str, float]


def draw(study: Study, number: int) -> Run:
    """The run of this number, from the stream of SeedSequence([seed, number]).

    Examples
    --------
    >>> import tomllib
    >>> from truestroke.studies.study import example, parse
    >>> run = draw(parse(tomllib.loads(example())), 7)
    >>> run.trajectory.name, round(run.plant.noise, 4), round(run.told["hysteresis share"], 3)
    ('random wave', 0.0569, 0.334)
    """
    number = checks.count("number", number, 0, 2**63 - 1)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([study.seed, number])))
    wave_seed, plant_seed = (int(seed) for seed in random.integers(2**63, size=2))
    told: dict[str, float] = {}
    plant = _sampled(study.plant, random, "", told)
    wave = _sampled(study.wave, random, "", told)
    laws = {name: _sampled(law, random, f"{name} ", told) for name, law in study.controllers.items()}
    if isinstance(change := plant.get("change"), Mapping):
        plant["change"] = _made("plant.change", Change, change)
    rate: dict[str, Any] = {"sample_rate": study.sample_rate}
    settings = _made("plant", PLANTS[plant.pop("kind")], plant | rate)
    seed = {"seed": wave_seed} if wave["kind"] == "random_wave" else {}
    trajectory = _made("wave", WAVES[wave.pop("kind")], wave | seed | rate)
    controllers = {
        name: _made(f"controllers.{name}", CONTROLLERS[law.pop("kind")], law | rate) for name, law in laws.items()
    }
    told |= _follows(settings, trajectory)
    return Run(number, plant_seed, settings, trajectory, controllers, told)


def first(study: Study, numbers: Sequence[int]) -> Run:
    """The first of these runs that can be drawn, of the first `TRIES`; the error of the very first if none can."""
    errors: list[ValueError] = []
    for number in numbers[:TRIES]:
        try:
            return draw(study, number)
        except ValueError as error:
            errors.append(error)
    raise errors[0]


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
    table: Mapping[str, Any], random: np.random.Generator, prefix: str, told: dict[str, float]
) -> dict[str, Any]:
    """The table with a value for each draw; its numbers go to `told`."""
    values = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            values[key] = _sampled(value, random, f"{prefix}{key} ", told)
            continue
        values[key] = value.sample(random) if isinstance(value, Draw) else value
        if isinstance(value, Draw):
            told.update(_numbers(f"{prefix}{key}", values[key]))
    return values


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, tuple):
        for i, entry in enumerate(value):
            yield from _numbers(f"{name}_{i}", entry)
    elif isinstance(value, (int, float)):
        yield name.replace("_", " ") if not name[-1].isdigit() else name, float(value)


def _follows(plant: MatchedSettings | PlantSettings, trajectory: Trajectory) -> dict[str, float]:
    """What tells more than single numbers. A partial sum of a + c_b zdot b vanishes at the singular speed."""
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
