"""Common parts of all commands: errors, files, progress, tables."""

from __future__ import annotations

import dataclasses
import difflib
import errno
import functools
import json
import math
import os
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

import truestroke
from truestroke.base import display, files, interrupts, streams, system
from truestroke.base.checks import SettingError
from truestroke.base.errors import LatenessWarning, ModelWarning, TruestrokeError
from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import inputs

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from truestroke.report import Page

FILES = ("output", "plots", "figures", "overwrite", "as_json")  # options that do not change the run
ALIASES = {"cutoff": "frequency", "slew_limit": "slew", "path": "trajectory"}  # arguments of Python by other options
RENAMED = {"play": "playback", "zoo": "robustness"}  # commands by their old names, for one version
UNITS = {"HZ": "Hz", "S": "s", "UM": "um", "UM/S": "um/s", "V": "V", "V/S": "V/s", "LOW HIGH": "V"}  # by the metavar
LONGEST_HELP = 200  # characters of the sentence about a command
PIPE_WIDTH = 120  # columns of a table where there is no terminal
LONG = 20.0  # s: what takes longer says so before it begins
SPACE = 5e6  # bytes: a page and the small files beside it take less
GAP = 2  # characters between the columns of a table
Option = Callable[[Callable[..., Any]], Callable[..., Any]]  # a decorator of a command


