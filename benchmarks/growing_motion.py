"""Motions that grow, shrink, or become faster within a run: how well are they followed?

Stages of 60 Hz to a ninth of the sample rate (2 to 20 kHz), two modes in two of five, hysteresis of three structures,
up to two ticks of dead time. Sines to f0/3 whose height grows evenly, by a ratio, or as the root of the time, shrinks,
swings, or goes in steps, and chirps up and down; half of the sines have a harmonic near f0. Four seconds each.

Prints the runs with an error above 5 %, and the distribution of the true rms of the second half, and of the largest
error before and after 0.5 s, % of peak to peak of the largest motion.

    python -m benchmarks.growing_motion --stages 200              # nothing given; half a minute
    python -m benchmarks.growing_motion --stages 200 --given f0   # or dynamics
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass
from multiprocessing import Pool
from typing import Any

import numpy as np
from benchmarks.unseen_mode import rms_and_largest
from numpy.typing import NDArray

from truestroke import AdaptiveController, run, trajectories
from truestroke.plant import StagePlant, StageSettings

FloatArray = NDArray[np.float64]
RATES = (2000.0, 5000.0, 8000.0, 10_000.0, 20_000.0)  # Hz
MOTIONS = ("grow", "geometric", "spiral", "shrink", "swing", "steps", "up", "down")
LASTS, BEGINS = 4.0, 0.15  # s: a motion, and how long it takes to begin
TRAVEL, MIDDLE = 20.0, 12.0  # um


@dataclass(frozen=True)
class Case:
    """A stage and a motion."""

    number: int
    stage: StageSettings
    motion: str
    frequency: float  # Hz

    def __str__(self) -> str:
        s = self.stage
        f0, modes = s.resonances[0], len(s.resonances)
        of = f"{self.frequency / f0:.2f} f0, {s.hysteresis_kind:8} f0 {f0:5.0f} Hz of {s.sample_rate:5.0f}"
        return f"{self.number:5} {self.motion:9} {of}, damping {s.dampings[0]:.3f}, {modes} mode{'s' * (modes > 1)}"


def sampled(number: int) -> Case:
    """The same number is always the same case."""
    rng = np.random.default_rng([359, number])
    rate = float(rng.choice(RATES))
    f0 = float(np.exp(rng.uniform(np.log(60), np.log(rate / 9))))
    dampings = np.exp(rng.uniform(np.log(0.003), np.log(0.08), size=2)).tolist()
    second, share = float(min(f0 * rng.uniform(2, 3.5), 0.42 * rate)), float(rng.uniform(0.02, 0.2))
    modes = 2 if rng.random() < 0.4 else 1
    stage = StageSettings(
        sample_rate=rate,
        hysteresis_kind=str(rng.choice(["plays", "preisach", "bouc-wen"])),
        noise=float(rng.choice([0.0005, 0.002, 0.01])),
        dead_time=int(rng.integers(0, 3)) / rate,
        amplifier_bandwidth=float(f0 * rng.uniform(3, 20)),
        resonances=(f0, second)[:modes],
        dampings=tuple(dampings[:modes]),
        shares=(1 - share, share) if modes > 1 else (1.0,),
    )
    near = f0 / int(rng.integers(3, 12)) * rng.uniform(0.93, 1.07)
    anywhere = f0 * rng.uniform(0.03, 1 / 3)
    frequency = min(near, f0 / 3) if rng.random() < 0.5 else anywhere
    return Case(number, stage, str(rng.choice(MOTIONS)), float(frequency))


def height(case: Case, time: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Of the sine, over the largest one."""
    first, part = float(np.exp(rng.uniform(np.log(0.01), np.log(0.3)))), time / LASTS
    match case.motion:
        case "grow":
            return first + (1 - first) * part
        case "geometric":
            return np.asarray(first ** (1 - part))
        case "spiral":
            return np.asarray(np.sqrt(first**2 + (1 - first**2) * part))
        case "shrink":
            return 1 - (1 - first) * part
        case "swing":
            return 1 - (1 - first) / 2 * (1 - np.cos(2 * np.pi * rng.uniform(0.3, 3) * time))
        case "steps":
            levels, ticks = rng.uniform(0.05, 1, int(rng.integers(3, 8))), round(0.05 * case.stage.sample_rate)
            steps = levels[np.minimum((part * levels.size).astype(int), levels.size - 1)]
            smooth = np.hanning(ticks + 2)[1:-1]
            padded = np.pad(steps, ticks, mode="edge")
            return np.convolve(padded, smooth / smooth.sum(), "same")[ticks:-ticks]
    return np.ones_like(time)


