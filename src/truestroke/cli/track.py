"""`truestroke track`: follow a motion with a simulated stack."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke.cli import common
from truestroke.cli.report import SHORTEST, finish

if TYPE_CHECKING:
    from truestroke.controller import Controller
    from truestroke.loop import Actuator
    from truestroke.recording import Recording
    from truestroke.trajectories import Trajectory

STROKE = 30.0  # um, of the simulated stack
VOLTAGE_LIMITS = (-0.6, 3.6)  # V at the D/A converter

# What each trajectory understands: option -> argument of its function.
SHARED = {"peak_to_peak": "peak_to_peak", "duration": "duration", "sample_rate": "sample_rate"}
MOTIONS = {
    "random": ("random_wave", {"frequency": "cutoff", "velocity_limit": "velocity_limit", "seed": "seed", **SHARED}),
    "sine": ("sine", {"frequency": "frequency", **SHARED}),
    "triangle": ("triangle", {"frequency": "frequency", **SHARED}),
    "staircase": ("staircase", {"velocity_limit": "velocity_limit", **SHARED}),
}


def _motion(context: click.Context, option: click.Parameter, value: str) -> str:
    """`value`, if it is one of `MOTIONS` or a file."""
    if value in MOTIONS or Path(value).is_file():
        return value
    raise click.BadParameter(f"{value!r} is neither one of {', '.join(MOTIONS)} nor a file.")


@click.command()
@click.option("--controller", type=click.Choice(["adaptive", "paper"]), default="adaptive", help="What is tested.")
@click.option("--plant", type=click.Choice(["realistic", "matched"]), default="realistic", help="What is driven: "
              "like a real stack, or of exactly the controller's structure.")  # fmt: skip
@click.option("--trajectory", metavar=f"[{'|'.join(MOTIONS)}|FILE.csv]", default="random", callback=_motion,
              help="Desired motion. A file has columns t (s) and z (um), or z alone.")  # fmt: skip
@click.option("--frequency", metavar="HZ", type=float, help="Of a sine or triangle; a random wave has its low pass "
              "there.  [default: 20 random, 12 sine, 4 triangle]")  # fmt: skip
@click.option("--peak-to-peak", metavar="UM", type=float, help="[default: 28.6, sine and triangle 22.8]")
@click.option("--velocity-limit", metavar="UM/S", type=float, help="The fastest that a random wave or a staircase "
              "may be.  [default: none, staircase 300]")  # fmt: skip
@click.option("--duration", metavar="S", type=click.FloatRange(min=0.5), help="[default: 20]")
@click.option("--sample-rate", metavar="HZ", type=float, help="Ticks per second.  [default: 2000, or that of the file]")
@click.option("--change-at", metavar="S", type=float, help="The actuator changes suddenly then (Sec. 4.2).")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--output", metavar="NAME", default="truestroke-track", help="Write NAME.h5 and NAME.html.")
@common.pictures_option
@common.json_option
def track(output: str, figures: Path | None, as_json: bool, **options: Any) -> None:
    """Follow a motion with a simulated stack.

    Prints rmse and maximum error over the second half of the run; writes a recording and a page of pictures.
    """
    recording_file, page_file = common.outputs(output, ".h5", ".html")
    trajectory = _trajectory(options)
    plant = _plant(options, trajectory)
    controller = _controller(options["controller"], trajectory)
    if len(trajectory) < SHORTEST:
        raise click.UsageError(f"--trajectory: {len(trajectory)} ticks, a page needs at least {SHORTEST}.")
    recording = _run(trajectory, controller, plant, recording_file)
    recording.save(recording_file)
    finish(recording, page_file, figures, as_json, recording_file)


# ---- From options to the run ---------------------------------------------------------------------------------------


def _trajectory(options: Mapping[str, Any]) -> Trajectory:
    from truestroke import trajectories

    name = options["trajectory"]
    given = {key: value for key in ("frequency", "velocity_limit", *SHARED) if (value := options[key]) is not None}
    function, known = MOTIONS.get(name, ("from_csv", {"sample_rate": "sample_rate"}))
    for key in given:
        if key not in known:
            raise click.UsageError(f"--{key.replace('_', '-')} means nothing to --trajectory {name}: leave it out.")
    if name == "triangle":
        given.setdefault("frequency", 4.0)
    if "seed" in known:
        given["seed"] = options["seed"]
    arguments = {known[key]: value for key, value in given.items()}
    if name not in MOTIONS:
        arguments |= {"path": name, **_columns(Path(name))}
    return getattr(trajectories, function)(**arguments)  # type: ignore[no-any-return]


def _columns(path: Path) -> dict[str, int]:
    """Time first, then position, where a file has more than one column."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return {"time": 0, "position": 1} if "," in file.readline() else {}


