"""One concept has one name, the field's: words that have gone do not come back, in pages, comments and docstrings."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_do_not_use_words_that_have_gone(page: Path) -> None:
    text = page.read_text()
    if page.name == "CHANGELOG.md":  # names in code what was renamed
        text = re.sub(r"`[^`\n]*`|\"[^\"\n]*\"", "", text)
    assert gone(list(enumerate(text.splitlines(), 1))) == []


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: str(source.relative_to(ROOT / "src")))
def test_comments_and_docstrings_do_not_use_words_that_have_gone(source: Path) -> None:
    assert gone(texts(source)) == []


@pytest.mark.parametrize("source", KERNEL, ids=lambda source: str(source.relative_to(ROOT)))
def test_comments_of_the_kernel_do_not_use_words_that_have_gone(source: Path) -> None:
    text = source.read_text()
    comments = [(text.count("\n", 0, m.start()) + 1, m[0]) for m in re.finditer(r"/\*.*?\*/", text, re.DOTALL)]
    assert gone(comments) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_writes_um_alone(page: Path) -> None:
    """But where it quotes the paper, or names the other way of writing."""
    text = re.sub(r"`[^`\n]*`|^> .*$|^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    assert "µm" not in text
