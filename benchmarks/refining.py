"""Passes that are refined one after another, behind the sweep of the model: what each of them misses, nm rms.

python -m benchmarks.refining 5 6     these seeds; two minutes each

A stage of plays, Preisach or Bouc-Wen, with creep, an amplifier and a resonance, makes the record of its model, then
four passes of a sine of 12 Hz and of lines of 3 Hz in the middle of the travel, at once or 20 s apart, each behind the
ramp from 0 V and the rest of `truestroke playback`.
"""

from __future__ import annotations

import sys

import numpy as np

from truestroke import trajectories
from truestroke.identification import Record, identify, refine, waveform
from truestroke.model.sampled import REST
from truestroke.plant import StagePlant, StageSettings

RATE, LIMITS, PASSES = 2000.0, (0.0, 3.6), 4  # Hz, V
KINDS, GAPS = ("plays", "preisach", "bouc-wen"), (0.0, 20.0)  # s between passes


def motions(middle: float, travel: float) -> dict[str, np.ndarray]:
    t = np.arange(2 * int(RATE)) / RATE
    sine = 0.25 * np.sin(2 * np.pi * 12 * t) * np.minimum(1.0, t / 0.1)
    lines = 0.3 * (4 * np.abs((3 * t + 0.25) % 1 - 0.5) - 1)
    return {"sine": middle + travel * sine, "lines": middle + travel * lines}


def ramp(start: float, stop: float) -> np.ndarray:
    """20 V/s"""
    return np.linspace(start, stop, 2 + int(abs(stop - start) / 20.0 * RATE))


def errors(kind: str, seed: int, motion: str, gap: float) -> list[float]:
    """Of each pass, nm rms."""
    settings = StageSettings(
        sample_rate=RATE, hysteresis_kind=kind, loop_width=0.12, resonances=(500.0,), amplifier_bandwidth=1000.0
    )
    stage = StagePlant(settings, seed=seed)
    stage.open()
    sweep = trajectories.random_wave(duration=8.0, sample_rate=RATE, cutoff=10.0, seed=seed).position
    volts = LIMITS[1] * (sweep - sweep.min()) / np.ptp(sweep)
    stage.exchange(ramp(0.0, volts[0]))
    z = stage.exchange(volts)
    stage.exchange(ramp(volts[-1], 0.0))
    model = identify(Record.from_arrays(volts, z, sample_rate=RATE)).model
    desired = motions(0.5 * (z.max() + z.min()), float(np.ptp(z)))[motion]
    wave, found = waveform(model, desired, RATE, voltage_limits=LIMITS), []
    for _ in range(PASSES):
        stage.exchange(np.zeros(1 + int(gap * RATE)))
        stage.exchange(np.append(ramp(0.0, wave.volts[0]), np.full(int(REST * RATE), wave.volts[0])))
        measured = stage.exchange(wave.volts)
        stage.exchange(ramp(wave.volts[-1], 0.0))
        refined = refine(model, Record.from_arrays(wave.volts, measured, sample_rate=RATE), waveform=wave)
        found.append(1000 * float(np.sqrt(np.mean((measured - desired) ** 2))))
        model, wave = refined.model, refined.next(voltage_limits=LIMITS)
    return found


def main() -> None:
    print("| seed | stage | motion | s between | passes, nm |\n|---|---|---|---|---|")
    for seed in map(int, sys.argv[1:] or ["5", "6"]):
        for i, kind in enumerate(KINDS):
            for j, motion in enumerate(("sine", "lines")):
                gap = GAPS[(i + j + seed) % 2]
                shown = ", ".join(f"{error:.0f}" for error in errors(kind, seed, motion, gap))
                print(f"| {seed} | {kind} | {motion} | {gap:g} | {shown} |", flush=True)


if __name__ == "__main__":
    main()