def phase(case: Case, time: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Of the sine, rad."""
    f0 = case.stage.resonances[0]
    low, high = max(2.0, 0.01 * f0), f0 / 3
    if case.motion not in ("up", "down"):
        return 2 * np.pi * case.frequency * time
    if case.motion == "down":
        low, high = high, low
    if rng.random() < 0.5:
        return 2 * np.pi * (low * time + (high - low) * time**2 / 2 / LASTS)
    ratio = np.log(high / low)
    return np.asarray(2 * np.pi * low * LASTS / ratio * np.expm1(time / LASTS * ratio))


def wave_of(case: Case) -> trajectories.Trajectory:
    """The motion, which begins smoothly."""
    rate, rng = case.stage.sample_rate, np.random.default_rng([360, case.number])
    time = np.arange(round(LASTS * rate)) / rate
    s = np.minimum(time / BEGINS, 1)
    begin = s**3 * (10 - 15 * s + 6 * s * s)
    z = begin * (MIDDLE + TRAVEL / 2 * height(case, time, rng) * np.sin(phase(case, time, rng)))
    v = np.gradient(z, 1 / rate)
    return trajectories.Trajectory(
        name=case.motion, position=z, velocity=v, acceleration=np.gradient(v, 1 / rate), sample_rate=rate
    )


def controller_of(case: Case, given: str) -> AdaptiveController:
    """With nothing, f0 or dynamics given."""
    known: dict[str, Any] = {}
    if given == "f0":
        known = {"resonance": case.stage.resonances[0]}
    if given == "dynamics":
        known = {"dynamics": case.stage.dynamics()}
    axis: dict[str, Any] = {"stroke": 24.0, "voltage_limits": (-0.6, 3.6), "slew_limit": 1e6}
    return AdaptiveController(sample_rate=case.stage.sample_rate, **axis, **known)


def errors(number: int, given: str) -> tuple[float, float, float]:
    """The rms of the second half, and the largest error before and after 0.5 s, % of peak to peak."""
    warnings.simplefilter("ignore")  # of limits and of the model: the error is what counts here
    case = sampled(number)
    recording = run(wave_of(case), controller_of(case, given), StagePlant(case.stage, seed=number))
    return rms_and_largest(recording, TRAVEL)


def main() -> None:
    """The worst runs, and the distribution."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stages", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first stage")
    parser.add_argument("--given", choices=["nothing", "f0", "dynamics"], default="nothing")
    of = parser.parse_args()
    numbers = range(of.first, of.first + of.stages)
    with Pool(2) as pool:
        found = pool.starmap(errors, [(number, of.given) for number in numbers], chunksize=1)
    for number, (rms, early, late) in zip(numbers, found, strict=True):
        if late > 5:
            print(f"{sampled(number)}: rms {rms:.3f}, largest {early:.1f}, {late:.1f}")
    for name, column in zip(("rms", "before 0.5 s", "after 0.5 s"), np.array(found).T, strict=True):
        median, most, worst = np.percentile(column, [50, 95, 100])
        above = ", ".join(f"{np.sum(column > level)} above {level} %" for level in (1, 2, 5, 10, 20))
        print(f"{name}: median {median:.3f}, 95 % {most:.2f}, worst {worst:.2f}; {above}")


if __name__ == "__main__":
    main()
