"""`truestroke invert`: from a desired displacement to a voltage waveform."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.cli import common, waveforms


@click.command()
@click.argument("trajectory", metavar=waveforms.METAVAR, callback=waveforms.known_motion)
@waveforms.model_option
@waveforms.motion_options
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave.")
@waveforms.limit_options
@click.option("--output", metavar="FILE", default="waveform.csv", help="A .csv or .npz.")
@common.page_options
def invert(
    trajectory: str, model: Path, output: str, plots: Path | None, strict: bool, as_json: bool, **options: Any
) -> None:
    """Make a voltage waveform of a desired displacement.

    A file has columns t (s) and z (um), or z alone, as the sensor of the model's record reads it; a built-in motion
    begins at the model's zero. The actuator is assumed to rest under the first voltage. Reports where the motion is out
    of reach or too fast, and where the model extrapolates.
    """
    target = waveforms.waveform_file("--output", output)
    known = truestroke.load_model(model)
    waveforms.warn_of(known)
    wave = waveforms.motion(trajectory, options, ramp=0.0)
    start = known.zero if trajectory in waveforms.MOTIONS else 0.0
    limits = waveforms.limits(known, options)
    made = truestroke.waveform(known, wave.position + start, wave.sample_rate, velocity=wave.velocity, **limits)
    waveforms.refuse_unreachable(made)
    truestroke.save_waveform(target, made)
    pictures = []
    if plots:
        from truestroke.report import page
        from truestroke.report.waveform import waveform

        pictures = page.save_plots(lambda theme: {"waveform": waveform(made, theme)}, plots)
    if as_json:
        found = {**waveforms.as_dict(made), "model_rmse_um": waveforms.error_of(known)}
        common.print_json({**found, "waveform": str(target), "pictures": [str(path) for path in pictures]})
    else:
        common.print_table(("predicted", "um", "of p-p"), waveforms.rows(made, known))
        waveforms.tell(made)
        common.print_files(waveform=target, pictures=plots)
    waveforms.leave(strict, made)
