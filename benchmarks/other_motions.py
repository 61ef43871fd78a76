"""Models that are `good`, on another motion than that of their record: how many are wrong by twice what they state.

python -m benchmarks.other_motions                          seed 1, noise of 0.3 and 1 %; ten minutes
python -m benchmarks.other_motions --seed 4 --noise 0.2     other draws
python -m benchmarks.other_motions --every                  a line of each record, and not of the false ones alone

Twelve hysteresis models, each moved in ten ways, with creep, a lag, dead time, two modes or a zero that walks; then in
another way, whose true displacement is known. A `good` model is false where its error there is more than twice that
which it states; `beyond` says whether `ActuatorModel.beyond` warns of that motion. The second table has how many
samples of that motion, with noise, the 95 % intervals of the models hold; alike are strokes of one length at one place.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from benchmarks.foreign_records import (
    bouc_wen,
    clock,
    creep,
    duhem,
    generalised_plays,
    jiles_atherton,
    lagged,
    late,
    low_pass,
    preisach,
    resonance,
    sine,
    up_and_down,
    wave,
)
from benchmarks.further_records import backlash_like, lugre, moving_thresholds, switching
from benchmarks.unseen_records import maxwell_slip, saturating

from truestroke.identification import Identified, Record, examine, identify

FALSE = 2.0  # times the stated error
RATE, SECONDS = 300.0, 16.0  # Hz, s: of a motion before it is made faster or slower
SETTLED = 0.2  # of the other motion, at its start, that is not judged

Draw = np.random.Generator
Simulator = Callable[[np.ndarray, Draw], np.ndarray]
Motion = Callable[[np.ndarray, Draw], np.ndarray]

SIMULATORS: dict[str, Simulator] = {
    "asymmetric Bouc-Wen": lambda v, rng: bouc_wen(v, 0.35, rng.uniform(1.5, 3.0), rng.uniform(-0.8, 0.4)),
    "Preisach": lambda v, rng: preisach(v, rng, 1500),
    "Krasnosel'skii": lambda v, rng: saturating(v, rng, 60),
    "Duhem": lambda v, rng: duhem(v, rng.uniform(3.0, 9.0)),
    "bristles, Stribeck": lambda v, rng: lugre(v, RATE),
    "Jiles-Atherton": lambda v, rng: jiles_atherton(2 * v - 1),
    "Maxwell slip with a curve": lambda v, rng: curved(maxwell_slip(v, rng), rng.uniform(-0.15, 0.15)),
    "plays between envelopes": lambda v, rng: generalised_plays(v),
    "thresholds that grow with the rate": lambda v, rng: moving_thresholds(v, RATE, rng, 0.02),
    "relays that switch by heat": lambda v, rng: switching(v, RATE, rng),
    "Coleman and Hodgdon": lambda v, rng: backlash_like(v, rng.uniform(3.0, 8.0)),
    "square of a polarisation": lambda v, rng: jiles_atherton(0.1 + 0.8 * v) ** 2,
}


def curved(y: np.ndarray, share: float) -> np.ndarray:
    return y + share * y * (1 - y)


# ---- Motions of about 1 Hz, from 0 to 1 ------------------------------------------------------------------------------


def heights(t: np.ndarray, rng: Draw, least: float = 0.2) -> np.ndarray:
    """Another height from each second on."""
    return rng.uniform(least, 1.0, int(t[-1]) + 2)[t.astype(int)]


def steps(t: np.ndarray, rng: Draw) -> np.ndarray:
    return low_pass(rng.uniform(0.0, 1.0, int(2 * t[-1]) + 2)[(2 * t).astype(int)], RATE, 8.0)


def modulated(t: np.ndarray, rng: Draw) -> np.ndarray:
    phase = 2 * np.pi * np.cumsum(0.4 + 1.6 * sine(t, 0.11)) / RATE
    return 0.5 - (0.1 + 0.4 * sine(t, 0.07 * rng.uniform(0.8, 1.2))) * np.cos(phase)


def chirped(t: np.ndarray, rng: Draw) -> np.ndarray:
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.cumsum(0.2 + 2.0 * t / t[-1]) / RATE)


def raster(t: np.ndarray, rng: Draw) -> np.ndarray:
    """Lines of one length on a staircase, with sharp turns."""
    return 0.1 + 0.4 * up_and_down(t, 1.0) + 0.5 * np.floor(t) / np.ceil(t[-1])


MOTIONS: dict[str, Motion] = {
    "random wave": lambda t, rng: wave(t, rng, 2.0),
    "wave in bursts": lambda t, rng: 0.5 + (wave(t, rng, 2.0) - 0.5) * low_pass(0.4 + 0.6 * (t % 8 < 4), RATE, 2.0),
    "sines of random height": lambda t, rng: low_pass(sine(t, 1.0) * heights(t, rng), RATE, 20.0),
    "triangles of random height": lambda t, rng: up_and_down(t, 1.0) * heights(t, rng),
    "triangles that decay": lambda t, rng: up_and_down(t, 1.0) * (1 - 0.9 * t / t[-1]),
    "reversal curves": lambda t, rng: 1 - up_and_down(t + 0.5, 1.0) * (0.1 + 0.9 * np.ceil(t + 0.5) / np.ceil(t[-1])),
    "chirp": chirped,
    "modulated sine": modulated,
    "steps that are rounded": steps,
    "one sine": lambda t, rng: sine(t, 1.0),
}
OTHERS: dict[str, Motion] = {
    "random wave": MOTIONS["random wave"],
    "triangles of random height": MOTIONS["triangles of random height"],
    "raster": raster,
    "rounded steps": steps,
}

# ---- What surrounds the hysteresis -----------------------------------------------------------------------------------


def two_modes(y: np.ndarray, rng: Draw) -> np.ndarray:
    first, damping = rng.uniform(10.0, 40.0), rng.uniform(0.01, 0.05)
    return 0.8 * resonance(y, RATE, first, damping) + 0.2 * resonance(y, RATE, 2.3 * first, damping)


SURROUNDINGS: dict[str, Simulator] = {
    "": lambda y, rng: y,
    "creep": lambda y, rng: creep(y, RATE, rng.uniform(0.005, 0.02)),
    "a lag": lambda y, rng: lagged(y, RATE, rng.uniform(0.003, 0.03)),
    "dead time": lambda y, rng: late(np.arange(y.size) / RATE, y, rng.uniform(0.002, 0.02)),
    "two modes": two_modes,
    "a zero that walks": lambda y, rng: y,
}
WALK = 0.002  # of the stroke, in a second


@dataclass(frozen=True)
class Case:
    """A record, and another motion with its true displacement, um, at the same sample rate."""

    name: str
    record: Record
    volts: np.ndarray
    true: np.ndarray


def case(simulator: str, motion: str, number: int, seed: int, noise: float) -> Case:
    """Of these two; surroundings, units, speed and the other motion are drawn by number and seed."""
    rng = np.random.Generator(np.random.PCG64([seed, number, round(1e4 * noise)]))
    around, other = rng.choice(list(SURROUNDINGS)), rng.choice(list(OTHERS))
    unit, volts, stroke = 10 ** rng.uniform(-2.5, 1.5), 10 ** rng.uniform(0.3, 2.9), 10 ** rng.uniform(-0.5, 2.5)
    bias = rng.choice([0.0, -0.2, -0.5])
    own = int(rng.integers(2**32))  # of the actuator, the same in both motions

    def moved(v: np.ndarray) -> np.ndarray:
        of, rest = np.random.Generator(np.random.PCG64(own)), round(RATE)
        from_rest = np.concatenate([np.linspace(-bias, v[0], rest), v])  # as models have it: from 0 V
        return SURROUNDINGS[around](SIMULATORS[simulator](from_rest, of), of)[rest:]

    t = clock(SECONDS, RATE)
    first, second = MOTIONS[motion](t, rng), OTHERS[other](t, rng)
    z, true = moved(first), moved(second)
    span = float(np.ptp(z))
    measured = z / span + 0.01 * noise * rng.standard_normal(t.size)
    if around == "a zero that walks":
        measured += np.cumsum(WALK / np.sqrt(RATE) * rng.standard_normal(t.size))
    words = f"{simulator}, {motion}{', ' * bool(around)}{around}, {noise:g} %; then {other}"
    made = Record.from_arrays(volts * (first + bias), stroke * measured, time=unit * t, source=words)
    return Case(words, made, volts * (second + bias), stroke * true / span)


def cases(seed: int, noise: float) -> Iterator[Case]:
    """Each simulator in each motion."""
    pairs = [(simulator, motion) for simulator in SIMULATORS for motion in MOTIONS]
    for number, pair in enumerate(pairs):
        yield case(*pair, number, seed, noise)


# ---- What is counted -------------------------------------------------------------------------------------------------


def true_error(found: Identified, made: Case) -> tuple[float, bool]:
    """Rms error on the other motion, um, beside its zero; and whether `beyond` warns of it."""
    model, fs = found.model, made.record.sample_rate
    error = (made.true - model.predict(made.volts, fs))[round(SETTLED * made.true.size) :]
    beyond = model.beyond(made.volts, fs)
    return float(np.std(error)), bool(beyond.warnings)


def held(found: Identified, made: Case) -> float:
    """Share of the other motion, beside its zero and with noise, that the 95 % interval holds."""
    model, fs, start = found.model, made.record.sample_rate, round(SETTLED * made.true.size)
    error = (made.true - model.predict(made.volts, fs))[start:]
    noise = examine(made.record).noise_um * np.random.Generator(np.random.PCG64(0)).standard_normal(error.size)
    return float(np.mean(np.abs(error - np.median(error) + noise) <= model.interval(made.volts, fs)[start:]))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.3, 1.0], help="of the sensor, %% of the stroke")
    parser.add_argument("--every", action="store_true")
    asked = parser.parse_args()
    rows, shares = [], []
    for noise in asked.noise:
        counts = dict.fromkeys(("good", "false", "beyond", "right", "right beyond", "spared"), 0)
        for made in cases(asked.seed, noise):
            found = identify(made.record)
            error, beyond = true_error(found, made)
            alike = any("Strokes of one" in reason or "All strokes" in reason for reason in found.verdict.reasons)
            shares.append((alike, held(found, made)))
            wrong, good = error > FALSE * found.held_out.rmse_um, found.verdict.level == "good"
            counts["good"] += good
            counts["false"] += good and wrong
            counts["beyond"] += good and wrong and beyond
            counts["right"] += good and not wrong
            counts["right beyond"] += good and not wrong and beyond
            counts["spared"] += found.verdict.level == "doubtful" and not wrong
            if asked.every or (good and wrong):
                times = error / found.held_out.rmse_um
                print(f"{found.verdict.level:8} {times:6.2f} times, beyond: {beyond!s:5} {made.name}", flush=True)
                if asked.every:
                    print(*found.verdict.reasons, sep="\n", flush=True)
        rows.append(f"| {noise:g} % | " + " | ".join(map(str, counts.values())) + " |")
    print("\n| noise | good | of these false | warned of | of these right | warned of | doubtful, and right |")
    print("|---|---|---|---|---|---|---|", *rows, sep="\n")
    print("\n| strokes | models | held, mean | median | below 90 % | below 75 % |\n|---|---|---|---|---|---|")
    for name, kind in (("alike", True), ("others", False)):
        each = np.array([share for alike, share in shares if alike == kind])
        below = f"{np.sum(each < 0.9)} | {np.sum(each < 0.75)}"
        print(f"| {name} | {each.size} | {100 * each.mean():.1f} % | {100 * np.median(each):.1f} % | {below} |")


if __name__ == "__main__":
    main()
