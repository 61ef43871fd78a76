"""An actuator's model as a TOML file that people read and that comes back to the last bit."""

import dataclasses
import os
import re
import warnings
import weakref
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truestroke.base import checks, files, toml
from truestroke.base.checks import SettingError
from truestroke.base.errors import ModelWarning
from truestroke.base.typing import FloatArray
from truestroke.control.actuator import ActuatorModel
from truestroke.control.explored import Explored
from truestroke.model.branches import Branches
from truestroke.model.dynamics import Dynamics
from truestroke.model.layout import TERMS

FORMAT, VERSION = "truestroke model", 1
KEYS = {
    "thresholds_V": "thresholds",
    "rate_dependent": "rate_dependent",
    "creep_times_s": "creep_times",
    "asymmetry": "asymmetry",
    "delay_s": "delay",
    "time_constant_s": "time_constant",
    "rate_scale_s_per_um": "rate_scale",
    "stroke_um": "stroke",
    "zero_um": "zero",
    "voltage_range_V": "voltage_range",
    "velocity_um_per_s": "velocity",
    "usual_velocity_um_per_s": "usual_velocity",
    "tested_frequency_Hz": "tested_frequency",
    "noise_um": "noise",
    "voltage_noise_V": "voltage_noise",
    "walk_um_per_root_s": "walk",
    "trend_um_per_s": "trend",
    "drift_um_per_s": "drift",
    "jitter_s": "jitter",
    "coverage_factor": "coverage_factor",
}
"""Keys of the file's table [model], and the members of `ActuatorModel` that they hold."""
SINCE = {
    "time_constant_s": 0.0,
    "usual_velocity_um_per_s": 0.0,
    "tested_frequency_Hz": 0.0,
    "voltage_noise_V": 0.0,
    "walk_um_per_root_s": 0.0,
    "trend_um_per_s": 0.0,
    "drift_um_per_s": 0.0,
    "jitter_s": 0.0,
    "coverage_factor": 1.96,
}
"""Keys that files of an earlier version do not have, and what they had."""
OLD = {"rated": "rate_dependent", "bends": "asymmetry", "figures": "metrics"}
"""Keys and tables of files of an earlier version, which also named the weights of the asymmetry `bend 1`, `bend 2`."""


class ModelFileError(files.FileError):
    """A model file that cannot be used; names the file and the reason."""


class BadModelError(ModelFileError):
    """A model that can be read, whose verdict is bad; names the file and the first reason."""


def save_model(path: str | os.PathLike[str], model: ActuatorModel) -> None:
    """Write the model to a TOML file.

    Parameters
    ----------
    path : str or PathLike
        File; a model that is there is replaced.
    model : ActuatorModel
        `Identified.model`, for one.

    Raises
    ------
    ModelFileError
        A number of the model is not finite.
    FileExistsError
        A file is there that is no model; within `files.overwriting` it is replaced.
    """
    words = "an ActuatorModel, such as identify(record).model; the order is path, model"
    checks.instance("model", model, ActuatorModel, words)
    checks.path("path", path)
    lines = [f"format = {_toml(FORMAT)}", f"version = {VERSION}", *_sections(model, "")]
    if model.before is not None:
        lines += ["", "# What it was refined from, to undo a pass that is worse", *_sections(model.before, "before.")]
    files.write(path, "\n".join(lines) + "\n", files.MODEL)


def _sections(model: ActuatorModel, prefix: str) -> list[str]:
    """The tables of a model as lines, each after an empty one."""
    lines = ["", f"[{prefix}model]"]
    lines += [f"{key} = {_toml(getattr(model, name))}" for key, name in KEYS.items()]
    lines += ["", f"[{prefix}weights] # +- standard deviation"]
    for name, unit, weight, deviation in zip(model.names, model.units, model.weights, model.deviations, strict=True):
        lines.append(f"{_toml(name)} = {_toml(weight)} # +- {deviation:.2g} {unit}")
    lines += ["", f"[{prefix}covariance] # of the weights, in the squares of their units", "lower_triangle = ["]
    lines += [f"  {_toml(row[: i + 1])}," for i, row in enumerate(model.covariance)]
    lines += [
        "]",
        *_dynamics(model.dynamics, prefix),
        *_branches(model.branches, prefix),
        *_explored(model.explored, prefix),
        "",
        f"[{prefix}metrics]",
        *_table(model.metrics.items()),
        "",
        f"[{prefix}provenance]",
    ]
    lines += _table(model.provenance.items())
    if model.plain is not None:
        lines += ["", "# The model of plays alone, which controllers start from"]
        lines += _sections(model.plain, f"{prefix}plain.")
    return lines


