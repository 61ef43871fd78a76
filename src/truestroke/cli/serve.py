"""`truestroke serve`: the loop in real time, published to a control system that may also move it."""

from pathlib import Path

import click

from truestroke.cli import realtime


@click.command()
@click.option("--epics", is_flag=True, help="As process variables of a soft IOC.")
@realtime.realtime_options
def serve(
    epics: bool, config: Path | None, example: bool, output: Path | None, overwrite: bool, live: bool, as_json: bool
) -> int:
    """Close the loop in real time and serve it: set-points and supervision, not single samples.

    The server has a process of its own; its end does not affect the loop. docs/epics.md lists what is published.
    """
    from truestroke.runtime.realtime import config as configuration

    if example:
        click.echo(configuration.example("serve"), nl=False)
        return 0
    if epics is live:
        raise click.UsageError("--epics or --live is needed, and not both.")
    if config is None:
        raise click.UsageError("--config FILE is needed; --example prints one to begin with.")
    job = configuration.load(config)
    if epics and job.epics is None:
        raise click.UsageError(f"{config}: a table [epics] is needed; --example shows one.")
    command, server = ("serve --epics", job.epics) if epics else ("serve --live", job.live)
    return realtime.close_the_loop(command, config, job, output, overwrite, as_json, server)
