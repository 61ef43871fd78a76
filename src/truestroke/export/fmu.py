"""`export_fmu`: a controller, an identified model or the simulated stack as a unit of FMI, for other simulators."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import truestroke
from truestroke.base import checks, declared, files, system
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.control.actuator import ActuatorModel
from truestroke.control.controller import AdaptiveController
from truestroke.control.settings import ControllerSettings, kernel_settings
from truestroke.export import c_values, fmu_actuator, fmu_variables
from truestroke.export.c_source import kernel_sources
from truestroke.export.fmu_variables import Variable
from truestroke.export.recorded import safe_volts
from truestroke.export.texts import TEMPLATES, rendered
from truestroke.plant.settings import PLANT_SETTINGS, PlantSettings

Version = Literal["2.0", "3.0"]
PLATFORMS = {  # version of FMI, system and machine: folder and ending of the binary
    ("2.0", "Linux", "x86_64"): ("linux64", "so"),
    ("3.0", "Linux", "x86_64"): ("x86_64-linux", "so"),
}
ICONS = {"2.0": "model.png", "3.0": "terminalsAndIcons/icon.png"}
FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
THEN = (1980, 1, 1, 0, 0, 0)  # the time of each file in the archive, so that the same export has the same bytes


class CompilerError(TruestrokeError, RuntimeError):
    """The C compiler is absent or has failed; the message has what it said."""


def _ours(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return b'generationTool="truestroke' in archive.read("modelDescription.xml")[: files.HEAD]
    except (zipfile.BadZipFile, KeyError, OSError, NotImplementedError):
        return False


KIND = files.Kind("an FMU", _ours)


@dataclass(frozen=True)
class _Unit:
    """What differs between the FMUs."""

    kind: str
    struct: str
    about: str
    rate: float
    variables: list[Variable]
    members: Mapping[str, Any]
    parameters: tuple[str, ...]
    sources: Mapping[str, str]
    terminals: Mapping[str, tuple[str, tuple[str, ...]]]
    sizes: Mapping[str, int] = field(default_factory=dict)


def export_fmu(
    what: AdaptiveController | ControllerSettings | ActuatorModel | PlantSettings,
    file: str | os.PathLike[str],
    *,
    sample_rate: float | None = None,
    safe_voltage: float | None = None,
    about: str = "a piezo actuator",
    binary: bool = True,
    version: Version = "2.0",
) -> Path:
    """Write a controller, an identified model or the simulated stack as an FMU of FMI 2.0 or 3.0: source and binary.

    Of FMI it is the part co-simulation.

    Parameters
    ----------
    what : AdaptiveController, ControllerSettings, ActuatorModel or PlantSettings
        A controller in double precision, of one axis, which starts as at its own start; a model, from voltage to
        displacement, with the bits of `ActuatorModel.predict`; or the simulated stack.
    file : str or PathLike
        Ends with .fmu; an FMU that this function wrote is replaced.
    sample_rate : float, optional
        Of a model, 1 / tick, Hz; by default that of its record. Controllers and stacks have their own.
    safe_voltage : float, optional
        The controller's output before the first step, V, within the limits; by default 0 V, or the limit nearest to it.
    about : str
        A line that says what it is.
    binary : bool
        Whether the C compiler of this computer makes a binary for it, on Linux of x86-64; without it the FMU has
        its source alone.
    version : {"2.0", "3.0"}
        Of FMI.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SettingError
        An argument is out of its bounds; nothing is written.
    CompilerError
        The compiler is absent or has failed; nothing is written.

    Examples
    --------
    >>> import tempfile
    >>> from truestroke.plant import PlantSettings
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     made = export_fmu(PlantSettings(), f"{folder}/stack.fmu", binary=False)
    ...     print("sources/fmi2.c" in zipfile.ZipFile(made).namelist())
    True
    """
    words = "an AdaptiveController, its ControllerSettings, an ActuatorModel, or a PlantSettings"
    checks.instance("what", what, (AdaptiveController, ControllerSettings, ActuatorModel, PlantSettings), words)
    target = checks.path("file", file)
    if target.suffix != ".fmu":
        raise SettingError("file", f"'{target}'", "a name that ends with .fmu")
    checks.one_of("version", version, get_args(Version))
    if sample_rate is not None and not isinstance(what, ActuatorModel):
        raise SettingError(
            "sample_rate", sample_rate, "left out: it is in the settings of the controller or stack", "Hz"
        )
    if isinstance(what, PlantSettings):
        unit = _plant(what)
    elif isinstance(what, ActuatorModel):
        unit = _actuator(what, sample_rate, about)
    else:
        unit = _controller(what.settings if isinstance(what, AdaptiveController) else what, safe_voltage, about)
    texts = _texts(unit, version)
    content = {name: text.encode() for name, text in texts.items()}
    content[ICONS[version]] = (TEMPLATES / "icon.png").read_bytes()
    place = PLATFORMS.get((version, *system.MACHINE))
    if binary and place:
        folder, ending = place
        content[f"binaries/{folder}/{_model(unit)}.{ending}"] = _compiled(texts)
    with files.writing(target, KIND) as path:
        _pack(path, content)
    return target


def _controller(settings: ControllerSettings, safe_voltage: float | None, about: str) -> _Unit:
    if settings.precision != "double":
        raise SettingError("precision", settings.precision, "double: the variables of FMI are in double precision")
    if others := settings.other_axes:
        raise SettingError("controller", f"an axis beside {others} others", "one axis: export each axis by itself")
    return _Unit(
        kind="controller",
        struct="ts_settings",
        about=f"The adaptive inverse controller of {about}",
        rate=settings.sample_rate,
        variables=fmu_variables.of_controller(settings, safe_volts(settings, safe_voltage)),
        members=kernel_settings(settings),
        parameters=(),
        sources=kernel_sources() | _sources("status.h", "unit.h", "unit_controller.c", "unit_controller.h"),
        terminals=fmu_variables.CONTROLLER_TERMINALS,
    )


def _actuator(model: ActuatorModel, sample_rate: float | None, about: str) -> _Unit:
    given = model.metrics.get("record_sample_rate_hz") if sample_rate is None else sample_rate
    if given is None:
        raise SettingError("sample_rate", None, "given: the model does not say that of its record", "Hz")
    rate = checks.sized("sample_rate", given, "Hz", 1e-3, 1e9)
    sizes, members, late = fmu_actuator.constants(model, rate)
    operators = ("truestroke.h", "asymmetry.h", "lanes.h", "operators.c")
    return _Unit(
        kind="actuator",
        struct="fmu_model",
        about=f"The identified model of {about}",
        rate=rate,
        variables=fmu_variables.of_actuator(model, late),
        members=members,
        parameters=(),
        sources={name: text for name, text in kernel_sources().items() if name in operators}
        | _sources("unit.h", "unit_actuator.c", "unit_actuator.h"),
        terminals=fmu_variables.ACTUATOR_TERMINALS,
        sizes=sizes,
    )


def _plant(settings: PlantSettings) -> _Unit:
    return _Unit(
        kind="plant",
        struct="ts_plant_settings",
        about="A simulated piezo stack with hysteresis, creep, resonance and noise",
        rate=settings.sample_rate,
        variables=fmu_variables.of_plant(settings),
        members=declared.kernel_values(settings, PLANT_SETTINGS),
        parameters=tuple(fmu_variables.plant_parameters()),
        sources=_sources("plant.c", "plant.h", "unit.h", "unit_plant.c", "unit_plant.h"),
        terminals=fmu_variables.PLANT_TERMINALS,
    )


def _sources(*names: str) -> dict[str, str]:
    from truestroke import _kernel

    assert _kernel.__file__
    folder = Path(_kernel.__file__).parent / "export/fmi"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def _model(unit: _Unit) -> str:
    return f"truestroke_{unit.kind}"


def _texts(unit: _Unit, version: Version) -> dict[str, str]:
    """What is written for this unit, by name in the archive; its guid is that of all of it."""
    front = f"fmi{version[0]}"
    sources = dict(unit.sources) | _sources("instance.c", "instance.h", f"{front}.c", f"{front}.h")
    values: dict[str, Any] = {
        "kind": unit.kind,
        "struct": unit.struct,
        "model": _model(unit),
        "about": unit.about,
        "version": truestroke.__version__,
        "date": "{}-{:02}-{:02}T{:02}:{:02}:{:02}Z".format(*THEN),
        "tick": repr(1 / unit.rate),
        "units": {
            name: fmu_variables.UNITS[name] for name in sorted({"s", *(v.unit for v in unit.variables if v.unit)})
        },
        "variables": unit.variables,
        "parameters": unit.parameters,
        "sizes": unit.sizes,
        "members": list(c_values.members(unit.members, "double")),
        "real": lambda value: c_values.real(value, "double"),
        "sources": sorted([*(name for name in sources if name.endswith(".c")), "variables.c"]),
        "terminals": unit.terminals,
    }
    names = {
        "modelDescription.xml": f"modelDescription{version[0]}.xml",
        "sources/variables.c": "variables.c",
        "sources/variables.h": "variables.h",
    }
    if version == "3.0":
        names["sources/buildDescription.xml"] = "buildDescription.xml"
        names["terminalsAndIcons/terminalsAndIcons.xml"] = "terminalsAndIcons.xml"
    whole = "".join([*rendered(names, values | {"guid": ""}).values(), *sources.values()])
    own = rendered(names, values | {"guid": hashlib.sha256(whole.encode()).hexdigest()[:32]})
    return own | {f"sources/{name}": text for name, text in sources.items()}


def _compiled(texts: Mapping[str, str]) -> bytes:
    """The shared library that the C compiler makes of the sources."""
    compiler = os.environ.get("CC") or "cc"
    program, *options = compiler.split()
    if shutil.which(program) is None:
        raise CompilerError(
            f"no C compiler {program} on this computer: install gcc, set CC, or export the source alone"
        )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sources").mkdir()
        for path, text in texts.items():
            if path.endswith((".c", ".h")):
                (folder / path).write_text(text, encoding="utf-8")
        sources = sorted(str(path) for path in (folder / "sources").glob("*.c"))
        command = [program, *FLAGS, *options, *sources, "-lm", "-o", str(folder / "unit.so")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise CompilerError(f"{compiler} has failed: {done.stderr.strip()[:2000]}")
        return (folder / "unit.so").read_bytes()


def _pack(path: Path, content: Mapping[str, bytes]) -> None:
    """An archive of the same bytes whenever it is made."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content, key=lambda name: (name != "modelDescription.xml", name)):
            archive.writestr(zipfile.ZipInfo(name, THEN), content[name], zipfile.ZIP_DEFLATED)
