"""`truestroke track`: follow a motion with a simulated stack."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke.cli import common, motion
from truestroke.cli.report import SHORTEST, finish

if TYPE_CHECKING:
    from truestroke.control.controller import Controller
    from truestroke.identification import ActuatorModel
    from truestroke.runtime.loop import Actuator
    from truestroke.signals.recording import Recording
    from truestroke.signals.trajectories import Trajectory

STROKE = 30.0  # um, of the simulated stack
VOLTAGE_LIMITS = (-0.6, 3.6)  # V at the D/A converter
SENSITIVITY = 13.0  # um/V, about that of the simulated stacks
ALIKE = 2.5  # times more or less


@click.command()
@click.option("--controller", type=click.Choice(["adaptive", "paper"]), default="adaptive", help="What is tested.")
@click.option("--model", type=click.Path(exists=True, dir_okay=False), metavar="FILE", help="Start the adaptive "
              "controller from a model of `truestroke identify`.")  # fmt: skip
@click.option("--voltage-limits", type=float, nargs=2, metavar="LOW HIGH", default=VOLTAGE_LIMITS,
              help="Lowest and highest voltage of the controller, V.")  # fmt: skip
@click.option("--plant", type=click.Choice(["realistic", "matched"]), default="realistic", help="What is driven: "
              "like a real stack, or of exactly the controller's structure.")  # fmt: skip
@click.option("--trajectory", metavar=motion.METAVAR, default="random", callback=motion.known,
              help="Desired motion. A file has columns t (s) and z (um), or z alone.")  # fmt: skip
@motion.motion_options
@click.option("--change-at", metavar="S", type=float, help="The actuator changes suddenly then (Sec. 4.2).")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--output", metavar="NAME", default="truestroke-track", help="Write NAME.h5 and NAME.html.")
@common.plots_option
@common.overwrite_option
@common.json_option
def track(output: str, plots: Path | None, as_json: bool, **options: Any) -> int:
    """Follow a motion with a simulated stack.

    Prints rmse and maximum error over the second half of the run; writes a recording and a page of pictures.
    """
    recording_file, page_file = common.outputs(output, ".h5", ".html")
    trajectory = motion.motion(options["trajectory"], options)
    plant = _plant(options, trajectory)
    controller = _controller(options, trajectory)
    if len(trajectory) < SHORTEST:
        raise click.UsageError(f"--trajectory: {len(trajectory)} ticks, a page needs at least {SHORTEST}.")
    recording = _run(trajectory, controller, plant, recording_file)
    recording.save(recording_file)
    return finish(recording, page_file, plots, as_json, recording_file)


# ---- From options to the run ---------------------------------------------------------------------------------------


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


def _controller(options: Mapping[str, Any], trajectory: Trajectory) -> Controller:
    from truestroke.cli.invert import load

    bench = {"sample_rate": trajectory.sample_rate, "voltage_limits": options["voltage_limits"]}
    if options["model"] is None:
        adaptive = truestroke.AdaptiveController
        make = adaptive.paper if options["controller"] == "paper" else adaptive
        return make(stroke=STROKE, **bench)
    if options["controller"] == "paper":
        raise click.UsageError("--controller paper knows no model: leave --model out.")
    model = load(options["model"])
    if not like_the_stack(model):
        raise click.UsageError(
            f"--model {options['model']}: has {model.sensitivity:.3g} um/V, the simulated stack {SENSITIVITY:.3g}: not "
            "the same actuator. On yours, `truestroke run` starts from the model."
        )
    return truestroke.AdaptiveController.from_model(model, **bench)


def like_the_stack(model: ActuatorModel) -> bool:
    """Whether it may be a model of the simulated stack."""
    return SENSITIVITY / ALIKE < model.sensitivity < SENSITIVITY * ALIKE


def _run(trajectory: Trajectory, controller: Controller, plant: Actuator, rescue: Path) -> Recording:
    """The run, and the same motion with a constant gain; what there is goes to `rescue` if it is interrupted."""
    from truestroke.runtime.loop import RunInterrupted, run

    try:
        with common.progress("tracking") as tell:
            recording = run(trajectory, controller, plant, progress=tell)
    except RunInterrupted as stop:
        ticks = stop.recording["time"].size
        saved = f"the {ticks} ticks so far are in {_own(stop.recording).save(rescue)}" if ticks else "nothing was saved"
        common.interrupted(stop, saved)
    recording = _own(recording)
    recording.save(rescue)
    return _with_uncompensated(recording, trajectory, plant)


def _own(recording: Recording) -> Recording:
    """With the command that made it."""
    from truestroke.signals.recording import Recording

    return Recording(recording.channels, recording.metadata | common.as_asked())


def _with_uncompensated(recording: Recording, trajectory: Trajectory, plant: Actuator) -> Recording:
    """The recording with what the same motion would be with the straight line that fits the actuator best."""
    import numpy as np

    from truestroke.control.baselines import ConstantGain
    from truestroke.runtime.loop import RunInterrupted, run
    from truestroke.signals.recording import Channel, Recording

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
