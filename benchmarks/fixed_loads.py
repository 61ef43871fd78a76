"""A load of one frequency that the controller does not know, beside a slow motion: python benchmarks/fixed_loads.py

A pump, the mains, another axis: a sine on the displacement of a stage whose dynamics are given and right, above the
bandwidth of the feedback and below the resonance, where the feedback can hardly reduce it. Prints the largest true
error after 0.5 s over the amplitude of the load, the first resonance in the model over that of the stage at the end,
and how often earlier weights were held.
"""

import argparse
import itertools
import warnings

import numpy as np

from truestroke import AdaptiveController, LimitWarning, run, trajectories
from truestroke.plant import StagePlant, StageSettings

RATE = 10_000.0  # Hz
RESONANCES = (110.0, 165.0, 300.0)  # Hz
LOADS = (0.3, 0.4, 0.55, 0.7)  # of the resonance
AMPLITUDES = (0.5, 1.0)  # um, of a stroke of 30


def follow(f0: float, kind: str, load: float, amplitude: float) -> tuple[float, float, int]:
    """Largest error after 0.5 s over `amplitude`, um; resonance of the model over f0, Hz; failures of learning."""
    stage = StageSettings(
        sample_rate=RATE, resonances=(f0,), dampings=(0.02,), hysteresis_kind=kind, noise=0.01,
        hum=amplitude, hum_frequency=load * f0,
    )  # fmt: skip
    wave = trajectories.sine(frequency=2.0, peak_to_peak=12.0, duration=4.0, sample_rate=RATE)
    controller = AdaptiveController(
        sample_rate=RATE, stroke=30.0, voltage_limits=(-0.6, 3.6), dynamics=stage.dynamics()
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LimitWarning)
        recording = run(wave, controller, StagePlant(stage, seed=1))
    error = np.abs(recording["true"] - recording["desired"])[round(0.5 * RATE) :]
    return float(error.max() / amplitude), controller.resonance / f0, controller.counters.restored


def main() -> None:
    """A line for each stage and load."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resonances", nargs="+", type=float, default=RESONANCES, help="Hz")
    parser.add_argument("--loads", nargs="+", type=float, default=LOADS, help="over the resonance")
    options = parser.parse_args()
    print("  f0 hysteresis  load / f0    um   largest error / load   f0 in the model   restored")
    largest = []
    for f0, kind, load, size in itertools.product(options.resonances, ("preisach", "plays"), options.loads, AMPLITUDES):
        error, model, restored = follow(f0, kind, load, size)
        largest.append(error)
        print(f"{f0:4.0f} {kind:10} {load:10.2f} {size:5.1f} {error:22.1f} {model:17.2f} {restored:10d}", flush=True)
    print(f"largest error / load: median {np.median(largest):.1f}, worst {max(largest):.1f}")


if __name__ == "__main__":
    main()
