"""Loop-back: the output wired to the input; what is late then is the electronics, and no actuator moves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.runtime.commissioning.procedure import LOST, AnswerError
from truestroke.runtime.drivers.one_axis import OneAxis

STEP = 0.05  # of the voltage range: the excitation, to that side of the safe voltage where there is more of it
TICKS = 4000  # of the excitation
LEVELS = 1, 12  # ticks that a level is held, at least and at most
SLOW = 8, 200  # parts of the way up and down, and ticks of each: what shows hysteresis
WIRE = 0.005  # of the excitation: hysteresis, and what a lag and a delay do not explain
SEEN = 30.0  # times the noise: an answer to the excitation
LATEST = 20.0  # ticks of delay that are looked for
SURE = 3.0  # standard deviations: a lag below is none
TAIL = 60  # ticks at the beginning that are not used
RATIO = 0.02, 5.0  # of the voltages at input and output: those of a wire, a divider, a monitor of an amplifier


@dataclass(frozen=True)
class LoopBack:
    """Delay and lag of the electronics, from the command to the measurement, beyond the latency that the driver states.

    Attributes
    ----------
    sample_rate : float
        Hz.
    delay, delay_uncertainty : float
        Dead time, s, beyond the hold of a command and the mean of a measurement over its tick, and its deviation.
    bandwidth, bandwidth_uncertainty : float
        Corner of a first-order lag, Hz, and its deviation; both 0 where none is seen.
    gain : float
        What the sensor's input shows for a volt, um/V.
    hysteresis : float
        Largest distance of the ways up and down, of the excitation.
    """

    sample_rate: float
    delay: float
    delay_uncertainty: float
    bandwidth: float
    bandwidth_uncertainty: float
    gain: float
    hysteresis: float

    @property
    def settings(self) -> dict[str, float]:
        """Those of a controller: sensor_delay, s, and sensor_bandwidth, Hz, where there is a lag."""
        found = {"sensor_delay": float(f"{max(self.delay, 0.0):.4g}")}
        return found | ({"sensor_bandwidth": float(f"{self.bandwidth:.4g}")} if self.bandwidth else {})

    def rows(self) -> list[list[str]]:
        """Quantity, value, remark."""
        lag = [f"{self.bandwidth:.4g} ± {figures(self.bandwidth_uncertainty, 2)} Hz", "corner of a first-order lag"]
        none = ["none is seen", f"up to {self.sample_rate / 2:g} Hz"]
        ticks = f"{self.delay * self.sample_rate:.3f} ticks beyond the latency of the driver"
        return [
            ["gain", f"{self.gain:.4g} um/V", f"hysteresis {100 * self.hysteresis:.2g} %: a wire"],
            ["delay", f"{1e6 * self.delay:.4g} ± {figures(1e6 * self.delay_uncertainty, 2)} us", ticks],
            ["bandwidth", *(lag if self.bandwidth else none)],
        ]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "sensor_delay_s": self.delay,
            "sensor_delay_uncertainty_s": self.delay_uncertainty,
            "sensor_bandwidth_Hz": self.bandwidth,
            "sensor_bandwidth_uncertainty_Hz": self.bandwidth_uncertainty,
            "gain_um_per_V": self.gain,
            "hysteresis": self.hysteresis,
            "settings": self.settings,
        }


def loop_back(axis: OneAxis, report: Callable[[str], None] = lambda _: None) -> LoopBack:
    """Measure delay and lag of an axis whose output is wired to its input, by small random steps.

    Parameters
    ----------
    axis : OneAxis
        Closed; it is closed again behind, at the safe voltage, whatever happens.
    report : callable, optional
        Called with what is being done.

    Raises
    ------
    AnswerError
        The input does not show the output, or not as a wire does: hysteresis, a resonance, creep.
    DriverError, SettingError
        As `OneAxis`.

    Examples
    --------
    >>> from truestroke.runtime.drivers import SimulatedDriver
    >>> try:
    ...     loop_back(OneAxis(SimulatedDriver(), voltage_limits=(-0.6, 3.6), slew=400.0))
    ... except AnswerError as error:
    ...     print(str(error)[:20])
    this is no loop-back
    """
    with axis:
        timing = axis.open()
        low, high = axis.voltage_limits
        height = min(STEP * (high - low), axis.slew / timing.sample_rate) * (1 if high > axis.safe_voltage else -1)
        report("hysteresis")
        way = axis.safe_voltage + height * _way()
        slowly = axis.apply(way)
        report("delay and lag")
        volts = axis.safe_voltage + height * _levels()
        z = axis.apply(volts)
    gain, noise = _seen(slowly, height)
    _check_ratio(gain, getattr(getattr(axis.driver, "settings", None), "um_per_volt", None))
    hysteresis = _hysteresis(slowly, abs(gain * height), noise)
    delay, lag = _fitted(volts - axis.safe_voltage, z, noise * math.sqrt(SLOW[1] / 2))
    rate = timing.sample_rate
    corner = rate / (2 * math.pi * lag[0]) if lag[0] else 0.0
    return LoopBack(
        sample_rate=rate,
        delay=delay[0] / rate,
        delay_uncertainty=delay[1] / rate,
        bandwidth=corner,
        bandwidth_uncertainty=corner * lag[1] / lag[0] if lag[0] else 0.0,
        gain=gain,
        hysteresis=hysteresis,
    )


def _way() -> FloatArray:
    """Slowly up and down, from 0 to 1."""
    parts, ticks = SLOW
    return np.repeat(1 - np.abs(np.arange(2 * parts + 1) / parts - 1), ticks)


def _levels() -> FloatArray:
    """Levels of 0 or 1 that are held for a random time: the same at each call."""
    random = np.random.default_rng(0)
    holds = random.integers(LEVELS[0], LEVELS[1] + 1, TICKS)
    levels = np.repeat(np.arange(TICKS) % 2, holds)[:TICKS].astype(np.float64)
    levels[: 2 * TAIL] = 0.0
    return levels


def _seen(z: FloatArray, height: float) -> tuple[float, float]:
    """Gain, um/V, and noise of a mean, um; AnswerError where nothing answers."""
    if np.isfinite(z).mean() < 1 - LOST:
        raise AnswerError(f"{100 * np.isnan(z).mean():.0f} % of the samples are lost: look at the driver")
    means, deviation = _means(z)
    noise = float(np.nanmedian(deviation)) / math.sqrt(SLOW[1] / 2)
    gain = float((means[SLOW[0]] - means[0]) / height)
    if not abs(gain * height) > SEEN * noise:
        raise AnswerError(
            f"the input does not show the output: {gain * height:.3g} um for {height:.3g} V, noise {noise:.2g} um; "
            "look at the wire and the channels in [driver]"
        )
    return gain, noise


def _check_ratio(gain: float, scale: Any) -> None:
    """AnswerError where the driver states how many um a volt at its input is, and the two voltages are far apart."""
    if scale is None:
        return
    ratio = abs(gain / float(np.ravel(scale)[0]))
    if not RATIO[0] < ratio < RATIO[1]:
        raise AnswerError(
            f"this is no loop-back: the input has {ratio:.3g} V for a volt at the output, a wire or divider "
            f"{RATIO[0]:g} to {RATIO[1]:g}; look at um_per_volt and the wire"
        )


def _means(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and deviation of the second half of each part of the slow way, um."""
    part = z.reshape(-1, SLOW[1])[:, SLOW[1] // 2 :]
    return np.nanmean(part, axis=1), np.nanstd(part, axis=1)


def _hysteresis(z: FloatArray, height: float, noise: float) -> float:
    """Largest distance of the ways up and down over the height; AnswerError where it is none of a wire."""
    means, _ = _means(z)
    found = float(np.max(np.abs(means - means[::-1]))) / height
    if found > WIRE + 6 * noise / height:
        raise _no_wire(f"{100 * found:.2g} % of hysteresis or creep between the ways up and down")
    return found


def _no_wire(seen: str) -> AnswerError:
    return AnswerError(
        f"this is no loop-back: {seen}, where a wire has less than {100 * WIRE:g} %; is an actuator connected? Wire "
        "the output to the input, through a divider if the input needs one, or take the monitor of the amplifier"
    )


def unit(ticks: int, delay: float, lag: float) -> FloatArray:
    """Means over each tick of the answer to a step at tick 0, behind `delay` and a lag, both in ticks.

    >>> unit(4, 0.5, 0.0).tolist()
    [0.5, 1.0, 1.0, 1.0]
    """
    t = np.maximum(np.arange(ticks + 1) - delay, 0.0)
    integral = t + lag * np.expm1(-t / lag) if lag > 0 else t
    return np.diff(integral)


def _fitted(volts: FloatArray, z: FloatArray, noise: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Delay and lag by least squares, ticks, each with its deviation; the lag is 0 where none is seen."""
    from scipy.optimize import least_squares
    from scipy.signal import fftconvolve

    used = np.isfinite(z)
    used[:TAIL] = False
    steps = np.diff(volts, prepend=volts[:1])
    t = np.linspace(-1.0, 1.0, z.size)

    def residual(p: FloatArray) -> FloatArray:
        # ticks may be negative by one: a sample at the end of its tick is early
        answer = fftconvolve(steps, unit(steps.size + 1, p[0] + 1.0, max(p[1], 0.0) if p.size > 1 else 0.0))
        terms = np.column_stack([answer[1 : steps.size + 1], np.ones_like(t), t])[used]
        return np.asarray(z[used] - terms @ np.linalg.lstsq(terms, z[used], rcond=None)[0])

    start = min(np.arange(-0.5, LATEST, 1.0), key=lambda d: float(np.sum(residual(np.array([d])) ** 2)))
    both = least_squares(residual, [start - 0.3, 0.3], bounds=([-1.0, 1e-4], [LATEST, 50.0]), diff_step=1e-4)
    alone = least_squares(residual, [start], bounds=([-1.0], [LATEST]), diff_step=1e-4)
    deviations = _deviations(both.jac, both.fun)
    lagged = both.x[1] > SURE * deviations[1] and both.cost < 0.99 * alone.cost
    fit = both if lagged else alone
    spread = _deviations(fit.jac, fit.fun)
    rms = float(np.sqrt(np.mean(fit.fun**2)))
    left = math.sqrt(max(rms**2 - noise**2, 0.0)) / float(np.std(z[used]))
    if left > 2 * WIRE and rms > 1.2 * noise:
        raise _no_wire(f"{100 * left:.2g} % of the answer are explained by no delay and lag")
    found = list(zip(fit.x.tolist(), spread.tolist(), strict=True))
    return found[0], found[1] if lagged else (0.0, 0.0)


def _deviations(jacobian: FloatArray, residual: FloatArray) -> FloatArray:
    """Of the numbers of a fit."""
    variance = float(residual @ residual) / max(residual.size - jacobian.shape[1], 1)
    return np.asarray(np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * variance))
