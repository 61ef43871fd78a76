"""The configuration of `truestroke run`: a TOML file becomes driver, axes and settings."""

from __future__ import annotations

import importlib
import importlib.util
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_type_hints

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.controller import AdaptiveController, Controller
from truestroke.control.settings import ControllerSettings
from truestroke.identification import ActuatorModel, ModelFileError, load_model
from truestroke.runtime.drivers.protocol import Driver
from truestroke.runtime.realtime.epics import EpicsSettings
from truestroke.runtime.realtime.motion import SetPoint
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings
from truestroke.signals import trajectories
from truestroke.signals.trajectories import Trajectory

DRIVERS = tuple(
    name for name in ("simulated", "nidaqmx", "pi") if importlib.util.find_spec(f"truestroke.runtime.drivers.{name}")
)
MOTIONS = {
    **{kind: getattr(trajectories, kind) for kind in ("random_wave", "sine", "triangle", "staircase", "from_csv")},
    "set_point": SetPoint,
}
CONTROLLERS = ("adaptive", "paper")
TABLES = ("driver", "axis", "realtime", "recording", "epics")
AXIS = (
    *("name", "stroke", "resonance", "voltage_limits", "safe_voltage", "slew"),
    *("controller", "model", "settings", "trajectory"),
    *("zero", "error_limit"),
)


@dataclass(frozen=True, kw_only=True)
class Job:
    """What `run_realtime` needs."""

    driver: Driver
    axes: tuple[Axis, ...]
    settings: RealtimeSettings
    file: Path
    epics: EpicsSettings | None = None


def example(command: Literal["run", "serve"] = "run") -> str:
    """A configuration with comments, of a simulated stack."""
    return Path(__file__).with_name("example.toml" if command == "run" else "serve.toml").read_text(encoding="utf-8")


def load(path: str | os.PathLike[str]) -> Job:
    """Read a configuration.

    Parameters
    ----------
    path : str or PathLike
        TOML; files that it names are looked for beside it, the recording goes to the current folder.

    Raises
    ------
    SettingError
        A key is unknown or missing, a value of the wrong type or out of its bounds: names file and key.
    OSError
        It cannot be read.
    """
    path = Path(path)
    document = _document(path)
    with checks.inside(f"{path}: "):
        return job(document, path.parent)


def job(document: Mapping[str, Any], folder: Path) -> Job:
    """From the tables of a configuration; files are looked for in `folder`.

    Examples
    --------
    >>> job({"driver": {"name": "simulated", "blok": 5}}, Path())
    Traceback (most recent call last):
        ...
    truestroke.SettingError: driver.blok = 5: must be left out; did you mean block? There are block, channels, \
faults, hardware_timed, latency, name, plant, register, sample_rate, seed
    """
    checks.known(document, TABLES)
    made, rate = driver(_table(document, "driver"))
    tables = document.get("axis")
    if not isinstance(tables, list) or not tables:
        raise SettingError("axis", repr(tables), "at least one table [[axis]]")
    with checks.inside("recording."):
        recording = _table(document, "recording")
        checks.known(recording, ("file",))
        file = checks.needed(recording, "file")
        checks.typed("file", file, str)
    return Job(
        driver=made,
        axes=tuple(_axis(table, place, folder, rate) for place, table in _numbered(tables)),
        settings=_made("realtime.", RealtimeSettings, _table(document, "realtime", {})),
        file=Path(file),
        epics=_made("epics.", EpicsSettings, _table(document, "epics")) if "epics" in document else None,
    )


def driver(table: Mapping[str, Any]) -> tuple[Driver, float]:
    """The driver of a table [driver]: its name, and its settings; and its ticks per second, Hz."""
    with checks.inside("driver."):
        name = _one_of("name", checks.needed(table, "name"), DRIVERS)
    module = importlib.import_module(f"truestroke.runtime.drivers.{name}")
    settings = _made("driver.", getattr(module, f"{name.capitalize()}Settings"), table, also=("name",))
    with checks.inside("driver."):
        made: Driver = getattr(module, f"{name.capitalize()}Driver")(settings)
    return made, settings.sample_rate


@dataclass(frozen=True, kw_only=True)
class OneAxisJob:
    """What an experiment on one axis needs of a configuration: `OneAxis(job.driver, **job.limits)`.

    Attributes
    ----------
    driver : Driver
        Its hardware.
    limits : dict
        voltage_limits (V), slew (V/s) and, if it is there, safe_voltage (V), as `OneAxis` takes them.
    name : str
        Of the axis.
    stroke, resonance : float, optional
        um; Hz; where the file has them.
    model : bool
        Whether the stroke is that of a model.
    zero : float, "measured" or None
        What is subtracted from the sensor, um, as of `Axis`.
    """

    driver: Driver
    limits: dict[str, Any]
    name: str
    stroke: float | None
    resonance: float | None
    model: bool = False
    zero: float | str | None = None


def one_axis(path: str | os.PathLike[str]) -> OneAxisJob:
    """Driver, limits and what else is known of the axis of a configuration with one.

    Raises
    ------
    SettingError, OSError
        As `load`.
    """
    path = Path(path)
    document = _document(path)
    with checks.inside(f"{path}: "):
        axes = document.get("axis")
        if not isinstance(axes, list) or len(axes) != 1:
            raise SettingError("axis", f"{len(axes) if isinstance(axes, list) else 0} tables", "one [[axis]]")
        ((place, axis),) = _numbered(axes)
        made, _ = driver(_table(document, "driver"))
        with checks.inside(place):
            checks.known(axis, AXIS)
            known: dict[str, Any] = {"model": "model" in axis, "zero": axis.get("zero")}
            return OneAxisJob(driver=made, limits=_limits(axis), **known, **_named(axis))


