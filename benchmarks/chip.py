"""Memory and instructions of exported controllers on a Cortex-M4F and M7, in QEMU: writes the table of docs/export.md.

    python benchmarks/chip.py

Debian: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Literal

from truestroke import AdaptiveController, Dynamics, Mode, RepetitiveController, export_c, plant, run, trajectories

BENCH = {"sample_rate": 10_000.0, "stroke": 20.0, "voltage_limits": (0.0, 10.0)}
MODES = (Mode(frequency=900.0, damping=0.02, share=0.9), Mode(frequency=2300.0, damping=0.03, share=0.1))
STAGE = Dynamics(sample_rate=10_000.0, modes=MODES, amplifier_bandwidth=3000.0, dead_time=1e-4)
CONTROLLERS = {
    "the paper's, 8 plays": AdaptiveController.paper(**BENCH),
    "default, 26 plays": AdaptiveController(**BENCH),
    "default with the dynamics of a stage": AdaptiveController(**BENCH, dynamics=STAGE),
}
LEARNED = "default with the dynamics of a stage, and a learned motion of 200 ticks"
ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples/cortex-m"
PAGE = ROOT / "docs/export.md"
TABLE = re.compile(r"(?m)^\| controller \| precision \|.*\n(?:\|.*\n)*")
HEAD = "| controller | precision | state | settings | stack | code | instructions per tick, M4F: mean and most | M7 |\n"
CORES = {"m4": "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16", "m7": "-mcpu=cortex-m7 -mfpu=fpv5-d16"}


def output(*command: object) -> str:
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, check=True).stdout


def memory(folder: Path) -> tuple[int, int, int, int]:
    """Bytes of state, settings, the deepest stack of a call, and code, for a Cortex-M4F."""
    flags = f"CFLAGS=-O3 {CORES['m4']} -mthumb -mfloat-abi=hard"
    printed = output("make", "-s", "-C", folder, "stack", "CC=arm-none-eabi-gcc", flags)
    stack = max(int(line.split()[0]) for line in printed.splitlines()[:4])
    sizes = {
        Path(line.split()[5]).stem: list(map(int, line.split()[:3]))
        for line in output("arm-none-eabi-size", *sorted(folder.glob("stack/*.o"))).splitlines()[1:]
    }
    constants = [sizes[name][0] for name in ("settings", "period") if name in sizes]
    code = sum(text for text, _, _ in sizes.values()) - sum(constants)
    return sizes["adaptive"][2], sum(constants), stack, code


def instructions(folder: Path, core: str, flags: str = "-O3") -> str:
    """Per tick: mean and most; fails where the bits are not those of the desk."""
    makefile = ("make", "-s", "-f", EXAMPLE / "Makefile", f"EXPORT={folder}", f"OUT={folder}", f"OPTIMISED={flags}")
    printed = output(*makefile, f"{core}.run")
    if not re.search(r"passed: (\d+) of \1 commands", printed):
        raise SystemExit(printed)
    return " and ".join(f"{int(n):,}" for n in re.findall(r"mean (\d+), most (\d+)", printed)[0])


def learned() -> RepetitiveController:
    """What three seconds of lines on a simulated stage have shown."""
    inside = AdaptiveController(**BENCH, dynamics=STAGE)
    controller = RepetitiveController(inside, 0.02)
    lines = trajectories.raster(frequency=50.0, peak_to_peak=10.0, duration=3.0, sample_rate=10_000.0, turn=0.2)
    settings = plant.StageSettings(resonances=(900.0,), dampings=(0.02,), hysteresis_kind="plays", dead_time=1e-4)
    run(lines, controller, plant.StagePlant(settings, seed=1))
    return controller


def row(
    name: str, controller: AdaptiveController | RepetitiveController, precision: Literal["single", "double"], ticks: int
) -> str:
    with tempfile.TemporaryDirectory() as place:
        folder = export_c(controller, place, precision=precision, ticks=ticks).folder
        found = [f"{size:,}" for size in memory(folder)]
        found += [instructions(folder, core) for core in CORES]
    return f"| {name} | {precision} | {' | '.join(found)} |\n"


def main() -> None:
    argparse.ArgumentParser(description=__doc__.split("\n")[0]).parse_args()  # --help measures and writes nothing
    table = HEAD + "|" + "---|" * 8 + "\n"
    for name, controller in CONTROLLERS.items():
        table += row(name, controller, "single", 1000) + row(name, controller, "double", 1000)
    table += row(f"{name}, a faster motion", controller, "single", 400)
    table += row(LEARNED, learned(), "single", 1000)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(TABLE.sub(lambda _: table, page), encoding="utf-8")
    print(table, end="")


if __name__ == "__main__":
    main()
