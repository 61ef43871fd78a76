"""A study is a distribution of runs and what is measured of each; a batch of run numbers in, rows out."""

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np

import truestroke
from truestroke.base.errors import TruestrokeError
from truestroke.control.settings import ControllerSettings
from truestroke.plant import MatchedSettings, PlantSettings, StageSettings
from truestroke.runtime.batch import Simulation, SimulationError, simulate_many
from truestroke.signals.trajectories import Trajectory

Channels = Mapping[str, Any]
Number = float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """One sample of a distribution: all that a simulation needs.

    Attributes
    ----------
    number : int
        Which.
    seed : int
        Of the sensor noise.
    plant : MatchedSettings, PlantSettings or StageSettings
        The actuator.
    trajectory : Trajectory
        The desired motion.
    controllers : dict of str to ControllerSettings
        By name.
    sampled : dict
        What was sampled, by name, and what follows from it.
    dropouts : tuple of (int, int)
        Bursts without a measurement: first tick of each, and the first after it.
    """

    number: int
    seed: int
    plant: MatchedSettings | PlantSettings | StageSettings
    trajectory: Trajectory
    controllers: dict[str, ControllerSettings]
    sampled: dict[str, Any]
    dropouts: tuple[tuple[int, int], ...] = ()

    def simulation(self, controller: str) -> Simulation:
        """With one of its controllers."""
        return Simulation(
            trajectory=self.trajectory,
            controller=self.controllers[controller],
            plant=self.plant,
            seed=self.seed,
            dropouts=self.dropouts,
        )


class Study(Protocol):
    """A distribution, and the metrics of a run. It can be pickled: executors send it to other processes."""

    @property
    def numbers(self) -> Sequence[int]:
        """Of the runs."""

    @property
    def controllers(self) -> Iterable[str]:
        """Names, the same in each run."""

    def identity(self) -> dict[str, Any]:
        """What results of this study depend on, for JSON: a store belongs to it."""

    def sample(self, number: int) -> Run:
        """The run of this number: a function of the study and the number alone."""

    def metrics(self, run: Run, controller: str, channels: Channels) -> dict[str, Number]:
        """What is kept of a run with one of its controllers; `channels` are those of `simulate_many`."""


@dataclass(frozen=True)
class Row:
    """What is kept of a run.

    Attributes
    ----------
    number : int
        Which.
    sampled : dict
        What was sampled, `Run.sampled`.
    metrics : dict of str to dict
        By controller: the metrics of the study.
    error : str
        Why there is nothing of the above: the sample is out of bounds, or its simulation failed; empty for all others.
    """

    number: int
    sampled: dict[str, Any]
    metrics: dict[str, dict[str, Number]]
    error: str = ""


@dataclass(frozen=True)
class Batch:
    """Rows, and what they cost.

    Attributes
    ----------
    rows : list of Row
        In the order of their numbers.
    seconds : dict of str to float
        By part, time of the processor: "sample", and each controller with its plant and metrics.
    ticks : int
        Of controller and plant.
    versions : dict of str to str
        Of what made them.
    """

    rows: list[Row]
    seconds: dict[str, float]
    ticks: int
    versions: dict[str, str] = field(default_factory=lambda: versions())


class StudyError(TruestrokeError, RuntimeError):
    """An executor did not do its work, or a simulation failed that should not; the message says why."""


def versions() -> dict[str, str]:
    """Of what decides the bits of a row."""
    return {"truestroke": truestroke.__version__, "numpy": np.__version__}


def simulate(study: Study, numbers: Iterable[int]) -> Batch:
    """Sample and run these, one after the other on one core.

    A sample that is out of bounds, that is refused, or whose simulation finds it so, is a row with the error.

    Raises
    ------
    StudyError
        A simulation failed for another reason than its sample.
    """
    rows: list[Row] = []
    seconds: Counter[str] = Counter()
    ticks = 0
    for number in numbers:
        try:
            row, spent, ran = _simulate(study, number)
        except (ValueError, ArithmeticError, TruestrokeError) as error:
            why = error.__cause__ or error
            if isinstance(error, SimulationError) and not isinstance(why, (ValueError, ArithmeticError)):
                raise StudyError(f"run {number} of the study: {type(why).__name__}: {why}") from error
            row, spent, ran = Row(number, {}, {}, " ".join(str(why).split())), {}, 0
        rows.append(row)
        seconds.update(spent)
        ticks += ran
    return Batch(rows, dict(seconds), ticks)


def _simulate(study: Study, number: int) -> tuple[Row, dict[str, float], int]:
    start = time.thread_time()
    run = study.sample(number)
    seconds = {"sample": time.thread_time() - start}
    metrics: dict[str, dict[str, Number]] = {}
    for name in run.controllers:
        reduce = partial(_metrics, study, run, name)
        metrics[name], seconds[name] = simulate_many([run.simulation(name)], reduce=reduce, threads=1).results[0]
    return Row(number, run.sampled, metrics), seconds, len(run.trajectory) * len(metrics)


def _metrics(study: Study, run: Run, controller: str, _: int, channels: Channels) -> tuple[dict[str, Number], float]:
    """What is kept, and the processor time of this thread, which was made for this simulation."""
    return study.metrics(run, controller, channels), time.thread_time()


def quantiles(values: Sequence[float | None]) -> tuple[float, float, float]:
    """Median, 95th percentile and largest.

    Examples
    --------
    >>> quantiles([3.0, 1.0, 2.0])
    (2.0, 2.9, 3.0)
    """
    return tuple(float(q) for q in np.quantile(np.array(values, float), [0.5, 0.95, 1.0]))  # type: ignore[return-value]
