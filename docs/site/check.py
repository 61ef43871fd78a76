"""Check the site that was built: `python -m docs.site.check FOLDER`. It ends with 1, and what is wrong.

Every link within the site leads to a page, an anchor or a file that is there; no page fetches anything from elsewhere;
the search and the index, which needs no script, find the words that readers ask for; the equations are all there; no
signature has what only Python can read.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

SOUGHT = {"sensor failure": "questions", "notch": "questions", "windows": "questions", "hysteresis": "theory"}
EQUATIONS = range(1, 24)
UNREADABLE = r"TypeAliasForwardRef|<function|<class| at 0x|[:|\[(] ?~\w"  # of signatures


class Page(HTMLParser):
    """The links, the fetched files, the anchors and the signatures of a page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.signatures: list[str] = []
        self._signs = False
        self.feed(file.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Sort the attributes."""
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("index", "search", "next", "prev", "author", "canonical"):
            self.fetched.append(given.get("href", ""))
        self.fetched += [given[name] for name in ("src", "srcset", "poster", "data") if name in given and tag != "a"]
        if tag == "dt":
            self._signs = "sig" in given.get("class", "").split()
            self.signatures += [""] * self._signs

    def handle_data(self, data: str) -> None:
        """Of a signature, all of its parts."""
        if self._signs:
            self.signatures[-1] += data

    def handle_endtag(self, tag: str) -> None:
        """Of a signature."""
        self._signs = self._signs and tag != "dt"


page = cache(Page)


@cache  # the side bar of each page links to all others
def linked(folder: Path, path: str) -> Path | None:
    """The file that a link of the pages in the folder leads to, if it is there."""
    target = (folder / unquote(path)).resolve()
    return target if target.is_file() else None


def wrong_links(file: Path) -> Iterator[str]:
    """The links of a page that lead nowhere."""
    for link in page(file).links:
        parts = urlsplit(link)
        if parts.scheme:
            continue
        target = linked(file.parent, parts.path) if parts.path else file
        if target is None:
            yield f"{file.name}: {link} is not there"
        elif parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in page(target).anchors:
            yield f"{file.name}: {link}: no such anchor"


def wrong_files(file: Path) -> Iterator[str]:
    """What a page fetches that is not a file of the site."""
    for name in page(file).fetched:
        parts = urlsplit(name)
        if parts.scheme == "data":
            continue
        if parts.scheme or parts.netloc:
            yield f"{file.name}: fetches {name} from elsewhere"
        elif not (file.parent / unquote(parts.path)).is_file():
            yield f"{file.name}: {name} is not there"


def wrong_styles(file: Path) -> Iterator[str]:
    """What a style sheet fetches from elsewhere."""
    for name in re.findall(r"(?:url\(\s*|@import\s+)[\"']?((?:https?:)?//[^\"')]+)", file.read_text()):
        yield f"{file.name}: fetches {name} from elsewhere"


def found(folder: Path, words: str) -> set[str]:
    """The pages that have all of these words, by the index of the search; words are cut as the search cuts them."""
    text = (folder / "searchindex.js").read_text()
    listed = json.loads(text[text.index("(") + 1 : text.rindex(")")])
    hits = []
    for word in words.split():
        stems = [stem for stem in (*listed["terms"], *listed["titleterms"]) if word.startswith(stem) and len(stem) > 3]
        places = [listed[kind].get(max(stems, key=len, default=""), []) for kind in ("terms", "titleterms")]
        hits.append({n for place in places for n in (place if isinstance(place, list) else [place])})
    return {listed["docnames"][n] for n in set.intersection(*hits)}


def wrong_search(folder: Path) -> Iterator[str]:
    """Words that the search, or the index without scripts, does not find."""
    keywords = (folder / "genindex.html").read_text().lower()
    for words, name in SOUGHT.items():
        if name not in found(folder, words):
            yield f"the search does not find {words!r} in {name}"
        if words not in keywords:
            yield f"genindex.html has no {words!r}"


def wrong_equations(folder: Path) -> Iterator[str]:
    """Equations that are missing, or are not MathML."""
    text = (folder / "theory.html").read_text()
    for number in EQUATIONS:
        if not re.search(rf'id="equation-{number}"[^>]*><math ', text):
            yield f"theory.html has no equation ({number})"
    for formula in re.findall(r"<math .*?</math>", text, flags=re.DOTALL):
        if re.search(r"<m\w+>(?:&amp;|&#x00026;|\\)", formula):
            yield f"theory.html has a formula that was not understood: {formula[:200]}"


def wrong_signatures(file: Path) -> Iterator[str]:
    """Signatures with the name of an object of Python in place of what it is."""
    for signature in page(file).signatures:
        if found := re.search(UNREADABLE, signature):
            yield f"{file.name}: {found[0]!r} in {' '.join(signature.split())[:80]}"


def wrong(folder: Path) -> list[str]:
    """All that is wrong with the site in the folder."""
    pages = sorted(folder.rglob("*.html"))
    checks = (wrong_links, wrong_files, wrong_signatures)
    each = [message for file in pages for check in checks for message in check(file)]
    styles = [message for file in folder.rglob("*.css") for message in wrong_styles(file)]
    return [*each, *styles, *wrong_search(folder), *wrong_equations(folder)]


if __name__ == "__main__":
    messages = wrong(Path(sys.argv[1]).resolve())
    sys.exit("\n".join(messages) or 0)
