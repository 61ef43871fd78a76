"""Write the pages as Sphinx wants them: `python -m docs.site.stage FOLDER`.

The pages of docs/ and of the project's root are written for GitHub, and stay so. Here their links and citations are
rewritten for the site, and pages that follow from other files are made: the contents from docs/README.md, the
reference (reference.py), examples and notebooks (gallery.py).
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

from docs.site import gallery, reference

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
FENCED = re.compile(r"^(```+|:::+).*?^\1[ ]*$", flags=re.MULTILINE | re.DOTALL)

# ---- Links and citations -------------------------------------------------------------------------------------------


def staged(source: Path) -> Path | None:
    """Where the site has a file of the repository; None for a file that it offers as it is."""
    if source in BESIDE:
        return Path(BESIDE[source])
    if source in gallery.scripts():
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
    if not file.exists():
        return target  # what `make docs` adds, such as the playground
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


def decision(source: Path, folder: Path) -> str:
    """Not in the side bar, which each page contains and Sphinx makes anew for it: docs/README.md lists them."""
    return f"---\norphan: true\n---\n\n{page(source, folder)}"


# ---- Examples and notebooks ------------------------------------------------------------------------------------------


def examples(source: Path, folder: Path) -> str:
    """The examples by their pictures, their list, and their pages below it."""
    words, table, rows = page(source, folder).partition("| script |")
    return "\n".join([words, gallery.cards(), table + rows, toctree([f"{s.stem}.md" for s in gallery.scripts()])])


def tutorials() -> list[Path]:
    """The tutorials with code: they open as notebooks, too."""
    pages = [DOCS / name for _, name in contents()["Tutorials"]]
    return [path for path in pages if path.exists() and "```python" in path.read_text()]


def tutorial(source: Path, folder: Path) -> str:
    """A page with its notebook."""
    heading, _, text = page(source, folder).partition("\n")
    return f"{heading}\n\nTo take: [this page as a notebook](notebooks/{source.stem}.ipynb).\n{text}"


# ---- All -------------------------------------------------------------------------------------------------------------

MADE: dict[Path, Callable[[Path, Path], str]] = {
    DOCS / "site/index.md": index,
    EXAMPLES / "README.md": examples,
}


def pages(folder: Path) -> dict[str, str]:
    """Every page of the site, and every notebook that is made of one, by its name."""
    sources = [*DOCS.glob("*.md"), *DOCS.glob("decisions/*.md"), *(s for s in BESIDE if s.suffix == ".md")]
    makers = MADE | dict.fromkeys(tutorials(), tutorial) | dict.fromkeys(DOCS.glob("decisions/*.md"), decision)
    made = {str(staged(source)): makers.get(source, page)(source, folder) for source in sources} | reference.pages()
    made["python.md"] += toctree([name for name in made if name.startswith("python/")])
    made["references.md"] = "# References\n\n```{bibliography}\n:all:\n```\n"
    made |= {f"examples/{s.stem}.md": gallery.example(s, folder / "examples") for s in gallery.scripts()}
    return made | {f"notebooks/{path.stem}.ipynb": gallery.notebook(path.read_text()) for path in tutorials()}


def write(folder: Path) -> None:
    """Stage all; a file that has not changed keeps its time, so that Sphinx need not read it again."""
    made = pages(folder)
    for name, text in made.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.exists() or file.read_text() != text:
            file.write_text(text)
    for file in [*folder.rglob("*.md"), *folder.glob("notebooks/*")]:
        if str(file.relative_to(folder)) not in made:
            file.unlink()
    if not (folder / "images").exists():
        (folder / "images").symlink_to(os.path.relpath(DOCS / "images", folder))


if __name__ == "__main__":
    write(Path(sys.argv[1]).resolve())
