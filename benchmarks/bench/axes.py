"""What several axes, what they take of one another, and learning from pass to pass add to a tick."""

from __future__ import annotations

from typing import Any

import numpy as np
from benchmarks.bench.cost import Cost, time_steps

from truestroke import (
    AdaptiveController,
    ControllerSettings,
    Dynamics,
    IterativeLearning,
    Mode,
    MultiAxisController,
    RepetitiveController,
    trajectories,
)
from truestroke.control.repeating.repetition import RepetitionSettings, kernel_repetition
from truestroke.runtime.realtime import motion

RATE = 10_000.0  # Hz
RESONANCES = (900.0, 700.0, 800.0)  # Hz
USUAL: dict[str, Any] = {"sample_rate": RATE, "stroke": 30.0, "voltage_limits": (-0.6, 3.6), "feedback": False}
LINES = 40.0  # a second
PERIODS = 20  # of a pass that is learned from


def ticks(steps: int) -> list[Cost]:
    """Command and adapt of all axes, one after the other, alone and as they know each other, through Python."""
    costs = []
    for axes in (1, 2, 3):
        for coupled in (False, True) if axes > 1 else (False,):
            words = f"{axes} axes that know each other" if coupled else f"{axes} axes" if axes > 1 else "1 axis"
            costs.append(_axes(axes, coupled, words, steps))
    return costs


def _axes(axes: int, coupled: bool, name: str, steps: int) -> Cost:
    names = "xyz"[:axes]
    settings = {
        one: ControllerSettings(**USUAL, dynamics=_dynamics(f)) for one, f in zip(names, RESONANCES, strict=False)
    }
    times = {"duration": 1.0, "sample_rate": RATE, "peak_to_peak": 20.0}
    wanted = {
        one: trajectories.raster(frequency=rate, **times) for one, rate in zip(names, (LINES, 0.5, 1.0), strict=False)
    }
    if coupled:
        together = MultiAxisController(settings)
        known, width = together.prepare(wanted), 3 * (axes - 1)
        controllers, wanted = list(together.axes.values()), known.axes
        others = [known.others[:, width * i : width * (i + 1)] for i in range(axes)]
    else:
        controllers, others = [AdaptiveController.from_settings(one) for one in settings.values()], [None] * axes
    target = memoryview(bytearray(8)).cast("d")
    rows = []
    for controller, trajectory, beside in zip(controllers, wanted.values(), others, strict=True):
        each = motion.motion(trajectory, target, controller, beside)
        rows.append([each(k) for k in range(len(trajectory))])
    places = [trajectory.position.tolist() for trajectory in wanted.values()]
    count = len(places[0])

    def tick(k: int) -> None:
        at = k % count
        for controller, given, place in zip(controllers, rows, places, strict=True):
            controller.command(*given[at])
            controller.adapt(place[at])

    def idle(k: int) -> None:
        at = k % count
        for _, given, place in zip(controllers, rows, places, strict=True):
            _, _ = given[at], place[at]

    about = {"plays": controllers[0].settings.plays, "parameters": controllers[0].settings.parameters}
    return time_steps(tick, steps, idle=idle, what="axes", name=name, way="Python, step by step", **about)


def lines(steps: int) -> list[Cost]:
    """`follow` and `adapt` of two axes, without and with the period of their lines; the worst ones are its learning."""
    return [_lines(period, words, steps) for period, words in ((None, ""), (1 / LINES, ", what repeats is learned"))]


