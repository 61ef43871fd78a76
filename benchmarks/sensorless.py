"""Trace against retrace without a sensor, by a model of the day before: python -m benchmarks.sensorless [--plants 15]

Stages of three structures in turn (plays, Preisach, Bouc-Wen), each with a width and a form of its loop, creep,
resonance and damping of its own. A record of rasters at the rate of the scan, two of them of its width, is identified
as `truestroke identify` does it. On another day an image of 512 columns is scanned open loop, and `truestroke unwarp`
corrects it. With --changed 1 stroke and width of the loop differ by a per cent then, rms: what no model knows without
a sensor. Printed are the shifts of the retrace against the trace, and the largest error of the places of the pixels,
but for one shift of all, in pixels of 512. With --noise and --steps the voltage is that of a monitor, with --rows
the record has more rows.
"""

from __future__ import annotations

import argparse
import dataclasses
from dataclasses import dataclass

import numpy as np

import truestroke
from truestroke import scans
from truestroke.identification.unwarp_voltage import quieted
from truestroke.plant import StagePlant, StageSettings

FS, COLUMNS, ROWS = 2000.0, 512, 128
WIDTH, OFFSET = 18.0, 13.0  # um
WIDTHS = 25.0, 21.0, 18.0, 18.0  # um, of the record
KINDS = "plays", "preisach", "bouc-wen"
GOAL = 0.3  # pixels


@dataclass(frozen=True)
class Shown:
    """Of one stage: shifts of the retrace, and the error of the places that were predicted, pixels."""

    before: float
    after: float
    places: float


def stage_of(number: int, changed: float) -> tuple[StageSettings, StageSettings]:
    """The stage of a number, on the day before and on that of the scan, changed by so many %."""
    rng = np.random.Generator(np.random.PCG64(number))
    settings = StageSettings(
        sample_rate=FS,
        resonances=(float(rng.uniform(500.0, 900.0)),),
        dampings=(float(rng.uniform(0.01, 0.03)),),
        noise=0.003,
        hysteresis_kind=KINDS[number // 2 % 3],
        loop_width=float(rng.uniform(0.1, 0.16)),
        threshold_exponent=float(rng.uniform(0.8, 1.5)),
        preisach_tilt=float(rng.uniform(0.2, 0.6)),
        preisach_scale=float(rng.uniform(0.3, 0.7)),
        bouc_wen_beta=float(rng.uniform(3.0, 5.0)),
        creep=float(rng.uniform(0.01, 0.02)),
    )
    stroke, loop = 1 + changed / 100 * rng.normal(size=2)
    later = dataclasses.replace(
        settings, stroke=float(stroke * settings.stroke), loop_width=float(loop * settings.loop_width)
    )
    return settings, later


def model_of(settings: StageSettings, rate: float, seed: int, rows: int = 16) -> truestroke.Model:
    """Of the axis, from rasters of some widths and so many rows, one after the other."""
    gain = settings.stroke / settings.voltage_limits[1]
    parts = [
        scans.raster(width=width, lines=rows, rate=rate, sample_rate=FS, offset=(OFFSET, OFFSET)).axes[0].position
        for width in WIDTHS
    ]
    volts = np.concatenate(parts) / gain
    plant = StagePlant(settings, seed=seed)
    plant.open()
    return truestroke.identify((volts, plant.exchange(volts), FS)).model


def monitored(volts: np.ndarray, noise: float, step: float, seed: int) -> np.ndarray:
    """A voltage as a monitor records it, with noise and steps, V."""
    read = volts + noise * np.random.Generator(np.random.PCG64(seed)).standard_normal(volts.size)
    return np.round(read / step) * step if step else read


def shown(number: int, rate: float, changed: float, noise: float = 0.0, step: float = 0.0, rows: int = 16) -> Shown:
    """What a stage shows whose voltage is recorded with this noise and in such steps, V."""
    before, later = stage_of(number, changed)
    model = model_of(before, rate, number, rows)
    scan = scans.raster(width=WIDTH, lines=ROWS, rate=rate, sample_rate=FS, offset=(OFFSET, OFFSET))
    gain = before.stroke / before.voltage_limits[1]
    volts = [axis.position / gain for axis in scan.axes]
    true = []
    for k, one in enumerate(volts):
        plant = StagePlant(later, seed=number + 1000 * (k + 1))
        plant.open()
        plant.exchange(one)
        true.append(plant.truth)
    places = [scans.at_pixels(scan, one, COLUMNS) for one in true]
    images = scans.images(scan, scans.Texture(seed=number, grain=0.3)(*places), name="height", unit="nm")
    read = [monitored(one, noise, step, number + k) for k, one in enumerate(volts)]
    found = truestroke.unwarp(images, truestroke.ScanRecord.of(scan, *read), model, model)
    assert found.before is not None
    assert found.after is not None
    low, high = model.voltage_range
    used, _ = quieted(read[0], FS, high - low, scan.lines["start"][::2])
    error = model.predict(used, FS, measured=False) - true[0]
    error = error[scan.inside]
    pixel = WIDTH / COLUMNS
    largest = float(np.abs(error - np.median(error)).max()) / pixel
    return Shown(float(np.hypot(*found.before)), float(np.hypot(*found.after)), largest)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=15)
    parser.add_argument("--first", type=int, default=1, help="number of the first stage; every second one is taken")
    parser.add_argument("--rate", type=float, default=4.0, help="rows per second, Hz")
    parser.add_argument("--changed", type=float, default=0.0, help="stroke and loop on the day of the scan, %% rms")
    parser.add_argument("--rows", type=int, default=16, help="of each raster of the record")
    parser.add_argument("--noise", type=float, default=0.0, help="of a sample of the monitor, mV")
    parser.add_argument("--steps", type=float, default=0.0, help="of its converter, mV")
    asked = parser.parse_args()
    print("stage  structure  before   after  places   pixels of 512")
    every = []
    for number in range(asked.first, asked.first + 2 * asked.plants, 2):
        one = shown(number, asked.rate, asked.changed, asked.noise / 1000, asked.steps / 1000, asked.rows)
        every.append(one)
        kind = stage_of(number, 0.0)[0].hysteresis_kind
        print(f"{number:5}  {kind:9}  {one.before:6.2f}  {one.after:6.3f}  {one.places:6.2f}", flush=True)
    after = np.array([one.after for one in every])
    within = int(np.sum(after <= GOAL))
    print(
        f"trace to retrace {np.median(after):.2g} median, {after.max():.2g} worst; {within} of {after.size} <= {GOAL}"
    )


if __name__ == "__main__":
    main()
