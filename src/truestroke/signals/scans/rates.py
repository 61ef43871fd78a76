"""Rates of lines and turns whose harmonics keep away from the resonances of the stage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import figures
from truestroke.base.typing import FloatArray
from truestroke.model.dynamics import Mode
from truestroke.signals.scans.scan import Scan

REACH = 0.06  # of the rate: how far another one may be
CLOSE = 0.2  # of the distance between two harmonics: one that near meets the resonance
HIGHEST = 30  # harmonic: what hysteresis makes of a raster falls with its number
BETTER = 0.1  # of that distance: what is worth another rate
RINGS = 1.25  # periods: time constant of a resonance from which on what rings looks like what repeats
WHOLE = 1e-6  # ticks that a period may be from a whole number of them
MOST = 0.5  # of what is above the goal: less of it is not why


def quiet_rate(rate: float, resonances: Iterable[float], sample_rate: float, *, reach: float = REACH) -> float:
    """The rate near another one whose harmonics are furthest from the resonances of the axes.

    Parameters
    ----------
    rate : float
        Rows, lines or turns per second, Hz.
    resonances : iterable of float
        First resonance of each axis, Hz, such as ``dynamics.modes[0].frequency``.
    sample_rate : float
        Ticks per second, Hz: a period is a whole number of them.
    reach : float
        How much slower or faster it may be, as a part of the rate, above 0 and below 1.

    Returns
    -------
    float
        Hz.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit; no period within reach is a whole number of ticks.

    Examples
    --------
    >>> found = quiet_rate(100.0, [900.0, 700.0], 5000.0)
    >>> print(f"{found:.2f} Hz: resonances at {900 / found:.2f} and {700 / found:.2f} times the rate")
    94.34 Hz: resonances at 9.54 and 7.42 times the rate
    """
    rate, ticks = checks.positive("rate", rate, "Hz"), checks.positive("sample_rate", sample_rate, "Hz")
    if isinstance(resonances, Mapping | str):
        raise SettingError("resonances", checks.described(resonances), "a sequence of numbers, without names", "Hz")
    modes = [checks.positive("resonances", one, "Hz") for one in checks.several("resonances", resonances, "Hz")]
    if not modes:
        raise SettingError("resonances", (), "at least one number", "Hz")
    reach = checks.within("reach", reach, 1e-6, 0.999, "of the rate")
    periods = range(math.ceil(ticks / rate / (1 + reach)), math.floor(ticks / rate / (1 - reach)) + 1)
    if not periods:
        raise SettingError("rate", rate, f"within {reach:g} of one whose period is a whole number of ticks", "Hz")
    return max((ticks / n for n in periods), key=lambda one: (_apart(one, modes), -abs(one - rate)))


def advice(scan: Scan, resonances: Mapping[str, float]) -> str:
    """A sentence where a harmonic of the lines meets the resonance of an axis, Hz, and another rate has none there.

    Raises
    ------
    SettingError
        `resonances` is no mapping of frequencies above 0.

    Examples
    --------
    >>> from truestroke.signals.scans.motions import raster
    >>> scan = raster(lines=4, rate=100.0, sample_rate=5000.0)
    >>> advice(scan, {"x": 950.0, "y": 700.0})
    'At 100 rows a second harmonic 7 meets the resonance of y, 700 Hz, which may be why: at 102.0408163 rows a second, \
a period of 0.0098 s, no harmonic up to 30 is within 14 Hz of a resonance.'
    >>> advice(scan, {"x": 950.0, "y": 750.0})
    ''
    """
    given = _checked(resonances)
    rate, known = _of_lines(scan), _within(scan, given)
    if not known:
        return ""
    words = {"raster": "rows", "spiral": "turns"}.get(scan.name, "lines")
    met = _met(rate, known)
    other = quiet_rate(rate, known.values(), scan.sample_rate)
    away = _apart(other, [one for one in given.values() if one / other <= HIGHEST + 0.5])  # 0.5 where all are beyond
    if not met or away < _apart(rate, known.values()) + BETTER:
        return ""
    each = [f"harmonic {round(one / rate)} meets the resonance of {name}, {one:.4g} Hz" for name, one in met.items()]
    return (
        f"At {rate:.5g} {words} a second {', and '.join(each)}, which may be why: at {other:.10g} {words} a second, a "
        f"period of {1 / other:.10g} s, no harmonic up to {HIGHEST} is within {_at_most(away * other)} "
        "Hz of a resonance."
    )


def _at_most(value: float) -> str:
    """Two digits of a number above 0, rounded down.

    >>> _at_most(0.98), _at_most(14.9), _at_most(0.04567)
    ('0.98', '14', '0.045')
    """
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return figures(math.floor(value / step * (1 + 1e-9)) * step, 2)


def ticks_of_lines(scan: Scan) -> int:
    """Ticks after which the lines repeat; 0 where they do not, or not after whole ticks.

    >>> from truestroke.signals.scans.motions import raster, spiral
    >>> ticks_of_lines(raster(lines=4, rate=40.0, sample_rate=5000.0)), ticks_of_lines(spiral(sample_rate=5000.0))
    (125, 0)
    """
    period = scan.settings.get("period")
    ticks = period * scan.sample_rate if isinstance(period, float) else 0.0
    return round(ticks) if abs(ticks - round(ticks)) < WHOLE else 0


def ringing(rate: float, modes: Mapping[str, Mode]) -> str:
    """A sentence where what rings in an axis lasts for more than a row of a raster; it can be said beforehand.

    One period is then like the next by chance, too, and what is learned of each is late and has noise in it. A mode of
    f0 and zeta decays by a factor of e in 1 / (2 pi f0 zeta).

    Parameters
    ----------
    rate : float
        Rows per second, Hz.
    modes : Mapping[str, Mode]
        First mode of each axis that is known, by its name.

    Examples
    --------
    >>> ringing(100.0, {"x": Mode(frequency=900.0, damping=0.01), "y": Mode(frequency=600.0, damping=0.004)})
    'What rings in y, 600 Hz with a damping of 0.004, takes 66 ms to decay, 6.6 rows of 100 a second: pixels may be \
some tenths from their places. Up to 18.8 rows a second leave it time.'
    >>> ringing(100.0, {"y": Mode(frequency=600.0, damping=0.03)})
    ''
    """
    slowest = min(modes.items(), key=lambda one: one[1].frequency * one[1].damping, default=None)
    if slowest is None:
        return ""
    name, mode = slowest
    decay = 1 / (2 * math.pi * mode.frequency * mode.damping)
    if rate * decay <= RINGS:
        return ""
    return (
        f"What rings in {name}, {mode.frequency:.4g} Hz with a damping of {mode.damping:.2g}, takes "
        f"{1e3 * decay:.2g} ms to decay, {figures(rate * decay, 2)} rows of {rate:.5g} a second: pixels may be some "
        f"tenths from their places. Up to {figures(RINGS / decay)} rows a second leave it time."
    )


def at_resonances(scan: Scan, error: FloatArray, resonances: Mapping[str, float]) -> FloatArray:
    """The part of an error at those harmonics of the lines that meet a resonance, Hz: what another rate may avoid.

    Parameters
    ----------
    scan : Scan
        What was followed.
    error : ndarray, shape (ticks, axes)
        In each tick of it, turns and lead-in included, um.
    resonances : Mapping[str, float]
        As of `advice`.

    Returns
    -------
    ndarray, shape (ticks, axes)
        What is less than half a harmonic from such a resonance, um.

    Examples
    --------
    >>> from truestroke.signals.scans.motions import raster
    >>> scan = raster(lines=4, rate=100.0, sample_rate=5000.0)
    >>> rings = np.sin(2 * np.pi * 700.0 * scan.time)[:, None]
    >>> [round(float(np.std(at_resonances(scan, one, {"y": 700.0}))), 1) for one in (5.0 + rings, 5.0 + 0.0 * rings)]
    [0.7, 0.0]
    """
    from scipy.signal import butter, sosfiltfilt

    rate, half = _of_lines(scan), scan.sample_rate / 2
    part = np.zeros_like(error)
    for one in _met(rate, _within(scan, _checked(resonances))).values():
        band = max(one - rate / 2, rate / 4), min(one + rate / 2, 0.99 * half)
        if band[0] < band[1]:
            part += sosfiltfilt(butter(2, band, "bandpass", fs=scan.sample_rate, output="sos"), error - part, axis=0)
    return part


def is_why(measured: float, without: float, goal: float) -> bool:
    """Whether a part of the error, without which it is so large, makes most of what is above the goal.

    >>> is_why(0.4, 0.1, 0.1), is_why(5.0, 4.9, 0.1)
    (True, False)
    """
    return measured > goal and measured - without > MOST * (measured - goal)


def _checked(resonances: Mapping[str, float]) -> dict[str, float]:
    checks.instance("resonances", resonances, Mapping, 'frequencies by the names of axes, as {"x": 900.0}')
    return {name: checks.positive(f"resonances[{name!r}]", one, "Hz") for name, one in resonances.items()}


def _of_lines(scan: Scan) -> float:
    """Lines or turns per second, Hz; 0 of a spiral of constant linear velocity, whose turns have no one rate."""
    rate = scan.settings.get("rate", scan.settings.get("rotation"))
    return rate if isinstance(rate, float) and scan.settings.get("velocity") != "linear" else 0.0


def _within(scan: Scan, resonances: Mapping[str, float]) -> dict[str, float]:
    """Those that a harmonic of the lines may excite, Hz."""
    rate = _of_lines(scan)
    return {name: one for name, one in resonances.items() if rate and 0.5 < one / rate <= HIGHEST}


def _met(rate: float, known: Mapping[str, float]) -> dict[str, float]:
    """Those that a harmonic of a rate meets, Hz."""
    return {name: one for name, one in known.items() if _apart(rate, [one]) <= CLOSE}


def _apart(rate: float, resonances: Iterable[float]) -> float:
    """Distance of the resonance that is nearest to a harmonic, of the distance between two harmonics: at most half."""
    return min((abs(one / rate - round(one / rate)) for one in resonances), default=0.5)
