"""An amplifier at its slew rate: behind a voltage that is no faster than that, the displacement is simple."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting.regression import plays

ROWS, STROKES = 6000, 8.0  # of the fastest part that is looked at; where it would have fewer strokes, every few rows
TOP = 99.5  # percentile of the voltage's speeds: the fastest
RATES = (0.25, 0.35, 0.5, 0.6, 0.7, 0.8, 0.9)  # of it, that are tried
BEHIND = 0.003, 0.7  # of the rows: so many are behind the voltage
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.35)  # of the span, of the plays beside
LAGS = (0, 1, 2, 4, 8, 16, 32)  # rows: a lag and a resonance are no slew rate


class Slew(NamedTuple):
    """A slew rate that would explain a record.

    Attributes
    ----------
    rate : float
        V/s.
    share : float
        Of the rows in which an amplifier of that rate would be behind the voltage.
    ratio : float
        What is not explained of the displacement with it, over what is not without, rms.
    """

    rate: float
    share: float
    ratio: float


def best(x: FloatArray, z: FloatArray, sample_rate: float, strokes: int) -> Slew | None:
    """The slew rate that explains the displacement z, um, of the voltage x, V, best; None where none changes it.

    Beside it: a filter of the voltage, plays, a parabola.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> x = 50 - 25 * (np.cos(8 * t) + np.cos(19 * t))
    >>> found = best(x, limited(x, 0.3), 1000.0, strokes=20)
    >>> found is not None and (250 < found.rate < 350, found.ratio < 0.5)
    (True, True)
    """
    every = max(1, round(STROKES * x.size / max(strokes, 1) / ROWS))
    x, z, rate = x[::every], z[::every], sample_rate / every
    if x.size > ROWS:
        travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
        start = int(np.argmax(travelled[ROWS:] - travelled[:-ROWS]))
        x, z = x[start : start + ROWS], z[start : start + ROWS]
    steps = np.abs(np.diff(x))
    if x.size < 2 * LAGS[-1] or not steps.any():
        return None
    top, found = float(np.percentile(steps[steps > 0], TOP)), []
    for most in (share * top for share in RATES):
        behind = limited(x, most)
        share = float(np.mean(np.abs(x - behind) > 1e-9 * np.ptp(x)))
        if BEHIND[0] < share < BEHIND[1]:
            found.append(Slew(most * rate, share, _left(behind, z)))
    least = min(found, key=lambda each: each.ratio, default=None)
    return None if least is None else least._replace(ratio=least.ratio / max(_left(x, z), 1e-300))


def limited(x: FloatArray, most: float) -> FloatArray:
    """The voltage x, V, behind an amplifier that moves `most` V a row.

    Examples
    --------
    >>> limited(np.array([0.0, 3.0, 3.0, 2.5]), 2.0).tolist()
    [0.0, 2.0, 3.0, 2.5]
    """
    now, made = float(x[0]), []
    for wanted in x.tolist():
        up, down = now + most, now - most
        now = up if wanted > up else down if wanted < down else wanted
        made.append(now)
    return np.array(made)


def _left(x: FloatArray, z: FloatArray) -> float:
    """What a filter of x, plays and a parabola of it leave of z, rms."""
    first, span = LAGS[-1], float(np.ptp(x))
    history = plays(x - x[0], tuple(r * span for r in THRESHOLDS))[first:]
    before = [x[first - lag : x.size - lag] for lag in LAGS]
    columns = np.column_stack([np.ones(x.size - first), *before, history, (x[first:] / span) ** 2])
    weights = np.linalg.lstsq(columns, z[first:], rcond=1e-8)[0]
    return float(np.std(z[first:] - columns @ weights))