def _named(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Name, stroke (um) and resonance (Hz) of an axis."""
    name = axis.get("name", "axis")
    checks.typed("name", name, str)
    units = {"stroke": "um", "resonance": "Hz"}
    return {"name": name} | {
        key: checks.positive(key, axis[key], unit) if key in axis else None for key, unit in units.items()
    }


def _document(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SettingError(str(path), "the file", f"TOML ({error})") from None


def _numbered(tables: list[Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Each [[axis]] with its path in messages: of one axis "axis.", else counted from 1."""
    for number, table in enumerate(tables, 1):
        place = "axis" if len(tables) == 1 else f"[[axis]] {number}"
        if not isinstance(table, Mapping):
            raise SettingError(place, repr(table), "a table [[axis]]")
        yield place + ("." if len(tables) == 1 else ": "), table


def _limits(axis: Mapping[str, Any]) -> dict[str, Any]:
    """voltage_limits, slew and, if it is there, safe_voltage, of the right types."""
    checks.typed("voltage_limits", checks.needed(axis, "voltage_limits"), tuple[float, ...])
    low, high = checks.interval("voltage_limits", axis["voltage_limits"], "V")
    slew = checks.positive("slew", checks.needed(axis, "slew"), "V/s")
    limits: dict[str, Any] = {"voltage_limits": (low, high), "slew": slew}
    if "safe_voltage" in axis:
        limits["safe_voltage"] = checks.within("safe_voltage", axis["safe_voltage"], low, high, "V")
    return limits


def _axis(table: Mapping[str, Any], place: str, folder: Path, rate: float) -> Axis:
    with checks.inside(place):
        checks.known(table, AXIS)
        limits, name = _limits(table), _named(table)["name"]
        given = _table(table, "trajectory", whole="axis.trajectory")
        with checks.inside("trajectory."):
            motion = _trajectory(given, folder, rate)
        controller = _controller(table, limits, motion.sample_rate, folder)
        watched = {key: table[key] for key in ("zero", "error_limit") if key in table}
        return Axis(trajectory=motion, controller=controller, name=name, **limits, **watched)


def _trajectory(given: Mapping[str, Any], folder: Path, rate: float) -> Trajectory | SetPoint:
    """The motion; its sample rate is that of the driver, Hz, unless it has one of its own."""
    kind = _one_of("kind", checks.needed(given, "kind"), tuple(MOTIONS))
    given = {"sample_rate": rate, **given}
    if isinstance(given.get("path"), str):
        given["path"] = str(folder / given["path"])
    try:
        motion: Trajectory | SetPoint = _made("", MOTIONS[kind], given, also=("kind",))
    except OSError as error:
        raise SettingError("path", repr(given["path"]), f"a file that can be read ({error.strerror})") from None
    return motion


def _controller(table: Mapping[str, Any], limits: Mapping[str, Any], sample_rate: float, folder: Path) -> Controller:
    fixed: dict[str, Any] = {"sample_rate": sample_rate, "voltage_limits": limits["voltage_limits"]}
    known = _named(table)["resonance"]
    extra = ({} if known is None else {"resonance": known}) | _settings(table)
    kind = _one_of("controller", table.get("controller", "adaptive"), CONTROLLERS)
    renamed = {name: f"settings.{name}" for name in extra} | {"slew_limit": "slew", "resonance": "resonance"}
    if "model" in table:
        for key in (key for key in ("controller", "stroke") if key in table):
            raise SettingError(key, repr(table[key]), "left out where there is a model")
        model = _model(table["model"], folder)
        with checks.inside("", renamed):
            return AdaptiveController.from_model(model, slew_limit=limits["slew"], **fixed, **extra)
    fixed["stroke"] = checks.positive("stroke", checks.needed(table, "stroke"), "um")
    if kind == "paper":
        with checks.inside("settings."):
            checks.known(_settings(table), ())  # the literal algorithm has none
        return AdaptiveController.paper(**fixed)
    with checks.inside("", renamed):
        return AdaptiveController(slew_limit=limits["slew"], **fixed, **extra)


def _settings(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table axis.settings: members of `ControllerSettings` that no key of [[axis]] stands for."""
    with checks.inside("settings."):
        extra = dict(_table(table, "settings", {}))
        own = {"sample_rate", "voltage_limits", "slew_limit", "stroke", "resonance"}
        hints = get_type_hints(ControllerSettings)
        checks.known(extra, [name for name in ControllerSettings.__dataclass_fields__ if name not in own])
        for name, value in extra.items():
            checks.typed(name, value, hints[name])
    return extra


def _model(name: Any, folder: Path) -> ActuatorModel:
    checks.typed("model", name, str)
    try:
        return load_model(folder / name)
    except ModelFileError as error:
        raise SettingError("model", repr(name), f"a model of truestroke identify ({error})") from None


# ---- Tables --------------------------------------------------------------------------------------------------------


def _table(document: Mapping[str, Any], key: str, default: Any = None, whole: str = "") -> Mapping[str, Any]:
    value = document.get(key, default)
    if not isinstance(value, Mapping):
        raise SettingError(key, repr(value), f"a table [{whole or key}]")
    return value


def _one_of(key: str, value: Any, names: tuple[str, ...]) -> str:
    if value not in names:
        raise SettingError(key, repr(value), f"one of {', '.join(names)}")
    return str(value)


def _made(where: str, make: Callable[..., Any], table: Mapping[str, Any], also: tuple[str, ...] = ()) -> Any:
    """What `table` describes; `also` are keys that it has for others."""
    with checks.inside(where):
        return checks.made(make, table, also)
