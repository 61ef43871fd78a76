"""`truestroke playback`: a waveform put out by hardware, and what it does, recorded."""

from pathlib import Path

import click

import truestroke
from truestroke.base import checks, files
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, realtime, waveforms


@click.command()
@click.argument("waveform", type=common.FILE)
@click.option(
    "--config", type=common.FILE, metavar="FILE", required=True, help="Driver and axes with their limits: TOML."
)
@realtime.axis_option
@click.option("--output", metavar="FILE", default="record.csv", help="Record, CSV.")
@waveforms.rest_option
@click.option("--force", is_flag=True, help="Output a waveform whose verdict is bad.")
@common.overwrite_option
@common.json_option
def playback(
    waveform: Path, config: Path, axis: str | None, output: str, rest: float, force: bool, as_json: bool
) -> int:
    """Output a waveform on hardware and record the motion.

    WAVEFORM has columns `time` (s) and `volts` (V), as `truestroke invert` writes them. One whose verdict is bad is
    refused, with exit code 4. The output goes from the safe voltage to the first voltage and back from the last one,
    within the slew limit, and to the safe voltage at any fault. `truestroke identify` and `truestroke refine` read the
    record.
    """
    from truestroke.identification.waveform import verdict_of
    from truestroke.runtime.drivers.playback import read_waveform, save_record
    from truestroke.runtime.realtime import config as configuration

    if Path(output).suffix != ".csv":
        raise click.UsageError(f"--output {output}: is a file .csv.")
    target = common.to_write("--output", output, files.MEASUREMENT)
    volts, rate = read_waveform(waveform)
    verdict = verdict_of(waveform)
    if verdict.is_bad and not force:
        reasons = " ".join(verdict.reasons)
        remedy = "Make it anew with `truestroke invert`, or output it with --force."
        return common.complain(
            f"{waveform}: the verdict of this waveform is bad: {reasons} {remedy}", ExitCode.of(verdict)
        )
    driver, table = configuration.one_axis(config, axis)
    common.foretell("the waveform takes", rest + volts.size / rate, as_json)
    with checks.inside(f"{waveform}: "):
        made = truestroke.playback(driver, volts, rate, **table.limits, rest=rest)
    save_record(target, made)
    found = made.as_dict()
    if as_json:
        common.print_json({**found, "waveform": verdict.as_dict(), "record": str(target)})
        return ExitCode.OK
    (low, high), (lowest, highest) = found["voltage_V"], found["displacement_um"]
    click.echo(f"output     {found['samples']} samples at {rate:g} Hz, {low:.4g} to {high:.4g} V")
    click.echo(f"measured   {lowest:.4g} to {highest:.4g} um; {found['lost']} samples lost")
    if verdict.level != "good":
        click.echo("of the waveform, which its file has:")
        common.print_verdict(verdict)
    common.print_files(record=target)
    return ExitCode.OK
