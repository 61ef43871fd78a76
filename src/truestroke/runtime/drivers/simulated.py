"""The simulated plant with the protocol of hardware, with faults on demand."""

import dataclasses
import functools
import os
import time
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import DriverError, Signal, check_signals
from truestroke.signals.timing import Timing

if TYPE_CHECKING:
    from truestroke.plant import MultiAxisStage
    from truestroke.signals.scans.images import Sample

USUAL_STROKE = 30.0  # um: a texture repeats after four thirds of it, a grating after a tenth
USUAL_STROKES = 10.0, 40.0  # um: under stages of these strokes samples have the usual sizes
FAULTS = ("open", "start", "error", "nan", "short", "wild", "frozen", "hang", "slip", "abort", "stop")


class Plant(Protocol):
    """What is driven on each channel: an actuator of the loop."""

    truth: FloatArray

    def open(self) -> Timing:
        """Be at rest."""

    def exchange(self, volts: FloatArray) -> FloatArray:
        """Move."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault, for tests and rehearsals.

    Attributes
    ----------
    kind : str
        "error": exchange raises; "nan": the samples are lost; "short": the second half of the block is lost; "wild":
        they are far beyond any stroke; "frozen": the last sample repeats; "hang": exchange never returns; "slip":
        exchange takes three periods longer; "abort": the process dies; "open", "start", "stop": that call raises.
    at : int
        First exchange that it concerns, counted from 0, and from 0 again after the axis check of `truestroke run`.
    count : int
        How many exchanges it lasts.
    """

    kind: str
    at: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise SettingError("kind", repr(self.kind), f"one of {', '.join(FAULTS)}")
        checks.count("at", self.at, 0, 2**62)
        checks.count("count", self.count, 1, 2**62)


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """A sample under the first two axes, and what a microscope reads of it: its height where it truly is, nm.

    Attributes
    ----------
    name : str
        Of the signal, and of its channel in the recording.
    sample : str
        "texture" or "grating", of `truestroke.scans`.
    seed : int
        Of the texture, and of the noise.
    noise : float
        Standard deviation of a tick, nm.
    """

    name: str = "height"
    sample: str = "texture"
    seed: int = 0
    noise: float = 0.0

    def __post_init__(self) -> None:
        checks.one_of("sample", self.sample, ("texture", "grating"))
        checks.count("seed", self.seed, 0, 2**62)
        checks.within("noise", self.noise, 0.0, 1e9, "nm")
        self.signal()

    def signal(self) -> Signal:
        """As the recording describes it."""
        return Signal(name=self.name, unit="nm", source=f"a simulated {self.sample}")

    def made(self, stroke: float) -> "Sample":
        """The sample: of the usual sizes under stages of 10 to 40 um, else as much larger or smaller as their stroke.

        A texture that repeats within the image shows shifts that are none, and one grain shows no shift at all.
        """
        from truestroke.signals.scans import Grating, Texture

        size = 1.0 if USUAL_STROKES[0] <= stroke <= USUAL_STROKES[1] else stroke / USUAL_STROKE
        if self.sample == "texture":
            return Texture(seed=self.seed, tile=40.0 * size, grain=0.12 * size)
        return Grating(pitch=3.0 * size, edge=0.1 * size)


def _keys_of(settings: str) -> Callable[[], Iterable[str]]:
    """Members of settings of `truestroke.plant`, which is loaded late."""

    def keys() -> Iterable[str]:
        from truestroke import plant

        return (one.name for one in dataclasses.fields(getattr(plant, settings)))

    return keys


