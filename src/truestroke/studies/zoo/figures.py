"""The figures of one run, all of the true displacement."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.plant import RealisticPlant
from truestroke.signals.metrics import rmse
from truestroke.signals.recording import Recording
from truestroke.studies.zoo.draw import SAMPLE_RATE, Run

SETTLED = 0.1  # s after a change that the rmse leaves out
SHOCK = 0.05  # s after a change that the largest error leaves out
LONG_AFTER = 0.5  # s after a change that its own rmse ends
START = 0.5  # s that the largest error leaves out


@dataclass(frozen=True, kw_only=True)
class Figures:
    """How well one controller followed in one run; errors are true minus desired displacement, um.

    Attributes
    ----------
    rmse : float
        Over the second half of the motion, without the 0.1 s after a change.
    maximum : float
        Largest error there.
    after_change : float or None
        rmse from 0.1 to 0.5 s after the change.
    cold : float
        rmse from 0.75 to 1 s after a cold start.
    largest : float
        Largest error anywhere, but for the first 0.5 s and for 50 ms after a change.
    largest_at : float
        When, s.
    left_out : float
        Largest error in what `largest` leaves out: the first 0.5 s, and the 50 ms after a change.
    ringing : float
        What of `largest` no controller can take away: the change makes the displacement jump by J, and the resonance
        rings with it; abs(J) exp(-zeta w 50 ms) is left when the errors count again. Without a change 0.
    changes : int
        How often the controller noticed a change.
    """

    rmse: float
    maximum: float
    after_change: float | None
    cold: float
    largest: float
    largest_at: float
    left_out: float
    ringing: float
    changes: int


def figures(run: Run, recording: Recording) -> Figures:
    """The figures of a recording of this run."""
    desired, true, time = recording["desired"], recording["true"], recording["time"]
    error, ticks = np.abs(true - desired), np.arange(time.size)
    since = ticks - run.change_tick if run.change_tick is not None else np.full(time.size, -1)
    settled, shock, long_after = (round(seconds * SAMPLE_RATE) for seconds in (SETTLED, SHOCK, LONG_AFTER))
    middle = (round(run.begin * SAMPLE_RATE) + time.size) // 2
    half = (ticks >= middle) & ~((since >= 0) & (since < settled))
    after, cold = (since >= settled) & (since < long_after), (time >= 0.75) & (time < 1.0)
    counts = (time >= START) & ~((since >= 0) & (since < shock))
    counted = np.where(counts, error, 0.0)
    worst = int(np.argmax(counted))
    return Figures(
        rmse=rmse(desired[half], true[half]),
        maximum=float(error[half].max()),
        after_change=rmse(desired[after], true[after]) if after.any() else None,
        cold=rmse(desired[cold], true[cold]),
        largest=float(counted[worst]),
        largest_at=float(time[worst]),
        left_out=float(error[~counts].max(initial=0.0)),
        ringing=_ringing(run, recording["volts"]),
        changes=int(np.count_nonzero(recording["flags"] & BIT["changed"])),
    )


def _ringing(run: Run, volts: FloatArray) -> float:
    """abs(J) exp(-zeta w 50 ms), um; J from the same voltages on the massless plant with and without the change."""
    tick = run.change_tick
    if tick is None:
        return 0.0
    still = run.settings.without("resonance", "noise", "lag")
    jump = []
    for settings in (still, still.without("change")):
        plant = RealisticPlant(settings)
        plant.exchange(volts[: tick + 1])
        jump.append(plant.truth[tick])
    decay = run.settings.damping * 2 * np.pi * run.settings.resonance * SHOCK
    return float(abs(jump[0] - jump[1]) * np.exp(-decay))


def as_dict(found: Figures) -> dict[str, float | int | None]:
    """By name, for JSON."""
    return dataclasses.asdict(found)
