"""Drivers of hardware, behind one protocol: open, start, exchange, stop, close.

A driver knows neither controllers nor trajectories. The libraries of the vendors are optional extras, loaded by `open`.
"""

from truestroke.drivers.protocol import Driver, DriverError

__all__ = ["Driver", "DriverError"]
