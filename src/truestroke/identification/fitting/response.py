"""Dead time and lag between voltage and displacement, separated by the steps and the fast turns of a record."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base.typing import FloatArray
from truestroke.identification.fitting import normal
from truestroke.identification.fitting.normal import Prior
from truestroke.identification.fitting.regression import Data, Structure, plays, respond_rows
from truestroke.identification.records import turning
from truestroke.identification.records.series import first_known
from truestroke.model import prior
from truestroke.model.branches import Branches
from truestroke.model.sampled import creep_states, respond

EXCERPT = 8_000  # rows at most in which the two are separated: those with the most fast motion
RESOLVED = 8  # samples of dead time and lag together: where there are more, means over some of them suffice
PLAYS, NEAREST = 20, 2.0  # of the quick model, and the power by which their thresholds are denser near 0
CREEP_TIMES = (0.01, 0.1, 1.0, 10.0)  # s
BETAS, OF_BETAS = (3.0, 8.0), 0.5  # of states of Duhem, and the deviation of their weights, in slopes of the line
SLOWER = 3.0  # times dead time and lag together: creep that is faster would be taken for a lag
REACHES = 0.5, 0.9  # of the voltage range: where the start is not fitted, and where it is from rest
START = 1.25  # times the rmse without the start of the record: more, and its states are not those of rest
ORDER = 16  # of the autoregression that whitens the residual
MISFIT = 0.03  # of the whitened sum of squares: what the quick model may err beside the noise
PULL = 0.005  # rows that count as one against the prior, likewise
SEEN = 1e-9  # of the largest singular value: below, columns are alike
CHI_SQUARED = 3.84, 5.99  # 95 %, of one number, and of two that are inside together
CLOCK = 0.75  # samples: what sampling hides of the time of a step
SPREAD = 0.5  # relative deviation of the weight of a play by itself: few are negative
NOISE = 0.002  # of the stroke: residual of the quick model before it is known
STEPS = 6  # of Gauss-Newton
ENDS, PARABOLA = 6, 5.0  # tries for an end of an interval, and what may be lost there, in bounds, for a parabola
FARTHEST = 0.25  # of the record: no end is farther
ALIKE = 1.2  # longest over shortest strokes, in time and in volts: below, a record has one motion
JUMPS = 5.0  # times the mean change of the voltage from row to row: a step; of a sine it is 1.6 at most
FEWEST_TURNS = 4  # between which strokes are compared
HIDDEN = 0.08  # of a stroke: hysteresis looks like so much dead time or lag where all strokes are alike; seen: 0.066
CONVERGED = 5e-3  # samples
NEARLY = 1e-3  # of the sum of squares: a step of a hypothesis that gains less does not change which one is taken
UNDECIDED = 10.0  # bounds: the model without dead time and lag loses less, and the final model is asked, too


@dataclass(frozen=True)
class Response:
    """Dead time and lag, with 95 % intervals.

    Attributes
    ----------
    delay, time_constant : float
        Dead time and time constant of a first-order lag, s.
    delay_interval, time_constant_interval : tuple of float
        Lowest and highest that agree with the record, s.
    separable : bool
        Whether the record separates the two; where it does not, both intervals hold both explanations.
    undecided : bool
        Whether the two are so little better than neither that hysteresis may be what they explain.
    """

    delay: float
    time_constant: float
    delay_interval: tuple[float, float]
    time_constant_interval: tuple[float, float]
    separable: bool
    undecided: bool = False

    @property
    def neither(self) -> Response:
        """Neither dead time nor lag; the intervals hold that, too."""
        (_, longest), (_, slowest) = self.delay_interval, self.time_constant_interval
        return Response(0.0, 0.0, (0.0, longest), (0.0, slowest), separable=False)


def find_response(data: Data, coarse: float, known: float | None = None, certain: bool = True) -> Response:
    """Dead time and lag of a record by generalised least squares of a quick model of plays, creep and states of Duhem.

    Behind a turn states of Duhem may go on for a while, as a lag does, and plays never do.
    The residual of the quick model is mostly slow. Whitened by an autoregression, steps and fast turns count as much as
    they show; then dead time alone, lag alone and both are compared. Where neither or either one alone is as good, the
    lag is taken: its prediction of faster motion than that of the record is smaller. Where all strokes are alike,
    hysteresis may be as late as a short dead time or lag, and neither is taken.

    Parameters
    ----------
    data : Data
        The record; its displacement at the full rate.
    coarse : float
        A first value of the two together, s.
    known : float, optional
        The dead time, s, if it is known.
    certain : bool
        Whether the intervals are wanted; else they are (0, 0).
    """
    if known is not None:
        return Response(known, 0.0, (known, known), (0.0, 0.0), separable=True)
    quick = _excerpt(data, coarse)
    if not quick.rows:  # bursts that are shorter than the autoregression show neither
        most = max(coarse, ORDER / quick.sample_rate)
        return Response(0.0, 0.0, (0.0, most), (0.0, most), separable=False)
    found = quick.found(coarse * quick.sample_rate, certain)
    stroke = _of_one_motion(data.volts)
    return found if stroke is None else _beyond_hysteresis(found, HIDDEN * stroke / data.sample_rate)


def _of_one_motion(x: FloatArray) -> float | None:
    """Samples of a stroke, where all are alike in time and in volts but for the first and the last; else None.

    Nor is it of one motion where the voltage steps, if only at its start.
    """
    turns, moves = turning.reversals(x, turning.STROKE * float(np.ptp(x)))[1:-1], np.abs(np.diff(x))
    if turns.size < FEWEST_TURNS or moves.max() > JUMPS * moves[turns[0] : turns[-1]].mean():
        return None
    times, ways = np.diff(turns), np.abs(np.diff(x[turns]))
    alike = all(float(size.max()) < ALIKE * float(size.min()) for size in (times, ways))
    return float(np.median(times)) if alike else None


def _beyond_hysteresis(found: Response, hidden: float) -> Response:
    """Of a record of one motion: hysteresis alone may be late by so much, s, at each of its turns.

    What is less is taken for hysteresis, and either of the two may be in place of both.
    """
    either = 0.0, max(found.delay_interval[1], found.time_constant_interval[1])
    if found.delay + found.time_constant <= hidden:
        return Response(0.0, 0.0, either, either, separable=False)
    return dataclasses.replace(found, delay_interval=either, time_constant_interval=either, separable=False)


class Minimum(NamedTuple):
    """Least sum of squares, um^2, at a delay and a lag, samples, and the matrix G of Gauss-Newton there."""

    squares: float
    delay: float
    lag: float
    G: FloatArray


class Fitted(NamedTuple):
    """Of a delay and a lag: sum of squares, um^2, coefficients, and G, g of their Gauss-Newton step, G step = g."""

    squares: float
    c: FloatArray
    G: FloatArray
    g: FloatArray


@dataclass(eq=False)
class _Quick:
    """Columns of the quick model before dead time and lag; times are in samples."""

    columns: FloatArray
    displacement: FloatArray
    known: npt.NDArray[np.bool_]
    sample_rate: float
    pull: FloatArray  # rows to the prior
    variance: float  # um^2, of the whitened residual

    def __post_init__(self) -> None:
        self._counted = normal.as_slice(self.known)
        self._whiten_by(np.ones(1))

    @property
    def rows(self) -> int:
        """Number of the rows that count."""
        return int(np.count_nonzero(self.known))

    def _whiten_by(self, white: FloatArray) -> None:
        """Filter what `fit` takes: of what is above the first row it commutes with dead time and lag."""
        from scipy.signal import lfilter

        first, ones = self.columns[:1], np.ones((len(self.columns), 1))
        self._above = lfilter(white, [1.0], self.columns - first, axis=0)
        self._first = lfilter(white, [1.0], ones, axis=0)[self._counted] * first
        self._target = lfilter(white, [1.0], self.displacement)[self._counted]
        self._fits: dict[tuple[float, float], Fitted] = {}

    def fit(self, delay: float, lag: float) -> Fitted:
        """Made once for each delay and lag until the next `whiten`: several searches begin and end at the same ones."""
        at = float(delay), float(lag)
        if at not in self._fits:
            self._fits[at] = self._fitted(*at)
        return self._fits[at]

    def _fitted(self, delay: float, lag: float) -> Fitted:
        h, pull = 0.05, np.sqrt(self.variance * (1 + PULL * self.rows)) * self.pull
        rows = np.empty((len(pull) + self._target.size, pull.shape[1]))
        rows[: len(pull)] = pull
        W, t = rows[:, :-1], rows[:, -1]
        np.add(respond_rows(self._above, delay, lag)[self._counted], self._first, out=W[len(pull) :])
        t[len(pull) :] = self._target
        R = normal.reduced(rows)
        U, S, V = np.linalg.svd(R[:, :-1], full_matrices=False)
        seen = S / S[0] > SEEN
        inverse = V[seen].T / S[seen]
        c = inverse @ (U[:, seen].T @ R[:, -1])
        y = self._above @ c
        D = np.zeros((len(W), 2))
        slopes = (
            (respond(y, delay + h, lag) - respond(y, max(delay - h, 0.0), lag)) / (h + min(h, delay)),
            (respond(y, delay, lag + h) - respond(y, delay, max(lag - h, 0.0))) / (h + min(h, lag)),
        )
        D[len(pull) :] = np.column_stack(slopes)[self._counted]
        for _ in range(2):  # without what the columns explain; again, for rounding
            D -= W @ (inverse @ (inverse.T @ (W.T @ D)))
        return Fitted(float(np.sum((R[:, -1] - R[:, :-1] @ c) ** 2)), c, D.T @ D, D.T @ (t - W @ c))

    def least(self, delay: float, lag: float, fixed: int | None = None, gain: float = 0.0) -> Minimum:
        """The least sum of squares from a start, but for steps that gain less than `gain` of it; `fixed` keeps one."""
        p = np.array([delay, lag])
        squares, _, G, g = self.fit(*p)
        for _ in range(STEPS):
            step = _step(p, G, g, fixed)
            if np.abs(step).max() < CONVERGED or g @ step < gain * squares:
                break
            for share in (1.0, 0.5, 0.1):
                other = np.maximum(p + share * step, 0.0)
                tried = self.fit(*other)
                if tried[0] < squares:
                    break
            else:
                break
            p, (squares, _, G, g) = other, tried
        return Minimum(squares, float(p[0]), float(p[1]), G)

    def whiten(self, delay: float, lag: float) -> None:
        """From the residual at these values."""
        from scipy.linalg import solve_toeplitz

        self._whiten_by(np.ones(1))
        c = self.fit(delay, lag)[1]
        e = np.where(self.known, self.displacement - respond(self.columns @ c, delay, lag), 0.0)
        r = np.array([e[: e.size - k] @ e[k:] for k in range(ORDER + 1)])
        r[0] = r[0] * (1 + 1e-9) + 1e-300
        white = np.concatenate([[1.0], -solve_toeplitz(r[:-1], r[1:])])
        self._whiten_by(white)
        self.variance = float(white @ r) / max(self.rows, 1)

    def found(self, coarse: float, certain: bool) -> Response:
        """The hypotheses compared."""
        starts = (coarse, 0.0), (0.3 * coarse, 0.7 * coarse)
        best = min((self.least(*start, gain=NEARLY) for start in starts), key=_squares)
        for gain in (NEARLY, 0.0):
            self.whiten(best.delay, best.lag)
            best = self.least(best.delay, best.lag, gain=gain)
        total = best.delay + best.lag
        none = Minimum(self.fit(0.0, 0.0)[0], 0.0, 0.0, best.G)
        dead, lag = self.least(total, 0.0, fixed=1), self.least(0.0, total, fixed=0)
        others = [self.least(*start, gain=NEARLY) for start in ((0.5 * total, 0.5 * total), (0.0, 0.0))]
        near = min(others, key=_squares)
        if near.squares < best.squares:
            near = self.least(near.delay, near.lag)
        best = min(best, near, dead, lag, key=_squares)
        bound, both = (x * (1 + MISFIT * self.rows) * best.squares / max(self.rows, 1) for x in CHI_SQUARED)
        still, late, lagged = (e.squares <= best.squares + bound for e in (none, dead, lag))
        chosen = none if still else lag if late and lagged else best
        agree = [e for e, agrees in ((none, still), (dead, late), (lag, lagged)) if agrees]
        spans = self._intervals(best, agree, both) if certain else np.zeros((2, 2))
        s = 1 / self.sample_rate
        delays, lags = ((float(low) * s, float(high) * s) for low, high in spans)
        undecided = not still and none.squares <= best.squares + UNDECIDED * bound
        return Response(chosen.delay * s, chosen.lag * s, delays, lags, not (late and lagged), undecided)

    def _intervals(self, best: Minimum, agree: Sequence[Minimum], bound: float) -> FloatArray:
        """Lowest and highest delay, and lag: where one of them, kept, loses less than `bound`; and sampling."""
        found = np.array([[e.delay, e.lag] for e in (best, *agree)])
        for k in (0, 1):
            for sign in (-1, 1):
                found = np.vstack([found, self._end(best, bound, k, sign)])
        margin = CLOCK * np.array([1.0, 0.5])
        return np.maximum([found.min(axis=0) - margin, found.max(axis=0) + margin], 0.0).T

    def _end(self, best: Minimum, bound: float, k: int, sign: int) -> FloatArray:
        """Delay and lag farthest from the best in the `k`-th of them that still agree."""
        at, G = np.array([best.delay, best.lag]), best.G
        alone = G[k, k] - G[0, 1] ** 2 / max(G[1 - k, 1 - k], 1e-300)  # the other one follows
        reach = float(np.sqrt(bound / max(alone, 1e-12 * G[k, k] + 1e-300)))
        inside, outside = 0.0, FARTHEST * self.displacement.size
        found, step = at, min(0.5 * reach, outside)
        for _ in range(ENDS):
            start = at.copy()
            start[k] = max(at[k] + sign * step, 0.0)
            start[1 - k] = max(at.sum() - start[k], 0.0)
            tried = self.least(float(start[0]), float(start[1]), fixed=k, gain=NEARLY)
            lost = (tried.squares - best.squares) / bound
            there = np.array([tried.delay, tried.lag])
            if lost <= 1:
                found, inside = there, step
                step = min(2 * step, 0.5 * (step + outside))
            else:
                between = at + (there - at) / np.sqrt(lost)  # a parabola from the best to here
                if lost < PARABOLA:
                    return between if sign * (between[k] - found[k]) > 0 else found
                outside = step
                step = 0.5 * (inside + step) if inside else max(step / float(np.sqrt(lost)), 0.1 * step)
            if start[k] == 0.0 and lost <= 1:
                break
        return found


def _squares(entry: Minimum) -> float:
    return entry.squares


def _step(p: FloatArray, G: FloatArray, g: FloatArray, fixed: int | None) -> FloatArray:
    """Of Gauss-Newton within p >= 0; what is fixed, or at 0 and pushed below, stays."""
    free = [k for k in (0, 1) if k != fixed and (p[k] > 0 or g[k] > 0)]
    step = np.zeros(2)
    if free:
        step[free] = np.linalg.lstsq(G[np.ix_(free, free)], g[free], rcond=1e-12)[0]
    if len(free) == 2 and (p + step).min() < 0:
        k = int((p + step).argmin())
        step[k] = -p[k]
        step[1 - k] = (g[1 - k] - G[1 - k, k] * step[k]) / G[1 - k, 1 - k]
    return np.maximum(p + step, 0.0) - p


def _excerpt(data: Data, coarse: float) -> _Quick:
    """Rows with the most fast motion; from the start where the record begins at rest or with a step."""
    size = max(1, int(coarse * data.sample_rate / RESOLVED))
    x, z, valid = data.volts, data.displacement, data.known
    if size > 1:
        blocks = x.size // size
        x, z = (a[: blocks * size].reshape(-1, size).mean(axis=1) for a in (x, z))
        valid = np.asarray(valid[: blocks * size].reshape(-1, size).all(axis=1), dtype=np.bool_)
    fs = data.sample_rate / size
    start, stop = _fastest(x)
    skip = first_known(x, float(np.ptp(x)))
    if skip > start + EXCERPT // 2:  # in a long record: the plays would not be known in most of the excerpt
        start, stop = (skip + row for row in _fastest(x[skip:]))
    kept = slice(start, stop)
    made = []
    for reach, first in zip(REACHES, (max(skip - start, ORDER), 0), strict=True):
        rows = np.convolve(~valid[kept], np.ones(ORDER + 1))[: stop - start] == 0
        rows[:first] = False
        columns, known = _columns(data, x, fs, reach, kept, coarse)
        made.append(
            _Quick(columns, _after_one(z[kept]), _after_one(rows), fs, known.rows(1.0), (NOISE * data.stroke) ** 2)
        )
        if start > 0:
            return made[0]
    later, whole = made
    at = whole.least(coarse * fs / 3, coarse * fs / 1.5)
    errors = [np.sqrt(q.fit(at.delay, at.lag)[0] / max(q.rows, 1)) for q in made]
    return whole if errors[1] <= START * errors[0] else later


def _after_one(signal: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A signal with one more sample before it, equal to the first: there a step before the record may be."""
    return np.concatenate([signal[:1], signal])


