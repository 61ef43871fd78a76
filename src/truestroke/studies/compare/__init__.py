"""Comparison of eight controllers on the same actuator and the same waves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from truestroke.control.settings import ControllerSettings
from truestroke.plant import RealisticPlant
from truestroke.runtime.loop import Actuator
from truestroke.signals.trajectories import random_wave, sine
from truestroke.studies.compare.rivals import Rival, Workbench, prepare
from truestroke.studies.compare.table import Row, compare, judge
from truestroke.studies.tracking import STROKE, VOLTAGE_LIMITS

__all__ = ["Comparison", "Rival", "Row", "Workbench", "compare", "judge", "prepare", "run"]

SAMPLE_RATE = 2000.0  # Hz
SINE = 8.0  # Hz
RIVALS = 8


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `run` found.

    Attributes
    ----------
    rows : list of Row
        Controller by controller, each with the random wave and the sine.
    rivals : list of Rival
        The controllers in the same order, with source and tuning.
    """

    rows: list[Row]
    rivals: list[Rival]

    def as_dict(self) -> dict[str, Any]:
        """All metrics and settings as plain numbers and text, for JSON."""
        return {
            **judge(self.rows).as_dict(),
            "rivals": [{"controller": r.name, "source": r.source, "tuning": r.tuning} for r in self.rivals],
            "rows": [row.as_dict() for row in self.rows],
        }


def run(
    seed: int = 0,
    duration: float = 20.0,
    plant: Callable[[int], Actuator] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Identify and tune all controllers, then compare them on a random wave of 20 Hz and a sine of 8 Hz.

    Parameters
    ----------
    seed : int
        Of the random wave and of the actuator's noise in the comparison; identification and tuning have others.
    duration : float
        Of the random wave, s; the sine takes an eighth of it, at least 2 s.
    plant : callable, optional
        Gives the actuator for a seed; by default `truestroke.plant.RealisticPlant`.
    progress : callable, optional
        Called as progress(steps done, all steps).
    """
    make_actuator = plant or (lambda seed: RealisticPlant(seed=seed))
    waves = [
        random_wave(duration=duration, sample_rate=SAMPLE_RATE, seed=seed),
        sine(frequency=SINE, peak_to_peak=24.0, duration=max(duration / 8, 2.0), sample_rate=SAMPLE_RATE),
    ]
    settings = ControllerSettings(sample_rate=SAMPLE_RATE, stroke=STROKE, voltage_limits=VOLTAGE_LIMITS)
    bench = Workbench(actuator=make_actuator(seed + 1), settings=settings, seed=seed + 1)
    ready, steps = [], RIVALS * (1 + len(waves))
    for rival in prepare(bench):
        ready.append(rival)
        if progress:
            progress(len(ready), steps)
    done = len(ready)
    rows = compare(
        lambda: make_actuator(seed),
        waves,
        {rival.name: rival.make for rival in ready},
        None if progress is None else lambda k, _: progress(done + k, steps),
    )
    return Comparison(rows, ready)
