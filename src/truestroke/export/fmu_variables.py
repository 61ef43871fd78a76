"""The variables of an FMU: of the controller, and of the simulated stack."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from truestroke.control.actuator import ActuatorModel
from truestroke.control.settings import ControllerSettings
from truestroke.plant.settings import PLANT_SETTINGS, PlantSettings
from truestroke.signals.timing import LONGEST_AGO

NO_SLEW = 1e30  # V/s: from here on the voltage may jump
BEYOND = 1e15  # of any voltage, V, or parameter
_ANY: dict[str, Any] = {"role": "parameter", "low": -BEYOND, "high": BEYOND}

UNITS = {  # name: factor and exponents of SI's base units
    "um": (1e-6, {"m": 1}),
    "um/s": (1e-6, {"m": 1, "s": -1}),
    "um/s2": (1e-6, {"m": 1, "s": -2}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "V/s": (1.0, {"kg": 1, "m": 2, "s": -4, "A": -1}),
    "um/V": (1e-6, {"kg": -1, "m": -1, "s": 3, "A": 1}),
    "Hz": (1.0, {"s": -1}),
    "s": (1.0, {"s": 1}),
    "s^2": (1.0, {"s": 2}),
    "1/h": (1 / 3600, {"s": -1}),
    "V/V": (1.0, {}),
    "um/um": (1.0, {}),
}

KINDS3 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}
"""The types of FMI 3.0 by those of FMI 2.0."""

CONTROLLER_TERMINALS = {
    "desired": ("Desired motion", ("z_d", "zdot_d", "zddot_d")),
    "sensor": ("Measurement of the stage", ("z", "measured")),
    "amplifier": ("Voltage at the D/A converter", ("volts",)),
}
PLANT_TERMINALS = {
    "amplifier": ("Voltage at the D/A converter", ("volts",)),
    "sensor": ("Measurement of the stage", ("measured", "truth")),
}
ACTUATOR_TERMINALS = {
    "amplifier": ("Voltage at the D/A converter", ("volts",)),
    "sensor": ("Measurement of the stage", ("displacement", "beyond")),
}
"""Variables that belong together, by the name of their terminal, with its meaning."""


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU, with its unit; numbers of Integer and Boolean are whole."""

    name: str
    meaning: str
    unit: str = ""
    kind: str = "Real"
    role: str = "input"
    start: float = 0.0
    low: float = 0.0
    high: float = 1.0

    @property
    def kind3(self) -> str:
        """Its type in FMI 3.0."""
        return KINDS3[self.kind]

    def text(self, value: float) -> str:
        """A value of its type as XML has it."""
        if self.kind == "Boolean":
            return "true" if value else "false"
        return repr(float(value)) if self.kind == "Real" else str(int(value))


def of_controller(settings: ControllerSettings, safe_voltage: float) -> list[Variable]:
    """In the order of c/fmi/unit_controller.c."""
    low, high = settings.voltage_limits
    slew = min(settings.slew_limit, NO_SLEW)
    fixed: dict[str, Any] = {"role": "parameter"}
    return [
        Variable("z_d", "desired displacement", "um"),
        Variable("zdot_d", "desired velocity", "um/s"),
        Variable("zddot_d", "desired acceleration; see the parameter `acceleration`", "um/s2"),
        Variable("z", "measured displacement", "um"),
        Variable("measured", "whether z is a measurement; without it nothing is learned", kind="Boolean", start=1),
        Variable("hold", "whether learning stops", kind="Boolean"),
        Variable("volts", "command at the D/A converter", "V", role="output", start=safe_voltage),
        Variable("innovation", "measured less expected displacement", "um", role="output"),
        Variable("flags", "bit mask of the last tick", kind="Integer", role="output"),
        Variable("voltage_min", "lowest command", "V", start=low, low=-BEYOND, high=BEYOND, **fixed),
        Variable("voltage_max", "highest command", "V", start=high, low=-BEYOND, high=BEYOND, **fixed),
        Variable(
            "slew_limit",
            "fastest change of the command; 1e30 is none",
            "V/s",
            start=slew,
            low=1e-15,
            high=NO_SLEW,
            **fixed,
        ),
        Variable("acceleration", "whether zddot_d is known", kind="Boolean", **fixed),
        Variable(
            "late", "commands between that of z and the step that takes z", kind="Integer", high=LONGEST_AGO, **fixed
        ),
    ]


def of_plant(settings: PlantSettings) -> list[Variable]:
    """In the order of c/fmi/unit_plant.c, then a parameter for each setting that is one number."""
    variables = [
        Variable("volts", "voltage at the D/A converter", "V"),
        Variable("measured", "displacement as the sensor reads it, mean over the last tick", "um", role="output"),
        Variable("truth", "the same without noise", "um", role="output"),
        Variable("seed", "of the noise", kind="Integer", role="parameter", high=2**31 - 1),
    ]
    return variables + [
        dataclasses.replace(_setting(settings, name), start=float(getattr(settings, name)))
        for name in plant_parameters()
    ]


def of_actuator(model: ActuatorModel, late: int) -> list[Variable]:
    """In the order of c/fmi/unit_actuator.c, then a parameter for each weight."""
    return [
        Variable("volts", "voltage at the D/A converter", "V", start=0.0),
        Variable("displacement", "as the sensor reads it, without noise; see `late`", "um", role="output"),
        Variable("late", "ticks by which it is later than the model says", kind="Integer", role="output", start=late),
        Variable("beyond", "whether voltage or velocity is beyond the record", kind="Boolean", role="output"),
        Variable("offset", "of the sensor's zero, above that of the record", "um", **_ANY),
        *(
            Variable(weight_name(name), f"weight {name}", unit, start=float(w), **_ANY)
            for name, unit, w in zip(model.names, model.units, model.weights, strict=True)
        ),
    ]


def weight_name(name: str) -> str:
    """Of the parameter of a weight: names of Modelica have neither blanks nor points.

    >>> weight_name("creep 0.3 s")
    'weight_creep_0_3_s'
    """
    return "weight_" + re.sub(r"\W", "_", name)


def plant_parameters() -> Sequence[str]:
    """Settings of the stack that are one real number between two others."""
    fields = {field.name: field.type for field in dataclasses.fields(PlantSettings)}
    return [name for name, s in PLANT_SETTINGS.items() if s.bound.ends is not None and fields[name] == "float"]


def _setting(settings: PlantSettings, name: str) -> Variable:
    declared = PLANT_SETTINGS[name]
    assert declared.bound.ends is not None
    low, high = (end if isinstance(end, (int, float)) else end(settings) for end in declared.bound.ends)
    return Variable(name, declared.meaning, declared.unit, role="parameter", low=float(low), high=float(high))
