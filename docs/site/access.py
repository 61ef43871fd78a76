"""What Sphinx and furo leave out for readers with a keyboard, a screen reader or a phone: focus, levels, options."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

OPTION = r"--?[A-Za-z][\w-]{,22}"  # --safe-voltage, -O3; a longer one would be wider than a phone


def accessible(html: str) -> str:
    """What scrolls can be reached with the keyboard; lines of a signature are no list; an option is not broken."""
    html = html.replace("<pre>", '<pre tabindex="0">')
    html = re.sub(
        r'<div class="table-wrapper', '<div tabindex="0" role="group" aria-label="table" class="table-wrapper', html
    )
    html = re.sub(r"<dl>\n((?:<dd><em class=\"sig-param\">.*</dd>\n)+)</dl>", signature, html)
    html = re.sub(rf'<span class="pre">({OPTION})</span>', r'<span class="pre option">\1</span>', html)
    html = html.replace('role="doc-biblioentry"', 'role="listitem"')  # the first is no longer a role of ARIA
    return html.replace('<p class="caption" role="heading">', '<p class="caption" role="heading" aria-level="2">')


def signature(found: re.Match[str]) -> str:
    """Each argument of a long signature on a line of its own."""
    lines = found[1].replace("<dd>", '<span class="sig-line">').replace("</dd>", "</span>")
    return f'<span class="sig-lines">{lines}</span>'


def improve(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    """The body of a page and its side bar, as they are about to be written."""
    for part in ("body", "furo_navigation_tree"):
        if part in context:
            context[part] = accessible(context[part])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the change, after that of furo."""
    app.connect("html-page-context", improve, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