def _plant(options: Mapping[str, Any], trajectory: Trajectory) -> Actuator:
    from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant

    at, rate = options["change_at"], trajectory.sample_rate
    if at is not None and not 0 < at < trajectory.duration:
        raise click.UsageError(
            f"--change-at {at:g}: must be between 0 and the end of the run, {trajectory.duration:g} s."
        )
    if options["plant"] == "matched":
        matched = MatchedSettings(
            sample_rate=rate,
            change=None if at is None else Change(time=at),
            weight_spread=0.0 if at is None else 0.3,  # Sec. 4.2
        )
        return MatchedPlant(velocity=trajectory.velocity, settings=matched, seed=options["seed"])
    change = None if at is None else Change(time=at, gain=0.8, hysteresis=1.3)
    return RealisticPlant(PlantSettings(sample_rate=rate, change=change), seed=options["seed"])


def _controller(name: str, trajectory: Trajectory) -> Controller:
    make = truestroke.AdaptiveController.paper if name == "paper" else truestroke.AdaptiveController
    return make(sample_rate=trajectory.sample_rate, stroke=STROKE, voltage_limits=VOLTAGE_LIMITS)


def _run(trajectory: Trajectory, controller: Controller, plant: Actuator, rescue: Path) -> Recording:
    """The run, and the same motion with a constant gain; what there is goes to `rescue` if it is interrupted."""
    from truestroke.loop import RunInterrupted, run
    from truestroke.recording import Recording

    try:
        with common.progress("tracking") as tell:
            recording = run(trajectory, controller, plant, progress=tell)
    except RunInterrupted as stop:
        ticks = stop.recording["time"].size
        saved = f"the {ticks} ticks so far are in {stop.recording.save(rescue)}" if ticks else "nothing was saved"
        if isinstance(stop.__cause__, KeyboardInterrupt):
            click.echo(f"truestroke: {saved}", err=True)
            raise click.Abort from None
        raise click.ClickException(f"{stop.__cause__}; {saved}") from stop
    recording = Recording(recording.channels, recording.metadata | common.as_asked())
    recording.save(rescue)
    return _with_uncompensated(recording, trajectory, plant)


def _with_uncompensated(recording: Recording, trajectory: Trajectory, plant: Actuator) -> Recording:
    """The recording with what the same motion would be with the straight line that fits the actuator best."""
    import numpy as np

    from truestroke.baselines import ConstantGain
    from truestroke.loop import RunInterrupted, run
    from truestroke.recording import Channel, Recording

    if not np.ptp(recording["volts"]):
        return recording  # at rest there is nothing to compare
    (offset, gain) = np.polynomial.Polynomial.fit(recording["volts"], recording["true"], 1).convert().coef
    line = ConstantGain(float(gain), VOLTAGE_LIMITS, offset=float(offset))
    try:
        before = run(trajectory, line, plant)["true"]
    except RunInterrupted as stop:
        raise click.Abort from stop
    kept = Channel(before, "um", f"true displacement if z = {offset:.3g} um + {gain:.4g} um/V x were all")
    return Recording(recording.channels | {"uncompensated": kept}, recording.metadata)
