"""The side bar of pages that it does not list, as those of decisions are, is made once for all of a folder."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sphinx.application import Sphinx


class Once:
    """What Sphinx's `toctree` gives for such a page: no mark of the page itself, and the links of its folder."""

    def __init__(self) -> None:
        self.made: dict[tuple[object, ...], str] = {}

    def __call__(self, app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
        """What `html-page-context` calls, before furo does."""
        make: Callable[..., str] | None = context.get("toctree")
        listed = app.builder.env.toctree_includes
        if make is None or page in listed or any(page in pages for pages in listed.values()):
            return

        def toctree(**options: object) -> str:
            key = (page.rpartition("/")[0], *sorted(options.items()))
            if key not in self.made:
                self.made[key] = make(**options)
            return self.made[key]

        context["toctree"] = toctree


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the change, before that of furo."""
    app.connect("html-page-context", Once(), priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
