"""How well `measure_dynamics` finds the dynamics of random simulated stages: python benchmarks/dynamics.py.

The stages are those of the fast half of robustness in range: 50 to 2000 Hz, at 2 to 20 kHz, three hystereses, a second
mode in a third of them, dead time to two ticks.
"""

from __future__ import annotations

import argparse

import numpy as np

from truestroke import Dynamics, DynamicsError, SettingError, measure_bode
from truestroke.base.typing import FloatArray
from truestroke.plant import StagePlant, StageSettings
from truestroke.signals.timing import Timing


def stage(number: int) -> StageSettings:
    """The settings of a random stage."""
    random = np.random.default_rng(number)

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    rate = float(random.choice([2000.0, 5000.0, 10000.0, 20000.0]))
    first = between(50.0, min(2000.0, 0.35 * rate))
    modes: dict[str, tuple[float, ...]] = {"resonances": (first,), "dampings": (between(0.003, 0.08),)}
    second = first * random.uniform(1.8, 3.0)
    if random.random() < 1 / 3 and second < 0.4 * rate:
        share = float(random.uniform(-0.1, 0.1))
        modes = {"resonances": (first, second), "dampings": (*modes["dampings"], between(0.005, 0.05))}
        modes["shares"] = (1.0 - share, share)
    return StageSettings(
        sample_rate=rate,
        amplifier_bandwidth=between(200.0, 5000.0),
        dead_time=float(random.choice([0.0, random.uniform(0.0, 2.0)])) / rate,
        hysteresis_kind=str(random.choice(["plays", "preisach", "bouc-wen"])),
        noise=between(0.005, 0.06),
        **modes,
    )


def errors(found: Dynamics, truth: Dynamics) -> dict[str, float]:
    """Relative, in %; the dead time in ticks."""
    first, mode = truth.modes[0], found.modes[0]
    low = np.linspace(1.0, 0.6 * first.frequency, 200)
    near = np.linspace(0.9, 1.1, 200) * first.frequency
    apart = [found.response(f) / truth.response(f) - 1 for f in (low, near)]
    return {
        "f0 (%)": 100 * abs(mode.frequency / first.frequency - 1),
        "damping (%)": 100 * abs(mode.damping / first.damping - 1),
        "dead time (ticks)": abs(found.dead_time - truth.dead_time) * truth.sample_rate,
        "magnitude to 0.6 f0 (%)": 100 * float(np.abs(np.abs(1 + apart[0]) - 1).max()),
        "response to 0.6 f0 (%)": 100 * float(np.abs(apart[0]).max()),
        "response within 10 % of f0 (%)": 100 * float(np.abs(apart[1]).max()),
    }


def deviations(found: Dynamics, truth: Dynamics) -> dict[str, float]:
    """Errors over what the measurement states as their standard deviation."""
    (mode, first), stated = (found.modes[0], truth.modes[0]), found.uncertainty
    each = {
        "f0": (mode.frequency - first.frequency) / stated["frequency[0]"],
        "damping": (mode.damping - first.damping) / stated["damping[0]"],
        "dead time": (found.dead_time - truth.dead_time) / stated["dead_time"],
    }
    if found.amplifier_bandwidth:
        apart = found.amplifier_bandwidth - truth.amplifier_bandwidth
        each["amplifier"] = apart / stated["amplifier_bandwidth"]
    return each


class OtherUnits:
    """A stage whose displacement and voltage have other units: each times a factor."""

    def __init__(self, plant: StagePlant, displacement: float, voltage: float) -> None:
        self.plant, self.displacement, self.voltage = plant, displacement, voltage

    def open(self) -> Timing:
        """As the stage."""
        return self.plant.open()

    def exchange(self, volts: FloatArray) -> FloatArray:
        """A voltage a tick in its unit; as many displacements in theirs."""
        return self.displacement * self.plant.exchange(np.asarray(volts) / self.voltage)


def main() -> None:
    """Median, 95 % and worst of the errors; how many are within 1.96 stated deviations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="a line for each stage")
    parser.add_argument("--units", nargs=2, type=float, default=(1.0, 1.0), help="factors of displacement, voltage")
    options = parser.parse_args()
    length, voltage = options.units
    limits = (-0.6 * voltage, 3.6 * voltage)
    relative: dict[str, list[float]] = {}
    rows: list[dict[str, float]] = []
    levels: list[str] = []
    for number in range(options.first, options.first + options.stages):
        settings = stage(number)
        try:
            truth = settings.dynamics()
        except SettingError:
            print(f"stage {number}: its inverse is not stable, it is left out")
            continue
        plant = OtherUnits(StagePlant(settings, seed=number), length, voltage)
        try:
            found = measure_bode(plant, voltage_limits=limits, seed=number)
        except DynamicsError as error:
            levels.append("refused")
            print(f"stage {number}: {error}")
            continue
        levels.append(found.verdict.level)
        rows.append(errors(found.dynamics, truth))
        for name, value in deviations(found.dynamics, truth).items():
            relative.setdefault(name, []).append(abs(value))
        if options.verbose:
            count = f"{len(found.dynamics.modes)} of {len(settings.resonances)} modes"
            numbers = ", ".join(f"{name} {value:.3g}" for name, value in rows[-1].items())
            about = f"{settings.sample_rate:.0f} Hz, f0 {settings.resonances[0]:.0f}, {settings.hysteresis_kind}"
            print(f"stage {number} ({about}, {settings.amplifier_bandwidth:.0f}): {count}; {numbers}", flush=True)
    print({level: levels.count(level) for level in sorted(set(levels))})
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        print(
            f"{name:31} median {np.median(values):.3g}, 95 % {np.percentile(values, 95):.3g}, worst {values.max():.3g}"
        )
    for name, each in relative.items():
        inside = sum(value < 1.96 for value in each)
        print(f"{name:31} {inside} of {len(each)} within 1.96 stated deviations, largest {max(each):.1f}")


if __name__ == "__main__":
    main()
