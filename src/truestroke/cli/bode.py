"""`truestroke bode`: the dynamics of a stage, measured in two seconds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke.base import checks, files
from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import common, realtime

if TYPE_CHECKING:
    from truestroke.identification.dynamics import Bode

SENSOR = "sensor_delay", "sensor_bandwidth"
DEMO = {"voltage_limits": (-0.6, 3.6), "slew_limit": 504.0, "safe_voltage": 0.0}


@click.command()
@click.option("--config", metavar="FILE", type=common.FILE, help="Driver and axes with their limits: TOML, as of "
              "truestroke run.  [default: a simulated stage]")  # fmt: skip
@realtime.axis_option
@click.option("--amplitude", metavar="V", type=float, help="Peak of the excitation.  [default: 1 to 3 % of the "
              "voltage range, by the noise]")  # fmt: skip
@click.option("--band", metavar="A B", nargs=2, type=float, help="Frequencies that are excited, Hz.  [default: from 8 "
              "periods in the duration to 0.45 of the sample rate, at most 8 kHz or 0.3 of it]")  # fmt: skip
@click.option(
    "--bias", metavar="V", type=float, help="Voltage of the measurement.  [default: the middle of the limits]"
)
@click.option("--duration", metavar="S", type=float, default=2.0, help="Of the excitation.")
@click.option("--travel", metavar="UM", type=float, help="How far the stage may go from where it is under the bias: "
              "beyond, it stops.  [default: a quarter of its range]")  # fmt: skip
@click.option("--modes", metavar="N", type=click.IntRange(1, 3), help="[default: as many as the record shows]")
@click.option("--sensor-delay", metavar="S", type=float, help="Of the sensor, from its data sheet.  [default: as in "
              "the settings of the axis, else 0]")  # fmt: skip
@click.option("--sensor-bandwidth", metavar="HZ", type=float, help="The same; 0 is not known.")
@click.option("--amplifier-bandwidth", metavar="HZ", type=float, default=0.0, help="Of the amplifier, from its data "
              "sheet, where the measurement cannot show it; 0 is not known.")  # fmt: skip
@click.option("--output", metavar="NAME", default="dynamics", help="Write NAME.toml and NAME.html.")
@common.page_options
def bode(config: Path | None, axis: str | None, output: str, plots: Path | None, as_json: bool, **options: Any) -> int:
    """Measure the dynamics of a stage: modes, damping, lag of the amplifier, dead time.

    A multisine of 1 to 3 % of the voltage range about the middle of the limits, for two seconds, after a slow ramp.
    Writes dynamics.toml, for the controller, and a page with the Bode plot. The output ends at the safe voltage.
    """
    realtime.check_axis(config, axis)
    name = output.removesuffix(".toml")
    (page_file,) = common.outputs(name, ".html")
    model_file = common.to_write("--output", page_file.with_suffix(".toml"), files.DYNAMICS)
    common.foretell("the excitation takes", options["duration"], as_json)
    try:
        named = {} if config is None else {"slew_limit": f"{config}: slew of the axis"}
        with _actuator(config, axis) as (actuator, limits), checks.inside("", named):
            found = _measured(actuator, limits, options, as_json)
    except truestroke.DynamicsError as error:
        return _failed(str(error), model_file, as_json)
    code = _reported(found, limits, model_file, page_file, plots, as_json)
    if not as_json:
        common.print_simulated(config)
    return code


@contextmanager
def _actuator(config: Path | None, axis: str | None) -> Iterator[tuple[truestroke.Actuator, dict[str, Any]]]:
    """What is driven, with its limits; an axis of hardware is at the safe voltage afterwards."""
    from truestroke.runtime.drivers import OneAxis
    from truestroke.runtime.realtime import config as configuration

    if config is None:
        from truestroke.plant import StagePlant

        yield StagePlant(), DEMO
        return
    driver, table = configuration.one_axis(config, axis)
    with OneAxis(driver, **table.limits) as driven:
        limits = {"voltage_limits": table.voltage_limits, "slew_limit": table.slew, "safe_voltage": table.safe_voltage}
        sensor = {name: table.settings[name] for name in SENSOR if name in table.settings}
        yield driven, limits | sensor


def _measured(actuator: truestroke.Actuator, limits: dict[str, Any], options: dict[str, Any], as_json: bool) -> Bode:
    given = {name: value for name, value in options.items() if value is not None or name not in SENSOR}
    return truestroke.measure_bode(actuator, **{**limits, **given}, report=common.activity(as_json))


def _nothing_written(file: Path) -> None:
    """A line for a bad verdict; dynamics of an older measurement may be there."""
    before = f"; {file} is of an older measurement" if file.exists() else ""
    common.print_text(f"written    no dynamics, as the verdict is bad{before}")


def _failed(reason: str, model_file: Path, as_json: bool) -> int:
    verdict = Verdict("bad", (common.in_words_of(click.get_current_context().command, reason),))
    if as_json:
        common.print_json({**verdict.as_dict(), "exit_code": int(ExitCode.CHECK)})
    else:
        common.print_verdict(verdict)
        _nothing_written(model_file)
    return ExitCode.CHECK


def _reported(
    found: Bode, limits: dict[str, Any], model_file: Path, page_file: Path, plots: Path | None, as_json: bool
) -> int:
    """File, page and lines; the exit code. Dynamics that are not to be used are not written."""
    from truestroke.report import dynamics

    used = None if found.verdict.is_bad else model_file
    if used is not None:
        found.dynamics.save(used)
    bounds = limits["voltage_limits"], limits["slew_limit"]
    made = dynamics.page(found, *bounds, common.to_repeat())
    pictures = common.save_page(made, page_file, plots)
    code = ExitCode.of(found.verdict)
    if as_json:
        written = {"file": used and str(used), "page": str(page_file), "pictures": pictures}
        common.print_json({**found.verdict.as_dict(), **dynamics.as_dict(found), **written})
        return code
    for name, value, beside in dynamics.rows(found, *bounds):
        click.echo(f"{name:10} {value:22} {beside}")
    common.print_verdict(found.verdict)
    if used is None:
        _nothing_written(model_file)
    common.print_files(written=used, page=page_file, pictures=plots)
    return code
