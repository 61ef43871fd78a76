"""All costs in one run, so that their ratios mean something."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.bench import axes, rivals
from benchmarks.bench.cost import Cost, of_times, time_steps

from truestroke import AdaptiveController, ControllerSettings
from truestroke.base.typing import FloatArray
from truestroke.control.reference import ReferenceController
from truestroke.plant import RealisticPlant
from truestroke.runtime import loop
from truestroke.signals import trajectories

PLAYS = (4, 8, 16, 24, 32)
BLOCK = 1000
STAGE: dict[str, Any] = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
LAWS: dict[str, Callable[..., ControllerSettings]] = {"paper": ControllerSettings.paper, "default": ControllerSettings}
SOURCES = Path(__file__).parents[2] / "c"
NUMBERS = {"double": "double", "float": "single"}


def run(steps: int = 1_000_000, progress: Callable[[int, int], None] | None = None) -> tuple[list[Cost], list[str]]:
    """Measure everything there is on this machine.

    Parameters
    ----------
    steps : int
        Of the kernel in C; a tenth of them through Python, a hundredth of a rival or of NumPy. At least 10,000.
    progress : callable, optional
        Called as progress(parts done, all parts).

    Returns
    -------
    costs : list of Cost
    missing : list of str
        What could not be measured, and why: a sentence each.
    """
    parts = [*_parts(steps)]
    costs: list[Cost] = []
    missing: list[str] = []
    for k, part in enumerate(parts):
        try:
            costs += part()
        except NotHere as reason:
            missing.append(str(reason))
        if progress:
            progress(k + 1, len(parts))
    return costs, missing


class NotHere(RuntimeError):  # noqa: N818 (what is measured is optional)
    """Something is not installed."""


def _parts(steps: int) -> Iterator[Callable[[], list[Cost]]]:
    yield partial(native, steps)
    for offer in rivals.OFFERS:
        yield partial(rival, offer, steps // 100)
    yield partial(dlib, steps // 10)
    for name, make in LAWS.items():
        for plays in PLAYS:
            yield partial(ticks, make(**STAGE, plays=plays), name, steps // 10)
        yield partial(ticks, make(**STAGE, precision="single"), name, steps // 10)
        yield partial(numpy_tick, make(**STAGE), name, steps // 100)
    yield partial(axes.ticks, steps // 10)
    yield partial(axes.lines, steps // 10)
    yield partial(axes.learning, steps)
    yield partial(axes.repetitive, steps // 10)
    yield partial(axes.repetition, steps)


# ---- The kernel ----------------------------------------------------------------------------------------------------


def native(steps: int) -> list[Cost]:
    """Time the kernel in C, and the machine's limit for its update: compiles and runs benchmarks/bench/kernel."""
    make = shutil.which("make")
    if make is None or not (SOURCES / "Makefile").is_file():
        raise NotHere("The kernel in C: needs a checkout of the sources, make and a C compiler.")
    quiet = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    command = [make, "--silent", "-C", str(SOURCES), "bench", f"CALLS={steps}"]
    found = subprocess.run(command, capture_output=True, text=True, env=quiet)
    if found.returncode:
        raise NotHere(f"The kernel in C: {found.stderr.strip().splitlines()[-1]}")
    return [_native(json.loads(line)) for line in found.stdout.splitlines() if line.startswith("{")]


def _native(line: dict[str, Any]) -> Cost:
    return Cost(
        what=line["what"],
        name="truestroke" if line["law"] == "rls" else line["law"],
        way="C",
        variant=line["variant"],
        plays=line["plays"],
        parameters=line["parameters"],
        precision=NUMBERS[line["number"]],
        best_ns=line["ns"],
        median_ns=line["median_ns"],
        p999_ns=line["p999_ns"],
        worst_ns=line["worst_ns"],
        steps=line["calls"],
    )


@cache
def motion() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return desired displacement (um), velocity (um/s) and what a stack measured that followed them (um)."""
    wave = trajectories.random_wave(duration=10.0, seed=0)
    followed = loop.run(wave, AdaptiveController(**STAGE), RealisticPlant(seed=0))
    return wave.position, wave.velocity, followed["measured"]


def ticks(settings: ControllerSettings, name: str, steps: int) -> list[Cost]:
    """Time command and adapt through Python, step by step and in blocks."""
    z_d, zdot_d, z = motion()
    about: dict[str, Any] = {
        "what": "tick",
        "name": name,
        "plays": settings.plays,
        "parameters": settings.parameters,
        "precision": settings.precision,
    }
    controller = AdaptiveController.from_settings(settings)
    command, adapt = controller.command, controller.adapt
    rows = list(zip(z_d.tolist(), zdot_d.tolist(), z.tolist(), strict=True))

    def tick(k: int) -> None:
        desired, rate, measured = rows[k % len(rows)]
        command(desired, rate)
        adapt(measured)

    def idle(k: int) -> None:
        _, _, _ = rows[k % len(rows)]

    def block(k: int) -> None:
        first = k * BLOCK % len(rows)
        part = slice(first, first + BLOCK)
        controller.process(z_d[part], zdot_d[part], z[part])

    return [
        time_steps(tick, steps, idle=idle, way="Python, step by step", **about),
        time_steps(block, max(2 * steps // BLOCK, 20), BLOCK, way=f"Python, blocks of {BLOCK}", **about),
    ]


def numpy_tick(settings: ControllerSettings, name: str, steps: int) -> list[Cost]:
    """Time the same controller in plain NumPy."""
    controller = ReferenceController(settings)
    rows = list(zip(*(column.tolist() for column in motion()), strict=True))

    def tick(k: int) -> None:
        desired, rate, measured = rows[k % len(rows)]
        controller.command(desired, rate)
        controller.adapt(measured)

    about: dict[str, Any] = {"plays": settings.plays, "parameters": settings.parameters}
    return [time_steps(tick, max(steps // 5, 200), what="tick", name=name, way="NumPy", **about)]


# ---- The rivals ----------------------------------------------------------------------------------------------------


def samples(steps: int) -> tuple[FloatArray, FloatArray]:
    """Return regressors, shape (steps, 16), and what they should give, shape (steps,)."""
    random = np.random.default_rng(0)
    u = random.standard_normal((steps, rivals.PARAMETERS))
    return u, u @ random.standard_normal(rivals.PARAMETERS) + 0.1 * random.standard_normal(steps)


def rival(offer: rivals.Offer, steps: int) -> list[Cost]:
    """Time the update of a rival."""
    version = offer.version()
    if version is None:
        raise NotHere(f"{offer.name}: pip install {offer.package}")
    law = offer.make()
    u, y = samples(steps)
    rows, targets = list(u), y.tolist()
    about: dict[str, Any] = {"what": "update", "way": "Python, step by step", "plays": 0}
    name = f"{offer.name} {version}"
    return [
        time_steps(lambda k: law.step(rows[k], targets[k]), steps, name=name, parameters=rivals.PARAMETERS, **about)
    ]


def dlib(steps: int) -> list[Cost]:
    """Time the update of dlib."""
    taken = rivals.dlib(*samples(steps))
    if taken is None:
        raise NotHere("dlib rls: needs g++ and its headers: apt-get install libdlib-dev")
    about: dict[str, Any] = {"what": "update", "way": "C++", "plays": 0, "parameters": rivals.PARAMETERS}
    return [of_times(taken, steps, name="dlib rls", **about)]
