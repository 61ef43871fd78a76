"""The texts that follow from the declaration of the settings: the table of docs/settings.md, the types of keywords.

    python tests/settings_texts.py

writes both anew. A test compares them with the declaration.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from truestroke.control.settings import SETTINGS, ControllerSettings

ROOT = Path(__file__).parents[1]
PAGE, OPTIONS = ROOT / "docs/settings.md", ROOT / "src/truestroke/control/options.py"
FIELDS = {field.name: field for field in dataclasses.fields(ControllerSettings)}
HEAD = ("setting", "unit", "meaning", "default", "bound", "law", "changeable", "kernel")


def table() -> str:
    """The settings as rows of Markdown."""
    rows = [HEAD, ("---",) * len(HEAD)]
    for setting in ControllerSettings(sample_rate=1.0, stroke=1.0, voltage_limits=(0.0, 1.0)).describe():
        shown = {
            "setting": f"`{setting['name']}`",
            "unit": setting["unit"] or "-",
            "changeable": "yes" if setting["changeable"] else "-",
            "kernel": ", ".join(f"`{member}`" for member in setting["kernel"]) or "-",
        }
        rows.append(tuple(str({**setting, **shown}[column]) for column in HEAD))
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def options() -> str:
    """Keywords of controllers as `TypedDict`s: those that may change while running, and all but the three first."""
    lines = [
        '"""Keywords of controllers for type checkers; written by tests/settings_texts.py from the declaration."""\n',
        "from typing import Literal, TypedDict\n\n"
        "from truestroke.control.feedback import Feedback\n"
        "from truestroke.model.dynamics import Dynamics\n\n",
        "class ChangeableOptions(TypedDict, total=False):",
        '    """Members of `ControllerSettings` that may change while running, but `voltage_limits`."""\n',
    ]
    own = [name for name in SETTINGS if name not in ("sample_rate", "stroke", "voltage_limits")]
    types = {name: f"{FIELDS[name].type}{' | None' if SETTINGS[name].rule else ''}".replace("'", '"') for name in own}
    lines += [f"    {name}: {types[name]}" for name in own if SETTINGS[name].changeable]
    lines += ["\n\nclass SettingsOptions(ChangeableOptions, total=False):"]
    lines += ['    """Members of `ControllerSettings` but the three that are needed."""\n']
    lines += [f"    {name}: {types[name]}" for name in own if not SETTINGS[name].changeable]
    return "\n".join(lines) + "\n"


def page() -> str:
    """docs/settings.md with the table of now."""
    return re.sub(r"^\| setting .*?\n(?!\|)", lambda _: table(), PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)


if __name__ == "__main__":
    OPTIONS.write_text(options())
    PAGE.write_text(page())
