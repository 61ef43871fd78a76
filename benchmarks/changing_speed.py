"""What `RepetitiveController` has where the speed of a raster changes in mid-run: python -m benchmarks.changing_speed

Stages of 100 to 2000 Hz, damping 0.005 to 0.05, hysteresis of three structures, 2 to 20 kHz, 0 or 1 tick of dead time,
noise of 0.3 to 30 nm; the dynamics are up to 3 % wrong, and not given to every fourth. A raster of 20 um runs for 5 s,
for 4 s at 1.2, 2 or 0.5 times its speed, which `controller.period` is given, and for 4 s as before. True error on the
lines: in the first second after each change and in its last half, over that of the controller alone in the same motion,
rms, median, 95 % and worst; and in the worst quarter of a second, or period if that is longer.

With `--unstated` nobody says that the speed changes: by 0.3 or 1 % in a tick, or by 1 % within two seconds, as of a
motion whose period is locked to something else.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline

from truestroke import (
    AdaptiveController,
    Dynamics,
    LimitWarning,
    Mode,
    RepetitiveController,
    SettingError,
    run,
    trajectories,
)
from truestroke.plant import StagePlant, StageSettings

FloatArray = npt.NDArray[np.float64]
RATES, FINE, BEGIN, WINDOW = (2000, 5000, 10_000, 20_000), 20, 0.3, 0.25
LASTS, DRIFT = (5.0, 4.0, 4.0), 2.0
SPEEDS = (1.2, 0.0), (2.0, 0.0), (0.5, 0.0)  # and s in which it is reached
UNSTATED = (1.003, 0.0), (0.997, 0.0), (1.01, 0.0), (0.99, DRIFT)


@dataclass(frozen=True)
class Case:
    """A stage, what is known of it, and the ticks of a period and the turns of its raster."""

    settings: StageSettings
    known: Dynamics | None
    ticks: int
    turn: float


def case(number: int) -> Case:
    """The one of a number."""
    rng = np.random.default_rng([314, number])
    f0 = float(np.exp(rng.uniform(np.log(100), np.log(2000))))
    rate = float(rng.choice([r for r in RATES if r >= 5 * f0]))
    lines = float(np.clip(rng.uniform(1 / 80, 1 / 8) * f0, rate / 4000, min(rate / 40, 120.0)))
    damping, kind = float(rng.uniform(0.005, 0.05)), str(rng.choice(["plays", "preisach", "bouc-wen"]))
    settings = StageSettings(
        sample_rate=rate,
        resonances=(f0,),
        dampings=(damping,),
        hysteresis_kind=kind,
        noise=float(rng.choice([0.0003, 0.003, 0.01, 0.03])),
        dead_time=float(rng.choice([0, 1])) / rate,
    )
    known = Dynamics(sample_rate=rate, modes=(Mode(frequency=float(rng.uniform(0.97, 1.03)) * f0, damping=damping),))
    return Case(settings, None if rng.uniform() < 0.25 else known, round(rate / lines), float(rng.uniform(0.2, 0.5)))


@dataclass(frozen=True)
class Changes:
    """How the speed of a motion changes: to so many times itself, within so many seconds; whether somebody says so."""

    speed: float
    within: float
    stated: bool

    def turns(self, c: Case) -> tuple[FloatArray, FloatArray, FloatArray, list[tuple[int, int]]]:
        """Turns at each tick and two derivatives, a second; first tick and ticks of a period of each part."""
        rate, before, rows, parts, at, turned = c.settings.sample_rate, 1.0, [], [], 0, 0.0
        for lasts, times in zip(LASTS, (1.0, self.speed, 1.0), strict=True):
            own = round(c.ticks / times) if self.stated else c.ticks / times
            time = np.arange(round(max(1, round(lasts * rate / own)) * own) + 1) / rate
            u = np.clip(time / self.within, 0.0, 1.0) if self.within else np.ones(time.size)
            speed = (before + (times - before) * u**2 * (3 - 2 * u)) * rate / (own * times)
            turns = turned + np.append(0.0, np.cumsum((speed[1:] + speed[:-1]) / 2)) / rate
            change = np.gradient(speed) * rate if self.within else np.zeros(time.size)
            rows.append((turns[:-1], speed[:-1], change[:-1]))
            parts.append((at, round(own)))
            at, turned, before = at + time.size - 1, turns[-1], times
        turns, speed, change = (np.concatenate(some) for some in zip(*rows, strict=True))
        return turns, speed, change, parts


def motion(c: Case, changes: Changes) -> tuple[trajectories.Trajectory, list[tuple[int, int]]]:
    """The raster, whose speed changes in the middle of a turn; first tick and ticks of a period of each part."""
    rate, fine = c.settings.sample_rate, c.ticks * FINE
    period = c.ticks / rate
    asked = {"frequency": 1 / period, "peak_to_peak": 20.0, "offset": 12.0, "turn": c.turn, "ramp": period}
    one = trajectories.raster(duration=5 * period, sample_rate=rate * FINE, **asked)
    low = 2 * fine + int(np.argmin(one.position[2 * fine : 3 * fine]))
    part, phase = slice(low, low + fine + 1), np.arange(fine + 1) / fine
    velocity = CubicHermiteSpline(phase, one.velocity[part] * period, one.acceleration[part] * period**2)
    position = CubicHermiteSpline(phase, one.position[part], one.velocity[part] * period)
    u = np.arange(round(BEGIN * rate)) / (BEGIN * rate)
    start = one.position[low] * u**3 * (10 - 15 * u + 6 * u**2)
    turns, speed, change, parts = changes.turns(c)
    p = turns % 1.0
    flat = one.flat[part][(p * fine).astype(int)]
    moved = (
        (start, position(p)),
        (np.gradient(start) * rate, velocity(p) * speed),
        (np.gradient(np.gradient(start)) * rate**2, velocity(p, 1) * speed**2 + velocity(p) * change),
        (np.zeros(u.size), flat),
    )
    z, v, a, flat = (np.concatenate(some) for some in moved)
    made = trajectories.Trajectory("raster", rate, z, v, one.settings, a, flat)
    return made, [(at + u.size, own) for at, own in parts]


class Changing(RepetitiveController):
    """It is given the period of each part of a motion at its first tick."""

    parts: Sequence[tuple[int, int]] = ()
    commands = 0

    def command(self, *ahead: float) -> float:
        """As of the controller."""
        for at, ticks in self.parts[1:]:
            if self.commands == at:
                self.period = ticks / self.sample_rate
        self.commands += 1
        return super().command(*ahead)


def errors(c: Case, changes: Changes) -> list[list[FloatArray]]:
    """Of the controller alone and of the other one, in windows behind each change, um rms on the lines."""
    wave, parts = motion(c, changes)
    asked = {"sample_rate": wave.sample_rate, "stroke": 30.0, "voltage_limits": c.settings.voltage_limits}
    alone, inside = (AdaptiveController(**asked, dynamics=c.known) for _ in range(2))
    learning = Changing(inside, c.ticks / wave.sample_rate)
    learning.parts = parts if changes.stated else ()
    made = []
    for controller in (alone, learning):
        done = run(wave, controller, StagePlant(c.settings, seed=c.ticks))
        squares = np.where(done["flat"] > 0, (done["true"] - done["desired"]) ** 2, np.nan)
        of = []
        for (at, own), end in zip(parts[1:], (parts[2][0], squares.size), strict=True):
            window = max(round(WINDOW * wave.sample_rate), own)
            of.append(np.sqrt([np.nanmean(squares[k : k + window]) for k in range(at, end - window + 1, window)]))
        made.append(of)
    return made


def rms(x: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stages", type=int, default=16)
    parser.add_argument("--unstated", action="store_true", help="small changes that nobody states")
    parser.add_argument("--each", action="store_true", help="print each change, too")
    given = parser.parse_args()
    warnings.simplefilter("ignore", LimitWarning)
    ratios = []
    for number in range(given.first, given.first + given.stages):
        c = case(number)
        second = max(1, round(1 / max(WINDOW, c.ticks / c.settings.sample_rate)))
        for speed, within in UNSTATED if given.unstated else SPEEDS:
            try:
                found = errors(c, Changes(speed, within, not given.unstated))
            except SettingError as error:
                print(f"stage {number} at {speed} times the speed: {error}")
                continue
            for alone, learned in zip(*found, strict=True):
                late = slice(alone.size // 2, None)
                ratios.append(
                    (
                        rms(learned[:second]) / rms(alone[:second]),
                        float(np.max(learned / alone)),
                        rms(learned[late]) / rms(alone[late]),
                    )
                )
                if given.each:
                    shown = " ".join(f"{one:6.2f}" for one in ratios[-1])
                    print(f"{number:5} {speed:6g} {shown}   alone {1000 * rms(alone[late]):.1f} nm", flush=True)
    print(f"{len(ratios)} changes, times the error of the controller alone: median, 95 %, worst")
    for name, x in zip(("first second", "worst window", "last half"), np.transpose(ratios), strict=True):
        print(f"{name:14}" + "".join(f"{value:8.2f}" for value in (np.median(x), np.quantile(x, 0.95), x.max())))


if __name__ == "__main__":
    main()
