"""An hour without a break: 7.2 million ticks of rest, sines and random waves on one plant, in any order.

    python benchmarks/one_hour.py [--minutes 60] [--seed 0] [--number 0]

Prints the true rmse and the largest error of each kind of motion minute by minute, and at the end what must hold: as
accurate as at the beginning, all states finite, P symmetric and positive definite. Nothing is recorded.
"""

import argparse
import sys
import time

import numpy as np

from truestroke import AdaptiveController, trajectories
from truestroke.plant import RealisticPlant
from truestroke.studies.robustness.sample import BLEND, SAMPLE_RATE, STROKE, VOLTAGE_LIMITS, joined, sample

KINDS = ("random 20 Hz", "rest", "sine 8 Hz", "random 10 Hz", "small sine", "sine 1 Hz")
PIECE = 10.0  # s


def pieces(random, reach, number):
    """Position and velocity of `number` motions of 10 s that blend into each other, and their names."""
    low, span = reach[0], reach[1] - reach[0]
    names, parts, ticks = [], [], round(PIECE * SAMPLE_RATE)
    shared = {"duration": PIECE + BLEND, "sample_rate": SAMPLE_RATE}
    for k in range(number):
        name = KINDS[0] if k in (1, number - 1) else KINDS[random.integers(len(KINDS))]  # the same at both ends
        kind, _, rest = name.partition(" ")
        size = span if kind == "sine" else random.uniform(0.3, 1.5)
        offset = random.uniform(low + size / 2, low + span - size / 2) if size < span else low + span / 2
        if kind == "random":
            cutoff, seed = float(rest[:-3]), int(random.integers(2**32))
            wave = trajectories.random_wave(cutoff=cutoff, peak_to_peak=span, low=low, seed=seed, ramp=0.0, **shared)
        elif name == "rest":
            wave = trajectories.sine(frequency=1.0, peak_to_peak=1e-9, offset=offset, ramp=0.0, **shared)
        else:
            frequency = float(rest[:-3]) if kind == "sine" else random.uniform(1.0, 8.0)
            wave = trajectories.sine(frequency=frequency, peak_to_peak=size, offset=offset, ramp=0.0, **shared)
        names.append(name)
        parts.append((wave.position, wave.velocity, wave.acceleration, k * ticks))
    z, v, _ = joined(parts)
    return names, z[: number * ticks], v[: number * ticks]


def drive(controller, plant, z_d, zdot_d):
    """The loop alone: true displacement, um."""
    true, volts = np.empty_like(z_d), np.empty(1)
    for k, (z, v) in enumerate(zip(z_d.tolist(), zdot_d.tolist(), strict=True)):
        volts[0] = controller.command(z, v)
        controller.adapt(float(plant.exchange(volts)[0]))
        true[k] = plant.truth[0]
    return true


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("--minutes", 60), ("--seed", 0), ("--number", 0)):
        arguments.add_argument(name, type=int, default=default)
    asked = arguments.parse_args()
    run = sample(asked.seed, asked.number)
    plant = RealisticPlant(run.plant.without("change"), seed=asked.number)
    plant.open()
    controller = AdaptiveController(sample_rate=SAMPLE_RATE, stroke=STROKE, voltage_limits=VOLTAGE_LIMITS)
    random, waves, worst, began = np.random.default_rng(asked.seed), [], 0.0, time.perf_counter()
    names, z_d, zdot_d = pieces(random, run.sampled["reach"], 6 * asked.minutes)
    ticks = round(PIECE * SAMPLE_RATE)
    for k, name in enumerate(names):
        part = slice(k * ticks, (k + 1) * ticks)
        error = drive(controller, plant, z_d[part], zdot_d[part]) - z_d[part]
        rmse, largest = (
            float(np.sqrt(np.mean(error[1000:] ** 2))),
            float(np.max(np.abs(error[1000 if k == 0 else 0 :]))),
        )
        worst = max(worst, largest)
        if name == KINDS[0]:
            waves.append(rmse)
        if k % 6 == 0 or k == len(names) - 1:
            seconds = time.perf_counter() - began
            print(
                f"{k / 6:6.1f} min  {name:13} rmse {rmse:.4f} um, largest {largest:.3f} um  ({seconds:.0f} s)",
                flush=True,
            )
    P, states = controller.covariance, controller.state()
    eigenvalues = np.linalg.eigvalsh(P)
    np.linalg.cholesky(P)  # raises where P is not positive definite
    finite = all(np.isfinite(value).all() for value in states.values() if value.dtype.kind == "f")
    print(f"random waves of 20 Hz: first {waves[0]:.4f} um, last {waves[-1]:.4f} um, worst {max(waves):.4f} um")
    print(f"largest error anywhere {worst:.3f} um, {controller.counters}")
    scale = np.sqrt(np.diag(P))
    eigenvalues = np.linalg.eigvalsh(P / np.outer(scale, scale))
    print(f"finite {finite}, asymmetry of P {np.max(np.abs(P - P.T)):g}, eigenvalues of the correlations "
          f"{eigenvalues[0]:.3g} to {eigenvalues[-1]:.3g}")  # fmt: skip
    return 0 if finite and waves[-1] < 1.2 * waves[0] and worst < 0.25 and eigenvalues[0] > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