class ExistingFile(click.Path):
    """The path of a file that is there; where it is not, the error names its folder and what may have been meant."""

    def __init__(self) -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, or the error."""
        path = Path(value)
        if path.exists():
            inputs.note(ctx, param, path)
            return super().convert(value, param, ctx)
        folder = path.absolute().parent
        if not folder.is_dir():
            self.fail(f"there is no folder {folder}.", param, ctx)
        meant = inputs.preferred(param, _alike(path, folder))
        maker = inputs.MAKERS.get(param.name or "") if param else None
        remedy = f"; did you mean {meant.name}?" if meant else f"; {maker}." if maker else "."
        self.fail(f"there is no file {path.name} in {folder}{remedy}", param, ctx)


def _alike(path: Path, folder: Path) -> list[Path]:
    """Files of a folder whose name is near to that of a path: of the same ending first."""
    there = [one for one in sorted(folder.iterdir()) if one.is_file()]
    ending = [one for one in there if path.suffix in ("", one.suffix)]
    stems = difflib.get_close_matches(path.stem, [one.stem for one in ending], n=1)
    names = difflib.get_close_matches(path.name, [one.name for one in there], n=1, cutoff=0.8)
    return [one for one in ending if one.stem in stems] or [one for one in there if one.name in names]


FILE = ExistingFile()


class Commands(click.Group):
    """Commands in the order of the help, whose errors are one line.

    Exit codes are those of `ExitCode`.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:
        """As they were added."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Each with the whole sentence that its own help begins with, in lines as wide as the terminal."""
        whole = [(name, command.get_short_help_str(limit=LONGEST_HELP)) for name, command in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(whole)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """By its name, or by its old one."""
        return super().resolve_command(ctx, [RENAMED.get(args[0], args[0]), *args[1:]])

    def main(self, *args: Any, **options: Any) -> Any:
        """Run a command and leave with its exit code, which does not depend on whether anybody reads what it prints."""
        streams.secure()
        code = self._run(*args, **{**options, "standalone_mode": False})
        unread = streams.error("stdout")
        if unread is not None:
            complain(f"stdout: {unread.strerror}; what was printed is not complete")
            lost = unread.errno != errno.EPIPE  # a reader that has enough is none
            code = ExitCode.FAILED if lost and code == ExitCode.OK else code
        sys.exit(code)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that is asked for, and remember it for error messages."""
        try:
            return super().invoke(ctx)
        except click.UsageError:
            raise  # which the kind of a file does not explain
        except (click.ClickException, TruestrokeError):
            if words := inputs.mistaken(ctx):
                raise click.UsageError(words) from None
            raise
        finally:
            self._asked = self.commands.get(ctx.invoked_subcommand or "")

    _asked: click.Command | None = None

    def _failed(self, message: str, code: int) -> int:
        return complain(in_words_of(self._asked, message), code)

    def _run(self, *args: Any, **options: Any) -> int:
        stopped: list[int] = []  # a signal may come before the next line has its own
        try:
            with interrupts.as_ctrl_c() as stopped, _warnings_as_lines():
                return int(super().main(*args, **options) or ExitCode.OK)
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else ExitCode.OK if end.code is None else ExitCode.FAILED
        except click.exceptions.NoArgsIsHelpError as asked:
            click.echo(asked.format_message())
            return ExitCode.OK
        except click.UsageError as error:
            message = in_plain_words(error)
            ended = message if message.endswith((".", "?", "?)")) else f"{message}."
            name = f" {self._asked.name}" if self._asked else ""
            return self._failed(f"{ended} See: truestroke{name} --help", ExitCode.USAGE)
        except SettingError as error:
            return self._failed(str(error), ExitCode.USAGE)
        except (click.ClickException, TruestrokeError) as error:
            return self._failed(str(error), _code_of(error))
        except OSError as error:
            return self._failed(f"{error.filename or 'file'}: {error.strerror or error}", ExitCode.FAILED)
        except (click.Abort, KeyboardInterrupt):
            code = system.exit_code(stopped[0]) if stopped else ExitCode.INTERRUPTED
            return complain("terminated" if stopped else "interrupted", code)


def in_plain_words(error: click.UsageError) -> str:
    """The message of a mistake on the command line: without options of another meaning, and with units for types."""
    if isinstance(error, click.NoSuchOption) and error.possibilities:
        bare = error.option_name.strip("-")  # that all begin with -- makes none alike
        alike = difflib.get_close_matches(bare, [one.strip("-") for one in error.possibilities])
        error = click.NoSuchOption(error.option_name, error.message, [f"--{one}" for one in alike])
    param = getattr(error, "param", None)
    message, metavar = error.format_message(), getattr(param, "metavar", None)
    if isinstance(error, click.MissingParameter) and param is not None:
        says = inputs.MAKERS.get(param.name or "") or getattr(param, "help", None)
        message = f"{message.rstrip('.')}: {says.rstrip('.')}." if says else message
    if (extra := re.search(r"unexpected extra argument \((\S+)\)", message)) and error.ctx is not None:
        named = inputs.option_of(error.ctx.command, extra[1])
        message = f"{message.rstrip('.')}; did you mean {named} {extra[1]}?" if named else message
    unit = UNITS.get(metavar or "")
    if outside := re.search(r"(\S+) is not in the range .*", message):
        message = f"{message[: outside.start()]}{_outside(float(outside[1]), param, unit)}"
    asked = f", in {unit} and without the unit" if unit else ""
    return re.sub(
        r"is not a valid (?:float|(integer))(?: range)?",
        lambda found: f"is no {'whole ' if found[1] else ''}number{asked}",
        message,
    )


def _outside(value: float, param: Any, unit: str | None) -> str:
    """What is said of a number that is outside of the range of its option."""
    low, high, ending = param.type.min, param.type.max, f" {unit}" if unit else ""
    bounds = f"{low:.10g}{ending} or more" if high is None else f"from {low:.10g} to {high:.10g}{ending}"
    return f"{value:.10g}{ending} must be {bounds}"


def _code_of(error: BaseException | None) -> int:
    """Of an error, or of what it came from: some have one of their own, for scripts that wait for it."""
    while error is not None:
        if isinstance(error, truestroke.DriverError):
            return ExitCode.DRIVER
        if isinstance(error, truestroke.BadModelError):
            return ExitCode.NOT_TRACKING
        error = error.__cause__
    return ExitCode.FAILED


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """What a run warns of before it begins, as a line on stderr, in the words of the command that is called."""
    from truestroke.control.feasibility import LimitWarning

    others, shown = warnings.showwarning, (LimitWarning, LatenessWarning, ModelWarning)

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if not issubclass(category, shown):
            others(message, category, *where, **more)
            return
        click.echo(f"truestroke: {notice(str(message))}", err=True)

    with warnings.catch_warnings():
        for category in shown:
            warnings.simplefilter("always", category)
        warnings.showwarning = show
        yield


def notice(text: str) -> str:
    """What is said before a run, with the options of the command that is called in place of arguments of Python."""
    from truestroke.control.feasibility import LOWER, NAMES

    context = click.get_current_context(silent=True)
    if context is None:
        return text
    if NAMES["slew"] not in context.params:
        text = text.replace(LOWER.format(NAMES["slew"]), "; a slower motion keeps the default")
    for name in NAMES.values():
        if name in context.params:
            text = text.replace(name, f"--{name.replace('_', '-')}")
    return text


def in_words_of(command: click.Command | None, text: str, quote: str = "") -> str:
    """A text of the library as a reader of the command line knows it: `name` of an argument becomes its option or NAME.

    So does the name that a `SettingError` begins with. Options in place of names in backticks are between `quote`.
    """
    params = command.params if command else []
    names = {one.name: one.opts[0] for one in params if isinstance(one, click.Option)}
    names |= {one.name: one.opts[0].upper() for one in params if isinstance(one, click.Argument) and not one.metavar}

    def option(match: re.Match[str]) -> str:
        name = match[1] or match[2]
        known = names.get(name) or names.get(ALIASES.get(name, name))
        if match[1] is None:
            return known or match[0]
        return f"{quote}{known or name}{quote}"

    return re.sub(r"`([a-z_]+)`|^([a-z_]+)(?= = )", option, text)


def complain(message: str, code: int = ExitCode.FAILED) -> int:
    """One line on stderr; the exit code."""
    click.echo(f"truestroke: {' '.join(message.split())}", err=True)
    return code


@contextmanager
def stoppable() -> Iterator[None]:
    """A run that was interrupted or failed, of which nothing is kept."""
    try:
        yield
    except truestroke.RunInterrupted as stop:
        if isinstance(stop.__cause__, KeyboardInterrupt):
            raise click.Abort from None
        raise click.ClickException(str(stop)) from stop


# ---- Options -------------------------------------------------------------------------------------------------------


def options(*several: Option) -> Option:
    """These options as one decorator, in the order of the help."""
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(several), command)


def _as_plots(context: click.Context, _: click.Parameter, folder: Path | None) -> None:
    if folder is not None:
        context.default_map = {"plots": folder}


def _permit(context: click.Context, _: click.Parameter, yes: bool) -> None:
    if yes:
        context.with_resource(files.overwriting())


def _to_fill(_: click.Context, parameter: click.Parameter, folder: Path | None) -> Path | None:
    """The folder that an option names; an error now rather than after the run if it can be neither made nor filled."""
    if folder is not None:
        there = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
        if not there.is_dir() or not _can_be_filled(there):
            why = "cannot be written" if there.is_dir() else "is a file"
            raise click.ClickException(f"{parameter.opts[0]} {folder}: {there} {why}; choose another folder.")
        require_space(parameter.opts[0], folder, there)
    return folder


def _can_be_filled(folder: Path) -> bool:
    """Whether a file can be made in it: what permissions say is not all, as of /proc."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


FOLDER = click.Path(file_okay=False, path_type=Path)
plots_option = options(
    click.option("--figures", type=FOLDER, hidden=True, is_eager=True, expose_value=False, callback=_as_plots),
    click.option(
        "--plots", type=FOLDER, metavar="FOLDER", callback=_to_fill, help="Also write each plot as PNG, light and dark."
    ),
)
overwrite_option = click.option("--overwrite", is_flag=True, expose_value=False, callback=_permit,
                                help="Replace existing files, of any origin.")  # fmt: skip
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
force_option = click.option("--force", is_flag=True,
                            help="Use a record that contradicts itself: units, clock, columns, shifts.")  # fmt: skip
page_options = options(plots_option, overwrite_option, json_option)
record_options = options(  # RECORD, and how `truestroke.read_record` reads it
    click.argument("record", type=FILE),
    click.option("--volts", metavar="COLUMN", help="Column of the voltage: its name, or its number from 1."),
    click.option("--displacement", metavar="COLUMN", help="Column of the displacement."),
    click.option("--time", metavar="COLUMN", help="Column of the time stamps."),
    click.option("--volts-unit", metavar="UNIT", help="V, mV, uV or kV.  [default: as the file says, else V]"),
    click.option("--displacement-unit", metavar="UNIT", help="um, nm, mm or m.  [default: as the file says, else um]"),
    click.option(
        "--time-unit", metavar="UNIT", help="s, ms, us, ns, min, h or day.  [default: as the file says, else s]"
    ),
    click.option(
        "--volts-scale", metavar="V", type=float, help="V for one of the column, such as 10 of a monitor of 1:10."
    ),
    click.option(
        "--displacement-scale",
        metavar="UM",
        type=float,
        help="um for one of the column, such as um/V of a sensor in V.",
    ),
    click.option("--sample-rate", metavar="HZ", type=float, help="Where there is no column of time stamps."),
    click.option("--flip-displacement", is_flag=True, help="Turn its sign: it falls as the voltage rises."),
    click.option("--drop-bad-rows", is_flag=True, help="Leave out rows without usable numbers or time stamps."),
)


def examined(record: truestroke.Record, force: bool) -> truestroke.Findings:
    """What `examine` finds; a RecordError where the record contradicts itself, unless `force`."""
    from truestroke.identification.examination import mistakes

    findings = truestroke.examine(record)
    if not force:
        mistakes.refuse(findings)
    return findings


def outputs(output: str, *endings: str, option: str = "--output") -> list[Path]:
    """The files to write, one for each of `endings`; an error now rather than after the run if they cannot be.

    `option` is what names them, for the error. A recording ends with .hdf5 in place of .h5 where `output` does.
    """
    stem = Path(output)
    if stem.suffix == ".hdf5":
        endings = tuple(".hdf5" if ending == ".h5" else ending for ending in endings)
    if stem.suffix in (".h5", ".hdf5", ".html"):
        stem = stem.with_suffix("")
    if not stem.name or stem.is_dir():
        raise click.UsageError(f"{option} {output}: is a folder; add a name, such as {stem / 'run1'}.")
    places = [stem.with_name(stem.name + ending) for ending in endings]
    for folder in filter(Path.is_dir, places):
        raise click.ClickException(f"{option} {output}: {folder} cannot be written; choose another {option}.")
    return [to_write(option, place, _kind(place.suffix)) for place in places]


def require_space(option: str, file: str | Path, folder: Path, needed: float = SPACE) -> None:
    """An error now rather than later where the disk of a folder has less space than this, bytes."""
    disk = shutil.disk_usage(folder)
    if disk.total > 0 and disk.free < needed:  # some file systems state no size
        free = f"{disk.free / 1e6:.1f} MB are free on its disk, {needed / 1e6:.0f} MB are needed"
        raise click.ClickException(f"{option} {file}: {free}; choose another folder, or delete something.")


def to_write(option: str, file: str | Path, kind: files.Kind, needed: float = SPACE) -> Path:
    """The file that an option names; an error now rather than later if it cannot be written.

    `needed` is the free space of its disk, bytes.
    """
    path = Path(file)
    if path.is_dir():
        raise click.UsageError(f"{option} {file}: is a folder; name a file.")
    if not path.parent.is_dir():
        made = system.command_line(*system.MAKE_FOLDER, path.parent)
        raise click.ClickException(f"{option} {file}: there is no folder {path.parent}; make it: {made}")
    if not (os.access(path, os.W_OK) if path.exists() else _can_be_filled(path.parent)):
        raise click.ClickException(f"{option} {file}: cannot be written; choose another {option}.")
    require_space(option, file, path.parent, needed)
    _refuse_an_input(option, path)
    try:
        files.check(path, kind)
    except files.FileError as error:
        raise click.UsageError(f"{option} {error}.") from None
    return path


def _refuse_an_input(option: str, path: Path) -> None:
    """An output that is a file which the command reads is replaced on request only."""
    context = click.get_current_context(silent=True)
    if context is None or files.replacing() or not path.exists():
        return
    for parameter in context.command.params:
        given, argument = context.params.get(parameter.name or ""), isinstance(parameter, click.Argument)
        reads = argument or (isinstance(parameter.type, click.Path) and parameter.type.exists)
        if reads and isinstance(given, str | Path) and Path(given).is_file() and path.samefile(given):
            name = (parameter.name or "").upper() if argument else parameter.opts[0]
            another = f"such as {path.stem}-2{path.suffix}, or --overwrite it"
            replaced = f"would replace the file that {name} names; choose another name, {another}."
            raise click.UsageError(inputs.mistaken(context) or f"{option} {path}: {replaced}")


def _kind(ending: str) -> files.Kind:
    """What the command that is called writes into a file with this ending."""
    from truestroke.signals import recording

    if ending in (".h5", ".hdf5"):
        return recording.kind({"command": f"truestroke {click.get_current_context().info_name}"})
    if ending == ".html":
        return files.page(click.get_current_context().info_name or "")
    return {".toml": files.MODEL, ".sqlite": files.STORE}[ending]


def as_asked() -> dict[str, Any]:
    """For a recording: the options, and the command that repeats them, without those that name files."""
    options = {name: value for name, value in click.get_current_context().params.items() if name not in FILES}
    return {"command": _command(FILES), "options": options}


def to_repeat() -> str:
    """For a page: the command that writes it and what it is about again, to the same names."""
    return _command([name for name in FILES if name != "output"])


def _command(without: Collection[str]) -> str:
    """The command as it was called, but for some of its options."""
    context = click.get_current_context()
    words = ["truestroke", context.info_name or ""]
    for parameter in context.command.params:
        name, value = parameter.name or "", context.params.get(parameter.name or "")
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE and name not in without:
            words += _words(parameter, value)
    return system.command_line(*words)


def _words(parameter: click.Parameter, value: Any) -> list[str]:
    """An argument or an option as it was typed: without a value where it is a switch, again for each of several."""
    if getattr(parameter, "is_flag", False):
        return [parameter.opts[0]]
    values = value if isinstance(value, tuple) else (value,)
    name = [] if isinstance(parameter, click.Argument) else [parameter.opts[0]]
    texts = [str(one).removesuffix(".0") for one in values]
    return [word for text in texts for word in (*name, text)] if parameter.multiple else [*name, *texts]


# ---- What is written and printed -----------------------------------------------------------------------------------


def save_page(page: Page, file: Path, plots: Path | None) -> list[str]:
    """Write a page, whose verdict names options, and, where a folder is given, its plots; the paths of these."""
    if page.verdict is not None:
        command = click.get_current_context().command
        reasons = tuple(in_words_of(command, reason, quote="`") for reason in page.verdict.reasons)
        page = dataclasses.replace(page, verdict=Verdict(page.verdict.level, reasons))
    page.save(file)
    return [str(path) for path in page.save_plots(plots)] if plots else []


def foretell(what: str, seconds: float, as_json: bool = False) -> None:
    """Before it begins, a line on stderr that says how long it takes, where that is long."""
    if seconds > LONG and not as_json:
        print_text(f"{what} {display.duration(seconds)}.", err=True)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None] | None]:
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


