"""One line of the doctor's table."""

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """The result of a check."""

    OK = "ok"
    WARNING = "warning"
    MISSING = "missing"


@dataclass(frozen=True)
class Finding:
    """What was looked at, and what helps.

    Attributes
    ----------
    part : str
        What it belongs to: "drivers", "real time", "permissions", "configuration".
    what : str
        What was looked at.
    why : str
        Why it matters.
    found : str
        What was found, with unit.
    level : Level
        OK; WARNING: present, but it may cause late ticks; MISSING: not present.
    command : str
        What installs or repairs it; dropped where it is OK; empty where no command does it.
    required : bool
        Whether the configuration cannot be run without it.
    """

    part: str
    what: str
    why: str
    found: str
    level: Level = Level.OK
    command: str = ""
    required: bool = False

    def __post_init__(self) -> None:
        if self.level is Level.OK:
            object.__setattr__(self, "command", "")
