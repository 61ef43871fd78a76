"""The command `truestroke`: arguments in, tables and paths out. Commands import what they need when they are called."""

from __future__ import annotations

import click

import truestroke
from truestroke.cli import (
    characterise,
    commission,
    compare,
    doctor,
    examine,
    identify,
    invert,
    playback,
    refine,
    report,
    reproduce,
    run,
    serve,
    study,
    track,
    zoo,
)
from truestroke.cli.common import Commands

__all__ = ["main"]


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(truestroke.__version__, "-V", "--version", message="truestroke %(version)s")
def main() -> None:
    """Make a piezo actuator go exactly where it is told.

    Begin with `truestroke track`: it needs no arguments and no hardware.
    """


for _command in (
    track.track,
    commission.commission,
    run.run,
    serve.serve,
    doctor.doctor,
    report.report,
    compare.compare,
    reproduce.reproduce,
    zoo.zoo,
    study.study,
    examine.examine,
    identify.identify,
    invert.invert,
    playback.playback,
    refine.refine,
    characterise.characterise,
):
    main.add_command(_command)
