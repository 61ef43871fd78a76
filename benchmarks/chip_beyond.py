"""Instructions of the longest tick on a Cortex-M7 in motions beyond the self-tests, in QEMU: a table of docs/export.md.

    python benchmarks/chip_beyond.py

Debian: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import chip
import numpy as np

from truestroke import AdaptiveController, export_c
from truestroke.base.typing import FloatArray
from truestroke.control.settings import ControllerSettings
from truestroke.export import recorded

STEPS = 20  # of the simulated stage in a tick
LOST = range(600, 640)
GIVEN = "if (commanded) adaptive_adapt(board_read(&z) ? z : (ts_real)NAN, 0);"  # of main.c


@dataclass(frozen=True)
class Case:
    words: str
    frequency: float = 0.0  # of the stage's one mode, Hz; 0: the actuator of the self-test
    lost: range = range(0)
    told: bool = True  # the loop gives NaN where a measurement is lost; else nothing
    history: int | None = None
    ticks: int = 1000
    flags: str = "-O3"

    def recorded(self, settings: ControllerSettings, rest: float, ticks: int, *_: object) -> FloatArray:
        """As `recorded.recorded`, with this stage and without the lost measurements."""
        controller = AdaptiveController.from_settings(settings)
        low, high = settings.voltage_limits
        gain, width = settings.stroke / (high - low), recorded.PLAY * (high - low)
        motion = np.float32(recorded._motion(settings, ticks, gain * (low - rest), gain * (high - rest)))
        step, w = 1 / settings.sample_rate / STEPS, 2 * math.pi * self.frequency
        play = z = velocity = 0.0
        controller.start(float(np.float32(rest)), 0.0)
        rows = np.empty((ticks, 5))
        for tick, (z_d, zdot_d, zddot_d) in enumerate(motion.astype(float)):
            volts = controller.command(z_d, zdot_d, zddot_d)
            play = max(volts - rest - width, min(volts - rest + width, play))
            strain = gain * (0.8 * (volts - rest) + 0.2 * play)
            if self.frequency > 0:
                for _ in range(STEPS):
                    velocity += step * (w * w * (strain - z) - 2 * 0.02 * w * velocity)
                    z += step * velocity
            else:
                z += 0.7 * (strain - z)
            measured = math.nan if tick in self.lost else float(np.float32(z))
            rows[tick] = z_d, zdot_d, zddot_d, volts, measured
            if self.told or tick not in self.lost:
                controller.adapt(measured)
        return rows

    def most(self) -> str:
        controller = chip.CONTROLLERS["default with the dynamics of a stage"]
        with tempfile.TemporaryDirectory() as place, mock.patch("truestroke.export.c_source.recorded", self.recorded):
            folder = export_c(controller, place, precision="single", ticks=self.ticks, history=self.history).folder
            replay = Path(folder) / "replay.c"
            text = replay.read_text(encoding="utf-8").replace("nanf", "NAN").replace("nan", "NAN")
            replay.write_text("#include <math.h>\n" + text, encoding="utf-8")
            if not self.told:
                loop = Path(folder) / "main.c"
                text = loop.read_text(encoding="utf-8")
                loop.write_text(text.replace(GIVEN, "if (commanded && board_read(&z) && z == z) adaptive_adapt(z, 0);"))
            return chip.instructions(folder, "m7", self.flags).split()[-1]


CASES = (
    Case("a stage of one mode, 900 Hz, as it is given", 900.0, ticks=5000),
    Case("its f0 is given 30 % too high", 900.0 / 1.3, ticks=5000),
    Case("its f0 is given twice as high", 450.0, ticks=5000),
    Case("5 measurements are lost", lost=LOST[:5]),
    Case("40 measurements are lost", lost=LOST),
    Case("40 measurements are lost, `--history 200`", lost=LOST, history=200),
    Case("the same, and the loop gives nothing for them", lost=LOST, told=False, history=200),
    Case("the same, compiled with `-DTS_BACKLOG=1`", lost=LOST, told=False, history=200, flags="-O3 -DTS_BACKLOG=1"),
)


def main() -> None:
    print("| motion | instructions of the longest tick, M7 |\n|---|---|")
    for case in CASES:
        print(f"| {case.words} | {case.most()} |", flush=True)


if __name__ == "__main__":
    main()
