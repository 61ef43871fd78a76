"""Instruments that take a voltage and report a position in lines of text, over VISA: the whole driver but its name."""

from __future__ import annotations

import re
import socket
import string
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.connected import SAME, ConnectedDriver, check
from truestroke.runtime.drivers.protocol import DriverError
from truestroke.runtime.drivers.registry import package

__all__ = ["LineDriver", "LineSettings"]

NEEDS = (
    package("pyvisa", "drives instruments by VISA"),
    package("pyvisa-py", "VISA by network, USB and serial port, where no vendor's VISA is installed"),
    package("pyserial", "serial ports and USB serial ports of pyvisa-py"),
)
NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
NO_NUMBER = 9.9e37  # SCPI's infinity; its NaN is 9.91e37
NOISE = "\x00\x01\x11\x13 \t\r\n"  # around an answer: flow control that came through, white space


@dataclass(frozen=True, kw_only=True)
class LineSettings:
    r"""An instrument, its axes, and what is said to it.

    Texts may contain ``{axis}``, the name of an axis. Numbers of the instrument are in its units: see
    `volts_per_unit` and `um_per_unit`.

    Attributes
    ----------
    resource : str
        VISA resource, such as ``"TCPIP::192.168.0.7::5025::SOCKET"``, ``"ASRL3::INSTR"`` or ``"GPIB::4::INSTR"``.
    output_range : tuple[float, float]
        Lowest and highest voltage, V.
    voltage_command : str
        Sets the voltage; contains ``{volts}``, with a format such as ``{volts:.6f}``.
    position_query : str
        Asks for the position.
    axes : tuple[str, ...]
        Names of the axes, of one instrument.
    backend : str
        VISA library: ``""`` that of the vendor, else pyvisa-py; ``"@py"`` pyvisa-py; or the file of a library.
    position_answer : str
        The whole answer to that question; contains ``{position}``.
    voltage_reply : str
        What the instrument answers to `voltage_command`; empty if nothing.
    voltage_query, voltage_answer : str
        Asks for the voltage that is set, so that the safe voltage is confirmed; empty if it has no such question.
    checks : tuple[tuple[str, str], ...]
        Questions that `open` asks, each with a regular expression for its whole answer: another instrument is refused.
    setup : tuple[str, ...]
        Commands that `open` sends; they must not move the output.
    stop_commands : tuple[str, ...]
        Commands before the safe voltage, such as one that stops a wave.
    volts_per_unit : float
        Piezo voltage over the number in `voltage_command`, V; not 0.
    um_per_unit, offset : float
        Displacement over the position in the answer, um, not 0; displacement at position 0, um.
    sample_rate : float
        Ticks per second, Hz; the connection must be fast enough.
    timeout : float
        Longest wait for an answer, s.
    write_termination, read_termination : str
        Ends of the lines.
    baud_rate : int
        Of a serial port, bit/s.
    xon_xoff : bool
        Whether a serial port has software flow control.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> LineSettings(
    ...     resource="TCPIP::192.168.0.7::5025::SOCKET",
    ...     output_range=(0.0, 150.0),
    ...     voltage_command="VOLT {volts:.4f}",
    ...     position_query="POS?",
    ... ).axes
    ('1',)
    """

    resource: str = field(
        metadata={"example": 'resource = "TCPIP::192.168.0.7::5025::SOCKET", or ASRL3::INSTR, which is COM3'}
    )
    output_range: tuple[float, float] = field(
        metadata={"example": "output_range = [-20.0, 120.0] (V), what it may put out"}
    )
    voltage_command: str = field(metadata={"example": 'voltage_command = "VOLT{axis} {volts:.4f}"'})
    position_query: str = field(metadata={"example": 'position_query = "POS{axis}?"'})
    axes: tuple[str, ...] = ("1",)
    backend: str = ""
    position_answer: str = "{position}"
    voltage_reply: str = ""
    voltage_query: str = ""
    voltage_answer: str = "{volts}"
    checks: tuple[tuple[str, str], ...] = ()
    setup: tuple[str, ...] = ()
    stop_commands: tuple[str, ...] = ()
    volts_per_unit: float = 1.0
    um_per_unit: float = 1.0
    offset: float = 0.0
    sample_rate: float = 50.0
    timeout: float = 2.0
    write_termination: str = "\n"
    read_termination: str = "\n"
    baud_rate: int = 9600
    xon_xoff: bool = False

    def __post_init__(self) -> None:
        if not self.resource:
            raise SettingError("resource", "''", "a VISA resource such as TCPIP::192.168.0.7::5025::SOCKET")
        check(self)
        checks.count("baud_rate", self.baud_rate, 50, 12_000_000)
        self._check_texts()

    def _check_texts(self) -> None:
        for name, filled in (
            ("voltage_command", "volts"),
            ("position_query", ""),
            ("position_answer", "position"),
            ("voltage_reply", ""),
            ("voltage_query", ""),
            ("voltage_answer", "volts"),
        ):
            _check_fields(name, getattr(self, name), filled)
        if not self.position_query:
            raise SettingError("position_query", "''", "the question for the position")
        for name in ("write_termination", "read_termination"):
            if not getattr(self, name):
                raise SettingError(name, "''", r'the end of a line, such as "\n"')
        for _, answer in self.checks:
            try:
                re.compile(answer)
            except re.error as error:
                raise SettingError("checks", repr(answer), f"a regular expression ({error})") from None
        _check_digits(self)


