"""Waveforms and the models they are made with: options, files, and what is printed of them."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from truestroke.base import files
from truestroke.cli import common

if TYPE_CHECKING:
    from truestroke.identification import ActuatorModel, PredictedWaveform


def model_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """`--model FILE`, as `load` takes it."""
    help_ = "Of `truestroke identify`."
    return click.option("--model", type=common.FILE, metavar="FILE", required=True, help=help_)(command)


def limit_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Limits of the voltage, and `--strict`."""
    for option in reversed(
        [
            click.option("--voltage-limits", type=float, nargs=2, metavar="LOW HIGH",
                         help="Lowest and highest voltage, V.  [default: those of the model's record]"),
            click.option("--slew", metavar="V/S", type=float, help="Fastest change of the voltage.  [default: none]"),
            click.option("--strict", is_flag=True, help="Exit code 1 where there is a warning."),
        ]
    ):  # fmt: skip
        command = option(command)
    return command


def load(path: Path) -> ActuatorModel:
    """The model in a file."""
    from truestroke.identification import load_model

    return load_model(path)


def waveform_file(option: str, name: str) -> Path:
    """Where a waveform can be written; an error now rather than later."""
    path = Path(name)
    if path.suffix not in (".csv", ".npz"):
        raise click.UsageError(f"{option} {name}: ends in neither .csv nor .npz.")
    if not os.access(path.parent, os.W_OK) or path.is_dir():
        raise click.ClickException(f"{option} {name}: cannot be written; is there a folder {path.parent}?")
    files.check(path, files.WAVEFORM)
    return path


def limits(model: ActuatorModel, options: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `waveform` that `limit_options` ask for."""
    from truestroke.control.settings import UNLIMITED

    return {
        "voltage_limits": options["voltage_limits"] or model.voltage_range,
        "slew_limit": UNLIMITED if options["slew"] is None else options["slew"],
    }


# ---- What is printed -----------------------------------------------------------------------------------------------


def error_of(model: ActuatorModel) -> float | None:
    """Rmse of the model where it last met the actuator, um: held out by `identify`, or of the last pass."""
    return model.metrics.get("held_out_rmse_um", model.metrics.get("prediction_rmse_um"))


def rows(made: PredictedWaveform, model: ActuatorModel) -> list[tuple[str, str, str]]:
    """Predicted error, and that of the model itself, which is not in it."""
    span = float(made.desired.max() - made.desired.min()) or float("nan")
    errors = {"rmse": made.rmse, "maximum": made.maximum}
    if (of_model := error_of(model)) is not None:
        errors["of the model itself, rmse"] = of_model
    return [(name, f"{error:.4f} um", f"{100 * error / span:.2f} %") for name, error in errors.items()]


def tell(made: PredictedWaveform) -> None:
    """Voltages and warnings."""
    x, rate = made.volts, made.sample_rate
    click.echo(f"voltage    {x.min():.4g} to {x.max():.4g} V, begins at {x[0]:.4g} V")
    click.echo(f"duration   {x.size / rate:g} s, {x.size} samples at {rate:g} Hz")
    for warning in made.warnings:
        common.print_text(f"- {warning}")


def as_dict(made: PredictedWaveform) -> dict[str, Any]:
    """For JSON."""
    short = {
        "out_of_reach_um": made.out_of_reach,
        "too_fast_um": made.too_fast,
        "beyond_voltage_V": made.beyond.voltage,
        "beyond_velocity_um_per_s": made.beyond.velocity,
    }
    return {
        "predicted_rmse_um": made.rmse,
        "predicted_maximum_um": made.maximum,
        "voltage_V": [float(made.volts.min()), float(made.volts.max())],
        "first_voltage_V": float(made.volts[0]),
        "sample_rate_Hz": made.sample_rate,
        "samples": made.volts.size,
        **{name: [dataclasses.asdict(span) for span in spans] for name, spans in short.items()},
        "warnings": list(made.warnings),
    }


def leave(strict: bool, made: PredictedWaveform) -> None:
    """Exit code 1 where that was asked for."""
    if strict and made.warnings:
        click.get_current_context().exit(1)
