"""Settings drawn from numbers, extremes and wrong types: each is a SettingError that names the setting, or runs.

python benchmarks/fuzz_settings.py                     20 000 of them, some minutes
python benchmarks/fuzz_settings.py --draws 200 --seed 3

What runs must keep a finite state, under absurd desired values and measurements too.
tests/test_hardening.py has a small copy.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from truestroke import AdaptiveController, ControllerSettings, SettingError
from truestroke.base.files import FileError

BASIC: dict[str, Any] = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
FIELDS = [field.name for field in dataclasses.fields(ControllerSettings)]
EXTREMES = (
    0.0,
    -0.0,
    5e-324,
    1e-300,
    1e-40,
    1e-15,
    1e-9,
    1e-3,
    1.0,
    1e3,
    1e9,
    1e15,
    1e40,
    1e154,
    1.7e308,
    -1.0,
    -1e308,
)
OTHERS = (np.nan, np.inf, -np.inf, 10**400, -(10**400), 2**63, 1j, None, True, "x", "3", b"3", [], (), {}, object, [[]])
ARRAYS = (np.array([1.0, 2.0]), np.array(3.0), np.array([]), np.array(["x"]), np.eye(2), np.array([0.0, np.nan]))
ABSURD = (0.0, 5e-324, 1e30, -1e154, 1.7e308, -1.7e308)


def one(rng: np.random.Generator) -> Any:
    """A value, mostly a number."""
    kind = rng.random()
    if kind < 0.4:
        return float(10.0 ** rng.uniform(-12, 12) * rng.choice([1, 1, 1, -1]))
    if kind < 0.7:
        return float(rng.choice(EXTREMES))
    if kind < 0.8:
        return int(rng.integers(-3, 40))
    several = (*OTHERS, *ARRAYS)
    return several[rng.integers(len(several))]


def value(rng: np.random.Generator, name: str) -> Any:
    """A value for this setting: of its shape, or of any."""
    if rng.random() < 0.15:
        return one(rng)
    if name in ("law", "precision"):
        return [*("kalman", "rls", "double", "single"), one(rng)][rng.integers(5)]
    if name in ("voltage_limits", "slope_limits"):
        pair = one(rng), one(rng)
        numbers = all(isinstance(entry, float) for entry in pair)
        return tuple(sorted(pair)) if numbers and rng.random() < 0.7 else pair
    if name in ("thresholds", "dead_zone_thresholds"):
        rest = np.sort(10.0 ** rng.uniform(-9, rng.choice([1.0, 300.0]), rng.integers(0, 9)))
        return (0.0, *rest.tolist())
    if name == "prior_covariance":
        size = int(rng.choice([37, 5]))
        scale = float(10.0 ** rng.uniform(-200, 200))
        return scale * np.diag(10.0 ** rng.uniform(-3, rng.choice([3.0, 100.0]), size))
    if name in ("rate_dependent", "creep_times", "dead_zone_weights", "initial_weights"):
        return tuple(one(rng) for _ in range(rng.choice([0, 1, 2, 5, 9, 37])))
    return one(rng)


def draw(rng: np.random.Generator) -> tuple[Callable[..., ControllerSettings], dict[str, Any]]:
    """How the settings are made, and what is given."""
    make = ControllerSettings.paper if rng.random() < 0.2 else ControllerSettings
    names = rng.choice(FIELDS, rng.choice([1, 1, 2, 3]), replace=False)
    return make, BASIC | {str(name): value(rng, name) for name in names}


def drive(controller: AdaptiveController, rng: np.random.Generator) -> None:
    """Some ticks, a third of them absurd; ValueError where a state is not finite."""
    s = controller.settings
    for k in range(30):
        odd = rng.random(3) < 0.3
        z_d, rate, z = np.where(odd, rng.choice(ABSURD, 3), s.stroke * np.array([0.5 + 0.01 * k, 1.0, 0.4 + 0.01 * k]))
        if s.precision == "single":  # beyond the numbers of its type it is refused
            z_d, rate = np.clip((z_d, rate), -1e38, 1e38)
        volts = controller.command(float(z_d), float(rate))
        if not s.voltage_limits[0] <= volts <= s.voltage_limits[1] and s.precision == "double":
            raise ValueError(f"{volts} V left")
        try:
            controller.adapt(float(z))
        except SettingError as error:
            if error.argument != "z_measured":
                raise
    bad = [name for name, entry in controller.state().items() if not np.isfinite(entry).all()]
    if bad:
        raise ValueError(f"not finite: {', '.join(bad)}")


def campaign(draws: int, seed: int) -> tuple[collections.Counter[str], list[str]]:
    """How often what happened, and what must not have."""
    rng, counts, wrong = np.random.default_rng(seed), collections.Counter[str](), []
    for number in range(draws):
        make, given = draw(rng)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    controller = AdaptiveController.from_settings(make(**given))
                except SettingError as error:
                    counts["refused"] += 1
                    if error.argument.partition("[")[0].removeprefix("the number of ") not in FIELDS:
                        wrong.append(f"{number}: names {error.argument}: {error}"[:400])
                    continue
                except FileError:  # names the file of `dynamics`
                    counts["refused"] += 1
                    continue
                drive(controller, rng)
                counts["run"] += 1
        except Exception as error:
            counts[type(error).__name__] += 1
            changed = {name: entry for name, entry in given.items() if entry is not BASIC.get(name)}
            wrong.append(f"{number}: {type(error).__name__} {error}; {make.__name__} {changed}"[:400])
    return counts, wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    counts, wrong = campaign(asked.draws, asked.seed)
    print(f"{asked.draws} settings, seed {asked.seed}:", ", ".join(f"{n} {what}" for what, n in counts.most_common()))
    for line in wrong:
        print(line)
    return bool(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
