"""The zero of the sensor in parts of a record that are apart by long gaps: each has another one."""

from __future__ import annotations

import dataclasses

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting.regression import even_thresholds, plays
from truestroke.identification.records.series import Series
from truestroke.model.sampled import creep_states

PLAYS = 16
REACH = 0.5  # of the voltage range
CREEP_TIMES = (0.1, 1.0, 10.0)  # s
RIDGE = 1e-6  # of the mean square of a column
DRIFTS_IF = 0.8  # times the rms without: with a drift of each part it must be below
ROWS = 15_000  # at most
FEWEST = 20  # known rows of a part


def parts(s: Series, samples: int) -> list[slice]:
    """The parts of the first samples between long gaps."""
    ends = [b for b in s.breaks if b < samples]
    return [slice(a, b) for a, b in zip([0, *ends], [*ends, samples], strict=True)]


def zeros(s: Series, samples: int) -> FloatArray:
    """By how much the zero of each sample is above that at the end of the first samples, um; behind them 0.

    Least squares of plays, creep, powers of the voltage and a constant for each part with known rows; with a linear
    drift of each part, too, where that lowers the rms to `DRIFTS_IF` of it.
    """
    found, each = np.zeros(s.volts.size), parts(s, samples)
    known = np.flatnonzero(s.known[:samples])
    if len(each) == 1 or not known.size:
        return found
    rows = known[:: -(-known.size // ROWS)]
    inside = np.column_stack([(np.arange(samples) >= part.start) & (np.arange(samples) < part.stop) for part in each])
    seen = inside[rows].sum(axis=0) >= FEWEST
    if not seen.any():
        return found
    shown, ends = inside[:, seen].astype(np.float64), np.array([part.stop for part in each])[seen]
    ramps = shown * (np.arange(samples)[:, None] - ends) / np.maximum(shown.sum(axis=0), 1.0)
    motion, z = _motion(s.volts[:samples], s.sample_rate)[rows], s.displacement[rows]
    still, moving = (_least(motion, columns[rows], z) for columns in (shown, np.hstack([shown, ramps])))
    drifts = moving[0] < DRIFTS_IF * still[0]
    moved = np.hstack([shown, ramps]) @ moving[1] if drifts else shown @ still[1]
    found[:samples] = moved - moved[np.flatnonzero(shown[:, -1])[-1]]
    found[:samples][~shown.any(axis=1)] = 0.0
    return found


def _motion(x: FloatArray, fs: float) -> FloatArray:
    """Columns of a quick model without a zero, of every sample."""
    span = float(np.ptp(x))
    u = (x - x.min()) / span
    held = plays(x, even_thresholds(PLAYS, REACH * span)) / span
    creep = [c / span for c in creep_states(x, tuple(tau for tau in CREEP_TIMES if tau * fs < x.size), fs)]
    return np.column_stack([held, u**2, u**3, *creep])


def _least(motion: FloatArray, zero: FloatArray, z: FloatArray) -> tuple[float, FloatArray]:
    """Rms of the residual, um, and the coefficients of the zero."""
    A, n = np.hstack([motion, zero]), motion.shape[1]
    pull = np.sqrt(RIDGE * len(z)) * np.eye(A.shape[1])[:n]
    c = np.linalg.lstsq(np.vstack([A, pull]), np.append(z, np.zeros(n)), rcond=None)[0]
    return float(np.sqrt(np.mean((z - A @ c) ** 2))), np.asarray(c[n:])


def at_one_zero(s: Series, samples: int) -> tuple[Series, FloatArray]:
    """The record as if all its first samples had the zero of their last part, and what was taken off, um."""
    off = zeros(s, samples)
    return (dataclasses.replace(s, displacement=s.displacement - off), off) if off.any() else (s, off)


def ahead(s: Series, predicted: FloatArray, train: int) -> FloatArray:
    """By how much the zero of each part behind the first samples is above the prediction, um: the median."""
    found = np.zeros(s.volts.size)
    for part in parts(s, s.volts.size):
        rows, fitted = s.known[part], s.known[part.start : train]
        if part.start > 0 and np.count_nonzero(fitted) < FEWEST <= np.count_nonzero(rows):
            found[part] = float(np.median((s.displacement - predicted)[part][rows]))
    return found
