"""The files of an export from their templates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

TEMPLATES = Path(__file__).with_name("templates")


def rendered(files: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, str]:
    """The text of each file by its name; `files` has the template of each, without .j2."""
    import jinja2

    engine = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATES), undefined=jinja2.StrictUndefined,
                                keep_trailing_newline=True, autoescape=False)  # fmt: skip
    return {name: engine.get_template(f"{template}.j2").render(values) for name, template in files.items()}
