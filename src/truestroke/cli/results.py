"""What is printed and written of a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

import truestroke
from truestroke.base.checks import SettingError
from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.signals.metrics import TrackingSummary

Progress = Callable[[int, int], None]  # (done, of so many)
SHORTEST = 20  # ticks that can be plotted


def own(recording: truestroke.Recording) -> truestroke.Recording:
    """The same with the command that made it, and in its words."""
    about = recording.metadata | common.as_asked()
    if notices := about.get("notices"):
        about["notices"] = [common.notice(text) for text in notices]
    return type(recording)(recording.channels, about)


def recorded(what: str, run: Callable[[Progress | None], truestroke.Recording], file: Path) -> truestroke.Recording:
    """The recording of a run, saved with the command that made it; so is what an interrupted run has."""
    try:
        with common.progress(what) as tell:
            recording = own(run(tell))
    except truestroke.RunInterrupted as stop:
        ticks, part = stop.recording["time"].size, own(stop.recording)
        saved = f"the {ticks} ticks so far are in {part.save(file)}" if ticks else "nothing was saved"
        if isinstance(stop.__cause__, KeyboardInterrupt):
            common.complain(saved)
            raise click.Abort from None
        raise click.ClickException(f"{stop.__cause__}; {saved}") from stop
    recording.save(file)
    return recording


def finish(
    recording: truestroke.Recording, page_file: Path, plots: Path | None, as_json: bool, recording_file: Path
) -> int:
    """Page and pictures to disk, verdict, table and paths to the terminal; the exit code."""
    from truestroke.signals import judgement

    verdict, ticks = judgement.judge(recording), len(recording["time"])
    code = ExitCode.of(verdict)
    if ticks < SHORTEST and not verdict.is_bad:
        raise click.ClickException(f"{recording_file}: {ticks} ticks, a page needs at least {SHORTEST}")
    parts = {name: recording.axis(name) for name in recording.axes} or {"": recording}
    found = {name: summary(part, SHORTEST) for name, part in parts.items()}
    if None in found.values():  # without measurements there are no metrics, and nothing to plot
        _tell_alone(verdict, as_json, recording_file)
        return code
    with common.progress("plotting"):
        from truestroke.report import run_page

        try:
            pictures = common.save_page(run_page(recording), page_file, plots)
        except KeyboardInterrupt:
            common.complain(f"the recording is in {recording_file}; its page: truestroke report {recording_file}")
            raise
    if as_json:
        files = {"recording": str(recording_file), "page": str(page_file), "pictures": pictures}
        each = {name: one.as_dict() for name, one in found.items() if one is not None}
        common.print_json({**verdict.as_dict(), **(each.get("") or {"axes": each}), **files})
        return code
    for name, one in found.items():
        if one is not None:
            if name:
                click.echo(f"axis {name}")
            print_metrics(one, judgement.judge(parts[name]))
    common.print_files(recording=recording_file, page=page_file, pictures=plots)
    if not verdict.is_bad and "realtime" not in recording.metadata:  # what comes next is of the simulated stack
        common.suggest(*_next(recording))
    return code


def summary(recording: truestroke.Recording, least: int) -> TrackingSummary | None:
    """The metrics, if it has so many ticks and something to take them of."""
    from truestroke.signals import judgement

    try:
        return judgement.summary(recording) if len(recording["time"]) >= least else None
    except SettingError:
        return None


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
        [name, *(text for um, share in cells for text in (Text.assemble((um, "bold"), " um"), share))]
        for name, cells in words.table(summary)
    ]
    common.print_table(columns, rows, dim="of p-p")
    common.print_verdict(verdict)
    for name, text in words.course(summary):
        click.echo(f"{name:10} {text}")
    flags = ("\n" + " " * 11).join(words.flags(summary)) or "none"
    click.echo(f"flags      {flags}\n")


def _next(recording: truestroke.Recording) -> list[tuple[str, str]]:
    """Commands worth typing after this one."""
    from truestroke.signals.judgement import change_time

    first = ("track --change-at 10", "the actuator changes suddenly")
    if change_time(recording) is not None:
        first = ("track --change-at 10 --controller paper", "the same with the paper's controller")
    others = ("compare", "eight controllers on the same actuator"), ("reproduce", "the paper's figures beside ours")
    return [first, *others]
