"""What a black-box model, fitted to the same part of the record, predicts of the error of a model."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting.regression import plays
from truestroke.identification.held_out.trace import Trace
from truestroke.model.sampled import central_difference

Rows = npt.NDArray[np.intp]

ROWS = 5_000  # of the record at most, evenly taken
SETTLED = 0.15  # of the record, at its start: its states may not be known
FITTED = 0.75  # of the fitted part: the rest chooses the ridge
FEWEST = 40  # rows of each
RIDGES = np.logspace(-6, 1, 8)  # of the mean square of a column
THRESHOLDS = np.linspace(0.01, 0.5, 16)  # of the voltage span
LAGS = (1, 2, 4, 8, 16, 32)  # samples
WAVES, WIDTH = 80, 0.7  # random cosines of voltage, velocity and history, and their frequency in standard deviations


def predictable(trace: Trace) -> float:
    """Share of the mean square of the held-out error that a black-box model predicts, below 0 where it makes it larger.

    Ridge regression of the error in the fitted part on the voltage and its powers, plays, lagged voltages, the rank of
    the velocity, and random cosines of these (Rahimi and Recht 2007); with a share of 0.75 there is a model with half
    the error.
    """
    every = -(-trace.time.size // ROWS)
    error, fitted = trace.residual[::every], trace.known & ~trace.held_out
    rows, test = np.flatnonzero(fitted[::every]), np.flatnonzero(trace.judged[::every])
    rows = rows[rows >= SETTLED * error.size]
    cut = round(FITTED * rows.size)
    square = float(np.mean(error[test] ** 2)) if test.size else 0.0
    if min(cut, rows.size - cut, test.size) < FEWEST or square == 0.0:
        return 0.0
    columns = _columns(trace.volts, trace.sample_rate, every)
    inside = _left(columns, error, rows[:cut], rows[cut:], RIDGES)
    best = RIDGES[[int(np.argmin(inside))]]
    return 1 - float(_left(columns, error, rows, test, best)[0]) / square


def _columns(x: FloatArray, fs: float, every: int) -> FloatArray:
    """Of every `every`-th row."""
    span = float(np.ptp(x))
    u = (x - x.min()) / span
    history = plays(x - x[0], tuple((THRESHOLDS * span).tolist()), every) / span
    velocity = np.argsort(np.argsort(central_difference(u, fs)))[::every] / u.size
    before = [u - np.concatenate([np.full(lag, u[0]), u[:-lag]]) for lag in LAGS if lag < u.size // 20]
    before, u = [column[::every] for column in before], u[::every]
    state = np.column_stack([u, velocity, history[:, 1::4] - u[:, None]])
    rng = np.random.Generator(np.random.PCG64(0))
    frequencies = WIDTH * rng.standard_normal((state.shape[1], WAVES))
    waves = np.cos(state / np.maximum(state.std(axis=0), 1e-12) @ frequencies + rng.uniform(0, 2 * np.pi, WAVES))
    return np.column_stack([u, u**2, u**3, velocity, history, *before, waves])


def _left(columns: FloatArray, error: FloatArray, fit: Rows, test: Rows, ridges: npt.NDArray[Any]) -> FloatArray:
    """Mean square error in the rows `test`, with each ridge, of what was fitted to the rows `fit`, um^2."""
    A, b = columns[fit], error[fit]
    mean, scale = A.mean(axis=0), A.std(axis=0)
    scale = np.where(scale > 1e-12, scale, 1.0)
    A, T = (A - mean) / scale, (columns[test] - mean) / scale
    values, vectors = np.linalg.eigh(A.T @ A / len(b))
    aim, T = vectors.T @ (A.T @ (b - b.mean()) / len(b)), T @ vectors
    left = [error[test] - b.mean() - T @ (aim / (np.maximum(values, 0.0) + ridge)) for ridge in ridges]
    return np.array([np.mean(e**2) for e in left])
