"""What a study is: a TOML file, read into frozen dataclasses; a key that is not known is an error."""

import dataclasses
import inspect
from collections.abc import Callable, Mapping
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
from truestroke.signals import metrics
from truestroke.studies.engine import Channels, Number, Row, Run
from truestroke.studies.study.sample import CONTROLLERS, DISTRIBUTIONS, PLANTS, WAVES, Distribution, sample

MOST = 100_000_000  # runs


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

    def metrics(self, run: Run, channels: Channels) -> dict[str, Number]:
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
    source = toml.read(path)
    with checks.inside(f"{path}: "):
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
