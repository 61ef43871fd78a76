"""The pages of reference that follow from the code: Python from the list of public names, and the command line."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import truestroke

ROOT = Path(__file__).resolve().parents[2]
PYTHON = """All public names, by what they are for. `import truestroke` loads none of them; each loads when it is
used. Units, signs and shapes are those of the [conventions](conventions.md).
"""
COMMANDS = """# Command line

```{eval-rst}
.. click:: truestroke.cli:main
   :prog: truestroke
   :nested: full
```
"""


def public_names() -> dict[str, list[str]]:
    """Public names by the package that has them, in the order of the list."""
    stub = ast.parse((ROOT / "src/truestroke/__init__.pyi").read_text())
    found: dict[str, list[str]] = {}
    for node in stub.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            package = [*node.module.split("."), node.names[0].name][1]
            found.setdefault(package, []).extend(entry.name for entry in node.names)
    return found


def packages() -> dict[str, str]:
    """What each package holds, as docs/house.md states it."""
    rows = re.findall(r"^\| `(\w+)/` \| ([^|]+) \|", (ROOT / "docs/house.md").read_text(), flags=re.MULTILINE)
    return dict(rows)


def pages() -> dict[str, str]:
    """The page of the command line, that of all public names, and one for each package that has some."""
    listed, made = [f"# Python\n\n{PYTHON}"], {}
    for package, holds in packages().items():
        names = public_names().get(package)
        if names:
            title = holds.partition(":")[0].capitalize()
            made[f"python/{package}.md"] = "\n\n".join([f"# {title}", *(entry(name) for name in names)]) + "\n"
            rows = [f"| [`{name}`](python/{package}.md#{name.lower()}) | {summary(name)} |" for name in names]
            listed.append("\n".join([f"## {title}\n", "| name | |", "|---|---|", *rows]))
    return {"commands.md": COMMANDS, "python.md": "\n\n".join(listed) + "\n", **made}


def summary(name: str) -> str:
    """The first sentence of a public name's docstring, in a table of Markdown."""
    first = (getattr(truestroke, name).__doc__ or "").strip().partition("\n")[0]
    return first.replace("``", "`").replace("|", r"\|").replace("[", r"\[")


def entry(name: str) -> str:
    """The section of a public name, from its docstring."""
    thing, full, members = getattr(truestroke, name), f"truestroke.{name}", ":members:"
    if isinstance(thing, type):
        kind = "autoexception" if issubclass(thing, Exception) else "autoclass"
    elif callable(thing):
        kind, members = "autofunction", ""
    else:  # a module; a package names what it has of its modules
        kind, full = "automodule", thing.__name__
        members += " " + ", ".join(getattr(thing, "__all__", []))
    return f"## {name}\n\n```{{eval-rst}}\n.. {kind}:: {full}\n   {members}\n```"
