"""Robustness as a study: its runs, one of them by itself, and the table of what came out."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.verdict import Level, Verdict
from truestroke.control.controller import AdaptiveController
from truestroke.plant import RealisticPlant
from truestroke.runtime import loop
from truestroke.signals.recording import Recording
from truestroke.studies import engine
from truestroke.studies.engine import Channels, Number, Row, Run, Store, StudyError, quantiles
from truestroke.studies.engine.executors import threads
from truestroke.studies.robustness.metrics import METRICS, SHOCK, START, metrics
from truestroke.studies.robustness.sample import CONTROLLERS, plant_of, sample

HALVES = {"all": (0, 1), "seen": (0, 2), "unseen": (1, 2)}  # first number and step
LIMIT = 0.25  # um: the largest error that a run may have
MANY = 0.2  # of the runs with a larger one: bad
NAMES = {"adaptive": "default", "paper": "the paper"}
LEFT_OUT = f"the first {START:g} s and the {1e3 * SHOCK:g} ms after a change"


@dataclass(frozen=True, kw_only=True)
class Robustness:
    """The study: actuators of a stated distribution under the default controller and the paper's.

    Attributes
    ----------
    seed : int
        Of all that is sampled.
    numbers : sequence of int
        Of the runs.
    controllers : tuple of str
        Of `CONTROLLERS`.
    settings : mapping
        Of the adaptive controller, for trying others.
    """

    seed: int = 0
    numbers: Sequence[int] = range(200)
    controllers: tuple[str, ...] = tuple(CONTROLLERS)
    settings: Mapping[str, Any] = field(default_factory=dict)

    def identity(self) -> dict[str, Any]:
        """Everything but how many there are."""
        return {"kind": "robustness", "seed": self.seed, "controllers": self.controllers, "settings": self.settings}

    def sample(self, number: int) -> Run:
        """The run of this number."""
        return sample(self.seed, number, self.controllers, **self.settings)

    def metrics(self, run: Run, channels: Channels) -> dict[str, Number]:
        """How well it was followed."""
        return metrics(run, channels)


def numbers(plants: int, half: str = "all") -> range:
    """Numbers of the runs: the even ones are seen, for tuning; the odd ones are looked at when all is decided.

    Examples
    --------
    >>> list(numbers(6, "seen")), list(numbers(6, "unseen"))
    ([0, 2, 4], [1, 3, 5])
    """
    if half not in HALVES:
        raise SettingError("half", repr(half), f"one of {', '.join(HALVES)}")
    start, step = HALVES[half]
    return range(start, checks.count("plants", plants, 1, 1_000_000), step)


def run(study: Robustness, workers: int = 2, progress: Callable[[int, int], None] | None = None) -> list[Row]:
    """Simulate all runs of the study; nothing is kept on the disk.

    Parameters
    ----------
    study : Robustness
        Which.
    workers : int
        Threads.
    progress : callable, optional
        Called as progress(runs done, all runs).

    Returns
    -------
    list of Row
        In the order of their numbers; the same for any number of workers.

    Raises
    ------
    StudyError
        A simulation failed.
    """
    engine.first(study, study.numbers)  # wrong settings are reported at once
    with Store(":memory:", study) as store:
        engine.run(study, store, threads(workers), progress)
        end = max(study.numbers) + 1
        for row in store.failed(end):
            raise StudyError(f"run {row.number}: {row.error}")
        return store.rows(end)


def record(
    seed: int, number: int, controller: str = "adaptive", without: Sequence[str] = (), **settings: Any
) -> Recording:
    """Simulate one run.

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
    one = sample(seed, number, [controller], **settings)
    plant = RealisticPlant(plant_of(one).without(*without), one.seed, one.dropouts)
    recording = loop.run(one.trajectory, AdaptiveController.from_settings(one.controllers[controller]), plant)
    about = {"seed": seed, "number": number, "what": one.sampled["what"], "without": list(without)}
    return Recording(recording.channels, recording.metadata | {"robustness": about})


@dataclass(frozen=True)
class Line:
    """Median, 95th percentile and worst of one metric over the runs, um; as ratios to `paper`, run by run, too.

    Attributes
    ----------
    metric, controller : str
        Names, as in `METRICS` and `CONTROLLERS`.
    runs : int
        How many have that metric.
    median, p95, worst : float
        um.
    ratio : tuple[float, float, float] or None
        Median, 95th percentile and largest of the metric over the same run's metric of the paper's controller.
    """

    metric: str
    controller: str
    runs: int
    median: float
    p95: float
    worst: float
    ratio: tuple[float, float, float] | None


def lines(rows: Iterable[Row]) -> list[Line]:
    """The table: metric by metric, controller by controller."""
    rows = list(rows)
    found = []
    for metric in METRICS:
        for controller in rows[0].metrics:
            having = [row.metrics for row in rows if row.metrics[controller][metric] is not None]
            values = [metrics[controller][metric] for metrics in having]
            ratio = None
            if values and "paper" in rows[0].metrics and controller != "paper":
                ratio = quantiles([m[controller][metric] / m["paper"][metric] for m in having])  # type: ignore[operator]
            if values:
                found.append(Line(metric, controller, len(values), *quantiles(values), ratio))
    return found


def values(rows: Iterable[Row], controller: str, metric: str) -> list[float]:
    """One metric of all runs that have it, um."""
    found = (row.metrics[controller][metric] for row in rows)
    return [value for value in found if value is not None]


def beyond(rows: Sequence[Row], controller: str = "adaptive") -> tuple[int, int]:
    """How many runs have an error above `LIMIT`, and how many of them even without what rings freely after a change."""
    pairs = list(zip(values(rows, controller, "largest"), values(rows, controller, "ringing"), strict=True))
    return sum(largest > LIMIT for largest, _ in pairs), sum(largest > LIMIT + rings for largest, rings in pairs)


def sentence(rows: Sequence[Row], controller: str) -> str:
    """How many runs have an error above the limit."""
    above, beyond_ringing = beyond(rows, controller)
    text = f"{NAMES[controller].capitalize()}: {above} of {len(rows)} runs have an error above {LIMIT:g} um, "
    text += f"{LEFT_OUT} left out"
    if above > beyond_ringing:
        text += f"; in {above - beyond_ringing} of them it is free ringing after the jump of the change"
    outside = values(rows, controller, "left_out")
    return f"{text}. In the times left out {sum(e > LIMIT for e in outside)} have one, up to {max(outside):.2f} um."


def judge(rows: Sequence[Row]) -> Verdict:
    """Whether the first of the controllers is robust: no run beyond `LIMIT`, but for what rings freely.

    Bad where a fifth of the runs or more have a larger error, doubtful where any has.
    """
    controller = next(iter(rows[0].metrics))
    _, above = beyond(rows, controller)
    level: Level = "bad" if above >= MANY * len(rows) else "doubtful"
    text = f"{NAMES[controller].capitalize()}: {above} of {len(rows)} runs have an error above {LIMIT:g} um"
    return Verdict.of([(level, f"{text} that is not free ringing.")] if above else [])
