"""`truestroke replay`: a run that was recorded, on the live page."""

from pathlib import Path

import click

import truestroke
from truestroke.cli import common


@click.command()
@click.argument("recordings", metavar="RECORDING...", type=common.FILE, nargs=-1, required=True)
@click.option(
    "--speed",
    metavar="FACTOR",
    type=float,
    default=1.0,
    help="Times that of the run, 0.01 to 100; the page can change it.",
)
@click.option(
    "--port", metavar="N", type=int, default=8765, help="Of the page, on this computer; 0 for any that is free."
)
@click.option("--window", metavar="S", type=float, default=2.0, help="How much of the run is shown, s, up to 4.")
def replay(recordings: tuple[Path, ...], speed: float, port: int, window: float) -> None:
    """Show a run again on the live page, from its recording.

    Of a run of several axes each has a file: name all of them. The address of the page is printed. It pauses at the
    end; Play shows the run again, a slider goes to another time, End or Ctrl-C ends it.
    """
    from truestroke.runtime.realtime import LiveSettings
    from truestroke.runtime.realtime.replay import replay as show

    settings = LiveSettings(port=port, window=window)
    show(_by_axis(recordings), settings, speed=speed)


def _by_axis(files: tuple[Path, ...]) -> dict[str, truestroke.Recording]:
    """Each axis by its name, and where two have the same one, by the file."""
    found: dict[str, truestroke.Recording] = {}
    for file in files:
        whole = truestroke.Recording.load(file)
        for one in [whole.axis(name) for name in whole.axes] or [whole]:
            name = (one.metadata.get("axis") or {}).get("name", "axis")
            found[name if name not in found else f"{file.stem} {name}"] = one
    return found
