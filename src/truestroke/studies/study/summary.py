"""What a study says: shares with their intervals, quantiles, and what the failing runs have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.studies.study.config import Study
from truestroke.studies.study.play import Row


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
    figures : dict of str to tuple of float
        Median, 95th percentile and largest of what was recorded, over all runs.
    """

    controller: str
    runs: int
    converged: int
    share: float
    low: float
    high: float
    time: tuple[float, float, float] | None
    figures: dict[str, tuple[float, float, float]]

    def as_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Telling:
    """How well one drawn number tells the runs that fail from the others.

    Attributes
    ----------
    name : str
        Of the number, in `Row.told`.
    higher : float
        Probability that it is higher in a run that failed than in one that converged (0.5: it tells nothing).
    """

    name: str
    higher: float

    @property
    def strength(self) -> float:
        """0 to 0.5: distance of `higher` from 0.5."""
        return abs(self.higher - 0.5)


def lines(study: Study, rows: Sequence[Row]) -> list[Line]:
    """One for each controller; not empty rows."""
    from scipy.stats import binomtest

    found = []
    for name in study.controllers:
        converged = [row.converged(study, name) for row in rows]
        interval = binomtest(sum(converged), len(rows)).proportion_ci(0.95, "exact")
        times = [row.figures[name]["convergence_time"] for row, good in zip(rows, converged, strict=True) if good]
        figures = {key: _three([row.figures[name][key] for row in rows]) for key in study.record}
        share = sum(converged) / len(rows)
        time = _three(times) if times else None
        bounds = float(interval.low), float(interval.high)
        found.append(Line(name, len(rows), sum(converged), share, *bounds, time, figures))
    return found


def telling(study: Study, rows: Sequence[Row], controller: str) -> list[Telling]:
    """All drawn numbers, the most telling first; empty where all runs converged, or none."""
    from scipy.stats import mannwhitneyu

    good = np.array([row.converged(study, controller) for row in rows])
    if good.all() or not good.any():
        return []
    found = []
    for name in rows[0].told:
        values = np.array([row.told[name] for row in rows])
        if np.ptp(values) > 0:
            higher = mannwhitneyu(values[~good], values[good]).statistic / (np.sum(good) * np.sum(~good))
            found.append(Telling(name, float(higher)))
    return sorted(found, key=lambda one: -one.strength)


def _three(values: Sequence[float | None]) -> tuple[float, float, float]:
    return tuple(float(q) for q in np.quantile(np.array(values, float), [0.5, 0.95, 1.0]))  # type: ignore[return-value]
