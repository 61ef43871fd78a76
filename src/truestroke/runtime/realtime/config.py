"""The configuration of `truestroke run`: a TOML file becomes driver, axes and settings."""

import dataclasses
import inspect
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from truestroke.base import checks, frames, toml
from truestroke.base.checks import SettingError
from truestroke.base.files import FileError
from truestroke.control import feasibility
from truestroke.control.actuator import ActuatorModel
from truestroke.control.controller import AdaptiveController, Controller
from truestroke.control.model_file import BadModelError, ModelFileError, usable_model
from truestroke.control.repeating.repetition import check_repeats
from truestroke.control.repeating.repetitive import RepetitiveController
from truestroke.control.settings import ControllerSettings
from truestroke.model.dynamics import Dynamics
from truestroke.runtime.drivers import registry
from truestroke.runtime.drivers.guard import Limits
from truestroke.runtime.drivers.protocol import Driver
from truestroke.runtime.drivers.single_channel import SingleChannel
from truestroke.runtime.drivers.turned import Turned
from truestroke.runtime.realtime.coupled import couple
from truestroke.runtime.realtime.epics import EpicsSettings
from truestroke.runtime.realtime.imaging import Imaging, check_stage, imaging
from truestroke.runtime.realtime.live_page import LiveSettings
from truestroke.runtime.realtime.motion import SetPoint
from truestroke.runtime.realtime.settings import Axis, RealtimeSettings, files_of
from truestroke.signals import trajectories
from truestroke.signals.trajectories import Trajectory

MOTIONS = {
    **{kind: getattr(trajectories, kind) for kind in ("random_wave", "sine", "triangle", "raster", "staircase")},
    **{kind: getattr(trajectories, kind) for kind in ("step", "from_csv")},
    "set_point": SetPoint,
}
OWN = ("sample_rate", "voltage_limits", "slew_limit", "stroke", "resonance")
"""Members of `ControllerSettings` that other keys replace."""
AHEAD = "left out: another program moves the axes, and their motion is not known ahead"


@dataclass(frozen=True, kw_only=True)
class AxisTable:
    """A table [[axis]], and what docs/run.md says of each key."""

    name: str = "axis"
    stroke: float | None = field(
        default=None, metadata={"unit": "um", "example": "stroke = 30.0 (um), the length of the travel"}
    )
    resonance: float = field(default=0.0, metadata={"unit": "Hz"})
    voltage_limits: tuple[float, ...] = field(
        metadata={"unit": "V", "example": "voltage_limits = [0.0, 10.0] (V), of the amplifier's input"}
    )
    safe_voltage: float = field(default=0.0, metadata={"unit": "V"})
    slew: float = field(metadata={"unit": "V/s", "example": "slew = 400.0 (V/s)"})
    controller: Literal["adaptive", "paper"] | None = None
    period: float | None = field(default=None, metadata={"unit": "s"})
    model: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    trajectory: Mapping[str, Any] = field(default_factory=dict)
    zero: float | Literal["measured"] | None = field(default=None, metadata={"unit": "um"})
    error_limit: float | None = field(default=None, metadata={"unit": "um"})

    def __post_init__(self) -> None:
        Limits(**self.limits)
        checks.within("resonance", self.resonance, 0.0, 1e9, "Hz")
        if self.stroke is not None:
            checks.positive("stroke", self.stroke, "um")

    def needed_stroke(self) -> float:
        """The stroke, um, where nothing else says it."""
        example = str(type(self).__dataclass_fields__["stroke"].metadata["example"])
        return float(toml.needed({} if self.stroke is None else {"stroke": self.stroke}, "stroke", example))

    @property
    def limits(self) -> dict[str, Any]:
        """voltage_limits (V), slew (V/s) and safe_voltage (V), as `OneAxis` takes them."""
        return {name: getattr(self, name) for name in ("voltage_limits", "slew", "safe_voltage")}


@dataclass(frozen=True, kw_only=True)
class RecordingTable:
    """The table [recording]."""

    file: str = "run.h5"

    def __post_init__(self) -> None:
        files_of("file", Path(self.file), ["axis"])


