"""Controllers of Physik Instrumente (GCS 2.0) over TCP: waves that they play and record, or set-points one by one."""

import functools
import select
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.connected import ConnectedDriver, check
from truestroke.runtime.drivers.playback import Recorded
from truestroke.runtime.drivers.protocol import DriverError
from truestroke.runtime.drivers.registry import package

__all__ = ["PiDriver", "PiSettings"]

SERVO_UPDATE_TIME, RECORDER_POINTS = 0x0E000200, 0x16000200  # parameters of the controller
POSITION, VOLTAGE = 2, 7  # what the recorder takes: position of an axis, control voltage of an output channel
SAME = 0.03  # of a wave's peak-to-peak, rms: how far the recorded voltage may be from the wave

HINTS = {
    -7: "no answer in time: the cable, or this controller does not know the question",
    -1088: "fewer points came than were asked for",
    2: "this controller does not know the command; docs/pi.md lists those that are needed",
    5: "is the servo off?",
    7: "the voltage is outside of the controller's limits",
    15: "the axes have other names: see axes in the settings",
    17: "outside of what the controller accepts: limits, or a record option that it does not have",
    54: "this controller does not know the parameter",
    67: "the wave is longer than the controller's memory",
    73: "a wave is still running: stop it",
}


@dataclass(frozen=True, kw_only=True)
class PiSettings:
    """A controller and its axes.

    Attributes
    ----------
    host : str
        Address of the controller, a name or an IP number.
    port : int
        TCP port.
    axes : tuple[str, ...]
        Names of the axes, as ``SAI?`` gives them.
    outputs : tuple[int, ...]
        Piezo output channel of each axis; by default 1, 2, ...
    output_range : tuple[float, float]
        Lowest and highest voltage, V. The limits that the controller has for the outputs (``VMI?``, ``VMA?``) must be
        the same.
    limit_parameters : tuple[int, int], optional
        Parameters (``SPA?``) that hold those limits, for controllers without ``VMI?`` and ``VMA?``.
    volts_per_unit : float
        Piezo voltage over the control value of ``SVA`` and wave table, V; not 0.
    um_per_unit, offset : float
        Displacement over position of ``POS?`` and recorder, um, not 0; displacement at position 0, um.
    sample_rate : float
        Ticks per second of `exchange`, Hz. The connection must be fast enough; `playback` has a rate of its own.
    samples_per_tick : int
        Most samples of the recorder that are averaged for a tick of `playback`; fewer if its memory is too small.
    points_per_command : int
        Points of a wave in one command; controllers accept some 70.
    timeout : float
        Longest wait for an answer, s.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> PiSettings(host="192.168.0.5", output_range=(-20.0, 120.0)).outputs
    (1,)
    """

    host: str = field(metadata={"example": 'host = "192.168.0.5"'})
    output_range: tuple[float, float] = field(
        metadata={"example": "output_range = [-20.0, 120.0] (V), what it may put out"}
    )
    port: int = 50000
    axes: tuple[str, ...] = ("1",)
    outputs: tuple[int, ...] | None = None
    limit_parameters: tuple[int, int] | None = None
    volts_per_unit: float = 1.0
    um_per_unit: float = 1.0
    offset: float = 0.0
    sample_rate: float = 100.0
    samples_per_tick: int = 5
    points_per_command: int = 50
    timeout: float = 2.0

    def __post_init__(self) -> None:
        check(self)
        outputs = range(1, len(self.axes) + 1) if self.outputs is None else self.outputs
        if np.ndim(outputs) != 1 or len(outputs) != len(self.axes):
            raise SettingError("outputs", self.outputs, f"as many as axes, {len(self.axes)}")
        object.__setattr__(self, "axes", tuple(map(str, self.axes)))
        object.__setattr__(self, "outputs", tuple(checks.count("outputs", entry, 1, 64) for entry in outputs))
        if self.limit_parameters is not None:
            low, high = (checks.count("limit_parameters", entry, 1, 2**32 - 1) for entry in self.limit_parameters)
            object.__setattr__(self, "limit_parameters", (low, high))
        checks.count("port", self.port, 1, 65535)
        checks.count("samples_per_tick", self.samples_per_tick, 1, 1000)
        checks.count("points_per_command", self.points_per_command, 1, 1000)


@dataclass(frozen=True)
class _Rate:
    """s a servo cycle, cycles a sample of the wave, samples of the recorder a sample of the wave."""

    cycle: float
    cycles: int
    samples: int


