"""The singularity-free inverse against the guard of `paper()` and the default: the table of docs/decisions/0021.

python benchmarks/singularity_free.py          about four minutes
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import product

import numpy as np
from singularity_free_inverse import singularity_free_inverse

from truestroke import AdaptiveController, Trajectory, run, trajectories
from truestroke.control.adaptation import RLS
from truestroke.model.models import limit_slopes, play_inverse
from truestroke.model.operators import play
from truestroke.plant import MatchedPlant, RealisticPlant
from truestroke.plant.settings import Change, MatchedSettings, PlantSettings

LIMITS = (-0.6, 3.6)  # V
STACK = MatchedSettings()  # the published P-885.90
USER = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": LIMITS}
PAPER = AdaptiveController.paper(**USER).settings


def guarded(y_d: float, w_h: np.ndarray, r: np.ndarray, y: np.ndarray) -> float:
    """The guard of `paper()`: slopes below 5 % of q are lifted to it."""
    x = play_inverse(y_d, limit_slopes(np.cumsum(w_h), PAPER.slope_limits)[0], r, y)
    return float(np.clip(x, *LIMITS))


def free(y_d: float, w_h: np.ndarray, r: np.ndarray, y: np.ndarray) -> float:
    return singularity_free_inverse(y_d, w_h, r, y, LIMITS)


class PaperLoop:
    """Fig. 5 with the law of `paper()` and any inverse; without `learn`, the published weights stand still."""

    def __init__(self, inverse: Callable[..., float], learn: bool = True) -> None:
        s = PAPER
        self.inverse, self.learn, self.r = inverse, learn, np.array(s.thresholds)
        self.law = RLS(
            s.initial_weights if learn else np.column_stack([STACK.a, STACK.b]).ravel(),
            forgetting=s.forgetting,
            regularization=s.regularization,
            covariance_limit=s.covariance_limit,
        )
        self.y = np.zeros(self.r.size)
        self.rate, self.negative = 0.0, 0

    def command(self, z_d: float, zdot_d: float) -> float:
        self.rate = PAPER.rate_scale * zdot_d
        w_h = self.law.weights[0::2] + self.rate * self.law.weights[1::2]  # (7)
        self.negative += bool(np.cumsum(w_h).min() <= 0)
        x = self.inverse(z_d, w_h, self.r, self.y)
        self.y = play(x, self.r, self.y)
        return x

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        if self.learn:
            u = np.column_stack([self.y, self.rate * self.y]).ravel()  # (20)
            self.law.update(u, z_measured - float(self.law.weights @ u))  # (15), (23)


CONTROLLERS: dict[str, Callable[[], object]] = {
    "known weights, guard": lambda: PaperLoop(guarded, learn=False),
    "known weights, singularity-free": lambda: PaperLoop(free, learn=False),
    "`paper()`, guard, in the kernel": lambda: AdaptiveController.paper(**USER),
    "the same law, guard": lambda: PaperLoop(guarded),
    "the same law, singularity-free": lambda: PaperLoop(free),
    "default `AdaptiveController`": lambda: AdaptiveController(**USER),
}


ACTUATORS: dict[str, Callable[[Trajectory, int], object]] = {
    "matched": lambda wave, seed: MatchedPlant(velocity=wave.velocity, seed=seed),
    "realistic": lambda wave, seed: RealisticPlant(seed=seed),
    "realistic, changed at 5 s": lambda wave, seed: RealisticPlant(
        PlantSettings(change=Change(time=5.0, gain=0.8, hysteresis=1.4)), seed=seed
    ),
}


def figures(job: tuple[str, str, float, int], duration: float = 20.0) -> tuple[float, ...]:
    """rmse and maximum of the second half, worst after 0.5 s, largest step of the voltage, share of negative slopes."""
    plant, name, cutoff, seed = job
    wave: Trajectory = trajectories.random_wave(cutoff=cutoff, duration=duration, seed=seed)
    controller = CONTROLLERS[name]()
    recording = run(wave, controller, ACTUATORS[plant](wave, seed))
    error = np.abs(recording["true"] - recording["desired"])
    later = error[error.size // 2 :]
    step = np.abs(np.diff(recording["volts"][1000:])).max()
    negative = getattr(controller, "negative", np.nan) / error.size
    return float(np.sqrt(np.mean(later**2))), later.max(), error[1000:].max(), step, 100 * negative


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    print(
        "| plant | wave | inverse | rmse um | maximum um | worst burst um | voltage step V | slope <= 0, % of ticks |"
    )
    print("|---|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(2) as pool:
        for plant, cutoff in product(ACTUATORS, (20.0, 30.0)):
            for name in CONTROLLERS:
                if plant != "matched" and name.startswith("known"):
                    continue
                runs = np.array(list(pool.map(figures, [(plant, name, cutoff, seed) for seed in seeds])))
                rmse, rest = np.median(runs[:, 0]), runs[:, 1:].max(axis=0)
                cells = [f"{rmse:.2g}", *(f"{v:.2g}" for v in rest)]
                print(f"| {plant} | {cutoff:.0f} Hz | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
