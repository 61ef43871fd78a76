"""Stages that share nothing with the controller's model or the studies: how fast may they go, measured first or not?

Hysteresis by Duhem's differential equation or by relays of a log-normal Preisach density, a second mode in six of ten
stages, lag of the amplifier, dead time, all by one matrix exponential; the sensor is sampled at the end of its tick.
Strokes of 0.5 to 200 um, voltage limits from 4 to 1250 V. Sines and rasters up to f0/2 for `measure_dynamics` through
`run`, and up to f0/3 with nothing given. Prints the true rms of the last half, and the largest error after 0.5 s,
% of peak to peak.

    python -m benchmarks.foreign_stages --stages 24                  # dynamics measured first; two minutes
    python -m benchmarks.foreign_stages --stages 24 --nothing        # nothing given
    python -m benchmarks.foreign_stages --stages 24 --jump           # f0 changes by 5 % in the run
    python -m benchmarks.foreign_stages --stages 24 --at 0.2         # resonances at a fifth of the sample rate
    python -m benchmarks.foreign_stages --stages 40 --resonances 45 110 --measure   # soft stages are only measured
    python -m benchmarks.foreign_stages --nothing --only 3 --duration 16
    python -m benchmarks.foreign_stages --stages 24 --modes three      # or front: the first mode is the smaller one
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from truestroke import AdaptiveController, DynamicsError, Timing, measure_dynamics, run, trajectories
from truestroke.signals.judgement import judge

FloatArray = NDArray[np.float64]
LIMITS = ((0.0, 100.0), (-20.0, 120.0), (-10.0, 10.0), (-0.6, 3.6), (-250.0, 1000.0))  # V
STROKES = (0.5, 10.0, 30.0, 200.0)  # um
RATES = (5000.0, 10000.0, 20000.0)  # Hz
RESONANCES = (60.0, 2000.0)  # Hz
ARRANGED = ("close", "three", "front")
RELAYS = 100  # thresholds of each direction: a relay is up to 0.3 % of a motion, below which nothing is learned


class Duhem:
    """h' = 6 |u'| (u / 2 - h) + (1/2 - part) u', of u from -1 to 1."""

    def __init__(self, part: float) -> None:
        self.part, self.u, self.h = part, 0.0, 0.0

    def of(self, u: float) -> float:
        du, self.u = u - self.u, u
        # an implicit step: finite for any jump of the voltage
        self.h = (self.h + 3 * abs(du) * u + (0.5 - self.part) * du) / (1 + 6 * abs(du))
        return self.h


class Relays:
    """Preisach's, with a log-normal density of half-widths and a normal one of centres, beside a spring."""

    def __init__(self, part: float) -> None:
        up, down = (x.ravel() for x in np.meshgrid(*2 * [np.linspace(-1, 1, RELAYS)], indexing="ij"))
        self.up, self.down = (x[up >= down] for x in (up, down))
        half, centre = (self.up - self.down) / 2, (self.up + self.down) / 2
        weight = np.exp(-(centre**2) / 0.72 - (np.log(half + 0.02) - np.log(0.25)) ** 2 / 1.28)
        self.weight, self.part, self.state = weight / weight.sum(), part, np.where(centre > 0, -1.0, 1.0)

    def of(self, u: float) -> float:
        self.state[u >= self.up], self.state[u <= self.down] = 1.0, -1.0
        return 0.5 * ((1 - 2 * self.part) * u + 2 * self.part * float(self.weight @ self.state))


