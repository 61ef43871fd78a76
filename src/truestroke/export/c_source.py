"""`export_c`: a folder of C99 source that builds by itself, with one controller in it and a test of its bits."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

import truestroke
from truestroke.base import checks, files
from truestroke.base.checks import SettingError
from truestroke.control.controller import AdaptiveController
from truestroke.control.reference.hum import EARS, HEARD, MOST_LOADS
from truestroke.control.repeating.repetition import RepetitionSettings
from truestroke.control.repeating.repetitive import RepetitiveController
from truestroke.control.settings import ControllerSettings, kernel_settings
from truestroke.export import c_values
from truestroke.export.c_sizes import struct_sizes
from truestroke.export.recorded import recorded, safe_volts
from truestroke.export.texts import rendered
from truestroke.model.operators import LANES

OWN = (
    "adaptive.h",
    "adaptive.c",
    "board.h",
    "main.c",
    "replay.c",
    "settings.c",
    "stack.awk",
    "Makefile",
    "CMakeLists.txt",
    "README.md",
)
LEAST_HISTORY = {"kalman": 16, "rls": 8}  # ticks: the Kalman law keeps some for a stage that it may find
MOST_HISTORY = 1024
KIND = files.Kind("an export of C", lambda path: False)


@dataclass(frozen=True)
class Exported:
    """What `export_c` wrote.

    Attributes
    ----------
    folder : Path
        Where it is.
    files : tuple[Path, ...]
        All of its files.
    capacities : Mapping[str, int]
        Of the kernel, as its header names them.
    ram : int
        Bytes of the state on a machine of 32 bits; the stack is beside it.
    flash : int
        Bytes of the settings; the code is beside them.
    """

    folder: Path
    files: tuple[Path, ...]
    capacities: Mapping[str, int]
    ram: int
    flash: int


def export_c(
    controller: AdaptiveController | ControllerSettings | RepetitiveController,
    folder: str | os.PathLike[str],
    *,
    precision: Literal["double", "single"] | None = None,
    history: int | None = None,
    safe_voltage: float | None = None,
    zero: float = 0.0,
    ram: int | None = None,
    ticks: int = 1000,
    about: str = "a piezo actuator",
    command: str = "truestroke.export_c",
) -> Exported:
    """Write a controller as C99 source: kernel, settings and prior, three calls, an example of a loop, a self-test.

    Parameters
    ----------
    controller : AdaptiveController, ControllerSettings or RepetitiveController
        Its settings are exported; it starts as at its own start, whatever it has learned since. Of a
        RepetitiveController what it has learned is exported beside the controller inside, which starts with its
        weights: the correction is output in a motion of that form.
    folder : str or PathLike
        A new or empty folder; `truestroke.base.files.overwriting` permits another.
    precision : {"double", "single"}, optional
        Number type of the kernel; by default that of the settings.
    history : int, optional
        Ticks that a measurement may come after its command, plus one, up to 1024; by default the fewest: 16, 8 with the
        paper's law, more with a long dead time.
    safe_voltage : float, optional
        Before the start and after the end, V, within the limits; by default 0 V, or the limit that is nearest to it.
    zero : float
        The reading of the sensor that counts as 0, um, such as `ActuatorModel.zero`; desired displacements count from
        it.
    ram : int, optional
        Bytes that the chip has for the state; an export that needs more is refused.
    ticks : int
        Of the recorded run of the self-test, 100 to 100,000.
    about : str
        A line that says whose controller it is.
    command : str
        What repeats the export, for the texts.

    Returns
    -------
    Exported
        The files and the capacities.

    Raises
    ------
    SettingError
        An argument is out of its bounds; nothing is written.
    FileExistsError
        The folder has files, and they may not be replaced.

    Examples
    --------
    >>> import tempfile
    >>> controller = AdaptiveController(sample_rate=10_000.0, stroke=20.0, voltage_limits=(0.0, 10.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     made = export_c(controller, folder, precision="single")
    >>> made.capacities["TS_MAX_PLAYS"], made.ram <= 15_700
    (26, True)
    """
    if precision is not None:
        checks.one_of("precision", precision, ("double", "single"))
    settings, repetition = _given(controller, precision)
    checks.count("ticks", ticks, 100, 100_000)
    members = _without_zeros(kernel_settings(settings))
    if others := settings.other_axes:
        raise SettingError("controller", f"an axis beside {others} others", "one axis: export each axis by itself")
    capacities = _capacities(settings, members, history)
    rest = safe_volts(settings, safe_voltage)
    sizes = struct_sizes(_kernel_header(capacities, settings.precision), settings.precision)
    real = c_values.REALS[settings.precision]().itemsize
    period, added = (2 * real * repetition.size, sizes["ts_repetition"]) if repetition is not None else (0, 0)
    needed = sizes["ts_controller"] + 2 * real + added + period
    if ram is not None and checks.count("ram", ram, 1, 2**32) < needed:
        size = f"{settings.plays} plays, {settings.parameters} weights and {capacities['TS_HISTORY']} ticks of history"
        remedy = "take fewer plays or a shorter history" + (
            ", or single precision" if settings.precision == "double" else ""
        )
        raise SettingError("ram", ram, f"{needed} or more for the state of {size}; {remedy}", "bytes")
    memory = {"ram": needed, "flash": sizes["ts_settings"] + period}
    checks.number("zero", zero, "um")
    texts = _texts(settings, repetition, members, capacities, memory, rest, zero, ticks, about, command)
    target = checks.path("folder", folder)
    _check_folder(target)
    (target / "kernel").mkdir(parents=True, exist_ok=True)
    written = tuple(files.write(target / name, text, KIND) for name, text in texts.items())
    return Exported(target, written, capacities, **memory)


def _given(
    controller: AdaptiveController | ControllerSettings | RepetitiveController,
    precision: Literal["double", "single"] | None,
) -> tuple[ControllerSettings, RepetitionSettings | None]:
    """Settings of the controller, and what was learned around it."""
    words = "an AdaptiveController, its ControllerSettings, or a RepetitiveController around one"
    inside: Any = controller.controller if isinstance(controller, RepetitiveController) else controller
    checks.instance("controller", inside, (AdaptiveController, ControllerSettings), words)
    settings: ControllerSettings = inside if isinstance(inside, ControllerSettings) else inside.settings
    if precision is not None:
        settings = dataclasses.replace(settings, precision=precision)
    if not isinstance(controller, RepetitiveController):
        return settings, None
    settings = dataclasses.replace(settings, initial_weights=tuple(inside.weights.tolist()))
    return settings, controller.learned_period(AdaptiveController.from_settings(settings))


def kernel_sources() -> dict[str, str]:
    """The kernel's source files, by name."""
    from truestroke import _kernel

    assert _kernel.__file__
    folder = Path(_kernel.__file__).parent / "export/kernel"
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())}


