"""Motions, waveforms and the models these are made with: options, files, and what is printed of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke.base import checks, display, files
from truestroke.base.exit_codes import ExitCode
from truestroke.cli import common, inputs
from truestroke.control import reach
from truestroke.control.settings import UNLIMITED
from truestroke.model.sampled import REST

if TYPE_CHECKING:
    from truestroke.control.repeating.iterative import Learned

# What each motion understands: option -> argument of its function.
SHARED = {"peak_to_peak": "peak_to_peak", "duration": "duration", "sample_rate": "sample_rate"}
MOTIONS = {
    "random": ("random_wave", {"frequency": "cutoff", "velocity_limit": "velocity_limit", "seed": "seed", **SHARED}),
    "sine": ("sine", {"frequency": "frequency", **SHARED}),
    "triangle": ("triangle", {"frequency": "frequency", **SHARED}),
    "raster": ("raster", {"frequency": "frequency", "turn": "turn", "settle": "turn", **SHARED}),
    "staircase": ("staircase", {"velocity_limit": "velocity_limit", **SHARED}),
    "step": ("step", {"velocity_limit": "velocity_limit", "settle": "settle", **SHARED}),
}
METAVAR = f"[{'|'.join(MOTIONS)}|FILE.csv|FILE.npz]"


def known_motion(context: click.Context, option: click.Parameter, value: str) -> str:
    """`value`, if it is one of `MOTIONS` or a file."""
    if value not in MOTIONS and Path(value).is_file():
        inputs.note(context, option, Path(value))
        return value
    if value in MOTIONS:
        return value
    raise click.BadParameter(f"{value!r} is neither one of {', '.join(MOTIONS)} nor a file.")


motion_options = common.options(
    click.option("--frequency", metavar="HZ", type=float, help="Of a sine, triangle or raster; a random wave "
                 "has its low pass there.  [default: 20 random, 12 sine, 4 triangle, raster]"),
    click.option("--peak-to-peak", metavar="UM", type=float, help="[default: 28.6, sine, triangle, raster 22.8, "
                 "step 5]"),
    click.option("--velocity-limit", metavar="UM/S", type=float, help="The fastest that a random wave, a "
                 "staircase or a step with --settle may be.  [default: none, staircase 300]"),
    click.option("--turn", metavar="SHARE", type=click.FloatRange(0.01, 0.99), help="Of the period of a raster that "
                 "its turns take.  [default: 0.2]"),
    click.option("--settle", metavar="FILE", type=common.FILE, help="Dynamics of the stage, of `truestroke bode`: a "
                 "step settles, and a raster turns, without ringing."),
    click.option("--duration", metavar="S", type=click.FloatRange(min=0.5), help="[default: 20]"),
    click.option("--sample-rate", metavar="HZ", type=float,
                 help="Ticks per second.  [default: 2000, or that of the file]"),
)  # fmt: skip


def motion(name: str, options: Mapping[str, Any], **of_file: Any) -> truestroke.Trajectory:
    """The motion that `name`, the options and, of a file, further arguments of `from_headings` describe."""
    keys = ("frequency", "velocity_limit", "turn", "settle", *SHARED)
    given = {key: value for key in keys if (value := options[key]) is not None}
    function, understood = MOTIONS.get(name, ("from_headings", {"sample_rate": "sample_rate"}))
    for key in given:
        if key not in understood:
            raise click.UsageError(f"--{key.replace('_', '-')} means nothing to {name}: leave it out.")
    if name == "triangle":
        given.setdefault("frequency", 4.0)
    if "turn" in given and "settle" in given:
        raise click.UsageError("--turn means nothing with --settle, which chooses it: leave it out.")
    if "settle" in given:
        given["settle"] = truestroke.Dynamics.load(given["settle"])
    if "seed" in understood:
        given["seed"] = options["seed"]
    arguments = {understood[key]: value for key, value in given.items()}
    if name not in MOTIONS:
        arguments |= {"path": name, **of_file}
    return getattr(truestroke.trajectories, function)(**arguments)  # type: ignore[no-any-return]


def dynamics_of(file: Path, sample_rate: float) -> truestroke.Dynamics:
    """Those of --dynamics, of this sample rate, Hz."""
    found = truestroke.Dynamics.load(file)
    with checks.inside(f"--dynamics {file}: ", {"dynamics.sample_rate": "sample_rate"}):
        return found.check_rate(sample_rate)


# ---- Waveforms -------------------------------------------------------------------------------------------------------


model_option = click.option("--model", type=common.FILE, metavar="FILE", required=True,
                            help="Of `truestroke identify`.")  # fmt: skip
force_option = click.option("--force", is_flag=True, help="Use a model whose verdict is bad.")
limit_options = common.options(
    click.option("--voltage-limits", type=float, nargs=2, metavar="LOW HIGH",
                 help="Lowest and highest voltage, V.  [default: those of the model's record]"),
    click.option("--slew", metavar="V/S", type=float, help="Fastest change of the voltage.  [default: none]"),
    click.option("--strict", is_flag=True, help="Exit code 1 where there is a warning."),
)  # fmt: skip


def refuse_forced(options: Mapping[str, Any]) -> None:
    """UsageError for --force where there is no --model that it could be about."""
    if options["force"] and options["model"] is None:
        raise click.UsageError("--force uses a --model whose verdict is bad: add --model FILE, or leave --force out.")


rest_option = click.option("--rest", metavar="S", type=click.FloatRange(0.0), default=REST,
                           help="Rest under the first voltage, from rest at 0 V.")  # fmt: skip


def waveform_file(option: str, name: str) -> Path:
    """Where a waveform can be written; an error now rather than later."""
    if Path(name).suffix not in (".csv", ".npz"):
        raise click.UsageError(f"{option} {name}: ends in neither .csv nor .npz.")
    return common.to_write(option, name, files.WAVEFORM)


def limits(model: truestroke.ActuatorModel, options: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `waveform` that `limit_options` ask for; limits in another unit than V are refused."""
    if options["voltage_limits"] is not None:
        model.check_volts(options["voltage_limits"], narrower=True)
    return {
        "voltage_limits": options["voltage_limits"] or model.voltage_range,
        "slew_limit": UNLIMITED if options["slew"] is None else options["slew"],
    }


