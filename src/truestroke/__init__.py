"""truestroke makes a piezo actuator go exactly where it is told.

One tick of the loop::

    trajectory -> (z_d, zdot_d) -> controller.command -> volts -> actuator -> z -> controller.adapt -> recording

Conventions: displacement z in um, velocity in um/s, voltage x in V at the D/A converter (before the amplifier),
weights in um/V, time in s, rates in Hz. Equation numbers are those of Tan et al., Sensors and Actuators A 150 (2009)
116-123.
"""

from truestroke._check import SettingError
from truestroke.controller import AdaptiveController, Controller, Counters, Diagnostics, Flags
from truestroke.settings import ControllerSettings

__version__ = "0.1.0"

__all__ = [
    "AdaptiveController",
    "Controller",
    "ControllerSettings",
    "Counters",
    "Diagnostics",
    "Flags",
    "SettingError",
    "__version__",
]