def _check_fields(name: str, text: str, field: str) -> None:
    """Of the fields in braces, `field` is there, once, and no other but the axis."""
    try:
        there = [entry for _, entry, _, _ in string.Formatter().parse(text) if entry is not None]
    except ValueError as error:
        raise SettingError(name, repr(text), f"text whose braces are closed ({error})") from None
    if set(there) - {field, "axis"} or (field and there.count(field) != 1):
        fields = f"with {{{field}}} once, and {{axis}} if it is needed" if field else "with no field but {axis}"
        raise SettingError(name, repr(text), fields)


def _check_digits(s: LineSettings) -> None:
    """The voltage command distinguishes voltages."""
    for volts in np.linspace(*s.output_range, 8):
        unit = float(volts) / s.volts_per_unit
        try:
            said = float(re.fullmatch(_pattern(s.voltage_command, "1"), _text(s.voltage_command, "1", unit))[1])  # type: ignore[index]
        except (ValueError, TypeError) as error:
            raise SettingError("voltage_command", repr(s.voltage_command), f"a number as text ({error})") from None
        if abs(said - unit) * abs(s.volts_per_unit) > SAME * np.ptp(s.output_range):
            bound = f"with more digits: it makes {said * s.volts_per_unit:g} V of {volts:g} V"
            raise SettingError("voltage_command", repr(s.voltage_command), bound)


def _text(template: str, axis: str, volts: float = 0.0) -> str:
    return template.format(axis=axis, volts=volts)


def _pattern(template: str, axis: str) -> str:
    """A regular expression for the whole of an answer, with one group: its number."""
    parts = string.Formatter().parse(template)
    return "".join(
        re.escape(before) + ("" if field is None else re.escape(axis) if field == "axis" else NUMBER)
        for before, field, _, _ in parts
    )


