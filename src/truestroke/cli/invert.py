"""`truestroke invert`: from a desired displacement to a voltage waveform."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.cli import common, motion, waveforms

if TYPE_CHECKING:
    from truestroke.identification import PredictedWaveform


@click.command()
@click.argument("trajectory", metavar=motion.METAVAR, callback=motion.known)
@waveforms.model_option
@motion.motion_options
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave.")
@waveforms.limit_options
@click.option("--output", metavar="NAME", default="waveform.csv", help="Write NAME.csv or NAME.npz.")
@common.plots_option
@common.overwrite_option
@common.json_option
def invert(
    trajectory: str, model: Path, output: str, plots: Path | None, strict: bool, as_json: bool, **options: Any
) -> None:
    """Make a voltage waveform of a desired displacement.

    A file has columns t (s) and z (um), or z alone, as the sensor of the model's record reads it; a built-in motion
    begins at the model's zero. The actuator is assumed to rest under the first voltage. Reports where the motion is out
    of reach or too fast, and where the model extrapolates.
    """
    from truestroke.identification import save_waveform, waveform

    target = waveforms.waveform_file("--output", output)
    known = waveforms.load(model)
    wave = motion.motion(trajectory, options, ramp=0.0)
    start = known.zero if trajectory in motion.MOTIONS else 0.0
    made = waveform(
        known, wave.position + start, wave.sample_rate, velocity=wave.velocity, **waveforms.limits(known, options)
    )
    save_waveform(target, made)
    pictures = _save_plot(made, plots) if plots else []
    if as_json:
        common.print_json(
            {
                **waveforms.as_dict(made),
                "model_rmse_um": waveforms.error_of(known),
                "waveform": str(target),
                "pictures": [str(path) for path in pictures],
            }
        )
    else:
        common.print_table(("predicted", "um", "of p-p"), waveforms.rows(made, known))
        waveforms.tell(made)
        common.print_files(waveform=target, pictures=plots)
    waveforms.leave(strict, made)


def _save_plot(made: PredictedWaveform, folder: Path) -> list[Path]:
    from truestroke.report.page import save_plots
    from truestroke.report.waveform import waveform

    return save_plots(lambda theme: {"waveform": waveform(made, theme)}, folder)
