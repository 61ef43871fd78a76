"""The voltage of a scan without the noise of the monitor that recorded it.

Lines are alike: what their mean does not have is noise. Where they are not, and before them, it is smoothed.
"""

from __future__ import annotations

import math

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.identification.unwarp_evidence import FEW, period_of, uneven
from truestroke.signals import quiet
from truestroke.signals.noise import converter_step, noise

REVERSAL = 5e-3  # of the range of a voltage: smaller ones are no motion of a scan,
NOISES = 8.0  # nor are those of so many times its noise
FEWEST = 8, 16  # lines, and samples of a period
FAR = 4.0  # deviations: a sample that is further from the lines before and after is an outlier
SPIKE = 5.0  # times what the voltage moves beside it: a single sample that is further off is none of a motion
ALIKE = 1.5  # deviations, rms: lines whose difference is no more are alike
HALF = 0.5  # of a period, which must be there to be compared
CHANGES = 0.5  # of the samples: where so many differ from those before, a converter has rounded a motion
HUM = 0.03  # of the range, rms: lines that differ by more are those of a scan that changes


def quieted(volts: FloatArray, sample_rate: float, span: float, starts: FloatArray) -> tuple[FloatArray, float]:
    """The voltage at the actuator, V, and the deviation of the noise of its monitor, V, as far as it was taken off.

    A slow axis adds up the noise in each state of its hysteresis.

    Parameters
    ----------
    volts : ndarray, shape (samples,)
        As recorded, V.
    sample_rate : float
        Hz
    span : float
        Range of the voltage of the model, V.
    starts : ndarray, shape (lines,)
        Of lines of one direction, s.

    Examples
    --------
    >>> true = np.abs(np.arange(8000) % 200 - 100.0) / 50.0  # V
    >>> monitor = true + 0.01 * np.random.default_rng(0).standard_normal(8000)
    >>> made, deviation = quieted(monitor, 2000.0, 3.0, np.arange(40) / 10.0)
    >>> round(deviation, 3), round(float(np.std(made - true)), 4)
    (0.01, 0.0009)
    """
    whole = noise(volts, (slice(0, volts.size),))
    volts = _without_spikes(volts, max(REVERSAL * float(np.ptp(volts)), NOISES * whole))
    deviation = quiet.noise_of(volts, span, whole) or _rounded(volts, span)
    made = quiet.without_noise(volts, deviation)
    mean = _alike(volts, made, starts * sample_rate, deviation or quiet.LEAST * span)
    far = np.abs(volts - mean) > REVERSAL * float(np.ptp(volts))  # of a voltage without noise only outliers change
    made = mean if deviation else np.where(far, mean, made)
    return quiet.without_reversals(made, max(REVERSAL * float(np.ptp(volts)), NOISES * whole)), deviation


def without_hum(volts: FloatArray, sample_rate: float, starts: FloatArray) -> FloatArray:
    """A voltage without noise, V, with the mean of all lines in each, but for a trend; starts of lines are in s.

    Examples
    --------
    >>> true, time = np.abs(np.arange(8000) % 200 - 100.0) / 50.0, np.arange(8000) / 2000.0
    >>> made = without_hum(true + 0.05 * np.sin(2 * np.pi * 51.3 * time), 2000.0, np.arange(40) / 10.0)
    >>> round(float(np.std(made - true)), 3)
    0.001
    """
    return _alike(volts, volts, starts * sample_rate, HUM * float(np.ptp(volts)))


def _without_spikes(volts: FloatArray, least: float) -> FloatArray:
    """The voltage, V, without single samples that are further than `least` from both neighbours, which agree.

    >>> _without_spikes(np.array([0.0, 0.1, 0.2, 2.0, 0.4, 0.5, 0.4, 0.3]), 0.05).round(1).tolist()
    [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.4, 0.3]
    """
    if volts.size < 5:
        return volts
    steps, middle = np.abs(np.diff(volts)), (volts[1:-3] + volts[3:-1]) / 2
    around = np.maximum(np.maximum(steps[:-3], steps[3:]), np.abs(volts[3:-1] - volts[1:-3]) / 2)
    spike = np.abs(volts[2:-2] - middle[: volts.size - 4]) > np.maximum(SPIKE * around[: volts.size - 4], least)
    made = volts.copy()
    made[2:-2][spike] = middle[spike]
    return made


def _rounded(volts: FloatArray, span: float) -> float:
    """Deviation of what a converter has rounded off a motion that goes on from sample to sample, V; else 0."""
    deviation = converter_step(volts) / math.sqrt(12)
    moves = float(np.mean(np.diff(volts) != 0)) > CHANGES
    return deviation if moves and quiet.LEAST * span < deviation < quiet.MOST * span else 0.0


def _alike(volts: FloatArray, smooth: FloatArray, starts: FloatArray, deviation: float) -> FloatArray:
    """`smooth`, V, with mean and trend of all lines in each that is like them; starts of lines are in samples."""
    if starts.size < FEWEST[0] or np.mean(np.abs(uneven(starts)) > 1.0) > FEW:
        return smooth
    period = period_of(starts)
    first = float(np.median(starts - period * np.arange(starts.size)))
    size, number = round(period), np.arange(math.ceil(-first / period), math.ceil((volts.size - first) / period))
    shown = (number >= 0) & (number < starts.size)
    if size < FEWEST[1]:
        return smooth
    turn = number[:, None] + np.arange(size) / size
    rows = np.interp(first + turn * period, np.arange(volts.size), volts, left=np.nan, right=np.nan)
    whole = np.flatnonzero(shown & np.isfinite(rows).all(axis=1))  # the last line may have lost its turn
    if whole.size < FEWEST[0]:
        return smooth
    slope = period_of(np.median(rows[whole] - np.median(rows[whole], axis=0), axis=1))
    rest = rows - slope * turn
    near = np.abs(rest - np.median(rest[whole], axis=0)) <= FAR * deviation
    if not near[whole].any(axis=0).all():
        return smooth
    form = np.nanmean(np.where(near, rest, np.nan)[whole], axis=0)
    off, seen = np.clip(rest - form, -FAR * deviation, FAR * deviation) ** 2, np.isfinite(rest)
    alike = np.sum(off, axis=1, where=seen) <= (ALIKE * deviation) ** 2 * np.sum(seen, axis=1)
    alike &= np.mean(seen, axis=1) > HALF
    if np.mean(alike[shown]) < 1 - FEW:
        return smooth
    tiled = np.tile(form, 3)
    form = quiet.without_noise(tiled, noise(tiled, (slice(0, tiled.size),)))[size : 2 * size]
    turns: FloatArray = np.asarray((np.arange(smooth.size) - first) / period, dtype=np.float64)
    inside = np.isin(np.floor(turns), number[alike])
    made, turns = smooth.copy(), turns[inside]
    made[inside] = slope * turns + np.interp(turns % 1.0, np.arange(size + 1) / size, np.append(form, form[0]))
    return made
