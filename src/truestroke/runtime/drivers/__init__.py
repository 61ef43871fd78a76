"""Drivers of hardware, behind one protocol: open, start, exchange, stop, close.

A driver knows neither controllers nor trajectories. The libraries of the vendors are optional extras, loaded by `open`.
"""

from truestroke.runtime.drivers.connected import ConnectedDriver
from truestroke.runtime.drivers.one_axis import OneAxis
from truestroke.runtime.drivers.playback import Recorded, playback
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.runtime.drivers.simulated import Fault, SimulatedDriver, SimulatedSettings
from truestroke.runtime.drivers.single_channel import SingleChannel

__all__ = [
    "ConnectedDriver",
    "Driver",
    "DriverError",
    "Fault",
    "OneAxis",
    "Recorded",
    "SimulatedDriver",
    "SimulatedSettings",
    "SingleChannel",
    "playback",
]
