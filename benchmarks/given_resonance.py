"""The even runs of the fast study with nothing given, or with f0 times a factor; decision 250, docs/fast-motion.md.

    python benchmarks/given_resonance.py [--resonance 1] [--seeds 0 1 2 3] [--first 0] [--last 199]

True error, % of peak to peak: rms of the second half, and the largest one after the first half second.
"""

import argparse
import os
from functools import partial
from multiprocessing import Pool

import numpy as np

from truestroke.studies.robustness.fast import record, sample


def errors(run_of: tuple[int, int], times: float) -> tuple[float, float]:
    """rms of the second half and largest error after 0.5 s, % of peak to peak; times 0: nothing is given."""
    of = sample(*run_of, ["unknown"])
    known = {"resonance": times * of.plant.resonances[0]} if times > 0 else {}
    recording = record(*run_of, "unknown", **known)
    error = 100 * (recording["true"] - recording["desired"]) / of.sampled["span"]["unknown"]
    late = error[round(0.5 * of.plant.sample_rate) :]
    return float(np.sqrt(np.mean(error[error.size // 2 :] ** 2))), float(np.abs(late).max())


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