def _branches(branches: Branches | None, prefix: str) -> list[str]:
    """The table of plays of curved voltages, cells and states of Duhem; nothing without any."""
    if branches is None:
        return []
    entries = [(name, value) for name, value in dataclasses.asdict(branches).items() if name != "weights"]
    lines = ["", f"[{prefix}branches] # voltage_range: V; betas: over the voltage range", *_table(entries)]
    weights = [f"  {_toml(weight)}, # {name}" for name, weight in zip(branches.names, branches.weights, strict=True)]
    return [*lines, "weights = [ # um/V", *weights, "]"]


def _explored(explored: Explored | None, prefix: str) -> list[str]:
    """The table of where the record has been; nothing without it."""
    if explored is None:
        return []
    of = "voltage, voltage beyond three plays, velocity"
    lines = ["", f"[{prefix}explored] # by the record: growth, um; {of}", f"growth = {_toml(explored.growth)}"]
    lines += [f"inner = {_toml(explored.inner)}"] if explored.inner else []
    return [*lines, "places = [", *[f"  {_toml(row)}," for row in explored.places], "]"]


def _dynamics(dynamics: Dynamics | None, prefix: str) -> list[str]:
    """The table of the stage, as of `Dynamics.to_dict`; nothing without any."""
    if dynamics is None:
        return []
    table = dynamics.to_dict()
    modes, uncertainty = table.pop("modes"), table.pop("uncertainty")
    lines = ["", f"[{prefix}dynamics] # of the stage: Hz, s", *_table(table.items())]
    for mode in modes:
        lines += [
            "",
            f"[[{prefix}dynamics.modes]] # frequency: Hz; share: of the static displacement",
            *_table(mode.items()),
        ]
    return [*lines, "", f"[{prefix}dynamics.uncertainty] # standard deviations", *_table(uncertainty.items())]


def load_model(path: str | os.PathLike[str]) -> ActuatorModel:
    """Read a model that `save_model` wrote, perhaps edited since.

    Raises
    ------
    ModelFileError
        The file is not there, is no TOML, no model, of a newer version, lacks an entry, has one too many or one that
        is out of bounds.
    """
    checks.path("path", path)
    with files.reading(path, lambda reason: ModelFileError(f"{os.fspath(path)}: {reason}")):
        return _read(Path(path))


def usable_model(path: str | os.PathLike[str], *, force: bool = False) -> ActuatorModel:
    """Read a model that is about to be used: what `identify` found to speak against it is said.

    Parameters
    ----------
    path : str or PathLike
        Of `save_model`.
    force : bool
        Whether a model whose verdict is bad is used, too, with a warning.

    Raises
    ------
    BadModelError
        The verdict of the model is bad.
    ModelFileError
        As `load_model`.

    Warns
    -----
    ModelWarning
        The verdict is doubtful, or bad with `force`.
    """
    known, source = load_model(path), f"{os.fspath(path)}: "
    if not force:
        _refuse_bad(known, source)
    _warn_once(known, source, 3)
    return known


def taken(model: ActuatorModel | str | os.PathLike[str]) -> ActuatorModel:
    """For a function that takes either: the file, as `usable_model`, or the model; a warning shows its caller.

    Of a model the warning is given only where it is bad: who identified it has read its verdict.
    """
    if isinstance(model, ActuatorModel):
        if model.verdict.is_bad:
            _warn_once(model, "", 4)
        return model
    if not isinstance(model, str | os.PathLike):
        raise SettingError("model", checks.described(model), "an ActuatorModel, or the file of one in quotes")
    known, source = load_model(model), f"{os.fspath(model)}: "
    _refuse_bad(known, source)
    _warn_once(known, source, 4)
    return known


def _refuse_bad(model: ActuatorModel, source: str) -> None:
    if model.verdict.is_bad:
        remedy = "Record again and identify a better one, or use it by `force`, in Python `load_model`"
        raise BadModelError(f"{_said(model, source)}. {remedy}")


_warned: weakref.WeakSet[ActuatorModel] = weakref.WeakSet()


def _warn_once(model: ActuatorModel, source: str, stacklevel: int) -> None:
    """A model that `usable_model` returned has been warned of when it is handed on."""
    if model.verdict.level != "good" and model not in _warned:
        _warned.add(model)
        warnings.warn(f"{_said(model, source)}.", ModelWarning, stacklevel=stacklevel)


def _said(model: ActuatorModel, source: str) -> str:
    reason = " ".join(model.verdict.reasons[:1])
    return f"{source}the verdict of this model is {model.verdict.level}: {reason}".rstrip(": .")


