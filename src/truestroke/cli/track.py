"""`truestroke track`: follow a motion with a simulated stack."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.cli import common, results, waveforms


@click.command()
@click.option("--controller", type=click.Choice(["adaptive", "paper"]), default="adaptive", help="What is tested.")
@click.option("--model", type=click.Path(exists=True, dir_okay=False), metavar="FILE", help="Start the adaptive "
              "controller from a model of `truestroke identify`.")  # fmt: skip
@click.option("--voltage-limits", type=float, nargs=2, metavar="LOW HIGH", default=(-0.6, 3.6),
              help="Lowest and highest voltage of the controller, V.")  # fmt: skip
@click.option("--plant", type=click.Choice(["realistic", "matched"]), default="realistic", help="What is driven: "
              "like a real stack, or of exactly the controller's structure.")  # fmt: skip
@click.option("--trajectory", metavar=waveforms.METAVAR, default="random", callback=waveforms.known_motion,
              help="Desired motion. A file has columns t (s) and z (um), or z alone.")  # fmt: skip
@waveforms.motion_options
@click.option("--change-at", metavar="S", type=float, help="The actuator changes suddenly then (Sec. 4.2).")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--output", metavar="NAME", default="truestroke-track", help="Write NAME.h5 and NAME.html.")
@common.page_options
def track(output: str, plots: Path | None, as_json: bool, **options: Any) -> int:
    """Follow a motion with a simulated stack.

    Prints rmse and maximum error over the second half of the run; writes a recording and a page of pictures.
    """
    from truestroke.studies import tracking

    recording_file, page_file = common.outputs(output, ".h5", ".html")
    trajectory = waveforms.motion(options["trajectory"], options)
    plant = tracking.stack(options["plant"], trajectory, options["seed"], options["change_at"])
    controller = _controller(options, trajectory)
    if len(trajectory) < results.SHORTEST:
        raise click.UsageError(f"--trajectory: {len(trajectory)} ticks, a page needs at least {results.SHORTEST}.")
    recording = _run(trajectory, controller, plant, recording_file)
    recording.save(recording_file)
    return results.finish(recording, page_file, plots, as_json, recording_file)


def _controller(options: Mapping[str, Any], trajectory: truestroke.Trajectory) -> truestroke.Controller:
    from truestroke.studies import tracking

    bench = {"sample_rate": trajectory.sample_rate, "voltage_limits": options["voltage_limits"]}
    if options["model"] is None:
        adaptive = truestroke.AdaptiveController
        make = adaptive.paper if options["controller"] == "paper" else adaptive
        return make(stroke=tracking.STROKE, **bench)
    if options["controller"] == "paper":
        raise click.UsageError("--controller paper knows no model: leave --model out.")
    model = truestroke.load_model(options["model"])
    if not tracking.like_the_stack(model):
        raise click.UsageError(
            f"--model {options['model']}: has {model.sensitivity:.3g} um/V, the simulated stack "
            f"{tracking.SENSITIVITY:.3g}: not the same actuator. On yours, `truestroke run` starts from the model."
        )
    return truestroke.AdaptiveController.from_model(model, **bench)


def _run(
    trajectory: truestroke.Trajectory, controller: truestroke.Controller, plant: Any, file: Path
) -> truestroke.Recording:
    """The run, and the same motion with a constant gain."""
    from truestroke.studies import tracking

    recording = results.recorded(
        "tracking", lambda tell: truestroke.run(trajectory, controller, plant, progress=tell), file
    )
    with common.stoppable():
        return tracking.with_uncompensated(recording, trajectory, plant)