def _lines(period: float | None, words: str, steps: int) -> Cost:
    settings = {
        name: ControllerSettings(**USUAL, dynamics=_dynamics(f)) for name, f in zip("xy", RESONANCES, strict=False)
    }
    controller = MultiAxisController(settings, period=period)
    times = {"sample_rate": RATE, "peak_to_peak": 20.0, "duration": steps / RATE + 1.0}
    known = controller.prepare(
        {"x": trajectories.raster(frequency=LINES, **times), "y": trajectories.raster(frequency=0.5, **times)}
    )
    desired = known.positions(slice(None))
    measured = desired + 0.01 * np.sin(desired)  # um: something to learn
    count = len(measured)

    def tick(k: int) -> None:
        at = k % count
        controller.follow(known, at)
        controller.adapt(measured[at])

    def idle(k: int) -> None:
        _ = measured[k % count]

    first = controller.axes["x"].settings
    about = {"plays": first.plays, "parameters": first.parameters, "way": "Python, step by step"}
    return time_steps(tick, steps, idle=idle, what="axes", name=f"2 axes by follow{words}", **about)


def learning(steps: int) -> list[Cost]:
    """A pass of iterative learning: what it takes when it is over, divided by its ticks."""
    lines = trajectories.raster(frequency=LINES, peak_to_peak=20.0, offset=12.0, duration=1.0, sample_rate=RATE)
    law = IterativeLearning(lines, gain=9.0, dynamics=_dynamics(RESONANCES[0]), voltage_limits=USUAL["voltage_limits"])
    rows = PERIODS * law.samples

    def one(_: int) -> None:
        law.learn(9.0 * np.tile(law.volts, PERIODS))  # a stage without hysteresis

    about = {"plays": 0, "parameters": law.samples // 2 + 1}
    name = f"learning of {PERIODS} lines of {law.samples} ticks"
    return [time_steps(one, max(steps // rows, 20), rows, what="axes", name=name, way="NumPy", **about)]


def _dynamics(frequency: float) -> Dynamics:
    return Dynamics(sample_rate=RATE, modes=(Mode(frequency=frequency, damping=0.02),))


def repetitive(steps: int) -> list[Cost]:
    """Command and adapt of an axis whose repeating motion is learned while it runs; the worst ones are its learning."""
    settings = ControllerSettings(**USUAL, dynamics=_dynamics(RESONANCES[0]))
    controller = RepetitiveController(AdaptiveController.from_settings(settings), 1 / LINES)
    lines = trajectories.raster(frequency=LINES, peak_to_peak=20.0, offset=12.0, duration=1.0, sample_rate=RATE)
    row = motion.motion(lines, memoryview(bytearray(8)).cast("d"), controller, None)
    repeated = [row(k) for k in range(round(RATE / 2), round(RATE / 2 + 10 * RATE / LINES))]
    measured = [z_d + 0.1 * np.sin(z_d) for z_d, *_ in repeated]  # um: something to learn

    def tick(k: int) -> None:
        at = k % len(repeated)
        controller.command(*repeated[at])
        controller.adapt(measured[at])

    def idle(k: int) -> None:
        at = k % len(repeated)
        _, _ = repeated[at], measured[at]

    about = {"plays": settings.plays, "parameters": settings.parameters, "way": "Python, step by step"}
    return [time_steps(tick, steps, idle=idle, what="axes", name="1 axis, learned while it runs", **about)]


def repetition(steps: int) -> list[Cost]:
    """What a motion that repeats adds to each tick, in the kernel through Python: phase, correction, level, limits."""
    lines = trajectories.raster(frequency=LINES, peak_to_peak=20.0, offset=12.0, duration=1.0, sample_rate=RATE)
    z_d, size = lines.position[round(RATE / 2) :].tolist(), round(RATE / LINES)
    added = kernel_repetition(RepetitionSettings(period=size, change=100.0, share=0.3))
    added.become(np.sin(2 * np.pi * np.arange(size) / size))

    def tick(k: int) -> None:
        at = k % len(z_d)
        added.tick(z_d[at])
        added.volts(1.0, -0.6, 3.6, 1.0)
        added.see(0.1, 9.0)

    def idle(k: int) -> None:
        _ = z_d[k % len(z_d)]

    about = {"plays": 0, "parameters": size, "way": "Python, step by step"}
    return [time_steps(tick, steps, idle=idle, what="axes", name="what repeats, in each tick", **about)]