def _without_zeros(members: Mapping[str, Any]) -> dict[str, Any]:
    """The settings with a prior whose rows begin at the block of columns with their first entry that is not 0."""
    rows = np.split(np.asarray(members["prior"], dtype=float), np.cumsum(np.arange(1, len(members["initial_weights"]))))
    begins = [int(np.flatnonzero(row)[0]) // LANES * LANES if row.any() else 0 for row in rows]
    kept = np.concatenate([row[begin:] for row, begin in zip(rows, begins, strict=True)])
    return {**members, "prior": kept, "prior_from": begins}


def _capacities(settings: ControllerSettings, members: Mapping[str, Any], history: int | None) -> dict[str, int]:
    """The smallest that hold the settings."""
    needed = max(LEAST_HISTORY[settings.law], 2 * max(members["dynamics.dead"], members["sensor.ticks"]) + 8)
    if history is not None and checks.count("history", history, 1, MOST_HISTORY) < needed:
        raise SettingError("history", history, f"{needed} or more for this law and dead time", "ticks")
    heard = HEARD if members["dynamics.known"] else MOST_LOADS
    return {
        "TS_MAX_PLAYS": settings.plays,
        "TS_MAX_DEAD_ZONES": members["dead_zones"],
        "TS_MAX_CREEPS": max(1, len(members["creep"])),
        "TS_MAX_DUHEM": max(1, len(members["duhem"])),
        "TS_MAX_OTHERS": 1,
        "TS_MAX_PARAMETERS": settings.parameters,
        "TS_MAX_LEARNED": settings.parameters if settings.law == "kalman" else 1,
        "TS_MAX_PRIOR": max(1, len(members["prior"])),
        "TS_MAX_SENSED": settings.parameters if members["sensor.share"] or members["sensor.lag"] else 1,
        "TS_SECTIONS": max(1, *(members[f"dynamics.{kind}"] for kind in ("sections", "others", "modes"))),
        "TS_FEEDBACKS": max(1, members["feedback.filters"]),
        "TS_HEARD": heard,
        "TS_LINES": members["hum.lines"] + heard,
        "TS_EARS": EARS if settings.law == "kalman" else 1,
        "TS_HISTORY": needed if history is None else history,
    }


def _kernel_header(capacities: Mapping[str, int], precision: str) -> str:
    """The kernel's header with these capacities and the number type as its defaults."""
    text = kernel_sources()["truestroke.h"]
    kind = "double" if precision == "double" else "float"
    for name, value in {**capacities, "TS_REAL": kind}.items():
        text, replaced = re.subn(rf"(?m)^(#define {name}) [^/\n]*$", rf"\1 {value}", text)
        if replaced != 1:
            raise RuntimeError(f"the kernel's header has {replaced} lines '#define {name}'")
    return text


def _period(repetition: RepetitionSettings, precision: str) -> dict[str, Any]:
    """What period.c has."""
    members = repetition.members()
    known = members["learned"]

    def real(value: float) -> str:
        return c_values.real(value, precision)

    def table(values: Sequence[float]) -> list[str]:
        texts = [real(float(value)) for value in values]
        return [", ".join(texts[begin : begin + 10]) for begin in range(0, len(texts), 10)]

    return {
        "size": repetition.size,
        "settles": repetition.settles,
        "reals": [(name, real(members[name])) for name in ("period", "change", "share", "cosine", "sine", "ratio")],
        "shape": [(name, real(known[name])) for name in ("mean", "span", "power", "slopes", "cosine", "sine")],
        "level": real(known["level"]),
        "gain": real(known["gain"]),
        "wave": table(known["wave"]),
        "volts": table(known["volts"]),
    }


def _texts(
    settings: ControllerSettings,
    repetition: RepetitionSettings | None,
    members: Mapping[str, Any],
    capacities: Mapping[str, int],
    memory: Mapping[str, int],
    rest: float,
    zero: float,
    ticks: int,
    about: str,
    command: str,
) -> dict[str, str]:
    """All files, by their names in the folder."""

    def real(value: float) -> str:
        return c_values.real(value, settings.precision)

    rows = recorded(settings, rest, ticks, zero, repetition)
    values = {
        "repetition": None if repetition is None else _period(repetition, settings.precision),
        "about": about.partition("\n")[0].replace("*/", "* /"),
        "command": command,
        "version": truestroke.__version__,
        "precision": settings.precision,
        "promotion": " -Wdouble-promotion" if settings.precision == "single" else "",
        "rate": f"{settings.sample_rate:.10g}",
        "rate_literal": real(settings.sample_rate),
        "safe": real(rest),
        "zero": real(zero),
        "limits": "{:.6g} to {:.6g}".format(*settings.voltage_limits),
        "slew": f"{members['slew']:.4g}",
        "plays": settings.plays,
        "parameters": settings.parameters,
        "capacities": ", ".join(f"`{name}` {value}" for name, value in capacities.items()),
        "latest": capacities["TS_HISTORY"] - 1 - (members["dynamics.dead"] + 4 if members["dynamics.known"] else 0),
        "members": list(c_values.members(members, settings.precision)),
        **memory,
        "ticks": len(rows),
        "rows": [", ".join(map(real, row)) for row in rows],
    }
    names = OWN if repetition is None else (*OWN, "period.c")
    own = rendered({name: name for name in names}, values)
    kernel = kernel_sources() | {"truestroke.h": _kernel_header(capacities, settings.precision)}
    if repetition is None:
        del kernel["repetition.c"]
    return own | {f"kernel/{name}": text for name, text in kernel.items()}


def _check_folder(folder: Path) -> None:
    """It is new, or has nothing in it, or may be written over."""
    if not folder.parent.is_dir():
        raise files.no_folder(folder.parent, folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "is a file; name a folder", str(folder))
    if folder.is_dir() and not files.replacing() and any(folder.iterdir()):
        raise FileExistsError(errno.EEXIST, "has files; choose a new folder, or `overwrite` it", str(folder))
