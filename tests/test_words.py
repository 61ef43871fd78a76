"""One concept has one name, the field's: words that have gone do not come back, in pages, comments and docstrings."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = sorted(p for p in (ROOT / "src").rglob("*.py*") if p.suffix in {".py", ".pyi"})
KERNEL = sorted(p for p in (ROOT / "c").rglob("*.[ch]") if "build" not in p.parts)

GONE = {  # pattern: what is written in its place
    r"brought": "weighted sum (of plays); set, limited to",
    r"(?<!\| )bends?|bent": "asymmetry, curved",
    r"rated": "rate-dependent",
    r"told|tells?|telling": "report, state, distinguish; informative (of data)",
    r"carry|carries|carried": "store, keep, contain; bumpless transfer (of the command)",
    r"mixed|deaf": "what it is",
    r"zoos?": "robustness study",
    r"draws?|drawn|drew": "sample (random), plot (picture)",
    r"played|to play": "output (waveform), simulate (run)",
    r"(?<!a )(?<!the )(?<!each )play (?:a|an|the|it|its|this|that|again) ": "output (waveform), simulate (run)",
    r"rooms?": "package; space (on a disk)",
    r"what is left|what (?:\w+ ){1,5}leaves?|is left(?! out)|are left(?! out)": "residual; remains",
    r"believes?|believed|doubts?|teach|teaches|taught|nonsense|rivals?|for ever|honest": "a plain technical word",
    r"(?<!paper's )(?<!and )figures(?! and table)(?!:|\.\*\*|\.py)": "metrics (numbers), plots (pictures)",
}
PATTERNS = {re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE): instead for pattern, instead in GONE.items()}


def gone(lines: list[tuple[int, str]]) -> list[str]:
    """What is to be replaced in numbered lines."""
    return [
        f"line {number}: {hit[0]!r}: {instead}"
        for number, line in lines
        for pattern, instead in PATTERNS.items()
        for hit in pattern.finditer(line)
    ]


def texts(source: Path) -> list[tuple[int, str]]:
    """Comments and docstrings of a file of Python by line, but code: in backticks, examples, names of parameters."""
    found = []
    for token in tokenize.generate_tokens(io.StringIO(source.read_text()).readline):
        if token.type == tokenize.COMMENT or (token.type == tokenize.STRING and '"""' in token.string[:4]):
            found += list(enumerate(token.string.splitlines(), token.start[0]))
    code = re.compile(r"\s*(?:>>>|\.\.\.|\w[\w, ]* : )")
    return [(number, re.sub(r"`[^`]*`", "", line)) for number, line in found if not code.match(line)]


def in_each(files: list[Path], found: Callable[[Path], object]) -> dict[str, object]:
    """What is found, by the name of the file; nothing of files without."""
    return {str(file.relative_to(ROOT)): wrong for file in files if (wrong := found(file))}


def test_pages_do_not_use_words_that_have_gone() -> None:
    def found(page: Path) -> object:
        text = page.read_text()
        if page.name == "CHANGELOG.md":  # names in code what was renamed
            text = re.sub(r"`[^`\n]*`|\"[^\"\n]*\"", "", text)
        return gone(list(enumerate(text.splitlines(), 1)))

    assert in_each(PAGES, found) == {}


def test_comments_and_docstrings_do_not_use_words_that_have_gone() -> None:
    assert in_each(SOURCES, lambda source: gone(texts(source))) == {}


def test_comments_of_the_kernel_do_not_use_words_that_have_gone() -> None:
    def found(source: Path) -> object:
        text = source.read_text()
        comments = re.finditer(r"/\*.*?\*/", text, re.DOTALL)
        return gone([(text.count("\n", 0, comment.start()) + 1, comment[0]) for comment in comments])

    assert in_each(KERNEL, found) == {}


def test_a_page_writes_um_alone() -> None:
    """But where it quotes the paper, or names the other way of writing."""
    quoted = re.compile(r"`[^`\n]*`|^> .*$|^```.*?^```", re.MULTILINE | re.DOTALL)
    assert in_each(PAGES, lambda page: "µm" in quoted.sub("", page.read_text())) == {}
