"""One line of the doctor's table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class Level(StrEnum):
    """How it stands."""

    OK = "ok"
    WARNING = "warning"
    MISSING = "missing"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was looked at, and what helps.

    Attributes
    ----------
    level : Level
        OK; WARNING: there, but it may hurt; MISSING: not there.
    part : str
        What it belongs to: "drivers", "real time", "disk", "configuration".
    what : str
        What was looked at.
    found : str
        What was found, with unit.
    why : str
        Why it matters.
    command : str
        What installs or repairs it; empty where nothing need be done, or no command does it.
    required : bool
        Whether the configuration cannot be run without it.
    """

    level: Level
    part: str
    what: str
    found: str
    why: str
    command: str = ""
    required: bool = False


def read(path: str) -> str:
    """The text of a file of the system, empty where there is none."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
