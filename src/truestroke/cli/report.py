"""`truestroke report`: table and page of a recording."""

from pathlib import Path

import click

import truestroke
from truestroke.cli import common, results


@click.command()
@click.argument("recording", type=common.FILE)
@click.option("--output", metavar="NAME", help="Write NAME.html.  [default: as RECORDING]")
@common.page_options
def report(recording: Path, output: str | None, plots: Path | None, as_json: bool) -> int:
    """Make the table and the page of a recording again."""
    (page_file,) = common.outputs(output or str(recording), ".html")
    return results.finish(truestroke.Recording.load(recording), page_file, plots, as_json, recording)
