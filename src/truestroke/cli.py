"""The command `truestroke`: arguments in, tables and paths out. Commands import their modules when they are called."""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import truestroke
from truestroke._check import SettingError

if TYPE_CHECKING:
    from truestroke.controller import Controller
    from truestroke.loop import Actuator
    from truestroke.metrics import TrackingSummary
    from truestroke.recording import Recording
    from truestroke.trajectories import Trajectory

STROKE = 30.0  # um, of the simulated stack
VOLTAGE_LIMITS = (-0.6, 3.6)  # V at the D/A converter
SHORTEST = 20  # ticks that can be drawn
INTERRUPTED = 130  # what a shell says after Ctrl-C

FILES = ("output", "figures", "as_json")  # options that do not change the run
# What each trajectory understands: option -> argument of its function.
SHARED = {"peak_to_peak": "peak_to_peak", "duration": "duration", "sample_rate": "sample_rate"}
MOTIONS = {
    "random": ("random_wave", {"frequency": "cutoff", "seed": "seed", **SHARED}),
    "sine": ("sine", {"frequency": "frequency", **SHARED}),
    "triangle": ("triangle", {"frequency": "frequency", **SHARED}),
    "staircase": ("staircase", SHARED),
}


class Commands(click.Group):
    """Commands whose errors are one line: exit code 2 for a wrong argument, 1 for a failure, 130 for Ctrl-C."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run a command and leave with its exit code."""
        try:
            sys.exit(super().main(*args, **{**options, "standalone_mode": False}) or 0)
        except click.exceptions.NoArgsIsHelpError as asked:
            click.echo(asked.format_message())
            sys.exit(0)
        except click.UsageError as error:
            where = error.ctx.command_path if error.ctx else "truestroke"
            _complain(f"{error.format_message()} See: {where} --help", 2)
        except (click.ClickException, SettingError) as error:
            message = error.format_message() if isinstance(error, click.ClickException) else str(error)
            _complain(message, 2 if isinstance(error, SettingError) else 1)
        except OSError as error:
            _complain(f"{error.filename or 'file'}: {error.strerror or error}", 1)
        except (click.Abort, KeyboardInterrupt):
            _complain("interrupted", INTERRUPTED)


def _complain(message: str, code: int) -> None:
    click.echo(f"truestroke: {' '.join(message.split())}", err=True)
    sys.exit(code)


def _motion(context: click.Context, option: click.Parameter, value: str) -> str:
    """`value`, if it is one of `MOTIONS` or a file."""
    if value in MOTIONS or Path(value).is_file():
        return value
    raise click.BadParameter(f"{value!r} is neither one of {', '.join(MOTIONS)} nor a file.")


def _pictures_option(command: Callable[..., Any]) -> Callable[..., Any]:
    kind = click.Path(file_okay=False, path_type=Path)
    return click.option(
        "--figures", type=kind, metavar="FOLDER", help="Also write each picture as PNG, light and dark."
    )(command)


