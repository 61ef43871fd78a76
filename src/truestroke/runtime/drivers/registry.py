"""Drivers by name: each is an entry point of the group `truestroke.drivers`, of this package or of another."""

import functools
import importlib.metadata
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from truestroke.base.checks import SettingError

GROUP = "truestroke.drivers"


@dataclass(frozen=True)
class Need:
    """What a driver, or another part, needs of this computer beside truestroke: a package or a library."""

    what: str
    why: str  # what it is for
    found: Callable[[], str]  # its version or place; "" where it is missing
    command: str  # what installs it


def package(name: str, why: str) -> Need:
    """A package of Python, in the versions that the extras of truestroke name."""
    lines = importlib.metadata.requires("truestroke") or []
    asked = (line.partition(";")[0].strip() for line in lines)
    wanted = next((line for line in asked if re.match(rf"{name}(?![\w-])", line)), name)
    return Need(name, why, functools.partial(_version, name), f'{sys.executable} -m pip install "{wanted}"')


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""


def names() -> tuple[str, ...]:
    """Those that are installed."""
    return tuple(sorted({entry.name for entry in importlib.metadata.entry_points(group=GROUP)}))


def find(name: str) -> Any:
    """The class of a driver; its attribute `Settings` is the dataclass of its settings, `needs` what it needs.

    Raises
    ------
    SettingError
        There is none of that name, or it cannot be imported.

    Examples
    --------
    >>> find("simulated").Settings().sample_rate
    2000.0
    """
    entries = _entries(name) if isinstance(name, str) else ()
    if not entries:
        known = ", ".join(names()) or "none: install truestroke again, for its entry points are missing"
        raise SettingError("name", repr(name), f"one of {known}")
    try:
        return next(iter(entries)).load()
    except (ImportError, AttributeError) as error:
        raise SettingError("name", repr(name), f"a driver that can be imported ({error})") from error


def _entries(name: str) -> importlib.metadata.EntryPoints:
    """Of that name: those of this package first; to look through 250 packages took a twentieth of a command's start."""
    try:
        ours = importlib.metadata.distribution("truestroke").entry_points.select(group=GROUP, name=name)
    except importlib.metadata.PackageNotFoundError:
        ours = importlib.metadata.EntryPoints()
    return ours or importlib.metadata.entry_points(group=GROUP, name=name)
