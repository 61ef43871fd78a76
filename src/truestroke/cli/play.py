"""`truestroke play`: play a waveform on hardware and record what it does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.base import files
from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.base.typing import FloatArray
    from truestroke.runtime.drivers import Recorded

FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
HEADER = "time (s),volts (V),z (um)"


@click.command()
@click.argument("waveform", type=FILE)
@click.option("--config", type=FILE, metavar="FILE", required=True, help="Driver and one axis with its limits: TOML.")
@click.option("--output", metavar="FILE", default="record.csv", help="Record, CSV.")
@click.option("--rest", metavar="S", type=click.FloatRange(0.0), default=0.5, help="Rest under the first voltage.")
@common.overwrite_option
@common.json_option
def play(waveform: Path, config: Path, output: str, rest: float, as_json: bool) -> None:
    """Play a waveform on hardware and record what it does.

    WAVEFORM has columns `time` (s) and `volts` (V), as `truestroke invert` writes them. The output goes from the safe
    voltage to the first voltage and back from the last one, within the slew limit, and to the safe voltage whenever
    anything fails. `truestroke identify` and `truestroke refine` read the record.
    """
    import numpy as np

    from truestroke.runtime.drivers import DriverError, playback
    from truestroke.runtime.realtime import config as configuration

    target = Path(output)
    if target.suffix != ".csv" or not target.parent.is_dir():
        raise click.UsageError(f"--output {output}: is a file .csv in a folder that is there.")
    files.check(target, files.MEASUREMENT)
    volts, rate = _waveform(waveform)
    driver, axis = configuration.one_axis(config)
    try:
        made = playback(driver, volts, rate, **axis.limits, rest=rest)
    except DriverError as error:
        raise click.ClickException(str(error)) from None
    x, z = made.volts[0], made.displacement[0]
    rows = np.column_stack([np.arange(x.size) / rate, x, z])
    with files.writing(target, files.MEASUREMENT) as draft:
        np.savetxt(draft, rows, fmt="%.9g", delimiter=",", header=HEADER, comments="")
    if as_json:
        common.print_json({**_figures(made), "record": str(target)})
        return
    click.echo(f"played     {x.size} samples at {rate:g} Hz, {x.min():.4g} to {x.max():.4g} V")
    click.echo(f"measured   {np.nanmin(z):.4g} to {np.nanmax(z):.4g} um; {np.isnan(z).sum()} samples lost")
    common.print_files(record=target)


def _figures(made: Recorded) -> dict[str, Any]:
    import numpy as np

    x, z = made.volts[0], made.displacement[0]
    return {
        "samples": x.size,
        "lost": int(np.isnan(z).sum()),
        "sample_rate_Hz": made.sample_rate,
        "voltage_V": [float(x.min()), float(x.max())],
        "displacement_um": [float(np.nanmin(z)), float(np.nanmax(z))],
    }


def _waveform(path: Path) -> tuple[FloatArray, float]:
    """Voltages, V, and their sample rate, Hz."""
    import numpy as np

    from truestroke.signals.tables import RecordError, open_table

    table = open_table(path)
    names = [name.lower() for name in table.names]
    if not {"time", "volts"} <= set(names):
        raise RecordError(str(path), "has no columns time (s) and volts (V)")
    time, volts = table.read([names.index("time"), names.index("volts")], False)
    steps = np.diff(time)
    if steps.size == 0 or not (steps > 0).all() or np.ptp(steps) > 1e-3 * steps.mean():
        raise click.ClickException(f"{path}: time does not ascend in even steps")
    return volts, float(f"{1 / steps.mean():.9g}")