def _json_option(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")(command)


# ---- Commands ------------------------------------------------------------------------------------------------------


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(truestroke.__version__, "-V", "--version", message="truestroke %(version)s")
def main() -> None:
    """Make a piezo actuator go exactly where it is told.

    Begin with `truestroke track`: it needs no arguments and no hardware.
    """


@main.command()
@click.option("--controller", type=click.Choice(["adaptive", "paper"]), default="adaptive", help="What is tested.")
@click.option("--plant", type=click.Choice(["realistic", "matched"]), default="realistic", help="What is driven: "
              "like a real stack, or of exactly the controller's structure.")  # fmt: skip
@click.option("--trajectory", metavar=f"[{'|'.join(MOTIONS)}|FILE.csv]", default="random", callback=_motion,
              help="Desired motion. A file has columns t (s) and z (um), or z alone.")  # fmt: skip
@click.option("--frequency", metavar="HZ", type=float, help="Of a sine or triangle; a random wave has its low pass "
              "there.  [default: 20 random, 12 sine, 4 triangle]")  # fmt: skip
@click.option("--peak-to-peak", metavar="UM", type=float, help="[default: 28.6, sine and triangle 22.8]")
@click.option("--duration", metavar="S", type=click.FloatRange(min=0.5), help="[default: 20]")
@click.option("--sample-rate", metavar="HZ", type=float, help="Ticks per second.  [default: 2000, or that of the file]")
@click.option("--change-at", metavar="S", type=float, help="The actuator changes suddenly then (Sec. 4.2).")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--output", metavar="NAME", default="truestroke-track", help="Write NAME.h5 and NAME.html.")
@_pictures_option
@_json_option
def track(output: str, figures: Path | None, as_json: bool, **options: Any) -> None:
    """Follow a motion with a simulated stack.

    Prints rmse and maximum error over the second half of the run; writes a recording and a page of pictures.
    """
    recording_file, page_file = _outputs(output)
    trajectory = _trajectory(options)
    plant = _plant(options, trajectory)
    controller = _controller(options["controller"], trajectory)
    if len(trajectory) < SHORTEST:
        raise click.UsageError(f"--trajectory: {len(trajectory)} ticks, a page needs at least {SHORTEST}.")
    recording = _run(trajectory, controller, plant, recording_file)
    recording.save(recording_file)
    _finish(recording, page_file, figures, as_json, recording_file)


@main.command()
@click.argument("recording", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--output", metavar="NAME", help="Write NAME.html.  [default: as RECORDING]")
@_pictures_option
@_json_option
def report(recording: Path, output: str | None, figures: Path | None, as_json: bool) -> None:
    """Make the table and the page of a recording again."""
    from truestroke.recording import Recording, RecordingError

    _, page_file = _outputs(output or str(recording))
    try:
        loaded = Recording.load(recording)
    except RecordingError as error:
        raise click.ClickException(str(error)) from None
    if len(loaded["time"]) < SHORTEST:
        raise click.ClickException(f"{recording}: {len(loaded['time'])} ticks, a page needs at least {SHORTEST}")
    _finish(loaded, page_file, figures, as_json, recording)


# ---- From options to the run ---------------------------------------------------------------------------------------


def _outputs(output: str) -> tuple[Path, Path]:
    """Paths of recording and page; an error now rather than after the run if they cannot be written."""
    stem = Path(output)
    if stem.suffix in (".h5", ".html"):
        stem = stem.with_suffix("")
    if not stem.name or stem.is_dir():
        raise click.UsageError(f"--output {output}: is a folder; add a name, such as {stem / 'run1'}.")
    if not stem.parent.is_dir():
        raise click.ClickException(
            f"--output {output}: there is no folder {stem.parent}; make it: mkdir -p {stem.parent}"
        )
    files = stem.with_name(stem.name + ".h5"), stem.with_name(stem.name + ".html")
    for file in files:
        if not os.access(file if file.exists() else file.parent, os.W_OK) or file.is_dir():
            raise click.ClickException(f"--output {output}: {file} cannot be written; choose another --output.")
    return files


def _trajectory(options: Mapping[str, Any]) -> Trajectory:
    from truestroke import trajectories

    name = options["trajectory"]
    given = {key: value for key in ("frequency", *SHARED) if (value := options[key]) is not None}
    function, known = MOTIONS.get(name, ("from_csv", {"sample_rate": "sample_rate"}))
    for key in given:
        if key not in known:
            raise click.UsageError(f"--{key.replace('_', '-')} means nothing to --trajectory {name}: leave it out.")
    if name == "triangle":
        given.setdefault("frequency", 4.0)
    if "seed" in known:
        given["seed"] = options["seed"]
    arguments = {known[key]: value for key, value in given.items()}
    if name not in MOTIONS:
        arguments |= {"path": name, **_columns(Path(name))}
    return getattr(trajectories, function)(**arguments)  # type: ignore[no-any-return]


def _columns(path: Path) -> dict[str, int]:
    """Time first, then position, where a file has more than one column."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return {"time": 0, "position": 1} if "," in file.readline() else {}


def _plant(options: Mapping[str, Any], trajectory: Trajectory) -> Actuator:
    from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant

    at, rate = options["change_at"], trajectory.sample_rate
    if at is not None and not 0 < at < trajectory.duration:
        raise click.UsageError(
            f"--change-at {at:g}: must be between 0 and the end of the run, {trajectory.duration:g} s."
        )
    if options["plant"] == "matched":
        matched = MatchedSettings(
            sample_rate=rate,
            change=None if at is None else Change(time=at),
            weight_spread=0.0 if at is None else 0.3,  # Sec. 4.2
        )
        return MatchedPlant(velocity=trajectory.velocity, settings=matched, seed=options["seed"])
    change = None if at is None else Change(time=at, gain=0.8, hysteresis=1.3)
    return RealisticPlant(PlantSettings(sample_rate=rate, change=change), seed=options["seed"])


def _controller(name: str, trajectory: Trajectory) -> Controller:
    make = truestroke.AdaptiveController.paper if name == "paper" else truestroke.AdaptiveController
    return make(sample_rate=trajectory.sample_rate, stroke=STROKE, voltage_limits=VOLTAGE_LIMITS)


def _run(trajectory: Trajectory, controller: Controller, plant: Actuator, rescue: Path) -> Recording:
    """The run, and the same motion with a constant gain; what there is goes to `rescue` if it is interrupted."""
    from truestroke.loop import RunInterrupted, run
    from truestroke.recording import Recording

    try:
        with _progress("tracking") as tell:
            recording = run(trajectory, controller, plant, progress=tell)
    except RunInterrupted as stop:
        ticks = stop.recording["time"].size
        saved = f"the {ticks} ticks so far are in {stop.recording.save(rescue)}" if ticks else "nothing was saved"
        if isinstance(stop.__cause__, KeyboardInterrupt):
            click.echo(f"truestroke: {saved}", err=True)
            raise click.Abort from None
        raise click.ClickException(f"{stop.__cause__}; {saved}") from stop
    recording = Recording(recording.channels, recording.metadata | _as_asked())
    recording.save(rescue)
    return _with_uncompensated(recording, trajectory, plant)


def _with_uncompensated(recording: Recording, trajectory: Trajectory, plant: Actuator) -> Recording:
    """The recording with what the same motion would be with the straight line that fits the actuator best."""
    import numpy as np

    from truestroke.baselines import ConstantGain
    from truestroke.loop import RunInterrupted, run
    from truestroke.recording import Channel, Recording

    if not np.ptp(recording["volts"]):
        return recording  # at rest there is nothing to compare
    (offset, gain) = np.polynomial.Polynomial.fit(recording["volts"], recording["true"], 1).convert().coef
    line = ConstantGain(float(gain), VOLTAGE_LIMITS, offset=float(offset))
    try:
        before = run(trajectory, line, plant)["true"]
    except RunInterrupted as stop:
        raise click.Abort from stop
    kept = Channel(before, "um", f"true displacement if z = {offset:.3g} um + {gain:.4g} um/V x were all")
    return Recording(recording.channels | {"uncompensated": kept}, recording.metadata)


def _as_asked() -> dict[str, Any]:
    """For the recording: the options, and the command that repeats them, without those that name files."""
    context = click.get_current_context()
    words = ["truestroke", context.info_name or ""]
    for option in context.command.params:
        name = option.name or ""
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE and name not in FILES:
            words += [option.opts[0], str(context.params[name]).removesuffix(".0")]
    options = {name: value for name, value in context.params.items() if name not in FILES}
    return {"command": shlex.join(words), "options": options}


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """A bar on stderr where that is a terminal, else nothing."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, all_of_them: bar.update(task, completed=done, total=all_of_them)


# ---- What is printed -----------------------------------------------------------------------------------------------


def _finish(recording: Recording, page_file: Path, figures: Path | None, as_json: bool, recording_file: Path) -> None:
    """Page and pictures to disk, table and paths to the terminal."""
    from truestroke import metrics

    summary = metrics.summary(recording)
    with _progress("drawing"):
        from truestroke.report import save_page, save_pictures

        save_page(recording, page_file)
        pictures = save_pictures(recording, figures) if figures else []
    if as_json:
        files = {"recording": str(recording_file), "page": str(page_file), "pictures": [str(path) for path in pictures]}
        click.echo(json.dumps({**_finite(summary.as_dict()), **files}))
        return
    _table(summary)
    click.echo(f"recording  {recording_file}")
    click.echo(f"page       {page_file}")
    if pictures:
        click.echo(f"pictures   {figures}{os.sep}")
    click.echo(f"\nOpen the page in a browser, or try: {_next(recording)}")


def _finite(figures: Mapping[str, float | int | None]) -> dict[str, float | int | None]:
    """JSON knows neither infinity nor NaN."""
    return {key: value if value is None or math.isfinite(value) else None for key, value in figures.items()}


def _table(summary: TrackingSummary) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from truestroke.report import words

    console = Console(highlight=False)
    table = Table(box=SIMPLE_HEAD if console.is_terminal else None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(words.span(summary))
    for kind in words.kinds(summary):
        table.add_column(kind, justify="right")
        table.add_column("of p-p", justify="right", style="dim")
    for name, cells in words.table(summary):
        table.add_row(name, *(text for um, percent in cells for text in (f"[bold]{um}[/] um", f"{percent} %")))
    console.print(table)
    click.echo(f"\nconverged  {words.convergence(summary)}")
    flags = ("\n" + " " * 11).join(words.flags(summary)) or "none"
    click.echo(f"flags      {flags}\n")


def _next(recording: Recording) -> str:
    """A command worth typing after this one."""
    if recording.metadata.get("plant", {}).get("settings", {}).get("change"):
        return "truestroke track --controller paper"
    return "truestroke track --change-at 10"
