"""Dynamics that lack the second mode of the stage, because the measurement did not see it: how much does that cost?

Stages of f0 at 0.03 to 0.11 of the sample rate (1 to 20 kHz), with a second mode at 2.2 to 4.2 f0 that has 3 to 12 % of
the displacement and a damping of 0.003 to 0.05. Sines to f0/2, of which a harmonic is near the second mode where it can
be, and rasters. The dynamics are exact but for that mode. Prints the true rms of the second half, and the largest error
before and after 0.5 s, % of peak to peak.

    python -m benchmarks.unseen_mode --stages 40                  # half a minute
    python -m benchmarks.unseen_mode --stages 40 --no-feedback
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass

import numpy as np

from truestroke import AdaptiveController, Dynamics, Recording, run, trajectories
from truestroke.plant import StagePlant, StageSettings

RATES = (1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0)  # Hz
HIGHEST = 0.4  # of the sample rate: a second mode
TRAVEL = 20.0  # um peak to peak


@dataclass(frozen=True)
class Case:
    """A stage, what is known of it, and a motion."""

    stage: StageSettings
    known: Dynamics
    motion: str
    frequency: float  # Hz

    def __str__(self) -> str:
        s = self.stage
        (f0, second), share, damping = s.resonances, s.shares[1], s.dampings[1]
        mode = f"{share:6.2f} at {second / f0:.1f} f0, damping {damping:.3f}"
        of = f"{self.frequency / f0:.2f} f0 {s.hysteresis_kind:8} {f0:5.0f} Hz of {s.sample_rate:5.0f}"
        return f"{self.motion:6} {of} {mode}"


def with_a_further_mode(
    rate: float, f0: float, second: float, share: float, damping: float, kind: str
) -> tuple[StageSettings, Dynamics]:
    """A stage of two modes, Hz, and its dynamics as a measurement has them that did not see the second one."""
    of_stage = {"sample_rate": rate, "hysteresis_kind": kind, "noise": 0.02}
    of_modes = {"resonances": (f0, second), "dampings": (0.01, damping), "shares": (1 - share, share)}
    seen = StageSettings(**of_stage, resonances=(f0,), dampings=(0.01,))
    return StageSettings(**of_stage, **of_modes), seen.dynamics()


def sampled(number: int) -> Case:
    """The same number is always the same case."""
    rng = np.random.default_rng([352, number])
    rate = float(rng.choice(RATES))
    f0 = rate * rng.uniform(0.03, 0.11)
    second = min(f0 * rng.uniform(2.2, 4.2), HIGHEST * rate)
    share = float(rng.choice([-1, 1]) * rng.uniform(0.03, 0.12))
    damping = float(np.exp(rng.uniform(np.log(0.003), np.log(0.05))))
    near = second * rng.uniform(0.95, 1.05) / rng.integers(3, 16)
    slower = f0 * rng.uniform(0.1, 0.5)
    motion, kind = str(rng.choice(["sine", "raster"])), str(rng.choice(["plays", "preisach", "bouc-wen"]))
    frequency = min(near if near < f0 / 2 else slower, f0 / 2 if motion == "sine" else 0.15 * f0)
    stage, known = with_a_further_mode(rate, f0, second, share, damping, kind)
    return Case(stage, known, motion, float(frequency))


def rms_and_largest(recording: Recording, travel: float) -> tuple[float, float, float]:
    """The true rms of the second half, and the largest error before and after 0.5 s, % of a travel, um."""
    error = 100 * np.abs(recording["true"] - recording["desired"]) / travel
    early = int(np.searchsorted(recording["time"], 0.5))
    rms = float(np.sqrt(np.mean(error[error.size // 2 :] ** 2)))
    return rms, float(error[:early].max()), float(error[early:].max())


def errors(case: Case, seed: int, *, feedback: bool) -> tuple[float, float, float]:
    """The rms of the second half, and the largest error before and after 0.5 s, % of peak to peak."""
    rate = case.stage.sample_rate
    of = {"frequency": case.frequency, "peak_to_peak": TRAVEL, "offset": 12.0, "duration": 3.0, "sample_rate": rate}
    wave = trajectories.sine(**of) if case.motion == "sine" else trajectories.raster(**of)
    axis = {"sample_rate": rate, "stroke": 24.0, "voltage_limits": (-0.6, 3.6), "slew_limit": 1e5}
    controller = AdaptiveController(**axis, dynamics=case.known, feedback=feedback)
    recording = run(wave, controller, StagePlant(case.stage, seed=seed))
    return rms_and_largest(recording, TRAVEL)


def main() -> None:
    """Print a row per stage, and the distribution."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stages", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first stage")
    parser.add_argument("--no-feedback", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore")  # of limits and of the model: the error is what counts here
    found = []
    for number in range(given.first, given.first + given.stages):
        case = sampled(number)
        found.append(errors(case, number, feedback=not given.no_feedback))
        print(
            f"{number:4} {case}  rms {found[-1][0]:7.3f}, largest {found[-1][1]:7.2f}, {found[-1][2]:7.2f}", flush=True
        )
    for name, column in zip(("rms", "before 0.5 s", "after 0.5 s"), np.array(found).T, strict=True):
        median, most, worst = np.percentile(column, [50, 95, 100])
        print(f"{name}: median {median:.3f}, 95 % {most:.2f}, worst {worst:.2f}; above 1 %: {np.sum(column > 1)}")


if __name__ == "__main__":
    main()
