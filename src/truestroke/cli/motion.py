"""The motions that commands follow or invert: built-in ones by name, others from a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from truestroke.signals.trajectories import Trajectory

# What each motion understands: option -> argument of its function.
SHARED = {"peak_to_peak": "peak_to_peak", "duration": "duration", "sample_rate": "sample_rate"}
MOTIONS = {
    "random": ("random_wave", {"frequency": "cutoff", "velocity_limit": "velocity_limit", "seed": "seed", **SHARED}),
    "sine": ("sine", {"frequency": "frequency", **SHARED}),
    "triangle": ("triangle", {"frequency": "frequency", **SHARED}),
    "staircase": ("staircase", {"velocity_limit": "velocity_limit", **SHARED}),
}
METAVAR = f"[{'|'.join(MOTIONS)}|FILE.csv|FILE.npz]"


def known(context: click.Context, option: click.Parameter, value: str) -> str:
    """`value`, if it is one of `MOTIONS` or a file."""
    if value in MOTIONS or Path(value).is_file():
        return value
    raise click.BadParameter(f"{value!r} is neither one of {', '.join(MOTIONS)} nor a file.")


def motion_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options of a motion, as `motion` takes them."""
    for option in reversed(
        [
            click.option("--frequency", metavar="HZ", type=float, help="Of a sine or triangle; a random wave has its "
                         "low pass there.  [default: 20 random, 12 sine, 4 triangle]"),
            click.option("--peak-to-peak", metavar="UM", type=float, help="[default: 28.6, sine and triangle 22.8]"),
            click.option("--velocity-limit", metavar="UM/S", type=float, help="The fastest that a random wave or a "
                         "staircase may be.  [default: none, staircase 300]"),
            click.option("--duration", metavar="S", type=click.FloatRange(min=0.5), help="[default: 20]"),
            click.option("--sample-rate", metavar="HZ", type=float,
                         help="Ticks per second.  [default: 2000, or that of the file]"),
        ]
    ):  # fmt: skip
        command = option(command)
    return command


def motion(name: str, options: Mapping[str, Any], **of_file: Any) -> Trajectory:
    """The motion that `name`, the options and, of a file, further arguments of `trajectories.from_csv` describe."""
    from truestroke.signals import trajectories

    given = {key: value for key in ("frequency", "velocity_limit", *SHARED) if (value := options[key]) is not None}
    function, understood = MOTIONS.get(name, ("from_csv", {"sample_rate": "sample_rate"}))
    for key in given:
        if key not in understood:
            raise click.UsageError(f"--{key.replace('_', '-')} means nothing to {name}: leave it out.")
    if name == "triangle":
        given.setdefault("frequency", 4.0)
    if "seed" in understood:
        given["seed"] = options["seed"]
    arguments = {understood[key]: value for key, value in given.items()}
    if name not in MOTIONS:
        arguments |= {"path": name, **of_file}
    return getattr(trajectories, function)(**arguments)  # type: ignore[no-any-return]
