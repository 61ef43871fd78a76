"""The configuration of `truestroke run`: a TOML file becomes driver, axes and settings."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from truestroke import trajectories
from truestroke._check import SettingError
from truestroke.controller import AdaptiveController, Controller
from truestroke.drivers.protocol import Driver
from truestroke.realtime.epics import EpicsSettings
from truestroke.realtime.motion import SetPoint
from truestroke.realtime.settings import Axis, RealtimeSettings
from truestroke.settings import ControllerSettings
from truestroke.trajectories import Trajectory

DRIVERS = tuple(
    name for name in ("simulated", "nidaqmx", "pi") if importlib.util.find_spec(f"truestroke.drivers.{name}")
)
MOTIONS = {
    **{kind: getattr(trajectories, kind) for kind in ("random_wave", "sine", "triangle", "staircase", "from_csv")},
    "set_point": SetPoint,
}
CONTROLLERS = ("adaptive", "paper")
TABLES = ("driver", "axis", "realtime", "recording", "epics")
AXIS = ("name", "stroke", "voltage_limits", "safe_voltage", "slew", "controller", "model", "settings", "trajectory")


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
        A key is unknown or missing, or a value is out of its bounds.
    OSError
        It cannot be read.
    """
    path = Path(path)
    return job(_document(path), path.parent)


def job(document: Mapping[str, Any], folder: Path) -> Job:
    """From the tables of a configuration; files are looked for in `folder`.

    Examples
    --------
    >>> job({"driver": {"name": "simulated", "blok": 5}}, Path())
    Traceback (most recent call last):
        ...
    truestroke._check.SettingError: driver.blok = 5: must be left out; there are block, channels, faults, \
hardware_timed, latency, name, plant, register, sample_rate, seed
    """
    _known("", document, TABLES)
    made = driver(_table(document, "driver"))
    tables = document.get("axis")
    if not isinstance(tables, list) or not tables:
        raise SettingError("axis", tables, "at least one table [[axis]]")
    recording = _table(document, "recording")
    _known("recording.", recording, ("file",))
    return Job(
        driver=made,
        axes=tuple(_axis(table, folder) for table in tables),
        settings=_made("realtime.", RealtimeSettings, document.get("realtime", {})),
        file=Path(_needed("recording.", recording, "file")),
        epics=_made("epics.", EpicsSettings, _table(document, "epics")) if "epics" in document else None,
    )


def driver(table: Mapping[str, Any]) -> Driver:
    """The driver of a table [driver]: its name, and its settings."""
    given = dict(table)
    name = _one_of("driver.name", _needed("driver.", given, "name"), DRIVERS)
    module = importlib.import_module(f"truestroke.drivers.{name}")
    made: Driver = getattr(module, f"{name.capitalize()}Driver")(
        _made("driver.", getattr(module, f"{name.capitalize()}Settings"), given, also=("name",))
    )
    return made


def one_axis(path: str | os.PathLike[str]) -> tuple[Driver, dict[str, Any]]:
    """Driver and limits of a configuration with one axis; what else is in it is for `truestroke run`.

    Returns
    -------
    driver : Driver
    limits : dict
        voltage_limits (V), slew (V/s) and, if it is there, safe_voltage (V), as `OneAxis` takes them.

    Raises
    ------
    SettingError, OSError
        As `load`.
    """
    path = Path(path)
    document = _document(path)
    axes = document.get("axis")
    if not isinstance(axes, list) or len(axes) != 1:
        raise SettingError(f"{path}: axis", f"{len(axes) if isinstance(axes, list) else 0} tables", "one [[axis]]")
    (axis,) = axes
    limits = {"voltage_limits": tuple(_needed("axis.", axis, "voltage_limits")), "slew": _needed("axis.", axis, "slew")}
    if "safe_voltage" in axis:
        limits["safe_voltage"] = axis["safe_voltage"]
    return driver(_table(document, "driver")), limits


def _document(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingError(str(path), "the file", f"TOML ({error})") from None


def _axis(table: Mapping[str, Any], folder: Path) -> Axis:
    _known("axis.", table, AXIS)
    motion = _trajectory(dict(_table(table, "trajectory", "axis.")), folder)
    given = {key: table[key] for key in ("name", "safe_voltage") if key in table}
    limits, slew = (_needed("axis.", table, key) for key in ("voltage_limits", "slew"))
    controller = _controller(table, motion.sample_rate, folder)
    return Axis(trajectory=motion, controller=controller, voltage_limits=limits, slew=slew, **given)


def _trajectory(given: dict[str, Any], folder: Path) -> Trajectory | SetPoint:
    kind = _one_of("axis.trajectory.kind", _needed("axis.trajectory.", given, "kind"), tuple(MOTIONS))
    if "path" in given:
        given["path"] = folder / given["path"]
    motion: Trajectory | SetPoint = _made("axis.trajectory.", MOTIONS[kind], given, also=("kind",))
    return motion


def _controller(table: Mapping[str, Any], sample_rate: float, folder: Path) -> Controller:
    limits, slew = tuple(table["voltage_limits"]), table["slew"]
    fixed: dict[str, Any] = {"sample_rate": sample_rate, "voltage_limits": limits}
    extra = _table(table, "settings", "axis.", {})
    own = {*fixed, "slew_limit", "stroke"}
    _known("axis.settings.", extra, [n for n in ControllerSettings.__dataclass_fields__ if n not in own])
    if "model" in table:
        for key in ("controller", "stroke"):
            if key in table:
                raise SettingError(f"axis.{key}", table[key], "left out where there is a model")
        return AdaptiveController.from_model(folder / table["model"], slew_limit=slew, **fixed, **extra)
    fixed["stroke"] = _needed("axis.", table, "stroke")
    if _one_of("axis.controller", table.get("controller", "adaptive"), CONTROLLERS) == "adaptive":
        return AdaptiveController(slew_limit=slew, **fixed, **extra)
    _known("axis.settings.", extra, ())  # the literal algorithm has none
    return AdaptiveController.paper(**fixed)


# ---- Tables --------------------------------------------------------------------------------------------------------


def _table(document: Mapping[str, Any], key: str, where: str = "", default: Any = None) -> Mapping[str, Any]:
    value = document.get(key, default)
    if not isinstance(value, Mapping):
        raise SettingError(where + key, value, f"a table [{where + key}]")
    return value


def _needed(where: str, table: Mapping[str, Any], key: str) -> Any:
    if key not in table:
        raise SettingError(where + key, "missing", "given")
    return table[key]


def _known(where: str, table: Mapping[str, Any], names: tuple[str, ...] | list[str]) -> None:
    for key, value in table.items():
        if key not in names:
            raise SettingError(where + key, value, f"left out; there are {', '.join(names) or 'none'}")


def _one_of(key: str, value: Any, names: tuple[str, ...]) -> str:
    if value not in names:
        raise SettingError(key, repr(value), f"one of {', '.join(names)}")
    return str(value)


def _made(where: str, make: Callable[..., Any], table: Mapping[str, Any], also: tuple[str, ...] = ()) -> Any:
    """make(**table), if the keys are its parameters; `also` are keys that it does not get."""
    parameters = inspect.signature(make).parameters
    _known(where, table, sorted({*parameters, *also}))
    for name, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty:
            _needed(where, table, name)
    given = {key: tuple(v) if isinstance(v, list) else v for key, v in table.items() if key not in also}
    return make(**given)
