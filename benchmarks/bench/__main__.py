"""What a step costs on this machine, beside other packages: the tables of docs/bench.md.

python -m benchmarks.bench [--steps 1000000] [--output NAME] [--plots FOLDER] [--json]

In a clone, where the sources of the kernel are. Recursive least squares of 16 parameters in C, in padasip, dlib,
filterpy, river and NumPy, beside the machine's limit for it; ticks of the paper's and the default controller in C and
through Python. Writes NAME.html.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.bench import page, suite, table


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench", description="What a step costs here.")
    parser.add_argument("--steps", type=int, default=1_000_000, help="of the kernel in C; a tenth of them through "
                        "Python, a hundredth of another package; at least 10000")  # fmt: skip
    parser.add_argument("--output", type=Path, default=Path("truestroke-bench"), help="write OUTPUT.html")
    parser.add_argument("--plots", type=Path, help="also write each plot as PNG, light and dark, into this folder")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    asked = parser.parse_args()
    if asked.steps < 10_000:
        parser.error(f"--steps = {asked.steps}: must be at least 10000")
    costs, missing = suite.run(asked.steps)
    made = page.page(costs, missing, f"{parser.prog} --steps {asked.steps}")
    path = made.save(asked.output.with_suffix(".html"))
    if asked.plots:
        made.save_plots(asked.plots)
    if asked.json:
        print(json.dumps({"machine": table.machine(), "costs": [c.as_dict() for c in costs], "missing": missing}))
        return
    for columns, rows in (table.update_table(costs), table.tick_table(costs), table.axes_table(costs)):
        print("\n".join(f"| {' | '.join(cells)} |" for cells in (columns, ["---"] * len(columns), *rows)), end="\n\n")
    print("\n".join([table.verdict(costs), *(f"- not measured: {reason}" for reason in missing), f"page: {path}"]))


if __name__ == "__main__":
    main()