@dataclass(frozen=True, kw_only=True)
class SimulatedSettings:
    """A simulated stack on each channel.

    Attributes
    ----------
    sample_rate : float
        Ticks per second, Hz.
    block, latency : int
        Ticks that an exchange moves; ticks from a command to its measurement.
    channels : int
        Stacks.
    seed : int
        Of the noise of the first one; each other one has the next.
    hardware_timed : bool
        Whether exchange lasts as long as its block, as a card with a clock of its own makes it.
    register : str or None
        File that shows what is at the outputs (float64, V, one for each channel), also to other processes; by default a
        temporary one. It stays as it is when the process dies, as the D/A converter of a card does; a temporary one
        until a watchdog has set it to safety.
    plant : Mapping[str, object]
        Members of `plant.PlantSettings`.
    stage : Mapping[str, object]
        Members of `plant.StageSettings`: a stage for fast motion on each channel in place of that plant.
    axes : Mapping[str, object]
        Members of `plant.MultiAxisSettings` beside `axes`, and `stages`, a table of members of `plant.StageSettings`
        for each channel: stages that disturb each other, in place of both.
    signals : tuple[SampleSettings, ...]
        Samples whose height is recorded as further signals; of two axes or more.
    faults : tuple[Fault, ...]
        Faults of the run.
    """

    sample_rate: float = 2000.0
    block: int = 1
    latency: int = 0
    channels: int = 1
    seed: int = 0
    hardware_timed: bool = False
    register: str | None = None
    plant: Mapping[str, object] = field(default_factory=dict, metadata={"keys": _keys_of("PlantSettings")})
    stage: Mapping[str, object] = field(default_factory=dict, metadata={"keys": _keys_of("StageSettings")})
    axes: Mapping[str, Any] = field(default_factory=dict)
    signals: tuple[SampleSettings, ...] = ()
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        checks.count("seed", self.seed, 0, 2**62)
        if self.plant and self.stage:
            raise SettingError("stage", dict(self.stage), "left out, or `plant`: a channel has one of them")
        if self.axes and (self.plant or self.stage):
            raise SettingError("axes", dict(self.axes), "left out, or `plant` and `stage`: a channel has one of them")
        check_signals([one.signal() for one in self.signals])
        if self.signals and self.channels < 2:
            raise SettingError("signals", f"{len(self.signals)} samples", "left out with one channel: x and y are two")
        self.timing()

    def timing(self) -> Timing:
        """The result of `open`."""
        names = [entry.name for entry in dataclasses.fields(Timing)]
        return Timing(**{name: getattr(self, name) for name in names})

    def together(self) -> "MultiAxisStage":
        """The stages of `axes`."""
        from truestroke.base import toml  # late, as `tempfile`: no process beside the loop needs them
        from truestroke.plant import MultiAxisSettings, MultiAxisStage, StageSettings

        given = {**self.axes}
        stages = given.pop("stages", [{} for _ in range(self.channels)])
        with checks.inside("axes."):
            if not isinstance(stages, list | tuple) or len(stages) != self.channels:
                raise SettingError("stages", f"{len(stages)} tables", f"{self.channels}, one for each channel")
            each = tuple(toml.decode(StageSettings, one, sample_rate=self.sample_rate) for one in stages)
            names = [f.name for f in dataclasses.fields(MultiAxisSettings) if f.name != "axes"]
            checks.known(given, ["stages", *names])
            return MultiAxisStage(MultiAxisSettings(axes=each, **given), self.seed)

    def plants(self) -> list[Plant]:
        """A realistic stack, or a stage, for each channel."""
        from truestroke.base import toml
        from truestroke.plant import PlantSettings, RealisticPlant, StagePlant, StageSettings

        if self.stage:
            with checks.inside("stage."):
                stage = toml.decode(StageSettings, self.stage, sample_rate=self.sample_rate)
            return [StagePlant(stage, self.seed + channel) for channel in range(self.channels)]
        with checks.inside("plant."):
            settings = toml.decode(PlantSettings, self.plant, sample_rate=self.sample_rate)
        return [RealisticPlant(settings, self.seed + channel) for channel in range(self.channels)]


