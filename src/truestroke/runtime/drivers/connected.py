"""Instruments on a connection that are sent each voltage and asked for each position: all of a driver but the words."""

from __future__ import annotations

import dataclasses
import functools
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any, ClassVar

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.paced import require_time
from truestroke.runtime.drivers.protocol import DriverError
from truestroke.signals.timing import Timing

__all__ = ["ConnectedDriver"]

SAME = 1e-3  # of the output range: what a voltage may differ by where the instrument reports it
PATIENCE = 5.0  # time-outs for which a connection is tried again on the way to the safe voltage
AGAIN = 0.1  # s between two such trials


def check(settings: Any) -> None:
    """The settings that all instruments with axes, units and a connection share; `output_range` becomes a pair.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """
    names = settings.axes
    if isinstance(names, str) or not names or len(set(names)) < len(names):
        raise SettingError("axes", repr(names), 'a list of different names such as ["1"]')
    object.__setattr__(settings, "output_range", checks.interval("output_range", settings.output_range, "V"))
    for name, unit in (("volts_per_unit", "V"), ("um_per_unit", "um")):
        if checks.number(name, getattr(settings, name), unit) == 0:
            raise SettingError(name, getattr(settings, name), "not 0", unit)
    checks.number("offset", settings.offset, "um")
    checks.positive("sample_rate", settings.sample_rate, "Hz")
    checks.positive("timeout", settings.timeout, "s")


