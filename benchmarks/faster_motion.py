"""How many samples the 95 % intervals of a model hold where motion is faster than its record, and how wide they are.

    python -m benchmarks.faster_motion                 48 records, some minutes
    python -m benchmarks.faster_motion --seed 100      48 others
    python -m benchmarks.faster_motion --records 12    fewer

Half of the stages are of `StagePlant`, the others have hysteresis that the model does not have, behind a lag, dead time
or a mode. Each is recorded with a wave, sines or triangles below 1, 3 or 10 Hz, 2 kHz, and then moves at 3, 10, 30 and
80 Hz. A row for each: the rms error of the prediction, % of the stroke, geometric mean; that of the motion that the
voltage of the model makes, a sine of a fifth of the stroke, % of it; samples held without what the interval has by the
speed, and with it, the mean of all motions and the lowest tenth; and the rms of the half width over twice the rms
error, geometric means.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator

import numpy as np
from benchmarks import foreign_records as made
from benchmarks.unseen_records import maxwell_slip, rate_dependent_bouc_wen, saturating

from truestroke.control import interval
from truestroke.control.actuator import ActuatorModel
from truestroke.identification import Record, identify
from truestroke.plant import StagePlant, StageSettings

FS = 2000.0
LONG = {1.0: 40.0, 3.0: 20.0, 10.0: 15.0}  # s of a record, by its frequency, Hz
FREQUENCIES = 3.0, 10.0, 30.0, 80.0

Stage = Callable[[np.ndarray], np.ndarray]  # um, of a voltage from 0 to 1


def of_plant(rng: np.random.Generator) -> Stage:
    first = float(np.exp(rng.uniform(np.log(200), np.log(800))))
    settings = StageSettings(
        sample_rate=FS,
        hysteresis_kind=str(rng.choice(["plays", "preisach", "bouc-wen"])),
        loop_width=0.1,
        resonances=(first,),
        dampings=(float(rng.uniform(0.01, 0.06)),),
        amplifier_bandwidth=float(np.exp(rng.uniform(np.log(100), np.log(3000)))),
        dead_time=float(rng.choice([0, 0.0005, 0.001, 0.002])),
        creep=float(rng.uniform(0.0, 0.02)),
        noise=float(rng.choice([0.003, 0.01, 0.03])),
    )
    seed = int(rng.integers(10**6))

    def run(v: np.ndarray) -> np.ndarray:
        plant = StagePlant(settings, seed=seed)
        plant.open()
        return plant.exchange(3.6 * v)

    return run


def foreign(rng: np.random.Generator) -> Stage:
    seed, widens = int(rng.integers(10**6)), float(rng.uniform(0.02, 0.1))
    kinds: tuple[Callable[[np.ndarray, np.random.Generator], np.ndarray], ...] = (
        lambda v, _: made.duhem(v),
        lambda v, _: made.dahl(v),
        lambda v, _: made.generalised_plays(v),
        lambda v, _: made.bouc_wen(v),
        lambda v, _: rate_dependent_bouc_wen(v, FS, widens),
        maxwell_slip,
        saturating,
        lambda v, r: made.preisach(v, r, 1500),
    )
    kind = kinds[rng.integers(len(kinds))]
    lag, dead = float(rng.choice([0, 0.0003, 0.001, 0.003, 0.01])), float(rng.choice([0, 0, 0.001, 0.004]))
    mode, noise, share = (float(rng.choice(x)) for x in ([0, 0, 120, 250, 500], [3e-4, 1e-3, 2e-3], [0, 0.005, 0.015]))

    def run(v: np.ndarray) -> np.ndarray:
        y = made.creep(kind(v, np.random.default_rng(seed)), FS, share)
        y = made.lagged(y, FS, lag) if lag else y
        y = made.resonance(y, FS, mode, 0.03) if mode else y
        y = made.late(np.arange(v.size) / FS, y, dead)
        return 10 * (y + np.random.default_rng(seed + 1).normal(0, noise, v.size) * np.ptp(y))

    return run


def recorded(rng: np.random.Generator, kind: str, frequency: float) -> np.ndarray:
    t = made.clock(LONG[frequency], FS)
    if kind == "wave":
        return made.wave(t, rng, frequency)
    size = made.low_pass(rng.uniform(0.3, 1.0, t.size)[(0.5 * frequency * t).astype(int)], FS, frequency)
    return np.clip(0.5 + (_periodic(kind, t, 0.5 * frequency) - 0.5) * size, 0.0, 1.0)


def _periodic(kind: str, t: np.ndarray, frequency: float) -> np.ndarray:
    return made.sine(t, frequency) if kind == "sines" else made.up_and_down(t, frequency)


def case(seed: int) -> Iterator[tuple[float, float, np.ndarray, np.ndarray, np.ndarray]]:
    """Of each motion: its frequency (of the record: 0), what a voltage misses, its share; of the stroke: error, widths.

    The widths are without and with the part of the speed.
    """
    rng = np.random.default_rng([seed, 7])
    stage = (of_plant if seed % 2 else foreign)(rng)
    parts = [recorded(rng, ["wave", "sines", "wave", "triangles"][(seed // 2) % 4], list(LONG)[(seed // 2) % 3])]
    spans = [(0.0, parts[0].size // 2, parts[0].size)]
    for frequency in FREQUENCIES:
        kind, share = ["wave", "sines", "triangles"][rng.integers(3)], float(rng.choice([0.3, 0.5, 0.75]))
        t = made.clock(max(2.0, 4.0 / frequency), FS)
        motion = made.wave(t, rng, frequency) if kind == "wave" else _periodic(kind, t, frequency)
        motion = rng.uniform(0.0, 1.0 - share) + share * motion
        way = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 1000))
        parts += [parts[-1][-1] + (motion[0] - parts[-1][-1]) * way, motion]
        start = sum(part.size for part in parts) - motion.size
        spans.append((frequency, start, start + motion.size))
    v, first = np.concatenate(parts), parts[0].size
    z = stage(v)
    model = identify(Record.from_arrays(100 * v[:first], z[:first], sample_rate=FS)).model
    off = z - model.predict(100 * v, FS)
    since = interval.of_zero(model, np.maximum(np.arange(v.size) - first, 0) / FS)
    width = interval.half_width(model, 100 * v, FS, since)
    without = np.sqrt(np.maximum(width**2 - interval.COVERED**2 * interval.of_speed(model, 100 * v, FS), 0.0))
    for frequency, start, stop in spans:
        missed = _missed(stage, model, frequency, float(np.median(z))) if frequency else np.nan
        yield frequency, missed, *(each[start:stop] / model.stroke for each in (off, without, width))


def _missed(stage: Stage, model: ActuatorModel, frequency: float, centre: float) -> float:
    """By how much motion misses for which a model made the voltage, rms over peak-to-peak, its zero left out."""
    t = np.arange(2.0, step=1 / FS)
    wanted = centre + 0.1 * model.stroke * np.sin(2 * np.pi * frequency * t) * np.minimum(1.0, 5 * t)
    made = stage(model.invert(wanted, FS, warn=False) / 100)
    return float(np.std((made - wanted)[t.size // 2 :])) / (0.2 * model.stroke)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--records", type=int, default=48)
    asked = parser.parse_args()
    rows: dict[float, list[list[float]]] = {}
    for seed in range(asked.seed, asked.seed + asked.records):
        for frequency, missed, off, *widths in case(seed):
            errors = [float(np.log(100 * rms)) for rms in (np.sqrt(np.mean(off**2)), missed)]
            held = [float(np.mean(np.abs(off) <= width)) for width in widths]
            ratio = [float(np.log(np.sqrt(np.mean(width**2) / np.mean(off**2)) / 2)) for width in widths]
            rows.setdefault(frequency, []).append(errors + held + ratio)
    print("| motion, Hz | rms, % | missed, % | held, % | tenth | over 2 rms | with the speed | tenth | over 2 rms |")
    print("|---" * 9 + "|")
    for frequency, found in rows.items():
        *errors, held, now, ratio, wide = np.array(found).T
        cells = [f"{np.exp(log.mean()):.3g}" for log in errors]
        cells += [cell for share, log in ((held, ratio), (now, wide)) for cell in _cells(share, log)]
        print(f"| {f'{frequency:g}' if frequency else 'record'} | {' | '.join(cells)} |")


def _cells(held: np.ndarray, ratio: np.ndarray) -> list[str]:
    return [f"{100 * held.mean():.0f}", f"{100 * np.quantile(held, 0.1):.0f}", f"{np.exp(ratio.mean()):.1f}"]


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
