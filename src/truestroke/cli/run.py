"""`truestroke run`: the loop in real time, on hardware or on a simulated stack."""

from pathlib import Path

import click

from truestroke.cli import realtime


@click.command()
@realtime.realtime_options
def run(config: Path | None, example: bool, output: Path | None, overwrite: bool, live: bool, as_json: bool) -> int:
    """Close the loop in real time, on hardware or on a simulated stack.

    Ctrl-C ends it softly, a second Ctrl-C at once; the output stays at the safe voltage. docs/run.md has the
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
    if not live and any(isinstance(axis.trajectory, SetPoint) for axis in job.axes):
        raise click.UsageError("a set-point is moved by others: --live, or truestroke serve --epics.")
    command = "run --live" if live else "run"
    return realtime.close_the_loop(command, config, job, output, overwrite, as_json, job.live if live else None)
