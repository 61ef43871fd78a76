"""`truestroke identify`: from a record of voltage and displacement to a model file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.cli import common
from truestroke.cli.examine import read, record_options

if TYPE_CHECKING:
    from truestroke.identification import Identified


@click.command()
@record_options
@click.option("--output", metavar="FILE", default="model.toml", help="The model is written there.")
@common.json_option
def identify(record: Path, output: str, as_json: bool, **options: Any) -> None:
    """Fit a model to a record of voltage and displacement.

    Structure by blocked cross-validation; the last 40 % of the record tell how well the model predicts. Writes a model
    file that `AdaptiveController.from_model` starts from.
    """
    from truestroke.identification import examine, save_model
    from truestroke.identification import identify as fit

    target = Path(output)
    if not target.parent.is_dir():
        raise click.ClickException(f"--output {output}: there is no folder {target.parent}")
    data = read(record, **options)
    warnings = examine(data).warnings
    found = fit(data)
    save_model(target, found.model)
    if as_json:
        common.print_json({**_figures(found), "model": str(target), "warnings": list(warnings)})
        return
    common.print_table(("held out, the last part", "um", "of p-p"), _rows(found))
    common.print_text(f"structure  {found.tried[-1][0]}" if found.tried else "structure  as given")
    for warning in warnings:
        common.print_text(f"- {warning}")
    click.echo(f"model      {target}")


def _figures(found: Identified) -> dict[str, Any]:
    import dataclasses

    return dataclasses.asdict(found.held_out) | {"effective_samples": found.effective_samples}


def _rows(found: Identified) -> list[tuple[str, str, str]]:
    h = found.held_out
    return [
        ("rmse", f"{h.rmse_um:.4f} um", f"{h.rmse_percent:.2f} %"),
        ("maximum", f"{h.maximum_um:.4f} um", f"{h.maximum_percent:.2f} %"),
    ]
