"""The sensor shows another axis for 1 to 5 s, then its own again: how large errors are afterwards, and how late.

python benchmarks/wrong_axis.py                        200 episodes of 28 s, some five minutes
python benchmarks/wrong_axis.py --restart              with a controller that begins anew when alarms come in a row
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from truestroke import AdaptiveController
from truestroke.plant import RealisticPlant
from truestroke.signals.trajectories import random_wave

BASIC = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
WRONG = 6000  # tick at which the sensor becomes the wrong one
AFTER = 2000  # ticks that recovery may take
BURST = 0.25  # um


class Restarting(AdaptiveController):
    """A prototype: more than six alarms of change in a row, within some 0.25 s, and what was learned is nonsense."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self._fresh, self._alarms = self.state(), 0.0

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        super().adapt(z_measured, ago)
        self._alarms = 0.998 * self._alarms + self.flags.changed
        if self.flags.changed and self._alarms > 6:
            self.restore(self.state() | {name: self._fresh[name] for name in ("weights", "covariance")})


def episode(number: int, restart: bool) -> tuple[int, float, float, int]:
    """Number; largest error later than a second after, um; when it was, s after; alarms of change."""
    rng = np.random.default_rng(number)
    wave = random_wave(duration=28.0, seed=number)
    ticks = len(wave)
    right = WRONG + int(rng.uniform(2000, 10_000))
    kind, noise = rng.integers(3), rng.normal(0.0, 0.013, ticks)
    if kind == 0:
        omega = 2 * np.pi * rng.uniform(0.5, 25.0) / 2000.0
        other = rng.uniform(5.0, 25.0) + rng.uniform(1.0, 14.0) * np.sin(omega * np.arange(ticks))
    elif kind == 1:
        other = random_wave(duration=28.0, seed=number + 10**6).position
    else:
        other = np.full(ticks, rng.uniform(0.0, 30.0))
    other = other + noise
    controller, plant = (Restarting if restart else AdaptiveController)(**BASIC), RealisticPlant(seed=number)
    plant.open()
    errors, volts = np.empty(ticks), np.empty(1)
    command, adapt, exchange = controller.command, controller.adapt, plant.exchange
    for k, (z_d, rate) in enumerate(zip(wave.position.tolist(), wave.velocity.tolist(), strict=True)):
        volts[0] = command(z_d, rate)
        z = exchange(volts)[0]
        adapt(other[k] if WRONG <= k < right else z)
        errors[k] = plant.truth[0] - z_d
    late = np.abs(errors[right + AFTER :])
    at = int(np.argmax(late))
    return number, float(late[at]), (at + AFTER) / 2000.0, controller.counters.changed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--restart", action="store_true")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.episodes)
    with ProcessPoolExecutor(asked.jobs) as pool:
        found = list(pool.map(partial(episode, restart=asked.restart), numbers, chunksize=5))
    largest = np.array([error for _, error, _, _ in found])
    print(
        f"{asked.episodes} episodes: largest error later than 1 s after, um: median {np.median(largest):.3f}, "
        f"95 % {np.quantile(largest, 0.95):.3f}, worst {largest.max():.3f}; above {BURST} um in {sum(largest > BURST)}"
    )
    for number, error, when, changed in sorted(found, key=lambda row: -row[1])[:8]:
        print(f"  episode {number}: {error:.3f} um, {when:.1f} s after; {changed} alarms")


if __name__ == "__main__":
    main()
