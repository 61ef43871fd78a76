"""The command `truestroke`: arguments in, tables and paths out. Commands import what they need when they are called."""

from __future__ import annotations

import importlib

import click

import truestroke
from truestroke.cli.common import Commands

__all__ = ["main"]

COMMANDS = (
    *(
        "track",
        "scan",
        "commission",
        "bode",
        "run",
        "serve",
        "doctor",
        "report",
        "replay",
        "compare",
        "reproduce",
        "robustness",
        "study",
    ),
    *("examine", "identify", "score", "invert", "playback", "refine", "learn", "unwarp", "characterise", "export"),
)
"""In the order of the help; each is a function in the module of its name."""


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(truestroke.__version__, "-V", "--version", message="truestroke %(version)s")
def main() -> None:
    """Make a piezo actuator follow a desired motion exactly.

    Begin with `truestroke track`: it needs no arguments and no hardware.
    """


for _name in COMMANDS:
    main.add_command(getattr(importlib.import_module(f"truestroke.cli.{_name}"), _name))
