"""The recorded run of a self-test: a controller in the loop with a small actuator, in the controller's number type."""

from __future__ import annotations

import math

import numpy as np

from truestroke import _kernel, _kernel32
from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.control.controller import AdaptiveController
from truestroke.control.repeating.repetition import RepetitionSettings, begun, derivatives
from truestroke.control.settings import ControllerSettings, kernel_settings

PERIODS = 12.0  # of the slower of two sines, in the run
PLAY = 0.1  # half width of the hysteresis, of the voltage range
SHARE = 0.3  # of the stroke: peak of the slower sine


def recorded(
    settings: ControllerSettings,
    rest: float,
    ticks: int,
    zero: float = 0.0,
    repetition: RepetitionSettings | None = None,
) -> FloatArray:
    """z_d, zdot_d, zddot_d (um, um/s, um/s^2), volts and measurement (um) of each tick; shape (ticks, 5).

    It starts at 0 um under `rest`, V, where the sensor reads `zero`, um. The actuator has one play and a pole: enough
    that every part of the law has something to learn. All values are numbers of the kernel's type. With a repetition it
    is the learned motion, for twelve periods at least: a correction joins, the motion stops, and it leaves.
    """
    controller = AdaptiveController.from_settings(settings)
    real = np.float64 if settings.precision == "double" else np.float32
    low, high = settings.voltage_limits
    gain, width = settings.stroke / (high - low), PLAY * (high - low)
    play = z = 0.0
    if repetition is None:
        motion = _motion(settings, ticks, gain * (low - rest), gain * (high - rest))
    else:
        motion = _repeated(settings, ticks, repetition)
    motion = real(motion).astype(float)
    controller.start(min(max(float(real(rest)), low), high), 0.0)  # a limit may be beyond itself, rounded
    added = None if repetition is None else _Added(settings, repetition)
    if added is not None:
        controller.hold()
    rows = np.empty((len(motion), 5))
    for row, (z_d, zdot_d, zddot_d) in zip(rows, motion, strict=True):
        volts = controller.command(z_d, zdot_d, zddot_d)
        volts = volts if added is None else added.volts(z_d, volts)
        play = max(volts - rest - width, min(volts - rest + width, play))
        z += 0.7 * (gain * (0.8 * (volts - rest) + 0.2 * play) - z)
        measured = real(z + zero)
        row[:] = z_d, zdot_d, zddot_d, volts, measured
        from_zero = measured - real(zero)
        rests = added is not None and added.rests(float(from_zero - real(z_d)))
        controller.adapt(math.nan if rests else float(from_zero))
    return rows


class _Added:
    """What a repetition adds to a controller, as adaptive.c does."""

    def __init__(self, settings: ControllerSettings, repetition: RepetitionSettings) -> None:
        kernel = _kernel if settings.precision == "double" else _kernel32
        assert repetition.learned is not None
        self._gain, self._repetition = repetition.learned.gain, kernel.Repetition(repetition.members())
        self._limits = *settings.voltage_limits, kernel_settings(settings)["slew"]

    def volts(self, z_d: float, inside: float) -> float:
        """The voltage of a tick, V."""
        self._repetition.tick(z_d)
        volts: float = self._repetition.volts(inside, *self._limits)
        return volts

    def rests(self, error: float) -> bool:
        """Whether the controller rests, after an error, um."""
        self._repetition.see(error, self._gain if self._repetition.joined else 0.0)
        return bool(self._repetition.corrects)


def safe_volts(settings: ControllerSettings, given: float | None) -> float:
    """The safe voltage that is given, V, or 0 V, or the limit that is nearest to it."""
    low, high = settings.voltage_limits
    return min(max(0.0, low), high) if given is None else checks.within("safe_voltage", given, low, high, "V")


def _repeated(settings: ControllerSettings, ticks: int, repetition: RepetitionSettings) -> FloatArray:
    """The learned motion, which begins softly at 0 um in two periods and stops after ten; shape (ticks, 3)."""
    assert repetition.learned is not None
    ticks, last = max(ticks, 12 * repetition.size), 10 * repetition.size
    z_d = begun(repetition.learned.shape.wave, ticks)[np.minimum(np.arange(ticks), last)]
    return np.stack([z_d, *derivatives(z_d, settings.sample_rate)], axis=1)


def _motion(settings: ControllerSettings, ticks: int, lowest: float, highest: float) -> FloatArray:
    """Two sines about the middle of the reach, which begin softly at 0 um; shape (ticks, 3)."""
    t = np.arange(ticks) / settings.sample_rate
    duration = ticks / settings.sample_rate
    middle, peak = (lowest + highest) / 2, SHARE * (highest - lowest)
    rise = np.minimum(t / (duration / 4), 1.0)
    w = 2 * math.pi * PERIODS / duration
    wave = rise**3 * (10 - 15 * rise + 6 * rise**2) * (middle + peak * np.sin(w * t) + peak / 4 * np.sin(2.7 * w * t))
    rate = np.gradient(wave, t)
    return np.stack([wave, rate, np.gradient(rate, t)], axis=1)
