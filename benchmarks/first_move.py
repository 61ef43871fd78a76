"""The first move of a controller that knows nothing, and of one that knows f0, on the stages of `foreign_stages`.

From rest at 0 V to the middle of the travel within 30, 100 and 300 ms, then 0.6 s of rest; also with voltage limits
that are given five times too wide. Prints the largest true error, % of the move: median, 90 % and largest of stages.

    python -m benchmarks.first_move --stages 24 --first 5200  # a minute
    python -m benchmarks.first_move --first 6000 --below 350  # soft stages only
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from multiprocessing import Pool

import numpy as np
from benchmarks.changing_motion import rise
from benchmarks.foreign_stages import sampled, travel

from truestroke import AdaptiveController, run, trajectories

MOVES = 0.03, 0.1, 0.3  # s
RESTS = 0.6  # s


def largest_error(number: int, seconds: float, given: bool, wide: float) -> float:
    """Of the stage of this number, % of the move."""
    warnings.simplefilter("ignore")  # that the motion needs more slew where the gain is given too small
    (bottom, top), (stage, _) = travel(sampled(number)[0]), sampled(number)
    shape = np.zeros((2, round((seconds + RESTS) * stage.rate)))
    moving = round(seconds * stage.rate)
    shape[:, :moving] = rise(moving, stage.rate)[:2]
    shape[0, moving:] = 1
    position, velocity = (bottom + top) / 2 * shape
    low, high = stage.limits
    known = {"resonance": stage.modes[0][0]} if given else {}
    controller = AdaptiveController(
        sample_rate=stage.rate,
        stroke=stage.stroke,
        voltage_limits=(wide * low, wide * high),
        slew_limit=100 * (high - low),
        **known,
    )
    wave = trajectories.Trajectory(name="move", position=position, velocity=velocity, sample_rate=stage.rate)
    run(wave, controller, stage)
    return float(100 * np.abs(np.array(stage.true) - position).max() / np.abs(position).max())


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--first", type=int, default=5200, help="number of the first stage")
    parser.add_argument("--below", type=float, default=np.inf, help="only stages whose f0, Hz, is below")
    of = parser.parse_args()
    soft = (number for number in itertools.count(of.first) if sampled(number)[0].modes[0][0] < of.below)
    numbers = list(itertools.islice(soft, of.stages))
    print("within, s   given     limits    median    90 %   largest, % of the move")
    with Pool(2) as pool:
        for seconds, given, wide in itertools.product(MOVES, (False, True), (1.0, 5.0)):
            jobs = [(number, seconds, given, wide) for number in numbers]
            errors = np.array(pool.starmap(largest_error, jobs))
            words = f"{seconds:8}    {'f0' if given else 'nothing':8}  {'times 5' if wide > 1 else 'right':8}"
            print(f"{words}{np.median(errors):8.1f}{np.quantile(errors, 0.9):8.0f}{errors.max():8.0f}")


if __name__ == "__main__":
    main()
