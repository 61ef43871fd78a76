"""Files that a command was given in the place of others: known by what is in them, once the command has failed."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import click

from truestroke.base import files

MAKERS = {  # of a file, by the option that takes it
    "config": "`truestroke run --example` prints one",
    "model": "`truestroke identify` writes it",
    "dynamics": "`truestroke bode` writes it",
    "waveform": "`truestroke invert` writes it",
    "recording": "`truestroke run` or `truestroke track` writes it",
}
MODEL, DYNAMICS, CONFIGURATION = "a model", "a file of dynamics", "a configuration"
TABLE, RECORDING, IMAGE = "a table of numbers", "a recording", "an image"
WANTED = {
    "model": (MODEL,),
    "model_y": (MODEL,),
    "dynamics": (DYNAMICS,),
    "settle": (DYNAMICS,),
    "config": (CONFIGURATION,),
    "record": (TABLE, RECORDING),
    "trajectory": (TABLE,),
    "waveform": (TABLE,),
    "lines": (TABLE,),
    "image": (IMAGE,),
    "retrace": (IMAGE,),
    "recording": (RECORDING,),
    "recordings": (RECORDING,),
    "state": (RECORDING,),
}
"""What the parameter of each name takes."""
HEAD = 20_000  # bytes of a file that are looked at
ROW = re.compile(rb"^[ \t]*[-+.\d][-+.\deE]*(?:[ \t]*[,;\t ][ \t]*[-+.\d][-+.\deE]*)*[ \t]*\r?$", re.MULTILINE)
ROWS = 2  # of numbers, at least, in a table
Given = tuple[click.Parameter, Path]


def note(context: click.Context | None, parameter: click.Parameter | None, path: Path) -> None:
    """Remember a file that a command reads."""
    if context is not None and parameter is not None:
        context.meta.setdefault(__name__, []).append((parameter, path))


def preferred(parameter: click.Parameter | None, paths: list[Path]) -> Path | None:
    """The first of the files that is of a kind that the parameter takes, else the first one."""
    fitting = (path for path in paths if parameter is not None and kind_of(path) in _wanted((parameter, path)))
    return next(fitting, paths[0] if paths else None)


def option_of(command: click.Command, word: str) -> str:
    """The option of a command that takes a word: one of its choices, or a file of its kind; empty where none does."""
    kind = kind_of(Path(word))
    for one in command.params:
        choices = one.type.choices if isinstance(one.type, click.Choice) else (one.metavar or "").strip("[]").split("|")
        if isinstance(one, click.Option) and (word in choices or (kind and kind in WANTED.get(one.name or "", ()))):
            return one.opts[0]
    return ""


def mistaken(context: click.Context) -> str:
    """Which files of the command are of another kind than it takes there, with the remedy; empty where none is."""
    given: list[Given] = context.meta.get(__name__, [])
    kinds = {path: kind_of(path) for _, path in given}
    wrong = [one for one in given if kinds[one[1]] and kinds[one[1]] not in _wanted(one)]
    for first, second in itertools.combinations(wrong, 2):
        if kinds[first[1]] in _wanted(second) and kinds[second[1]] in _wanted(first):
            return f"{_named(first)} is {kinds[first[1]]}, {_named(second)} is {kinds[second[1]]}: exchange them."
    if not wrong:
        return ""
    parameter, path = wrong[0]
    maker = MAKERS.get(parameter.name or "", "")
    return f"{_named(wrong[0])} is {kinds[path]}; it must be {' or '.join(_wanted(wrong[0]))}{maker and f': {maker}'}."


def kind_of(path: Path) -> str:
    """What a file holds, or nothing where that is not certain."""
    from truestroke.base import hdf5
    from truestroke.signals.scans.image_files import ENDINGS

    if path.suffix.lower() in ENDINGS:
        return IMAGE
    try:
        if files.MODEL.ours(path):
            return MODEL
        if files.DYNAMICS.ours(path):
            return DYNAMICS
        with path.open("rb") as file:
            head = file.read(HEAD)
    except OSError:
        return ""
    if head.startswith(hdf5.SIGNATURE):
        return RECORDING
    if re.search(rb"^\[driver\]", head, re.MULTILINE) and b"[[axis]]" in head:
        return CONFIGURATION
    return TABLE if b"\0" not in head and len(ROW.findall(head)) >= ROWS else ""


def _wanted(one: Given) -> tuple[str, ...]:
    """Kinds that its place takes; of a place without a kind that of the file itself."""
    parameter, path = one
    return WANTED.get(parameter.name or "") or (kind_of(path),)


def _named(one: Given) -> str:
    parameter, path = one
    name = parameter.opts[0] if isinstance(parameter, click.Option) else (parameter.name or "").upper()
    return f"{name} {path}"
