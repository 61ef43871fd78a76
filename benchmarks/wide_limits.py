"""What it costs to tell voltage limits or a stroke that are too wide; docs/adaptation.md.

    python benchmarks/wide_limits.py [--first 0] [--last 59] [--seed 0]

The even runs of the 2 kHz half of the robustness study: the true rmse of the second half, um, and the alarms of change
beside the changes that there were.
"""

import argparse
import warnings
from typing import Any

import numpy as np

from truestroke import AdaptiveController
from truestroke.control.feasibility import LimitWarning
from truestroke.plant import RealisticPlant
from truestroke.runtime.loop import run
from truestroke.studies.robustness import metrics, sample
from truestroke.studies.robustness.sample import KNOWN, plant_of

warnings.simplefilter("ignore", LimitWarning)  # that the gain told is too small is the question

TOLD: dict[str, dict[str, Any]] = {
    "as it is": {},
    "-10 to 10 V": {"voltage_limits": (-10.0, 10.0)},
    "150 um": {"stroke": 150.0},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, default=59)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    runs = [sample(asked.seed, n, []) for n in range(asked.first + asked.first % 2, asked.last + 1, 2)]
    changes = sum(plant_of(one).change is not None for one in runs)
    print(f"{len(runs)} runs, {changes} changes; rmse, um: median, 95 %, worst; alarms beyond the changes")
    for words, given in TOLD.items():
        rows = []
        for one in runs:
            plant = RealisticPlant(plant_of(one), one.seed, one.dropouts)
            recording = run(one.trajectory, AdaptiveController(**KNOWN | given), plant)
            rows.append(metrics(one, recording))
        rmse = np.percentile([row["rmse"] for row in rows], [50, 95, 100])
        alarms = sum(row["changes"] for row in rows) - changes
        print(f"{words:12} {rmse[0]:.4f} {rmse[1]:.4f} {rmse[2]:.4f} {alarms:4d}", flush=True)


if __name__ == "__main__":
    main()
