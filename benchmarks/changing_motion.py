"""Eight kinds of motion one after the other on the stages of `foreign_stages`, begun within a tenth of a second.

Slow sine, rest, raster, fast sine, a small one, several tones, a step, a sine between slow and fast: 1.5 s each, in an
order that is drawn, up to f0/3. Prints of each kind the true rms after its first third, and the largest error of all of
it, % of peak to peak of the large motions; then for how long errors are above 10 %.

    python -m benchmarks.changing_motion --stages 16                    # nothing given; two minutes
    python -m benchmarks.changing_motion --stages 16 --resonance 1      # f0 given, as a data sheet has it
    python -m benchmarks.changing_motion --stages 16 --resonance 0.85   # off by 15 %
    python -m benchmarks.changing_motion --stages 16 --measured         # dynamics measured first
"""

from __future__ import annotations

import argparse
import warnings
from multiprocessing import Pool

import numpy as np
from benchmarks.foreign_stages import sampled, travel
from numpy.typing import NDArray

from truestroke import AdaptiveController, measure_dynamics, run, trajectories

FloatArray = NDArray[np.float64]  # of motions shape (3, n): position, um, velocity, um/s, acceleration, um/s^2
KINDS = "slow", "rest", "raster", "fast", "small", "tones", "step", "middle"
LASTS, BEGINS = 1.5, 0.1  # s: a kind of motion, and how long it takes to begin
FASTEST = 1 / 3  # of f0
BURST = 10.0  # %: a larger error is a burst


def tone(time: FloatArray, frequency: float, amplitude: float, phase: float = 0.0) -> FloatArray:
    """A sine."""
    w = 2 * np.pi * frequency
    sine, cosine = np.sin(w * time + phase), np.cos(w * time + phase)
    return amplitude * np.array([sine, w * cosine, -w * w * sine])


def rise(ticks: int, rate: float) -> FloatArray:
    """From 0 to 1."""
    s, time = np.arange(ticks) / ticks, ticks / rate
    return np.array([
        s**3 * (10 - 15 * s + 6 * s * s),
        (30 * s**2 - 60 * s**3 + 30 * s**4) / time,
        (60 * s - 180 * s**2 + 120 * s**3) / time**2,
    ])  # fmt: skip


def kind_of_motion(kind: str, time: FloatArray, f0: float, span: float, random: np.random.Generator) -> FloatArray:
    """About 0 um."""
    top = FASTEST * f0
    still = np.array([np.ones_like(time), np.zeros_like(time), np.zeros_like(time)])
    match kind:
        case "slow":
            return tone(time, random.uniform(1, 5), span / 2)
        case "middle":
            return tone(time, random.uniform(0.05, 0.12) * f0, span * random.uniform(0.2, 0.5))
        case "fast":
            return tone(time, random.uniform(0.6, 1) * top, span / 2)
        case "small":
            return tone(time, random.uniform(0.6, 1) * top, 0.06 * span) + random.uniform(-0.3, 0.3) * span * still
        case "tones":
            drawn = [(random.uniform(0.1, 1) * top, random.uniform(0, 2 * np.pi)) for _ in range(6)]
            return np.sum([tone(time, frequency, span / 12, phase) for frequency, phase in drawn], axis=0)
        case "step":
            return random.uniform(-0.4, 0.4) * span * still
        case "raster":
            rate = 1 / (time[1] - time[0])
            frequency = 0.3 * top * random.uniform(0.4, 1)
            lines = trajectories.raster(
                frequency=frequency, peak_to_peak=0.8 * span, sample_rate=rate, duration=time[-1] + 1, turn=0.2
            )
            whole = np.array([lines.position - 0.4 * span, lines.velocity, lines.acceleration])
            return whole[:, : time.size]
    return 0 * still


