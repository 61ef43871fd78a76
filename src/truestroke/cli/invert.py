"""`truestroke invert`: from a desired displacement to a voltage waveform."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.base import files
from truestroke.cli import common, waveforms
from truestroke.control import reach


@click.command()
@click.argument("trajectory", metavar=waveforms.METAVAR, callback=waveforms.known_motion)
@waveforms.model_option
@waveforms.motion_options
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave.")
@waveforms.limit_options
@waveforms.rest_option
@click.option("--output", metavar="FILE", default="waveform.csv", help="A .csv or .npz.")
@click.option("--report", metavar="FILE", default="waveform.html", help="The page is written there.")
@common.page_options
def invert(
    trajectory: str, model: Path, output: str, report: str, plots: Path | None, strict: bool, rest: float,
    as_json: bool, **options: Any,
) -> int:  # fmt: skip
    """Make a voltage waveform of a desired displacement.

    A file has columns t (s) and z (um), or z alone, as the sensor of the model's record reads it; a built-in motion
    begins at the model's zero. The actuator rests under the first voltage for as long as `truestroke playback` waits,
    and creep that is slower goes on. Reports where the motion is out of reach or too fast, and where the model
    extrapolates. The verdict says whether to use the waveform: good, doubtful (usable, with the reasons), bad (exit
    code 4).
    """
    page_file = common.to_write("--report", report, files.page("invert"))
    target = waveforms.waveform_file("--output", output)
    known = truestroke.load_model(model)
    wave = waveforms.motion(trajectory, options, ramp=0.0)
    start = known.zero if trajectory in waveforms.MOTIONS else 0.0
    asked = {**waveforms.limits(known, options), "rest": rest, "velocity": wave.velocity}
    made = truestroke.waveform(known, wave.position + start, wave.sample_rate, **asked)
    waveforms.refuse_unreachable(made)
    truestroke.save_waveform(target, made)
    with common.progress("plotting"):
        from truestroke.report import waveform as pages

        page = pages.page(made, known, waveforms.rows(made, known), common.to_repeat())
        pictures = common.save_page(page, page_file, plots)
    if as_json:
        found = {**waveforms.as_dict(made), "model_rmse_um": reach.error_of(known)}
        common.print_json({**found, "waveform": str(target), "page": str(page_file), "pictures": pictures})
    else:
        common.print_table(("predicted", "um", "of p-p"), waveforms.rows(made, known))
        waveforms.tell(made)
        common.print_verdict(made.verdict)
        common.print_files(waveform=target, page=page_file, plots=plots)
    return waveforms.code(strict, made)
