"""A batch of run numbers in, rows out: the work that every executor hands round."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

import truestroke
from truestroke.base.errors import TruestrokeError
from truestroke.runtime.batch import Simulation, SimulationError, simulate_many
from truestroke.studies.study.config import Study
from truestroke.studies.study.draw import draw
from truestroke.studies.study.figures import FIGURES, Channels, convergence_time

Number = float | None


@dataclass(frozen=True)
class Row:
    """What is kept of a run.

    Attributes
    ----------
    number : int
        Which.
    told : dict of str to float
        What was drawn, `Run.told`.
    figures : dict of str to dict
        By controller: "convergence_time" (s, None if it never settles) and what the study records.
    error : str
        Why there is nothing of the above: the draw cannot be, or its simulation failed; empty for all others.
    """

    number: int
    told: dict[str, float]
    figures: dict[str, dict[str, Number]]
    error: str = ""

    def converged(self, study: Study, controller: str) -> bool:
        """Whether that controller settled to `study.level` within `study.within`."""
        settled = self.figures[controller]["convergence_time"]
        return settled is not None and settled <= study.within


@dataclass(frozen=True)
class Batch:
    """Rows, and what they cost.

    Attributes
    ----------
    rows : list of Row
        In the order of their numbers.
    seconds : dict of str to float
        By part, time of the processor: "draw", and each controller with its plant and figures.
    ticks : int
        Of controller and plant.
    versions : dict of str to str
        Of what made them.
    """

    rows: list[Row]
    seconds: dict[str, float]
    ticks: int
    versions: dict[str, str] = field(default_factory=lambda: versions())

    def as_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, known: Mapping[str, Any]) -> Batch:
        """Back from `as_dict`."""
        return cls(**{**known, "rows": [Row(**row) for row in known["rows"]]})


class StudyError(TruestrokeError, RuntimeError):
    """An executor did not do its work, or a simulation failed that should not; the message says why."""


def versions() -> dict[str, str]:
    """Of what decides the bits of a row."""
    return {"truestroke": truestroke.__version__, "numpy": np.__version__}


def play(study: Study, numbers: Iterable[int]) -> Batch:
    """Draw and run these, one after the other on one core.

    A draw that is out of bounds, or whose simulation finds it so, is a row with the error.

    Raises
    ------
    StudyError
        A simulation failed for a reason that lies not in the draw.
    """
    rows: list[Row] = []
    seconds: Counter[str] = Counter()
    ticks = 0
    for number in numbers:
        try:
            row, spent, ran = _play(study, number)
        except (ValueError, ArithmeticError, SimulationError) as error:
            why = error.__cause__ or error
            if not isinstance(why, (ValueError, ArithmeticError)):  # no fault of the draw
                raise StudyError(f"run {number} of the study: {type(why).__name__}: {why}") from error
            row, spent, ran = Row(number, {}, {}, " ".join(str(why).split())), {}, 0
        rows.append(row)
        seconds.update(spent)
        ticks += ran
    return Batch(rows, dict(seconds), ticks)


def _play(study: Study, number: int) -> tuple[Row, dict[str, float], int]:
    start = time.thread_time()
    run = draw(study, number)
    seconds = {"draw": time.thread_time() - start}
    figures: dict[str, dict[str, Number]] = {}
    for name, controller in run.controllers.items():
        one = Simulation(trajectory=run.trajectory, controller=controller, plant=run.plant, seed=run.seed)
        figures[name], seconds[name] = simulate_many([one], reduce=partial(_figures, study), threads=1).results[0]
    return Row(number, run.told, figures), seconds, len(run.trajectory) * len(figures)


def _figures(study: Study, _: int, channels: Channels) -> tuple[dict[str, Number], float]:
    """What is kept, and the processor time of this thread, which was made for this simulation."""
    kept: dict[str, Number] = {"convergence_time": convergence_time(channels, study.level)}
    kept |= {name: FIGURES[name].of(channels) for name in study.record}
    return kept, time.thread_time()
