"""All runs of the zoo, each controller on the same plants and motions, in parallel; and the table of what came out."""

from __future__ import annotations

import dataclasses
import signal
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.controller import AdaptiveController
from truestroke.runtime import loop
from truestroke.signals.recording import Recording
from truestroke.studies.zoo.draw import SAMPLE_RATE, STROKE, VOLTAGE_LIMITS, draw
from truestroke.studies.zoo.figures import Figures, as_dict, figures

CONTROLLERS = ("adaptive", "paper")
HALVES = ("all", "seen", "unseen")
LIMIT = 0.25  # um: the largest error that a run may have
COLUMNS = {  # name of the figure -> words
    "rmse": "rmse, second half",
    "maximum": "maximum, second half",
    "after_change": "rmse 0.1-0.5 s after a change",
    "cold": "rmse 0.75-1 s from a cold start",
    "largest": "largest error that counts",
    "left_out": "largest in what is left out",
}


@dataclass(frozen=True)
class Result:
    """One run of the zoo.

    Attributes
    ----------
    number : int
        Which.
    words : str
        What happened in it.
    figures : dict of str to Figures
        By controller.
    """

    number: int
    words: str
    figures: dict[str, Figures]

    def as_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {"number": self.number, "what": self.words} | {k: as_dict(f) for k, f in self.figures.items()}


@dataclass(frozen=True)
class Line:
    """Median, 95th percentile and worst of one figure over the zoo, um; as ratios to `paper`, run by run, too.

    Attributes
    ----------
    figure, controller : str
        Names, as in `COLUMNS` and `CONTROLLERS`.
    runs : int
        How many have that figure.
    median, p95, worst : float
        um.
    ratio : tuple[float, float, float] or None
        Median, 95th percentile and largest of the figure over the same run's figure of the paper's controller.
    """

    figure: str
    controller: str
    runs: int
    median: float
    p95: float
    worst: float
    ratio: tuple[float, float, float] | None

    def as_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return dataclasses.asdict(self)


def numbers(plants: int, half: str = "all") -> list[int]:
    """Numbers of the runs: the even ones are seen, for tuning; the odd ones are looked at when all is decided.

    Examples
    --------
    >>> numbers(6, "seen"), numbers(6, "unseen")
    ([0, 2, 4], [1, 3, 5])
    """
    if half not in HALVES:
        raise SettingError("half", repr(half), f"one of {', '.join(HALVES)}")
    start, step = {"all": (0, 1), "seen": (0, 2), "unseen": (1, 2)}[half]
    return list(range(start, checks.count("plants", plants, 1, 1_000_000), step))


def record(
    seed: int, number: int, controller: str = "adaptive", without: Sequence[str] = (), **settings: Any
) -> Recording:
    """Play one run.

    Parameters
    ----------
    seed, number : int
        Which.
    controller : str
        One of `CONTROLLERS`.
    without : sequence of str
        Effects of the plant that are switched off, as in `truestroke.plant.EFFECTS`.
    **settings
        Of `AdaptiveController`, for trying others.
    """
    drawn = draw(seed, number)
    known: dict[str, Any] = {"sample_rate": SAMPLE_RATE, "stroke": STROKE, "voltage_limits": VOLTAGE_LIMITS}
    if controller not in CONTROLLERS:
        raise SettingError("controller", repr(controller), f"one of {', '.join(CONTROLLERS)}")
    made = AdaptiveController.paper(**known) if controller == "paper" else AdaptiveController(**known, **settings)
    recording = loop.run(drawn.trajectory, made, drawn.actuator(*without))
    about = {"seed": seed, "number": number, "what": drawn.words(), "without": list(without)}
    return Recording(recording.channels, recording.metadata | {"zoo": about})


def play(seed: int, number: int, controllers: Sequence[str] = CONTROLLERS, **settings: Any) -> Result:
    """One run with each of the controllers; `settings` are those of the adaptive one."""
    drawn = draw(seed, number)
    changed = {name: settings if name == "adaptive" else {} for name in controllers}
    found = {name: figures(drawn, record(seed, number, name, **changed[name])) for name in controllers}
    return Result(number, drawn.words(), found)


def run(
    plants: int = 200,
    seed: int = 0,
    controllers: Sequence[str] = CONTROLLERS,
    half: str = "all",
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
    **settings: Any,
) -> list[Result]:
    """The zoo.

    Parameters
    ----------
    plants : int
        How many there are; their numbers are 0 to plants - 1.
    seed : int
        Of the zoo.
    controllers : sequence of str
        Of `CONTROLLERS`.
    half : str
        "all", or "seen" (even numbers) or "unseen" (odd ones).
    workers : int
        Processes.
    progress : callable, optional
        Called as progress(runs done, all runs).
    **settings
        Of the adaptive controller, for trying others.

    Returns
    -------
    list of Result
        In the order of their numbers; the same for any number of workers.
    """
    chosen = numbers(plants, half)
    results: list[Result] = []
    if checks.count("workers", workers, 1, 1024) == 1:
        for number in chosen:
            results.append(play(seed, number, controllers, **settings))
            if progress:
                progress(len(results), len(chosen))
        return results
    with ProcessPoolExecutor(workers, mp_context=get_context("forkserver"), initializer=_leave_ctrl_c) as pool:
        jobs = [pool.submit(play, seed, number, controllers, **settings) for number in chosen]
        try:
            for job in as_completed(jobs):
                results.append(job.result())
                if progress:
                    progress(len(results), len(chosen))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return sorted(results, key=lambda result: result.number)


def _leave_ctrl_c() -> None:
    """To the process that asked: it stops the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def lines(results: Iterable[Result]) -> list[Line]:
    """The table: figure by figure, controller by controller."""
    results = list(results)
    found = []
    for figure in COLUMNS:
        for controller in results[0].figures:
            values, ratios = [], []
            for result in results:
                value = getattr(result.figures[controller], figure)
                if value is None:
                    continue
                values.append(value)
                if "paper" in result.figures and controller != "paper":
                    ratios.append(value / getattr(result.figures["paper"], figure))
            if values:
                ratio = _three(ratios) if ratios else None
                found.append(Line(figure, controller, len(values), *_three(values), ratio))
    return found


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    return tuple(float(q) for q in np.quantile(values, [0.5, 0.95, 1.0]))  # type: ignore[return-value]


def beyond(results: Iterable[Result], controller: str = "adaptive") -> tuple[int, int]:
    """How many runs have an error above `LIMIT`, and how many of them even without what rings freely after a change."""
    found = [result.figures[controller] for result in results]
    return sum(f.largest > LIMIT for f in found), sum(f.largest > LIMIT + f.ringing for f in found)
