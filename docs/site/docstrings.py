"""Docstrings as they are written here: in single backticks code, and a link where it is a public name."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxRole
from sphinx.util.inspect import TypeAliasForwardRef

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


def readable(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """A default that is made, or a function without a name, is `...`: Sphinx parses no other, and then cuts no type."""
    return arguments and re.sub("<factory>|<function <lambda>>", "...", arguments), returns


def setup(app: Sphinx) -> dict[str, int]:
    """Register the role, which `default_role` selects, the escapes and the signatures."""
    app.add_role("name", Name())
    app.connect("autodoc-process-docstring", as_rest, priority=400)  # before numpydoc
    app.connect("autodoc-process-signature", readable)
    TypeAliasForwardRef.__repr__ = lambda alias: alias.name  # what Sphinx writes of ArrayLike in a union, or a property
    return {"env_version": 2, "parallel_read_safe": True, "parallel_write_safe": True}
