"""`truestroke refine`: adapt a model from the recording of the waveform that was made with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.base import files
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, records, waveforms

if TYPE_CHECKING:
    from truestroke.identification import Refined


@click.command()
@records.record_options
@waveforms.model_option
@click.option("--waveform", type=common.FILE, metavar="FILE",
              help="What was put out, as `truestroke invert` or --next wrote it.")  # fmt: skip
@click.option("--output", metavar="FILE", default="model.toml", help="The refined model is written there.")
@click.option("--next", "following", metavar="NAME", help="Write the waveform of the next pass, NAME.csv or NAME.npz: "
              "made with the refined model, and corrected by its residual in RECORD.")  # fmt: skip
@waveforms.limit_options
@common.overwrite_option
@common.json_option
def refine(
    record: Path, model: Path, waveform: Path | None, output: str, following: str | None, strict: bool, as_json: bool,
    voltage_limits: tuple[float, float] | None, slew: float | None, **options: Any,
) -> int:  # fmt: skip
    """Adapt a model from the recording of a waveform.

    Playback, record, refine, and again: prints how far this pass was from the desired motion, and how well the old
    and the refined model predict it. The actuator rests under the first voltage before each pass.
    """
    from truestroke import identification

    if following and waveform is None:
        raise click.UsageError("--next needs --waveform: the motion is in there.")
    if not Path(output).parent.is_dir():
        raise click.ClickException(f"--output {output}: there is no folder {Path(output).parent}")
    files.check(output, files.MODEL)
    target = waveforms.waveform_file("--next", following) if following else None
    known, data = waveforms.load(model), records.read(record, **options)
    wanted = None if waveform is None else identification.load_waveform(waveform)
    found = identification.refine(known, data, waveform=wanted)
    identification.save_model(output, found.model)
    made = None
    if target is not None and wanted is not None:
        bounds = waveforms.limits(found.model, {"voltage_limits": voltage_limits, "slew": slew})
        made = identification.waveform(
            found.model, wanted.desired, wanted.sample_rate, residual=found.residual, **bounds
        )
        identification.save_waveform(target, made)
    if as_json:
        following_pass = {} if made is None else {**waveforms.as_dict(made), "waveform": str(target)}
        common.print_json({**found.verdict.as_dict(), **_metrics(found), "model": output, "next": following_pass})
    else:
        _tell(found, output)
        if made is not None:
            click.echo("\nnext pass")
            waveforms.tell(made)
            click.echo(f"waveform   {target}")
    if made is not None:
        waveforms.leave(strict, made)
    return ExitCode.of(found.verdict)


def _metrics(found: Refined) -> dict[str, Any]:
    return {
        "pass_rmse_um": found.rmse,
        "pass_maximum_um": found.maximum,
        "prediction_rmse_before_um": found.before,
        "prediction_rmse_um": found.after,
    }


def _tell(found: Refined, model: str) -> None:
    import numpy as np

    lines = [("prediction, old model", found.before), ("prediction, refined", found.after)]
    if found.rmse is not None and found.maximum is not None:
        lines = [("this pass, rmse", found.rmse), ("this pass, maximum", found.maximum), *lines]
    span = float(np.ptp(found.measured))
    common.print_table(
        ("measured minus", "um", "of p-p"),
        [(name, f"{value:.4f} um", f"{100 * value / span:.2f} %") for name, value in lines],
    )
    if found.undone:
        common.print_verdict(found.verdict)
    click.echo(f"model      {model}")
