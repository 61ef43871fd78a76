"""Loads of one frequency that nobody names, beside a motion: python benchmarks/unknown_loads.py

A pump, a fan, the mains, another axis: a sine on the displacement of a stage of 150 to 1500 Hz, 0.02 to 0.6 um of a
stroke of 30, drawn by the seed. The motion is slow, 0.2 to 8 Hz, or with --fast 2 to 20 % of f0. Prints the largest
true error after 0.5 s and the rms of the second half over those of the load, and f0 in the model.

    python benchmarks/unknown_loads.py --first 0 --loads 130                  # nothing given
    python benchmarks/unknown_loads.py --first 0 --loads 130 --given f0       # or dynamics
    python benchmarks/unknown_loads.py --first 300 --loads 120 --fast
    python benchmarks/unknown_loads.py --first 2000 --loads 100 --named       # hum = its frequency
"""

import argparse
import math
import warnings

import numpy as np

from truestroke import AdaptiveController, run, trajectories
from truestroke.plant import StagePlant, StageSettings

RATE = 10_000.0  # Hz
AXIS = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}


def between(random: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def follow(number: int, given: str, fast: bool, named: bool) -> tuple[str, float, float]:
    """The run in words; largest error and rms over those of the load."""
    random = np.random.default_rng([77, number])
    f0, kind = between(random, 150, 1500), str(random.choice(["preisach", "plays", "bouc-wen"]))
    load = between(random, 24, 0.7 * f0) if fast else between(random, 8, min(200.0, 0.6 * f0))
    amplitude, motion = between(random, 0.02, 0.6), str(random.choice(["sine", "hold", "raster"]))
    stage = StageSettings(
        sample_rate=RATE, resonances=(f0,), dampings=(between(random, 0.006, 0.06),), hysteresis_kind=kind, noise=0.01,
        hum=amplitude, hum_frequency=load,
    )  # fmt: skip
    frequency = random.uniform(0.02, 0.2) * f0 if fast else random.uniform(1, 8)
    of = {"peak_to_peak": 12.0, "offset": 10.0, "duration": 4.0, "sample_rate": RATE}
    if motion == "raster":
        wave = trajectories.raster(frequency=frequency, **of)
    else:
        wave = trajectories.sine(frequency=frequency if motion == "sine" else 0.2, **of)
    known = {"nothing": {}, "f0": {"resonance": f0}, "dynamics": {"dynamics": stage.dynamics()}}[given]
    controller = AdaptiveController(**AXIS, **known, hum=[load] if named else ())
    recording = run(wave, controller, StagePlant(stage, seed=number))
    error = recording["true"] - recording["desired"]
    largest, rms = np.abs(error[5000:]).max() / amplitude, np.sqrt(2 * np.mean(error[20000:] ** 2)) / amplitude
    words = f"{number:4} {f0:5.0f} {kind:9}{motion:7}{load:6.0f} Hz{amplitude:7.3f} um{controller.resonance / f0:6.2f}"
    return words, float(largest), float(rms)


def main() -> None:
    """A line for each load."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--loads", type=int, default=130)
    parser.add_argument("--given", choices=("nothing", "f0", "dynamics"), default="nothing")
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--named", action="store_true", help="the controller is given the frequency, hum=")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    print("        f0 hysteresis motion   load            f0 in the model over f0; largest error, rms, over the load")
    found = []
    for number in range(given.first, given.first + given.loads):
        words, *errors = follow(number, given.given, given.fast, given.named)
        found.append(errors)
        print(f"{words} {errors[0]:8.1f} {errors[1]:6.2f}", flush=True)
    for name, column in zip(("largest", "rms"), np.array(found).T, strict=True):
        shown = f"median {np.median(column):.2f}, 90 % {np.quantile(column, 0.9):.2f}, worst {column.max():.1f}"
        print(f"{name:8}{shown}; above ten times the load: {int(np.sum(column > 10))} of {len(column)}")


if __name__ == "__main__":
    main()
