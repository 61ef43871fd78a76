"""When a move settles to 1 %, while hysteresis and creep are learned: python benchmarks/settling.py

Steps of `trajectories.step(settle=dynamics)` every 50 ms or 8 periods, with the true dynamics and with f0 5 % wrong.
`--further` adds modes, each by its frequency over the first one and its share. `--inverted` sets up to which frequency
the motion is inverted in full, and from which one not at all, in first resonances.
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from dataclasses import replace

import numpy as np

from truestroke import AdaptiveController, Dynamics, LimitWarning, run, trajectories
from truestroke.control import stage
from truestroke.plant import StagePlant, StageSettings

STROKE = 24.0  # um
JUDGED = 0.7  # of the time between two steps: the next begins early, for it is known ahead


def periods(settings: StageSettings, known: Dynamics, height: float, duration: float) -> tuple[float, float, float]:
    """Longest time to 1 % in 0.3 to 1 s and in the last second, periods; largest error after 1.5 there, % of a step."""
    rate, first = settings.sample_rate, settings.resonances[0]
    hold = max(0.05, 8 / first)
    middle = {"offset": (STROKE - height) / 2, "peak_to_peak": height}
    wave = trajectories.step(settle=known, hold=hold, duration=duration, sample_rate=rate, **middle)
    controller = AdaptiveController(sample_rate=rate, stroke=STROKE, voltage_limits=(-0.6, 3.6), dynamics=known)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LimitWarning)
        true = run(wave, controller, StagePlant(settings, seed=1))["true"]
    moving = wave.velocity != 0
    ticks = round(JUDGED * hold * rate)
    found = []
    for start in np.flatnonzero(moving[1:] & ~moving[:-1]):
        if start + ticks < len(wave):
            error = np.abs(true[start : start + ticks] - wave.position[start + ticks]) / height
            beyond = np.flatnonzero(error > 0.01)
            settled = (beyond[-1] + 1) / rate * first if beyond.size else 0.0
            found.append((start / rate, settled, 100 * error[round(1.5 / first * rate) :].max()))
    time, settled, after = np.array(found).T
    late = time > duration - 1.0
    return float(settled[(time > 0.3) & (time < 1.0)].max()), float(settled[late].max()), float(after[late].max())


def main() -> None:
    """A line for each stage, hysteresis, height and error of f0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--stages", nargs="+", default=["700,0.02", "300,0.01"], help="first resonance, Hz, and damping"
    )
    parser.add_argument("--further", nargs="+", default=[], help="further modes: frequency over the first, and share")
    parser.add_argument("--rates", nargs="+", type=float, default=[10_000.0], help="Hz")
    parser.add_argument("--kinds", nargs="+", default=["plays", "preisach", "bouc-wen"])
    parser.add_argument("--heights", nargs="+", type=float, default=[5.0], help="um")
    parser.add_argument("--inverted", nargs=2, type=float, metavar=("A", "B"))
    parser.add_argument("--noise", type=float, default=0.01, help="of a sample of the sensor, um")
    parser.add_argument("--duration", type=float, default=3.0, help="s")
    options = parser.parse_args()
    if options.inverted:
        stage.INVERTED = (tuple(options.inverted),)
    further = [tuple(map(float, of.split(","))) for of in options.further]
    ratios, shares = [1.0, *(ratio for ratio, _ in further)], [share for _, share in further]
    print("   f0 damping   kHz hysteresis    um  f0 known   periods to 1 %: 0.3 to 1 s, last second   after 1.5, %")
    for of, rate, kind, height in itertools.product(options.stages, options.rates, options.kinds, options.heights):
        first, damping = map(float, of.split(","))
        settings = StageSettings(
            sample_rate=rate, resonances=tuple(ratio * first for ratio in ratios), dampings=(damping,) * len(ratios),
            shares=(1 - sum(shares), *shares), hysteresis_kind=kind, noise=options.noise,
        )  # fmt: skip
        for wrong in (0.95, 1.0, 1.05):
            right = settings.dynamics()
            modes = tuple(replace(mode, frequency=wrong * mode.frequency) for mode in right.modes)
            known = replace(right, modes=modes, trusted_to=wrong * first)
            early, late, after = periods(settings, known, height, options.duration)
            name = f"{first:5.0f} {damping:7.3f} {rate / 1000:5.0f} {kind:10} {height:5.1f} {wrong:9.2f}"
            print(f"{name} {early:30.2f} {late:12.2f} {after:13.1f}", flush=True)


if __name__ == "__main__":
    main()
