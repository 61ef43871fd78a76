"""What a study is: a TOML file, read into frozen dataclasses, and its run i, a function of the study and i alone."""

import dataclasses
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from truestroke.base import checks, toml
from truestroke.base.checks import SettingError
from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.control.settings import ControllerSettings
from truestroke.plant import Change, MatchedSettings, PlantSettings
from truestroke.signals import metrics, trajectories
from truestroke.signals.trajectories import Trajectory
from truestroke.studies.engine import Channels, Number, Row, Run

MOST = 100_000_000  # runs
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


@dataclass(frozen=True)
class Metric:
    """A number of a run: words and unit for a table, and the function of its channels."""

    words: str
    unit: str
    of: Callable[[Channels], float]


def error(channels: Channels) -> FloatArray:
    """True minus desired displacement, um, shape (ticks,)."""
    return np.asarray(channels["true"] - channels["desired"])


def _half(values: FloatArray) -> FloatArray:
    return values[values.size // 2 :]


def _flagged(name: str) -> Callable[[Channels], float]:
    return lambda channels: 100 * float(np.mean((channels["flags"] & BIT[name]) > 0))


METRICS = {
    "rmse": Metric("rmse, second half", "um", lambda c: float(np.sqrt(np.mean(_half(error(c)) ** 2)))),
    "maximum": Metric("maximum, second half", "um", lambda c: float(np.max(np.abs(_half(error(c)))))),
    "largest": Metric("largest error anywhere", "um", lambda c: float(np.max(np.abs(error(c))))),
    "saturated": Metric("ticks at a voltage limit", "%", _flagged("saturated")),
    "projected": Metric("ticks with a projection", "%", _flagged("projected")),
    "rejected": Metric("measurements rejected", "%", _flagged("rejected")),
    "changed": Metric("ticks with a change found", "%", _flagged("changed")),
    "slewed": Metric("ticks at the slew limit", "%", _flagged("slewed")),
}
"""Of the true error and the flags of a run, by name."""


@dataclass(frozen=True, kw_only=True)
class Converged:
    """A run has, if its `metrics.convergence_time` to `level` (um, of the true error) is at most `within` (s)."""

    level: float = field(metadata={"unit": "um"})
    within: float = field(metadata={"unit": "s"})

    def __post_init__(self) -> None:
        checks.positive("level", self.level, "um")
        checks.positive("within", self.within, "s")


@dataclass(frozen=True, kw_only=True)
class Study:
    """One study. Values of plant, wave and controllers are plain, a `Distribution`, or a mapping of such.

    Attributes
    ----------
    title : str
        For the page.
    runs : int
        How many; their numbers are 0 to runs - 1.
    seed : int
        Of all that is sampled.
    sample_rate : float
        Hz.
    record : tuple of str
        Metrics to keep of each run, of `METRICS`.
    plant, wave : mapping
        "kind" and settings.
    controllers : mapping of str to mapping
        Each by its name: "kind" and settings.
    converged : Converged
        What that means here.
    source : mapping
        All of it as it stood in the file.
    """

    title: str = "A study"
    runs: int
    seed: int = 0
    sample_rate: float = field(default=2000.0, metadata={"unit": "Hz"})
    record: tuple[str, ...] = ("rmse", "maximum")
    plant: Mapping[str, Any]
    wave: Mapping[str, Any]
    controllers: Mapping[str, Any]
    converged: Converged
    source: Mapping[str, Any]

    def __post_init__(self) -> None:
        checks.count("runs", self.runs, 1, MOST)
        checks.count("seed", self.seed, 0, 2**63 - 1)
        checks.positive("sample_rate", self.sample_rate, "Hz")
        for name in self.record:
            checks.one_of("record", name, tuple(METRICS))
        if not self.controllers:
            raise SettingError("controllers", "{}", "at least one, as in [controllers.paper]")

    def identity(self) -> dict[str, Any]:
        """What a store belongs to: everything but the title and the number of runs."""
        return {key: value for key, value in self.source.items() if key not in ("title", "runs")}

    @property
    def numbers(self) -> range:
        """Of the runs."""
        return range(self.runs)

    def sample(self, number: int) -> Run:
        """The run of this number; see `sample`."""
        return sample(self, number)

    def metrics(self, run: Run, _: str, channels: Channels) -> dict[str, Number]:
        """Time of convergence, s (None if it never converges), and what is recorded."""
        time = metrics.convergence_time(channels["time"], error(channels), self.converged.level)
        return {"convergence_time": time} | {name: METRICS[name].of(channels) for name in self.record}

    def has_converged(self, row: Row, controller: str) -> bool:
        """Whether that controller has."""
        time = row.metrics[controller]["convergence_time"]
        return time is not None and time <= self.converged.within


def example() -> str:
    """The study of Sec. 4.3 as TOML, with comments."""
    return (files("truestroke.studies.study") / "sec43.toml").read_text(encoding="utf-8")


def load(path: str | Path, runs: int | None = None) -> Study:
    """A study from its file.

    Parameters
    ----------
    path : path
        TOML.
    runs : int, optional
        In place of the number in the file.

    Raises
    ------
    SettingError
        The file is not TOML, a key is not known, a value is out of its bounds.
    """
    with checks.inside(f"{path}: "):
        source = toml.read(path)
        return parse(source if runs is None else source | {"runs": runs})


def parse(source: Mapping[str, Any]) -> Study:
    """A study from what its file says.

    Examples
    --------
    >>> import tomllib
    >>> study = parse(tomllib.loads(example()))
    >>> study.runs, study.plant["noise"]
    (10000, Distribution(kind='uniform', values=(0.01, 0.06), spread=0.0))
    """
    read = toml.decode(Study, source, source=source)
    controllers = {name: toml.value(f"controllers.{name}", v, Mapping) for name, v in read.controllers.items()}
    return dataclasses.replace(
        read,
        plant=_section("plant", read.plant, PLANTS),
        wave=_section("wave", read.wave, WAVES),
        controllers={name: _section(f"controllers.{name}", given, CONTROLLERS) for name, given in controllers.items()},
    )


def _section(name: str, table: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """Plant, wave or controller: its kind is known, and so is each of its settings."""
    kind = table.get("kind", "")
    if not isinstance(kind, str) or kind not in kinds:
        raise SettingError(f"{name}.kind", repr(kind), f"one of {', '.join(kinds)}")
    made = ControllerSettings if kinds is CONTROLLERS else kinds[kind]
    settings = inspect.signature(made).parameters
    with checks.inside(f"{name}."):
        checks.known(table, ("kind", *(key for key in settings if key not in ("seed", "sample_rate"))))
    return {key: _value(f"{name}.{key}", value) for key, value in table.items()}


def _value(name: str, value: Any) -> Any:
    """A plain value, a distribution, or a table of such."""
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, Mapping):
        return value
    kinds = [key for key in value if key in DISTRIBUTIONS]
    if not kinds:
        return {key: _value(f"{name}.{key}", inner) for key, inner in value.items()}
    kind = kinds[0]
    with checks.inside(f"{name}."):
        checks.known(value, (kind, "spread") if kind == "around" else (kind,))
    if kind == "choice":
        if not isinstance(value[kind], list) or not value[kind]:
            raise SettingError(name, value[kind], "a list of values to choose from")
        return Distribution(kind, tuple(tuple(v) if isinstance(v, list) else v for v in value[kind]))
    if kind == "around":
        values = tuple(checks.finite_array(name, value[kind]).tolist())
        return Distribution(kind, values, checks.within(f"{name}.spread", value.get("spread"), 0.0, 1.0))
    ends = checks.interval(name, value[kind])
    if kind == "log_uniform":
        checks.positive(f"{name}[0]", ends[0])
    return Distribution(kind, ends)


# ---- The run of a number --------------------------------------------------------------------------------------------


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
