"""The measurement of the dynamics: slowly to a bias voltage, a small multisine for two seconds, slowly back."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.identification.dynamics.bode import Bode, DynamicsError, SmallMotion, identify_dynamics
from truestroke.identification.dynamics.excitation import SPARE, Multisine, fastest, multisine
from truestroke.model.dynamics import SEEN, Dynamics, Mode
from truestroke.signals.timing import Timing

DURATION = 2.0  # s
RAMP = 0.5  # s, at least, to the bias voltage and back
ROUNDING = 1e-12  # of a mean
HOLD = 0.3  # s at the bias voltage: creep slows down, noise is measured
FADING, FADING_CYCLES, FADING_FREQUENCY = 0.1, 8, 8.0  # of the voltage range; cycles; Hz
LEAD = 0.25  # s of the excitation before its period
CORNERS = 1000.0, 500.0, 200.0, 100.0  # Hz: from which on the amplitudes of the excitation fall: as the slew allows
HIGHEST = 8000.0, 0.3  # Hz, and of the sample rate: the end of the band, at most, is the higher one
PERIODS = 8  # of the lowest frequency in the duration
LEVELS = 0.01, 0.03  # of the voltage range: the peak of the excitation, at least and at most
LOUD = 24.0  # standard deviations of the noise: the peak of the displacement that is aimed at
TRAVEL = 0.25  # of what the voltage range moves the stage: how far it may go, where nothing is asked for
STEP = 0.02  # of the voltage range: the least way to the bias voltage that shows the gain
SPIKES = 3  # samples in a row beyond the travel
GAP = 0.05  # s without a sample
LONGEST = 120.0  # s to the bias voltage and back: with less slew it is refused


class Driven(Protocol):
    """An actuator of the loop."""

    def open(self) -> Timing:
        """Be ready, at rest; the timing."""

    def exchange(self, volts: FloatArray) -> FloatArray:
        """One voltage (V) a tick; as many displacements (um)."""


def measure_dynamics(actuator: Driven, **options: Any) -> Dynamics:
    """Measure modes, lag and dead time of a stage with a small multisine of two seconds.

    Parameters
    ----------
    actuator : Actuator
        Simulated or real; it is opened once.
    **options
        As of `measure_bode`, which gives what a Bode plot needs, too: voltage_limits (V) is needed.

    Returns
    -------
    Dynamics
        With standard deviations.

    Raises
    ------
    DynamicsError
        The stage shows no resonance or too little coherence, went too far, or the fit is bad: says what to do.
    SettingError
        An option is out of bounds.

    Examples
    --------
    >>> from truestroke.plant import PlantSettings, RealisticPlant
    >>> stage = RealisticPlant(PlantSettings(sample_rate=5000.0, resonance=700.0, damping=0.02))
    >>> found = measure_dynamics(stage, voltage_limits=(-0.6, 3.6))
    >>> print(f"{found.modes[0].frequency:.0f} Hz, damping {found.modes[0].damping:.3f}")
    700 Hz, damping 0.020
    """
    found = measure_bode(actuator, **options)
    if found.verdict.is_bad:
        raise DynamicsError(" ".join(found.verdict.reasons))
    return found.dynamics


def measure_bode(
    actuator: Driven,
    *,
    voltage_limits: tuple[float, float],
    safe_voltage: float = 0.0,
    bias: float | None = None,
    amplitude: float | None = None,
    band: tuple[float, float] | None = None,
    duration: float = DURATION,
    slew_limit: float | None = None,
    travel: float | None = None,
    modes: int | None = None,
    sensor_delay: float = 0.0,
    sensor_bandwidth: float = 0.0,
    amplifier_bandwidth: float = 0.0,
    seed: int = 0,
    report: Callable[[str], None] = lambda _: None,
) -> Bode:
    """The frequency response around a bias voltage, and the dynamics fitted to it.

    Parameters
    ----------
    actuator : Actuator
        Simulated or real; it is opened once. The output begins and ends at `safe_voltage`.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage, V.
    safe_voltage : float
        Where the output begins and ends, V.
    bias : float, optional
        Voltage of the measurement, V; by default the middle of the limits.
    amplitude : float, optional
        Peak of the excitation, V; by default 1 to 3 % of the voltage range, by the noise of the sensor.
    band : tuple[float, float], optional
        Frequencies that are excited, Hz; by default from 8 periods in the duration to 0.45 of the sample rate, or to
        8 kHz or 0.3 of the rate, whichever is higher, where that is less.
    duration : float
        Of the excitation, s.
    slew_limit : float, optional
        Fastest change of the voltage, V/s; by default 120 voltage ranges a second.
    travel : float, optional
        How far the stage may go from where it is under the bias voltage, um; by default a quarter of what the whole
        voltage range moves it.
    modes : int, optional
        1 to 3; by default as many as there is evidence of.
    sensor_delay, sensor_bandwidth : float
        Of the sensor, s and Hz, as far as known from its data sheet; the measurement cannot distinguish them from
        those of the stage.
    amplifier_bandwidth : float
        Hz, from its data sheet, where the measurement cannot show it, as of one that is far slower than the resonance;
        0 is not known.
    seed : int
        Of the phases of the excitation.
    report : callable, optional
        Called with what is being done.

    Returns
    -------
    Bode

    Raises
    ------
    DynamicsError
        The stage went further than `travel` (with the frequency of it), the sensor does not answer, or the record has
        no usable resonance. The output is back at the safe voltage.
    SettingError
        An argument is out of bounds.
    """
    checks.able("actuator", actuator, ("open", "exchange"), "an actuator, such as a plant.RealisticPlant")
    low, high = checks.interval("voltage_limits", voltage_limits, "V")
    slew = 120 * (high - low) if slew_limit is None else checks.positive("slew_limit", slew_limit, "V/s")
    safe = checks.within("safe_voltage", safe_voltage, low, high, "V")
    bias = (low + high) / 2 if bias is None else checks.within("bias", bias, low, high, "V")
    checks.within("duration", duration, 0.2, 60.0, "s")
    if modes is not None:
        checks.count("modes", modes, 1, 3)
    timing = checks.instance("actuator.open()", actuator.open(), Timing, "a Timing(sample_rate=...)")
    checks.count("channels of the actuator", timing.channels, 1, 1)
    band = _band(band, timing.sample_rate, duration)
    _refuse_before(
        timing, (low, high), bias, slew, amplitude, travel, sensor_delay, sensor_bandwidth, amplifier_bandwidth
    )
    line = _Line(actuator, timing, slew, safe)
    with line:
        report("bias")
        noise, gain = line.approach(bias, low, high)
        peak = _peak(noise, gain, (low, high), bias) if amplitude is None else amplitude
        ticks = round(duration * timing.sample_rate)
        waves = [multisine(timing.sample_rate, ticks, band, corner, peak, seed) for corner in CORNERS]
        wave = _within_slew(waves, timing.sample_rate, slew, amplitude)
        wanted = fastest(waves[-1].volts, timing.sample_rate) / SPARE
        report("excitation")
        reach = TRAVEL * abs(gain) * (high - low) if travel is None else travel
        z = line.excite(wave, bias, reach, given=travel is not None)
    report("fitting")
    record = SmallMotion(
        sample_rate=timing.sample_rate, excitation=wave, z=z, bias=bias, noise=noise, gain=gain,
        latency=timing.latency + timing.block - 1, slew_limit=slew, wanted_slew=wanted,
        travel=math.inf if travel is None else travel,
    )  # fmt: skip
    return identify_dynamics(
        record, modes=modes, sensor_delay=sensor_delay, sensor_bandwidth=sensor_bandwidth,
        amplifier_bandwidth=amplifier_bandwidth,
    )  # fmt: skip


def _band(band: tuple[float, float] | None, rate: float, duration: float) -> tuple[float, float]:
    if band is None:
        return PERIODS / duration, min(SEEN * rate, max(HIGHEST[0], HIGHEST[1] * rate))
    low, high = checks.interval("band", band, "Hz")
    if low < 2 / duration or high > SEEN * rate:
        bound = f"within {2 / duration:g} Hz, two periods in {duration:g} s, and {SEEN * rate:g} Hz, {SEEN} of the rate"
        raise SettingError("band", band, bound, "Hz")
    return low, high


def _refuse_before(
    timing: Timing, limits: tuple[float, float], bias: float, slew: float, amplitude: float | None,
    travel: float | None, sensor_delay: float, sensor_bandwidth: float, amplifier_bandwidth: float,
) -> None:  # fmt: skip
    """SettingError for what would else be refused after the stage has moved."""
    low, high = limits
    spare, least = min(bias - low, high - bias), LEVELS[0] * (high - low)
    if amplitude is not None and checks.positive("amplitude", amplitude, "V") > spare:
        raise SettingError("amplitude", amplitude, f"up to {spare:g} V, from the bias of {bias:g} V to the limits", "V")
    if amplitude is None and spare < least:
        raise SettingError("bias", bias, f"at least {least:.3g} V from the voltage limits", "V")
    if travel is not None:
        checks.positive("travel", travel, "um")
    fading = 2 * math.pi * min(spare, FADING * (high - low)) * FADING_CYCLES / 0.5
    slowest = (4 * max(abs(low), abs(high), high - low) + fading) / LONGEST
    if slew < slowest:
        raise SettingError(
            "slew_limit", slew, f"at least {figures(slowest)} V/s, else it takes over {LONGEST:g} s", "V/s"
        )
    Dynamics(
        sample_rate=timing.sample_rate, modes=(Mode(frequency=0.1 * timing.sample_rate, damping=0.1),),
        sensor_delay=sensor_delay, sensor_bandwidth=sensor_bandwidth, amplifier_bandwidth=amplifier_bandwidth,
    )  # fmt: skip


def _peak(noise: float, gain: float, limits: tuple[float, float], bias: float) -> float:
    """Of the excitation, V, by the noise."""
    low, high = limits
    least, most = (part * (high - low) for part in LEVELS)
    return min(float(np.clip(LOUD * noise / abs(gain), least, most)), bias - low, high - bias)


def _within_slew(waves: list[Multisine], rate: float, slew: float, amplitude: float | None) -> Multisine:
    """The first excitation within the slew limit; a smaller one if none is, and nobody asked for an amplitude."""
    for wave in waves:
        needed = fastest(wave.volts, rate)
        if needed <= SPARE * slew:
            return wave
    if amplitude is not None:
        most = amplitude * SPARE * slew / needed
        bound = f"up to {most:.3g} V: {figures(needed, 4)} V/s are needed, the slew limit is {slew:g} V/s"
        raise SettingError("amplitude", amplitude, f"{bound}; or a lower `band`", "V")
    return Multisine(wave.volts * (SPARE * slew / needed), wave.lines, wave.frequency)


class _Line:
    """An actuator that is open: voltages out, displacements back, from the safe voltage and to it again."""

    def __init__(self, actuator: Driven, timing: Timing, slew: float, safe: float) -> None:
        self.actuator, self.timing, self.slew, self.safe, self.last = actuator, timing, slew, safe, safe

    def __enter__(self) -> _Line:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: object) -> None:
        """Slowly back to the safe voltage, unless it is the actuator that has failed."""
        if kind is None or issubclass(kind, (DynamicsError, SettingError, KeyboardInterrupt)):
            self.put(self.ramp(self.safe))

    def ramp(self, target: float) -> FloatArray:
        """From the last voltage to another, smooth at both ends, V."""
        way = target - self.last
        ticks = math.ceil(max(RAMP, 2 * abs(way) / self.slew) * self.timing.sample_rate)
        part = np.arange(1, ticks + 1) / ticks
        return np.asarray(self.last + way * (part - np.sin(2 * np.pi * part) / (2 * np.pi)))

    def fading(self, bias: float, swing: float) -> FloatArray:
        """A slow oscillation about the bias that fades, V: small loops of hysteresis behind it are symmetric."""
        frequency = min(FADING_FREQUENCY, 0.5 * self.slew / (2 * np.pi * swing)) if swing else FADING_FREQUENCY
        t = np.arange(1, round(FADING_CYCLES / frequency * self.timing.sample_rate) + 1) / self.timing.sample_rate
        part = frequency * t / FADING_CYCLES
        return np.asarray(
            bias + swing * np.minimum(1.0, 4 * part) * (1 - part) ** 2 * np.sin(2 * np.pi * frequency * t)
        )

    def put(self, volts: FloatArray, within: tuple[float, float] | None = None, further: str = "") -> FloatArray:
        """Put `volts` out; the displacement of each, um, which comes after the latency: the last is held for it.

        `further` is what else helps where it is not `within`.
        """
        block, late = self.timing.block, self.timing.latency
        all_of_it = np.append(volts, np.full(late, volts[-1]))
        z = np.empty(all_of_it.size)
        beyond, lost = 0, 0
        for k in range(0, all_of_it.size, block):
            part = all_of_it[k : k + block]
            z[k : k + block] = self.actuator.exchange(part)
            self.last = float(part[-1])
            for value in z[k : k + block].tolist() if within else ():
                lost = lost + 1 if math.isnan(value) else 0
                beyond = beyond + 1 if within and not within[0] <= value <= within[1] and not lost else 0
            if beyond >= SPIKES and within:
                self.too_far(z[: k + block], within, further)
            if lost > GAP * self.timing.sample_rate:
                at = f"{k / self.timing.sample_rate:.3f} s"
                raise DynamicsError(
                    f"no sample for {1e3 * GAP:g} ms, {at} after the excitation began: look at the sensor"
                )
        return z[late:]

    def too_far(self, z: FloatArray, within: tuple[float, float], further: str) -> None:
        """DynamicsError, with the frequency of the motion."""
        rate = self.timing.sample_rate
        recent = np.nan_to_num(z[-round(0.5 * rate) :] - np.nanmean(z))
        power = np.abs(np.fft.rfft(recent * np.hanning(recent.size), 4 * recent.size))
        frequency = float(np.argmax(power) * rate / (4 * recent.size))
        raise DynamicsError(
            f"the stage went to {z[-1]:.4g} um, further than `travel` allows, {within[0]:.4g} to {within[1]:.4g} um, "
            f"mostly at {frequency:.4g} Hz, {z.size / rate:.2g} s after the begin: use a smaller `amplitude` (V), or a "
            f"`band` without that frequency{further}"
        )

    def approach(self, bias: float, low: float, high: float) -> tuple[float, float]:
        """To the bias voltage; noise of a sample there, um, and gain on the way, um/V."""
        span, rate = high - low, self.timing.sample_rate
        way = bias - self.last
        z = self.put(self.ramp(bias))
        fading = self.fading(bias, min(bias - low, high - bias, FADING * span))
        faded = self.put(fading)
        still = self.put(np.full(round(HOLD * rate), bias))
        if not np.isfinite(still).mean() > 0.9 or not np.isfinite(z).any():
            raise DynamicsError("most samples are lost at the bias voltage: look at the sensor and its cable")
        noise = float(np.nanstd(np.diff(still, 2)) / math.sqrt(6.0))
        if abs(way) >= STEP * span:
            moved = float(np.nanmean(still) - np.nanmean(z[: max(round(0.05 * z.size), 1)]))
        else:  # a small way shows hysteresis above all: what fades is larger
            way, seen = float(np.ptp(fading)), np.isfinite(faded)
            moved = way * float(np.polyfit(fading[seen], faded[seen], 1)[0])
        if abs(moved) <= 5 * noise + ROUNDING * abs(float(np.nanmean(still))):  # of a constant
            raise DynamicsError(
                f"{abs(way):.3g} V move the stage by {abs(moved):.2g} um, its noise is {noise:.2g} um: "
                "look at amplifier, cables and channels"
            )
        self.rest = float(np.nanmean(still))
        return noise, moved / way

    def excite(self, wave: Multisine, bias: float, travel: float, given: bool) -> FloatArray:
        """The multisine around the bias, after a part of it that leads in; displacement of its period, um.

        A travel that somebody has `given` may be larger, that of the measurement itself is as large as is safe.
        """
        ahead = min(round(LEAD * self.timing.sample_rate), wave.volts.size)
        lead = wave.volts[-ahead:] * np.minimum(1.0, np.arange(1, ahead + 1) / (0.5 * ahead))
        volts = bias + np.concatenate([lead, wave.volts])
        further = ", or, where the stage may go so far, a larger `travel`" if given else ""
        return self.put(volts, (self.rest - travel, self.rest + travel), further)[ahead:]
