"""`truestroke identify`: from a record of voltage and displacement to a model file and its page."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

import truestroke
from truestroke.base import display, files, system
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common


@click.command()
@common.record_options
@click.option("--output", metavar="FILE", default="model.toml", help="The model is written there.")
@click.option("--report", metavar="FILE", help="The page is written there.  [default: as --output, .html]")
@common.force_option
@common.page_options
def identify(
    record: Path, output: str, report: str | None, force: bool, plots: Path | None, as_json: bool, **options: Any
) -> int:
    """Fit a model to a record of voltage and displacement.

    Structure by blocked cross-validation; the last 40 % of the record measure how well the model predicts. Writes a
    model file that `AdaptiveController.from_model` starts from, and a page with its uncertainty. The verdict says
    whether to use it: good, doubtful (usable, with the reasons), bad (exit code 4).
    """
    target, page_file = _files(output, report)
    data = truestroke.read_record(record, **options)
    findings = common.examined(data, force)
    found = truestroke.identify(data, findings=findings)
    truestroke.save_model(target, found.model)
    with common.progress("plotting"), _the_model_is_there(target):
        from truestroke.report import identified

        made = identified.model_page(
            found, data, findings=findings, model_file=target, next_commands=tuple(_next(target, found.model)),
            command=common.to_repeat(),
        )  # fmt: skip
        pictures = common.save_page(made, page_file, plots)
    if as_json:
        metrics = dataclasses.asdict(found.held_out) | {"effective_samples": found.effective_samples}
        files = {"model": str(target), "page": str(page_file), "pictures": pictures}
        evidence = dataclasses.asdict(found.evidence)
        common.print_json(
            {**found.verdict.as_dict(), **metrics, "evidence": evidence, **files, "warnings": list(findings.warnings)}
        )
        return ExitCode.of(found.verdict)
    held = found.held_out
    rows = [
        ("rmse", display.micrometres(held.rmse_um), f"{held.rmse_percent:.2f} %"),
        ("maximum", display.micrometres(held.maximum_um), f"{held.maximum_percent:.2f} %"),
    ]
    common.print_text(f"record     {findings.sentence()}")
    common.print_table(("held out, the last part", "um", "of p-p"), rows)
    width = float(np.median(found.trace.half_width[found.trace.held_out]))
    common.print_text(f"95 %       +-{width:.3g} um (median) holds {100 * held.coverage:.0f} % of these samples")
    chosen = found.tried[-1]
    common.print_text(f"structure  chosen: {', '.join(chosen.parts)}, prior x {chosen.prior:g}")
    for warning in findings.warnings[len(findings.mistakes) + len(findings.implausible) :]:  # the verdict has those
        common.print_text(f"- {warning}")
    common.print_text(f"tested     {identified.tested_range(found.model)}: beyond, the model extrapolates")
    common.print_verdict(found.verdict)
    common.print_files(model=target, page=page_file, pictures=plots)
    if not found.verdict.is_bad:
        common.suggest(*_next(target, found.model))
    return ExitCode.of(found.verdict)


@contextmanager
def _the_model_is_there(target: Path) -> Iterator[None]:
    """Where the page is interrupted, a line says that the model is on the disk."""
    try:
        yield
    except KeyboardInterrupt:
        common.complain(f"{target} has the model; its page and pictures are not complete")
        raise


def _files(output: str, report: str | None) -> tuple[Path, Path]:
    """Model and page; an error now rather than after the fit if they cannot be written."""
    target = common.to_write("--output", output, files.MODEL)
    beside = target.with_name(f"{target.name.removesuffix('.toml')}.html")  # of stage.2 not that of stage.1
    page_file = common.to_write("--report", beside if report is None else report, files.page("identify"))
    if page_file == target:
        raise click.UsageError(f"--output {output}: the page would replace the model; call the model .toml.")
    return target, page_file


def _next(file: Path, model: truestroke.ActuatorModel) -> list[tuple[str, str]]:
    """Commands worth typing after this one."""
    from truestroke.studies.tracking import like_the_stack

    name = system.command_line(file)
    track = (f"track --model {name}", "the controller starts from the model, on the simulated stack")
    invert = (f"invert wave.csv --model {name}", "the voltage that makes a motion of yours")
    return [track, invert] if like_the_stack(model) else [invert]
