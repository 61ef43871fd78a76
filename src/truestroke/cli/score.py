"""`truestroke score`: how well a model predicts another record."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.base import files
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, waveforms


@click.command()
@click.argument("model", type=common.FILE)
@common.record_options
@click.option("--offset", metavar="UM", type=float, help="By how much the zero of RECORD is above that of the record "
              "of the model.  [default: estimated]")  # fmt: skip
@click.option("--report", metavar="FILE", default="score.html", help="The page is written there.")
@common.force_option
@common.page_options
def score(
    model: Path, record: Path, offset: float | None, report: str, force: bool, plots: Path | None, as_json: bool,
    **options: Any,
) -> int:  # fmt: skip
    """Errors of a model on a record of another day.

    The zero of the sensor is another one on another day: it is estimated, stated, and removed from the errors. The
    verdict says whether the model still holds: good, doubtful (usable, with the reasons), bad (exit code 4).
    """
    from truestroke.identification import score as scored

    page_file = common.to_write("--report", report, files.page("score"))
    known, data = truestroke.load_model(model), truestroke.read_record(record, **options)
    waveforms.warn_of(known)
    common.examined(data, force)
    found = scored(known, data, offset=offset)
    with common.progress("plotting"):
        from truestroke.report.identified import score as pages

        made = pages.score_page(found, known, model, common.to_repeat())
        pictures = common.save_page(made, page_file, plots)
    if as_json:
        metrics = {f.name: getattr(found, f.name) for f in dataclasses.fields(found)}
        metrics = {name: value for name, value in metrics.items() if name not in ("trace", "verdict", "beyond")}
        written = {"page": str(page_file), "pictures": pictures}
        warnings = {"warnings": list(found.beyond.warnings)}
        common.print_json({**found.verdict.as_dict(), **metrics, **written, **warnings})
        return ExitCode.of(found.verdict)
    common.print_table(("measured minus predicted", "um", "of p-p"), pages.rows(found))
    common.print_text(f"zero       {pages.offset(found)}")
    common.print_text(f"95 %       {pages.interval(found)}")
    for name, words in pages.voltage(found):
        common.print_text(f"{name:<11}{words}")
    for warning in found.beyond.warnings:
        common.print_text(f"- {warning}")
    common.print_verdict(found.verdict)
    common.print_files(page=page_file, pictures=plots)
    return ExitCode.of(found.verdict)
