"""What one step costs: every step is timed by itself, so that the worst ones are seen."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

IDLE = 20_000  # calls of what is subtracted
WINDOWS, LONGEST = 50, 100  # the best mean is sought among so many windows of calls, none longer than that


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one step of something costs.

    Attributes
    ----------
    what : str
        "update" (of recursive least squares), "limit" (of the machine, for the same loads, stores and multiply-adds),
        "command", "tick" (command and adapt), or "axes" (of several axes, and learning from pass to pass).
    name : str
        Of the law or of whom it is: "paper", "default", "padasip FilterRLS", ...
    way : str
        "C", "Python, step by step", "Python, blocks of 1000": then the figures are those of a block, divided by 1000.
    variant : str
        Of the kernel: "avx2", ...; "" where there is none.
    plays, parameters : int
        Size of the problem; no plays where there is no controller.
    precision : str
        "double" or "single".
    best_ns : float
        Mean of the best window of steps: what it takes where nothing disturbs it. The figure to form ratios of.
    median_ns, p999_ns, worst_ns : float
        Of all steps, each timed by itself, ns, less what clock and loop take; they hold what else the machine does.
    steps : int
        That were timed.
    """

    what: str
    name: str
    way: str
    variant: str = ""
    plays: int
    parameters: int
    precision: str = "double"
    best_ns: float
    median_ns: float
    p999_ns: float
    worst_ns: float
    steps: int

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def time_steps(
    step: Callable[[int], object],
    steps: int,
    each: int = 1,
    idle: Callable[[int], object] = abs,
    **about: Any,
) -> Cost:
    """Time step(0), step(1), ..., one by one.

    Parameters
    ----------
    step : callable
        Is given the number of the step.
    steps : int
        How many are timed; a tenth of them goes before, to warm up.
    each : int
        Steps of whatever is measured in one call: the figures are divided by it.
    idle : callable
        What of a step does not belong to what is measured: its median time, clock included, is subtracted.
    **about
        What, name, way and the rest of `Cost`.

    Examples
    --------
    >>> time_steps(abs, 1000, what="update", name="abs", way="Python", plays=0, parameters=1).steps
    1000
    """
    for k in range(steps // 10):
        step(k)
    taken = np.maximum(_times(step, steps) - np.median(_times(idle, min(steps, IDLE))), 0.0) / each
    return of_times(taken, **about, steps=steps * each)


def _times(step: Callable[[int], object], steps: int) -> npt.NDArray[np.float64]:
    now, taken = time.perf_counter_ns, np.empty(steps)
    for k in range(steps):
        before = now()
        step(k)
        taken[k] = now() - before
    return taken


def of_times(taken: npt.ArrayLike, steps: int, **about: Any) -> Cost:
    """Return the cost that follows from the times of single calls, ns.

    Examples
    --------
    >>> of_times([100.0, 100.0, 400.0], 3, what="update", name="mine", way="C", plays=0, parameters=16).median_ns
    100.0
    """
    ns = np.asarray(taken, float)
    window = max(1, min(LONGEST, ns.size // WINDOWS))
    best = ns[: ns.size - ns.size % window].reshape(-1, window).mean(axis=1).min()
    median, p999, worst = (float(q) for q in np.quantile(ns, [0.5, 0.999, 1.0]))
    return Cost(**about, best_ns=float(best), median_ns=median, p999_ns=p999, worst_ns=worst, steps=steps)
