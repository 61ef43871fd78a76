"""Where `truestroke scan` keeps its tenth of a pixel: other stages, sizes, rates, sensors and seeds than its own.

    python -m benchmarks.scanning

Each row changes one thing of the command: 512 x 512 pixels of 20 um at 40 rows a second and 5 kHz, a stage of plays at
900 Hz and of Preisach at 700 Hz. Largest distortion and shift between trace and retrace, pixels; rms of x and y, nm.
"""

import dataclasses
import itertools
import warnings

from truestroke import SettingError
from truestroke.plant import MultiAxisSettings, MultiAxisStage
from truestroke.signals import scans
from truestroke.studies.scanning import imaging, lines

KINDS = ("plays", "preisach", "bouc-wen")


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


def followed(width=imaging.WIDTH, rows=imaging.RATE, wrong=0.0, seed=0, **given):
    """Largest distortion and shift, pixels; rms of x and y, nm."""
    made = stage(**given)
    told = tuple(
        dataclasses.replace(one, resonances=tuple((1 + wrong / 100) * f for f in one.resonances)) for one in made.axes
    )
    known = dataclasses.replace(made, axes=told)
    scan = imaging.scan_of(known, rows, width)
    controllers = imaging.controllers_of(known, lines.period_of(scan))
    true = lines.together(scan, MultiAxisStage(made, seed), controllers)
    found = scans.distortion(scan, *true.T, imaging.PIXELS)
    x, y = found.rms_um()
    return found.largest, found.trace_retrace, 1e3 * x, 1e3 * y


def main() -> None:
    print(f"{'':46} largest  trace-retrace    x nm    y nm")
    for words, given in cases():
        try:
            largest, shift, x, y = followed(**given)
        except SettingError as error:
            print(f"{words:46} refused: {error}", flush=True)
            continue
        print(f"{words:46} {largest:7.3f} {shift:14.3f} {x:7.2f} {y:7.2f}", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
