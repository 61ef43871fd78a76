"""Make the notebooks of the examples anew: `python examples/notebooks.py`; a test holds them equal to the scripts."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

HERE = Path(__file__).parent
SCRIPTS = sorted(HERE.glob("[0-9]*.py"))


def notebook(script: Path) -> str:
    """The script as a notebook without outputs: its docstring is the title, each `# %%` begins a cell."""
    title, *parts = re.split(r"^# %%(.*)\n", script.read_text(), flags=re.MULTILINE)
    cells = [cell(f"{script.stem[:2]}-0", "markdown", f"# {ast.literal_eval(title)}")]
    for number, (kind, text) in enumerate(zip(parts[::2], parts[1::2], strict=True), 1):
        markdown = "markdown" in kind
        source = re.sub(r"^# ?", "", text, flags=re.MULTILINE) if markdown else text
        cells.append(cell(f"{script.stem[:2]}-{number}", "markdown" if markdown else "code", source.strip()))
    return document(cells)


def document(cells: list[dict[str, object]]) -> str:
    """A notebook of these cells."""
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def cell(name: str, kind: str, source: str) -> dict[str, object]:
    """One cell, as the format of notebooks has it."""
    lines = source.splitlines(keepends=True)
    code = {"execution_count": None, "outputs": []} if kind == "code" else {}
    return {"cell_type": kind, "id": name, "metadata": {}, "source": lines, **code}


if __name__ == "__main__":
    for path in SCRIPTS:
        (HERE / "notebooks" / path.with_suffix(".ipynb").name).write_text(notebook(path))
