"""In how many runs the module of the browser has the bits of the package: `python -m benchmarks.browser_bits [RUNS]`.

Stacks are those of the robustness study, controllers of random size and speed, a third of them with the dynamics of a
stage. Each run goes through node; a run counts where every command and every measurement has the same bits.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from web import build

from truestroke import AdaptiveController, Dynamics, Mode, export_json
from truestroke.studies.robustness.sample import plant_of, sample

CHECK = Path(build.__file__).with_name("check.mjs")
TICKS = 2000


def loops(folder: Path, runs: int) -> list[Path]:
    """Runs of controller and stack."""
    files = []
    for i in range(runs):
        make = AdaptiveController.paper if i % 3 == 0 else AdaptiveController
        run = build.looped(make(**build.STACK), plant_of(sample(0, i, ())), TICKS, seed=i)
        files.append(folder / f"loop{i}.json")
        files[-1].write_text(json.dumps(run))
    return files


def controllers(folder: Path, runs: int) -> list[Path]:
    """Runs of a controller of any size and speed."""
    random, files = np.random.Generator(np.random.PCG64(0)), []
    for i in range(runs):
        rate, stroke, high = 10 ** random.uniform(2.5, 4.6), 10 ** random.uniform(-2, 3), 10 ** random.uniform(0, 3)
        known = {}
        if i % 3 == 0:
            modes = (Mode(frequency=rate * random.uniform(0.03, 0.3), damping=random.uniform(0.005, 0.1)),)
            known["dynamics"] = Dynamics(
                sample_rate=rate, modes=modes, amplifier_bandwidth=rate * random.uniform(0.1, 0.4)
            )
        limits = (-high * random.uniform(0, 1), high)
        controller = AdaptiveController(sample_rate=rate, stroke=stroke, voltage_limits=limits, **known)
        files.append(export_json(controller, folder / f"controller{i}.json", ticks=TICKS))
    return files


def main() -> None:
    """Count."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wasm = folder / "truestroke.wasm"
        wasm.write_bytes(build.module())
        for what, files in (("controller and stack", loops(folder, runs)), ("controller", controllers(folder, runs))):
            command = ["node", CHECK, wasm, *files]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.stderr:
                sys.exit(done.stderr)
            same = [int(line.split()[1]) for line in done.stdout.splitlines()]
            print(f"{what}: the same bits in {sum(n == TICKS for n in same)} of {len(files)} runs of {TICKS} ticks")


if __name__ == "__main__":
    main()
