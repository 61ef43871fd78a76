"""The run as process variables of EPICS: a soft IOC in a process of its own, which reads what the loop writes."""

import ctypes
import importlib.util
import ipaddress
import math
import os
import re
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.resources import as_file, files
from typing import Any

import numpy as np

from truestroke.base import checks, system
from truestroke.base.checks import SettingError
from truestroke.runtime.realtime.process import Lifeline, RealtimeError
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.settings import Axis
from truestroke.runtime.realtime.shared import Helper, Shared, Slot, State, Text
from truestroke.runtime.realtime.status import STATES, WINDOW

REFRESH = 0.1  # s between two updates
WAVES = 5  # updates from one of the waveforms to the next
ARRIVED = 1e-6  # um
SLOWEST = 1e-4  # of the speed of a set-point: lowest SPEED
LAST_WORDS = 0.5  # s for clients to read the end
NAME = re.compile(r"[A-Za-z0-9_\-:]{1,30}")
INTERFACES = ("EPICS_CAS_INTF_ADDR_LIST", "EPICS_PVAS_INTF_ADDR_LIST")  # of Channel Access, of PV Access
LOST = "lost"  # one more state: the process of the loop is gone
SEVERITIES = {State.STOPPING: "MINOR", State.ENDED: "MINOR"}


@dataclass(frozen=True, kw_only=True)
class EpicsSettings:
    """What is published, and to whom.

    Attributes
    ----------
    prefix : str
        Of all names: letters, digits, ``_``, ``-`` and ``:``, at most 30.
    window : float
        Length of the waveforms, s.
    rmse_warning, rmse_alarm : float
        Where the rms error of the last half second is a MINOR and a MAJOR alarm, um.
    interface : str
        Address of this computer that answers; "127.0.0.1" is known to this computer alone, "0.0.0.0" to all networks.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """

    prefix: str
    window: float = 2.0
    rmse_warning: float = math.inf
    rmse_alarm: float = math.inf
    interface: str = "127.0.0.1"

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.prefix):
            raise SettingError("prefix", repr(self.prefix), "1 to 30 letters, digits, _, - and :")
        checks.within("window", self.window, 0.01, 4.0, "s")
        for name in ("rmse_warning", "rmse_alarm"):
            if not getattr(self, name) > 0:
                raise SettingError(name, getattr(self, name), "above 0 um", "um")

    def check(self, axes: Sequence[Axis]) -> None:
        """Before anything moves: RealtimeError without softioc, SettingError where two axes share a name."""
        if importlib.util.find_spec("softioc") is None:
            raise RealtimeError('EPICS needs the package softioc: pip install "truestroke[epics]"')
        checks.distinct("name", [axis.name.upper() for axis in axes], "axis also in capitals")

    def serve(self, lifeline: Lifeline, shared: Shared, axes: list[Panel], sample_rate: float) -> None:
        """Publish until the run has ended, or its process is gone."""
        serve(lifeline, shared, self, axes, sample_rate)


def serve(lifeline: Lifeline, shared: Shared, settings: EpicsSettings, axes: list[Panel], sample_rate: float) -> None:
    """Publish until the run has ended, or its process is gone."""
    try:
        server = _Server(shared, settings, axes, sample_rate)
    except BaseException as error:
        shared.write(Text.SERVER, f"{type(error).__name__}: {error}")
        shared.count[Slot.SERVER] = Helper.FAILED
        os._exit(1)
    shared.count[Slot.SERVER] = Helper.READY
    gone = False
    while not gone and shared.count[Slot.STATE] != State.ENDED:
        server.publish()
        gone = lifeline.gone(REFRESH)
    server.end(lost=shared.count[Slot.STATE] != State.ENDED)
    time.sleep(LAST_WORDS)
    os._exit(0)  # threads of EPICS go on otherwise


