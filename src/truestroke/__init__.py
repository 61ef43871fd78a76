"""truestroke makes a piezo actuator follow a desired motion exactly.

One tick of the loop::

    trajectory -> (z_d, zdot_d) -> controller.command -> volts -> actuator -> z -> controller.adapt -> recording

Conventions: displacement z in um, velocity in um/s, voltage x in V at the D/A converter (before the amplifier),
weights in um/V, time in s, rates in Hz. Equation numbers are those of Tan et al., Sensors and Actuators A 150 (2009)
116-123.
"""

import ast
import importlib
from pathlib import Path
from typing import Any

from truestroke.control.controller import AdaptiveController as AdaptiveController  # what all need; loads NumPy alone

__version__ = "0.1.0"


def _places() -> dict[str, str]:
    """Public name -> module or package that has it, as `__init__.pyi` states them."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = (node for node in stub.body if isinstance(node, ast.ImportFrom))
    return {entry.name: str(node.module) for node in imports for entry in node.names}


_PLACES = _places()
__all__ = sorted([*_PLACES, "__version__"])


def __getattr__(name: str) -> Any:
    """A public name, loaded when it is first used, so that a controller in a small process needs nothing else."""
    if name not in _PLACES:
        raise AttributeError(f"module 'truestroke' has no attribute {name!r}")
    place = vars(importlib.import_module(_PLACES[name]))
    value = place[name] if name in place else importlib.import_module(f"{_PLACES[name]}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