class LineDriver(ConnectedDriver):
    """An instrument that is sent each voltage and asked for each position in lines of text.

    A class of its own has `kind`, and `lines` where its settings are not `LineSettings`.

    Parameters
    ----------
    settings : object
        `LineSettings`, or a dataclass with what `lines` needs.
    """

    needs = NEEDS

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        self._lines = self.lines()

    def lines(self) -> LineSettings:
        """What is said to the instrument."""
        said: LineSettings = self.settings
        return said

    @property
    def where(self) -> str:
        """VISA resource."""
        return self._lines.resource

    @property
    def channels(self) -> int:
        """How many axes there are."""
        return len(self._lines.axes)

    def _connect(self) -> Any:
        return _connect(self._lines)

    def _disconnect(self, device: Any) -> None:
        device.close()

    def _translated(self) -> AbstractContextManager[None]:
        return _translated()

    def _check(self) -> None:
        for question, answer in self._lines.checks:
            self._require(question, answer, "the instrument of checks")
        for command in self._lines.setup:
            self._device.write(command)
        self._position()

    def _require(self, question: str, answer: str, remedy: str) -> str:
        """The answer to a question of `open`; a DriverError where it is another than this regular expression."""
        said = _ask(self._device, question)
        if not re.fullmatch(answer, said):
            raise DriverError(f"to {question} the instrument answers {said!r}, not {answer}: {remedy}")
        return said

    def _position(self) -> FloatArray:
        s = self._lines
        return self._numbers(s.position_query, s.position_answer) * s.um_per_unit + s.offset

    def _set(self, volts: FloatArray) -> None:
        s = self._lines
        for axis, value in zip(s.axes, volts.tolist(), strict=True):
            command = _text(s.voltage_command, axis, value / s.volts_per_unit)
            if not s.voltage_reply:
                self._device.write(command)
            elif (said := _ask(self._device, command)) != _text(s.voltage_reply, axis):
                raise DriverError(f"to {command} the instrument answers {said!r}, not {_text(s.voltage_reply, axis)}")

    def _halt(self) -> None:
        for command in self._lines.stop_commands:
            self._device.write(command)

    def _reported(self) -> FloatArray | None:
        s = self._lines
        return self._numbers(s.voltage_query, s.voltage_answer) * s.volts_per_unit if s.voltage_query else None

    def _numbers(self, question: str, answer: str) -> FloatArray:
        """The number in the answer for each axis; NaN where the instrument says that it has none."""
        return np.array([_number(self._device, question, answer, axis) for axis in self._lines.axes])


# ---- The instrument ------------------------------------------------------------------------------------------------


def _connect(s: LineSettings) -> Any:
    import pyvisa

    milliseconds = round(1e3 * s.timeout)
    device: Any = pyvisa.ResourceManager(s.backend).open_resource(
        s.resource,
        open_timeout=milliseconds,
        timeout=milliseconds,
        write_termination=s.write_termination,
        read_termination=s.read_termination,
    )
    try:
        _configure(device, s)
    except BaseException:
        _close(device)
        raise
    return device


def _configure(device: Any, s: LineSettings) -> None:
    """What only some interfaces have: the speed of a serial port; a network that does not wait for a second line."""
    from pyvisa import constants

    if device.interface_type == constants.InterfaceType.asrl:
        device.baud_rate = s.baud_rate
        device.flow_control = constants.ControlFlow.xon_xoff if s.xon_xoff else constants.ControlFlow.none
    elif device.interface_type == constants.InterfaceType.tcpip and s.resource.upper().endswith("SOCKET"):
        try:
            device.set_visa_attribute(constants.ResourceAttribute.tcpip_nodelay, True)
        except Exception:  # pyvisa-py 0.8 does not know it, and a question behind a command then waits 40 ms
            network = device.visalib.sessions[device.session].interface
            network.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _close(device: Any) -> None:
    with suppress(Exception):  # a device that is gone cannot be closed
        device.close()


def _ask(device: Any, question: str) -> str:
    return str(device.query(question)).strip(NOISE)


def _number(device: Any, question: str, template: str, axis: str) -> float:
    """The number in the answer; NaN where the instrument says that it has none."""
    said = _ask(device, _text(question, axis))
    found = re.fullmatch(_pattern(template, axis), said)
    if not found:
        raise DriverError(f"to {_text(question, axis)} the instrument answers {said!r}, not {template}")
    number = float(found[1])
    return number if abs(number) < NO_NUMBER else np.nan


@contextmanager
def _translated() -> Iterator[None]:
    """What pyvisa and its libraries raise, as a DriverError."""
    try:
        yield
    except ImportError as error:
        raise DriverError(f'{error}; pip install "truestroke[visa]"') from error
    except DriverError:
        raise
    except Exception as error:  # a VISA library may raise anything: pyvisa-py an Exception where nobody answers
        raise DriverError(" ".join(str(error).split()) or type(error).__name__) from error
