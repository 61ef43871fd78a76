"""Waveforms of identified models, played on the simulated stage of the record: what they miss, and their verdicts.

python -m benchmarks.waveforms              three stages, two records each, 18 motions; two minutes
python -m benchmarks.waveforms --every      a line of each waveform, too
python -m benchmarks.waveforms --rest 10    s under the first voltage

A stage of plays, Preisach or Bouc-Wen, with creep, an amplifier and a resonance, is driven by a random wave of 1 or of
10 Hz. Its model makes sines and triangles of 2, 20 and 80 Hz, 0.3 to 0.75 of the travel. Each voltage is played on the
stage after a rest under its first voltage, as by `truestroke playback`. The error is true minus desired displacement,
in % of the motion's peak-to-peak, rms: whole, and without its mean, which is the zero. "Endless" is the voltage of a
model that takes all creep to have ended in the rest.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator

import numpy as np

import truestroke
from truestroke import trajectories
from truestroke.identification import PredictedWaveform, Record, identify
from truestroke.plant import StagePlant, StageSettings
from truestroke.runtime.drivers.playback import REST

RATE, SECONDS = 2000.0, 20.0  # Hz, s: of the record
LIMITS = (0.0, 3.6)  # V
KINDS = {"plays": 0.13, "preisach": 0.10, "bouc-wen": 0.10}  # and the width of the loop


def stage(kind: str, seed: int) -> StagePlant:
    settings = StageSettings(
        sample_rate=RATE, hysteresis_kind=kind, loop_width=KINDS[kind], resonances=(500.0,), amplifier_bandwidth=1000.0
    )
    made = StagePlant(settings, seed=seed)
    made.open()
    return made


def ramp(volts: float) -> np.ndarray:
    """From 0 V, as `playback` does it: a second for the whole of the limits."""
    return np.linspace(0.0, volts, 1 + round(RATE * volts / LIMITS[1]))


def recorded(kind: str, frequency: float, seed: int) -> Record:
    """A random wave over the whole range of the voltage, after a ramp from 0 V."""
    wave = trajectories.random_wave(duration=SECONDS, sample_rate=RATE, cutoff=frequency, seed=seed).position
    volts = LIMITS[1] * (wave - wave.min()) / np.ptp(wave)
    plant = stage(kind, seed)
    plant.exchange(ramp(volts[0]))
    return Record.from_arrays(volts, plant.exchange(volts), sample_rate=RATE)


def motions(record: Record) -> Iterator[tuple[str, np.ndarray]]:
    """In the middle of the travel of the record."""
    middle, travel = 0.5 * (record.displacement.max() + record.displacement.min()), np.ptp(record.displacement)
    for frequency in (2.0, 20.0, 80.0):
        for share in (0.3, 0.5, 0.75):
            for name in ("sine", "triangle"):
                make = getattr(trajectories, name)
                wave = make(duration=4.0, sample_rate=RATE, frequency=frequency, peak_to_peak=share * travel).position
                yield f"{name} {frequency:g} Hz, {share:g}", wave + middle - 0.5 * (wave.max() + wave.min())


def missed(kind: str, made: PredictedWaveform, seed: int, rest: float) -> tuple[float, float]:
    """Rms error, % of the motion's peak-to-peak, and that without its mean."""
    plant = stage(kind, seed + 100)
    first = made.volts[0]
    plant.exchange(np.append(ramp(first), np.full(round(rest * RATE), first)))
    plant.exchange(made.volts)
    error = 100 * (plant.truth - made.desired) / np.ptp(made.desired)
    return float(np.sqrt(np.mean(error**2))), float(np.std(error))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rest", type=float, default=REST)
    options = parser.parse_args()
    print(
        f"{'stage, record':18}{'model':>10}{'motions':>9}{'rms':>8}{'worst':>8}{'no zero':>9}{'endless':>9}{'worst':>8}"
    )
    for kind in KINDS:
        for frequency in (1.0, 10.0):
            record = recorded(kind, frequency, options.seed)
            found = identify(record)
            rows: dict[str, list[tuple[float, ...]]] = {}
            for name, desired in motions(record):
                made, endless = (
                    truestroke.waveform(found.model, desired, RATE, voltage_limits=LIMITS, rest=rest)
                    for rest in (options.rest, math.inf)
                )
                row = (
                    *missed(kind, made, options.seed, options.rest),
                    *missed(kind, endless, options.seed, options.rest),
                )
                rows.setdefault(name.split()[1], []).append(row[:3])
                if options.every:
                    print(f"  {name:24}{made.verdict.level:10}" + "".join(f"{value:8.2f}" for value in row[:3]))
            for motion, errors in rows.items():
                rms, still, endless_rms = np.array(errors).T
                print(
                    f"{f'{kind}, {frequency:g} Hz':18}{found.verdict.level:>10}{motion:>6} Hz{rms.mean():8.2f}"
                    f"{rms.max():8.2f}{still.mean():9.2f}{endless_rms.mean():9.2f}{endless_rms.max():8.2f}"
                )


if __name__ == "__main__":
    main()
