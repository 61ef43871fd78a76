"""The even runs of the fast study with nothing given, or with f0 times a factor; decision 250, docs/fast-motion.md.

    python benchmarks/given_resonance.py [--resonance 1] [--seeds 0 1 2 3] [--first 0] [--last 199]

True error, % of peak to peak: rms of the second half, and the largest one after the first half second.
"""

import argparse
import dataclasses
import os
import warnings
from functools import partial
from multiprocessing import Pool

import numpy as np

from truestroke import AdaptiveController, run
from truestroke.control.feasibility import LimitWarning
from truestroke.plant import StagePlant
from truestroke.studies.robustness.fast.sample import sample

warnings.simplefilter("ignore", LimitWarning)  # what a motion of the study needs of the voltage is not the question
FOLLOW = ("slew_limit", "smoothing_time", "filter_frequency", "prior_covariance", "initial_weights")  # the resonance


def errors(run_of: tuple[int, int], times: float) -> tuple[float, float]:
    """rms of the second half and largest error after 0.5 s, % of peak to peak; times 0: nothing is given."""
    of = sample(*run_of, ["unknown"]).simulation("unknown")
    settings = of.controller
    if times > 0:
        settings = dataclasses.replace(settings, resonance=times * of.plant.resonances[0], **dict.fromkeys(FOLLOW))
    recording = run(of.trajectory, AdaptiveController.from_settings(settings), StagePlant(of.plant, seed=of.seed))
    half, late = len(recording["time"]) // 2, round(0.5 * settings.sample_rate)
    error = 100 * (recording["true"] - recording["desired"]) / np.ptp(recording["desired"][half:])
    return float(np.sqrt(np.mean(error[half:] ** 2))), float(np.abs(error[late:]).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resonance", type=float, default=0.0, help="given, over f0; 0: nothing")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, default=199)
    given = parser.parse_args()
    runs = [(seed, number) for seed in given.seeds for number in range(given.first, given.last + 1) if number % 2 == 0]
    with Pool(os.cpu_count()) as pool:
        rms, largest = np.array(pool.map(partial(errors, times=given.resonance), runs, chunksize=4)).T
    print(f"{len(runs)} runs, {f'f0 times {given.resonance:g}' if given.resonance else 'nothing'} given")
    for name, values, high in (("rms", rms, 1.0), ("largest", largest, 10.0)):
        worst = "{}, {}".format(*runs[int(np.argmax(values))])
        print(
            f"{name:8s} median {np.median(values):.3f}  95 % {np.quantile(values, 0.95):.2f}  worst {values.max():.3g}"
            f" (run {worst})  above {high:g} %: {int(np.sum(values > high))}"
        )


if __name__ == "__main__":
    main()
