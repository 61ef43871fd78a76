"""Where a voltage turns round, and how much later the displacement does."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.signals.noise import converter_step, noise

Rows = npt.NDArray[np.int64]

FEW_EXTREMES, RIPPLE = 1000, 0.02  # that are walked along, and share of pairs without which another pass is no gain
STROKE = 0.05  # of the voltage span: the least travel between two reversals that counts as a stroke
WINDOW = 0.1  # of the shorter stroke beside it, that a reversal's window reaches down on either side
POINTS = 48  # of a window
FEWEST_SIDE = 3  # samples of a window on each side of the reversal
STEPS, MOVED = 8, 0.05  # of a converter, and of the span: rates are formed over rows in which a signal moves so far
STRANGE = 0.25  # of the squares in the windows, beside noise: a larger residual is that of a stage that rings
MOST_REVERSALS = 200  # that are looked at, evenly over the record


def reversals(x: FloatArray, threshold: float) -> Rows:
    """Rows at which `x` turns and then goes back by more than `threshold`, the first and last row among them.

    Examples
    --------
    >>> reversals(np.array([0.0, 2.0, 1.9, 4.0, 1.0, 3.0]), 0.5)
    array([0, 3, 4, 5])
    """
    signs = (x[1:] > x[:-1]).view(np.int8) - (x[1:] < x[:-1]).view(np.int8)
    moves = np.flatnonzero(signs)
    moved = signs[moves]
    candidates = np.concatenate([moves[1:][moved[1:] != moved[:-1]], [x.size - 1]])
    candidates = _without_ripple(x, candidates, threshold)
    found, extreme = [0], 0
    direction = 0.0  # of the stroke under way; unknown at first
    for k, value in zip(candidates.tolist(), x[candidates].tolist(), strict=True):
        ahead = (value - x[extreme]) * (direction or np.sign(value - x[extreme]))
        if direction == 0.0:
            if ahead > threshold:
                direction, extreme = float(np.sign(value - x[0])), k
        elif ahead >= 0:
            extreme = k
        elif -ahead > threshold:
            found.append(extreme)
            direction, extreme = -direction, k
    if found[-1] != x.size - 1:
        found.append(x.size - 1)
    return np.array(found, dtype=np.int64)


def _without_ripple(x: FloatArray, extremes: Rows, threshold: float) -> Rows:
    """The extremes without pairs that lie between those beside them and are less apart: they make no stroke.

    Noise has an extreme in two rows of three; what walks along them does not vectorise.
    """
    while extremes.size > FEW_EXTREMES:
        apart = np.abs(np.diff(x[extremes]))
        inner = apart[1:-1]
        small = (inner <= threshold) & (inner < apart[:-2]) & (inner <= apart[2:])
        pairs = np.flatnonzero(small) + 1
        if pairs.size < RIPPLE * extremes.size:
            break
        kept = np.ones(extremes.size, dtype=np.bool_)
        kept[pairs] = kept[pairs + 1] = False
        extremes = extremes[kept]
    return extremes


def delay(x: FloatArray, z: FloatArray, turns: Rows, breaks: Sequence[int]) -> float | None:
    """Samples by which `z` turns later than `x`; None where too few reversals show it.

    Hysteresis without rate turns with its input: however wide the loop, displacement and voltage have their extremes
    at one instant, and only the slopes before and after differ. So close to a reversal at tau ::

        z(t) = c + f(x(t - d) - x(tau)) before,   c + g(x(t - d) - x(tau)) after,   f, g parabolas through 0

    for every reversal its own c, f, g, and one delay d for all: that with the least sum of squares. None where much
    more than noise remains: something else than the voltage moves the displacement there, such as ringing.
    """
    windows = _windows(x, turns, breaks)
    if len(windows) < 4:
        return None
    rows = np.array([np.linspace(low, high, POINTS).round() for low, _, high in windows])
    tops = np.array([_top(x, middle) for _, middle, _ in windows])
    values = z[rows.astype(np.int64)]
    values = (values - values.mean(axis=1, keepdims=True)) / np.ptp(z)
    reach = float(np.median([(high - low) / 2 for low, _, high in windows]))

    grid = np.linspace(-0.5 * reach, reach, 31)
    for _ in range(3):  # each time closer around the least
        squares = np.array([_left(x, rows, values, tops, d) for d in grid])
        best, step = int(squares.argmin()), grid[1] - grid[0]
        if best in (0, grid.size - 1):
            return None
        least, (before, at, after) = float(grid[best]), squares[best - 1 : best + 2]
        grid = np.linspace(least - step, least + step, 9)
    of_noise = noise(z, (slice(0, z.size),)) / float(np.ptp(z))
    if at - values.size * of_noise**2 > STRANGE * float(np.sum(values**2)):
        return None
    bend = before - 2 * at + after
    return least + float(0.5 * (before - after) / bend * step if bend else 0.0)


def _windows(x: FloatArray, turns: Rows, breaks: Sequence[int]) -> list[tuple[int, int, int]]:
    """First row, reversal and last row of the windows that have enough samples and no gap."""
    inner = np.arange(1, turns.size - 1)
    inner = inner[:: max(1, inner.size // MOST_REVERSALS)]
    windows = []
    for i in inner:
        before, k, after = (int(turn) for turn in turns[i - 1 : i + 2])
        depth = WINDOW * min(abs(x[k] - x[before]), abs(x[k] - x[after]))
        low = before + int(np.flatnonzero(np.abs(x[before:k] - x[k]) > depth)[-1])
        high = k + int(np.flatnonzero(np.abs(x[k : after + 1] - x[k]) > depth)[0])
        if min(k - low, high - k) >= FEWEST_SIDE and not any(low < b <= high for b in breaks):
            windows.append((low, k, high))
    return windows


def _top(x: FloatArray, k: int) -> tuple[float, float]:
    """Time and height of the extreme at row `k`, by the parabola through it and its neighbours."""
    left, middle, right = x[k - 1 : k + 2]
    bend = left - 2 * middle + right
    shift = float(0.5 * (left - right) / bend) if bend else 0.0
    if abs(shift) > 1:  # the end of a plateau
        return float(k), float(middle)
    return k + shift, float(middle - 0.25 * (left - right) * shift)


def _left(x: FloatArray, rows: FloatArray, values: FloatArray, tops: FloatArray, d: float) -> float:
    """Sum of squares of the residual of the best parabolas at the delay `d`."""
    times = rows - d
    drop = np.interp(times, np.arange(x.size), x) - tops[:, 1:]
    drop /= np.abs(drop).max(axis=1, keepdims=True)
    after = times > tops[:, :1]
    before_, after_ = np.where(after, 0.0, drop), np.where(after, drop, 0.0)
    columns = np.stack([np.ones_like(drop), before_, before_**2, after_, after_**2], axis=2)
    Q = np.linalg.qr(columns)[0]
    fitted = Q @ (Q.transpose(0, 2, 1) @ values[:, :, None])
    return float(((values - fitted[:, :, 0]) ** 2).sum())


def rate_lag(x: FloatArray, z: FloatArray, longest: int) -> float | None:
    """Samples by which the rate of `z` lags that of `x`: the peak of their cross-correlation, by a parabola.

    Delay and hysteresis both make it: a rate-independent loop lags by a part of its period, of any length.
    """
    from scipy.signal import correlate

    rises = np.sign((x - x.mean()) @ (z - z.mean()))  # the rates of steps and of late answers have none in common
    over = max(_resolved(x, longest // 4), _resolved(z, longest // 4))
    dx, dz = x[over:] - x[:-over], (z[over:] - z[:-over]) * rises
    reach = min(longest, dx.size // 4)
    if reach < 2:
        return None
    whole = correlate(dz, dx, mode="full", method="fft")
    c = whole[dx.size - 1 - reach : dx.size + reach] / (dx.size - np.abs(np.arange(-reach, reach + 1)))
    k = int(c.argmax())
    if not over <= k < c.size - over:
        return None
    before, at, after = c[k - over], c[k], c[k + over]
    return float(k - reach + 0.5 * over * (before - after) / (before - 2 * at + after))


def _resolved(signal: FloatArray, longest: int) -> int:
    """Rows over which a signal moves by several steps of its converter: 1 where it has none."""
    step, over = converter_step(signal), 1
    if step:
        least = min(STEPS * step, MOVED * float(np.ptp(signal)))
        while 2 * over <= longest and np.percentile(np.abs(signal[over:] - signal[:-over]), 75) < least:
            over *= 2
    return over