class _Server:
    """The records of a run and of its axes."""

    def __init__(self, shared: Shared, settings: EpicsSettings, axes: list[Panel], sample_rate: float) -> None:
        for variable in INTERFACES:
            os.environ.setdefault(variable, settings.interface)
        local = all(_is_loopback(address) for variable in INTERFACES for address in os.environ[variable].split())
        with _quiet():
            from softioc import asyncio_dispatcher, builder, softioc

            self._shared, self._count = shared, 0
            builder.SetDeviceName(settings.prefix)
            self._state = builder.mbbIn("STATE", *_states())
            self._left = builder.aIn("TIME_LEFT", EGU="s", PREC=1, LOPR=0.0)
            self._overruns = builder.longIn("OVERRUNS", EGU="blocks", HIGH=1, HSV="MINOR")
            builder.aIn("SAMPLE_RATE", EGU="Hz", PREC=3, initial_value=sample_rate)
            stop = {"ZNAM": "run", "ONAM": "stop", "ASG": "STOP", "initial_value": 0, "always_update": True}
            builder.boolOut("STOP", on_update=self._stop, **stop)
            self._axes = [
                _AxisRecords(builder, shared, channel, panel, settings, sample_rate)
                for channel, panel in enumerate(axes)
            ]
            builder.LoadDatabase()
            with _guarded():
                open_to_pva = not local or system.keep_to_loopback([])
                softioc.iocInit(asyncio_dispatcher.AsyncioDispatcher(), enable_pva=open_to_pva)
            if local:
                system.keep_to_loopback(_datagram_sockets())
        self._rate, self._settled = sample_rate, 0

    def _stop(self, asked: int) -> None:
        if asked:
            self._shared.count[Slot.STOP] = 1

    def publish(self) -> None:
        """What has settled since the last time."""
        count, settled = self._shared.count, self._settled
        self._state.set(count[Slot.STATE])
        self._left.set((count[Slot.TICKS] - settled) / self._rate)
        self._overruns.set(count[Slot.OVERRUNS])
        for axis in self._axes:
            axis.publish(settled, count[Slot.SLOW_WRITTEN], waves=self._count % WAVES == 0)
        self._count += 1
        self._settled = count[Slot.WRITTEN]

    def end(self, lost: bool) -> None:
        """The last update of the clients."""
        self._state.set(len(STATES) if lost else State.ENDED)
        for axis in self._axes:
            axis.invalidate()