class SimulatedDriver:
    """Simulated stacks as hardware: `truestroke.runtime.drivers.Driver`.

    The time of the plant is that of its ticks alone: the measurements are those of `truestroke.run`, to the last bit.

    Parameters
    ----------
    settings : SimulatedSettings
        Timing, noise, faults.
    plants : sequence of Plant, optional
        What is driven instead of the stacks that the settings describe.

    Attributes
    ----------
    truth : ndarray, shape (channels, block)
        Noise-free counterpart of the last `measured`, um.

    Examples
    --------
    >>> driver = SimulatedDriver(SimulatedSettings(plant={"noise": 0.0}))
    >>> driver.open().sample_rate
    2000.0
    >>> driver.start(np.zeros(1))
    >>> volts, measured = np.ones((1, 1)), np.empty((1, 1))
    >>> driver.exchange(volts, measured)
    >>> print(f"{measured[0, 0]:.1f} um, output at {driver.output[0]:g} V")
    4.0 um, output at 1 V
    >>> driver.stop(np.zeros(1))
    >>> print(f"output at {driver.output[0]:g} V")
    output at 0 V
    >>> driver.close()
    """

    Settings = SimulatedSettings

    def __init__(self, settings: SimulatedSettings | None = None, plants: Sequence[Plant] | None = None) -> None:
        self.settings = SimulatedSettings() if settings is None else settings
        self._together = self.settings.together() if self.settings.axes and plants is None else None
        if self._together is not None:
            self._plants: list[Any] = [self._together]
        else:
            self._plants = self.settings.plants() if plants is None else list(plants)
        if self._together is None and len(self._plants) != self.settings.channels:
            raise SettingError("plants", len(self._plants), f"{self.settings.channels}, one for each channel")
        self._temporary: str | None = None
        self.signals = tuple(one.signal() for one in self.settings.signals)
        self._samples = self._made()

    def _made(self) -> list["Sample"]:
        """The samples, by the longest stroke of the stages."""
        if not self.settings.signals:
            return []
        from truestroke.plant import StagePlant

        stages = [one.settings for one in self._plants if isinstance(one, StagePlant)]
        if self._together is not None:
            stages = list(self._together.settings.axes)
        stroke = max((one.stroke for one in stages), default=USUAL_STROKE)
        return [one.made(stroke) for one in self.settings.signals]

    def open(self) -> Timing:
        """The stacks at rest; the output stays where it is."""
        import tempfile

        s = self.settings
        self._fail("open")
        if s.register is None and self._temporary is None:
            handle, self._temporary = tempfile.mkstemp(prefix="truestroke-", suffix=".volts")
            os.close(handle)
            self._forgotten = weakref.finalize(self, _remove, self._temporary, os.getpid())
        self._path = s.register or self._temporary or ""
        if not Path(self._path).exists() or Path(self._path).stat().st_size != 8 * s.channels:
            set_register(self._path, np.zeros(s.channels))
        self.output = np.memmap(self._path, np.float64, "r+", shape=(s.channels,))
        for plant in self._plants:
            plant.open()
        self.truth = np.empty((s.channels, s.block))
        self._late = np.full((2, s.channels, s.latency), np.nan)  # measured and true of the commands before
        self._begin()
        return s.timing()

    def _begin(self) -> None:
        self._exchanges = 0
        self._noises = [np.random.Generator(np.random.PCG64(one.seed)) for one in self.settings.signals]
        self.readings = self._read(np.zeros_like(self.truth))  # a texture is made when it is read first

    def rewind(self) -> None:
        """The stacks as `open` left them, with the same noise before them; the output stays where it is."""
        for plant in self._plants:
            plant.open()
        self._late[:] = np.nan
        self._begin()

    def start(self, volts: FloatArray) -> None:
        """`volts` at the outputs."""
        self._fail("start")
        self.output[:] = volts
        self._over = time.perf_counter()

    def exchange(self, volts: FloatArray, measured: FloatArray) -> None:
        """Move the stacks by a block."""
        s = self.settings
        kinds = {f.kind for f in s.faults if f.at <= self._exchanges < f.at + f.count}
        self._exchanges += 1
        if "error" in kinds:
            raise DriverError("exchange: error -1: the simulated connection is lost")
        while "hang" in kinds:
            time.sleep(1.0)
        if "abort" in kinds:
            os.abort()
        previous = measured[:, -1:].copy()
        self.output[:] = volts[:, -1]
        both = np.concatenate([self._late, self._moved(volts)], axis=2)
        measured[:], self.truth = both[:, :, : s.block]
        self._late = both[:, :, s.block :]
        self.readings = self._read(self.truth)
        values: dict[str, float | FloatArray] = {"nan": np.nan, "short": np.nan, "wild": 1e6, "frozen": previous}
        for kind in [kind for kind in values if kind in kinds]:
            measured[:, s.block // 2 if kind == "short" else 0 :] = values[kind]
        self._pass_time(s.block / s.sample_rate, "slip" in kinds)

    def _moved(self, volts: FloatArray) -> FloatArray:
        """What is measured and true in the ticks of `volts`, shape (2, channels, ticks)."""
        if self._together is not None:
            return np.array([self._together.exchange(volts.T).T, self._together.truth.T])
        each = [(plant.exchange(row), plant.truth) for plant, row in zip(self._plants, volts, strict=True)]
        return np.array(each).swapaxes(0, 1)

    def _read(self, truth: FloatArray) -> FloatArray:
        """What the signals are at these places, um, shape (channels, block)."""
        read = np.full((len(self.signals), truth.shape[1]), np.nan)
        there = np.isfinite(truth[:2]).all(axis=0)
        for row, sample, one, noise in zip(read, self._samples, self.settings.signals, self._noises, strict=True):
            if there.any():
                row[there] = sample(*truth[:2, there]) + noise.normal(0.0, one.noise, np.count_nonzero(there))
        return read

    def _pass_time(self, period: float, slips: bool) -> None:
        if slips:
            time.sleep(3 * period)
            self._over += 3 * period
        if self.settings.hardware_timed:
            self._over += period
            time.sleep(max(self._over - time.perf_counter(), 0.0))

    def stop(self, volts: FloatArray) -> None:
        """`volts` at the outputs."""
        self._fail("stop")
        self.output[:] = volts

    def _fail(self, call: str) -> None:
        if any(fault.kind == call for fault in self.settings.faults):
            raise DriverError(f"{call}: error -2: the simulated device does not answer")

    def close(self) -> None:
        """Delete the temporary register, if there is one."""
        if self._temporary is not None:
            self._forgotten()
            self._temporary = None

    def rescue(self) -> Callable[[FloatArray], None]:
        """Write to the register from another process."""
        if self._temporary is not None:
            return functools.partial(_rescue, self._temporary, os.getpid())
        return functools.partial(set_register, self._path)

    def describe(self) -> dict[str, object]:
        """The settings, as plain data."""
        return {"kind": "simulated", **dataclasses.asdict(self.settings), **self._range()}

    def _range(self) -> dict[str, object]:
        """That of the D/A converters, or of each of them, where they are simulated and have one."""
        settings = getattr(self._plants[0], "settings", None)
        if self._together is not None:
            ranges = [one.voltage_limits for one in self._together.settings.axes]
            return {"output_range": ranges if len(set(ranges)) > 1 else ranges[0]}
        limits = getattr(settings, "voltage_limits" if self.settings.stage else "da_limits", None)
        return {} if limits is None else {"output_range": limits}


def _remove(path: str, owner: int) -> None:
    """A temporary register, which a process that was forked from its owner leaves alone."""
    if os.getpid() == owner:
        Path(path).unlink(missing_ok=True)


def _rescue(path: str, owner: int, volts: FloatArray) -> None:
    """Set the simulated outputs of a temporary register, where it is there; its owner keeps it, if it lives.

    Another process rescues where the owner is gone, or stands still: nobody else would delete it.
    """
    if Path(path).exists():
        set_register(path, volts)
        if os.getpid() != owner:
            Path(path).unlink(missing_ok=True)


def set_register(path: str, volts: FloatArray) -> None:
    """Set simulated outputs to `volts` (V, shape (channels,))."""
    with open(path, "r+b" if Path(path).exists() else "wb") as file:
        file.write(np.asarray(volts, dtype=np.float64).tobytes())
