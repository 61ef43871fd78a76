"""truestroke makes a piezo actuator follow a desired motion exactly.

One tick of the loop::

    trajectory -> (z_d, zdot_d) -> controller.command -> volts -> actuator -> z -> controller.adapt -> recording

Conventions: displacement z in um, velocity in um/s, voltage x in V at the D/A converter (before the amplifier),
weights in um/V, time in s, rates in Hz. Equation numbers are those of Tan et al., Sensors and Actuators A 150 (2009)
116-123.
"""

from truestroke.base import lazy

__version__ = "0.1.0"
__getattr__, __dir__, _names = lazy.attach(__name__)
__all__ = [*_names, "__version__"]
