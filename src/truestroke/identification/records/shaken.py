"""A stage that is shaken by steps of its voltage: the sign of its gain is not that of the correlation."""

import numpy as np

from truestroke.base.typing import FloatArray

FEW, JUMPED = 50, 0.5  # one row in so many has so much of the voltage's travel: it moves in steps
OFTEN, NEARLY_ALL = 8, 0.9  # the same of steps that come more often
ROWS = 20_000  # that are looked at
AGAIN = 4  # times the mode is fitted
SLOWED = 0.9999  # radius of a pole that grows
EXPLAINED = 0.9  # of the variance of the displacement, by the one mode
DAMPING = 0.3  # at most: a stage that does not ring follows its voltage


def in_steps(x: FloatArray) -> bool:
    """Whether the voltage moves in few rows."""
    moved = np.sort(np.abs(np.diff(x)))
    return bool(moved[-max(1, moved.size // FEW) :].sum() > JUMPED * moved.sum())


def shaken(x: FloatArray, z: FloatArray) -> float:
    """Gain at rest of a mode that answers the steps of `x` by the displacement `z`; 0 where there is none.

    A stage that is driven above its resonance, or whose period suits that of the steps, goes down when its voltage goes
    up. A linear filter of second order, which is fitted to `z` and then predicts it from `x` alone, shows that it rings
    behind the voltage; its gain is below 0 where the sensor is turned.

    Examples
    --------
    >>> from scipy.signal import lfilter
    >>> x = np.repeat(np.tile([0.0, 1.0], 100), 25)
    >>> z = lfilter([0.0, 0.06], [1.0, -1.93, 0.99], x)  # a period of 25 rows
    >>> [round(shaken(x, moved), 3) for moved in (z, -z, x)]
    [1.0, -1.0, 0.0]
    """
    moved = np.sort(np.abs(np.diff(x)))
    if moved[-(moved.size // OFTEN) :].sum() < NEARLY_ALL * moved.sum():
        return 0.0
    x, z = x[:ROWS] - x[0], z[:ROWS] - z[:ROWS].mean()
    mode = _fitted(x, z, z)
    for _ in range(AGAIN):  # noise of the sensor biases the first ones
        mode = _fitted(x, z, _answer(mode, x))
    (a1, a2, *b), start = mode, x.size // 4  # behind what was before the record
    radius = float(np.sqrt(max(-a2, 0.0)))
    if not 0.0 < radius < 1.0 or abs(a1) >= 2 * radius:  # it runs away, or does not ring
        return 0.0
    decay = -np.log(radius)
    if decay > DAMPING * np.hypot(decay, np.arccos(a1 / (2 * radius))):
        return 0.0
    off = (z - _answer(mode, x))[start:]
    if np.var(off) > (1 - EXPLAINED) * np.var(z[start:]):
        return 0.0
    return float(sum(b) / (1 - a1 - a2))


def _fitted(x: FloatArray, z: FloatArray, instrument: FloatArray) -> list[float]:
    """Weights of the two rows of `z` before, and of three rows of `x`, by an instrument that has no noise."""
    columns, free = (
        np.column_stack([y[1:-1], y[:-2], x[2:], x[1:-1], x[:-2], np.ones(x.size - 2)]) for y in (z, instrument)
    )
    return [float(weight) for weight in np.linalg.lstsq(free.T @ columns, free.T @ z[2:], rcond=None)[0][:5]]


def _answer(mode: list[float], x: FloatArray) -> FloatArray:
    """What a mode makes of `x`; one that grows is slowed down."""
    from scipy.signal import lfilter  # all of scipy.signal takes longer to import than the package

    a1, a2, *b = mode
    shrink = min(1.0, SLOWED / max(float(np.abs(np.roots([1.0, -a1, -a2])).max(initial=0.0)), SLOWED))
    return np.asarray(lfilter(b, [1.0, -a1 * shrink, -a2 * shrink**2], x))