def refuse_unreachable(made: truestroke.PredictedWaveform) -> None:
    """UsageError where not one sample of the motion is within reach: it is in another unit, or of another zero."""
    outside = sum(span.stop - span.start for span in made.out_of_reach)
    if outside * made.sample_rate > made.volts.size - 0.5:
        wanted, reached, limits = (
            low if low == high else f"{low} to {high}"
            for low, high in ((f"{x.min():.4g}", f"{x.max():.4g}") for x in (made.desired, made.predicted, made.volts))
        )
        raise click.UsageError(
            f"the motion, {wanted} um, is nowhere within reach: the model comes to {reached} um at {limits} V. Is it "
            "in um, and as the sensor of the model's record reads it?"
        )


def learned(found: Learned) -> truestroke.PredictedWaveform:
    """One repetition of the best pass, with what was measured of it."""
    from truestroke.control.spans import Beyond

    best, made = found.best, found.learning
    return truestroke.PredictedWaveform(
        sample_rate=made.sample_rate,
        volts=best.volts,
        desired=made.desired,
        predicted=best.measured,
        out_of_reach=(),
        too_fast=(),
        beyond=Beyond((), ()),
        verdict=found.verdict,
    )


# ---- What is printed -----------------------------------------------------------------------------------------------


def rows(made: truestroke.PredictedWaveform, model: truestroke.ActuatorModel) -> list[tuple[str, str, str]]:
    """Predicted error, and that of the model itself, which is not in it."""
    span = float(made.desired.max() - made.desired.min()) or float("nan")
    errors = {"rmse": made.rmse, "maximum": made.maximum}
    if (of_model := reach.error_of(model)) is not None:
        errors["of the model itself, rmse"] = of_model
    return error_rows(errors, span)


def error_rows(errors: Mapping[str, float], span: float) -> list[tuple[str, str, str]]:
    """Rows of a table: each error, um, and its share of the peak to peak."""
    return [(name, display.micrometres(error), f"{100 * error / span:.2f} %") for name, error in errors.items()]


def tell(made: truestroke.PredictedWaveform) -> None:
    """Voltages and warnings."""
    x, rate = made.volts, made.sample_rate
    click.echo(f"voltage    {x.min():.4g} to {x.max():.4g} V, begins at {x[0]:.4g} V")
    click.echo(f"duration   {x.size / rate:g} s, {x.size} samples at {rate:g} Hz")
    for warning in made.warnings:
        common.print_text(f"- {warning}")


def warn_of(model: truestroke.ActuatorModel) -> None:
    """On stderr, that the verdict of a model is bad."""
    if (verdict := model.verdict).is_bad:
        click.echo(f"truestroke: the verdict of this model is bad: {' '.join(verdict.reasons[:1])}", err=True)


def as_dict(made: truestroke.PredictedWaveform) -> dict[str, Any]:
    """For JSON."""
    short = {
        "out_of_reach_um": made.out_of_reach,
        "too_fast_um": made.too_fast,
        "beyond_voltage_V": made.beyond.voltage,
        "beyond_velocity_um_per_s": made.beyond.velocity,
        "beyond_frequency_um": made.beyond.frequency,
    }
    return {
        **made.verdict.as_dict(),
        "predicted_rmse_um": made.rmse,
        "predicted_maximum_um": made.maximum,
        "voltage_V": [float(made.volts.min()), float(made.volts.max())],
        "first_voltage_V": float(made.volts[0]),
        "sample_rate_Hz": made.sample_rate,
        "samples": made.volts.size,
        **{name: [dataclasses.asdict(span) for span in spans] for name, spans in short.items()},
        "warnings": list(made.warnings),
    }


def code(strict: bool, made: truestroke.PredictedWaveform) -> int:
    """Exit code: 4 of a bad verdict; else 1 where there is a warning, and that was asked for."""
    return ExitCode.of(made.verdict) or (ExitCode.FAILED if strict and made.warnings else ExitCode.OK)
