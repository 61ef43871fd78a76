"""Write the pages as Sphinx wants them: `python docs/site/stage.py FOLDER`.

The pages of docs/ and of the project's root are written for GitHub, and stay so. Here their links and citations are
rewritten for the site, and pages that follow from other files are made: the contents from docs/README.md, the
reference of Python from the list of public names, a page for each example from its script.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import truestroke

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
EXAMPLES = ROOT / "examples"
BESIDE = {  # pages that are not in docs/, by what the site calls them
    ROOT / "README.md": "project.md",
    ROOT / "CONTRIBUTING.md": "contributing.md",
    ROOT / "CHANGELOG.md": "changelog.md",
    EXAMPLES / "README.md": "examples/index.md",
    DOCS / "references.bib": "references.md",
    DOCS / "site/index.md": "index.md",
}
PYTHON = """All public names, by what they are for. `import truestroke` loads NumPy alone; the rest loads when it is
used. Units, signs and shapes are those of the [conventions](conventions.md).
"""
COMMANDS = """# Command line

```{eval-rst}
.. click:: truestroke.cli:main
   :prog: truestroke
   :nested: full
```
"""
FENCED = re.compile(r"^(```+|:::+).*?^\1[ ]*$", flags=re.MULTILINE | re.DOTALL)

# ---- Links and citations -------------------------------------------------------------------------------------------


def staged(source: Path) -> Path | None:
    """Where the site has a file of the repository; None for a file that it offers as it is."""
    if source in BESIDE:
        return Path(BESIDE[source])
    if source in scripts():
        return Path("examples", source.stem + ".md")
    if DOCS in source.parents and source.suffix in {".md", ".png", ".svg"}:
        return source.relative_to(DOCS)
    return None


def relinked(target: str, source: Path, folder: Path) -> str:
    """The target of a link of the page `source`, as the page that is staged in `folder` writes it."""
    path, _, anchor = target.partition("#")
    if not path or re.match(r"[a-z]+:", target):
        return target
    file, here = (source.parent / path).resolve(), folder / (staged(source) or "")
    there = staged(file)
    return os.path.relpath(folder / there if there else file, here.parent) + (f"#{anchor}" if anchor else "")


def rewritten(prose: str, source: Path, folder: Path) -> str:
    """Text between the fenced blocks: links, pictures and citations; what is in backticks stays."""

    def link(found: re.Match[str]) -> str:
        words, target = found.groups()
        if (source.parent / target).is_dir():  # nothing to open
            return words
        return f"[{words}]({relinked(target, source, folder)})"

    def picture(found: re.Match[str]) -> str:
        return f'{found[1]}="{relinked(found[2], source, folder)}"'

    prose = re.sub(r"(?<!\\)\[((?:[^\[\]`]|`[^`]*`)*)\]\(([^)\s]+)\)", link, prose)
    prose = re.sub(r'\b(src|srcset)="([^"]+)"', picture, prose)
    return re.sub(r"(`[^`\n]*`)|\[@(\w+)\]", lambda m: m[1] or f"{{cite:p}}`{m[2]}`", prose)


def page(source: Path, folder: Path) -> str:
    """A page of the repository for the site."""
    text, parts, end = source.read_text(), [], 0
    for block in FENCED.finditer(text):
        parts += [rewritten(text[end : block.start()], source, folder), block[0]]
        end = block.end()
    return "".join([*parts, rewritten(text[end:], source, folder)])


# ---- Contents, from docs/README.md ----------------------------------------------------------------------------------


def contents() -> dict[str, list[tuple[str, str]]]:
    """Of each heading of docs/README.md the pages of its table: what for, and the page on the site."""
    found: dict[str, list[tuple[str, str]]] = {}
    for section in re.split(r"^## ", (DOCS / "README.md").read_text(), flags=re.MULTILINE)[1:]:
        heading, _, body = section.partition("\n")
        rows = re.findall(r"^\| (?!to \|)(.+?) \| (.+) \|$", body, flags=re.MULTILINE)
        found[heading] = [
            (purpose, str(staged((DOCS / path).resolve())))
            for purpose, links in rows
            for path in re.findall(r"\]\(([^)#\s]+)", links)
        ]
    return {heading: pages for heading, pages in found.items() if pages}


def toctree(pages: list[str], caption: str = "") -> str:
    """A hidden list of pages for the side bar."""
    title = f":caption: {caption}\n" if caption else ""
    return f"```{{toctree}}\n:hidden:\n{title}\n" + "\n".join(p.removesuffix(".md") for p in pages) + "\n```\n"


def index(source: Path, folder: Path) -> str:
    """The first page, with the contents of all."""
    pages = {heading: [p for _, p in rows] for heading, rows in contents().items()}
    pages["Reference"] += ["python.md", "commands.md"]
    pages["The project"].append("README.md")
    return "\n".join([page(source, folder), *(toctree(names, heading) for heading, names in pages.items())])


def all_pages(source: Path, folder: Path) -> str:
    """docs/README.md, with the decisions below it."""
    decisions = sorted(f"decisions/{path.name}" for path in (DOCS / "decisions").glob("*.md"))
    return page(source, folder) + "\n" + toctree(decisions)


# ---- Reference of Python, from the list of public names --------------------------------------------------------------


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
    rows = re.findall(r"^\| `(\w+)/` \| ([^|]+) \|", (DOCS / "house.md").read_text(), flags=re.MULTILINE)
    return dict(rows)


def python_reference() -> dict[str, str]:
    """The page of all public names, and one for each package that has some."""
    listed, pages = [f"# Python\n\n{PYTHON}"], {}
    for package, holds in packages().items():
        names = public_names().get(package)
        if names:
            title = holds.partition(":")[0].capitalize()
            pages[f"python/{package}.md"] = "\n\n".join([f"# {title}", *(entry(name) for name in names)]) + "\n"
            rows = [f"| [`{name}`](python/{package}.md#{name.lower()}) | {summary(name)} |" for name in names]
            listed.append("\n".join([f"## {title}\n", "| name | |", "|---|---|", *rows]))
    return {"python.md": "\n\n".join([*listed, toctree(list(pages))]), **pages}


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


# ---- Examples, from their scripts ------------------------------------------------------------------------------------


def scripts() -> list[Path]:
    """The scripts of the examples, in their order."""
    return sorted(EXAMPLES.glob("[0-9]*.py"))


def example(script: Path, folder: Path) -> str:
    """The page of an example: its picture, its script in cells, script and notebook to take."""
    title, *parts = re.split(r"^# %%(.*)\n", script.read_text(), flags=re.MULTILINE)
    here = (folder / "examples").resolve()
    lines = [f"# {ast.literal_eval(title)}", ""]
    files = (script, EXAMPLES / "notebooks" / f"{script.stem}.ipynb")
    lines += ["Take it: " + ", ".join(f"[{f.name}]({os.path.relpath(f, here)})" for f in files) + ".", ""]
    for kind, text in zip(parts[::2], parts[1::2], strict=True):
        if "markdown" in kind:
            lines += [re.sub(r"^# ?", "", text, flags=re.MULTILINE).strip(), ""]
        else:
            lines += [f"```python\n{text.strip()}\n```", ""]
    return "\n".join(lines)


def examples(source: Path, folder: Path) -> str:
    """The list of the examples, with their pages below it."""
    return page(source, folder) + "\n" + toctree([f"{script.stem}.md" for script in scripts()])


# ---- All -------------------------------------------------------------------------------------------------------------

MADE: dict[Path, Callable[[Path, Path], str]] = {
    DOCS / "site/index.md": index,
    DOCS / "README.md": all_pages,
    EXAMPLES / "README.md": examples,
}


def pages(folder: Path) -> dict[str, str]:
    """Every page of the site, by its name."""
    sources = [*DOCS.glob("*.md"), *DOCS.glob("decisions/*.md"), *(s for s in BESIDE if s.suffix == ".md")]
    made = {str(staged(source)): MADE.get(source, page)(source, folder) for source in sources}
    made |= {f"examples/{script.stem}.md": example(script, folder) for script in scripts()}
    made["references.md"] = "# References\n\n```{bibliography}\n:all:\n```\n"
    made["commands.md"] = COMMANDS
    return made | python_reference()


def write(folder: Path) -> None:
    """Stage all; a file that has not changed keeps its time, so that Sphinx need not read it again."""
    made = pages(folder)
    for name, text in made.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.exists() or file.read_text() != text:
            file.write_text(text)
    for file in folder.rglob("*.md"):
        if str(file.relative_to(folder)) not in made:
            file.unlink()
    if not (folder / "images").exists():
        (folder / "images").symlink_to(os.path.relpath(DOCS / "images", folder))


if __name__ == "__main__":
    write(Path(sys.argv[1]).resolve())
