"""`truestroke characterise`: how the weights of an actuator depend on velocity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

import truestroke
from truestroke.base import system
from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import common, realtime, results


@click.command()
@click.option("--plant", type=click.Choice(["realistic", "matched"]), default="realistic", help="What is driven: "
              "like a real stack, or of exactly the controller's structure.")  # fmt: skip
@click.option("--config", metavar="FILE", type=common.FILE,
              help="Drive the hardware of this configuration of `truestroke run`, within its limits.")  # fmt: skip
@realtime.axis_option
@click.option("--record", metavar="FILE", type=common.FILE,
              help="Drive nothing: take the recording of an earlier run, whole or interrupted.")  # fmt: skip
@click.option("--speeds", metavar="UM/S,...", default="50,100,150,200,250,300", help="Of the triangles.")
@click.option("--stroke", metavar="UM", type=float, default=38.0, help="Of the triangles, from 0 um.")
@click.option(
    "--voltage-limits", metavar="A B", nargs=2, type=float, default=(-0.6, 3.6), help="V at the D/A converter."
)
@click.option("--slew-limit", metavar="V/S", type=float, help="Fastest change of the voltage.  [default: 120 times the "
              "voltage range]")  # fmt: skip
@click.option("--sample-rate", metavar="HZ", type=float, default=2000.0, help="Ticks per second: those of the driver.")
@click.option("--duration", metavar="S", type=float, default=8.0, help="At each speed; five cycles at least.")
@click.option("--plays", metavar="N", type=click.IntRange(1, 32), default=8, help="Their thresholds are spread over "
              "the voltages that the motion takes.")  # fmt: skip
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the sensor noise.")
@click.option("--output", metavar="NAME", default="truestroke-characterise", help="Write NAME.toml, NAME.h5 and "
              "NAME.html.")  # fmt: skip
@common.page_options
def characterise(record: Path | None, output: str, plots: Path | None, as_json: bool, **options: Any) -> int:
    """Measure how the weights of an actuator depend on velocity.

    Triangles at several speeds (Sec. 2.4), and for each play a line of its weight against velocity (Fig. 4). Writes a
    model file, the recording and a page of pictures.
    """
    realtime.check_axis(options["config"], options["axis"])
    model_file, recording_file, page_file = common.outputs(output.removesuffix(".toml"), ".toml", ".h5", ".html")
    from truestroke.studies.characterisation import fit_lines

    recording = truestroke.Recording.load(record) if record else _drive(options, recording_file)
    try:
        found = fit_lines(recording, plays=options["plays"])
    except truestroke.NotConverged as error:
        raise click.ClickException(f"{error}; the recording is in {record or recording_file}") from None
    truestroke.save_model(model_file, found.actuator_model)
    with common.progress("plotting"):
        from truestroke.studies.characterisation import page

        verdict = page.judged(found)
        made = page.page(found, common.to_repeat())
        pictures = common.save_page(made, page_file, plots)
    code = ExitCode.of(verdict)
    if as_json:
        files = {"model": str(model_file), "recording": str(record or recording_file), "page": str(page_file)}
        common.print_json({**verdict.as_dict(), **found.as_dict(), **files, "pictures": pictures})
        return code
    _print(found, verdict)
    common.print_files(model=model_file, recording=record or recording_file, page=page_file, pictures=plots)
    common.print_simulated(options["config"] or record, "stack")
    common.suggest(
        (system.command_line("identify", record or recording_file), "creep and asymmetry, too, from the same recording")
    )
    return code


def _drive(options: Mapping[str, Any], recording_file: Path) -> truestroke.Recording:
    """The run; what there is of it is saved if it is interrupted."""
    from truestroke.studies.characterisation.procedure import drive, sweep

    motion = {name: options[name] for name in ("stroke", "duration", "sample_rate")}
    wave = sweep(speeds=_speeds(options["speeds"]), **motion)

    def run(tell: results.Progress | None) -> truestroke.Recording:
        with _actuator(options, wave) as (actuator, limits):
            return drive(wave, actuator, **limits, progress=tell)

    return results.recorded("driving", run, recording_file)


def _speeds(words: str) -> list[float]:
    """Numbers between commas."""
    try:
        return [float(word) for word in words.split(",")]
    except ValueError:
        raise click.UsageError(f"--speeds {words}: is not numbers with commas, such as 50,100,200.") from None


@contextmanager
def _actuator(
    options: Mapping[str, Any], wave: truestroke.Trajectory
) -> Iterator[tuple[truestroke.Actuator, dict[str, Any]]]:
    """What is driven, and the limits of voltage and slew; an axis of hardware is at the safe voltage afterwards."""
    from truestroke.runtime.drivers import OneAxis
    from truestroke.runtime.realtime import config
    from truestroke.studies import tracking

    if not options["config"]:
        limits = {name: options[name] for name in ("voltage_limits", "slew_limit")}
        yield tracking.plant(options["plant"], wave, options["seed"]), limits
        return
    for name in ("plant", "voltage_limits", "slew_limit", "seed"):
        if click.get_current_context().get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(f"--{name.replace('_', '-')}: means nothing with --config; the file has it.")
    driver, table = config.one_axis(options["config"], options["axis"])
    with OneAxis(driver, **table.limits) as axis:
        yield axis, {"voltage_limits": table.voltage_limits, "slew_limit": table.slew}


def _print(found: truestroke.Characterisation, verdict: Verdict) -> None:
    from truestroke.studies.characterisation import page

    common.print_table(*page.play_table(found))
    common.print_table(*page.speed_table(found))
    common.print_verdict(verdict)
    for sentence in page.verdict(found):
        common.print_text(f"- {sentence}")
    click.echo()
