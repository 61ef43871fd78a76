"""Hum without dynamics: in how many runs does the controller take it for an oscillation of its own stage?

A bench stage at 2 kHz follows random waves of 3 s. A sine from outside, of each amplitude and frequency, is on the
sensor. An oscillation that is found lowers the filter of the law and puts a stage into the model that is not there.

    python benchmarks/hum.py [--amplitudes 0.05 0.1 0.2] [--lines 50 60 100] [--cutoffs 5 20] [--seeds 30]
"""

import argparse
import itertools
import math

import numpy as np

from truestroke import AdaptiveController
from truestroke.plant import RealisticPlant
from truestroke.signals.trajectories import random_wave

RATE = 2000.0  # Hz


def follow(amplitude: float, line: float, cutoff: float, seed: int) -> tuple[bool, float]:
    """Whether an oscillation was found, and the rms error of the second half without the hum, um."""
    controller = AdaptiveController(sample_rate=RATE, stroke=30.0, voltage_limits=(-0.6, 3.6))
    plant, error = RealisticPlant(seed=seed), []
    plant.open()
    wave = random_wave(duration=3.0, cutoff=cutoff, seed=seed)
    for k, (z_d, zdot_d) in enumerate(zip(wave.position.tolist(), wave.velocity.tolist(), strict=True)):
        z = plant.exchange(np.array([controller.command(z_d, zdot_d)]))[0]
        controller.adapt(z + amplitude * math.sin(2 * math.pi * line * k / RATE + seed // 2))
        error.append(z - z_d)
    return controller.counters.oscillating > 0, float(np.std(error[len(error) // 2 :]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--amplitudes", type=float, nargs="+", default=[0.05, 0.1, 0.2])
    parser.add_argument("--lines", type=float, nargs="+", default=[50.0, 60.0, 100.0])
    parser.add_argument("--cutoffs", type=float, nargs="+", default=[5.0, 20.0])
    parser.add_argument("--seeds", type=int, default=30)
    asked = parser.parse_args()
    print("hum, um  line, Hz  wave, Hz  found in     error, um rms: median  worst")
    for amplitude, line, cutoff in itertools.product(asked.amplitudes, asked.lines, asked.cutoffs):
        runs = [follow(amplitude, line, cutoff, seed) for seed in range(asked.seeds)]
        errors = [error for _, error in runs]
        found = sum(one for one, _ in runs)
        print(
            f"{amplitude:7g}  {line:8g}  {cutoff:8g}  {found:3d} of {asked.seeds:3d}  {np.median(errors):20.3f}  "
            f"{max(errors):5.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
