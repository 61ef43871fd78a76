"""`truestroke refine`: adapt a model from the recording of the waveform that was made with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.base import display, files
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, waveforms


@click.command()
@common.record_options
@waveforms.model_option
@click.option("--waveform", type=common.FILE, metavar="FILE",
              help="What was put out, as `truestroke invert` or --next wrote it.")  # fmt: skip
@click.option("--output", metavar="FILE", default="refined.toml", help="The refined model is written there.")
@click.option("--next", "following", metavar="FILE", help="Write the waveform of the next pass, a .csv or .npz: "
              "corrected at each frequency through the model and what the passes so far show.")  # fmt: skip
@click.option("--dynamics", metavar="FILE", type=common.FILE, help="Of `truestroke bode`, in place of the delay and "
              "the resonances of the model; refined.toml has them from then on.")  # fmt: skip
@waveforms.rest_option
@waveforms.limit_options
@common.force_option
@common.overwrite_option
@common.json_option
def refine(
    record: Path, model: Path, waveform: Path | None, output: str, following: str | None, strict: bool, force: bool,
    as_json: bool, voltage_limits: tuple[float, float] | None, slew: float | None, dynamics: Path | None,
    rest: float, **options: Any,
) -> int:  # fmt: skip
    """Adapt a model from the recording of a waveform.

    Playback, record, refine, and again: prints how far this pass was from the desired motion, and how well the old
    and the refined model predict it. The actuator rests under the first voltage before each pass, for as long as
    `truestroke playback` waits.
    """
    if following and waveform is None:
        raise click.UsageError("--next needs --waveform: the motion is in there.")
    common.to_write("--output", output, files.MODEL)
    target = waveforms.waveform_file("--next", following) if following else None
    known, data = truestroke.load_model(model), truestroke.read_record(record, **options)
    waveforms.warn_of(known)
    common.examined(data, force)
    wanted = None if waveform is None else _put_out(waveform)
    stage = None if dynamics is None else truestroke.Dynamics.load(dynamics)
    found = truestroke.refine(known, data, waveform=wanted, dynamics=stage, rest=rest)
    truestroke.save_model(output, found.model)
    made = None
    if target is not None and wanted is not None:
        bounds = waveforms.limits(found.model, {"voltage_limits": voltage_limits, "slew": slew})
        made = found.next(**bounds)
        truestroke.save_waveform(target, made)
    if as_json:
        metrics = {"pass_rmse_um": found.rmse, "pass_maximum_um": found.maximum}
        metrics |= {"prediction_rmse_before_um": found.before, "prediction_rmse_um": found.after}
        planned = {"expected_rmse_um": found.expected, "waveform": str(target)}
        following_pass = {} if made is None else {**waveforms.as_dict(made), **planned}
        common.print_json({**found.verdict.as_dict(), **metrics, "model": output, "next": following_pass})
    else:
        _tell(found, output)
        if made is not None and found.expected is not None:
            click.echo(f"\nnext pass, rmse expected {display.micrometres(found.expected)}")
            waveforms.tell(made)
            common.print_verdict(made.verdict)
            click.echo(f"waveform   {target}")
    code = ExitCode.of(found.verdict)
    return code if code or made is None else waveforms.code(strict, made)


def _tell(found: truestroke.Refined, model: str) -> None:
    import numpy as np

    errors = {"prediction, old model": found.before, "prediction, refined": found.after}
    if found.rmse is not None and found.maximum is not None:
        errors = {"this pass, rmse": found.rmse, "this pass, maximum": found.maximum, **errors}
    common.print_table(("measured minus", "um", "of p-p"), waveforms.error_rows(errors, float(np.ptp(found.measured))))
    if found.undone:
        common.print_verdict(found.verdict)
    if found.kept:
        common.print_text(found.kept)
    click.echo(f"model      {model}")


def _put_out(file: Path) -> truestroke.Waveform:
    """With what it should have moved: `playback` outputs a file of voltages alone, too."""
    try:
        return truestroke.load_waveform(file)
    except truestroke.RecordError as error:
        if error.missing != "desired":
            raise
        reason = "no column desired, what the waveform should have moved, as `truestroke invert` and --next write it"
        remedy = "Without --waveform the record alone refines the model."
        raise click.ClickException(f"{file}: {reason}. {remedy}") from None
