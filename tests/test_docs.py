"""The documentation is executed: examples, console blocks, links, citations, equations."""

from __future__ import annotations

import contextlib
import doctest
import io
import os
import re
import shlex
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from docs import pictures
from forked import ran
from printed import assert_prints
from sybil import Sybil
from sybil.example import SybilFailure
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser, SkipParser

import truestroke
from truestroke.cli import main
from truestroke.report.style import LIGHT

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

EXAMPLES = [page for page in PAGES if re.search(r"^ *```(python|console|text)", page.read_text(), re.MULTILINE)]


def prose(page: Path) -> str:
    """The page without its fenced blocks."""
    return re.sub(r"^(```+).*?^\1", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


# ---- Examples ----------------------------------------------------------------------------------------------------


# These start processes, or look at the machine: each in a process of its own, which is a fork for those that move. All
# others, and a simulated scan or learning, run in this one.
OF_THEIR_OWN = {"run", "serve", "replay", "doctor"}
FORKED = {"run", "scan", "learn"}


def run_command(words: list[str], folder: Path) -> tuple[int, str, str]:
    """What the shell gives for `truestroke` and these words in the folder: exit code, output, messages."""
    env = {"COLUMNS": "120", "NO_COLOR": "1", "PYTHONIOENCODING": "utf-8"}
    if words[0] not in OF_THEIR_OWN and not (words[0] in {"scan", "learn"} and "--config" in words):
        called = CliRunner().invoke(main, words, env=env, catch_exceptions=False)
        return called.exit_code, called.stdout, called.stderr
    command = [Path(sys.executable).with_name("truestroke"), *words]
    if words[0] in FORKED:
        done = ran(command, cwd=folder, env=env, timeout=300)
    else:
        printed = {"capture_output": True, "text": True}
        done = subprocess.run(command, cwd=folder, env={**os.environ, **env}, timeout=300, check=False, **printed)
    return done.returncode, done.stdout, done.stderr


def run_console(block: str, folder: Path) -> None:
    """Run each `$ truestroke` line of the block; the lines behind it are what it prints.

    It ends with 0, or with what the comment `# exit code N` behind it says.
    """
    for command, expected in re.findall(r"^\$ (truestroke\b.*)\n?((?:(?!\$ ).*\n?)*)", block, flags=re.MULTILINE):
        code, printed, messages = run_command(shlex.split(command, comments=True)[1:], folder)
        stated = re.search(r"# exit code (\d+)$", command)
        assert code == (int(stated[1]) if stated else 0), f"$ {command}\n{printed}{messages}"
        if expected.strip():
            assert_prints(expected, printed, tolerance=0.05)


def run_page(page: Path, folder: Path) -> None:
    """A text block right behind a python block is what that block prints; the blocks of a page share their names."""
    document = Sybil(
        parsers=[
            PythonCodeBlockParser(doctest_optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE),
            CodeBlockParser(language="text", evaluator=lambda example: None),
            CodeBlockParser(language="console", evaluator=lambda example: run_console(example.parsed, folder)),
            SkipParser(),
        ]
    ).parse(page)
    printed, end = "", -1  # of the last python block
    for example in document.examples():
        start, block = example.region.start, document.text[example.region.start : example.region.end]
        if block.startswith("```text") and end >= 0 and not document.text[end:start].strip("`\n "):
            assert_prints(str(example.parsed), printed, tolerance=0.01)
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            example.evaluate()
        printed, end = output.getvalue(), example.region.end if block.startswith("```python") else -1


@pytest.mark.parametrize("page", EXAMPLES, ids=lambda page: str(page.relative_to(ROOT)))
@pytest.mark.filterwarnings("default::truestroke.ModelWarning")  # a reader of a page sees it, and goes on
@pytest.mark.usefixtures("each_picture_once", "no_waiting")
def test_examples_run_and_print_what_the_page_says(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(page, tmp_path)


@pytest.mark.parametrize(
    "block",
    [
        "```python\nprint(2.0)\n```\n\n```text\n2.1\n```",
        "```python\nprint('one')\n```\n\n```text\ntwo\n```",
        "```python\nassert x == 2\n```",
        "```python\n>>> 1 + 1\n3\n```",
        "```console\n$ truestroke no-such-command\n```",
    ],
)
def test_a_wrong_example_is_found(block: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"```python\nx = 1\n```\n\n{block}\n")
    with pytest.raises((AssertionError, SybilFailure)):
        run_page(page, tmp_path)


# ---- Links, citations, equations, names -----------------------------------------------------------------------------


@cache
def anchors(page: Path) -> set[str]:
    """The anchors that GitHub makes of the headings."""
    headings = re.findall(r"^#+ (.+?)\s*$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_relative_links_and_anchors_resolve() -> None:
    wrong = []
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            linked = (page.parent / path).resolve() if path else page
            if not linked.exists():
                wrong.append(f"{page.name}: {target}: there is no {linked}")
            elif anchor and anchor not in anchors(linked):
                wrong.append(f"{page.name}: {target}: {linked.name} has {sorted(anchors(linked))}")
    assert wrong == []


def test_citations_and_bibliography_match() -> None:
    keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "docs/references.bib").read_text(), flags=re.MULTILINE))
    cited = {key for page in PAGES for key in re.findall(r"\[@(\w+)\]", page.read_text())}
    assert cited <= keys, "not in references.bib"
    assert keys <= cited, "nothing cites these"


