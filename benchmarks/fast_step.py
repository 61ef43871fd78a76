"""What a tick costs with dynamics and feedback, against the default, and how long 20 s at 10 kHz take with all of it.

    python benchmarks/fast_step.py

All figures are of one run: each round measures every controller once, the best of the rounds counts. Seconds do not
repeat on shared machines, though processor time is taken; the ratios of one run do. The kernel alone is measured, in
blocks; each controller replays the measurements of its own run.
"""

import argparse
import math
import time
import warnings

from truestroke import AdaptiveController, ControllerSettings, Dynamics, LimitWarning, Mode
from truestroke.plant import StagePlant, StageSettings
from truestroke.runtime.loop import run
from truestroke.signals import trajectories

RATE = 10_000.0  # Hz
AXIS = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
STAGE = Dynamics(
    sample_rate=RATE,
    modes=(Mode(frequency=700.0, damping=0.02, share=0.9), Mode(frequency=1900.0, damping=0.03, share=0.1)),
    amplifier_bandwidth=3000.0,
    dead_time=1e-4,
)
STAGE_SETTINGS = StageSettings(
    sample_rate=RATE,
    resonances=(700.0, 1900.0),
    dampings=(0.02, 0.03),
    shares=(0.9, 0.1),
    amplifier_bandwidth=3000.0,
    dead_time=1e-4,
)
ROWS = {
    "default": ControllerSettings(**AXIS),
    "dynamics, 1 mode": ControllerSettings(
        **AXIS, dynamics=Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),)), feedback=False
    ),
    "dynamics, 2 modes and lag": ControllerSettings(**AXIS, dynamics=STAGE, feedback=False),
    "the same, and feedback": ControllerSettings(**AXIS, dynamics=STAGE),
    "the same, and hum": ControllerSettings(**AXIS, dynamics=STAGE, hum=50.0),
}


def costs(seconds: float, rounds: int) -> dict[str, float]:
    """Seconds a tick of each controller, the best of the rounds."""
    wave = trajectories.sine(
        frequency=20.0, peak_to_peak=15.0, duration=seconds, sample_rate=RATE, offset=12.0, ramp=0.2
    )
    with warnings.catch_warnings():  # each controller replays its own run: limits and spikes would make a tick cheaper
        warnings.simplefilter("ignore", LimitWarning)
        z = {
            name: run(wave, AdaptiveController.from_settings(settings), StagePlant(STAGE_SETTINGS))["measured"]
            for name, settings in ROWS.items()
        }
    best = dict.fromkeys(ROWS, math.inf)
    for _ in range(rounds):
        for name, settings in ROWS.items():
            controller = AdaptiveController.from_settings(settings)
            begin = time.process_time()
            controller.process(wave.position, wave.velocity, z[name])
            best[name] = min(best[name], (time.process_time() - begin) / len(wave))
    return best


def whole_run() -> float:
    """Seconds of a run of 20 s with all of it, the plant and the recording included."""
    wave = trajectories.sine(frequency=20.0, peak_to_peak=15.0, duration=20.0, sample_rate=RATE, offset=12.0)
    controller, plant = AdaptiveController.from_settings(ROWS["the same, and hum"]), StagePlant(STAGE_SETTINGS)
    begin = time.process_time()
    run(wave, controller, plant)
    return time.process_time() - begin


def main() -> None:
    """Print the table, and the time of a whole run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0, help="of motion")
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    found = costs(options.seconds, options.rounds)
    print(f"{'':28}{'weights':>8}{'ns a tick':>11}{'ratio':>7}{'20 s at 10 kHz, s':>19}")
    for name, cost in found.items():
        ratio, whole = cost / found["default"], cost * 20 * RATE
        print(f"{name:28}{ROWS[name].parameters:8}{1e9 * cost:11.0f}{ratio:7.2f}{whole:19.2f}")
    print(f"A run of 20 s at 10 kHz with all of it, its simulated stage and its recording: {whole_run():.2f} s")


if __name__ == "__main__":
    main()
