"""A page of each kind that the commands write, to look at: `python -m docs.site.reports FOLDER`.

The runs are short, and of simulated stacks; one of them, `bad`, has a bad verdict. `make reports-look` opens the pages.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from truestroke import plant
from truestroke.runtime.realtime import config

AXIS = '\n[[axis]]\nname = "{}"\nstroke = 30.0\nvoltage_limits = [-0.6, 3.6]\nslew = 4000.0\n'
SCAN = """[driver]
name = "simulated"
sample_rate = 2000.0
channels = 2
axes = {stages = [{resonances = [900.0]}, {resonances = [600.0]}], coupling = [[0.0, 0.03], [0.03, 0.0]]}

[[driver.signals]]
name = "height"
sample = "texture"

[scan]
MOTION
offset = [8.0, 8.0]

[coupled]

[realtime]
overrun_streak = 0
watchdog_timeout = 9.0

[recording]
file = "NAME.h5"
"""
MOTIONS = {
    "raster": 'kind = "raster"\nwidth = 6.0\nlines = 16\nrate = 20.0\nturn = 0.3',
    "spiral": 'kind = "spiral"\ndiameter = 6.0\npitch = 0.3\nrotation = 20.0',
}
COMMANDS = """\
track --duration 4 --output track
track --trajectory sine --voltage-limits -0.6 1.5 --duration 2 --output bad
run --config stage.toml
report run.h5 --output run.html
commission --config stage.toml --yes
bode --output bode
learn --passes 3 --output learn
characterise --duration 2 --speeds 100,300 --output characterise
identify record.csv --output identify.toml --report identify.html
score identify.toml other.csv --report score.html
invert sine --peak-to-peak 20 --duration 1 --model identify.toml --output invert.csv --report invert.html
scan --output scan
scan --config raster.toml --images gwy
scan --config spiral.toml
unwarp raster.gwy --record raster-x.h5 --lines lines.csv --model identify.toml --output unwarped.gsf
compare --duration 4 --output compare
robustness --plants 4 --output robustness
robustness --fast --plants 1 --output fast
reproduce fig4 table1 --output reproduce
study study.toml --runs 8 --output study"""

WITH_PAGE = {0, 3, 4}  # exit codes after which there is a page: its verdict may be bad


def prepare(folder: Path) -> None:
    """The files that the commands read."""
    folder.mkdir(parents=True, exist_ok=True)
    short = (
        config.example()
        .replace("duration = 20.0", "duration = 4.0")
        .replace("overrun_streak = 20", "overrun_streak = 0")
        .replace("watchdog_timeout = 0.25", "watchdog_timeout = 9.0")  # other programs may have the processor
    )
    (folder / "stage.toml").write_text(short)
    for name, motion in MOTIONS.items():
        table = SCAN.replace("MOTION", motion).replace("NAME", name)
        (folder / f"{name}.toml").write_text(table + AXIS.format("x") + AXIS.format("y"))
    imaging = config.load(folder / "raster.toml").imaging
    assert imaging is not None
    imaging.scan.save_lines(folder / "lines.csv")
    time = np.arange(12_000) / 2000.0
    volts = 1.5 - 1.5 * np.cos(2 * np.pi * time) * np.cos(0.7 * time)
    for seed, name in enumerate(("record", "other")):
        z = plant.RealisticPlant(seed=seed).exchange(volts)
        np.savetxt(folder / f"{name}.csv", np.stack([time, volts, z], 1), delimiter=",", header="t,u,z", comments="")
    (folder / "study.toml").write_text(truestroke(folder, "study", "--example").stdout)


def truestroke(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command in the folder."""
    command = [Path(sys.executable).with_name("truestroke"), *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def main(folder: Path) -> list[str]:
    """Make all pages; the commands that made none."""
    prepare(folder)
    failed = []
    for line in COMMANDS.splitlines():
        print(line, flush=True)
        done = truestroke(folder, *line.split(), "--overwrite")
        if done.returncode not in WITH_PAGE:
            failed.append(f"truestroke {line}: exit code {done.returncode}: {done.stderr.strip()}")
    return failed


if __name__ == "__main__":
    sys.exit("\n".join(main(Path(sys.argv[1]))) or 0)