def _read(path: Path) -> ActuatorModel:
    try:
        return _model(toml.read(path))
    except FileNotFoundError:
        raise ModelFileError(f"{os.fspath(path)}: there is no such file") from None
    except (OSError, SettingError) as error:
        raise ModelFileError(f"{os.fspath(path)}: {error}") from error


@dataclass(frozen=True, kw_only=True)
class _Covariance:
    lower_triangle: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True, kw_only=True)
class _Explored:
    places: tuple[tuple[Any, ...], ...]
    growth: float
    inner: float = 0.0


@dataclass(frozen=True, kw_only=True)
class _Tables:
    """The tables that a model consists of."""

    model: Mapping[str, Any]
    weights: Mapping[str, Any]
    covariance: _Covariance
    metrics: Mapping[str, Any]
    provenance: Mapping[str, Any]
    dynamics: Dynamics | None = None
    branches: Branches | None = None
    explored: _Explored | None = None
    plain: Mapping[str, Any] | None = None


def _model(document: dict[str, Any]) -> ActuatorModel:
    for key, wanted in (("format", FORMAT), ("version", VERSION)):
        if document.get(key) != wanted:
            bound = f"{wanted!r}: else it is not a {FORMAT} of this version, which `truestroke identify` writes"
            raise SettingError(key, repr(document.get(key)), bound)
    model = _of_tables(toml.decode(_Tables, _renamed(document), also=("format", "version", "before")))
    if "before" not in document:
        return model
    return model.replace(before=_inner("before", document["before"]))


def _inner(name: str, table: Mapping[str, Any] | None) -> ActuatorModel | None:
    """The model in a table of another one."""
    if table is None:
        return None
    tables = toml.value(name, _renamed(table), _Tables)
    with checks.inside(f"{name}."):
        return _of_tables(tables)


def _renamed(table: Any) -> Any:
    """A table whose keys have the names of now."""
    return {OLD.get(key, key): value for key, value in table.items()} if isinstance(table, Mapping) else table


def _of_tables(tables: _Tables) -> ActuatorModel:
    entries = {**SINCE, **_renamed(tables.model)}
    weights = {re.sub("^bend ", "asymmetry ", name): value for name, value in tables.weights.items()}
    with checks.inside("model.", {name: key for key, name in KEYS.items()}):
        checks.known(entries, KEYS)
        members = toml.arguments(ActuatorModel, {name: toml.needed(entries, key) for key, name in KEYS.items()})
    flags: dict[str, Any] = {term.setting: name in weights for name, term in TERMS.items() if term.most == 1}
    model = ActuatorModel(
        **members,
        **flags,
        weights=_numbers(weights.values()),
        covariance=_symmetric(tables.covariance.lower_triangle, len(weights)),
        dynamics=tables.dynamics,
        branches=tables.branches,
        explored=_of_places(tables.explored),
        plain=_inner("plain", tables.plain),
        metrics=tables.metrics,
        provenance=tables.provenance,
    )
    if tuple(weights) != model.names:
        raise SettingError("weights", ", ".join(weights), ", ".join(model.names))
    return model


def _numbers(entries: Iterable[Any]) -> FloatArray:
    """As an array where all are numbers; else as they are, so that the model's check names the first that is not."""
    values: Any = list(entries)
    return np.array(values, dtype=np.float64) if all(isinstance(v, int | float) for v in values) else values


def _symmetric(rows: tuple[tuple[Any, ...], ...], m: int) -> FloatArray:
    if [len(row) for row in rows] != [*range(1, m + 1)]:
        raise SettingError("covariance.lower_triangle", f"{len(rows)} rows", f"{m} rows of 1 to {m} numbers")
    P = np.zeros((m, m))
    for i, row in enumerate(rows):
        P[i, : i + 1] = P[: i + 1, i] = row
    return P


def _of_places(table: _Explored | None) -> Explored | None:
    if table is None:
        return None
    if len({len(row) for row in table.places}) > 1:
        raise SettingError("explored.places", "rows of unlike length", "rows of 5 numbers")
    return Explored(np.array([_numbers(row) for row in table.places]), table.growth, table.inner)


# ---- TOML ----------------------------------------------------------------------------------------------------------


def _table(entries: Iterable[tuple[str, Any]]) -> list[str]:
    return [f"{_toml(key)} = {_toml(value)}" for key, value in entries]


def _toml(value: Any) -> str:
    try:
        return toml.text(value)
    except ValueError as error:
        raise ModelFileError(f"in the model {error}") from None
