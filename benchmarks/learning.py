"""How far learning brings rasters on sampled stages, pass by pass: python -m benchmarks.learning [--online]

Thirty stages: first resonance 400 or 900 Hz, damping 0.01 to 0.03, a second mode, hysteresis of three structures, a
dead time of 0 or 1 tick that is not given, dynamics whose resonance is up to 3 % wrong, one pass in five missed. The
error is that of the true displacement against the raster itself, on its lines, rms in % of the peak-to-peak.

With --online it is a `RepetitiveController` around the default controller, which knows the same dynamics: batch by
batch in one run, with half a second of lost measurements where a pass is missed. Its first batch is the controller
alone. With --steps it is the processor time of a tick of a `RepetitiveController` around a constant gain: the least of
three runs of the same ticks, for periods of 250, 1000 and 8192 ticks at 10 kHz. With --gain 0.95 the gain of the stage
changes after eight passes, and those after it count. With --late one of the passes 1 to 5 of each stage is recorded too
late, by a lot of 2 to 98 % of the period; it is not in the table. With --late-first it is pass 0.
With --sensor 1.01 the sensor shows 1 % more than there is; the error is that of the true displacement times as much.

With --online --wander 1 the period wanders by 1 % within five seconds. --turn is the share of the period that the
turns of the lines take; with --turn stage they are those that the known dynamics ask for.

With --whole it is the error with its mean, as the sensor shows it, of `truestroke.learn` with its way from the safe
voltage: strokes of 5 um to 1 mm, 300 Hz to 50 kHz, damping 0.005 to 0.05, three ranges of voltage, a gain up to 25 %
wrong. Every second stage, by lot, rests before each pass; with the others creep and loops go on.
"""

from __future__ import annotations

import argparse
import math
import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from truestroke import (
    AdaptiveController,
    Dynamics,
    IterativeLearning,
    Mode,
    RepetitiveController,
    SettingError,
    learn,
    run,
    trajectories,
)
from truestroke.base.typing import FloatArray
from truestroke.control.baselines import ConstantGain
from truestroke.plant import StagePlant, StageSettings
from truestroke.runtime.drivers.playback import Recorded
from truestroke.signals.timing import Timing

FS, LIMITS, SPAN = 10_000.0, (-0.6, 3.6), 20.0
FREQUENCIES = {400.0: (10.0, 20.0, 50.0, 100.0), 900.0: (10.0, 20.0, 50.0, 100.0, 200.0)}
KINDS = "plays", "preisach", "bouc-wen"
BEFORE = 8  # passes before the gain changes
LATE = 1, 6  # the first pass that may be recorded late, and the first that is not any more
MISSED = 2  # the pass that is missed, where one is
WANDERS, FINE = 5.0, 20  # s; samples of a tick that a wandering motion is interpolated from
RATES = 2e3, 5e3, 1e4, 2e4, 5e4, 1e5, 2e5  # Hz, of --whole
RANGES = (-0.6, 3.6), (0.0, 10.0), (-20.0, 120.0)  # V


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


def errors(
    c: Case, passes: int, changed: float = 1.0, late: tuple[int, int] | None = None, sensor: float = 1.0
) -> list[float]:
    """Of each pass that was recorded, %; of those after a change of the gain of the stage, where it changes.

    `late`: one of the passes from the first number up to the second is recorded too late. `sensor`: gain of the
    sensor, by which the true size is put right.
    """
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
    rng = np.random.default_rng([c.seed, 1])
    at, by = (int(rng.integers(*late)), round(N * rng.uniform(0.02, 0.98))) if late else (-1, 0)
    for k in range(before + passes + c.missed + bool(late)):
        if c.missed and k == MISSED and k != at:
            learned.learn(None)
            continue
        gain = changed if k >= before + c.missed else 1.0
        measured = sensor * gain * stage.exchange(np.tile(learned.volts, settle + count))[settle * N :]
        true = sensor * gain * stage.truth[settle * N :].reshape(count, N).mean(axis=0)
        if k == at:
            with suppress(SettingError):  # a first record that seems to be of the other sign is refused
                learned.learn(np.roll(measured, by))
            continue
        learned.learn(measured)
        found.append(100 * float(np.std((true - desired)[lines])) / SPAN)
    return found[before:][:passes]