class ConnectedDriver(ABC):
    """The protocol of `drivers.Driver` over a connection, whose outputs keep their voltage when it is closed.

    `exchange` reads the position that the last voltage has led to, then sends the next, so the latency is one tick.
    Nothing is timed by hardware. After an error the driver is "failed": the next answer on that connection is not
    known, so that nothing but `stop` and `open` works, which make another one.

    A class of its own for an instrument has the attributes `Settings`, `kind` and `where`, and gives `_connect`,
    `_disconnect`, `_translated`, `_position` and `_set`; where the instrument can more, `channels`, `_check`, `_halt`
    and `_reported`. It is made of its settings alone: the watchdog makes another one, with another connection.

    Parameters
    ----------
    settings : object
        A frozen dataclass with ``output_range`` (V), ``sample_rate`` (Hz) and ``timeout`` (s), the longest wait for an
        answer.
    """

    kind: ClassVar[str]  # name of the driver, in recordings
    remedy: ClassVar[str] = ""  # what is added to the rate that works, where that asked for does not
    holds: ClassVar[str] = "the instrument holds its last voltage"  # when this computer stops

    def __init__(self, settings: Any) -> None:
        self.settings = settings
        self._device: Any = None
        self._state = "closed"  # or "open", "started", "failed"

    # ---- What a class of its own gives -----------------------------------------------------------------------------

    @property
    @abstractmethod
    def where(self) -> str:
        """Address of the instrument, in errors."""

    @property
    def channels(self) -> int:
        """How many axes there are."""
        return 1

    @abstractmethod
    def _connect(self) -> Any:
        """A new connection: it becomes `_device`."""

    @abstractmethod
    def _disconnect(self, device: Any) -> None:
        """Close a connection, which may be gone already."""

    @abstractmethod
    def _translated(self) -> AbstractContextManager[None]:
        """Within it, each error of the connection and its library becomes a `DriverError`."""

    @abstractmethod
    def _position(self) -> FloatArray:
        """Ask for the displacement of each axis, um; NaN where the instrument has none."""

    @abstractmethod
    def _set(self, volts: FloatArray) -> None:
        """Send a voltage for each axis: finite, and within ``output_range``."""

    def _check(self) -> None:  # noqa: B027 (most instruments need none)
        """Refuse another instrument, and set up this one, with the output where it is; part of `open`."""

    def _tick(self) -> None:
        """What takes as long as a tick, with the output where it is."""
        self._position()
        self._position()

    def _halt(self) -> None:  # noqa: B027
        """End whatever else moves the output, such as a wave or the instrument's own loop."""

    def _reported(self) -> FloatArray | None:
        """What the instrument says that its outputs are at, V; None where it has no such question."""
        return None

    # ---- The protocol ----------------------------------------------------------------------------------------------

    def open(self) -> Timing:
        """Connect, check, set up. The output stays where it is.

        Raises
        ------
        DriverError
            The library or the instrument is not there, or the instrument is not as the settings say.
        """
        self.close()
        with self._working("opening"):
            self._device = self._connect()
            self._check()
        self._state = "open"
        return Timing(sample_rate=self.settings.sample_rate, block=1, latency=1, channels=self.channels)

    def start(self, volts: FloatArray) -> None:
        """Set the output to `volts` (V, shape (channels,)), if the connection is fast enough for the ticks.

        Raises
        ------
        DriverError
            A voltage and a position take longer than two thirds of a tick; the message names a rate that works.
        """
        self._needs("open", "start")
        with self._working("starting"):
            require_time(self._tick, self.settings.sample_rate, self.remedy)
            self._put(volts)
        self._state = "started"

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """Ask for the displacement (um) under the last voltage, then send the next (V); shape (channels, 1)."""
        self._needs("started", "exchange")
        with self._working("exchanging"):
            measured[:, 0] = self._position()
            self._put(volts[:, 0])

    def stop(self, volts: FloatArray) -> None:
        """Set the output to the safe `volts` (V, shape (channels,)), confirmed; after an error by a new connection."""
        if self._state in ("open", "started"):
            with suppress(DriverError):
                with self._working("stopping"):
                    self._bring_to(volts)
                self._state = "open"
                return
        self.close()
        self.hold(volts)

    def hold(self, volts: FloatArray) -> None:
        """Put constant `volts` (V, shape (channels,)) out, confirmed, by a connection that is closed again.

        Tries again for five times the time-out: an instrument of one connection may not know yet that the other is
        gone, and the answer to an earlier question may still come. Then it is a `DriverError`.
        """
        end = time.monotonic() + PATIENCE * self.settings.timeout
        while True:
            try:
                with self._naming(f"holding {self.where} at {np.asarray(volts).tolist()} V"):
                    try:
                        self._device = self._connect()
                        self._bring_to(volts)
                    finally:
                        self.close()
                return
            except DriverError:
                if time.monotonic() > end:
                    raise
                time.sleep(AGAIN)

    def close(self) -> None:
        """Close the connection; the output keeps its voltage. A second call does nothing."""
        self._state, device, self._device = "closed", self._device, None
        if device is not None:
            with suppress(Exception):  # a device that is gone cannot be closed
                self._disconnect(device)

    def rescue(self) -> Callable[[FloatArray], None]:
        """Give `hold` for another process: can be pickled."""
        return functools.partial(_rescue, type(self), self.settings)

    def unattended(self) -> tuple[bool, str]:
        """Whether the instrument sets its outputs to the safe voltages itself when this computer stops; in words."""
        return False, self.holds

    def describe(self) -> dict[str, object]:
        """Kind and settings, as plain data for a recording."""
        return {"kind": self.kind, **dataclasses.asdict(self.settings)}

    # ---- States and voltages ---------------------------------------------------------------------------------------

    def _needs(self, state: str, call: str) -> None:
        """In this state, or, where it is "open", in "started", too."""
        if self._state != state and not (state == "open" and self._state == "started"):
            before = "start" if state == "started" else "open"
            raise DriverError(f"{call}: the driver is {self._state}; call {before} first")

    @contextmanager
    def _working(self, doing: str) -> Iterator[None]:
        """After an error in here the driver is "failed", but for that of a setting."""
        before, self._state = self._state, "failed"
        try:
            with self._naming(f"{doing} {self.where}"):
                yield
        except SettingError:
            self._state = before
            raise
        self._state = before

    @contextmanager
    def _naming(self, doing: str) -> Iterator[None]:
        """Each error in here is a DriverError that says first what was being done."""
        try:
            with self._translated():
                yield
        except DriverError as error:
            named = str(error).startswith(doing.partition(" ")[0])
            raise error if named else DriverError(f"{doing}: {error}") from error

    def _put(self, volts: FloatArray) -> None:
        """Set voltages that may be anything: only those that the instrument may have leave here."""
        low, high = self.settings.output_range
        if not np.isfinite(volts).all():
            raise DriverError("a voltage is not finite")
        if not (low <= np.min(volts) and np.max(volts) <= high):
            raise DriverError(f"{np.asarray(volts).tolist()} V is outside of output_range = {(low, high)}")
        self._set(np.asarray(volts))

    def _bring_to(self, volts: FloatArray) -> None:
        """Set the output and have it confirmed: by the voltage, or by any answer, which comes after the command."""
        self._halt()
        self._put(volts)
        said = self._reported()
        if said is None:
            self._position()
        elif not np.allclose(said, volts, rtol=0, atol=SAME * np.ptp(self.settings.output_range)):
            raise DriverError(f"the instrument says {said.tolist()} V, not {np.asarray(volts).tolist()} V")


def _rescue(kind: Callable[[Any], ConnectedDriver], settings: Any, volts: FloatArray) -> None:
    kind(settings).hold(volts)
