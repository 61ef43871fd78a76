"""Stages whose lag is before the hysteresis, as that of an amplifier, or behind it: decision 334.

Relays and Duhem's equation, one mode, a lag of half to four first resonances, five tones to f0/2 and a sine of 0.45 f0.
Dynamics are measured first; true error, % of peak to peak.

    python -m benchmarks.lag_order [--stages 12]
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from multiprocessing import Pool

import numpy as np
from benchmarks.foreign_stages import Duhem, Relays, Stage, travel

from truestroke import AdaptiveController, measure_dynamics, run
from truestroke.base.typing import FloatArray
from truestroke.signals.trajectories import Trajectory, smoothstep

STEPS = 8  # of a tick, in which the voltage of the stack changes
LIMITS, STROKE, DURATION = (0.0, 10.0), 20.0, 3.0  # V, um, s


class Driven(Stage):
    """The same with the lag before the hysteresis, which sees the voltage of the stack."""

    def __init__(self, modes, rate, *, lag, dead, **about) -> None:
        super().__init__(modes, rate * STEPS, dead=dead * STEPS, **about)
        self.rate, self.kept, self.stack = rate, float(np.exp(-2 * np.pi * lag / rate / STEPS)), 0.0

    def exchange(self, volts: FloatArray) -> FloatArray:
        start = len(self.true)
        for u in volts.tolist():
            for _ in range(STEPS):
                before, self.stack = self.stack, u + self.kept * (self.stack - u)
                self.late.append(self.strain((before + self.stack) / 2))
                self.x = self.A @ self.x + self.b * self.late.pop(0)
            self.true.append(float(self.share @ self.x))
        return np.array(self.true[start:]) + self.noise * self.random.standard_normal(len(volts))


def stage_of(number: int, order: str) -> Stage:
    """A stage by its number."""
    random = np.random.default_rng([number, 77])
    rate = float(random.choice([5e3, 1e4, 2e4]))
    f0 = float(np.exp(random.uniform(np.log(80), np.log(min(2000, rate / 10)))))
    damping, over = np.exp(random.uniform(np.log([0.005, 0.5]), np.log([0.05, 4.0])))
    kind = Duhem(0.2) if number % 2 else Relays(0.13)
    about = {"hysteresis": kind, "limits": LIMITS, "stroke": STROKE, "noise": 5e-5, "seed": number}
    made = Driven if order == "before" else Stage
    return made([(f0, float(damping), 1.0)], rate, lag=float(over) * f0, dead=int(random.integers(2)), **about)


def motion_of(number: int, kind: str, stage: Stage, low: float, high: float) -> Trajectory:
    """Five tones or a sine between these displacements, um."""
    random, f0 = np.random.default_rng([number, 78]), stage.modes[0][0]
    tones = 1 if kind == "sine" else 5
    f = np.array([0.45]) * f0 if kind == "sine" else f0 * random.uniform(0.04, 0.5, tones)
    size, phase = random.uniform(0.3, 1, tones), random.uniform(0, 2 * np.pi, tones)
    time = np.arange(round(DURATION * stage.rate)) / stage.rate
    wave = size @ np.sin(2 * np.pi * f[:, None] * time + phase[:, None])
    begun, _ = smoothstep(4 * time)
    position = begun * ((low + high) / 2 + (high - low) * wave / np.ptp(wave))
    return Trajectory(position=position, velocity=np.gradient(position) * stage.rate, sample_rate=stage.rate, name=kind)


def error_of(kind: str, order: str, number: int) -> float:
    """True rms of the second half, % of peak to peak."""
    low, high = travel(stage_of(number, order))
    stage = stage_of(number, order)
    wave = motion_of(number, kind, stage, low, high)
    axis = {"sample_rate": stage.rate, "stroke": STROKE, "voltage_limits": LIMITS, "slew_limit": 1e9}
    controller = AdaptiveController(**axis, dynamics=measure_dynamics(stage, voltage_limits=LIMITS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of limits that a prior would need
        run(wave, controller, stage)
    error = np.array(stage.true[-wave.position.size :]) - wave.position
    return float(100 * error[error.size // 2 :].std() / (high - low))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stages", type=int, default=12)
    stages = range(parser.parse_args().stages)
    print("motion  lag     rms: median  95 %   worst")
    with Pool(2) as pool:
        for kind, order in itertools.product(("tones", "sine"), ("before", "behind")):
            rms = pool.starmap(error_of, [(kind, order, number) for number in stages])
            print(
                f"{kind:7} {order:7} {np.median(rms):11.3f} {np.quantile(rms, 0.95):6.3f} {max(rms):6.3f}", flush=True
            )


if __name__ == "__main__":
    main()
