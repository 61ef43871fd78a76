"""`truestroke identify`: from a record of voltage and displacement to a model file and its page."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.base import files
from truestroke.cli import common, records

if TYPE_CHECKING:
    from truestroke.identification import ActuatorModel, Identified


@click.command()
@records.record_options
@click.option("--output", metavar="FILE", default="model.toml", help="The model is written there.")
@click.option("--report", metavar="FILE", help="The page is written there.  [default: as --output, .html]")
@common.plots_option
@common.overwrite_option
@common.json_option
def identify(record: Path, output: str, report: str | None, plots: Path | None, as_json: bool, **options: Any) -> None:
    """Fit a model to a record of voltage and displacement.

    Structure by blocked cross-validation; the last 40 % of the record measure how well the model predicts. Writes a
    model file that `AdaptiveController.from_model` starts from, and a page with its uncertainty.
    """
    from truestroke.identification import examine, save_model
    from truestroke.identification import identify as fit

    target, page_file = _files(output, report)
    data = records.read(record, **options)
    findings = examine(data)
    found = fit(data)
    save_model(target, found.model)
    with common.progress("plotting"):
        from truestroke.report import identified

        made = identified.model_page(
            found,
            data,
            findings=findings,
            model_file=target,
            next_commands=tuple(_next(target, found.model)),
            command=common.as_asked()["command"],
        )
        pictures = common.save_page(made, page_file, plots)
    if as_json:
        files = {"model": str(target), "page": str(page_file), "pictures": pictures}
        common.print_json({**_metrics(found), **files, "warnings": list(findings.warnings)})
        return
    common.print_table(("held out, the last part", "um", "of p-p"), _rows(found))
    chosen = found.tried[-1]
    common.print_text(f"structure  chosen: {', '.join(chosen.parts)}, prior x {chosen.prior:g}")
    for warning in findings.warnings:
        common.print_text(f"- {warning}")
    common.print_files(model=target, page=page_file, pictures=plots)
    common.suggest(*_next(target, found.model))


def _files(output: str, report: str | None) -> tuple[Path, Path]:
    """Model and page; an error now rather than after the fit if they cannot be written."""
    target = Path(output)
    page_file = target.with_suffix(".html") if report is None else Path(report)
    for option, file in (("--output", target), ("--report", page_file)):
        if not file.parent.is_dir():
            raise click.ClickException(f"{option} {file}: there is no folder {file.parent}")
        if file.is_dir():
            raise click.UsageError(f"{option} {file}: is a folder; name a file.")
    if page_file == target:
        raise click.UsageError(f"--output {output}: the page would replace the model; call the model .toml.")
    files.check(target, files.MODEL)
    files.check(page_file, files.PAGE)
    return target, page_file


def _next(file: Path, model: ActuatorModel) -> list[tuple[str, str]]:
    """Commands worth typing after this one."""
    from truestroke.studies.tracking import like_the_stack

    name = shlex.quote(str(file))
    track = (f"track --model {name}", "the controller starts from the model, on the simulated stack")
    invert = (f"invert wave.csv --model {name}", "the voltage that makes a motion of yours")
    return [track, invert] if like_the_stack(model) else [invert]


def _metrics(found: Identified) -> dict[str, Any]:
    import dataclasses

    return dataclasses.asdict(found.held_out) | {"effective_samples": found.effective_samples}


def _rows(found: Identified) -> list[tuple[str, str, str]]:
    h = found.held_out
    return [
        ("rmse", f"{h.rmse_um:.4f} um", f"{h.rmse_percent:.2f} %"),
        ("maximum", f"{h.maximum_um:.4f} um", f"{h.maximum_percent:.2f} %"),
    ]
