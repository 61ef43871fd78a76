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
INTERRUPTED = 130  # what a shell says after Ctrl-C

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


class Motion(click.ParamType):
    """One of `MOTIONS`, or a CSV file that exists."""

    name = "|".join((*MOTIONS, "FILE.csv"))

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """`value`, if it can be a trajectory."""
        if value in MOTIONS or Path(value).is_file():
            return value
        self.fail(f"{value!r} is neither one of {', '.join(MOTIONS)} nor a file.", param, ctx)


# ---- Commands ------------------------------------------------------------------------------------------------------


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(truestroke.__version__, "-V", "--version", message="truestroke %(version)s")
def main() -> None:
    """Make a piezo actuator go exactly where it is told.

    Begin with `truestroke track`: it needs no arguments and no hardware.
    """


@main.command()
@click.option("--controller", type=click.Choice(["adaptive", "paper"]), default="adaptive", help="What is tested.")
@click.option(
    "--plant", type=click.Choice(["realistic", "matched"]), default="realistic", help="Simulated actuator: like a real "
    "one, or of exactly the controller's structure."
)  # fmt: skip
@click.option("--trajectory", type=Motion(), default="random", help="Desired motion; a CSV file has columns t and z.")
@click.option("--frequency", type=float, help="Hz; a random wave is low-passed there.  [default: 20 random, 12 sine, "
              "4 triangle]")  # fmt: skip
@click.option("--peak-to-peak", type=float, help="um.  [default: 28.6, sine and triangle 22.8]")
@click.option("--duration", type=float, help="s.  [default: 20]")
@click.option("--sample-rate", type=float, help="Hz, ticks per second.  [default: 2000, or the file's]")
@click.option("--change-at", type=float, help="s; the actuator changes suddenly then (Sec. 4.2 of the paper).")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the random wave and the sensor noise.")
@click.option("--output", default="truestroke-track", help="Files to write, without ending: NAME.h5 and NAME.html.")
@click.option("--figures", type=click.Path(file_okay=False, path_type=Path), help="Folder for the pictures as PNG, "
              "light and dark.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the figures as one JSON object, nothing else.")
def track(output: str, figures: Path | None, as_json: bool, **options: Any) -> None:
    """Follow a motion with a simulated stack: a table, a recording, a page of pictures.

    The table gives rmse and maximum error over the second half of the run.
    """
    recording_file, page_file = _outputs(output)
    trajectory = _trajectory(options)
    plant = _plant(options, trajectory)
    controller = _controller(options["controller"], trajectory)
    recording = _run(trajectory, controller, plant, recording_file)
    recording.save(recording_file)
    _finish(recording, page_file, figures, as_json, recording_file)


@main.command()
@click.argument("recording", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--output", help="Page to write.  [default: RECORDING with the ending .html]")
@click.option("--figures", type=click.Path(file_okay=False, path_type=Path), help="Folder for the pictures as PNG, "
              "light and dark.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the figures as one JSON object, nothing else.")
def report(recording: Path, output: str | None, figures: Path | None, as_json: bool) -> None:
    """Make the table and the page of a recording again."""
    from truestroke.recording import Recording, RecordingError

    _, page_file = _outputs(output or str(recording))
    try:
        loaded = Recording.load(recording)
    except RecordingError as error:
        raise click.ClickException(str(error)) from None
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
        raise click.ClickException(f"--output {output}: there is no folder {stem.parent}; make it: mkdir -p {stem.parent}")
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
    path = () if name in MOTIONS else (name,)
    return getattr(trajectories, function)(*path, **{known[key]: value for key, value in given.items()})  # type: ignore[no-any-return]


def _plant(options: Mapping[str, Any], trajectory: Trajectory) -> Actuator:
    from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant

    at, rate = options["change_at"], trajectory.sample_rate
    if at is not None and not 0 < at < trajectory.duration:
        raise click.UsageError(f"--change-at {at:g}: must be between 0 and the end of the run, {trajectory.duration:g} s.")
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
    import numpy as np

    from truestroke.baselines import ConstantGain
    from truestroke.loop import RunInterrupted, run
    from truestroke.recording import Channel, Recording

    try:
        with _progress("tracking") as tell:
            recording = run(trajectory, controller, plant, progress=tell)
        z, x = recording["true"], recording["volts"]
        gain = ConstantGain(float(np.dot(z, x) / np.dot(x, x)), VOLTAGE_LIMITS)
        before = run(trajectory, gain, plant)["true"]
    except RunInterrupted as stop:
        saved = stop.recording.save(rescue)
        if isinstance(stop.__cause__, KeyboardInterrupt):
            click.echo(f"truestroke: saved the {stop.recording['time'].size} ticks so far: {saved}", err=True)
            raise click.Abort from None
        raise click.ClickException(f"{stop}; the ticks so far are in {saved}") from stop
    kept = Channel(before, "um", f"true displacement of the same motion at a constant {gain.sensitivity:.4g} um/V")
    return Recording(recording.channels | {"uncompensated": kept}, recording.metadata | {"command": _command()})


def _command() -> str:
    """The command line as it was typed."""
    context = click.get_current_context()
    return shlex.join([*context.command_path.split(), *sys.argv[2:]])


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
    from truestroke.report import save_page, save_pictures

    summary = metrics.summary(recording)
    with _progress("drawing"):
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
    click.echo(f"\nconverged after  {words.convergence(summary)}")
    click.echo(f"flags            {'; '.join(words.flags(summary)) or 'none'}\n")


def _next(recording: Recording) -> str:
    """A command worth typing after this one."""
    if recording.metadata.get("plant", {}).get("settings", {}).get("change"):
        return "truestroke track --controller paper"
    return "truestroke track --change-at 10"
