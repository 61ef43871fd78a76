"""When a move of 5 um settles to 1 %, while hysteresis and creep are learned: python benchmarks/settling.py

Steps of `trajectories.step(settle=dynamics)` every 50 ms, with the true dynamics and with f0 5 % wrong. `--inverted`
sets up to which frequency the motion is inverted in full, and from which one not at all, in first resonances.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from truestroke import AdaptiveController, Dynamics, run, trajectories
from truestroke.control import stage
from truestroke.plant import StagePlant, StageSettings

RATE, HEIGHT, HOLD = 10_000.0, 5.0, 0.05  # Hz, um, s
JUDGED = 0.7  # of the time between two steps: the next begins early, for it is known ahead


def periods(settings: StageSettings, known: Dynamics, duration: float) -> tuple[float, float, float]:
    """Longest time to 1 % in 0.3 to 1 s and in the last second, periods; largest error after 1.5 there, % of a step."""
    wave = trajectories.step(
        peak_to_peak=HEIGHT, settle=known, hold=HOLD, offset=10.0, duration=duration, sample_rate=RATE
    )
    controller = AdaptiveController(sample_rate=RATE, stroke=24.0, voltage_limits=(-0.6, 3.6), dynamics=known)
    true = run(wave, controller, StagePlant(settings, seed=1))["true"]
    moving = wave.velocity != 0
    ticks, first = round(JUDGED * HOLD * RATE), settings.resonances[0]
    found = []
    for start in np.flatnonzero(moving[1:] & ~moving[:-1]):
        if start + ticks < len(wave):
            error = np.abs(true[start : start + ticks] - wave.position[start + ticks]) / HEIGHT
            beyond = np.flatnonzero(error > 0.01)
            settled = (beyond[-1] + 1) / RATE * first if beyond.size else 0.0
            found.append((start / RATE, settled, 100 * error[round(1.5 / first * RATE) :].max()))
    time, settled, after = np.array(found).T
    late = time > duration - 1.0
    return float(settled[(time > 0.3) & (time < 1.0)].max()), float(settled[late].max()), float(after[late].max())


def main() -> None:
    """A line for each stage, hysteresis and error of f0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inverted", nargs=2, type=float, default=stage.INVERTED, metavar=("A", "B"))
    parser.add_argument("--duration", type=float, default=3.0, help="s")
    options = parser.parse_args()
    stage.INVERTED = tuple(options.inverted)
    print("   f0 hysteresis  f0 known   periods to 1 %: 0.3 to 1 s, last second   after 1.5 periods, %")
    for first, damping in ((700.0, 0.02), (300.0, 0.01)):
        for kind in ("plays", "preisach", "bouc-wen"):
            settings = StageSettings(
                sample_rate=RATE, resonances=(first,), dampings=(damping,), hysteresis_kind=kind, noise=0.01
            )
            for wrong in (0.95, 1.0, 1.05):
                right = settings.dynamics()
                modes = (replace(right.modes[0], frequency=wrong * first),)
                known = replace(right, modes=modes, trusted_to=wrong * first)
                early, late, after = periods(settings, known, options.duration)
                print(f"{first:5.0f} {kind:10} {wrong:8.2f} {early:25.2f} {late:12.2f} {after:23.1f}", flush=True)


if __name__ == "__main__":
    main()
