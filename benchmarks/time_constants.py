"""Dead time and lag from simulated records: how often the true values are inside the 95 % intervals of `identify`.

python benchmarks/time_constants.py           the table of docs/identify.md: four kinds of records, 100 of each
python benchmarks/time_constants.py 12        twelve of each
python benchmarks/time_constants.py 25 300    twenty-five of each, from seed 300 on
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.signal import sawtooth

from truestroke.identification.fitting.procedure import time_constants
from truestroke.identification.records.series import series
from truestroke.plant import StagePlant, StageSettings

FINE = 10_000.0  # Hz: rate of the simulation
EVERY = 10  # ticks of it for each row of the record
HYSTERESES = ("plays", "preisach", "bouc-wen")
LONGEST_DEAD, LONGEST_LAG = 6e-3, 8e-3  # s


class Simulated(NamedTuple):
    """A record and the time constants of its stage."""

    volts: np.ndarray
    displacement: np.ndarray
    sample_rate: float
    dead_time: float
    lag: float


def sine_and_step(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One sine and one step"""
    f, at = rng.uniform(0.5, 3.0), rng.uniform(0.3, 0.5) * t[-1]
    return np.where(t < at, 0.3 - 0.3 * np.cos(2 * np.pi * f * t), 0.4 - 0.4 * np.cos(2 * np.pi * f * t) + 0.15)


def multi_sine(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Five sines"""
    f, phase = rng.uniform(0.5, 20.0, 5), rng.uniform(0, 2 * np.pi, 5)
    return _scaled(t, sum(np.sin(2 * np.pi * a * t + b) for a, b in zip(f, phase, strict=True)))


def random_wave(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random wave"""
    f, phase = rng.uniform(0.1, rng.uniform(5.0, 30.0), 30), rng.uniform(0, 2 * np.pi, 30)
    return _scaled(t, sum(np.sin(2 * np.pi * a * t + b) for a, b in zip(f, phase, strict=True)))


def triangles(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Triangles of several heights"""
    f = rng.uniform(0.5, 5.0)
    height = rng.uniform(0.3, 0.95, 200)[(f * t).astype(int)]
    return height * (0.5 + 0.5 * sawtooth(2 * np.pi * f * t, 0.5))


def _scaled(t: np.ndarray, s: np.ndarray) -> np.ndarray:
    return (s - s.min()) / np.ptp(s) * np.minimum(1.0, t / 0.5)


KINDS: tuple[Callable[[np.ndarray, np.random.Generator], np.ndarray], ...] = (
    sine_and_step,
    multi_sine,
    random_wave,
    triangles,
)


def record(kind: Callable[[np.ndarray, np.random.Generator], np.ndarray], seed: int, seconds: float = 8.0) -> Simulated:
    """Hysteresis of a structure, dead time and lag by chance, in one of three no dead time, in one of three no lag."""
    rng = np.random.Generator(np.random.PCG64([KINDS.index(kind), seed]))
    case, before = rng.integers(3), bool(rng.integers(2))
    dead = 0.0 if case == 0 else float(rng.uniform(0.5e-3, LONGEST_DEAD))
    lag = 0.0 if case == 1 else float(rng.uniform(0.5e-3, LONGEST_LAG))
    corner = 1 / (2 * np.pi * lag) if lag else 0.0
    settings = StageSettings(
        hysteresis_kind=HYSTERESES[seed % 3],
        loop_width=float(rng.uniform(0.05, 0.16)),
        creep=float(rng.uniform(0.0, 0.02)),
        resonances=(4000.0,),
        dampings=(0.3,),
        amplifier_bandwidth=corner if before else 0.0,
        sensor_bandwidth=0.0 if before else corner,
        noise=float(rng.uniform(0.005, 0.03)),
    )
    t = np.arange(round(seconds * FINE)) / FINE
    volts = 3.6 * kind(t, rng)
    stage = StagePlant(settings, seed=seed)
    stage.open()
    z = np.interp(t - dead, t, stage.exchange(volts))
    return Simulated(volts[::EVERY], z[::EVERY], FINE / EVERY, dead, lag)


def inside(made: Simulated) -> bool:
    """Whether dead time and lag are both inside the intervals that `identify` gives the whole record."""
    found = time_constants(series((made.volts, made.displacement, made.sample_rate)))
    pairs = (made.dead_time, found.delay_interval), (made.lag, found.time_constant_interval)
    return all(low <= true <= high for true, (low, high) in pairs)


def main() -> None:
    count, first, *_ = [*map(int, sys.argv[1:]), *(100, 0)[len(sys.argv) - 1 :]]
    print("| record | both inside |")
    print("|---|---|")
    for kind in KINDS:
        held = sum(inside(record(kind, seed)) for seed in range(first, first + count))
        print(f"| {kind.__doc__} | {held} of {count} |", flush=True)


if __name__ == "__main__":
    main()