def console() -> Console:
    """Where tables go: as wide as the terminal, else of `PIPE_WIDTH` columns or of the variable COLUMNS."""
    from rich.console import Console

    terminal = Console(highlight=False)
    return terminal if terminal.is_terminal or "COLUMNS" in os.environ else Console(highlight=False, width=PIPE_WIDTH)


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str | Text]], dim: str = "", left: str = "") -> None:
    """First column left, the others right, then an empty line; a rule under the head where there is a terminal.

    A narrow terminal wraps the first column only. If that is not enough rows become columns, where these are narrower;
    no cell is ever cut off. Columns named `dim` are dimmed; one named `left` is aligned left, too.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    terminal = console()
    box, gap = (SIMPLE_HEAD, GAP - 1) if terminal.is_terminal else (None, GAP)
    edges = 2 if box else 0
    head, rows = _turned(columns, rows, terminal.width - edges)
    terminal.width = max(terminal.width, _least(head, rows) + edges)
    table = Table(box=box, pad_edge=False, padding=(0, gap, 0, 0))
    for i, name in enumerate(map(str, head)):
        side: Literal["left", "right"] = "right" if i and name != left else "left"
        table.add_column(Text(name), justify=side, style="dim" if name == dim else None, no_wrap=i > 0)
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))  # no markup
    terminal.print(table)
    if not terminal.is_terminal:  # where the box ends with one
        click.echo()


Cells = Sequence[Sequence["str | Text"]]


def _turned(columns: Sequence[str | Text], rows: Cells, width: int) -> tuple[Sequence[str | Text], Cells]:
    """Columns and rows, or these exchanged where a table does not fit and is narrower that way."""
    head, *lines = zip(columns, *rows, strict=True)
    least = _least(columns, rows)
    return (head, lines) if width < least and _least(head, lines) < least else (columns, rows)


def _least(columns: Sequence[str | Text], rows: Cells) -> int:
    """Characters of a table whose first column is as narrow as its longest word, and whose others are whole."""
    from rich.cells import cell_len

    first, *others = zip(columns, *rows, strict=True)
    words = (cell_len(word) for cell in first for word in str(cell).split())
    return max(words, default=0) + sum(GAP + max(cell_len(str(cell)) for cell in column) for column in others)


def print_verdict(verdict: Verdict, reasons: bool = True) -> None:
    """The verdict in a word, in colour where there is a terminal, and each reason behind it, wrapped."""
    from rich.text import Text

    style = {"good": "green", "doubtful": "bold yellow", "bad": "bold white on red"}[verdict.level]
    word = verdict.level.upper() if verdict.is_bad else verdict.level
    console().print(Text.assemble(f"{'verdict':10} ", (word, style)))
    context = click.get_current_context(silent=True)
    for reason in verdict.reasons if reasons else ():
        reason = in_words_of(context.command if context else None, reason)
        click.echo(click.wrap_text(reason, _width(), initial_indent=" " * 11, subsequent_indent=" " * 11))


def print_text(text: str, *, err: bool = False) -> None:
    """A paragraph, wrapped, in the words of the command that is called; on stderr where `err`."""
    context = click.get_current_context(silent=True)
    text = in_words_of(context.command if context else None, text)
    click.echo(click.wrap_text(text, _width()), err=err)


def _width() -> int:
    return min(PIPE_WIDTH, shutil.get_terminal_size((PIPE_WIDTH, 24)).columns)


def print_json(value: Mapping[str, Any]) -> None:
    """One object on one line."""
    click.echo(json.dumps(_finite(value)))


def _finite(value: Any) -> Any:
    """JSON knows neither infinity nor NaN: they become null."""
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_files(**files: Path | None) -> None:
    """What was written, a line each: name, path."""
    for name, path in files.items():
        if path is not None:
            click.echo(f"{name:10} {path}{os.sep if path.is_dir() else ''}")


def activity(as_json: bool) -> Callable[[str], None]:
    """Shows what is being done, in one line of a terminal that the next output takes."""
    shown = sys.stderr.isatty() and not as_json
    return lambda what: click.echo(f"\r\x1b[K{what} ...\r", nl=False, err=True) if shown else None


def print_simulated(config: Path | None, what: str = "stage") -> None:
    """A line where nothing but a simulation was driven: its files are of no use for another one."""
    if config is None:
        click.echo(f"{what:10} simulated; --config FILE drives yours")


def suggest(*commands: tuple[str, str]) -> None:
    """Commands worth typing next, each with what it shows."""
    width = max(len(command) for command, _ in commands)
    click.echo("\nOpen the page in a browser. What next:")
    for command, shows in commands:
        click.echo(f"  {program()} {command:{width}}  {shows}")


def program() -> str:
    """How a reader of this terminal calls truestroke: by its name, or by its path where that is not on the PATH."""
    called = Path(sys.argv[0])
    if called.name == "__main__.py":
        return "python -m truestroke"
    if called.stem != "truestroke" or shutil.which("truestroke"):
        return "truestroke"
    path = Path(os.path.abspath(called))  # and not resolve(): a link may lead out of the environment
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else called)
