"""Errors where all resonances of the dynamics that a controller is given are wrong, by a factor; docs/fast-motion.md.

    python benchmarks/wrong_dynamics.py [--first 0] [--last 79] [--seed 0] [--times 1 0.95 1.05 0.9 1.1 0.8 1.2 0.5 2]

The even runs of the fast half of the robustness study, with its stages, motions and jumps of f0: the true rms error of
the second half, % of peak to peak, the largest one after the first half second, and in how many runs that is above 5 %.
"""

import argparse
import dataclasses
import warnings

import numpy as np

from truestroke import AdaptiveController, run
from truestroke.control.feasibility import LimitWarning
from truestroke.plant import StagePlant
from truestroke.studies.robustness.fast.sample import FastRun, sample

warnings.simplefilter("ignore", LimitWarning)  # what a motion of the study needs of the voltage is not the question


def errors(of: FastRun, times: float) -> tuple[float, float]:
    """rms of the second half and largest error after 0.5 s, % of peak to peak."""
    settings = of.controllers["measured"]
    right = settings.dynamics
    modes = tuple(dataclasses.replace(mode, frequency=times * mode.frequency) for mode in right.modes)
    wrong = dataclasses.replace(right, modes=modes)
    follow = dict.fromkeys(("feedback", "smoothing_time", "slew_limit"))  # from the dynamics
    settings = dataclasses.replace(settings, dynamics=wrong, **follow)
    motion = of.motions["measured"]
    recording = run(motion, AdaptiveController.from_settings(settings), StagePlant(of.plant, of.seed))
    error = (recording["true"] - recording["desired"]) / of.sampled["span"]["measured"]
    late = error[round(0.5 * settings.sample_rate) :]
    return 100 * float(np.std(error[error.size // 2 :])), 100 * float(np.abs(late).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, default=79)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--times", type=float, nargs="+", default=[1, 0.95, 1.05, 0.9, 1.1, 0.8, 1.2, 0.5, 2])
    asked = parser.parse_args()
    runs = [sample(asked.seed, n, ["measured"]) for n in range(asked.first + asked.first % 2, asked.last + 1, 2)]
    print("f0 given / f0   rms: median    95 %   worst   run   largest: median   worst   above 5 %")
    for times in asked.times:
        found = []
        for one in runs:
            try:
                found.append((*errors(one, times), one.number))
            except ValueError as refused:  # a resonance beyond what the sample rate sees
                print(f"run {one.number}, {times:g}: {refused}")
        rms, largest, number = np.array(found).T
        median, most, worst = np.percentile(rms, [50, 95, 100])
        print(
            f"{times:14g}  {median:12.3g}  {most:6.3g}  {worst:6.3g}  {number[rms.argmax()]:4.0f}  "
            f"{np.median(largest):16.3g}  {largest.max():6.3g}  "
            f"{np.count_nonzero(largest > 5):3d} of {largest.size}",
            flush=True,
        )


if __name__ == "__main__":
    main()
