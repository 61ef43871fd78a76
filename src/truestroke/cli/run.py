"""`truestroke run`: the loop in real time, on hardware or on a simulated stack."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common
from truestroke.cli.report import SHORTEST, print_figures

if TYPE_CHECKING:
    from truestroke.base.verdict import Verdict
    from truestroke.runtime.realtime import Outcome
    from truestroke.runtime.realtime.config import Job
    from truestroke.signals.metrics import TrackingSummary
    from truestroke.signals.recording import Recording


@click.command()
@click.option("--config", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
              help="Driver, axes, limits: TOML.")  # fmt: skip
@click.option("--example", is_flag=True, help="Print a configuration with comments, of a simulated stack.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="Recording, in place of the one that the configuration names.")  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace a recording that is there.")
@common.json_option
def run(config: Path | None, example: bool, output: Path | None, overwrite: bool, as_json: bool) -> int:
    """Close the loop in real time, on hardware or on a simulated stack.

    Ctrl-C ends it softly, a second Ctrl-C at once; the output is left at the safe voltage. docs/run.md has the
    exit codes.
    """
    from truestroke.runtime.realtime import SetPoint
    from truestroke.runtime.realtime import config as configuration

    if example:
        click.echo(configuration.example(), nl=False)
        return 0
    if config is None:
        raise click.UsageError("--config FILE is needed; --example prints one to begin with.")
    job = configuration.load(config)
    if any(isinstance(axis.trajectory, SetPoint) for axis in job.axes):
        raise click.UsageError("a set-point is moved by others: truestroke serve --epics.")
    return close_the_loop("run", config, job, output, overwrite, as_json)


def close_the_loop(
    command: str, config: Path, job: Job, output: Path | None, overwrite: bool, as_json: bool, epics: bool = False
) -> int:
    """Run what the configuration says, and print what became of it; the exit code."""
    from truestroke.base.files import beside
    from truestroke.runtime.drivers import DriverError
    from truestroke.runtime.realtime import Cause, RealtimeError, run_realtime
    from truestroke.runtime.realtime.runner import recordings as names_of
    from truestroke.signals import judgement
    from truestroke.signals.recording import Recording

    show: Literal["live", "lines"] | None = None if as_json else "live" if sys.stderr.isatty() else "lines"
    about = {"command": f"truestroke {command} --config {config}", "config": config.read_text(encoding="utf-8")}
    options: dict[str, Any] = {"settings": job.settings, "about": about, "overwrite": overwrite, "show": show}
    file = job.file if output is None else output
    for path in names_of(file, job.axes, overwrite):
        if path.exists():
            told = f"recording to {beside(path)} until the run has ended; {path} stays as it is until then"
            click.echo(f"truestroke: {told}", err=True)
    try:
        outcome = run_realtime(job.driver, job.axes, file, epics=job.epics if epics else None, **options)
    except RealtimeError as error:
        raise click.ClickException(str(error)) from None
    except DriverError as error:
        click.echo(f"truestroke: {' '.join(str(error).split())}", err=True)
        return Cause.DRIVER.value
    recordings = {axis.name: Recording.load(path) for axis, path in zip(job.axes, outcome.files, strict=True)}
    verdicts = {name: judgement.judge(recording) for name, recording in recordings.items()}
    code = _code(outcome, judgement.worst(verdicts))
    if as_json:
        _print_json(outcome, recordings, verdicts, code)
    else:
        _print(outcome, recordings, verdicts)
    if outcome.reason:
        click.echo(f"truestroke: {' '.join(outcome.reason.split())}", err=True)
    return code


def _code(outcome: Outcome, verdict: Verdict) -> int:
    """Its own, where the run ended for another cause than that it was over; 4 where that was in vain."""
    code: int = outcome.cause.value
    return ExitCode.NOT_TRACKING if code == ExitCode.OK and verdict.is_bad else code


def _summary(recording: Recording) -> TrackingSummary | None:
    """The figures, if there is anything to take them of."""
    from truestroke.base.checks import SettingError
    from truestroke.signals import judgement

    try:
        return judgement.summary(recording) if len(recording["time"]) > 1 else None
    except SettingError:
        return None


def _lateness(recording: Recording) -> dict[str, float]:
    import numpy as np

    late = recording["lateness"]
    return {f"p{p:g}": float(np.percentile(late, p)) for p in (50, 99, 99.9)} if late.size else {}


def _print_json(
    outcome: Outcome, recordings: Mapping[str, Recording], verdicts: Mapping[str, Verdict], code: int
) -> None:
    from truestroke.signals import judgement

    axes: dict[str, Any] = {}
    for (name, recording), file in zip(recordings.items(), outcome.files, strict=True):
        figures = _summary(recording)
        axes[name] = {"recording": str(file), **verdicts[name].as_dict(), **(figures.as_dict() if figures else {})}
    late = {**_lateness(next(iter(recordings.values()))), "worst": outcome.worst_us}
    counts = {name: getattr(outcome, name) for name in ("ticks", "all_ticks", "overruns", "missed", "limited", "lost")}
    ended = {"cause": outcome.cause.name.lower(), "exit_code": code, "reason": outcome.reason}
    common.print_json(
        {**judgement.worst(verdicts).as_dict(), **ended, **counts, "lateness_us": late, "axes": axes},
    )


def _print(outcome: Outcome, recordings: Mapping[str, Recording], verdicts: Mapping[str, Verdict]) -> None:
    for name, recording in recordings.items():
        if len(recordings) > 1:
            click.echo(f"axis {name}")
        if figures := _summary(recording):
            print_figures(figures, verdicts[name])
        else:
            common.print_verdict(verdicts[name])
    late = ", ".join(f"{name} {us:.1f} us" for name, us in _lateness(next(iter(recordings.values()))).items())
    click.echo(f"{'ticks':10} {outcome.ticks} of {outcome.all_ticks}; {outcome.lost} samples lost")
    click.echo(f"{'late':10} {late or 'nothing'}; worst {outcome.worst_us:.1f} us; {outcome.overruns} overruns")
    if outcome.limited:
        click.echo(
            f"{'guard':10} kept {outcome.limited} voltages within limits and slew that the controller did not keep"
        )
    for file in outcome.files:
        common.print_files(recording=file)
    if outcome.ticks >= SHORTEST:
        click.echo(f"\nIts page: {common.program()} report {outcome.files[0]}")