def _fastest(x: FloatArray) -> tuple[int, int]:
    """First row, and the first row after, of the excerpt in which the voltage changes its rate most."""
    if x.size <= EXCERPT:
        return 0, x.size
    sums = np.concatenate([[0.0], np.cumsum(np.diff(x, 2, prepend=[x[0], x[0]]) ** 2)])
    starts = np.arange(0, x.size - EXCERPT, EXCERPT // 8)
    start = int(starts[np.argmax(sums[starts + EXCERPT] - sums[starts])])
    return start, start + EXCERPT


def _columns(
    data: Data, x: FloatArray, fs: float, reach: float, kept: slice, coarse: float
) -> tuple[FloatArray, Prior]:
    """Plays, creep, a constant, creep and lag under way at the start, powers of the motion, Duhem; and their prior."""
    low, high = data.voltage_range
    thresholds = tuple(((np.arange(PLAYS) / PLAYS) ** NEAREST * reach * (high - low)).tolist())
    times = tuple(tau for tau in CREEP_TIMES if SLOWER * coarse < tau < x.size / fs / 2)
    s = Structure(thresholds=thresholds, creep_times=times, lag=False)
    H = _after_one(plays(x[: kept.stop], thresholds)[kept])
    creep = [_after_one(c[kept]) for c in creep_states(x[: kept.stop], times, fs)]
    t = np.arange(len(H)) / fs
    share = H @ prior.play_weights(thresholds, high - low, prior.FIRST_SLOPE * data.q)
    share = (share - share.min()) / np.ptp(share)
    begins = 1.0 if kept.start == 0 else 0.0
    starts = [begins * np.exp(-t / tau) for tau in times]
    others = [share**2, share**3, share**4, begins * (t == 0)]
    duhem = _after_one(Branches(voltage_range=data.voltage_range, betas=BETAS).states(x[: kept.stop])[kept])
    known = data.prior(s)
    a = known.mean[s.a]
    of_gain, of_hysteresis = prior.GAIN_DEVIATION * a, prior.HYSTERESIS_DEVIATION * np.append(0.0, a[1:])
    together = np.outer(of_gain, of_gain) + np.outer(of_hysteresis, of_hysteresis)
    m = known.mean.size
    of_others = [*[data.stroke] * len(others), *[OF_BETAS * data.q] * duhem.shape[1]]
    covariance = np.diag(np.square([*np.zeros(m), *of_others]))
    covariance[:m, :m] = known.covariance
    covariance[np.ix_(s.a, s.a)] = together + np.diag((SPREAD * a) ** 2)
    columns = np.column_stack([H, *creep, np.ones(len(H)), *starts, *others, duhem])
    return columns, Prior(np.append(known.mean, np.zeros(len(of_others))), covariance)
