"""The files of an export from their templates."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jinja2

TEMPLATES = Path(__file__).with_name("templates")


def rendered(files: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, str]:
    """The text of each file by its name; `files` has the template of each, without .j2."""
    return {name: _engine().get_template(f"{template}.j2").render(values) for name, template in files.items()}


@cache
def _engine() -> jinja2.Environment:
    """It keeps what it has compiled."""
    import jinja2

    return jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATES), undefined=jinja2.StrictUndefined,
                              keep_trailing_newline=True, autoescape=False)  # fmt: skip
