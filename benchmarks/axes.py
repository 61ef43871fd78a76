"""Cross-talk of two axes on 40 lines a second of 20 um: what it leaves, and what it was without being known.

    python benchmarks/axes.py [--plants 10] [--first 0] [--given nothing] [--wrong 3] [--anchor] [--steps]

Each row is a simulated stage of two axes; nm rms of the true error on the lines from 2 s on, of x (lines) and y
(frame): without cross-talk, with it and axes that know each other, with it and axes that do not. With dynamics and the
period of the lines, with dynamics, and with neither.
"""

import argparse
import dataclasses
import time
from collections import defaultdict

import numpy as np

from truestroke import ControllerSettings, Dynamics, Mode, MultiAxisController, run, sensor_frame
from truestroke.control.repeating.learned_strain import STEPS, LearnedStrain
from truestroke.control.repeating.turns import Turns
from truestroke.plant import MultiAxisSettings, MultiAxisStage, StageSettings
from truestroke.signals.trajectories import raster

KINDS = ("plays", "preisach", "bouc-wen")
SECONDS = 4.0
LINES = 40.0  # Hz


def plant(number: int, coupled: bool) -> tuple[MultiAxisSettings, float, tuple[tuple[float, ...], ...]]:
    """Settings of a stage from its number, the scale of its stroke, and the frame that its user states."""
    random = np.random.default_rng(number)
    rate = float(random.choice([5_000.0, 10_000.0, 20_000.0]))
    scale = float(random.choice([0.2, 1.0, 1.0, 4.0]))
    axes = tuple(
        StageSettings(
            sample_rate=rate,
            resonances=(random.uniform(500.0, 1200.0),),
            dampings=(random.uniform(0.01, 0.03),),
            hysteresis_kind=str(random.choice(KINDS)),
            stroke=30.0 * scale,
            voltage_limits=((-0.6, 3.6), (0.0, 10.0), (-2.0, 12.0))[random.integers(3)],
            noise=float(random.choice([0.01, 0.03])) * scale,
        )
        for _ in "xy"
    )
    kind = str(random.choice(["coupling", "push"]))
    share, back = random.choice([-0.03, 0.03], 2)
    rotation = float(random.choice([0.0, 0.0, 10.0, -10.0]))
    wrong = random.uniform(-0.3, 0.3)
    given = {kind: ((0.0, share), (back, 0.0))} if coupled else {}
    settings = MultiAxisSettings(axes=axes, **given, frame=sensor_frame(rotation + (wrong if coupled else 0.0)))
    return settings, scale, sensor_frame(rotation)


def anchor() -> None:
    """Two stages at 2 kHz, nothing given: rms of x and y from half a second and from two seconds on, nm."""
    axes = tuple(
        StageSettings(sample_rate=2000.0, resonances=(f,), hysteresis_kind=kind)
        for f, kind in ((900.0, "plays"), (850.0, "preisach"))
    )
    print("cross-talk   x, y from 0.5 s, known to each other   unknown   the same from 2 s")
    for kind in ("coupling", "push"):
        for share in (0.01, 0.03):
            settings = MultiAxisSettings(axes=axes, **{kind: ((0.0, share), (share, 0.0))})
            given = settings, 1.0, sensor_frame(0.0)
            row = [followed(given, 1, None, aware, None, after) for after in (0.5, 2.0) for aware in (True, False)]
            print(f"{share:4.0%} {kind:9}" + "".join(f"{x:9.1f}{y:7.1f}" for x, y in row), flush=True)


def steps() -> None:
    """Processor time of each step of the learning, us, and of all of a batch, at 10 kHz and lines of 250 ticks."""
    known = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=412.0, damping=0.02),))
    learned, random, took, batches = LearnedStrain(known, 250), np.random.default_rng(1), defaultdict(list), []
    wave = 5.0 * np.cos(2 * np.pi * np.arange(250) / 250)
    learned.follow(wave, np.ones(250, dtype=bool), Turns(250, 0, 100_000))
    for tick in range(100_000):
        learned.at(tick)
        error = 0.05 * wave[(tick - 3) % 250] / (1 + len(learned.errors)) + 0.003 * random.standard_normal()
        waiting, began = len(learned._todo), time.thread_time_ns()
        learned.put(tick, error)
        spent = (time.thread_time_ns() - began) / 1e3
        if waiting or learned._todo:  # one was done
            place = len(STEPS) - 1 - len(learned._todo)
            took[STEPS[place]].append(spent)
            batches += [0.0] * (place == 0)
            batches[-1] += spent
    print("step            median    worst")
    for name, times in {**took, "all of a batch": batches}.items():
        print(f"{name.strip('_'):14}{np.median(times):8.0f} {max(times):8.0f}")


