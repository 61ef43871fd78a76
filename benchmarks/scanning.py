"""Where `truestroke scan` keeps its tenth of a pixel: other stages, sizes, rates, sensors and seeds than its own.

    python -m benchmarks.scanning
    python -m benchmarks.scanning --between    # rates and rotations between the resonances: tables of decision 205
    python -m benchmarks.scanning --sampled 40 [--first 100]    # stages and scans by chance: table of decision 236
    python -m benchmarks.scanning --spirals 40 [--first 200]    # spirals by chance, alone and learned: decision 374

Each row changes one thing of the command: 512 x 512 pixels of 20 um at 40 rows a second and 5 kHz, a stage of plays at
900 Hz and of Preisach at 700 Hz. Largest distortion and shift between trace and retrace, pixels; rms of x and y, nm.
"""

import argparse
import dataclasses
import itertools
import warnings

import numpy as np

from truestroke import SettingError
from truestroke.plant import MultiAxisSettings, MultiAxisStage
from truestroke.signals import scans
from truestroke.studies.scanning import imaging, lines

KINDS = ("plays", "preisach", "bouc-wen")
MET = (  # resonances that a harmonic meets, hysteresis, damping, rows a second
    ((600.0, 500.0), ("plays", "preisach"), 0.02, 40.0),
    ((400.0, 350.0), ("plays", "bouc-wen"), 0.01, 40.0),
    ((900.0, 700.0), ("bouc-wen", "plays"), 0.01, 100.0),
    ((900.0, 700.0), ("bouc-wen", "preisach"), 0.01, 100.0),
    ((900.0, 700.0), ("plays", "preisach"), 0.01, 100.0),
    ((900.0, 680.0), ("plays", "preisach"), 0.01, 100.0),
)
TURNED = (((900.0, 700.0), (600.0, 500.0)), (("plays", "bouc-wen"), ("bouc-wen", "bouc-wen")))  # of the spirals


def stage(
    resonances=(900.0, 700.0),
    kinds=("plays", "preisach"),
    damping=imaging.DAMPING,
    share=1.0,
    noise=imaging.NOISE,
    rate=imaging.SAMPLE_RATE,
) -> MultiAxisSettings:
    """That of the command but for these; `share` multiplies its cross-talk."""
    made = imaging.stage_of(resonances, kinds, noise)
    axes = tuple(dataclasses.replace(one, dampings=(damping,), sample_rate=rate) for one in made.axes)
    coupling = [[share * entry for entry in row] for row in imaging.COUPLING]
    return dataclasses.replace(made, axes=axes, coupling=coupling)


def cases():
    """Words, and what differs."""
    yield "the command", {}
    for x, y in ((600.0, 500.0), (1500.0, 1200.0), (400.0, 300.0), (900.0, 900.0)):
        yield f"{x:g} and {y:g} Hz", {"resonances": (x, y)}
    for damping in (0.005, 0.01, 0.05):
        yield f"damping {damping:g}", {"damping": damping}
    for kinds in itertools.product(KINDS, KINDS):
        yield f"{kinds[0]} and {kinds[1]}", {"kinds": kinds}
    yield "cross-talk of 5 and 3.3 %", {"share": 5 / 3}
    yield "noise of 3 nm", {"noise": 0.003}
    yield "noise of 10 nm", {"noise": 0.01}
    yield "10 kHz", {"rate": 10_000.0}
    yield "1500 and 1200 Hz, 10 kHz", {"resonances": (1500.0, 1200.0), "rate": 10_000.0}
    for width in (1.0, 5.0, 10.0):
        yield f"{width:g} um", {"width": width}
    for rows in (10.0, 20.0, 50.0, 100.0):
        yield f"{rows:g} rows a second", {"rows": rows}
    for wrong in (-3.0, 3.0):
        yield f"resonances {wrong:+g} % wrong", {"wrong": wrong}
    for seed in (1, 2):
        yield f"seed {seed}", {"seed": seed}
    for damping, kinds in itertools.product((0.01, 0.03), (("bouc-wen", "plays"), ("plays", "bouc-wen"))):
        other = {"damping": damping, "kinds": kinds, "seed": 7}
        words = f"{damping:g}, {kinds[0]} and {kinds[1]}"
        yield f"400, 350 Hz, {words}", other | {"resonances": (400.0, 350.0)}
        for rate, rows in ((10e3, 10.0), (10e3, 40.0), (20e3, 80.0)):
            given = other | {"resonances": (2000.0, 1600.0), "rate": rate, "rows": rows}
            yield f"2000, 1600 Hz, {rows:g} rows, {words}", given


