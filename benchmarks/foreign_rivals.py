"""Models of others on the foreign records, beside `identify`: who predicts what nobody has seen.

python -m benchmarks.foreign_rivals                            all records, some minutes on two idle cores
python -m benchmarks.foreign_rivals --records duhem --seed 1   those whose description has the word
python -m benchmarks.foreign_rivals --unseen                   of other actuators; --further, --other: of more
python -m benchmarks.foreign_rivals --skip NARX                without one of them

Each is fitted to the first 60 % and predicts the rest from the voltage alone. What it can choose it chooses inside the
first 60 %: fitted to four fifths of them, judged on the last. Where the last part is of another day, all take its zero
from its first twentieth. NARX needs sysidentpy, which wants an older NumPy than the rest:
`pip install "truestroke[rivals]"` in an environment of its own. Without it that column is empty.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from benchmarks import foreign_records, further_records, other_records, unseen_records

from truestroke.identification import Identified, Record, identify
from truestroke.model.operators import play_history

POINTS = 3000  # of the training part at most, for the models that are slow to fit
ANOTHER_DAY = 3600.0  # s: after a longer gap the zero is another one
ZERO = 0.05  # of the held-out part: rows from which all take the zero of another day
VALIDATED = 0.8  # of the training part: what is fitted where a choice is judged on the rest
LAGS = np.array([1, 2, 4, 8, 16, 32, 64, 128])  # decimated samples, of the trees


@dataclass(frozen=True)
class Task:
    """What each model gets: the record as `identify` took it, scaled.

    Attributes
    ----------
    u, z : ndarray, shape (samples,)
        Voltage from 0 to 1 and displacement, over its peak-to-peak value.
    known : ndarray of bool, shape (samples,)
        Rows that may be fitted and are judged.
    train : int
        Samples at the start that may be fitted.
    """

    u: np.ndarray
    z: np.ndarray
    known: np.ndarray
    train: int

    def rows(self, stop: int, most: int = POINTS) -> np.ndarray:
        """At most so many known rows before `stop`, without the first twentieth, whose history is not known."""
        rows = np.flatnonzero(self.known[:stop])
        rows = rows[rows >= self.train // 20]
        return rows[:: max(1, rows.size // most)]

    def validation(self) -> tuple[int, np.ndarray]:
        """Where the rows of a choice end, and the rows that judge it."""
        rows = np.flatnonzero(self.known[: self.train])
        stop = int(rows[int(VALIDATED * rows.size)])
        return stop, rows[rows >= stop]


Predict = Callable[[Task, int], np.ndarray]


def tuned(task: Task, candidates: Iterable[Predict]) -> np.ndarray:
    """Prediction of all samples by the candidate that is best inside the training part."""
    stop, judges = task.validation()

    def error(candidate: Predict) -> float:
        off = candidate(task, stop)[judges] - task.z[judges]
        return float(np.mean(off**2)) if np.all(np.isfinite(off)) else np.inf

    return min(candidates, key=error)(task, task.train)


def linear(columns: np.ndarray, task: Task, stop: int, ridge: float = 0.0) -> np.ndarray:
    """Least squares of columns, fitted to the rows before `stop`."""
    rows = task.rows(stop, most=20_000)
    A, t = columns[rows], task.z[rows]
    if ridge:
        A = np.vstack([A, np.sqrt(ridge * rows.size) * np.eye(A.shape[1])])
        t = np.concatenate([t, np.zeros(columns.shape[1])])
    return np.asarray(columns @ np.linalg.lstsq(A, t, rcond=None)[0])


# ---- Plays with lags -------------------------------------------------------------------------------------------------


def plays_with_lags(task: Task) -> np.ndarray:
    """Plays, a cubic, and the voltage of samples before; ridge regression."""

    def candidate(count: int, ridge: float, lags: Sequence[int]) -> Predict:
        before = [np.concatenate([np.full(lag, task.u[0]), task.u[:-lag]])[:, None] for lag in lags]
        powers = task.u[:, None] ** np.arange(4)
        columns = np.hstack([powers, play_history(task.u, tuple(0.6 * (np.arange(count) + 1) / count)), *before])
        return lambda task, stop: linear(columns, task, stop, ridge)

    lags = [lag for lag in (1, 2, 4, 8) if lag < task.train // 50]
    return tuned(task, itertools.starmap(candidate, itertools.product((10, 25), (1e-9, 1e-6), ((), lags))))


# ---- Bouc-Wen --------------------------------------------------------------------------------------------------------


def bouc_wen(task: Task, starts: int = 150, steps: int = 10) -> np.ndarray:
    """h' = u' - |u'| beta h - gamma u' |h|, z a cubic of u plus kappa h, its voltage a lag behind.

    beta, gamma and the lag from `starts` random ones, the best three refined by Gauss and Newton; the rest is linear.
    """
    rng = np.random.Generator(np.random.PCG64(0))
    log_start = np.column_stack(
        [rng.uniform(np.log(0.3), np.log(60), starts), rng.uniform(-1.0, 1.0, starts), rng.uniform(-3, 3, starts)]
    )
    first = task.train // 20
    kept = _turns_kept(task.u, POINTS // 2)
    stop = int(np.searchsorted(kept, task.train))
    fitted = np.flatnonzero(task.known[kept[:stop]] & (kept[:stop] >= first))

    def response(numbers: np.ndarray, samples: int) -> np.ndarray:
        """Columns [1, u, u^2, u^3, h] of each row of numbers, shape (rows, samples, 5)."""
        numbers = np.clip(numbers, -6.0, 6.0)
        beta, ratio, lag = np.exp(numbers[:, 0]), np.tanh(numbers[:, 1]), np.exp(numbers[:, 2])
        x = np.repeat(task.u[kept[:samples], None], len(numbers), axis=1)
        steps = np.diff(kept[:samples], prepend=kept[0])
        state, h = x[0].copy(), np.zeros_like(x)
        for k in range(1, samples):
            x[k] = state = x[k] + (state - x[k]) * np.exp(-steps[k] / lag)
            dx = x[k] - x[k - 1]
            rate = beta * np.abs(dx) * (1 + ratio * np.sign(dx * h[k - 1]))
            gain = np.where(rate > 1e-9, -np.expm1(-rate) / np.maximum(rate, 1e-9), 1.0)
            h[k] = h[k - 1] * np.exp(-rate) + dx * gain
        return np.stack([np.ones_like(x), x, x**2, x**3, h], axis=-1).transpose(1, 0, 2)

    def residuals(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns, z = response(numbers, stop), task.z[kept[:stop]]
        weights = np.array([np.linalg.lstsq(C[fitted], z[fitted], rcond=None)[0] for C in columns])
        off = np.array([C[fitted] @ w - z[fitted] for C, w in zip(columns, weights, strict=True)])
        return off, weights

    off, _ = residuals(log_start)
    best = log_start[np.argsort((off**2).mean(axis=1))[:3]]
    finals = []
    for numbers in best:
        damping = 1e-3
        for _ in range(steps):
            trial = np.vstack([numbers, numbers + 1e-4 * np.eye(3)])
            off, _ = residuals(trial)
            J, now = (off[1:] - off[0]).T / 1e-4, float(off[0] @ off[0])
            moves = [
                numbers - np.linalg.solve(J.T @ J + d * np.diag(np.diag(J.T @ J) + 1e-12), J.T @ off[0])
                for d in (damping / 10, damping, 10 * damping)
            ]
            costs = (residuals(np.array(moves))[0] ** 2).sum(axis=1)
            if costs.min() < now:
                numbers, damping = moves[int(costs.argmin())], damping * (0.1, 1.0, 10.0)[int(costs.argmin())]
            else:
                damping *= 30
        finals.append((float((residuals(numbers[None])[0] ** 2).sum()), numbers))
    numbers = min(finals, key=lambda final: final[0])[1]
    _, weights = residuals(numbers[None])
    made = response(numbers[None], kept.size)[0] @ weights[0]
    return np.interp(np.arange(task.u.size), kept, made)


def _turns_kept(u: np.ndarray, most: int) -> np.ndarray:
    """Some rows, evenly, and each at which the voltage turns by more than a hundredth, the last included."""
    even = np.arange(0, u.size, max(1, u.size // most))
    coarse = u[even]
    turns = even[1:-1][(np.diff(coarse)[:-1] * np.diff(coarse)[1:]) < 0]
    return np.unique(np.concatenate([even, turns, [u.size - 1]]))


# ---- Preisach --------------------------------------------------------------------------------------------------------


def preisach(task: Task) -> np.ndarray:
    """Relays on a grid of switching points, a line and an offset; weights by non-negative least squares."""
    from scipy.optimize import nnls

    def candidate(levels: int) -> Predict:
        grid = (np.arange(levels) + 0.5) / levels
        down, up = (side.ravel() for side in np.meshgrid(grid, grid))
        keep = up >= down
        up, down = up[keep], down[keep]
        kept = _turns_kept(task.u, 2 * POINTS)
        states, state = np.empty((kept.size, up.size), dtype=np.float32), np.zeros(up.size, dtype=np.float32)
        for k, x in enumerate(task.u[kept]):
            state[x > up] = 1.0
            state[x < down] = 0.0
            states[k] = state
        u = task.u[kept]
        columns = np.hstack([np.ones((kept.size, 1)), -np.ones((kept.size, 1)), u[:, None], states])

        def predict(task: Task, stop: int) -> np.ndarray:
            fitted = np.flatnonzero(task.known[kept] & (kept < stop) & (kept >= task.train // 20))
            weights, _ = nnls(columns[fitted].astype(np.float64), task.z[kept[fitted]], maxiter=20 * columns.shape[1])
            return np.interp(np.arange(task.u.size), kept, columns @ weights)

        return predict

    return tuned(task, map(candidate, (10, 20)))


# ---- NARX ------------------------------------------------------------------------------------------------------------


def narx(task: Task) -> np.ndarray:
    """Polynomial NARX by forward regression (sysidentpy); it runs free from the end of the training part on."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    def candidate(degree: int, lags: int, every: int) -> Predict:
        u, z = task.u[::every, None], task.z[::every, None]
        turn = np.sign(np.diff(u, axis=0, prepend=u[:1]))
        inputs = np.hstack([u, turn])

        def predict(task: Task, stop: int) -> np.ndarray:
            first, last = task.train // 20 // every, stop // every
            model = FROLS(
                order_selection=False, n_terms=12, ylag=lags, xlag=[list(range(1, lags + 1)), [1]],
                estimator=LeastSquares(), basis_function=Polynomial(degree=degree),
            )  # fmt: skip
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                try:
                    model.fit(X=inputs[first:last], y=z[first:last])
                    start = last - model.max_lag
                    free = model.predict(X=inputs[start:], y=z[start : start + model.max_lag])
                except (ValueError, np.linalg.LinAlgError, OverflowError):
                    return np.full(task.u.size, np.inf)
            made = np.nan_to_num(np.concatenate([z[:start, 0], free[:, 0]]), nan=1.0)
            return np.interp(np.arange(task.u.size), every * np.arange(made.size), np.clip(made, -1.0, 1.0))

        return predict

    coarse = max(1, task.u.size // POINTS)
    choices = itertools.product((1, 2, 3), (1, 2), sorted({coarse, max(1, coarse // 4)}))
    return tuned(task, itertools.starmap(candidate, choices))


# ---- Trees -----------------------------------------------------------------------------------------------------------


def boosted_trees(task: Task) -> np.ndarray:
    """Histogram gradient boosting on the voltage, lagged voltages, rates and the last turns; beyond a line."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    every = max(1, task.u.size // (4 * POINTS))
    u = task.u[::every]
    lags = [lag for lag in LAGS if lag < u.size // 20]
    before = [u - np.concatenate([np.full(lag, u[0]), u[:-lag]]) for lag in lags]
    features = np.column_stack([u, *before, _last_turns(u)])

    def candidate(leaves: int, rate: float, columns: int) -> Predict:
        def predict(task: Task, stop: int) -> np.ndarray:
            fitted = np.flatnonzero(task.known[::every][: stop // every])
            line = np.polyfit(u[fitted], task.z[::every][fitted], 1)
            rest = task.z[::every][fitted] - np.polyval(line, u[fitted])
            chosen = features[:, : 1 + len(lags)] if columns else features
            model = HistGradientBoostingRegressor(
                max_iter=150, max_leaf_nodes=leaves, learning_rate=rate, random_state=0
            )
            made = np.polyval(line, u) + model.fit(chosen[fitted], rest).predict(chosen)
            return np.interp(np.arange(task.u.size), every * np.arange(u.size), made)

        return predict

    return tuned(task, itertools.starmap(candidate, itertools.product((8, 31), (0.1,), (0, 1))))


def _last_turns(u: np.ndarray, count: int = 3) -> np.ndarray:
    """Voltage of the last turns of at least 2 %, shape (samples, count)."""
    turns, low, high, rising = [u[0]] * count, u[0], u[0], True
    rows = np.empty((u.size, count))
    for k, x in enumerate(u):
        if rising:
            high = max(high, x)
            if x < high - 0.02:
                turns, low, rising = [high, *turns[:-1]], x, False
        else:
            low = min(low, x)
            if x > low + 0.02:
                turns, high, rising = [low, *turns[:-1]], x, True
        rows[k] = turns
    return rows


# ---- The comparison --------------------------------------------------------------------------------------------------

RIVALS: dict[str, Callable[[Task], np.ndarray]] = {
    "plays, lags": plays_with_lags,
    "Bouc-Wen": bouc_wen,
    "Preisach": preisach,
    "NARX": narx,
    "trees": boosted_trees,
}
NEEDS = {"NARX": "sysidentpy", "trees": "sklearn"}


def installed(name: str) -> bool:
    """Whether the package that this rival needs is there."""
    return name not in NEEDS or importlib.util.find_spec(NEEDS[name]) is not None


@dataclass(frozen=True)
class Compared:
    """A record, and the rms errors of all on its last part, % of its peak-to-peak displacement.

    Attributes
    ----------
    source : str
        Of the record.
    errors : dict of str to float
        Of the rivals, by name.
    identified : float
        Of `identify`.
    found : Identified
        What it found.
    """

    source: str
    errors: dict[str, float]
    identified: float
    found: Identified

    @property
    def ratio(self) -> float:
        """Error of `identify` over that of the best rival."""
        return self.identified / min(self.errors.values())


def compared(record: Record, rivals: Iterable[str] = tuple(RIVALS)) -> Compared:
    """Errors of a record in rows that are judged for all alike."""
    found = identify(record)
    trace = found.trace
    low, span = trace.volts.min(), np.ptp(trace.volts)
    scale = float(np.ptp(trace.displacement))
    task = Task(
        (trace.volts - low) / span, (trace.displacement - trace.displacement.mean()) / scale, trace.known,
        int(np.argmax(trace.held_out)),
    )  # fmt: skip
    judged = np.flatnonzero(trace.held_out & trace.known)
    first = judged[: round(ZERO * judged.size)] if np.diff(record.time).max() > ANOTHER_DAY else judged[:0]

    def percent(off: np.ndarray) -> float:
        zero = float(np.median(off[first])) if first.size else 0.0
        return 100 * float(np.sqrt(np.mean((off[judged] - zero) ** 2)))

    errors = {name: percent(RIVALS[name](task) - task.z) for name in rivals if installed(name)}
    errors = {name: error if np.isfinite(error) else np.inf for name, error in errors.items()}  # ran away
    return Compared(record.source, errors, percent(trace.residual / scale), found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", default="", help="only those whose description has this word")
    parser.add_argument("--unseen", action="store_true", help="the records of unseen_records.py in their place")
    parser.add_argument("--further", action="store_true", help="those of further_records.py")
    parser.add_argument("--other", action="store_true", help="those of other_records.py")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--skip", nargs="*", default=[], choices=RIVALS, help="leave these out")
    asked = parser.parse_args()
    names = [name for name in RIVALS if name not in asked.skip and installed(name)]
    sets = (asked.further, further_records), (asked.other, other_records), (asked.unseen, unseen_records)
    of = next((chosen for wanted, chosen in sets if wanted), foreign_records)
    print("| record |", " | ".join(names), "| `identify` | over the best | verdict |")
    print("|---" * (len(names) + 4) + "|")
    for record in of.records(asked.seed):
        if asked.records.lower() in record.source.lower():
            row = compared(record, names)
            values = [f"{row.errors[name]:.2f}" for name in names]
            own = f"{row.identified:.2f} | {row.ratio:.2f} | {row.found.verdict.level}"
            print(f"| {row.source} |", " | ".join(values), f"| {own} |", flush=True)


if __name__ == "__main__":
    main()
