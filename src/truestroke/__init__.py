"""truestroke makes a piezo actuator go exactly where it is told.

One tick of the loop::

    trajectory -> (z_d, zdot_d) -> controller.command -> volts -> actuator -> z -> controller.adapt -> recording

Conventions: displacement z in um, velocity in um/s, voltage x in V at the D/A converter (before the amplifier),
weights in um/V, time in s, rates in Hz. Equation numbers are those of Tan et al., Sensors and Actuators A 150 (2009)
116-123.
"""

import importlib
from typing import TYPE_CHECKING, Any

from truestroke.base.checks import SettingError
from truestroke.base.flags import Flags
from truestroke.control.controller import AdaptiveController, Controller, Counters, Diagnostics
from truestroke.control.settings import ControllerSettings
from truestroke.signals.timing import Timing

if TYPE_CHECKING:
    from truestroke import plant
    from truestroke.control.feasibility import LimitWarning
    from truestroke.runtime.batch import Batch, Simulation, SimulationError, simulate_many
    from truestroke.runtime.loop import Actuator, RunInterrupted, run
    from truestroke.signals import metrics, trajectories
    from truestroke.signals.recording import Recording
    from truestroke.signals.trajectories import Trajectory
    from truestroke.studies.characterisation import Characterisation, characterise

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "AdaptiveController",
    "Batch",
    "Characterisation",
    "Controller",
    "ControllerSettings",
    "Counters",
    "Diagnostics",
    "Flags",
    "LimitWarning",
    "Recording",
    "RunInterrupted",
    "SettingError",
    "Simulation",
    "SimulationError",
    "Timing",
    "Trajectory",
    "__version__",
    "characterise",
    "metrics",
    "plant",
    "run",
    "simulate_many",
    "trajectories",
]

# Loaded when first used, so that a controller in a small process needs nothing else.
_LAZY = {
    "Actuator": "runtime.loop",
    "Characterisation": "studies.characterisation",
    "characterise": "studies.characterisation",
    "Batch": "runtime.batch",
    "Simulation": "runtime.batch",
    "SimulationError": "runtime.batch",
    "simulate_many": "runtime.batch",
    "LimitWarning": "control.feasibility",
    "RunInterrupted": "runtime.loop",
    "run": "runtime.loop",
    "Recording": "signals.recording",
    "Trajectory": "signals.trajectories",
}
_LAZY_MODULES = {"metrics": "signals.metrics", "plant": "plant", "trajectories": "signals.trajectories"}


def __getattr__(name: str) -> Any:
    if name in _LAZY_MODULES:
        return importlib.import_module(f"truestroke.{_LAZY_MODULES[name]}")
    if name in _LAZY:
        value = getattr(importlib.import_module(f"truestroke.{_LAZY[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'truestroke' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
