"""NI-DAQmx cards: blocks of samples, output and input on one clock of the hardware."""

import ctypes
import ctypes.util
import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import DriverError, Signal, check_signals
from truestroke.runtime.drivers.registry import Need, package
from truestroke.signals.timing import LONGEST_AGO, Timing

__all__ = ["NidaqmxDriver", "NidaqmxSettings"]

TERMINALS = {
    "default": "DEFAULT",
    "rse": "RSE",
    "nrse": "NRSE",
    "differential": "DIFF",
    "pseudo_differential": "PSEUDO_DIFF",
}

HINTS = {
    -200290: "the output ran out of samples: this computer was late; take a larger block, or more blocks ahead",
    -200621: "the card's own memory ran out of samples: bus or computer were late; take a larger block",
    -200279: "the input's buffer ran over: this computer was late; take a larger block",
    -200284: "no sample came in time: does the sample clock run?",
    -200561: "the voltage is outside output_range",
    -200220: "is the card's name, as `nidaqmx` or NI MAX lists it, that of outputs and inputs?",
    -200170: "does the card have this channel?",
    -200324: "is the card still plugged in?",
    -200678: "the card's own watchdog has expired: this computer was late, or card_watchdog is too short",
    -50103: "another program, or an earlier run, holds the card",
    -200587: "another program, or an earlier run, holds the card",
}


@dataclass(frozen=True, kw_only=True)
class AnalogSignal:
    """A further input of the card, beside those of the sensors: a signal that is recorded, such as that of an image.

    Attributes
    ----------
    name : str
        Of its channel in the recording.
    input : str
        Physical channel, such as "Dev1/ai2".
    per_volt : float
        Of the signal's unit at 1 V, not 0.
    offset : float
        The signal at 0 V.
    unit : str
        Of the signal, such as "nm".

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """

    name: str
    input: str
    per_volt: float = 1.0
    offset: float = 0.0
    unit: str = "V"

    def __post_init__(self) -> None:
        _names("input", [self.input])
        if not checks.number("per_volt", self.per_volt, f"{self.unit}/V"):
            raise SettingError("per_volt", self.per_volt, "not 0", f"{self.unit}/V")
        checks.number("offset", self.offset, self.unit)
        self.signal()

    def signal(self) -> Signal:
        """As the recording describes it."""
        return Signal(name=self.name, unit=self.unit, source=f"input {self.input}, mean over the tick")