def errors(number: int, known: float | None, coupled: bool, aware: bool, period: float | None) -> list[float]:
    """Rms of x and y, nm for a stroke of 30 um; `known`: the share of its resonance that is given, None: nothing is."""
    return followed(plant(number, coupled), number, known, aware, period, 2.0)


def told(stage: StageSettings, share: float) -> dict[str, object]:
    """The dynamics that are given, with a resonance that is wrong."""
    dynamics = stage.dynamics()
    modes = tuple(dataclasses.replace(mode, frequency=share * mode.frequency) for mode in dynamics.modes)
    return {"dynamics": dataclasses.replace(dynamics, modes=modes), "feedback": False}


def followed(given, seed: int, known: float | None, aware: bool, period: float | None, after: float) -> list[float]:
    """The same of a stage, its scale and its frame, so many seconds after the start."""
    settings, scale, frame = given
    rate = settings.sample_rate
    axes = {}
    for name, one in zip("xy", settings.axes, strict=True):
        dynamics = {} if known is None else told(one, known)
        limits = {"stroke": one.stroke, "voltage_limits": one.voltage_limits}
        axes[name] = ControllerSettings(sample_rate=rate, **limits, **dynamics)
    times = {"duration": SECONDS, "sample_rate": rate}
    middle = np.array(frame) @ (15.0 * scale, 15.0 * scale)
    motion = {
        "x": raster(frequency=LINES, peak_to_peak=20.0 * scale, offset=middle[0], **times),
        "y": raster(frequency=0.1, peak_to_peak=20.0 * scale, offset=middle[1], **times),
    }
    controller = MultiAxisController(axes, frame, period=period)
    if not aware:
        prepare = controller.prepare

        def blind(motion):
            known = prepare(motion)
            known.others[:] = 0.0
            return known

        controller.prepare = blind
    recording = run(motion, controller, MultiAxisStage(settings, seed=seed))
    counts = (recording["time"] > after) & (recording["flat_x"] > 0)
    found = []
    for name in "xy":
        error = (recording[f"true_{name}"] - recording[f"desired_{name}"])[counts]
        found.append(1e3 * float(np.sqrt(np.mean(error**2))) / scale)
    return found


GIVEN = {"period": (True, 1 / LINES), "dynamics": (True, None), "nothing": (False, None)}
"""Whether dynamics are given, and the period of the lines, s, by what is given beside the axes."""


def alone(given: str, numbers: range, share: float) -> None:
    """Rms of x and y with cross-talk, where this is given; then median, worst, and how many are above 10 nm."""
    known, period = GIVEN[given]
    rows = []
    for number in numbers:
        rows.append(errors(number, share if known else None, True, True, period))
        rate = plant(number, True)[0].sample_rate
        print(f"{number:4} {rows[-1][0]:8.1f} {rows[-1][1]:8.1f}   {rate:.0f} Hz", flush=True)
    for name, one in zip("xy", np.transpose(rows), strict=True):
        print(f"{name}: median {np.median(one):.1f}, worst {one.max():.1f}, above 10 nm {np.sum(one > 10.0)}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--plants", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--given", choices=tuple(GIVEN), help="this alone, with cross-talk that is known to be there")
    parser.add_argument("--wrong", type=float, default=0.0, help="%% by which the resonances that are given are wrong")
    parser.add_argument("--anchor", action="store_true", help="1 and 3 %% at 2 kHz, nothing given, instead")
    parser.add_argument("--steps", action="store_true", help="the processor time of the learning instead")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.plants)
    if asked.steps:
        steps()
        return
    if asked.anchor:
        anchor()
        return
    share = 1 + asked.wrong / 100
    if asked.given:
        alone(asked.given, numbers, share)
        return
    for words, (known, period) in GIVEN.items():
        known = share if known else None
        print(words, "   alone x, y   known to each other   unknown")
        rows = []
        for number in numbers:
            row = [
                *errors(number, known, False, True, period),
                *errors(number, known, True, True, period),
                *errors(number, known, True, False, period),
            ]
            rows.append(row)
            s = plant(number, True)[0]
            about = " ".join(f"{a.resonances[0]:5.0f} Hz {a.hysteresis_kind:9}" for a in s.axes)
            print(f"{number:3} " + "  ".join(f"{e:8.1f}" for e in row), f"  {s.sample_rate:.0f} Hz {about}", flush=True)
        print("median ", "  ".join(f"{e:8.1f}" for e in np.median(rows, axis=0)))
        print("worst  ", "  ".join(f"{e:8.1f}" for e in np.max(rows, axis=0)), flush=True)


if __name__ == "__main__":
    import warnings

    warnings.simplefilter("ignore")
    main()