class PiDriver(ConnectedDriver):
    """The protocol of `drivers.Driver` over a controller of PI in open loop, and `playback`; see docs/pi.md.

    `playback` is what these controllers are good at: the wave is in their memory, and their own clock puts it out and
    records. `exchange` sends a set-point and asks for the position at each tick, which is slow, and timed by the
    caller.

    Parameters
    ----------
    settings : PiSettings
        Address, axes, limits, sensor.
    """

    Settings, kind = PiSettings, "pi"
    needs = (package("pipython", "drives controllers of Physik Instrumente"),)
    remedy = "; a generated wave has no such bound"
    holds = "the controller holds its last set-point; a wave of playback ends at the safe voltage by itself"

    @property
    def where(self) -> str:
        """Address of the controller."""
        host: str = self.settings.host
        return host

    @property
    def channels(self) -> int:
        """How many axes there are."""
        return len(self.settings.axes)

    def _connect(self) -> Any:
        return _connect(self.settings)

    def _disconnect(self, device: Any) -> None:
        device.__exit__(None, None, None)

    def _translated(self) -> AbstractContextManager[None]:
        return _translated()

    def _check(self) -> None:
        """Axes, servo and limits."""
        _check_axes(self._device, self.settings)
        _check_limits(self._device, self.settings)

    def _tick(self) -> None:
        self._position()
        self._reported()  # as long as SVA

    def _position(self) -> FloatArray:
        s = self.settings
        units = np.array(list(self._device.qPOS(list(s.axes)).values()), dtype=np.float64)
        position: FloatArray = units * s.um_per_unit + s.offset
        return position

    def _set(self, volts: FloatArray) -> None:
        s = self.settings
        self._device.SVA(list(s.axes), [float(unit) for unit in volts / s.volts_per_unit])

    def _halt(self) -> None:
        """Generators, motion and servo."""
        with _unless_it_answers():
            self._device.StopAll(noraise=True)
        with _unless_it_answers():
            self._device.SVO(list(self.settings.axes), [False] * len(self.settings.axes))

    def _reported(self) -> FloatArray:
        s = self.settings
        volts: FloatArray = np.array(list(self._device.qSVA(list(s.axes)).values())) * s.volts_per_unit
        return volts

    def playback(self, volts: npt.ArrayLike, sample_rate: float) -> Recorded:
        """Output a wave from the controller's memory and record it; the output then stays at its last voltage.

        It begins with a step if the output is elsewhere: `truestroke.runtime.drivers.playback` ramps.

        Parameters
        ----------
        volts : array_like, shape (channels, samples)
            V, within `output_range`.
        sample_rate : float
            Hz; a sample is a whole number of the controller's servo cycles.

        Returns
        -------
        Recorded
            Voltage that the controller has recorded, V, and displacement, um, means over each sample. The recorded
            voltage locates the start of the wave, so sample i of the displacement is that under sample i of the wave.

        Raises
        ------
        SettingError
            Shape, voltage or rate cannot be.
        DriverError
            The controller refuses, its memory is too small, or it did not put out what was sent.
        """
        self._needs("open", "playback")
        wave = _wave(volts, self.settings)
        with self._working("playing"):
            rate = self._rate(wave.shape[1], sample_rate)
            self._load(wave, rate)
            self._configure_recorder(rate)
            self._run(wave.shape[1] * rate.cycles * rate.cycle)
            raw = self._read((wave.shape[1] + 2) * rate.samples, rate)  # it continues after the wave
        self._state = "open"
        return _averaged(wave, raw, rate.samples, float(sample_rate), self.settings)

    def _rate(self, length: int, sample_rate: float) -> _Rate:
        """How often generator and recorder take a point, within the recorder's memory."""
        checks.positive("sample_rate", sample_rate, "Hz")
        cycle = float(self._parameter(SERVO_UPDATE_TIME))
        cycles = max(round(1 / (sample_rate * cycle)), 1)
        if abs(cycles * cycle * sample_rate - 1) > 1e-6:
            bound = f"{1 / cycle:g} Hz over a whole number, such as {1 / (cycle * cycles):g} Hz"
            raise SettingError("sample_rate", sample_rate, bound, "Hz")
        points = int(self._parameter(RECORDER_POINTS)) // self._device.qTNR()
        for samples in range(self.settings.samples_per_tick, 0, -1):
            if cycles % samples == 0 and (length + 2) * samples <= points:
                return _Rate(cycle, cycles, samples)
        raise DriverError(
            f"playing: the recorder holds {points} samples of each source, so {(points - 2) / sample_rate:.3g} s at "
            f"{sample_rate:g} Hz, and the wave has {length / sample_rate:.3g} s"
        )

    def _parameter(self, number: int) -> Any:
        return self._device.qSPA("1", number)["1"][number]

    def _load(self, wave: FloatArray, rate: _Rate) -> None:
        from pipython import pitools

        device, s = self._device, self.settings
        for generator, row in zip(self._generators(), wave / s.volts_per_unit, strict=True):
            device.WCL(generator)
            pitools.writewavepoints(device, generator, row.tolist(), s.points_per_command)
            device.WSL(generator, generator)
            device.WGC(generator, 1)
            device.WOS(generator, 0.0)
            device.WTR(generator, rate.cycles, 0)

    def _configure_recorder(self, rate: _Rate) -> None:
        device, s = self._device, self.settings
        device.RTR(rate.cycles // rate.samples)
        for i, (axis, output) in enumerate(zip(s.axes, s.outputs or (), strict=True)):
            device.DRC(2 * i + 1, axis, POSITION)
            device.DRC(2 * i + 2, output, VOLTAGE)
        device.DRT(0, 0, 0)  # it starts with the generators

    def _run(self, duration: float) -> None:
        generators = self._generators()
        self._device.WGO(generators, [1] * len(generators))
        running = functools.partial(self._device.IsGeneratorRunning, generators)
        _wait(lambda: not any(running().values()), duration + self.settings.timeout, "the end of the wave")

    def _read(self, count: int, rate: _Rate) -> FloatArray:
        """What was recorded: shape (count, channels, 2), position and voltage."""
        device, tables = self._device, list(range(1, 2 * len(self.settings.axes) + 1))
        _wait(lambda: min(device.qDRL(tables).values()) >= count, self.settings.timeout, f"{count} recorded samples")
        said = float(device.qDRR(tables, 1, count)["SAMPLE_TIME"])
        while device.bufstate is not True:
            time.sleep(0.01)
        if abs(said * rate.samples / (rate.cycles * rate.cycle) - 1) > 0.01:
            wanted = f"not {rate.samples} a sample of the wave"
            raise DriverError(f"playing: the recorder took a sample each {said:g} s, {wanted}")
        raw = np.array(device.bufdata, dtype=np.float64).T
        if raw.shape != (count, len(tables)):
            raise DriverError(f"playing: {raw.shape} values came from the recorder, not {(count, len(tables))}")
        return raw.reshape(count, -1, 2)

    def _generators(self) -> list[int]:
        """Wave generators, numbered as the axes are in the controller."""
        return [self._device.axes.index(axis) + 1 for axis in self.settings.axes]


# ---- The wave and its record ---------------------------------------------------------------------------------------


def _wave(volts: npt.ArrayLike, s: PiSettings) -> FloatArray:
    wave = checks.finite_array("volts", volts, "V", ndim=2)
    if len(wave) != len(s.axes) or wave.shape[1] < 2:
        raise SettingError("volts", f"array of shape {wave.shape}", f"of shape ({len(s.axes)}, 2 or more samples)")
    low, high = s.output_range
    for worst in (float(wave.min()), float(wave.max())):
        checks.within("volts", worst, low, high, "V")
    return wave


def _averaged(wave: FloatArray, raw: FloatArray, samples: int, sample_rate: float, s: PiSettings) -> Recorded:
    """Means over each sample of the wave, which begins in the record where its voltage fits best."""
    length = wave.shape[1] * samples
    expected = np.repeat(wave, samples, axis=1)
    position, voltage = raw[:, :, 0].T, raw[:, :, 1].T
    off = [np.mean((voltage[:, k : k + length] - expected) ** 2) for k in range(2 * samples + 1)]
    begin = int(np.argmin(off))
    allowed = SAME * np.ptp(wave) + 1e-3 * np.ptp(s.output_range)
    if not off[begin] <= allowed**2:
        raise DriverError(
            f"playing: the recorded voltage differs from the wave by {np.sqrt(off[begin]):.3g} V rms, not "
            f"{allowed:.3g} V at the most: are volts_per_unit and outputs those of the controller?"
        )
    volts, z = (x[:, begin : begin + length].reshape(len(wave), -1, samples).mean(2) for x in (voltage, position))
    return Recorded(volts, z * s.um_per_unit + s.offset, sample_rate)


def _wait(done: Callable[[], bool], patience: float, what: str) -> None:
    end = time.monotonic() + patience
    while not done():
        if time.monotonic() > end:
            remedy = "does the wave generator wait for a trigger (WGO, DRT)? Else raise the driver's timeout"
            raise DriverError(f"playing: waited {patience:.3g} s for {what}, in vain: {remedy}")
        time.sleep(0.01)


# ---- The controller ------------------------------------------------------------------------------------------------


def _connect(s: PiSettings) -> Any:
    """GCSDevice of PIPython over its PISocket."""
    from pipython import CRITICAL, GCSDevice, PILogger
    from pipython.pidevice.interfaces.pisocket import PISocket

    class Socket(PISocket):  # type: ignore[misc]
        """For cases in which PISocket would wait or spin: connecting, a connection closed at the other end."""

        def ConnectTCPIP(self, ipaddress: str, ipport: int = 50000) -> None:  # noqa: N802
            self._socket = socket.create_connection((ipaddress, ipport), s.timeout)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setblocking(False)
            self._connected = True

        def read(self) -> str:
            if not select.select([self._socket], [], [], 0.05)[0]:
                return ""
            came = self._socket.recv(65536)
            if not came:
                raise ConnectionError("the controller has closed the connection; does it accept one more?")
            return came.decode("cp1252", errors="ignore")

        def close(self) -> None:  # GCSDevice calls it again when it is deleted
            self._connected = False
            self._socket.close()

        CloseConnection = close

    PILogger.setLevel(CRITICAL)  # it prints what it raises
    gateway = Socket(s.host, s.port)
    gateway.settimeout(round(1e3 * s.timeout))
    try:
        return GCSDevice(gateway=gateway)  # asks CSV? and ERR?
    except BaseException:
        gateway.close()
        raise


def _check_axes(device: Any, s: PiSettings) -> None:
    from pipython import GCS2Device

    if not isinstance(device.gcsdevice, GCS2Device):
        raise DriverError(f"opening {s.host}: the controller speaks GCS {device.qCSV():g}, the driver GCS 2")
    there = device.axes
    for axis in s.axes:
        if axis not in there:
            raise DriverError(f"opening {s.host}: there is no axis {axis}; there are {', '.join(there)}")
    for axis, on in device.qSVO(list(s.axes)).items():
        if on:
            raise DriverError(f"opening {s.host}: the servo of axis {axis} is on; switch it off (SVO {axis} 0)")


def _check_limits(device: Any, s: PiSettings) -> None:
    for output in s.outputs or ():
        limits = _limits(device, output, s.limit_parameters)
        if not np.allclose(limits, s.output_range, rtol=0, atol=1e-3):
            raise DriverError(
                f"opening {s.host}: the controller limits output {output} to {limits[0]:g} to {limits[1]:g} V, the "
                f"settings have output_range = {s.output_range}"
            )


def _limits(device: Any, output: int, parameters: tuple[int, int] | None) -> tuple[float, float]:
    if parameters is None:
        try:
            with _translated():
                return device.qVMI(output)[output], device.qVMA(output)[output]
        except DriverError as error:
            raise DriverError(f"asking VMI? and VMA?, else see limit_parameters: {error}") from error
    low, high = (float(device.qSPA(str(output), number)[str(output)][number]) for number in parameters)
    return low, high


@contextmanager
def _unless_it_answers() -> Iterator[None]:
    """After a refusal the way to the safe voltage continues; after no answer it does not: answers would be mistaken."""
    from pipython import GCSError

    try:
        yield
    except GCSError as error:
        if error.val < 0:
            raise


@contextmanager
def _translated() -> Iterator[None]:
    """What PIPython raises, as a DriverError with the remedy."""
    try:
        from pipython import GCSError
    except ImportError as error:
        raise DriverError(f'{error}; pip install "truestroke[pi]"') from error
    try:
        yield
    except GCSError as error:
        hint = f" ({HINTS[error.val]})" if error.val in HINTS else ""
        raise DriverError(f"GCS {error.val}: {error.msg}{hint}") from error
    except OSError as error:
        raise DriverError(str(error)) from error
    except SettingError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError) as error:  # PIPython, at an answer that it cannot read
        raise DriverError(f"the controller's answer cannot be read: {error}") from error
