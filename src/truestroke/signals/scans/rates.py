"""Rates of a raster whose harmonics keep away from the resonances of the stage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from truestroke.base import checks
from truestroke.base.checks import SettingError

REACH = 0.06  # of the rate: how far another one may be
CLOSE = 0.2  # of the distance between two harmonics: one that near meets the resonance
HIGHEST = 30  # harmonic: what hysteresis makes of a raster falls with its number
BETTER = 0.1  # of that distance: what is worth another rate


def quiet_rate(rate: float, resonances: Iterable[float], sample_rate: float, *, reach: float = REACH) -> float:
    """The rate near another one whose harmonics are furthest from the resonances of the axes.

    Parameters
    ----------
    rate : float
        Rows per second, Hz.
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
    modes = [checks.positive("resonances", one, "Hz") for one in resonances]
    reach = checks.within("reach", reach, 1e-6, 0.999, "of the rate")
    periods = range(math.ceil(ticks / rate / (1 + reach)), math.floor(ticks / rate / (1 - reach)) + 1)
    if not periods:
        raise SettingError("rate", rate, f"within {reach:g} of one whose period is a whole number of ticks", "Hz")
    return max((ticks / n for n in periods), key=lambda one: (_apart(one, modes), -abs(one - rate)))


def advice(rate: float, resonances: Mapping[str, float], sample_rate: float) -> str:
    """A sentence where a harmonic of this rate meets the resonance of an axis, and another rate has none there, Hz.

    Examples
    --------
    >>> advice(100.0, {"x": 950.0, "y": 700.0}, 5000.0)
    'Harmonic 7 of 100 rows a second, 700 Hz, meets the resonance of y, 700 Hz: 102.0408163 rows a second have \
none within 14 Hz of a resonance.'
    >>> advice(40.0, {"x": 900.0, "y": 700.0}, 5000.0)
    ''
    """
    known = {name: one for name, one in resonances.items() if 0.5 < one / rate <= HIGHEST}
    if not known:
        return ""
    name, met = min(known.items(), key=lambda one: _apart(rate, [one[1]]))
    other = quiet_rate(rate, known.values(), sample_rate)
    away = _apart(other, known.values())
    if _apart(rate, [met]) > CLOSE or away < _apart(rate, known.values()) + BETTER:
        return ""
    harmonic = round(met / rate)
    return (
        f"Harmonic {harmonic} of {rate:.5g} rows a second, {harmonic * rate:.4g} Hz, meets the resonance of {name}, "
        f"{met:.4g} Hz: {other:.10g} rows a second have none within {math.floor(away * other):.2g} Hz of a resonance."
    )


def _apart(rate: float, resonances: Iterable[float]) -> float:
    """Distance of the resonance that is nearest to a harmonic, of the distance between two harmonics: at most half."""
    return min(abs(one / rate - round(one / rate)) for one in resonances)
