"""What a study is: a TOML file, read into frozen dataclasses; a key that is not known is an error."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.settings import ControllerSettings
from truestroke.plant import MatchedSettings, PlantSettings
from truestroke.signals import trajectories
from truestroke.studies.study.figures import FIGURES

DRAWS = ("uniform", "log_uniform", "choice", "around")
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
KEYS = ("title", "runs", "seed", "sample_rate", "record", "plant", "wave", "controllers", "converged")
MOST = 100_000_000  # runs


@dataclass(frozen=True)
class Draw:
    """A value that is drawn for each run anew.

    Attributes
    ----------
    kind : str
        "uniform" or "log_uniform" (values are the ends), "choice" (of values), "around" (each of values by itself
        times a factor that is uniform from 1 - spread to 1 + spread).
    values : tuple
        In the unit of what is drawn.
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
        >>> Draw("uniform", (1.0, 2.0)).sample(np.random.default_rng(0)).__round__(3)
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


@dataclass(frozen=True, kw_only=True)
class Study:
    """One study. Values of plant, wave and controllers are plain, a `Draw`, or a mapping of such.

    Attributes
    ----------
    title : str
        For the page.
    runs : int
        How many; their numbers are 0 to runs - 1.
    seed : int
        Of all draws.
    sample_rate : float
        Hz.
    record : tuple of str
        Figures to keep of each run, of `FIGURES`.
    plant, wave : mapping
        "kind" and settings.
    controllers : mapping of str to mapping
        Each by its name: "kind" and settings.
    level, within : float
        A run has converged if its `metrics.convergence_time` to `level` (um, of the true error) is at most
        `within` (s).
    source : mapping
        All of it as it stood in the file.
    """

    title: str
    runs: int
    seed: int
    sample_rate: float
    record: tuple[str, ...]
    plant: Mapping[str, Any]
    wave: Mapping[str, Any]
    controllers: Mapping[str, Mapping[str, Any]]
    level: float
    within: float
    source: Mapping[str, Any]

    def identity(self) -> dict[str, Any]:
        """What a store belongs to: everything but the title and the number of runs."""
        return {key: value for key, value in self.source.items() if key not in ("title", "runs")}


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
    try:
        source = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingError("study", str(path), f"a TOML file: {error}") from None
    try:
        return parse(source if runs is None else source | {"runs": runs})
    except SettingError as error:
        raise SettingError(f"{path}: {error.argument}", error.value, error.bound, error.unit) from None


def parse(source: Mapping[str, Any]) -> Study:
    """A study from what its file says.

    Examples
    --------
    >>> study = parse(tomllib.loads(example()))
    >>> study.runs, study.plant["noise"]
    (10000, Draw(kind='uniform', values=(0.01, 0.06), spread=0.0))
    """
    _known("study", source, KEYS, required=("runs", "plant", "wave", "controllers", "converged"))
    converged, record = _table(source, "converged"), source.get("record", ["rmse", "maximum"])
    _known("converged", converged, ("level", "within"), required=("level", "within"))
    if not isinstance(record, list) or [name for name in record if not isinstance(name, str) or name not in FIGURES]:
        raise SettingError("record", record, f"a list of {', '.join(FIGURES)}")
    controllers = _table(source, "controllers")
    if not controllers:
        raise SettingError("controllers", "{}", "at least one, as in [controllers.paper]")
    return Study(
        title=str(source.get("title", "A study")),
        runs=checks.count("runs", source["runs"], 1, MOST),
        seed=checks.count("seed", source.get("seed", 0), 0, 2**63 - 1),
        sample_rate=checks.positive("sample_rate", source.get("sample_rate", 2000.0), "Hz"),
        record=tuple(record),
        plant=_section("plant", _table(source, "plant"), PLANTS),
        wave=_section("wave", _table(source, "wave"), WAVES),
        controllers={
            name: _section(f"controllers.{name}", _table(controllers, name), CONTROLLERS) for name in controllers
        },
        level=checks.positive("converged.level", converged["level"], "um"),
        within=checks.positive("converged.within", converged["within"], "s"),
        source=source,
    )


def _known(name: str, table: Mapping[str, Any], keys: Iterable[str], required: Iterable[str] = ()) -> None:
    for key in table:
        if key not in (keys := tuple(keys)):
            raise SettingError(f"{name}.{key}", repr(table[key]), f"left out: the keys are {', '.join(keys)}")
    for key in required:
        if key not in table:
            raise SettingError(f"{name}.{key}", "nothing", "given")


def _table(source: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = source[name]
    if not isinstance(table, Mapping):
        raise SettingError(name, repr(table), f"a table, [{name}]")
    return table


def _section(name: str, table: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """Plant, wave or controller: its kind is known, and so is each of its settings."""
    kind = table.get("kind", "")
    if not isinstance(kind, str) or kind not in kinds:
        raise SettingError(f"{name}.kind", repr(kind), f"one of {', '.join(kinds)}")
    made = ControllerSettings if kinds is CONTROLLERS else kinds[kind]
    settings = inspect.signature(made).parameters
    _known(name, table, ("kind", *(key for key in settings if key not in ("seed", "sample_rate"))))
    return {key: _value(f"{name}.{key}", value) for key, value in table.items()}


def _value(name: str, value: Any) -> Any:
    """A plain value, a draw, or a table of such."""
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, Mapping):
        return value
    kinds = [key for key in value if key in DRAWS]
    if not kinds:
        return {key: _value(f"{name}.{key}", inner) for key, inner in value.items()}
    kind = kinds[0]
    _known(name, value, (kind, "spread") if kind == "around" else (kind,), required=(kind,))
    if kind == "choice":
        if not isinstance(value[kind], list) or not value[kind]:
            raise SettingError(name, value[kind], "a list of values to choose from")
        return Draw(kind, tuple(tuple(v) if isinstance(v, list) else v for v in value[kind]))
    if kind == "around":
        values = tuple(checks.finite_array(name, value[kind]).tolist())
        return Draw(kind, values, checks.within(f"{name}.spread", value.get("spread"), 0.0, 1.0))
    ends = checks.interval(name, value[kind])
    if kind == "log_uniform":
        checks.positive(f"{name}[0]", ends[0])
    return Draw(kind, ends)
