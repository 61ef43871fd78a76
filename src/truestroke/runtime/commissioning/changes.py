"""What was found, into the configuration: comments and order stay, the file as it was stays beside it."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from truestroke.base import files
from truestroke.base.checks import SettingError

CONFIGURATION = files.Kind("a configuration", lambda path: True)  # as it was it stays beside it

Changes = Mapping[tuple[str, str], tuple[float, str]]
"""("axis" or "driver", key) to the value and what it is, with unit."""


def changed(text: str, changes: Changes) -> str:
    r"""The text of a configuration with one [[axis]], with these values.

    Raises
    ------
    SettingError
        The text cannot be changed by these keys alone.

    Examples
    --------
    >>> text = "[[axis]] # of the stage\nname = 'x'\n[axis.trajectory]\nkind = 'sine'\n"
    >>> print(changed(text, {("axis", "stroke"): (30.0, "um")}).partition(" # um")[0])
    [[axis]] # of the stage
    name = 'x'
    stroke = 30.0
    """
    import tomlkit

    document = tomlkit.parse(text)
    wanted = tomllib.loads(text)
    for (table, key), (value, what) in changes.items():
        given: Any = document["axis"][0] if table == "axis" else document[table]
        item = tomlkit.item(value)
        item.comment(f"{what}, found by truestroke commission on {date.today():%Y-%m-%d}")
        given[key] = item
        (wanted["axis"][0] if table == "axis" else wanted[table])[key] = value
    new = tomlkit.dumps(document)
    if tomllib.loads(new) != wanted:
        raise SettingError("the configuration", "its form", "one that takes new keys: write them by hand")
    return new


def write(path: Path, changes: Changes) -> Path:
    """Change the configuration at `path`; where the file as it was now is.

    It is replaced at once and as a whole; FILE.bak, or FILE.bak1 and so on, is the file as it was.

    Raises
    ------
    SettingError, OSError
        It cannot be changed; it is as it was.
    """
    path = path.resolve()
    old = path.read_bytes().decode("utf-8")
    new = changed(old, changes)
    backup = _beside(path, old)
    with files.writing(path, CONFIGURATION) as draft:
        draft.write_text(new, encoding="utf-8", newline="")
    return backup


def _beside(path: Path, text: str) -> Path:
    """A copy under a name that no file had."""
    number = 0
    while True:
        backup = path.with_name(f"{path.name}.bak{number or ''}")
        try:
            with backup.open("x", encoding="utf-8", newline="") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            return backup
        except FileExistsError:
            number += 1
