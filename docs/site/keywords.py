"""Headings in the general index, so that a reader without scripts finds what the search finds."""

from __future__ import annotations

import re

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform


class Headings(SphinxTransform):
    """Each section of a page is an entry of the index, under its own words."""

    default_priority = 400

    def apply(self) -> None:
        """Put an index entry before each section's title."""
        if self.env.docname.startswith(("api/", "decisions/", "changelog")):
            return
        for section in self.document.findall(nodes.section):
            title = section.next_node(nodes.title)
            if title is None or not section["ids"]:
                continue
            words = re.sub(r"[;!|]", ",", title.astext())
            entry = addnodes.index(entries=[("single", words, section["ids"][0], "", None)])
            section.insert(section.index(title) + 1, entry)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(Headings)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