class FromRest:
    """A driver with a clock of its own, whose stage begins each pass at rest."""

    def __init__(self, stage: StagePlant) -> None:
        self.stage = stage

    def open(self) -> Timing:
        """The stage, at rest."""
        return self.stage.open()

    def playback(self, volts: FloatArray, sample_rate: float) -> Recorded:
        """Of the first channel."""
        self.stage.open()
        return Recorded(volts, self.stage.exchange(np.ascontiguousarray(volts[0]))[None, :], sample_rate)

    def start(self, volts: FloatArray | None = None) -> None:
        """Nothing to do."""

    exchange = stop = close = rescue = start

    def describe(self) -> dict[str, object]:
        """No settings."""
        return {}


def whole(number: int, passes: int) -> list[float]:
    """Of each pass of `truestroke.learn` on a stage of this number, %, with the mean; behind the last one its own."""
    rng = np.random.default_rng(7000 + number)
    f0 = float(np.exp(rng.uniform(np.log(300.0), np.log(20_000.0)))) if number % 10 else 50_000.0
    fs = RATES[min(int(np.searchsorted(RATES, rng.uniform(5.0, 14.0) * f0)), len(RATES) - 1)]
    stroke, damping = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in ((5.0, 1000.0), (0.005, 0.05)))
    kind, limits = str(rng.choice(KINDS)), RANGES[rng.integers(3)]
    samples = int(rng.choice([60, 100, 200, 500, 1000]))
    while fs / samples > f0 / 4:
        samples *= 2
    while fs / samples < f0 / 100 or samples > 4000:
        samples //= 2
    span, motion, rests = rng.uniform(0.2, 0.65) * stroke, str(rng.choice(["raster", "sine"])), bool(rng.integers(2))
    known, gain, creep, width = (
        float(rng.uniform(*ends)) for ends in ((0.97, 1.03), (0.8, 1.25), (0.005, 0.03), (0.08, 0.2))
    )
    asked = {"hysteresis_kind": kind, "loop_width": width, "creep": creep, "noise": 1e-3 * stroke, "stroke": stroke}
    asked |= {"resonances": (f0,), "dampings": (damping,), "amplifier_bandwidth": 10 * f0, "voltage_limits": limits}
    stage = StagePlant(StageSettings(sample_rate=fs, **asked), seed=number)
    reach = stroke * (limits[1] - limits[0]) / limits[1]
    wave = getattr(trajectories, motion)(
        frequency=fs / samples,
        peak_to_peak=span,
        offset=0.5 * stroke * sum(limits) / limits[1],
        duration=1 + 3 * samples / fs,
        sample_rate=fs,
    )
    dynamics = Dynamics(sample_rate=fs, modes=(Mode(frequency=known * f0, damping=damping),))
    found = learn(
        FromRest(stage) if rests else stage,
        wave,
        voltage_limits=limits,
        slew=1e9,
        stroke=gain * reach,
        dynamics=dynamics,
        passes=passes,
        averaged=0.2,
    )
    errors = [100 * one.rmse / span for one in found.passes]
    return errors + errors[-1:] * (passes - len(errors))


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
    parser.add_argument("--sensor", type=float, default=1.0, help="gain of the sensor")
    parser.add_argument("--late", action="store_true", help="one pass is recorded too late")
    parser.add_argument("--late-first", action="store_true", help="the first pass is recorded too late")
    parser.add_argument("--online", action="store_true", help="one run with a RepetitiveController")
    parser.add_argument("--wander", type=float, default=0.0, help="on line: %% by which the period wanders")
    parser.add_argument("--turn", default=0.2, help="on line: share of the period, or: stage")
    parser.add_argument("--whole", action="store_true", help="the error with its mean, of other stages")
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
    if asked.whole:
        table = np.array([whole(asked.first + k, asked.passes) for k in range(asked.stages)])
    elif asked.online:
        table = np.array([online(c, asked.passes, asked.wander / 100, asked.turn) for c in cases])
    else:
        late = (0, 1) if asked.late_first else LATE if asked.late else None
        table = np.array([errors(c, asked.passes, asked.gain, late, asked.sensor) for c in cases])
    print("pass    median   95 %    worst   above the first   above 0.05 %")
    for k, column in enumerate(table.T):
        above, far = int(np.sum(column > table[:, 0])), int(np.sum(column > 0.05))
        middle, most = np.quantile(column, (0.5, 0.95))
        print(f"{k:4}  {middle:8.3f} {most:8.3f} {column.max():8.3f} {above:9} {far:15}")
    worst = int(np.argmax(table[:, min(5, asked.passes - 1)]))
    print(f"worst after five: {asked.first + worst if asked.whole else case(asked.first + 2 * worst)}")


if __name__ == "__main__":
    main()
