"""`truestroke export`: the controller as source or settings for another machine."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
from click.core import ParameterSource

import truestroke
from truestroke.base import npz, system
from truestroke.base.checks import SettingError
from truestroke.base.files import FileError
from truestroke.cli import common, waveforms

if TYPE_CHECKING:
    from truestroke.control.settings import ControllerSettings

SIZES = ("sample_rate", "stroke", "voltage_limits")
ALONE = (*SIZES, "slew", "safe_voltage", "controller", "model", "dynamics")
ANOTHER = 0.02  # of a period: by no more it is followed, so that it is not the one of this axis
OF_TARGETS = {
    "precision": ["c"],
    "history": ["c"],
    "ram": ["c"],
    "repetition": ["c"],
    "stack": ["fmu"],
    "actuator": ["fmu"],
    "source": ["fmu"],
    "fmi": ["fmu"],
    "ticks": ["c", "json"],
}
"""Options that not all targets have."""


@click.command()
@click.argument("target", metavar="c|json|fmu", type=click.Choice(["c", "json", "fmu"]))
@click.option("--config", metavar="FILE", type=common.FILE, help="Take the controller of a configuration of "
              "`truestroke run`.")  # fmt: skip
@click.option("--axis", metavar="NAME", help="Which of its axes.  [default: the only one]")
@click.option("--sample-rate", metavar="HZ", type=float, help="Ticks per second, without --config.")
@click.option("--stroke", metavar="UM", type=float, help="Travel, without --config or --model.")
@click.option("--voltage-limits", metavar="LOW HIGH", type=float, nargs=2, help="V, without --config.")
@click.option("--slew", metavar="V/S", type=float, help="Fastest change of the voltage, without --config.")
@click.option("--safe-voltage", metavar="V", type=float, help="Before the start and after the end, without --config.  "
              "[default: 0, or the limit that is nearest to it]")  # fmt: skip
@click.option(
    "--controller", type=click.Choice(["adaptive", "paper"]), help="Which law, without --config.  [default: adaptive]"
)
@click.option("--model", metavar="FILE", type=common.FILE, help="Start from a model of `truestroke identify`.")
@waveforms.force_option
@click.option("--dynamics", metavar="FILE", type=common.FILE, help="Of `truestroke bode`.")
@click.option("--state", metavar="FILE", type=common.FILE, help="The controller of a recording, which starts with what "
              "it had learned.")  # fmt: skip
@click.option("--repetition", metavar="FILE", type=common.FILE, help="c, with --config of an axis with a period: what "
              "its RepetitiveController has learned, `numpy.savez(FILE, **controller.state())`.")  # fmt: skip
@click.option(
    "--precision", type=click.Choice(["double", "single"]), default="single", help="Number type of the machine."
)
@click.option("--history", metavar="TICKS", type=click.IntRange(1, 1024), help="That a measurement may come after its "
              "command, plus one.  [default: 16, 8 of the paper's law, more with a long dead time]")  # fmt: skip
@click.option("--ram", metavar="BYTES", type=click.IntRange(1), help="Of the chip, for the state: refuse more.")
@click.option("--ticks", metavar="N", type=click.IntRange(100, 100_000), default=1000, help="Of the self-test.")
@click.option("--output", metavar="PATH", type=click.Path(path_type=Path), required=True,
              help="c: a new or empty folder; json, fmu: a file.")  # fmt: skip
@click.option("--stack", is_flag=True, help="fmu: the simulated stack in place of a controller.")
@click.option("--actuator", is_flag=True, help="fmu: the actuator of --model FILE, from voltage to displacement, in "
              "place of a controller.")  # fmt: skip
@click.option("--source", is_flag=True, help="fmu: without a binary of this computer.")
@click.option("--fmi", type=click.Choice(["2.0", "3.0"]), default="2.0", help="fmu: version of FMI.  [default: 2.0]")
@common.overwrite_option
@common.json_option
def export(target: str, output: Path, as_json: bool, **options: Any) -> None:
    """Write a controller as C99 source that builds by itself, as JSON for a browser, or as an FMU.

    c: the folder holds the kernel with capacities cut to the settings, settings and prior as constants, three calls, an
    example of a loop, and a self-test: a recorded run whose commands must come out again. json: the file holds the
    settings in double precision and such a run. fmu: FMI 2.0 or 3.0 for co-simulation, source and binary; with
    --actuator of the model itself, with --stack of the simulated stack.
    """
    from truestroke.export import export_c

    _refuse_others(target)
    waveforms.refuse_forced(options)
    for kind, write in (("stack", _stack), ("actuator", _actuator)):
        if options[kind]:
            write(output, options, as_json)
            return
    asked = _asked(options)
    settings = asked.settings
    if target != "c":
        _one_file(target, asked, output, options, as_json)
        return
    made = export_c(
        settings if asked.repetitive is None else asked.repetitive,
        output,
        precision=options["precision"],
        history=options["history"],
        safe_voltage=asked.safe_voltage,
        zero=_number(asked),
        ram=options["ram"],
        ticks=options["ticks"],
        about=asked.about,
        command=common.as_asked()["command"],
    )
    if as_json:
        common.print_json({"folder": str(made.folder), "capacities": dict(made.capacities),
                           "ram_bytes": made.ram, "flash_bytes": made.flash})  # fmt: skip
        return
    click.echo(f"{len(made.files)} files of a controller with {settings.plays} plays and {settings.parameters} weights")
    click.echo(f"state      {made.ram:,} bytes of RAM, beside the stack")
    click.echo(f"settings   {made.flash:,} bytes of flash, beside the code")
    common.print_files(folder=made.folder)
    for words, target in (("\nIts self-test:", "test"), ("Its memory:   ", "size")):
        click.echo(f"{words} {system.command_line('make', '-C', made.folder, target)}")


@dataclass(frozen=True)
class _Asked:
    """The controller that is asked for, and whose it is.

    Attributes
    ----------
    safe_voltage : float or None
        V.
    about : str
        A line that says whose it is.
    zero : float or "measured"
        The reading of the sensor that counts as 0, um.
    repetitive : RepetitiveController or None
        Around the controller, with what it has learned.
    """

    settings: ControllerSettings
    safe_voltage: float | None
    about: str
    zero: float | Literal["measured"] = 0.0
    repetitive: truestroke.RepetitiveController | None = None


def _number(asked: _Asked) -> float:
    """The zero that a chip subtracts, um: it measures none at its start."""
    if asked.zero == "measured":
        raise click.UsageError(
            f"zero of {asked.about}: 'measured' is done by `truestroke run`, and a chip measures none. Write the "
            "number of um that the recording of a run has in its metadata, axis_check: zero = 12.5"
        )
    return float(asked.zero)


def _refuse_others(target: str) -> None:
    """An option of another target is refused, not passed over."""
    context = click.get_current_context()
    for name, targets in OF_TARGETS.items():
        if target not in targets and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"--{name} is one of `export {targets[0]}`.")


def _one_file(
    target: str,
    asked: _Asked,
    output: Path,
    options: dict[str, Any],
    as_json: bool,
) -> None:
    from truestroke.export import export_fmu, export_json

    settings = dataclasses.replace(asked.settings, precision="double")
    whose: dict[str, Any] = {"safe_voltage": asked.safe_voltage, "about": asked.about}
    what = f"A controller with {settings.plays} plays and {settings.parameters} weights"
    if target == "fmu":
        file = export_fmu(
            settings,
            output,
            **whose,
            binary=not options["source"],
            version=options["fmi"],
        )
    else:
        command = common.as_asked()["command"]
        file = export_json(settings, output, **whose, ticks=options["ticks"], command=command)
    _told(file, what, as_json)


def _stack(output: Path, options: dict[str, Any], as_json: bool) -> None:
    """The simulated stack as an FMU; of the options only the rate is its own."""
    from truestroke.export import export_fmu
    from truestroke.plant import PlantSettings

    _refuse_of_controllers("stack", options, ("sample_rate",))
    rate = options["sample_rate"]
    settings = PlantSettings() if rate is None else PlantSettings(sample_rate=rate)
    _told(
        export_fmu(settings, output, binary=not options["source"], version=options["fmi"]),
        "The simulated stack",
        as_json,
    )


def _actuator(output: Path, options: dict[str, Any], as_json: bool) -> None:
    """The actuator of a model as an FMU."""
    from truestroke.export import export_fmu

    _refuse_of_controllers("actuator", options, ("sample_rate", "model"))
    if options["model"] is None:
        raise click.UsageError("--actuator needs --model FILE, which truestroke identify writes.")
    model = truestroke.usable_model(options["model"], force=options["force"])
    file = export_fmu(
        model,
        output,
        sample_rate=options["sample_rate"],
        about=f"the actuator of {options['model'].name}",
        binary=not options["source"],
        version=options["fmi"],
    )
    _told(file, f"An actuator with {len(model.thresholds)} plays and {model.parameters} weights", as_json)


def _refuse_of_controllers(kind: str, options: dict[str, Any], own: tuple[str, ...]) -> None:
    """What is exported in place of a controller has few of its options."""
    if options["actuator"] and options["stack"]:
        raise click.UsageError("--actuator and --stack are two FMUs: ask for one of them.")
    for name in (*ALONE, "config", "axis", "state"):
        if name not in own and options[name] is not None:
            raise click.UsageError(
                f"--{name.replace('_', '-')} is one of a controller, and --{kind} makes none: leave it out."
            )


def _told(file: Path, what: str, as_json: bool) -> None:
    if as_json:
        common.print_json({"file": str(file)})
        return
    click.echo(what)
    common.print_files(file=file)


def _asked(options: dict[str, Any]) -> _Asked:
    """Of a configuration, of a recording, or by options."""
    if options["repetition"] is not None and options["config"] is None:
        raise click.UsageError("--repetition goes with --config FILE, of an axis with a period.")
    for source in ("config", "state"):
        if options[source] is None:
            continue
        if alone := [name for name in (*ALONE, "state") if name != source and options[name] is not None]:
            raise click.UsageError(f"--{alone[0].replace('_', '-')} is in --{source} FILE: leave it out.")
        if source == "state":
            return _recorded(options["state"], options["axis"])
        return _configured(options["config"], options["axis"], options["repetition"])
    if options["axis"] is not None:
        raise click.UsageError("--axis is one of --config FILE or --state FILE.")
    return _given(options)


def _given(options: dict[str, Any]) -> _Asked:
    """The controller that the options describe."""
    needed = ("sample_rate",) if options["model"] else SIZES
    missing = [f"--{name.replace('_', '-')}" for name in needed if options[name] is None]
    if missing:
        raise click.UsageError(f"{', '.join(missing)}: needed without --config FILE.")
    given = {name: options[name] for name in SIZES if options[name] is not None}
    slew = {} if options["slew"] is None else {"slew_limit": options["slew"]}
    if options["controller"] == "paper":
        if further := [name for name in ("model", "dynamics") if options[name] is not None]:
            raise click.UsageError(f"--controller paper knows no {further[0]}: leave it out.")
        paper = truestroke.AdaptiveController.paper(**given).settings
        return _Asked(dataclasses.replace(paper, **slew), options["safe_voltage"], "the paper's controller")
    given |= slew
    if options["dynamics"] is not None:
        given["dynamics"] = waveforms.dynamics_of(options["dynamics"], options["sample_rate"])
    if options["model"] is None:
        about = "an actuator of {stroke:g} um".format(**given)
        return _Asked(truestroke.AdaptiveController(**given).settings, options["safe_voltage"], about)
    if "stroke" in given:
        raise click.UsageError("--stroke is that of --model: leave it out.")
    model = truestroke.usable_model(options["model"], force=options["force"])
    settings = truestroke.AdaptiveController.from_model(model, **given).settings
    return _Asked(settings, options["safe_voltage"], f"the actuator of {options['model'].name}", model.zero)


def _configured(config: Path, name: str | None, repetition: Path | None) -> _Asked:
    """Of an axis of a configuration; no guard stands beside a chip, so that its controller keeps the stricter slew."""
    from truestroke.runtime.realtime import config as configuration

    axes = {axis.name: axis for axis in configuration.load(config).axes}
    axis = axes[_chosen(config, tuple(axes), name)]
    repetitive = _repetitive(config, axis.controller, repetition)
    inside = axis.controller if repetitive is None else repetitive.controller
    if not isinstance(inside, truestroke.AdaptiveController):
        raise click.UsageError(f"the controller of {config} is none of the kernel's.")
    settings = inside.settings
    settings = dataclasses.replace(settings, slew_limit=min(settings.slew_limit, axis.slew))
    if repetitive is not None:
        inside.change(slew_limit=settings.slew_limit)
    return _Asked(settings, axis.safe_voltage, f"axis {axis.name} of {config.name}", axis.zero or 0.0, repetitive)


def _repetitive(config: Path, controller: object, file: Path | None) -> truestroke.RepetitiveController | None:
    """The controller of an axis with a period, with what it has learned; None without a file of it."""
    if file is None and not isinstance(controller, truestroke.RepetitiveController):
        return None
    if file is None or not isinstance(controller, truestroke.RepetitiveController):
        words = "its axis has no period" if file is not None else "its axis has a period: name what was learned in it"
        raise click.UsageError(f"--repetition FILE and {config} go together: {words}.")
    period = controller.period
    try:
        controller.restore(npz.read(file, npz.names(file, FileError), FileError))
    except SettingError as error:
        words = "it is no state of the controller of this axis"
        raise click.UsageError(f"--repetition {file}: {words}: {str(error).replace('`', '')}.") from None
    except FileError as error:
        words = "numpy.savez(FILE, **controller.state()) writes one"
        raise click.UsageError(f"--repetition {file}: no NPZ file, or a damaged one: {error}; {words}.") from None
    if not controller.batches:
        raise click.UsageError(f"--repetition {file}: it has learned nothing yet; save it after a run that repeats.")
    if abs(controller.period - period) > ANOTHER * period:
        words = f"its motion has a period of {controller.period:.4g} s, that of {config} {period:.4g} s"
        raise click.UsageError(f"--repetition {file}: {words}: choose the file of this axis, or change `period`.")
    return controller


def _recorded(file: Path, name: str | None) -> _Asked:
    """Of a recording, with what was learned in it."""
    from truestroke.export.learned import learned

    recording = truestroke.Recording.load(file)
    if recording.axes:
        name = _chosen(file, recording.axes, name)
        recording = recording.axis(name)
    about = recording.metadata.get("axis", {})
    if name is not None:
        _chosen(file, (about.get("name", "axis"),), name)
    settings = learned(recording, str(file))
    settings = dataclasses.replace(settings, slew_limit=min(settings.slew_limit, about.get("slew", math.inf)))
    checked = recording.metadata.get("axis_check", {}).get(about.get("name"), {})
    return _Asked(settings, about.get("safe_voltage"), f"the actuator of {file.name}", checked.get("zero", 0.0))


def _chosen(file: Path, axes: tuple[str, ...], name: str | None) -> str:
    """The name of the axis that is asked for, or of the only one."""
    if name is None and len(axes) > 1:
        raise click.UsageError(f"{file} has the axes {', '.join(axes)}: name one with --axis.")
    if name is not None and name not in axes:
        raise click.UsageError(f"--axis {name}: {file} has {', '.join(axes)}.")
    return name or axes[0]
