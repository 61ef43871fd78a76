"""A waveform put out by hardware, and what it does, recorded: one pass of playback, record, refine."""

import dataclasses
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, files
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.model.sampled import REST
from truestroke.runtime.drivers.guard import Limits, check_range
from truestroke.runtime.drivers.one_axis import ONE_OF, OneAxis
from truestroke.runtime.drivers.paced import let_go
from truestroke.runtime.drivers.protocol import Driver

__all__ = ["Player", "Recorded", "playback"]

RAMP = 1.0  # s: how long a ramp over the whole of the voltage limits takes, at least


@dataclass(frozen=True, eq=False)
class Recorded:
    """What was put out, and what it did.

    Attributes
    ----------
    volts : ndarray, shape (channels, samples)
        V.
    displacement : ndarray, shape (channels, samples)
        um, means over each sample; NaN where a sample was lost.
    sample_rate : float
        Hz.
    """

    volts: FloatArray
    displacement: FloatArray
    sample_rate: float

    def as_dict(self) -> dict[str, Any]:
        """Of the first channel, for JSON: the unit is in the name."""
        x, z = self.volts[0], self.displacement[0]
        return {
            "samples": x.size,
            "lost": int(np.isnan(z).sum()),
            "sample_rate_Hz": self.sample_rate,
            "voltage_V": [float(x.min()), float(x.max())],
            "displacement_um": [float(np.nanmin(z)), float(np.nanmax(z))],
        }


def read_waveform(path: Path) -> tuple[FloatArray, float]:
    """Voltages, V, and their sample rate, Hz, of a file with columns `time` (s) and `volts` (V).

    Raises
    ------
    RecordError
        It has no such columns, a row that is no number, or times that are not even.
    """
    # Late: each process beside the loop has the drivers, and none of them reads a table.
    from truestroke.signals.columns import Wanted, even_rate, read_columns, refuse_bad_rows
    from truestroke.signals.tables import UNITS, open_table

    table = open_table(path)
    headings = {"volts": "volts (V)", "time": "time (s)"}
    wanted = [Wanted(role, UNITS[role], (role,), certain=True, heading=name) for role, name in headings.items()]
    signals, _ = read_columns(path, table, wanted, ())
    refuse_bad_rows(str(path), signals, table)
    return signals["volts"], even_rate(path, table, signals["time"])


def save_record(path: Path, made: Recorded) -> None:
    """Write the first channel as CSV, as `read_record` takes it."""
    x, z = made.volts[0], made.displacement[0]
    rows = np.column_stack([np.arange(x.size) / made.sample_rate, x, z])
    with files.writing(path, files.MEASUREMENT) as draft:
        np.savetxt(draft, rows, fmt="%.9g", delimiter=",", header="time (s),volts (V),z (um)", comments="")


class Player(Driver, Protocol):
    """A driver whose hardware puts out a whole waveform by itself."""

    def playback(self, volts: npt.ArrayLike, sample_rate: float) -> Recorded:
        """Put out `volts` (V, shape (channels, samples)), record the displacement; without `start`."""


