"""`truestroke examine`: what a record of voltage and displacement holds."""

from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.cli import common


@click.command()
@common.record_options
@common.json_option
def examine(record: Path, as_json: bool, **options: Any) -> None:
    """Examine a record of voltage and displacement.

    Reads CSV and other text with columns, NPZ, MATLAB, Parquet, HDF5. Prints sample rate, stroke, delay, noise, rates;
    lists what the record cannot identify. A record that cannot be used is refused with its row and the reason.
    """
    found = truestroke.examine(truestroke.read_record(record, **options))
    if as_json:
        common.print_json(found.as_dict())
        return
    common.print_table(("found", str(record)), found.table(), left=str(record))
    for warning in found.warnings:
        common.print_text(f"- {warning}")