@dataclass(frozen=True, kw_only=True)
class NidaqmxSettings:
    """A card with one output and one input an axis.

    Attributes
    ----------
    outputs, inputs : tuple[str, ...]
        Physical channels of the axes, such as "Dev1/ao0" and "Dev1/ai0"; outputs of one card.
    um_per_volt : tuple[float, ...]
        Displacement over voltage of each sensor at the input, um/V, not 0; one number serves all.
    offset : tuple[float, ...]
        Displacement at 0 V of each, um; one number serves all.
    signals : tuple[AnalogSignal, ...]
        Further inputs, which are recorded: of the same task, range and terminals as the sensors.
    sample_rate : float
        Ticks per second, Hz.
    converter_rate : float
        Conversions per second, Hz, a multiple of `sample_rate`: each tick's voltage is put out, and its displacement
        measured, `converter_rate / sample_rate` times; the measurement is the mean.
    block : int
        Ticks between two calls of the card, 1 to 1023.
    ahead : int
        Blocks of voltage that wait in the card's buffer: how late this computer may be. The latency is
        ``ahead * block`` ticks; latency and block together are at most 1024 ticks.
    output_range, input_range : tuple[float, float]
        V; the card takes the narrowest range of its own that holds it.
    terminals : str
        How the inputs are wired: "default", "rse", "nrse", "differential" or "pseudo_differential".
    clock : str
        Terminal whose clock the inputs follow; empty: the sample clock of the output.
    watch_clock : bool
        Whether each exchange compares the samples that went out with those that came in, and fails when input has
        lost more than a tick. Switch it off for a card that counts its samples in large chunks (USB).
    card_watchdog : float
        Time without an exchange after which the card itself, by a timer of its own, puts the safe voltage out, s,
        longer than four blocks; 0: none. Few cards have one for analogue outputs; one that has none refuses to open.
    timeout : float
        Longest wait for the card beyond the length of a block, s; shorter than the watchdog's.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> settings = NidaqmxSettings(outputs=("Dev1/ao0",), inputs=("Dev1/ai0",), um_per_volt=10.0)
    >>> settings.conversions, settings.latency
    (5, 40)
    """

    outputs: tuple[str, ...] = field(metadata={"example": 'outputs = ["Dev1/ao0"]'})
    inputs: tuple[str, ...] = field(metadata={"example": 'inputs = ["Dev1/ai0"]'})
    um_per_volt: tuple[float, ...] | float = field(metadata={"example": "um_per_volt = 10.0, of the sensor"})
    offset: tuple[float, ...] | float = 0.0
    signals: tuple[AnalogSignal, ...] = ()
    sample_rate: float = 2000.0
    converter_rate: float = 10_000.0
    block: int = 20
    ahead: int = 2
    output_range: tuple[float, float] = (-10.0, 10.0)
    input_range: tuple[float, float] = (-10.0, 10.0)
    terminals: str = "default"
    clock: str = ""
    watch_clock: bool = True
    card_watchdog: float = 0.0
    timeout: float = 0.2

    def __post_init__(self) -> None:
        channels = checks.count("outputs", len(_names("outputs", self.outputs)), 1, 64)
        if len(_names("inputs", self.inputs)) != channels:
            raise SettingError("inputs", self.inputs, f"as many as outputs, {channels}")
        for name, unit in (("um_per_volt", "um/V"), ("offset", "um")):
            object.__setattr__(self, name, _for_each(name, getattr(self, name), channels, unit))
        if 0.0 in self.scale[0]:
            raise SettingError("um_per_volt", self.um_per_volt, "not 0", "um/V")
        check_signals([one.signal() for one in self.signals])
        checks.positive("sample_rate", self.sample_rate, "Hz")
        checks.positive("converter_rate", self.converter_rate, "Hz")
        if self.conversions < 1 or self.conversions * self.sample_rate != self.converter_rate:
            bound = f"a multiple of sample_rate, {self.sample_rate} Hz"
            raise SettingError("converter_rate", self.converter_rate, bound, "Hz")
        checks.count("block", self.block, 1, LONGEST_AGO)
        checks.count("ahead", self.ahead, 1, LONGEST_AGO)
        checks.count("block - 1 + ahead * block", self.block - 1 + self.latency, 0, LONGEST_AGO)
        for name in ("output_range", "input_range"):
            object.__setattr__(self, name, checks.interval(name, getattr(self, name), "V"))
        if self.terminals not in TERMINALS:
            raise SettingError("terminals", self.terminals, f"one of {', '.join(TERMINALS)}")
        checks.positive("timeout", self.timeout, "s")
        if self.card_watchdog:
            checks.within("card_watchdog", self.card_watchdog, 4 * self.block / self.sample_rate, 3600.0, "s")
        for name in ("outputs", "inputs"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def conversions(self) -> int:
        """Conversions per tick."""
        return round(self.converter_rate / self.sample_rate)

    @property
    def latency(self) -> int:
        """Ticks from a command to the exchange position of its measurement."""
        return self.ahead * self.block

    @property
    def scale(self) -> tuple[FloatArray, FloatArray]:
        """`um_per_volt` and `offset` of the axes, then those of the signals, shape (all inputs,)."""
        factors, offsets = [one.per_volt for one in self.signals], [one.offset for one in self.signals]
        return np.append(self.um_per_volt, factors), np.append(self.offset, offsets)

    @property
    def all_inputs(self) -> tuple[str, ...]:
        """Physical channels of the axes, then of the signals."""
        return (*self.inputs, *(one.input for one in self.signals))


def _names(argument: str, value: Sequence[str]) -> Sequence[str]:
    """A list of names, and not one name, of which the letters would be taken."""
    if isinstance(value, str) or not all(isinstance(name, str) and "/" in name for name in value):
        raise SettingError(argument, repr(value), 'a list of physical channels such as ["Dev1/ao0"]')
    return value


def _for_each(argument: str, value: Any, channels: int, unit: str) -> tuple[float, ...]:
    """One number for each channel, or one for all."""
    if np.ndim(value) == 0:
        value = [value] * channels
    if len(value) != channels:
        raise SettingError(argument, value, f"one number, or {channels}", unit)
    return tuple(checks.number(argument, entry, unit) for entry in value)


class NidaqmxDriver:
    """The protocol of `truestroke.runtime.drivers.Driver` over a NI-DAQmx card; docs/nidaqmx.md has the first steps.

    The output takes its samples from a buffer and never repeats one: when this computer is late it stops, at the
    last voltage, with an error. Edge i of its clock also converts the input, just before sample i goes out; the first
    conversion is thrown away, so that each mean is of conversions that follow their voltage.

    Parameters
    ----------
    settings : NidaqmxSettings
        Channels, rates, ranges, sensors.
    """

    Settings = NidaqmxSettings
    needs = (
        package("nidaqmx", "drives cards of National Instruments"),
        Need(
            "libnidaqmx",
            "the driver of National Instruments, below the package nidaqmx",
            lambda: _library(),
            f"{sys.executable} -m nidaqmx installdriver",
        ),
    )

    def __init__(self, settings: NidaqmxSettings) -> None:
        self.settings = settings
        self._tasks: list[Any] = []  # input, output
        self._dog: Any = None  # the task of the card's watchdog
        self._state = "closed"  # or "open", "started": the output holds, "running": the clock runs, "failed"
        samples = settings.block * settings.conversions
        self._patience = settings.block / settings.sample_rate + settings.timeout  # s
        self._out = np.empty((len(settings.outputs), samples))
        self._in = np.empty((len(settings.all_inputs), samples))
        self.signals = tuple(one.signal() for one in settings.signals)
        self.readings = np.full((len(self.signals), settings.block), np.nan)

    def open(self) -> Timing:
        """Reserve the card and configure it; the output stays where it is.

        Raises
        ------
        DriverError
            NI-DAQmx, the Python package or the card is not there, or does not support the settings.
        """
        self._disarm()
        self._configure()
        s = self.settings
        if s.card_watchdog:  # a card without one refuses before anything moves
            try:
                with self._naming_watchdog(), _watchdog(s):
                    pass
            except DriverError:
                self.close()
                raise
        return Timing(
            sample_rate=s.sample_rate, block=s.block, latency=s.latency, channels=len(s.outputs), hardware_timed=True
        )

    def _configure(self) -> None:
        self._end_tasks()
        s = self.settings
        with _naming(f"opening {', '.join(s.outputs + s.all_inputs)}"):
            from nidaqmx import Task, constants, stream_readers, stream_writers

            try:
                self._tasks.append(Task())
                self._tasks.append(Task())
                _configure_output(self._tasks[1], s, constants)
                _configure_input(self._tasks[0], s, constants)
                for task in self._tasks:
                    task.control(constants.TaskMode.TASK_RESERVE)
            except BaseException:
                self.close()
                raise
            self._state = "open"
            self._reader = stream_readers.AnalogMultiChannelReader(self._tasks[0].in_stream)
            self._writer = stream_writers.AnalogMultiChannelWriter(self._tasks[1].out_stream)

    def start(self, volts: FloatArray) -> None:
        """Set the output to `volts` (V, shape (channels,)) and hold it there.

        The clock waits for the first exchange, so that nothing runs dry while the caller makes itself ready.
        """
        self._end_tasks()  # gives back what open has reserved, for the write on demand
        s = self.settings
        self._arm(volts)
        with _naming(f"starting {', '.join(s.outputs)}"):
            _write_on_demand(s.outputs, s.output_range, volts)
        self._configure()
        held = np.repeat(np.asarray(volts, np.float64)[:, None], s.latency * s.conversions, axis=1)
        with _naming(f"starting {', '.join(s.outputs)}"):
            _whole("write_many_sample", self._writer.write_many_sample(held, self._patience), held.shape[1])
        self._state = "started"

    def _arm(self, safe: FloatArray) -> None:
        """Let the card set its outputs to `safe` itself when no exchange comes; before other tasks reserve it."""
        if self.settings.card_watchdog and self._dog is None:
            with self._naming_watchdog():
                self._dog = _watchdog(self.settings)
                self._dog.cfg_watchdog_ao_expir_states(_expiration(self.settings.outputs, safe))
                self._dog.start()
                if self._dog.expired:  # in an earlier run
                    self._dog.clear_expiration()

    def _disarm(self) -> None:
        dog, self._dog = self._dog, None
        if dog is not None:
            from nidaqmx.errors import Error

            with suppress(Error):
                dog.close()

    def _naming_watchdog(self) -> AbstractContextManager[None]:
        s = self.settings
        return _naming(f"card_watchdog = {s.card_watchdog:g} s: the watchdog of {_device(s.outputs[0])}")

    def unattended(self) -> tuple[bool, str]:
        """Whether the open card sets its outputs to the safe voltages itself when this computer stops; in words."""
        s = self.settings
        if s.card_watchdog:
            return True, f"the card's own watchdog: the safe voltage after {s.card_watchdog:g} s without an exchange"
        at_power_up = _power_up(s.outputs)
        return False, f"the card holds its last voltage{at_power_up}; where it has a watchdog, set card_watchdog"

    def _run(self) -> None:
        """Start the clock; the conversion at its first edge comes before any voltage."""
        ai, ao = self._tasks
        with _naming(f"starting {', '.join(self.settings.outputs)}"):
            ai.start()  # waits for the clock, which is the output's
            ao.start()
            self._reader.read_many_sample(np.empty((len(self._in), 1)), 1, self._patience)

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """Write a block of voltages (V) after those that wait, and wait for the displacements (um) of the next."""
        if self._state not in ("started", "running"):
            raise DriverError(f"exchange: the driver is {self._state}; call start first")
        if not np.isfinite(volts).all():  # the output of a converter is then not defined
            raise DriverError(f"writing to {', '.join(self.settings.outputs)}: a voltage is not finite")
        s = self.settings
        self._out.reshape(len(s.outputs), s.block, s.conversions)[:] = volts[:, :, None]
        first, self._state = self._state == "started", "failed"  # until this call has come to its end
        if first:
            self._run()
        with _naming(f"writing to {', '.join(s.outputs)}"):
            if self._dog is not None:
                self._dog.reset_timer()
            _whole("write_many_sample", self._writer.write_many_sample(self._out, self._patience), self._out.shape[1])
        with _naming(f"reading from {', '.join(s.all_inputs)}"):
            count = self._reader.read_many_sample(self._in, self._in.shape[1], self._patience)
            _whole("read_many_sample", count, self._in.shape[1])
            if s.watch_clock:
                self._watch_clock()
        factor, offset = s.scale
        every = self._in.reshape(len(self._in), s.block, s.conversions).mean(axis=2) * factor[:, None] + offset[:, None]
        measured[:], self.readings = every[: len(s.inputs)], every[len(s.inputs) :]
        self._state = "running"

    def _watch_clock(self) -> None:
        """Input and output have seen the same edges, or measurements belong to other commands than is assumed."""
        ai, ao = self._tasks
        generated = ao.out_stream.total_samp_per_chan_generated  # asked first: the input can only be further
        acquired = ai.in_stream.total_samp_per_chan_acquired
        if generated - acquired > self.settings.conversions:
            raise DriverError(
                f"reading from {', '.join(self.settings.inputs)}: {generated} samples went out, {acquired} came in; "
                "the input has lost edges of its clock"
            )

    def stop(self, volts: FloatArray) -> None:
        """End the tasks, then write the safe `volts` (V, shape (channels,)) on demand; also after an error, also twice.

        After exchanges that went well, those that wait in the buffer go out first: a ramp to safety comes to its end.
        Where the card refuses, it is reset, which passes 0 V, and asked again.
        """
        if self._state == "running":
            time.sleep(self.settings.latency / self.settings.sample_rate)
        self._end_tasks()
        self._disarm()  # it does not let others write on demand
        hold(self.settings.outputs, self.settings.output_range, volts)

    def close(self) -> None:
        """End the tasks; the output keeps its last voltage. A second call does nothing."""
        self._end_tasks()
        self._disarm()

    def _end_tasks(self) -> None:
        self._state = "closed"
        if not self._tasks:
            return
        from nidaqmx.errors import Error

        while self._tasks:
            with suppress(Error):  # of a task that had failed before; it is closed all the same
                self._tasks.pop().close()

    def rescue(self) -> Callable[[FloatArray], None]:
        """Give `stop` for another process: a function of the safe volts that can be pickled."""
        return functools.partial(hold, self.settings.outputs, self.settings.output_range)

    def describe(self) -> dict[str, object]:
        """Kind and settings, as plain data for a recording."""
        return {"kind": "nidaqmx", **dataclasses.asdict(self.settings)}


def _library() -> str:
    """That of NI as the package nidaqmx finds it, or on the loader's path."""
    with suppress(OSError):
        return ctypes.util.find_library("nidaqmx") or str(ctypes.CDLL("libnidaqmx.so.1")._name)
    return ""


def _watchdog(s: NidaqmxSettings) -> Any:
    """The task of the card's own watchdog, not yet started."""
    from nidaqmx.system.watchdog import WatchdogTask

    return WatchdogTask(_device(s.outputs[0]), timeout=s.card_watchdog)


def _expiration(outputs: Sequence[str], volts: FloatArray) -> list[Any]:
    from nidaqmx.constants import WatchdogAOExpirState
    from nidaqmx.types import AOExpirationState

    states = zip(outputs, map(float, volts), strict=True)
    return [AOExpirationState(output, value, WatchdogAOExpirState.VOLTAGE) for output, value in states]


def _power_up(outputs: Sequence[str]) -> str:
    """The card's outputs at power-up, in words; empty where it does not state them."""
    from nidaqmx.errors import Error
    from nidaqmx.system import System

    try:
        states = System.local().get_analog_power_up_states_with_output_type(list(outputs))
    except Error:
        return ""
    return f", and gets {', '.join(f'{state.power_up_state:g} V' for state in states)} at power-up"


def _configure_output(task: Any, s: NidaqmxSettings, constants: Any) -> None:
    for name in s.outputs:
        task.ao_channels.add_ao_voltage_chan(name, min_val=s.output_range[0], max_val=s.output_range[1])
    _clock(task, s, constants, "", (s.ahead + 1) * s.block * s.conversions)
    task.out_stream.output_buf_size = (s.ahead + 1) * s.block * s.conversions
    task.out_stream.regen_mode = constants.RegenerationMode.DONT_ALLOW_REGENERATION
    _agree("output channels", task.out_stream.num_chans, len(s.outputs))
    _agree("converter_rate in Hz", task.timing.samp_clk_rate, s.converter_rate)


def _configure_input(task: Any, s: NidaqmxSettings, constants: Any) -> None:
    terminals = constants.TerminalConfiguration[TERMINALS[s.terminals]]
    for name in s.all_inputs:
        low, high = s.input_range
        task.ai_channels.add_ai_voltage_chan(name, terminal_config=terminals, min_val=low, max_val=high)
    _clock(task, s, constants, s.clock or f"/{_device(s.outputs[0])}/ao/SampleClock", round(s.converter_rate))
    _agree("input channels", task.in_stream.num_chans, len(s.all_inputs))


def _clock(task: Any, s: NidaqmxSettings, constants: Any, source: str, buffer: int) -> None:
    mode = constants.AcquisitionType.CONTINUOUS
    task.timing.cfg_samp_clk_timing(s.converter_rate, source=source, sample_mode=mode, samps_per_chan=buffer)


def hold(outputs: Sequence[str], output_range: tuple[float, float], volts: FloatArray) -> None:
    """Put constant `volts` (V, shape (channels,)) out at these physical channels of `output_range` (V), by a new task.

    Resets the card if something else holds it; `DriverError` where it refuses after that, too.
    """
    with _naming(f"holding {', '.join(outputs)} at {np.asarray(volts).tolist()} V"):
        from nidaqmx.errors import DaqError
        from nidaqmx.system.device import Device

        try:
            _write_on_demand(outputs, output_range, volts)
        except DaqError:
            for device in dict.fromkeys(map(_device, outputs)):
                Device(device).reset_device()
            _write_on_demand(outputs, output_range, volts)


def _write_on_demand(outputs: Sequence[str], output_range: tuple[float, float], volts: FloatArray) -> None:
    from nidaqmx import Task, stream_writers

    with Task() as task:
        for name in outputs:
            task.ao_channels.add_ao_voltage_chan(name, min_val=output_range[0], max_val=output_range[1])
        stream_writers.AnalogMultiChannelWriter(task.out_stream).write_one_sample(np.array(volts, np.float64))


def _device(channel: str) -> str:
    return channel.strip("/").split("/")[0]


def _agree(what: str, found: float, wanted: float) -> None:
    if abs(found - wanted) > 1e-6 * wanted:
        raise DriverError(f"{what}: the card says {found:g}, the settings {wanted:g}")


def _whole(call: str, count: int, wanted: int) -> None:
    if count != wanted:
        raise DriverError(f"{call}: the card moved {count} samples of {wanted}")


@contextmanager
def _naming(call: str) -> Iterator[None]:
    """What NI-DAQmx raises, as a DriverError with the call and the remedy."""
    try:
        from nidaqmx.errors import DaqError, Error
    except ImportError as error:
        raise DriverError(f'{call}: {error}; pip install "truestroke[nidaqmx]"') from error
    try:
        yield
    except DaqError as error:
        text = " ".join(str(error).split("\n\nStatus Code")[0].split())
        hint = f" ({HINTS[error.error_code]})" if error.error_code in HINTS else ""
        raise DriverError(f"{call}: NI-DAQmx {error.error_code}: {text}{hint}") from error
    except Error as error:  # the library of NI is not there, or too old
        raise DriverError(f"{call}: {error} `truestroke doctor` has the command that installs it.") from error