@dataclass(frozen=True, kw_only=True)
class CoupledTable:
    """The table [coupled]: the axes know how the others move.

    Its keys say how the sensors stand, and what period of the motion all axes learn.
    """

    rotation: float = field(default=0.0, metadata={"unit": "degrees"})
    skew: float = field(default=0.0, metadata={"unit": "degrees"})
    frame: tuple[tuple[float, ...], ...] | None = None
    period: float | None = field(default=None, metadata={"unit": "s"})

    def of(self, axes: int) -> frames.Matrix | None:
        """The frame of so many axes; None: each sensor stands along its axis."""
        if self.frame is not None:
            if self.rotation or self.skew:
                raise SettingError("frame", self.frame, "left out, or rotation and skew")
            return frames.frame("frame", self.frame, axes)
        if not (self.rotation or self.skew):
            return None
        if axes != 2:
            raise SettingError("rotation", self.rotation, f"left out: {axes} axes need frame", "degrees")
        return frames.sensor_frame(self.rotation, self.skew)


@dataclass(frozen=True, kw_only=True)
class Document:
    """The tables of a configuration; what those of driver and axes hold is read with the help of the others."""

    driver: Mapping[str, Any] = field(metadata={"example": 'a table [driver] with name = "simulated"'})
    axis: tuple[Mapping[str, Any], ...] = field(metadata={"example": 'a table [[axis]] with name = "x"'})
    scan: Mapping[str, Any] | None = None
    coupled: CoupledTable | None = None
    realtime: RealtimeSettings = field(default_factory=RealtimeSettings)
    recording: RecordingTable = field(default_factory=RecordingTable)
    epics: EpicsSettings | None = None
    live: LiveSettings = field(default_factory=LiveSettings)


_PLACES: Mapping[str, Iterable[str]] = {
    "in [axis.trajectory]": {name for make in MOTIONS.values() for name in inspect.signature(make).parameters},
    "in settings of [[axis]]": ControllerSettings.__dataclass_fields__,
    "in [coupled]": CoupledTable.__dataclass_fields__,
    "in [realtime]": RealtimeSettings.__dataclass_fields__,
    "in [recording]": RecordingTable.__dataclass_fields__,
    "in [[axis]], above its other tables": AxisTable.__dataclass_fields__,
    "in [driver] or [[axis]]": ("name",),
    "in [driver]: all axes have one clock": ("sample_rate",),
    "slew, in [[axis]]": ("slew_limit",),
    "[axis.trajectory], below its [[axis]]": ("trajectory",),
}
"""Where keys belong, for the error of one in another table; of those in several the last counts."""


def _places(*without: str) -> dict[str, str]:
    """Where a key belongs, by its name, and not in these tables."""
    return {name: place for place, names in _PLACES.items() if place not in without for name in names}


@dataclass(frozen=True, kw_only=True)
class Job:
    """What `run_realtime` needs."""

    driver: Driver
    axes: tuple[Axis, ...]
    settings: RealtimeSettings
    file: Path
    epics: EpicsSettings | None = None
    live: LiveSettings = field(default_factory=LiveSettings)
    imaging: Imaging | None = None
    frame: frames.Matrix | None = None  # of sensors that are turned


def example(command: Literal["run", "serve"] = "run") -> str:
    """A configuration with comments, of a simulated stack."""
    return Path(__file__).with_name("example.toml" if command == "run" else "serve.toml").read_text(encoding="utf-8")


@contextmanager
def _document(path: str | os.PathLike[str]) -> Iterator[dict[str, Any]]:
    """What the file says; errors within name it."""
    with checks.inside(f"{os.fspath(path)}: "):
        document = toml.read(path)
        if "format" in document and "driver" not in document:
            configuration = "a configuration, with tables [driver] and [[axis]] (truestroke run --example)"
            raise SettingError("the file", document["format"], configuration)
        yield document


def load(path: str | os.PathLike[str]) -> Job:
    """Read a configuration.

    Parameters
    ----------
    path : str or PathLike
        TOML; the files that it names are relative to it, the recording is written to the current folder.

    Raises
    ------
    SettingError
        A key is unknown or missing, a value of the wrong type or out of its bounds: names file and key.
    OSError
        It cannot be read.
    """
    with _document(path) as document:
        return job(document, Path(path).parent)


