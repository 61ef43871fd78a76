"""How far learning brings rasters on sampled stages, pass by pass: python -m benchmarks.learning [--online]

Thirty stages: first resonance 400 or 900 Hz, damping 0.01 to 0.03, a second mode, hysteresis of three structures, a
dead time of 0 or 1 tick that is not given, dynamics whose resonance is up to 3 % wrong, one pass in five missed. The
error is that of the true displacement against the raster itself, on its lines, rms in % of the peak-to-peak.

With --online it is a `RepetitiveController` around the default controller, which knows the same dynamics: batch by
batch in one run, with half a second of lost measurements where a pass is missed. Its first batch is the controller
alone. With --steps it is the processor time of a tick of a `RepetitiveController` around a constant gain: the least of
three runs of the same ticks, for periods of 250, 1000 and 8192 ticks at 10 kHz. With --gain 0.95 the gain of the stage
changes after eight passes, and those after it count.

With --online --wander 1 the period wanders by 1 % within five seconds. --turn is the share of the period that the
turns of the lines take; with --turn stage they are those that the known dynamics ask for.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from truestroke import AdaptiveController, Dynamics, IterativeLearning, Mode, RepetitiveController, run, trajectories
from truestroke.control.baselines import ConstantGain
from truestroke.plant import StagePlant, StageSettings

FS, LIMITS, SPAN = 10_000.0, (-0.6, 3.6), 20.0
FREQUENCIES = {400.0: (10.0, 20.0, 50.0, 100.0), 900.0: (10.0, 20.0, 50.0, 100.0, 200.0)}
KINDS = "plays", "preisach", "bouc-wen"
BEFORE = 8  # passes before the gain changes
MISSED = 2  # the pass that is missed, where one is
WANDERS, FINE = 5.0, 20  # s; samples of a tick that a wandering motion is interpolated from


@dataclass(frozen=True)
class Case:
    """A stage, a raster, and what is known of the stage wrongly."""

    frequency: float
    f0: float
    damping: float
    kind: str
    known: float
    dead_time: float
    missed: bool
    seed: int


def case(number: int) -> Case:
    """The stage of a number."""
    rng = np.random.Generator(np.random.PCG64(number))
    f0 = float(rng.choice(list(FREQUENCIES)))
    return Case(
        frequency=float(rng.choice(FREQUENCIES[f0])),
        f0=f0,
        damping=float(rng.uniform(0.01, 0.03)),
        kind=str(rng.choice(KINDS)),
        known=float(rng.uniform(0.97, 1.03)),
        dead_time=float(rng.choice([0.0, 1 / FS])),
        missed=bool(rng.uniform() < 0.2),
        seed=number,
    )


def raster(c: Case, duration: float, turn: float | Dynamics = 0.2, fine: int = 1) -> trajectories.Trajectory:
    """The motion, of so many seconds."""
    asked = {"frequency": c.frequency, "peak_to_peak": SPAN, "offset": 12.0, "turn": turn}
    return trajectories.raster(duration=duration, sample_rate=fine * FS, **asked)


def wandering(c: Case, duration: float, turn: float | Dynamics, share: float) -> trajectories.Trajectory:
    """The same, whose period wanders by this share of it."""
    wave = raster(c, duration + 2 * share * WANDERS, turn, FINE)
    own, w = np.arange(wave.position.size) / (FINE * FS), 2 * np.pi / WANDERS
    t = np.arange(round(duration * FS)) / FS
    at, rate, change = t + share * (1 - np.cos(w * t)) / w, 1 + share * np.sin(w * t), share * w * np.cos(w * t)
    velocity = CubicHermiteSpline(own, wave.velocity, wave.acceleration)
    return trajectories.Trajectory(
        wave.name,
        FS,
        CubicHermiteSpline(own, wave.position, wave.velocity)(at),
        velocity(at) * rate,
        wave.settings,
        velocity(at, 1) * rate**2 + velocity(at) * change,
        wave.flat[np.floor(at * FINE * FS).astype(int)],
    )


def stage_of(c: Case, dropouts: tuple[tuple[int, int], ...] = ()) -> tuple[StagePlant, Dynamics]:
    """The stage, and what is known of it."""
    modes = {"resonances": (c.f0, 2.9 * c.f0), "dampings": (c.damping, 0.01), "shares": (0.95, 0.05)}
    settings = StageSettings(hysteresis_kind=c.kind, dead_time=c.dead_time, **modes)
    known = Dynamics(sample_rate=FS, modes=(Mode(frequency=c.known * c.f0, damping=c.damping),))
    return StagePlant(settings, seed=c.seed, dropouts=dropouts), known


def online(c: Case, batches: int, wander: float, turn: str | float) -> list[float]:
    """Of each batch of one run, %; a missing one as the last."""
    stage, known = stage_of(c, ((25_000, 30_000),) if c.missed else ())
    duration, turns = 2.0 + 0.65 * (batches + 4 + 2 * c.missed), known if turn == "stage" else float(turn)
    wave = wandering(c, duration, turns, wander) if wander > 0 else raster(c, duration, turns)
    inside = AdaptiveController(sample_rate=FS, stroke=30.0, voltage_limits=LIMITS, dynamics=known)
    controller = RepetitiveController(inside, 1 / c.frequency)
    done = run(wave, controller, stage)
    error = np.where(done["flat"].astype(bool), done["true"] - done["desired"], np.nan)
    length = math.ceil(0.3 * c.frequency) * round(FS / c.frequency)
    found = [100 * float(np.nanstd(error[batch.tick - length : batch.tick])) / SPAN for batch in controller.batches]
    return (found + found[-1:] * batches)[:batches]


def errors(c: Case, passes: int, changed: float = 1.0) -> list[float]:
    """Of each pass that was not missed, %; of those after a change of the gain of the stage, where it changes."""
    stage, known = stage_of(c)
    stage.open()
    wave = raster(c, 1.0)
    learned = IterativeLearning(wave, dynamics=known, gain=30.0 / 3.6, voltage_limits=LIMITS)
    N = learned.samples
    settle, count = (max(2, math.ceil(seconds * FS / N)) for seconds in (0.15, 0.3))
    start = math.ceil(0.25 * FS / N) * N
    desired, lines = wave.position[start : start + N], learned.counts
    found: list[float] = []
    before = BEFORE if changed != 1.0 else 0
    for k in range(before + passes + c.missed):
        if c.missed and k == MISSED:
            learned.learn(None)
            continue
        gain = changed if k >= before + c.missed else 1.0
        measured = gain * stage.exchange(np.tile(learned.volts, settle + count))[settle * N :]
        true = gain * stage.truth[settle * N :].reshape(count, N).mean(axis=0)
        learned.learn(measured)
        found.append(100 * float(np.std((true - desired)[lines])) / SPAN)
    return found[before:]


def ticks(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Processor time of each tick of two batches, us, the least of three runs, and whether it learns there."""
    wave = trajectories.raster(
        frequency=FS / size, peak_to_peak=SPAN, offset=12.0, duration=3 * size / FS + 1.0, sample_rate=FS, turn=0.2
    )
    start = math.ceil(0.25 * FS / size) * size
    repeated = list(zip(*(x[start : start + size].tolist() for x in (wave.position, wave.velocity)), strict=True))
    measured = [z + 0.1 * math.sin(z) for z, _ in repeated]  # um: something to learn
    known = Dynamics(sample_rate=FS, modes=(Mode(frequency=900.0, damping=0.02),))
    runs = []
    for _ in range(3):
        inside = ConstantGain(30.0 / 3.6, voltage_limits=LIMITS)
        about = {"sample_rate": FS, "voltage_limits": LIMITS, "dynamics": known}
        controller, taken, learns = RepetitiveController(inside, size / FS, **about), [], []
        while len(controller.batches) < 2:
            at, before = len(taken) % size, controller._task
            begin = time.thread_time_ns()
            controller.command(*repeated[at])
            controller.adapt(measured[at])
            taken.append((time.thread_time_ns() - begin) / 1e3)
            learns.append(before is not None)
        runs.append(taken)
    return np.min(runs, axis=0), np.array(learns)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stages", type=int, default=30)
    parser.add_argument("--first", type=int, default=1, help="number of the first stage; odd ones were not tuned with")
    parser.add_argument("--passes", type=int, default=8)
    parser.add_argument(
        "--gain", type=float, default=1.0, help="of the stage from the ninth pass on, which is pass 0 then"
    )
    parser.add_argument("--online", action="store_true", help="one run with a RepetitiveController")
    parser.add_argument("--wander", type=float, default=0.0, help="on line: %% by which the period wanders")
    parser.add_argument("--turn", default=0.2, help="on line: share of the period, or: stage")
    parser.add_argument("--steps", action="store_true", help="processor time of the ticks in which it learns")
    asked = parser.parse_args()
    if asked.steps:
        print("ticks of a period   us: median   99 %   largest   of others: median   largest   ticks that learn")
        for size in (250, 1000, 8192):
            taken, learns = ticks(size)
            some, others = taken[learns], taken[~learns]
            quantiles = np.quantile(some, (0.5, 0.99, 1.0))
            print(f"{size:17} {quantiles[0]:12.0f} {quantiles[1]:6.0f} {quantiles[2]:9.0f}", end="")
            print(f" {np.median(others):19.1f} {others.max():9.0f} {some.size:18}")
        return
    cases = [case(asked.first + 2 * k) for k in range(asked.stages)]
    if asked.online:
        table = np.array([online(c, asked.passes, asked.wander / 100, asked.turn) for c in cases])
    else:
        table = np.array([errors(c, asked.passes, asked.gain) for c in cases])
    print("pass    median   95 %    worst   above the first   above 0.05 %")
    for k, column in enumerate(table.T):
        above, far = int(np.sum(column > table[:, 0])), int(np.sum(column > 0.05))
        middle, most = np.quantile(column, (0.5, 0.95))
        print(f"{k:4}  {middle:8.3f} {most:8.3f} {column.max():8.3f} {above:9} {far:15}")
    worst = int(np.argmax(table[:, min(5, asked.passes - 1)]))
    print(f"worst after five: {case(asked.first + 2 * worst)}")


if __name__ == "__main__":
    main()
