"""What GitHub shows and Sphinx does not: a `<picture>` with a light and a dark image."""

from __future__ import annotations

import re

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform


class Pictures(SphinxTransform):
    """Each `<picture>` becomes two images; the style sheet shows that of the reader's theme."""

    default_priority = 200  # before Sphinx collects the images

    def apply(self) -> None:
        """Replace the raw HTML."""
        for raw in list(self.document.findall(nodes.raw)):
            if "<picture" in raw.astext():
                raw.replace_self(images(raw.astext()))


def images(html: str) -> list[nodes.image]:
    """The light and the dark image of a `<picture>`."""
    dark = re.search(r'<source[^>]*\bsrcset="([^"]+)"', html, re.DOTALL)
    light = re.search(r'<img[^>]*\bsrc="([^"]+)"', html, re.DOTALL)
    words = re.search(r'<img[^>]*\balt="([^"]+)"', html, re.DOTALL)
    if not (dark and light and words):
        raise ValueError(f"a <picture> needs a dark source, an image and its alt text: {html}")
    places = {"only-light": light[1], "only-dark": dark[1]}
    return [nodes.image(uri=uri, alt=words[1], classes=[theme]) for theme, uri in places.items()]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(Pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