def job(document: Mapping[str, Any], folder: Path) -> Job:
    """From the tables of a configuration; files are looked for in `folder`.

    Examples
    --------
    >>> job({"driver": {"name": "simulated", "blok": 5}, "axis": [{}], "recording": {"file": "run.h5"}}, Path())
    Traceback (most recent call last):
        ...
    truestroke.SettingError: driver.blok = 5: must be left out; did you mean block? There are name, sample_rate, \
block, latency, channels, seed, hardware_timed, register, plant, stage, axes, signals, faults
    """
    read = toml.decode(Document, document, elsewhere=_places())
    made, rate = driver(read.driver)
    tables = _tables(read.axis)
    image = None
    if read.scan is not None:
        with checks.inside("scan."):
            image = imaging(_with_dynamics(read.scan, folder), [table.name for _, table in tables], made, rate)
    axes = []
    for place, table in tables:
        with checks.inside(place):
            if read.coupled is not None and table.period is not None:
                raise SettingError("period", table.period, "left out, and in [coupled]: all axes learn it", "s")
            axes.append(_axis(table, folder, rate, image))
    if image is not None:
        with checks.inside("scan."):
            first = {table.name: table.resonance for _, table in tables}  # where the law has no such setting
            known = {axis.name: feasibility.first_mode(axis.controller) for axis in axes}
            check_stage(image, first | {name: mode.frequency for name, mode in known.items() if mode is not None})
    frame = None
    if read.coupled is not None:
        with checks.inside("coupled."):
            frame = read.coupled.of(len(axes))
        with checks.inside("", {"period": "coupled.period"}):
            axes = [*couple(axes, frame, period=read.coupled.period)]
        made = made if frame is None else Turned(made, frame)
        image = dataclasses.replace(image, frame=frame) if image else None
    usual: dict[str, Any] = {"settings": read.realtime, "file": Path(read.recording.file), "frame": frame}
    return Job(driver=made, axes=tuple(axes), imaging=image, epics=read.epics, live=read.live, **usual)


def driver(table: Mapping[str, Any]) -> tuple[Driver, float]:
    """The driver of a table [driver]: its name, and its settings; and its ticks per second, Hz."""
    with checks.inside("driver."):
        found = registry.find(toml.needed(table, "name", 'name = "simulated"'))
        others = _places("in [axis.trajectory]", "in settings of [[axis]]")  # some drivers have keys of these names
        settings = toml.decode(found.Settings, table, also=("name",), elsewhere=others)
        made: Driver = found(settings)
    return made, settings.sample_rate


def one_axis(path: str | os.PathLike[str], axis: str | None = None) -> tuple[Driver, AxisTable]:
    """Driver and axis of a configuration, for an experiment: `OneAxis(driver, **axis.limits)`.

    Where it has several, `axis` names one: the others are set to their safe voltages at once, and held there.

    Raises
    ------
    SettingError, OSError
        As `load`.
    """
    made, table, _ = one_axis_at(path, axis)
    return made, table


def one_axis_at(path: str | os.PathLike[str], axis: str | None = None) -> tuple[Driver, AxisTable, float]:
    """The same, and the ticks per second of the driver, Hz.

    Raises
    ------
    SettingError, OSError
        As `load`.
    """
    with _document(path) as document:
        tables = {table.name: table for _, table in _tables(_axes(document))}
        if axis is None and len(tables) > 1:
            raise SettingError("`axis`", "missing", f"one of {', '.join(tables)}: the configuration has several axes")
        if axis is not None and axis not in tables:
            raise SettingError("`axis`", repr(axis), f"one of {', '.join(tables)}")
        made, rate = driver(toml.value("driver", toml.needed(document, "driver"), Mapping))
        name = next(iter(tables)) if axis is None else axis
        if len(tables) > 1:
            coupled: CoupledTable = toml.value("coupled", document.get("coupled", {}), CoupledTable)
            with checks.inside("coupled."):
                frame = coupled.of(len(tables))
            limits = {name: Limits(**one.limits) for name, one in tables.items()}
            safe = {name: one.safe_voltage for name, one in limits.items()}
            highest = {name: one.voltage_limits for name, one in limits.items()}
            made = made if frame is None else Turned(made, frame)
            made = SingleChannel(made, name, safe, voltage_limits=highest)
        return made, tables[name], rate