def test_theory_states_every_equation_in_order() -> None:
    tags = [int(n) for n in re.findall(r"\\tag\{(\d+)\}", (ROOT / "docs/theory.md").read_text())]
    assert tags == list(range(1, 24))


def test_mathematics_survives_github() -> None:
    """Between single dollars GitHub takes a backslash before punctuation for an escape, in tables a | for a border."""
    wrong = [
        f"{page.name}: {formula}"
        for page in PAGES
        for line in prose(page).splitlines()
        for formula in re.findall(r"\$([^$\s](?:[^$]*[^$\s])?)\$", re.sub(r"`[^`]*`", "", line))
        if re.search(r"\\[!-/:-@\[-`{-~]", formula) or (line.startswith("|") and "|" in formula)
    ]
    assert wrong == []


def test_code_that_a_page_names_exists() -> None:
    """As in `models.py:play_inverse` and `c/src/rls.c:ts_rls_update`."""
    wrong = []
    for page in PAGES:
        for path, name in re.findall(r"`([\w/]+\.(?:py|c|h)):(\w+)`", page.read_text()):
            file = next((f for f in (ROOT / path, ROOT / "src/truestroke" / path) if f.exists()), None)
            definition = rf"^\s*(?:def|class) {name}\b" if path.endswith(".py") else rf"^[\w ]+[\s*]{name}\("
            if not (file and re.search(definition, file.read_text(), flags=re.MULTILINE)):
                wrong.append(f"{page.name}: {path} does not define {name}")
    assert wrong == []


def test_every_page_is_reached_from_the_index() -> None:
    index = (ROOT / "docs/README.md").read_text()
    pages = [str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")]
    pages.remove("site/index.md")  # the index of the site
    assert [p for p in pages if f"({p})" not in index and p != "README.md"] == []


def test_a_picture_of_periods_leaves_out_those_without_a_sample_that_counts() -> None:
    ticks = np.arange(2000.0)
    ramp_first = {
        "time": ticks / 1e4,
        "flat": (ticks >= 600).astype(float),
        "desired": 0.0 * ticks,
        "true": 1e-3 * np.sin(2 * np.pi * ticks / 200),
    }
    runs = {"alone": ramp_first, "recording": ramp_first, "controller": SimpleNamespace(batches=[])}
    line = pictures.online(runs, LIGHT).axes[0].lines[0]
    assert len(line.get_xdata()) == 7
    assert np.allclose(line.get_ydata(), 1 / np.sqrt(2))


def test_version_is_one() -> None:
    citation = re.search(r"^version: \"?([\w.]+)", (ROOT / "CITATION.cff").read_text(), flags=re.MULTILINE)
    assert citation
    assert PROJECT["project"]["version"] == truestroke.__version__ == citation[1]
