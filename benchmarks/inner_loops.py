"""What the 95 % interval of a model of one loop holds of motion inside of that loop, with and without its inner loops.

python -m benchmarks.inner_loops              seed 2; some minutes
python -m benchmarks.inner_loops --seed 3     other draws

Five hysteresis models that have been through their whole range, each recorded with strokes of one length; then four
other motions in the same range, beside their zero and with the noise of the sensor.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np
from benchmarks import other_motions
from benchmarks.foreign_records import clock, jiles_atherton, sine, up_and_down

from truestroke.identification import Record, examine, identify

FS, SECONDS, SETTLED = other_motions.RATE, other_motions.SECONDS, other_motions.SETTLED
STROKE, VOLTS = 30.0, 100.0


def dahl(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """h' = s v' (1 - h sign v'), y = v - c h."""
    s, c, h = rng.uniform(3.0, 10.0), rng.uniform(0.05, 0.2), np.zeros(v.size)
    for k, dv in enumerate(np.diff(v), 1):
        h[k] = h[k - 1] + s * dv * (1 - np.sign(dv) * h[k - 1])
    return np.asarray(v - c * h)


ACTUATORS: dict[str, other_motions.Simulator] = {
    "Jiles-Atherton": lambda v, rng: jiles_atherton(2 * v - 1),
    "Dahl": dahl,
    "Bouc-Wen": other_motions.SIMULATORS["asymmetric Bouc-Wen"],
    "Preisach": other_motions.SIMULATORS["Preisach"],
    "Maxwell slip": other_motions.SIMULATORS["Maxwell slip with a curve"],
}
RECORDS: dict[str, other_motions.Motion] = {
    "sine": lambda t, rng: sine(t, 1.0),
    "triangle": lambda t, rng: up_and_down(t, 1.0),
    "sine of the middle": lambda t, rng: 0.3 + 0.4 * sine(t, 1.0),
}
MOTIONS: dict[str, other_motions.Motion] = {
    **{name: other_motions.OTHERS[name] for name in ("random wave", "triangles of random height", "raster")},
    "small loops": lambda t, rng: 0.3 + 0.4 * t / t[-1] + 0.15 * sine(t, 1.0),
}


def shares(actuator: str, record: str, seed: int) -> list[tuple[float, float, float]]:
    """Of each motion: what the interval holds without inner loops and with them, and by how much it is wider."""
    rng = np.random.default_rng([seed, list(ACTUATORS).index(actuator), list(RECORDS).index(record)])
    own, t = int(rng.integers(2**32)), clock(SECONDS, FS)
    v, noise = RECORDS[record](t, rng), float(rng.choice([0.001, 0.003, 0.01]))
    used = np.concatenate([np.linspace(0, 1, round(FS)), np.linspace(1, 0, round(FS))])

    def moved(v: np.ndarray) -> np.ndarray:
        whole = np.concatenate([used, np.linspace(0, v[0], round(FS)), v])
        return np.asarray(ACTUATORS[actuator](whole, np.random.default_rng(own))[-v.size :])

    z = moved(v)
    scale = STROKE / np.ptp(z)
    made = Record.from_arrays(VOLTS * v, scale * z + noise * STROKE * rng.standard_normal(t.size), sample_rate=FS)
    findings = examine(made)
    model = identify(made, findings=findings).model
    without = model.replace(explored=dataclasses.replace(model.explored, inner=0.0))
    found = []
    for motion in MOTIONS.values():
        other = v.min() + np.ptp(v) * motion(t, rng)
        off = (scale * moved(other) - model.predict(VOLTS * other, FS))[round(SETTLED * t.size) :]
        off += findings.noise_um * rng.standard_normal(off.size) - np.median(off)
        widths = [each.interval(VOLTS * other, FS)[-off.size :] for each in (without, model)]
        held = [float(np.mean(np.abs(off) <= width)) for width in widths]
        found.append((*held, float(widths[1].mean() / widths[0].mean())))
    return found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=2)
    seed = parser.parse_args().seed
    print(
        "| actuator | motions | held, % | with inner loops | below 75 % | with | width |\n|---|---|---|---|---|---|---|"
    )
    for actuator in ACTUATORS:
        before, now, wider = np.array([each for record in RECORDS for each in shares(actuator, record, seed)]).T
        below = f"{np.sum(before < 0.75)} | {np.sum(now < 0.75)}"
        held = f"{100 * before.mean():.1f} | {100 * now.mean():.1f}"
        print(f"| {actuator} | {now.size} | {held} | {below} | x {np.exp(np.log(wider).mean()):.2f} |", flush=True)


if __name__ == "__main__":
    main()