def live(path: str | os.PathLike[str]) -> LiveSettings:
    """The table [live] of a configuration, or what holds without one.

    Raises
    ------
    SettingError, OSError
        As `load`.
    """
    with _document(path) as document:
        found: LiveSettings = toml.value("live", document.get("live", {}), LiveSettings)
    return found


@dataclass(frozen=True, kw_only=True)
class Movable:
    """An axis that another program moves: its table, and its controller."""

    name: str
    table: AxisTable
    controller: AdaptiveController


def movable(path: str | os.PathLike[str]) -> tuple[Driver, tuple[Movable, ...]]:
    """Driver and axes of a configuration whose motions come from elsewhere: trajectories and recording are not read.

    Raises
    ------
    SettingError, OSError
        As `load`; or it has [coupled] or a period, which need a motion that is known ahead.
    """
    with _document(path) as document:
        if "coupled" in document:
            raise SettingError("coupled", "a table", AHEAD)
        made, rate = driver(toml.value("driver", toml.needed(document, "driver"), Mapping))
        axes = []
        for place, table in _tables(_axes(document)):
            with checks.inside(place):
                if table.period is not None:
                    raise SettingError("period", table.period, AHEAD, "s")
                controller = _controller(table, rate, Path(path).parent)
                if not isinstance(controller, AdaptiveController):
                    raise SettingError("controller", repr(table.controller), '"adaptive"')
                axes.append(Movable(name=table.name, table=table, controller=controller))
    return made, tuple(axes)


