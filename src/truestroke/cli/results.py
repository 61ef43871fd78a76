"""What is printed and written of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from truestroke.base.checks import SettingError
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.base.verdict import Verdict
    from truestroke.signals.metrics import TrackingSummary
    from truestroke.signals.recording import Recording

SHORTEST = 20  # ticks that can be plotted


def own(recording: Recording) -> Recording:
    """The same with the command that made it."""
    return type(recording)(recording.channels, recording.metadata | common.as_asked())


def finish(recording: Recording, page_file: Path, plots: Path | None, as_json: bool, recording_file: Path) -> int:
    """Page and pictures to disk, verdict, table and paths to the terminal; the exit code."""
    from truestroke.signals import judgement

    verdict, ticks = judgement.judge(recording), len(recording["time"])
    code = ExitCode.of(verdict)
    if ticks < SHORTEST and not verdict.is_bad:
        raise click.ClickException(f"{recording_file}: {ticks} ticks, a page needs at least {SHORTEST}")
    try:
        summary = judgement.summary(recording) if ticks >= SHORTEST else None
    except SettingError:
        summary = None
    if summary is None:  # without measurements there are no metrics, and nothing to plot
        _tell_alone(verdict, as_json, recording_file)
        return code
    with common.progress("plotting"):
        from truestroke.report import run_page

        pictures = common.save_page(run_page(recording), page_file, plots)
    if as_json:
        files = {"recording": str(recording_file), "page": str(page_file), "pictures": pictures}
        common.print_json({**verdict.as_dict(), **summary.as_dict(), **files})
        return code
    print_metrics(summary, verdict)
    common.print_files(recording=recording_file, page=page_file, pictures=plots)
    if not verdict.is_bad:
        common.suggest(*_next(recording))
    return code


def _tell_alone(verdict: Verdict, as_json: bool, recording_file: Path) -> None:
    if as_json:
        common.print_json({**verdict.as_dict(), "recording": str(recording_file), "page": None, "pictures": []})
    else:
        common.print_verdict(verdict)
        common.print_files(recording=recording_file)


def print_metrics(summary: TrackingSummary, verdict: Verdict) -> None:
    """The table of errors, the verdict, when the error became small, and what happened on the way."""
    from rich.text import Text

    from truestroke.report import words

    columns = [words.span(summary)]
    for kind in words.kinds(summary):
        columns += [kind, "of p-p"]
    rows = [
        [name, *(text for um, percent in cells for text in (Text.assemble((um, "bold"), " um"), f"{percent} %"))]
        for name, cells in words.table(summary)
    ]
    common.print_table(columns, rows, dim="of p-p")
    common.print_verdict(verdict)
    for name, text in words.course(summary):
        click.echo(f"{name:10} {text}")
    flags = ("\n" + " " * 11).join(words.flags(summary)) or "none"
    click.echo(f"flags      {flags}\n")


def _next(recording: Recording) -> list[tuple[str, str]]:
    """Commands worth typing after this one."""
    from truestroke.signals.judgement import change_time

    if change_time(recording) is None:
        first = ("track --change-at 10", "the actuator changes suddenly")
    else:
        first = ("track --change-at 10 --controller paper", "the same with the paper's controller")
    return [
        first,
        ("compare", "eight controllers on the same actuator"),
        ("reproduce", "the paper's figures beside ours"),
    ]