def motion(number: int, f0: float, rate: float, span: float, middle: float) -> tuple[list[str], int, int, FloatArray]:
    """The order of the kinds, ticks of the way to the middle, and of each kind, and all of it."""
    random = np.random.default_rng([number, 7])
    ticks, begins = round(LASTS * rate), max(round(BEGINS * rate), round(3 / f0 * rate))
    up, time = rise(begins, rate), np.arange(ticks) / rate
    whole = np.zeros((3, ticks))
    whole[0] = 1
    whole[:, :begins] = up
    whole[:, -begins:] = up[:, ::-1] * [[1], [-1], [1]]
    order = [str(kind) for kind in random.permutation(KINDS)]
    parts = [middle * up]
    for kind in order:
        z = kind_of_motion(kind, time, f0, span, random)
        product = [whole[0] * z[0], whole[1] * z[0] + whole[0] * z[1]]
        part = np.array([*product, whole[2] * z[0] + 2 * whole[1] * z[1] + whole[0] * z[2]])
        part[0] += middle
        parts.append(part)
    return order, begins, ticks, np.concatenate(parts, axis=1)


def follow(
    number: int, resonance: float, measured: bool, last: str | None = None
) -> tuple[str, dict[str, tuple[float, float]], float]:
    """The stage in words; of each kind of motion rms after its first third and largest error, %; s of bursts.

    With `last` the run ends behind that kind of motion.
    """
    warnings.simplefilter("ignore")
    bottom, top = travel(sampled(number)[0])
    stage, words = sampled(number)
    f0, span = stage.modes[0][0], top - bottom
    order, begins, ticks, z = motion(number, f0, stage.rate, span, (top + bottom) / 2)
    if last is not None:
        order = order[: order.index(last) + 1]
        z = z[:, : begins + len(order) * ticks]
    known = (
        {"dynamics": measure_dynamics(stage, voltage_limits=stage.limits)}
        if measured
        else {"resonance": resonance * f0}
    )
    controller = AdaptiveController(sample_rate=stage.rate, stroke=stage.stroke, voltage_limits=stage.limits, **known)
    wave = trajectories.Trajectory(
        name="changing", position=z[0], velocity=z[1], acceleration=z[2], sample_rate=stage.rate
    )
    run(wave, controller, stage)
    error = 100 / span * (np.array(stage.true) - z[0])
    found = {}
    for i, kind in enumerate(order):
        part = error[begins + i * ticks : begins + (i + 1) * ticks]
        found[kind] = float(np.sqrt(np.mean(part[ticks // 3 :] ** 2))), float(np.abs(part).max())
    return words, found, float(np.sum(np.abs(error[begins:]) > BURST)) / stage.rate


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stages", type=int, default=16)
    parser.add_argument("--first", type=int, default=5000, help="number of the first stage")
    parser.add_argument("--resonance", type=float, default=0.0, help="that is given, over f0; 0: none")
    parser.add_argument("--measured", action="store_true", help="dynamics are measured first, and given")
    of = parser.parse_args()
    numbers = range(of.first, of.first + of.stages)
    with Pool(2) as pool:
        rows = pool.starmap(follow, [(number, of.resonance, of.measured) for number in numbers])
    print("stage  hysteresis, f0, Hz, rate, kHz, damping, second mode, limits, stroke, um: rms / largest, %")
    for number, (words, found, _) in zip(numbers, rows, strict=True):
        print(f"{number:5}  {words}\n       " + "  ".join(f"{k} {r:.2f} / {m:.1f}" for k, (r, m) in found.items()))
    print("\nmotion   rms: median  95 %   worst   largest: median  95 %   worst")
    for kind in KINDS:
        rms, largest = np.array([found[kind] for _, found, _ in rows]).T
        shown = [f"{np.median(x):12.3f} {np.quantile(x, 0.95):7.3f} {x.max():7.3f}" for x in (rms, largest)]
        print(f"{kind:7}" + "   ".join(shown))
    bursts = np.array([seconds for *_, seconds in rows])
    print(f"above {BURST:.0f} %: {bursts.sum():.3f} s in all, at most {bursts.max():.3f} s of a stage")


if __name__ == "__main__":
    main()
