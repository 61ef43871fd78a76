"""What a study says: shares with their intervals, quantiles, and what the failing runs have in common."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truestroke.base.verdict import Level, Verdict
from truestroke.studies.engine import Row, quantiles
from truestroke.studies.study.config import Study

FEW, MOST = 0.5, 0.95  # of the runs: fewer converge with any controller, and the study is bad; with each, doubtful
IMPOSSIBLE = 0.01, 0.2  # of the runs could not be simulated: doubtful, bad


@dataclass(frozen=True)
class Line:
    """One controller over all runs.

    Attributes
    ----------
    controller : str
        Its name.
    runs, converged : int
        How many, and how many of them converged.
    share, low, high : float
        Converged / runs, and its exact (Clopper-Pearson) 95 % interval.
    time : tuple of float, or None
        Median, 95th percentile and longest convergence time of those that converged, s.
    metrics : dict of str to tuple of float
        Median, 95th percentile and largest of what was recorded, over all runs.
    """

    controller: str
    runs: int
    converged: int
    share: float
    low: float
    high: float
    time: tuple[float, float, float] | None
    metrics: dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Informative:
    """How well one sampled number separates the runs that fail from the others.

    Attributes
    ----------
    name : str
        Of the number, in `Row.sampled`.
    higher : float
        Probability that it is higher in a run that failed than in one that converged (0.5: it is not informative).
    """

    name: str
    higher: float


def lines(study: Study, rows: Sequence[Row]) -> list[Line]:
    """One for each controller; not empty rows."""
    from scipy.stats import binomtest

    found = []
    for name in study.controllers:
        converged = [study.has_converged(row, name) for row in rows]
        interval = binomtest(sum(converged), len(rows)).proportion_ci(0.95, "exact")
        times = [row.metrics[name]["convergence_time"] for row, good in zip(rows, converged, strict=True) if good]
        metrics = {key: quantiles([row.metrics[name][key] for row in rows]) for key in study.record}
        share = sum(converged) / len(rows)
        time = quantiles(times) if times else None
        bounds = float(interval.low), float(interval.high)
        found.append(Line(name, len(rows), sum(converged), share, *bounds, time, metrics))
    return found


def informative(study: Study, rows: Sequence[Row], controller: str) -> list[Informative]:
    """All sampled numbers, the most informative first; empty where all runs converged, or none."""
    from scipy.stats import mannwhitneyu

    good = np.array([study.has_converged(row, controller) for row in rows])
    if good.all() or not good.any():
        return []
    found = []
    for name in rows[0].sampled:
        values = np.array([row.sampled[name] for row in rows])
        if np.ptp(values) > 0:
            higher = mannwhitneyu(values[~good], values[good]).statistic / (np.sum(good) * np.sum(~good))
            found.append(Informative(name, float(higher)))
    return sorted(found, key=lambda one: -abs(one.higher - 0.5))


def judge(study: Study, rows: Sequence[Row], failed: Sequence[Row] = ()) -> Verdict:
    """Whether the controllers converge on this distribution, and whether it can be simulated at all.

    Bad where no controller converges in half of the runs, or a fifth of them could not be simulated; doubtful where one
    converges in less than 95 %, or a hundredth could not be simulated.
    """
    findings: list[tuple[Level, str]] = []
    lost = len(failed) / (len(rows) + len(failed))
    if lost > IMPOSSIBLE[0]:
        text = f"{100 * lost:.3g} % of the runs could not be simulated."
        findings.append(("bad" if lost > IMPOSSIBLE[1] else "doubtful", text))
    found = lines(study, rows)
    level: Level = "bad" if max(line.share for line in found) < FEW else "doubtful"
    rare = [line for line in found if line.share < MOST]
    findings += [(level, f"{line.controller} converged in {100 * line.share:.2f} % of the runs.") for line in rare]
    return Verdict.of(findings)