def playback(
    driver: Driver,
    volts: npt.ArrayLike,
    sample_rate: float,
    *,
    voltage_limits: tuple[float, float],
    slew: float,
    safe_voltage: float = 0.0,
    rest: float = REST,
) -> Recorded:
    """Put out a waveform by hardware and record what it does, from the safe voltage and back to it.

    The output ramps to the first voltage, rests there, follows the waveform, and ramps back. A driver that has
    `playback` does all of it on its own clock, with a waveform for each of its channels; others have one channel and
    take it block by block, as `OneAxis`: within limits and slew, paced by this computer where they have no clock.

    Parameters
    ----------
    driver : Driver
        Closed; it is closed again at the end, with the output at the safe voltage in every case, except where it has
        another number of channels: then nothing is put out.
    volts : array_like, shape (samples,) or (channels, samples)
        V.
    sample_rate : float
        Hz. Hardware that takes it block by block must have the same.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage, V: a waveform beyond them is refused.
    slew : float
        Fastest change of the voltage, V/s: a waveform that is faster is refused. The ramps take a second for the whole
        of `voltage_limits`, or longer because of the slew limit.
    safe_voltage : float
        Where it starts and ends, V.
    rest : float
        Time under the first voltage, s.

    Returns
    -------
    Recorded
        Of the waveforms alone, ramps cut off; `displacement[0]` and `volts[0]` are what `Record.from_arrays` takes.

    Raises
    ------
    SettingError
        An argument is out of its bounds or not of its kind.
    DriverError
        The hardware failed.
    """
    waves = np.atleast_2d(checks.finite_array("volts", volts, "V", ndim=(1, 2)))
    limits = Limits(voltage_limits=voltage_limits, slew=slew, safe_voltage=safe_voltage)
    if waves.shape[1] < 2:
        raise SettingError("volts", f"array of {waves.shape[1]} samples", "at least two samples", "V")
    low, high = limits.voltage_limits
    for value in (waves.min(), waves.max()):
        if not low <= value <= high:
            bound = f"within voltage_limits, from {low:g} to {high:g} V: make it for these (`truestroke invert"
            raise SettingError("volts", figures(value, 4), f"{bound} --voltage-limits {low:g} {high:g}`)", "V")
    rate = checks.positive("sample_rate", sample_rate, "Hz")
    fastest = float(np.abs(np.diff(waves)).max()) * rate
    if fastest > limits.slew * (1 + 1e-9):
        bound = f"no faster than slew, {slew:g} V/s: make it for that (`truestroke invert --slew {slew:g}`)"
        raise SettingError("volts", f"waveform of {figures(fastest, 4)} V/s", bound)
    calls = ("open", "start", "exchange", "stop", "close")
    checks.able("driver", driver, calls, "a driver, such as drivers.SimulatedDriver; the order is driver, volts")
    before, after = _ways(limits, waves, rate, rest)
    whole = np.hstack([before, waves, after])
    made = (_at_once if hasattr(driver, "playback") else _by_blocks)(driver, whole, rate, limits)
    part = slice(before.shape[1], before.shape[1] + waves.shape[1])
    return Recorded(made.volts[:, part], made.displacement[:, part], made.sample_rate)


def _ways(limits: Limits, waves: FloatArray, sample_rate: float, rest: float) -> tuple[FloatArray, FloatArray]:
    """From the safe voltage to all waveforms, and back; whose way is shorter waits at the safe voltage."""
    safe, step = limits.safe_voltage, _step(limits, sample_rate)
    there = [lead(limits, wave[0], sample_rate, rest) for wave in waves]
    back = [ramp(wave[-1], safe, step) for wave in waves]
    first, last = (max(len(way) for way in ways) for ways in (there, back))
    before = [np.append(np.full(first - len(way), safe), way) for way in there]
    return np.array(before), np.array([np.append(way, np.full(last - len(way), safe)) for way in back])


def lead(limits: Limits, first: float, sample_rate: float, rest: float = REST) -> FloatArray:
    """From the safe voltage to the first one, V, and the rest there, s: what is put out before a waveform."""
    way = ramp(limits.safe_voltage, first, _step(limits, sample_rate))
    return np.append(way, np.full(round(rest * sample_rate), first))


def _step(limits: Limits, sample_rate: float) -> float:
    """Of a ramp, V a sample."""
    low, high = limits.voltage_limits
    return min(limits.slew, (high - low) / RAMP) / sample_rate


def ramp(start: float, stop: float, step: float) -> FloatArray:
    """From start to stop, both of them, no faster than `step` a sample."""
    return np.linspace(start, stop, int(np.ceil(abs(stop - start) / step)) + 2)


def _at_once(driver: Any, volts: FloatArray, sample_rate: float, limits: Limits) -> Recorded:
    """By the hardware's own memory and clock."""
    with ExitStack() as end:
        end.callback(let_go, driver, np.full(len(volts), limits.safe_voltage))
        channels = driver.open().channels
        if channels != len(volts):
            end.pop_all()  # the outputs stay where they are: the safe voltages of all are not known
            driver.close()
            remedy = f"; {ONE_OF}" if len(volts) == 1 else ""
            raise SettingError("channels of the driver", channels, f"as many as waveforms, {len(volts)}{remedy}")
        for channel in range(channels):
            check_range("voltage_limits", limits.voltage_limits, driver.describe(), channel)
        made: Recorded = driver.playback(volts, sample_rate)
        return made


def _by_blocks(driver: Driver, volts: FloatArray, sample_rate: float, limits: Limits) -> Recorded:
    """Through `exchange`; the latency is waited for at the end, and taken out."""
    if len(volts) > 1:
        raise SettingError("volts", f"waveforms of {len(volts)} channels", "one: this hardware does not play by itself")
    with OneAxis(driver, **dataclasses.asdict(limits)) as axis:
        timing = axis.open()
        if abs(sample_rate / timing.sample_rate - 1) > 1e-6:
            raise SettingError(
                "sample_rate of the waveform", sample_rate, f"that of the driver, {timing.sample_rate:g} Hz", "Hz"
            )
        return Recorded(volts, axis.apply(volts[0])[None, :], sample_rate)