def followed(width=imaging.WIDTH, rows=imaging.RATE, wrong=0.0, seed=0, scanned=None, **given):
    """Largest distortion and shift, pixels; rms of x and y, nm. `scanned` has other arguments of `scan_of`."""
    made = stage(**given)
    known = wrongly(made, wrong)
    scan = imaging.scan_of(known, rows, width, **(scanned or {}))
    controllers = imaging.controllers_of(known, lines.period_of(scan))
    true = lines.together(scan, MultiAxisStage(made, seed), controllers)
    found = scans.distortion(scan, *true.T, imaging.PIXELS)
    x, y = found.rms_um()
    return found.largest, found.trace_retrace, 1e3 * x, 1e3 * y


def sampled(number: int) -> dict[str, object]:
    """A stage of 250 to 3000 Hz and a scan from its number; at least 4.5 samples in an oscillation."""
    random = np.random.default_rng(number)
    x = float(np.exp(random.uniform(np.log(250.0), np.log(3000.0))))
    y, rate = x * float(random.uniform(0.6, 1.0)), float(random.choice([5e3, 10e3, 20e3, 50e3]))
    while rate < 4.5 * x:
        rate *= 2
    damping = round(float(np.exp(random.uniform(np.log(0.003), np.log(0.08)))), 4)
    kinds = tuple(str(kind) for kind in random.choice(KINDS, 2))
    rows = float(random.choice([5, 10, 20, 25, 40, 50, 80, 100]))
    width, share = float(random.choice([2.0, 5.0, 10.0, 20.0, 20.0])), float(random.choice([1.0, 5 / 3]))
    made = {"resonances": (round(x), round(y)), "damping": damping, "kinds": kinds, "rows": rows, "width": width}
    slow = min(rate, 2e4) if rows < 20 else rate
    return made | {"rate": slow, "share": share, "noise": imaging.NOISE * width / 20.0, "seed": number}


def between() -> None:
    """Largest distortion at rates that meet a resonance, with what else was possible, and at those between."""
    print(f"{'largest distortion, pixels':46} lead 4 s   lead 8 s       ramp    between")
    for resonances, kinds, damping, rows in MET:
        given = {"resonances": resonances, "kinds": kinds, "damping": damping}
        quiet = scans.quiet_rate(rows, resonances, imaging.SAMPLE_RATE)
        found = [
            followed(rows=rate, scanned=scanned, **given)[0]
            for rate, scanned in ((rows, {}), (rows, {"lead_in": 8.0}), (rows, {"slow": "ramp"}), (quiet, {}))
        ]
        words = f"{resonances[0]:g}, {resonances[1]:g} Hz, {kinds[0]}, {kinds[1]}, {rows:g} rows"
        print(f"{words:46}" + "".join(f"{one:9.3f}  " for one in found) + f"({quiet:.2f})", flush=True)
    print(f"{'spirals, % of the diameter':46}" + "".join(f"{one:9.2f}  " for one in turns(900.0, 700.0)))
    for resonances, kinds in itertools.product(*TURNED):
        made = stage(resonances=resonances, kinds=kinds)
        found = [turned(made, rotation) for rotation in turns(*resonances)]
        words = f"{resonances[0]:g}, {resonances[1]:g} Hz, {kinds[0]}, {kinds[1]}"
        print(f"{words:46}" + "".join(f"{one:9.3f}  " for one in found), flush=True)


