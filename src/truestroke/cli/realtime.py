"""The loop in real time, by the commands that close it: `run`, and `serve`, which publishes it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

import truestroke
from truestroke.base import checks, frames, system, toml
from truestroke.base.exit_codes import ExitCode
from truestroke.base.files import beside
from truestroke.base.verdict import Verdict
from truestroke.cli import common, results

if TYPE_CHECKING:
    from truestroke.runtime.realtime import Outcome
    from truestroke.runtime.realtime.config import Job
    from truestroke.runtime.realtime.server import Server


live_option = click.option(
    "--live", is_flag=True, help="Serve a page that shows the run, with STOP; its address is printed."
)
axis_option = click.option(
    "--axis",
    metavar="NAME",
    help="Which one moves, where FILE has several: the others are set to their safe voltages at once, and held there.",
)


def check_axis(config: Path | None, axis: str | None) -> None:
    """An axis is one of a configuration."""
    if axis is not None and config is None:
        raise click.UsageError(f"--axis {axis}: names an axis of a configuration; it needs --config.")


realtime_options = common.options(
    click.option("--config", type=common.FILE, metavar="FILE", help="Driver, axes, limits: TOML."),
    click.option("--example", is_flag=True, help="Print a configuration with comments, of a simulated stack."),
    click.option("--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
                 help="Recording, in place of the one the configuration names; .h5 is added to a name without ending."),
    click.option("--overwrite", is_flag=True, help="Replace a recording that is there."),
    live_option,
    common.json_option,
)  # fmt: skip


@dataclass(frozen=True)
class Closed:
    """A run that has ended: recordings and verdicts by the name of the axis."""

    outcome: Outcome
    recordings: Mapping[str, truestroke.Recording]
    verdicts: Mapping[str, Verdict]


def close_the_loop(
    command: str,
    config: Path,
    job: Job,
    output: Path | None,
    overwrite: bool,
    as_json: bool,
    server: Server | None = None,
) -> int:
    """Run the configuration, and print the result; the exit code."""
    from truestroke.signals import judgement

    done = follow(command, config, job, output, overwrite, as_json, server)
    code = code_of(done.outcome, judgement.worst(done.verdicts))
    if as_json:
        common.print_json(as_dict(done, code))
    else:
        print_run(done)
    if done.outcome.reason:
        common.complain(done.outcome.reason)
    return code


def follow(
    command: str,
    config: Path,
    job: Job,
    output: Path | None,
    overwrite: bool,
    as_json: bool,
    server: Server | None = None,
) -> Closed:
    """Run the configuration; what was recorded.

    Raises
    ------
    DriverError
        The hardware could not begin.
    """
    from truestroke.runtime.realtime import run_realtime
    from truestroke.runtime.realtime.runner import recordings as names_of
    from truestroke.signals import judgement

    show: Literal["live", "lines"] | None = None if as_json else "live" if sys.stderr.isatty() else "lines"
    called = system.command_line("truestroke", *command.split(), "--config", config)
    about = {"command": called, "config": toml.source(config)}
    options: dict[str, Any] = {"settings": job.settings, "about": about, "overwrite": overwrite, "show": show}
    file = job.file if output is None else output if output.suffix else output.with_suffix(".h5")
    with checks.inside("", {"file": "--output"}):
        paths = names_of(file, job.axes, overwrite)
    for path in paths:
        if path.resolve() == config.resolve():
            raise click.UsageError(f"{path}: the recording would replace the configuration; call it run.h5.")

    def begins() -> None:
        for path in paths:
            if path.exists():
                common.complain(
                    f"recording to {beside(path)} until the run has ended; {path} stays as it is until then"
                )
        if job.frame is not None and not as_json and (turned := frames.described(job.frame)):
            common.print_text(turned, err=True)
        common.foretell("the run takes", job.axes[0].trajectory.duration, as_json)

    outcome = run_realtime(job.driver, job.axes, file, server=server, begins=begins, **options)
    recordings = {
        axis.name: truestroke.Recording.load(path) for axis, path in zip(job.axes, outcome.files, strict=True)
    }
    if not outcome.ticks:  # of a run that did not begin nothing stays: its files would only be in the way of the next
        for left in outcome.files:
            left.unlink(missing_ok=True)
    return Closed(outcome, recordings, {name: judgement.judge(recording) for name, recording in recordings.items()})


def code_of(outcome: Outcome, verdict: Verdict) -> int:
    """Its own, where the run ended for another cause than that it was over; 4 where that was in vain."""
    code: int = outcome.cause.value
    return ExitCode.NOT_TRACKING if code == ExitCode.OK and verdict.is_bad else code


def _lateness(recording: truestroke.Recording) -> dict[str, float]:
    import numpy as np

    late = recording["lateness"]
    return {f"p{p:g}": float(np.percentile(late, p)) for p in (50, 99, 99.9)} if late.size else {}


def as_dict(done: Closed, code: int) -> dict[str, Any]:
    """A run that has ended, for JSON."""
    from truestroke.signals import judgement

    outcome, recordings, verdicts = done.outcome, done.recordings, done.verdicts
    axes: dict[str, Any] = {}
    for (name, recording), file in zip(recordings.items(), outcome.files, strict=True):
        summary = results.summary(recording, 2)
        kept = str(file) if outcome.ticks else None
        axes[name] = {"recording": kept, **verdicts[name].as_dict(), **(summary.as_dict() if summary else {})}
    late = {**_lateness(next(iter(recordings.values()))), "worst": outcome.worst_us}
    counts = {name: getattr(outcome, name) for name in ("ticks", "all_ticks", "overruns", "missed", "limited", "lost")}
    ended = {"cause": outcome.cause.name.lower(), "exit_code": code, "reason": outcome.reason}
    return {**judgement.worst(verdicts).as_dict(), **ended, **counts, "lateness_us": late, "axes": axes}


def print_run(done: Closed) -> None:
    """Errors and verdict of each axis, punctuality, files."""
    from truestroke.report import words

    outcome, recordings, verdicts = done.outcome, done.recordings, done.verdicts
    for name, recording in recordings.items():
        if len(recordings) > 1:
            click.echo(f"axis {name}")
        if summary := results.summary(recording, 2):
            results.print_metrics(summary, verdicts[name])
        else:  # where it ended before the first tick, stderr has the reason
            common.print_verdict(verdicts[name], reasons=outcome.ticks > 0)
        if subtracted := words.zero_of(recording):
            click.echo(f"{'zero':10} {subtracted:.4g} um of the sensor are subtracted (zero = 0.0 keeps its own)")
    late = ", ".join(f"{name} {us:.1f} us" for name, us in _lateness(next(iter(recordings.values()))).items())
    click.echo(f"{'ticks':10} {outcome.ticks} of {outcome.all_ticks}; {outcome.lost} samples lost")
    click.echo(f"{'late':10} {late or 'nothing'}; worst {outcome.worst_us:.1f} us; {outcome.overruns} overruns")
    if outcome.limited:
        click.echo(
            f"{'guard':10} kept {outcome.limited} voltages within limits and slew that the controller did not keep"
        )
    for file in outcome.files if outcome.ticks else ():
        common.print_files(recording=file)
    if outcome.ticks >= results.SHORTEST:
        click.echo(f"\nIts page: {common.program()} {system.command_line('report', outcome.files[0])}")
