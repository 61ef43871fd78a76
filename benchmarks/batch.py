"""What a tick of a batch costs: `run` one by one, `simulate_many` on one thread and on two, and where the time goes.

    python benchmarks/batch.py

Seconds do not repeat on shared machines; the ratios of one run do. Each figure is the best of several rounds. Costs
are time of the processor, which others on the machine disturb least; the gain of two threads is of the clock on the
wall: it needs a quiet machine.
"""

import itertools
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from truestroke import (
    AdaptiveController,
    ControllerSettings,
    Recording,
    Simulation,
    _loops,
    metrics,
    run,
    simulate_many,
)
from truestroke.plant import MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant
from truestroke.plant.noise import Noise
from truestroke.signals.trajectories import random_wave

BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
CONTROLLERS = {"paper": ControllerSettings.paper(**BENCH), "default": ControllerSettings(**BENCH)}
PLANTS = {"matched": MatchedSettings(), "realistic": PlantSettings()}
RUNS, ROUNDS = 16, 5
WAVE = random_wave(seed=0, velocity_limit=300.0)  # 20 s at 2 kHz, as in Sec. 4.3


def best(*jobs: Callable[[], object], clock: Callable[[], float] = time.process_time) -> list[float]:
    """Shortest time of each job, s; the jobs take turns, so that all of them meet the same machine."""
    times = [[] for _ in jobs]
    for _, (job, found) in itertools.product(range(ROUNDS), list(zip(jobs, times, strict=True))):
        start = clock()
        job()
        found.append(clock() - start)
    return [min(found) for found in times]


def ns(seconds: float, runs: int = 1) -> float:
    """Per tick."""
    return 1e9 * seconds / (runs * len(WAVE))


def figures(_: int, channels: dict[str, np.ndarray]) -> metrics.TrackingSummary:
    return metrics.summary(channels)


def actuator(plant: MatchedSettings | PlantSettings) -> MatchedPlant | RealisticPlant:
    return MatchedPlant(WAVE.velocity, plant) if isinstance(plant, MatchedSettings) else RealisticPlant(plant)


def alone(controller: ControllerSettings, plant: MatchedSettings | PlantSettings) -> Recording:
    return run(WAVE, AdaptiveController.from_settings(controller), actuator(plant))


def throughput() -> None:
    print(f"{'':20}{'run, ns':>8}{'batch, ns':>11}{'ratio':>7}{'million ticks/s/core':>22}{'gain of 2 threads':>19}")
    for (law, controller), (stage, plant) in itertools.product(CONTROLLERS.items(), PLANTS.items()):
        batch = [Simulation(trajectory=WAVE, controller=controller, plant=plant, seed=n) for n in range(RUNS)]
        jobs = [partial(simulate_many, batch, reduce=figures, threads=n) for n in (1, 2)]
        one_by_one, together = best(partial(alone, controller, plant), jobs[0])
        one, two = best(*jobs, clock=time.perf_counter)
        one_by_one, together = ns(one_by_one), ns(together, RUNS)
        row = f"{one_by_one:8.0f}{together:11.0f}{one_by_one / together:7.1f}{1e3 / together:22.2f}{one / two:19.2f}"
        print(f"{law + ', ' + stage:20}{row}")


def profile() -> None:
    """Of the paper's controller and the matched plant: each part by itself, and what is left of the whole."""
    controller, plant, ticks = CONTROLLERS["paper"], PLANTS["matched"], len(WAVE)
    noise, rows, flags = Noise(0), np.empty((5, ticks)), np.zeros(ticks, np.uint8)
    channels = {"time": WAVE.time, "desired": WAVE.position, "flags": flags}
    channels |= {"measured": WAVE.position + 0.01, "true": WAVE.position + 0.01}
    made = AdaptiveController.from_settings(controller)
    pair = made._kernel.native(), actuator(plant)._plant.native()
    noise.fill(rows[0])
    batch = [Simulation(trajectory=WAVE, controller=controller, plant=plant)] * RUNS
    parts = {
        "the whole": partial(simulate_many, batch, reduce=figures, threads=1),
        "kernel": lambda: made.process(WAVE.position, WAVE.velocity, channels["measured"]),
        "kernel, plant, loop": lambda: _loops.run(*pair, WAVE.position, WAVE.velocity, *rows, flags),
        "noise": lambda: noise.fill(rows[0]),
        "settings": lambda: (AdaptiveController.from_settings(controller), actuator(plant)),
        "figures": lambda: figures(0, channels),
        "a trajectory, apart": lambda: random_wave(seed=0, velocity_limit=300.0),
    }
    whole, *each = best(*parts.values())
    costs = dict(zip(parts, [ns(whole, RUNS), *map(ns, each)], strict=True))
    inside = ("kernel, plant, loop", "noise", "settings", "figures")
    costs["rest: Python"] = costs["the whole"] - sum(costs[name] for name in inside)
    print(f"\n{'paper, matched':24}{'ns a tick':>10}{'%':>8}")
    for name, cost in costs.items():
        print(f"{name:24}{cost:10.1f}{100 * cost / costs['the whole']:8.1f}")


if __name__ == "__main__":
    throughput()
    profile()