def turns(*resonances: float) -> tuple[float, float]:
    """Turns a second of the command, and between the resonances, Hz."""
    return imaging.ROTATION, scans.quiet_rate(imaging.ROTATION, resonances, imaging.SAMPLE_RATE)


def turned(made: MultiAxisSettings, rotation: float) -> float:
    """Error of a spiral, % of its diameter, rms."""
    scan = imaging.spiral_of(made, rotation)
    return off(scan, made, made, lines.period_of(scan))


def off(scan: scans.Scan, made: MultiAxisSettings, known: MultiAxisSettings, period: float | None, seed=0) -> float:
    """The same of a scan with a period or without, on a stage that is known as another."""
    true = lines.together(scan, MultiAxisStage(made, seed), imaging.controllers_of(known, period))
    error = true - np.stack([axis.position for axis in scan.axes], axis=1)
    return imaging.percent_off(scan, error) * imaging.WIDTH / scan.size[0]


def spirals(numbers: range) -> None:
    """Spirals by chance, whose resonances are known as they are or 3 % wrong: alone, and what is learned of turns."""
    print(f"{'% of the diameter, rms':80}   alone  learned")
    found = []
    for number in numbers:
        given, random = sampled(number), np.random.default_rng([number, 374])
        width, _, seed = (given.pop(name) for name in ("width", "rows", "seed"))
        most = min(given["resonances"]) / 5
        rotation = float(
            random.choice([one for one in (5.0, 10.0, 20.0, 40.0, 50.0, 100.0, 125.0, 200.0) if one < most])
        )
        turns = min(int(random.choice([64, 128, 256])), round(12 * rotation))  # at most 12 s
        wrong = float(random.choice([0.0, 0.0, -3.0, 3.0]))
        made, usual = stage(**given), {"offset": imaging.OFFSET, "lead_out": imaging.LEAD_OUT}
        scan = scans.spiral(diameter=width, turns=turns, rotation=rotation, sample_rate=given["rate"], **usual)
        words = f"{number}: {given['resonances']}, {given['damping']}, {given['kinds']}, {width:g} um, "
        words += f"{turns} turns at {rotation:g} Hz, {wrong:+g} %"
        try:
            pair = [off(scan, made, wrongly(made, wrong), period, seed) for period in (None, lines.period_of(scan))]
        except SettingError as error:
            print(f"{words}: refused: {error}", flush=True)
            continue
        found.append(pair)
        print(f"{words:80}{pair[0]:8.3f} {pair[1]:8.3f}", flush=True)
    for name, share in (("median", 50), ("95 %", 95), ("worst", 100)) if found else ():
        print(f"{name:80}" + "".join(f"{one:8.3f} " for one in np.percentile(found, share, axis=0)))


def wrongly(made: MultiAxisSettings, percent: float) -> MultiAxisSettings:
    """The same stage with all resonances so far off."""
    axes = tuple(
        dataclasses.replace(one, resonances=tuple((1 + percent / 100) * f for f in one.resonances)) for one in made.axes
    )
    return dataclasses.replace(made, axes=axes)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--between", action="store_true", help="rates between the resonances instead")
    parser.add_argument("--sampled", type=int, metavar="N", help="so many stages and scans by chance instead")
    parser.add_argument("--spirals", type=int, metavar="N", help="so many spirals by chance instead")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    asked = parser.parse_args()
    if asked.spirals:
        spirals(range(asked.first, asked.first + asked.spirals))
        return
    if asked.between:
        between()
        return
    print(f"{'':46} largest  trace-retrace    x nm    y nm")
    numbers = range(asked.first, asked.first + (asked.sampled or 0))
    drawn = ((f"{k}: {', '.join(str(one) for one in sampled(k).values())}", sampled(k)) for k in numbers)
    for words, given in drawn if asked.sampled else cases():
        try:
            largest, shift, x, y = followed(**given)
        except SettingError as error:
            print(f"{words:46} refused: {error}", flush=True)
            continue
        print(f"{words:46} {largest:7.3f} {shift:14.3f} {x:7.2f} {y:7.2f}", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
