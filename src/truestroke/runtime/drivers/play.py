"""Play a waveform on hardware and record what it does: one pass of play, record, refine."""

from __future__ import annotations

import signal
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, interrupts
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import Driver
from truestroke.signals.timing import Timing

__all__ = ["Player", "Recorded", "play_and_record"]

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


class Player(Driver, Protocol):
    """A driver whose hardware plays a whole waveform by itself."""

    def play(self, volts: npt.ArrayLike, sample_rate: float) -> Recorded:
        """Put out `volts` (V, shape (channels, samples)), record the displacement; without `start`."""


def play_and_record(
    driver: Driver,
    volts: npt.ArrayLike,
    sample_rate: float,
    *,
    voltage_limits: tuple[float, float],
    slew: float,
    safe_voltage: float = 0.0,
    rest: float = 0.5,
) -> Recorded:
    """Play a waveform on hardware of one channel, from the safe voltage and back to it.

    The output ramps to the first voltage, rests there, plays, and ramps back. A driver that has `play` plays it all at
    once on its own clock; others do so block by block, paced by this computer where they have no clock.

    Parameters
    ----------
    driver : Driver
        Closed; it is closed again in the end, with the output at the safe voltage, whatever happens.
    volts : array_like, shape (samples,)
        V.
    sample_rate : float
        Hz. Hardware that plays block by block must have the same.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage, V: a waveform that leaves them is refused.
    slew : float
        Fastest change of the voltage, V/s: a waveform that is faster is refused. The ramps take a second for the whole
        of `voltage_limits`, or longer where the slew limit says so.
    safe_voltage : float
        Where it starts and ends, V.
    rest : float
        Time under the first voltage, s.

    Returns
    -------
    Recorded
        Of the waveform alone, ramps cut off; `displacement[0]` and `volts[0]` are what `Record.from_arrays` takes.

    Raises
    ------
    SettingError
        An argument is out of its bounds.
    DriverError
        The hardware failed.
    """
    wave = checks.finite_array("volts", volts, "V")
    low, high = checks.interval("voltage_limits", voltage_limits, "V")
    if wave.size < 2:
        raise SettingError("volts", f"array of {wave.size} samples", "at least two samples", "V")
    for value in (wave.min(), wave.max()):
        checks.within("volts", value, low, high, "V")
    safe = checks.within("safe_voltage", safe_voltage, low, high, "V")
    rate = checks.positive("sample_rate", sample_rate, "Hz")
    fastest = float(np.abs(np.diff(wave)).max()) * rate
    if fastest > checks.positive("slew", slew, "V/s") * (1 + 1e-9):
        raise SettingError("volts", f"waveform of {fastest:.4g} V/s", f"no faster than slew, {slew:g} V/s")
    step = min(slew, (high - low) / RAMP) / rate
    before = np.append(_ramp(safe, wave[0], step), np.full(round(rest * sample_rate), wave[0]))
    whole = np.concatenate([before, wave, _ramp(wave[-1], safe, step)])[None, :]
    try:
        timing = driver.open()
        if timing.channels != 1:
            raise SettingError("channels of the driver", timing.channels, "1")
        play = getattr(driver, "play", None)
        made = play(whole, sample_rate) if play else _by_blocks(driver, timing, whole, sample_rate, safe)
    finally:
        with interrupts.handled(interrupts.ENDING, signal.SIG_IGN):  # none interrupts the way to the safe voltage
            try:
                driver.stop(np.array([safe]))
            finally:
                driver.close()
    part = slice(before.size, before.size + wave.size)
    return Recorded(made.volts[:, part], made.displacement[:, part], made.sample_rate)


def _ramp(start: float, stop: float, step: float) -> FloatArray:
    """From start to stop, both of them, no faster than `step` a sample."""
    return np.linspace(start, stop, int(np.ceil(abs(stop - start) / step)) + 2)


def _by_blocks(driver: Driver, timing: Timing, volts: FloatArray, sample_rate: float, safe: float) -> Recorded:
    """The same through `exchange`; the latency is waited for at the end, and taken out."""
    if abs(sample_rate / timing.sample_rate - 1) > 1e-6:
        raise SettingError("sample_rate", sample_rate, f"that of the driver, {timing.sample_rate:g} Hz", "Hz")
    length, block = volts.shape[1], timing.block
    blocks = -(-(length + timing.latency) // block)
    commands = np.pad(volts, ((0, 0), (0, blocks * block - length)), mode="edge")
    measured = np.empty_like(commands)
    driver.start(np.array([safe]))
    due = time.monotonic()
    for k in range(0, blocks * block, block):
        part = np.full((1, block), np.nan)
        driver.exchange(np.ascontiguousarray(commands[:, k : k + block]), part)
        measured[:, k : k + block] = part
        due += block / sample_rate
        if not timing.hardware_timed:
            time.sleep(max(due - time.monotonic(), 0.0))
    return Recorded(volts, measured[:, timing.latency : timing.latency + length], sample_rate)