class Stage:
    """An actuator of `run`: hysteresis, dead ticks, amplifier, modes; 0 um is where a large loop ends at 0 V.

    `modes` are frequency (Hz), damping and share of each. `true` has the displacements at the ends of the ticks, um.
    """

    def __init__(
        self,
        modes: Sequence[tuple[float, float, float]],
        rate: float,
        *,
        hysteresis: Duhem | Relays,
        limits: tuple[float, float] = (0.0, 10.0),
        stroke: float = 20.0,
        lag: float = 0.0,
        dead: int = 0,
        noise: float = 1e-5,
        seed: int = 0,
    ) -> None:
        self.modes, self.rate, self.limits, self.stroke, self.hysteresis = modes, rate, limits, stroke, hysteresis
        self.noise, self.random = noise * stroke, np.random.default_rng(seed)
        self.jump = -1, 1.0  # in which tick, and the factor
        self.lag, self.late, self.x = lag, [0.0] * dead, np.zeros(2 * len(modes) + (lag > 0))
        self.change(1.0)
        low, high = limits
        sweep = [np.linspace((low + high) / 2, high, 600), np.linspace(high, low, 1200), np.linspace(low, 0, 600)]
        self.zero = 0.0
        self.zero = [self.strain(v) for v in np.concatenate(sweep).tolist()][-1]
        self.true: list[float] = []

    def change(self, factor: float) -> None:
        """All frequencies are `factor` times the first ones, from the next tick on."""
        states, modes = self.x.size, 2 * len(self.modes)
        both, self.share = np.zeros((states + 1, states + 1)), np.zeros(states)
        for i, (frequency, damping, share) in enumerate(self.modes):
            w = 2 * np.pi * factor * frequency
            both[2 * i, 2 * i + 1], both[2 * i + 1, 2 * i : 2 * i + 2] = 1, (-(w**2), -2 * damping * w)
            both[2 * i + 1, modes], self.share[2 * i] = w**2, share
        if self.lag:
            both[states - 1, states - 1 :] = 2 * np.pi * self.lag * np.array([-1, 1])
        step = expm(both / self.rate)
        self.A, self.b = step[:-1, :-1], step[:-1, -1]

    def strain(self, volts: float) -> float:
        """What hysteresis makes of a voltage, um."""
        low, high = self.limits
        u = (2 * min(max(volts, low), high) - low - high) / (high - low)
        return self.stroke * (self.hysteresis.of(u) + 0.025 * u * u) - self.zero

    def open(self) -> Timing:
        self.true = []
        return Timing(sample_rate=self.rate)

    def exchange(self, volts: FloatArray) -> FloatArray:
        start = len(self.true)
        for v in volts.tolist():
            if len(self.true) == self.jump[0]:
                self.change(self.jump[1])
            self.late.append(self.strain(v))
            self.x = self.A @ self.x + self.b * self.late.pop(0)
            self.true.append(float(self.share @ self.x))
        return np.array(self.true[start:]) + self.noise * self.random.standard_normal(len(volts))


@dataclass(frozen=True)
class First:
    """Where the first resonances are drawn: between two frequencies, Hz, or all `at` a share of the sample rate."""

    low: float = RESONANCES[0]
    high: float = RESONANCES[1]
    at: float | None = None
    arranged: str | None = None  # of `ARRANGED`

    def of(self, rate: float, random: np.random.Generator) -> float:
        drawn = min(float(np.exp(random.uniform(np.log(self.low), np.log(self.high)))), rate / 8)
        return self.at * rate if self.at else drawn


def arranged(kind: str, f0: float, zeta: float, random: np.random.Generator) -> list[tuple[float, float, float]]:
    """Modes near to each other: two, three, or a small one in front of that which carries the most."""
    if kind == "three":
        second, third, lower, higher = random.uniform([1.4, 2.2, 0.05, 0.05], [2.0, 3.2, 0.2, 0.2])
        return [(f0, zeta, 1 - lower - higher), (second * f0, zeta, lower), (third * f0, zeta, higher)]
    ratio = random.uniform(*((1.6, 2.5) if kind == "front" else (1.15, 1.6)))
    share = random.uniform(*((0.75, 0.95) if kind == "front" else (0.1, 0.4)))
    return [(f0, zeta, 1 - share), (ratio * f0, zeta, share)]


def sampled(number: int, first: First = First()) -> tuple[Stage, str]:
    """A stage by its number, and what it is in words."""
    random = np.random.default_rng(number)
    rate = float(random.choice(RATES))
    f0 = first.of(rate, random)
    zeta = np.exp(random.uniform(np.log(0.004), np.log(0.08), size=2))
    ratio, share = random.uniform(2.0, 3.5), random.uniform(0.02, 0.2) if random.random() < 0.6 else 0.0
    modes = [(f0, float(zeta[0]), 1 - share), (ratio * f0, float(zeta[1]), share)][: 2 if share else 1]
    if first.arranged:
        modes = arranged(first.arranged, f0, float(zeta[0]), np.random.default_rng([number, 2]))
        share, ratio = modes[1][2], modes[1][0] / f0
    kind, part = (Duhem, 0.22) if random.random() < 0.5 else (Relays, 0.15)
    limits, stroke = LIMITS[random.integers(5)], float(random.choice(STROKES))
    stage = Stage(
        modes, rate, hysteresis=kind(part * random.uniform(0.5, 1)), limits=limits, stroke=stroke,
        lag=f0 * random.uniform(3, 20), dead=int(random.integers(3)), noise=float(random.choice([1e-5, 5e-5])),
        seed=number,
    )  # fmt: skip
    second = f"{share:.2f} at {ratio:.1f} f0" if share else ""
    volts = f"{limits[0]:g} to {limits[1]:g} V"
    return stage, f"{kind.__name__:7}{f0:6.0f}{rate / 1e3:5.0f}{zeta[0]:8.3f}  {second:14}{volts:>15}{stroke:7g}"


