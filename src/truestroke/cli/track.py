"""`truestroke track`: follow a motion with a simulated stack."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.cli import common, results, waveforms

SECONDS = 7e-6  # of a tick that is simulated


@click.command()
@click.option("--controller", type=click.Choice(["adaptive", "paper"]), default="adaptive", help="What is tested.")
@click.option("--model", type=common.FILE, metavar="FILE", help="Start the adaptive "
              "controller from a model of `truestroke identify`.")  # fmt: skip
@waveforms.force_option
@click.option("--voltage-limits", type=float, nargs=2, metavar="LOW HIGH", default=(-0.6, 3.6),
              help="Lowest and highest voltage of the controller, V.")  # fmt: skip
@click.option("--dynamics", metavar="FILE", type=common.FILE, help="Give the adaptive controller the dynamics of "
              "`truestroke bode`.")  # fmt: skip
@click.option("--period", type=float, metavar="S", help="Of a motion that repeats: the error that remains is "
              "learned while it runs.")  # fmt: skip
@click.option("--plant", type=click.Choice(["realistic", "matched", "stage"]), help="What is driven: like a real "
              "stack, of exactly the controller's structure, or the stage that `truestroke bode` measures without "
              "--config.  [default: realistic; stage with --dynamics]")  # fmt: skip
@click.option("--trajectory", metavar=waveforms.METAVAR, default="random", callback=waveforms.known_motion,
              help="Desired motion. A file has columns t (s) and z (um), or z alone.")  # fmt: skip
@waveforms.motion_options
@click.option("--change-at", metavar="S", type=float, help="The actuator changes suddenly then (Sec. 4.2).")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--output", metavar="NAME", default="truestroke-track", help="Write NAME.h5 and NAME.html.")
@common.page_options
def track(output: str, plots: Path | None, as_json: bool, **options: Any) -> int:
    """Follow a motion with a simulated stack or stage.

    Prints rmse and maximum error over the second half of the run; writes a recording and a page of pictures.
    """
    from truestroke.studies import tracking

    waveforms.refuse_forced(options)
    recording_file, page_file = common.outputs(output, ".h5", ".html")
    dynamics = None if options["dynamics"] is None else _dynamics(options)
    kind: Any = options["plant"] or ("realistic" if dynamics is None else "stage")
    if kind == "stage" and options["sample_rate"] is None and options["trajectory"] in waveforms.MOTIONS:
        options["sample_rate"] = tracking.STAGE_RATE if dynamics is None else dynamics.sample_rate
    trajectory = waveforms.motion(options["trajectory"], options)
    plant = tracking.plant(kind, trajectory, options["seed"], options["change_at"])
    controller = _controller(options, trajectory, {} if dynamics is None else {"dynamics": dynamics})
    if options["period"] is not None:
        controller = truestroke.RepetitiveController(controller, options["period"])
    if len(trajectory) < results.SHORTEST:
        raise click.UsageError(f"--trajectory: {len(trajectory)} ticks, a page needs at least {results.SHORTEST}.")
    common.foretell(f"{len(trajectory):.3g} ticks take about", SECONDS * len(trajectory), as_json)
    recording = _run(trajectory, controller, plant, recording_file)
    recording.save(recording_file)
    return results.finish(recording, page_file, plots, as_json, recording_file)


def _dynamics(options: Mapping[str, Any]) -> truestroke.Dynamics:
    """Those of the file; a UsageError where they mean nothing to plant or controller."""
    from truestroke.studies import tracking

    if options["plant"] not in (None, "stage"):
        raise click.UsageError(f"--dynamics are of the simulated stage: use --plant stage, not {options['plant']}.")
    if options["controller"] == "paper":
        raise click.UsageError("--controller paper knows no dynamics: leave --dynamics out.")
    found = truestroke.Dynamics.load(options["dynamics"])
    if not tracking.like_the_stage(found):
        raise click.UsageError(
            f"--dynamics {options['dynamics']}: has its first resonance at {found.modes[0].frequency:.4g} Hz, the "
            f"simulated stage at {tracking.RESONANCE:g} Hz: not the same stage. On yours, `truestroke run` takes them."
        )
    return found


def _controller(
    options: Mapping[str, Any], trajectory: truestroke.Trajectory, known: Mapping[str, Any]
) -> truestroke.Controller:
    from truestroke.studies import tracking

    bench = {"sample_rate": trajectory.sample_rate, "voltage_limits": options["voltage_limits"]}
    if options["model"] is None:
        _check_limits(*options["voltage_limits"])
        adaptive = truestroke.AdaptiveController
        if options["controller"] == "paper":
            return adaptive.paper(stroke=tracking.STROKE, **bench)
        return adaptive(stroke=tracking.STROKE, **bench, **known)
    if options["controller"] == "paper":
        raise click.UsageError("--controller paper knows no model: leave --model out.")
    model = truestroke.usable_model(options["model"], force=options["force"])
    if not tracking.like_the_stack(model):
        raise click.UsageError(
            f"--model {options['model']}: has {model.sensitivity:.3g} um/V, the simulated stack "
            f"{tracking.SENSITIVITY:.3g}: not the same actuator. On yours, `truestroke run` starts from the model."
        )
    return truestroke.AdaptiveController.from_model(model, **bench, **known)


def _check_limits(low: float, high: float) -> None:
    """UsageError where the range is that of another actuator: its gain would be further off than `run` permits."""
    from truestroke.runtime import gains
    from truestroke.studies import tracking

    own = tracking.VOLTAGE_LIMITS
    if high - low > gains.RUN[1] * (own[1] - own[0]):
        raise click.UsageError(
            f"--voltage-limits {low:g} {high:g}: the simulated stack moves {tracking.STROKE:g} um from {own[0]:g} to "
            f"{own[1]:g} V, before its amplifier: not the same actuator. For yours, `truestroke run --example`."
        )


def _run(
    trajectory: truestroke.Trajectory, controller: truestroke.Controller, plant: Any, file: Path
) -> truestroke.Recording:
    """The run, and the same motion with a constant gain."""
    from truestroke.studies import tracking

    recording = results.recorded(
        "tracking", lambda tell: truestroke.run(trajectory, controller, plant, progress=tell), file
    )
    return tracking.with_uncompensated(recording, trajectory, plant)