def _axes(document: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """The tables [[axis]] of a document whose other tables are not read."""
    example = str(Document.__dataclass_fields__["axis"].metadata["example"])
    given: tuple[Mapping[str, Any], ...] = toml.value(
        "axis", toml.needed(document, "axis", example), tuple[Mapping[str, Any], ...]
    )
    return given


def _tables(given: Sequence[Mapping[str, Any]]) -> list[tuple[str, AxisTable]]:
    """Each [[axis]], read, with its path in messages: of one axis "axis.", else counted from 1."""
    if not given:
        raise SettingError("axis", "[]", "at least one table [[axis]]")
    tables = []
    for number, table in enumerate(given, 1):
        place = "axis." if len(given) == 1 else f"[[axis]] {number}: "
        with checks.inside(place):
            tables.append((place, toml.decode(AxisTable, table, elsewhere=_places())))
    checks.distinct("name", [table.name for _, table in tables], "axis")
    return tables


def _axis(table: AxisTable, folder: Path, rate: float, image: Imaging | None) -> Axis:
    if image is not None and table.name in image.axes:
        if table.trajectory:
            raise SettingError("trajectory", dict(table.trajectory), "left out: [scan] moves this axis")
        # errors count on the lines
        motion: Trajectory | SetPoint = dataclasses.replace(
            image.scan.axes[image.axes.index(table.name)], flat=image.scan.inside
        )
    elif image is not None and not table.trajectory:
        rest = np.zeros(len(image.scan.x))
        motion = Trajectory("rest", rate, rest, rest, {}, acceleration=rest)
    else:
        with checks.inside("trajectory."):
            motion = _trajectory(table.trajectory, folder, rate)
    controller = _controller(table, motion.sample_rate, folder)
    if table.period is not None:
        controller = RepetitiveController(
            controller,
            table.period,
            sample_rate=motion.sample_rate,
            voltage_limits=checks.interval("voltage_limits", table.voltage_limits, "V"),
            slew_limit=table.slew,
        )
        if isinstance(motion, Trajectory):
            check_repeats(motion, table.period)
    watched: dict[str, Any] = {"zero": table.zero, "error_limit": table.error_limit}
    return Axis(trajectory=motion, controller=controller, name=table.name, **table.limits, **watched)


def _trajectory(given: Mapping[str, Any], folder: Path, rate: float) -> Trajectory | SetPoint:
    """The motion; its sample rate is that of the driver, Hz, unless it has one of its own."""
    kind = _one_of("kind", toml.needed(given, "kind", 'kind = "sine", in a table [axis.trajectory]'), tuple(MOTIONS))
    given = {"sample_rate": rate, **given}
    if isinstance(given.get("path"), str):
        given["path"] = str(folder / given["path"])
    try:
        others, given = _places("in [axis.trajectory]"), _with_dynamics(given, folder)
        motion: Trajectory | SetPoint = toml.decode(MOTIONS[kind], given, also=("kind",), elsewhere=others)
    except OSError as error:
        raise SettingError("path", repr(given["path"]), f"a file that can be read ({error.strerror})") from None
    return motion


def _with_dynamics(given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The same, with the dynamics of files of `truestroke bode` that it names."""
    named = {key: given[key] for key in ("turn", "settle") if isinstance(given.get(key), str)}
    if isinstance(given.get("settle"), (int, float)):
        words = "dynamics of the slow axis, a file of truestroke bode in quotes; a share of the period is of turn only"
        raise SettingError("settle", repr(given["settle"]), words)
    return {**given, **{key: _dynamics(key, folder, name) for key, name in named.items()}}


def _controller(table: AxisTable, sample_rate: float, folder: Path) -> Controller:
    fixed: dict[str, Any] = {"sample_rate": sample_rate, "voltage_limits": table.voltage_limits}
    with checks.inside("settings."):
        # the literal algorithm has none
        names = (
            [] if table.controller == "paper" else [n for n in ControllerSettings.__dataclass_fields__ if n not in OWN]
        )
        checks.known(table.settings, names, _places("in settings of [[axis]]"))
        settings = _settings(table.settings, folder)
    own = {"slew_limit": table.slew, "resonance": table.resonance, **settings}
    renamed = {name: f"settings.{name}" for name in settings} | {"slew_limit": "slew"}
    if table.model is not None:
        for key in (key for key in ("controller", "stroke") if getattr(table, key) is not None):
            raise SettingError(key, repr(getattr(table, key)), "left out where there is a model")
        model = _model(table.model, folder)
        with checks.inside("", renamed):
            return AdaptiveController.from_model(model, **fixed, **own)
    fixed["stroke"] = table.needed_stroke()
    if table.controller == "paper":
        return AdaptiveController.paper(**fixed)
    with checks.inside("", renamed):
        return AdaptiveController(**fixed, **own)


def _settings(given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Of the controller; dynamics may be a file of `truestroke bode` beside it, hum one number, feedback a switch."""
    apart: dict[str, Any] = {}
    if isinstance(name := given.get("dynamics"), str):
        apart["dynamics"] = _dynamics("dynamics", folder, name)
    if isinstance(given.get("hum"), float | int):
        apart["hum"] = given["hum"]
    if isinstance(given.get("feedback"), bool):
        apart["feedback"] = given["feedback"]
    others = {name: value for name, value in given.items() if name not in apart}
    return {**toml.arguments(ControllerSettings, others), **apart}


def known(path: str | os.PathLike[str], table: AxisTable, rate: float, *, force: bool = False) -> dict[str, Any]:
    """Dynamics and model of the files that an axis names, for an experiment at so many ticks per second, Hz.

    Raises
    ------
    SettingError
        A file is missing or of another kind, or the model is bad and not to be used by `force`.
    """
    folder = Path(path).parent
    found: dict[str, Any] = {}
    with checks.inside(f"{os.fspath(path)}: [[axis]] {table.name}: "):
        if isinstance(name := table.settings.get("dynamics"), str):
            with checks.inside("settings.", {"dynamics.sample_rate": "dynamics: sample_rate"}):
                found["dynamics"] = _dynamics("dynamics", folder, name).check_rate(rate)
        if table.model is not None:
            found["model"] = _model(table.model, folder, force=force)
    return found


def _dynamics(key: str, folder: Path, name: str) -> Dynamics:
    try:
        return Dynamics.load(folder / name)
    except FileError as error:
        raise SettingError(key, repr(name), f"dynamics of truestroke bode ({error})") from None


def _model(name: str, folder: Path, *, force: bool = False) -> ActuatorModel:
    try:
        return usable_model(folder / name, force=force)
    except BadModelError as error:
        reason = str(error).partition(". Record")[0]
        raise SettingError("model", repr(name), f"a model whose verdict is not bad ({reason})") from None
    except ModelFileError as error:
        raise SettingError("model", repr(name), f"a model of truestroke identify ({error})") from None


def _one_of(key: str, value: Any, names: tuple[str, ...]) -> str:
    if value not in names:
        raise SettingError(key, repr(value), f"one of {', '.join(names)}")
    return str(value)
