"""The record that commands take: how it is named, and how it is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.identification import Record


def record_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """RECORD and the options that say how it is read, as `read` takes them."""
    for option in reversed(
        [
            click.argument("record", type=common.FILE),
            click.option("--volts", metavar="COLUMN", help="Column of the voltage: its name, or its number from 1."),
            click.option("--displacement", metavar="COLUMN", help="Column of the displacement."),
            click.option("--time", metavar="COLUMN", help="Column of the time stamps."),
            click.option("--volts-unit", metavar="UNIT", help="V, mV, uV or kV.  [default: as the file says, else V]"),
            click.option(
                "--displacement-unit", metavar="UNIT", help="um, nm, mm or m.  [default: as the file says, else um]"
            ),
            click.option(
                "--time-unit", metavar="UNIT", help="s, ms, us, ns or min.  [default: as the file says, else s]"
            ),
            click.option(
                "--displacement-scale",
                metavar="UM",
                type=float,
                help="um for one of the column, such as um/V of a sensor in V.",
            ),
            click.option("--sample-rate", metavar="HZ", type=float, help="Where there is no column of time stamps."),
            click.option("--flip-displacement", is_flag=True, help="Turn its sign: it falls as the voltage rises."),
            click.option("--drop-bad-rows", is_flag=True, help="Leave out rows without usable numbers or time stamps."),
        ]
    ):
        command = option(command)
    return command


def read(record: Path, **options: Any) -> Record:
    """The record that `record_options` name."""
    from truestroke.identification import read_record

    return read_record(record, **options)
