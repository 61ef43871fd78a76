"""How the cost of a study grows: with plays, plants and workers; and what a million plants cost on a thousand cores.

    python benchmarks/cost_growth.py [FOLDER FOR THE PICTURES]

Costs of a run are time of the processor, which others on the machine disturb least; those of a whole study are of the
clock on the wall: they need a quiet machine. Figures of one run of this script belong together.
"""

import os
import platform
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from truestroke.report import style
from truestroke.report.page import save_plots
from truestroke.studies import study
from truestroke.studies.engine import executors
from truestroke.studies.study.config import Study

SEC43 = tomllib.loads(study.example())
PLAYS, PLANTS, SAMPLES, ROUNDS = (4, 8, 16, 24, 32), (25, 50, 100, 200), 6, 3
MILLION, CORES = 1_000_000, 1000


def with_plays(plays: int) -> Study:
    laws = {name: law | {"plays": plays} for name, law in SEC43["controllers"].items()}
    return study.parse(SEC43 | {"controllers": laws})


def of_a_run(asked: Study) -> dict[str, float]:
    """Least time of the processor of several rounds, ms, by part: draw, default, paper."""
    found = [study.simulate(asked, range(SAMPLES)).seconds for _ in range(ROUNDS)]
    return {part: min(1e3 * one[part] / SAMPLES for one in found) for part in found[0]}


def wall(runs: int, work: executors.Work) -> float:
    """Of a study from an empty store, s."""
    with (
        tempfile.TemporaryDirectory() as folder,
        study.Store(Path(folder) / "s", asked := study.parse(SEC43 | {"runs": runs})) as store,
    ):
        start = time.perf_counter()
        study.run(asked, store, work)
        return time.perf_counter() - start


def of_a_driver() -> tuple[float, float]:
    """What one driver spends on handing round a batch by dask, and on keeping a row, ms."""
    asked, empty = study.parse(SEC43), 1000
    stream = executors.dask(1)(asked, [()] * (empty + 1))
    next(stream)  # the cluster stands
    start = time.perf_counter()
    for _ in stream:
        pass
    batch = 1e3 * (time.perf_counter() - start) / empty
    rows = study.simulate(study.parse(SEC43 | {"wave": {"kind": "sine", "duration": 1.0}}), range(100)).rows
    with tempfile.TemporaryDirectory() as folder, study.Store(Path(folder) / "s", asked) as store:
        start = time.perf_counter()
        store.add(study.Batch(rows, {}, 0))
        return batch, 1e3 * (time.perf_counter() - start) / len(rows)


def million(run: dict[str, float]) -> tuple[float, float]:
    """Of a million plants, from the parts, s: all workers together, and the driver beside them."""
    batch, row = of_a_driver()
    batches = len(study.batches(study.parse(SEC43), range(MILLION)))
    workers, driver = MILLION * sum(run.values()) / 1e3, (batches * batch + MILLION * row) / 1e3
    print(f"\nA driver spends {batch:.2f} ms on a batch (dask) and {row:.3f} ms on a row.")
    print(f"A million plants: {workers / 3600:.1f} core hours; {workers / CORES:.0f} s on a thousand cores; {batches} "
          f"batches, and {driver:.0f} s of one driver beside them.")  # fmt: skip
    return workers, driver


def main() -> None:
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {time.strftime('%Y-%m-%d')}\n")
    print(f"{'plays':>6}{'sample, ms':>10}{'default':>9}{'paper':>7}{'ns a tick: default':>20}{'paper':>7}")
    by_plays, ticks = {}, len(study.sample(study.parse(SEC43), 0).trajectory)
    for plays in PLAYS:
        one = by_plays[plays] = of_a_run(with_plays(plays))
        each = f"{1e6 * one['default'] / ticks:20.0f}{1e6 * one['paper'] / ticks:7.0f}"
        print(f"{plays:6}{one['draw']:10.1f}{one['default']:9.1f}{one['paper']:7.1f}{each}")
    both = max(2, executors.cores())
    by_plants = {runs: wall(runs, executors.threads(both)) for runs in PLANTS}
    print(f"\n{'plants':>6}{'s, threads':>12}{'ms a plant':>12}")
    for runs, seconds in by_plants.items():
        print(f"{runs:6}{seconds:12.2f}{1e3 * seconds / runs:12.1f}")
    by_workers = {
        name: [wall(PLANTS[-1], make(n)) for n in range(1, both + 1)]
        for name, make in (("threads", executors.threads), ("dask", executors.dask))
    }
    print(f"\n{'workers':>7}{'s, threads':>12}{'s, dask':>9}  gain of threads, dask")
    for n, (threads, dask) in enumerate(zip(*by_workers.values(), strict=True), 1):
        gains = f"{by_workers['threads'][0] / threads:.2f}, {by_workers['dask'][0] / dask:.2f}"
        print(f"{n:7}{threads:12.2f}{dask:9.2f}  {gains}")
    parts = million(of_a_run(study.parse(SEC43)))
    if len(sys.argv) > 1:
        save_plots(lambda theme: {"growth": picture(theme, by_plays, by_plants, parts)}, sys.argv[1])


def picture(theme: style.Theme, by_plays: dict, by_plants: dict, parts: tuple[float, float]) -> Figure:
    with style.use(theme):
        figure, (left, middle, right) = style.panels(2.8, 1, 3)
        for colour, name in zip(theme.series, ("default", "paper", "sample"), strict=False):
            left.plot(PLAYS, [by_plays[n][name] for n in PLAYS], "o-", color=colour, ms=3.5, label=name)
        left.set(xlabel="plays", ylabel="time of a run (ms)", ylim=(0, None), xticks=PLAYS)
        left.legend(loc="upper left")
        middle.plot(list(by_plants), list(by_plants.values()), "o", color=theme.series[0], ms=3.5)
        slope = by_plants[PLANTS[-1]] / PLANTS[-1]
        middle.plot([0, PLANTS[-1]], [0, slope * PLANTS[-1]], color=theme["muted"], lw=0.9)
        middle.set(xlabel="plants", ylabel="time of a study (s)", ylim=(0, None), xlim=(0, None))
        cores, (workers, driver) = np.geomspace(1, 1e4, 50), parts
        right.loglog(cores, workers / cores, color=theme.series[0], label="workers")
        right.axhline(driver, color=theme.series[1], label="driver (dask)")
        right.set(xlabel="cores", ylabel="time of a million plants (s)")
        right.legend(loc="upper right")
    return figure


if __name__ == "__main__":
    main()
