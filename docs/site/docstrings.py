"""Docstrings as they are written here: in single backticks code, and a link where it is a public name."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxRole

import truestroke


class Name(SphinxRole):
    """Code; a link where it is a public name, `AdaptiveController`, and not where it is an argument."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """The node of the text."""
        shown = nodes.literal(self.text, self.text, classes=["code"])
        name = self.text.removeprefix("truestroke.").removesuffix("()")
        if name.partition(".")[0] not in truestroke.__all__:
            return [shown], []
        link = addnodes.pending_xref(
            "", shown, refdomain="py", reftype="obj", reftarget=f"truestroke.{name}", refwarn=False, refexplicit=True
        )
        return [link], []


def as_rest(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Escape what docutils takes for markup: |dz/dt|, and a backtick before a power."""
    for i, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")) and "``" not in line:
            lines[i] = re.sub(r"(`[^`]+`)(?=[\w^])", r"\1\\ ", line.replace("|", r"\|"))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the role, which `default_role` selects, and the escapes."""
    app.add_role("name", Name())
    app.connect("autodoc-process-docstring", as_rest, priority=400)  # before numpydoc
    return {"parallel_read_safe": True, "parallel_write_safe": True}
