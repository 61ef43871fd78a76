"""Robustness as a study: its metrics, its runs, one of them by itself, and the table of what came out."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control.controller import AdaptiveController
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.runtime import loop
from truestroke.signals.metrics import rmse
from truestroke.signals.recording import Recording
from truestroke.studies import engine
from truestroke.studies.engine import Channels, Number, Row, Run, Store, Study, StudyError, quantiles
from truestroke.studies.engine.executors import threads
from truestroke.studies.robustness.sample import CONTROLLERS, SAMPLE_RATE, change_tick, plant_of, sample

SETTLED = 0.1  # s after a change that the rmse leaves out
SHOCK = 0.05  # s after a change that the largest error leaves out
LONG_AFTER = 0.5  # s after a change that its own rmse ends
START = 0.5  # s that the largest error leaves out
METRICS = {  # name -> in a table
    "rmse": "rmse, second half",
    "maximum": "maximum, second half",
    "after_change": "rmse 0.1-0.5 s after a change",
    "cold": "rmse 0.75-1 s from a cold start",
    "largest": "largest error that counts",
    "left_out": "largest in the times left out",
}
HALVES = {"all": (0, 1), "seen": (0, 2), "unseen": (1, 2)}  # first number and step
LIMIT = 0.25  # um: the largest error that a run may have
MANY = 0.2  # of the runs with a larger one: bad
NAMES = {"adaptive": "default", "paper": "the paper"}
LEFT_OUT = f"the first {START:g} s and the {1e3 * SHOCK:g} ms after a change"


def metrics(run: Run, channels: Channels) -> dict[str, Number]:
    """How well one controller followed in one run; errors are true minus desired displacement, um.

    Parameters
    ----------
    run : Run
        Of `sample`.
    channels : mapping
        time, desired, true, volts and flags of the run, or its recording.

    Returns
    -------
    dict
        rmse and maximum, um: over the second half of the motion, without the 0.1 s after a change. after_change, um:
        rmse from 0.1 to 0.5 s after the change, or None. cold, um: rmse from 0.75 to 1 s after a cold start. largest,
        um, and largest_at, s: largest error anywhere, but for the first 0.5 s and for 50 ms after a change. left_out,
        um: largest error in what `largest` leaves out. ringing, um: what of `largest` no controller can take away: the
        change makes the displacement jump by J, and the resonance rings with it; abs(J) exp(-zeta w 50 ms) remains when
        the errors count again; 0 without a change. changes: how many sudden changes the controller found.
    """
    desired, true, time = channels["desired"], channels["true"], channels["time"]
    plant = plant_of(run)
    error, ticks, change = np.abs(true - desired), np.arange(time.size), change_tick(plant)
    since = ticks - change if change is not None else np.full(time.size, -1)
    settled, shock, long_after = (round(seconds * SAMPLE_RATE) for seconds in (SETTLED, SHOCK, LONG_AFTER))
    middle = (round(run.sampled["begin"] * SAMPLE_RATE) + time.size) // 2
    half = (ticks >= middle) & ~((since >= 0) & (since < settled))
    after, cold = (since >= settled) & (since < long_after), (time >= 0.75) & (time < 1.0)
    counts = (time >= START) & ~((since >= 0) & (since < shock))
    counted = np.where(counts, error, 0.0)
    worst = int(np.argmax(counted))
    return {
        "rmse": rmse(desired[half], true[half]),
        "maximum": float(error[half].max()),
        "after_change": rmse(desired[after], true[after]) if after.any() else None,
        "cold": rmse(desired[cold], true[cold]),
        "largest": float(counted[worst]),
        "largest_at": float(time[worst]),
        "left_out": float(error[~counts].max(initial=0.0)),
        "ringing": _ringing(plant, change, channels["volts"]),
        "changes": int(np.count_nonzero(channels["flags"] & BIT["changed"])),
    }


def _ringing(plant: PlantSettings, change: int | None, volts: FloatArray) -> float:
    """abs(J) exp(-zeta w 50 ms), um; J from the same voltages on the massless plant with and without the change."""
    if change is None:
        return 0.0
    still = plant.without("resonance", "noise", "lag")
    jump = []
    for settings in (still, still.without("change")):
        massless = RealisticPlant(settings)
        massless.exchange(volts[: change + 1])
        jump.append(massless.truth[change])
    decay = plant.damping * 2 * np.pi * plant.resonance * SHOCK
    return float(abs(jump[0] - jump[1]) * np.exp(-decay))


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

    def metrics(self, run: Run, _: str, channels: Channels) -> dict[str, Number]:
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


def run(
    study: Study,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
    *,
    file: str | Path = ":memory:",
    with_refused: bool = False,
) -> list[Row]:
    """Simulate the runs of the study that `file` does not have.

    Parameters
    ----------
    study : Study
        Which, such as a `Robustness`.
    workers : int
        Threads.
    progress : callable, optional
        Called as progress(runs done, all runs).
    file : path
        The store that rows are kept in as they come, SQLite; by default nothing is kept on the disk.
    with_refused : bool
        Whether samples that were refused are rows with their error; else the first is an exception.

    Returns
    -------
    list of Row
        In the order of their numbers; the same for any number of workers.

    Raises
    ------
    StudyError
        A simulation failed, or a sample was refused: the first one, or, `with_refused`, where each was.
    """
    engine.first(study, study.numbers)  # wrong settings are reported at once
    with Store(file, study) as store:
        engine.run(study, store, threads(workers), progress)
        end = max(study.numbers) + 1
        asked = set(study.numbers)
        refused = [row for row in store.failed(end) if row.number in asked]
        if refused and not (with_refused and len(refused) < len(asked)):
            raise StudyError(f"run {refused[0].number}: {refused[0].error}")
        done = [row for row in store.rows(end) if row.number in asked]
        return sorted([*done, *refused], key=lambda row: row.number)


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
