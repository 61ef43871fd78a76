"""Headings and the terms of the glossary in the general index: a reader without scripts finds what the search finds."""

from __future__ import annotations

import re

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

UNLISTED = ("python/", "decisions/", "changelog")  # the first has entries of its own


def entry(words: str, anchor: str) -> addnodes.index:
    """An entry of the general index that leads to the anchor."""
    return addnodes.index(entries=[("single", re.sub(r"[;!|]", ",", words), anchor, "", None)])


class Keywords(SphinxTransform):
    """Each section of a page is an entry of the index, under its own words, and so is each row of the glossary."""

    default_priority = 400

    def apply(self) -> None:
        """Put the entries where they lead to."""
        if self.env.docname.startswith(UNLISTED):
            return
        for section in self.document.findall(nodes.section):
            title = section.next_node(nodes.title)
            if title is not None and section["ids"]:
                section.insert(section.index(title) + 1, entry(title.astext(), section["ids"][0]))
        if self.env.docname == "glossary":
            for body in self.document.findall(nodes.tbody):
                for row in body.findall(nodes.row):
                    self.add_term(row)

    def add_term(self, row: nodes.row) -> None:
        """A row of the glossary: its term, or terms with commas between them."""
        cell = row[0]
        term = cell.astext()
        cell["ids"].append("term-" + nodes.make_id(term))
        cell.extend(entry(word, cell["ids"][0]) for word in term.split(", "))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(Keywords)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
