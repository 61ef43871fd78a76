"""`export_json`: the settings of a controller as JSON, by the names of the kernel's members, for a browser."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import truestroke
from truestroke.base import checks, declared, files
from truestroke.base.checks import SettingError
from truestroke.base.flags import FLAGS
from truestroke.control.controller import AdaptiveController
from truestroke.control.settings import ControllerSettings, kernel_settings
from truestroke.export.recorded import recorded, safe_volts
from truestroke.plant.settings import PLANT_SETTINGS, PlantSettings

FORMAT = "truestroke controller"
KIND = files.Kind(
    "settings of a controller", lambda path: path.read_bytes()[:64].startswith(b'{\n "format": "%s"' % FORMAT.encode())
)


def plain(value: Any) -> Any:
    """A value of a setting as JSON has it; an infinite number is the text that JavaScript's `Number` reads.

    >>> plain((np.float64(0.1), np.True_, float("inf"), [3]))
    [0.1, True, 'Infinity', [3]]
    """
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else str(float(value)).replace("inf", "Infinity")
    return [plain(entry) for entry in value]


def controller_members(settings: ControllerSettings) -> dict[str, Any]:
    """The members of ts_settings that are not 0, by name."""
    members = kernel_settings(settings).items()
    return {name: plain(value) for name, value in members if np.any(np.asarray(value, dtype=object))}


def plant_members(settings: PlantSettings) -> dict[str, Any]:
    """All members of ts_plant_settings, by name."""
    return {name: plain(value) for name, value in declared.kernel_values(settings, PLANT_SETTINGS).items()}


def described(
    settings: ControllerSettings, safe_voltage: float | None, ticks: int, about: str, command: str
) -> Mapping[str, Any]:
    """What `export_json` writes, as plain data."""
    rest = safe_volts(settings, safe_voltage)
    return {
        "format": FORMAT,
        "version": truestroke.__version__,
        "about": about,
        "command": command,
        "sample_rate": settings.sample_rate,
        "stroke": settings.stroke,
        "voltage_limits": list(settings.voltage_limits),
        "safe_voltage": rest,
        "flags": [flag.name for flag in FLAGS],
        "members": controller_members(settings),
        "recorded": {
            "columns": ["z_d", "zdot_d", "zddot_d", "volts", "measured"],
            "rows": recorded(settings, rest, ticks).tolist(),
        },
    }


def export_json(
    controller: AdaptiveController | ControllerSettings,
    file: str | os.PathLike[str],
    *,
    safe_voltage: float | None = None,
    ticks: int = 1000,
    about: str = "a piezo actuator",
    command: str = "truestroke.export_json",
) -> Path:
    """Write the settings and the prior of a controller as JSON, with a recorded run, for the module of the browser.

    Parameters
    ----------
    controller : AdaptiveController or ControllerSettings
        In double precision, of one axis; it starts as at its own start, whatever it has learned since.
    file : str or PathLike
        A JSON file; one that this function wrote is replaced.
    safe_voltage : float, optional
        Before the start and after the end, V, within the limits; by default 0 V, or the limit that is nearest to it.
    ticks : int
        Of the recorded run, 100 to 100,000: z_d (um), zdot_d (um/s), zddot_d (um/s^2), volts (V), measured (um).
    about : str
        A line that says whose controller it is.
    command : str
        What repeats the export.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SettingError
        An argument is out of its bounds, or the controller is in single precision; nothing is written.

    Examples
    --------
    >>> import tempfile
    >>> controller = AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = export_json(controller, f"{folder}/controller.json")
    ...     print(json.loads(written.read_text())["members"]["plays"])
    26
    """
    words = "an AdaptiveController or its ControllerSettings"
    checks.instance("controller", controller, (AdaptiveController, ControllerSettings), words)
    settings = controller.settings if isinstance(controller, AdaptiveController) else controller
    if settings.precision != "double":
        raise SettingError("precision", settings.precision, "double: the module computes in double precision")
    if others := settings.other_axes:
        raise SettingError("controller", f"an axis beside {others} others", "one axis: export each axis by itself")
    checks.count("ticks", ticks, 100, 100_000)
    entries = described(settings, safe_voltage, ticks, about, command).items()
    lines = (f" {json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in entries)
    return files.write(checks.path("file", file), "{\n" + ",\n".join(lines) + "\n}\n", KIND)