class _AxisRecords:
    """The records of an axis."""

    def __init__(
        self, builder: Any, shared: Shared, channel: int, panel: Panel, settings: EpicsSettings, rate: float
    ) -> None:
        self._shared, self._channel, self._panel = shared, channel, panel
        record = panel.name.upper()
        low, high = panel.reach
        place = {"EGU": "um", "PREC": 4, "LOPR": low, "HOPR": high}
        bottom, top = panel.voltage_limits
        limits = {"LOPR": bottom, "HOPR": top, "LOW": bottom, "HIGH": top, "LSV": "MINOR", "HSV": "MINOR"}
        alarms: dict[str, object] = {}
        if math.isfinite(settings.rmse_warning):
            alarms |= {"HIGH": settings.rmse_warning, "HSV": "MINOR"}
        if math.isfinite(settings.rmse_alarm):
            alarms |= {"HIHI": settings.rmse_alarm, "HHSV": "MAJOR"}
        self._readback = builder.aIn(f"{record}:READBACK", **place)
        self._desired = builder.aIn(f"{record}:DESIRED", **place)
        self._volts = builder.aIn(f"{record}:VOLTS", EGU="V", PREC=4, **limits)
        self._rmse = builder.aIn(f"{record}:RMSE", EGU="um", PREC=4, LOPR=0.0, **alarms)
        self._moving: Any = None
        if panel.moved:
            self._moving = builder.boolIn(f"{record}:MOVING", ZNAM="arrived", ONAM="moving")
            out = {"DRVL": low, "DRVH": high, "EGU": "um", "PREC": 4, "always_update": True, "initial_value": 0.0}
            builder.aOut(f"{record}:SETPOINT", ASG="OPERATOR", validate=_is_number, on_update=self._send, **out)
            fast = out | {"DRVL": panel.speed * SLOWEST, "DRVH": panel.speed, "EGU": "um/s"}
            fast["initial_value"] = panel.speed
            builder.aOut(f"{record}:SPEED", ASG="OPERATOR", validate=_is_number, on_update=self._pace, **fast)
        self._window, self._recent = round(settings.window * rate), round(WINDOW * rate)
        wave = {"datatype": float, "length": self._window, "EGU": "um", "PREC": 4}
        shown = ("DESIRED", "MEASURED", "ERROR")
        self._waves = [builder.WaveformIn(f"{record}:{name}:WAVE", **wave) for name in shown]
        self._waves.append(builder.WaveformIn(f"{record}:VOLTS:WAVE", **(wave | {"EGU": "V"})))
        self._weights: Any = None
        if panel.weights:
            weights = {"datatype": float, "length": panel.weights, "EGU": "um/V", "PREC": 4}
            self._weights = builder.WaveformIn(f"{record}:WEIGHTS", **weights)

    def _send(self, target: float) -> None:
        self._shared.targets[self._channel] = target

    def _pace(self, speed: float) -> None:
        self._shared.targets[self._shared.layout.channels + self._channel] = speed

    def publish(self, done: int, entries: int, waves: bool) -> None:
        """Of `done` ticks that have settled, and the last of `entries` slow ones."""
        if not done:
            return
        desired, measured, volts = self._shared.last(self._channel, done, self._window if waves else self._recent)
        self._show(self._readback, measured[-1])
        self._desired.set(desired[-1])
        self._volts.set(volts[-1])
        error = measured - desired
        recent = error[-self._recent :]
        self._show(self._rmse, math.sqrt(np.nanmean(recent**2)) if np.isfinite(recent).any() else math.nan)
        if self._moving is not None:
            low, high = self._panel.reach
            target = min(max(self._shared.targets[self._channel], low), high)
            self._moving.set(int(abs(desired[-1] - target) > ARRIVED))
        if waves:
            for one, wave in zip(self._waves, (desired, measured, error, volts), strict=True):
                one.set(wave)
            if self._weights is not None and entries:
                slow = self._shared.slow[self._channel]
                self._weights.set(slow[(entries - 1) % len(slow), : self._panel.weights])

    @staticmethod
    def _show(record: Any, value: float) -> None:
        """A value that is no number is INVALID."""
        from softioc import alarm

        if math.isfinite(value):
            record.set(value)
        else:
            record.set_alarm(alarm.INVALID_ALARM, alarm.READ_ALARM)

    def invalidate(self) -> None:
        """What was read last is no longer so."""
        for record in (self._readback, self._desired, self._volts, self._rmse):
            self._show(record, math.nan)


def _is_loopback(address: str) -> bool:
    with suppress(ValueError):
        return ipaddress.ip_address(address.partition(":")[0]).is_loopback
    return address == "localhost"


def _datagram_sockets() -> list[socket.socket]:
    """Those of this process, each by a descriptor of its own."""
    found = []
    for one in system.open_sockets():
        if one.type == socket.SOCK_DGRAM and one.family in (socket.AF_INET, socket.AF_INET6):
            found.append(one)
        else:
            one.close()
    return found


def _states() -> list[Any]:
    """Names and severities of the STATE record."""
    named = [(name, SEVERITIES.get(State(i), "NO_ALARM")) for i, name in enumerate(STATES)]
    return [*named, (LOST, "MAJOR")]


def _is_number(record: Any, value: float) -> bool:
    return math.isfinite(value)


@contextmanager
def _guarded() -> Iterator[None]:
    """What starts within it obeys the access security of `epics.acf`, or RuntimeError."""
    from epicscorelibs.ioc import Com, dbCore

    with as_file(files("truestroke.runtime.realtime") / "epics.acf") as file:
        if dbCore.asSetFilename(str(file).encode()) == 0:
            yield
    if not ctypes.c_int.in_dll(Com, "asActive").value:
        raise RuntimeError("EPICS did not take its access security from epics.acf")


@contextmanager
def _quiet() -> Iterator[None]:
    """EPICS greets on stderr, where the status line is."""
    before = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
