"""The controllers nv200 of piezosystem jena, over USB or network: each set-point sent, each position asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

from truestroke.base import checks
from truestroke.runtime.drivers.lines import NUMBER, LineDriver, LineSettings
from truestroke.runtime.drivers.protocol import DriverError

__all__ = ["Nv200Driver", "Nv200Settings"]

OPEN_LOOP = (  # question, answer, and what to do where it is another
    ("modsrc", "modsrc,0", "set-points come from another input: modsrc,0"),
    ("cl", "cl,0", "the controller's own loop is closed: cl,0"),
    ("acmeasure", "acmeasure,[1-9]", "the actuator has no sensor, so meas is no position"),
)


@dataclass(frozen=True, kw_only=True)
class Nv200Settings:
    """A controller of one axis.

    Attributes
    ----------
    resource : str
        VISA resource: ``"ASRL3::INSTR"`` for COM3, ``"ASRL/dev/ttyUSB0::INSTR"``, ``"TCPIP::192.168.0.9::23::SOCKET"``.
    output_range : tuple[float, float]
        Lowest and highest voltage, V; those that the controller has for the actuator (``avmin``, ``avmax``).
    um_per_unit, offset : float
        Displacement over the position of ``meas``, um, not 0; displacement at position 0, um.
    sample_rate : float
        Ticks per second, Hz; the connection must be fast enough.
    timeout : float
        Longest wait for an answer, s.
    backend : str
        VISA library, as of the driver `visa`.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> Nv200Settings(resource="ASRL3::INSTR", output_range=(-20.0, 130.0)).sample_rate
    50.0
    """

    resource: str = field(metadata={"example": 'resource = "ASRL3::INSTR", which is COM3'})
    output_range: tuple[float, float] = field(
        metadata={"example": "output_range = [-20.0, 120.0] (V), what it may put out"}
    )
    um_per_unit: float = 1.0
    offset: float = 0.0
    sample_rate: float = 50.0
    timeout: float = 1.0
    backend: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "output_range", checks.interval("output_range", self.output_range, "V"))
        self.lines()

    def lines(self) -> LineSettings:
        """What is said to the controller."""
        return LineSettings(
            resource=self.resource,
            output_range=self.output_range,
            backend=self.backend,
            voltage_command="set,{volts:.4f}",
            voltage_query="set",
            voltage_answer="set,{volts}",
            position_query="meas",
            position_answer="meas,{position}",
            stop_commands=("grun,0", "modsrc,0", "cl,0"),
            um_per_unit=self.um_per_unit,
            offset=self.offset,
            sample_rate=self.sample_rate,
            timeout=self.timeout,
            write_termination="\r\n",
            baud_rate=115_200,
            xon_xoff=True,
        )


class Nv200Driver(LineDriver):
    """The protocol of `drivers.Driver` over an nv200 in open loop; see docs/nv200.md.

    Parameters
    ----------
    settings : Nv200Settings
        Address, limits, sensor.
    """

    Settings, kind = Nv200Settings, "nv200"

    def lines(self) -> LineSettings:
        """What is said to the controller."""
        said: LineSettings = self.settings.lines()
        return said

    def _check(self) -> None:
        """Loop, set-point source, sensor and limits."""
        super()._check()
        for question, answer, remedy in OPEN_LOOP:
            self._require(question, answer, remedy)
        for question, limit in zip(("avmin", "avmax"), self.settings.output_range, strict=True):
            said = float(self._require(question, f"{question},{NUMBER}", "a limit in V").partition(",")[2])
            if abs(said - limit) > 1e-3:
                raise DriverError(f"{question} is {said:g} V in the controller, {limit:g} V in output_range")
