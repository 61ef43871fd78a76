"""The examples and the tutorials as pages, pictures and notebooks."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

from examples.notebooks import cell, document

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def scripts() -> list[Path]:
    """The scripts of the examples, in their order."""
    return sorted(EXAMPLES.glob("[0-9]*.py"))


def title(script: Path) -> str:
    """What an example shows: its docstring."""
    return str(ast.get_docstring(ast.parse(script.read_text())))


def picture(script: Path) -> str:
    """Its picture, light and dark, as a page of the examples has it."""
    place = f"../images/examples/{script.stem}"
    image = f'<img alt="{title(script)}" src="{place}-light.png">'
    return f'<picture>\n<source srcset="{place}-dark.png">\n{image}\n</picture>\n'


def cards() -> str:
    """All examples by their pictures."""
    card = ":::{{grid-item-card}}\n:link: {}.html\n:link-type: url\n\n{}\n{}\n:::\n"
    each = [card.format(script.stem, picture(script), title(script)) for script in scripts()]
    return "\n".join(["::::{grid} 1 2 2 2\n:gutter: 3\n", *each, "::::\n"])


def example(script: Path, folder: Path) -> str:
    """The page of an example in `folder`: its picture, its cells, script and notebook to take."""
    _, *parts = re.split(r"^# %%(.*)\n", script.read_text(), flags=re.MULTILINE)
    files = (script, EXAMPLES / "notebooks" / f"{script.stem}.ipynb")
    links = ", ".join(f"[{file.name}]({os.path.relpath(file, folder)})" for file in files)
    lines = [f"# {title(script)}", "", picture(script), f"To take: {links}.", ""]
    for kind, text in zip(parts[::2], parts[1::2], strict=True):
        if "markdown" in kind:
            lines += [re.sub(r"^# ?", "", text, flags=re.MULTILINE).strip(), ""]
        else:
            lines += [f"```python\n{text.strip()}\n```", ""]
    return "\n".join(lines)


def notebook(page: str) -> str:
    """A page of Markdown as a notebook: blocks of Python are cells, and so are the commands of the terminal."""
    parts, end = [], 0
    for block in BLOCK.finditer(page):
        commands = re.findall(r"^\$ (truestroke .*)", block[2], flags=re.MULTILINE)
        if block[1] == "python" or (block[1] == "console" and commands):
            code = block[2] if block[1] == "python" else "\n".join(f"!{command}" for command in commands)
            parts += [("markdown", page[end : block.start()]), ("code", code)]
            end = block.end()
    parts.append(("markdown", page[end:]))
    shown = [(kind, unlinked(text).strip() if kind == "markdown" else text.strip()) for kind, text in parts]
    return document([cell(f"cell-{n}", kind, text) for n, (kind, text) in enumerate(shown) if text])


def unlinked(text: str) -> str:
    """The words of links to other pages, which a notebook does not have beside it."""
    return re.sub(r"\[([^\[\]]+)\]\((?!https?:)[^)\s]+\)", r"\1", re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL))
