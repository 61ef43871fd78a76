"""Any instrument that takes a voltage and reports a position, over VISA: GPIB, USB, network, serial port."""

from truestroke.runtime.drivers.lines import LineDriver, LineSettings

__all__ = ["VisaDriver"]


class VisaDriver(LineDriver):
    """The protocol of `drivers.Driver` over an instrument with VISA; see docs/visa.md.

    Parameters
    ----------
    settings : LineSettings
        Resource, commands and questions, limits, sensor.
    """

    Settings, kind = LineSettings, "visa"
