"""`truestroke report`: table and page of a recording."""

from __future__ import annotations

from pathlib import Path

import click

from truestroke.cli import common, results


@click.command()
@click.argument("recording", type=common.FILE)
@click.option("--output", metavar="NAME", help="Write NAME.html.  [default: as RECORDING]")
@common.plots_option
@common.overwrite_option
@common.json_option
def report(recording: Path, output: str | None, plots: Path | None, as_json: bool) -> int:
    """Make the table and the page of a recording again."""
    from truestroke.signals.recording import Recording

    (page_file,) = common.outputs(output or str(recording), ".html")
    return results.finish(Recording.load(recording), page_file, plots, as_json, recording)
