"""The metrics of one run, all of the true displacement."""

import numpy as np

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.plant import PlantSettings, RealisticPlant
from truestroke.signals.metrics import rmse
from truestroke.studies.engine import Channels, Number, Run
from truestroke.studies.robustness.sample import SAMPLE_RATE, change_tick, plant_of

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