def travel(stage: Stage) -> tuple[float, float]:
    """Displacements between which motions are, um: the middle three fifths of a large loop."""
    low, high = stage.limits
    loop = [stage.strain(v) for v in np.concatenate([np.linspace(0, high, 600), np.linspace(high, low, 600)]).tolist()]
    stage.strain(0.0)
    bottom, top = np.quantile(loop, [0.2, 0.8])
    return float(bottom), float(top)


def follow(
    number: int, given: bool, duration: float, first: First = First(), jump: bool = False
) -> tuple[str, float, float]:
    """What the motion is, true rms of the last half, and the largest error after 0.5 s, % of peak to peak.

    With `jump` the frequencies of the stage change by 5 % when the last half is still 1 s away.
    """
    bottom, top = travel(sampled(number, first)[0])
    stage, _ = sampled(number, first)
    random = np.random.default_rng([number, 1])
    frequency = stage.modes[0][0] * random.uniform(0.03, 0.5 if given else 1 / 3)
    lines = random.random() < 0.25
    settings = {"sample_rate": stage.rate, "stroke": stage.stroke, "voltage_limits": stage.limits}
    motion = {"peak_to_peak": top - bottom, "offset": (top + bottom) / 2, "duration": duration}
    if given:
        settings["dynamics"] = measure_dynamics(stage, voltage_limits=stage.limits)
    if lines:
        turn = {"turn": settings["dynamics"]} if given else {}
        wave = trajectories.raster(frequency=0.3 * frequency, sample_rate=stage.rate, **turn, **motion)
    else:
        wave = trajectories.sine(frequency=frequency, sample_rate=stage.rate, **motion)
    if jump:
        stage.jump = round((duration / 2 - 1) * stage.rate), float(random.choice([0.95, 1.05]))
    verdict = judge(run(wave, AdaptiveController(**settings), stage))
    error = 100 / (top - bottom) * (np.array(stage.true) - wave.position)
    relative = frequency / stage.modes[0][0] * (0.3 if lines else 1)
    words = f"{'raster' if lines else 'sine':6} {relative:.2f} f0 {verdict.level}"
    last, later = error[error.size // 2 :], error[round(stage.rate / 2) :]
    return words, float(np.sqrt(np.mean(last**2))), float(np.abs(later).max())


def measure(number: int, first: First) -> tuple[str, float, float]:
    """What was found in words, and the errors of frequency and damping of the first mode, %."""
    stage, _ = sampled(number, first)
    found, (frequency, damping, _) = measure_dynamics(stage, voltage_limits=stage.limits).modes[0], stage.modes[0]
    errors = 100 * abs(found.frequency / frequency - 1), 100 * abs(found.damping / damping - 1)
    return (f"{found.frequency:.2f} of {frequency:.2f} Hz", *errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of stages, in place of --stages")
    parser.add_argument("--nothing", action="store_true", help="no dynamics are given")
    parser.add_argument("--duration", type=float, default=4.0, help="s")
    parser.add_argument("--resonances", nargs=2, type=float, default=RESONANCES, help="f0 from, to, Hz")
    parser.add_argument("--jump", action="store_true", help="f0 changes by 5 %%, 1 s before the last half")
    parser.add_argument("--at", type=float, help="f0 of all stages, over the sample rate")
    parser.add_argument("--modes", choices=ARRANGED, help="modes that are near to each other")
    parser.add_argument("--measure", action="store_true", help="only measure the dynamics")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # of the slew rate that a motion needs
    first = First(*options.resonances, options.at, options.modes)
    columns = ("f0", "damping, %") if options.measure else ("rms", "largest, % of p-p")
    print("    hysteresis f0, Hz kHz damping second           voltage    stroke   " + "  ".join(columns))
    numbers, kept = options.only or range(options.first, options.first + options.stages), []
    for number in numbers:
        words = sampled(number, first)[1]
        try:
            if options.measure:
                what, one, other = measure(number, first)
            else:
                what, one, other = follow(number, not options.nothing, options.duration, first, options.jump)
        except DynamicsError as error:
            print(f"{number:3} {words}  refused: {error}", flush=True)
            continue
        kept.append((one, other))
        print(f"{number:3} {words}   {what:24}  {one:7.3f} {other:8.2f}", flush=True)
    for name, each in zip(columns, np.array(kept).T, strict=True):
        print(f"{name}: median {np.median(each):.3f}, 95 % {np.quantile(each, 0.95):.3f}, worst {each.max():.2f}")
    print(f"{len(kept)} of {len(numbers)} stages")


if __name__ == "__main__":
    main()
