"""The site of the documentation: what `make docs` makes of the pages, and that its check finds what is wrong."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from docs.site import check, gallery, github, reference, reports, stage
from late import Late

import truestroke
from truestroke import cli
from truestroke.base.flags import Flags

access, mathml, sidebar = Late("docs.site.access"), Late("docs.site.mathml"), Late("docs.site.sidebar")
ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
STAGED, BUILT = ROOT / "build/site/source", ROOT / "build/site/html"

# ---- From the pages of GitHub to those of Sphinx ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "target", "there"),
    [
        ("docs/run.md", "commission.md", "commission.md"),
        ("docs/run.md", "https://www.ni.com/x.md", "https://www.ni.com/x.md"),
        ("docs/run.md", "#faults", "#faults"),
        ("docs/run.md", "../README.md#limits", "project.md#limits"),
        ("docs/decisions/0001-c-kernel-and-numpy-text.md", "../house.md", "../house.md"),
        ("docs/decisions/0001-c-kernel-and-numpy-text.md", "../../CHANGELOG.md", "../changelog.md"),
        ("README.md", "docs/scan.md#files", "scan.md#files"),
        ("README.md", "LICENSE", "../../../LICENSE"),
        ("CONTRIBUTING.md", "c/tests/vectors.py", "../../../c/tests/vectors.py"),
        ("examples/README.md", "02_loop_by_hand.py", "02_loop_by_hand.md"),
        (
            "examples/README.md",
            "notebooks/02_loop_by_hand.ipynb",
            "../../../../examples/notebooks/02_loop_by_hand.ipynb",
        ),
    ],
)
def test_a_link_leads_to_the_same_place_on_the_site(source: str, target: str, there: str) -> None:
    assert stage.relinked(target, ROOT / source, STAGED) == there


def test_text_between_backticks_and_in_blocks_stays() -> None:
    text = "See [@tan2009], `[@tan2009]` and [c](../c), [`a`](run.md).\n"
    assert stage.rewritten(text, DOCS / "theory.md", STAGED) == (
        "See {cite:p}`tan2009`, `[@tan2009]` and c, [`a`](run.md).\n"
    )


def test_every_page_is_in_the_side_bar_once() -> None:
    listed = [page for pages in stage.contents().values() for _, page in pages]
    assert sorted(listed) == sorted(set(listed))
    pages = {path.name for path in DOCS.glob("*.md")} - {"README.md"}
    assert pages | {"project.md", "contributing.md", "changelog.md", "references.md"} <= set(listed)


def test_every_decision_is_listed_once_where_the_side_bar_has_none() -> None:
    """In the order of their numbers. Without it a decision would be in no page's contents."""
    listed = re.findall(r"\(decisions/(\d{4}-[^)]+\.md)\)", (DOCS / "README.md").read_text())
    assert listed == sorted(path.name for path in DOCS.glob("decisions/*.md"))
    assert stage.pages(STAGED)[f"decisions/{listed[-1]}"].startswith("---\norphan: true\n---\n\n# ")


def test_the_reference_has_every_public_name_once() -> None:
    names = [name for names in reference.public_names().values() for name in names]
    assert sorted([*names, "__version__"]) == sorted(truestroke.__all__)
    assert set(reference.public_names()) <= set(reference.packages())


def test_a_page_of_an_example_shows_its_whole_script() -> None:
    script = ROOT / "examples/05_record_to_controller.py"
    shown = gallery.example(script, STAGED)
    code = [line for line in script.read_text().splitlines() if line and not line.startswith(("#", '"""'))]
    assert [line for line in code if line not in shown] == []


def test_every_example_has_a_picture_in_both_colours() -> None:
    files = {f"{script.stem}-{theme}.png" for script in gallery.scripts() for theme in ("light", "dark")}
    assert {file.name for file in (DOCS / "images/examples").iterdir()} == files


def test_a_tutorial_as_a_notebook_has_its_code_and_its_commands() -> None:
    page = "# A\n\nSee [b](b.md).\n\n```python\nx = 1\n```\n\n```text\n1\n```\n\n"
    page += "```console\n$ truestroke track\nrmse\n```\n"
    cells = json.loads(gallery.notebook(page))["cells"]
    assert [(cell["cell_type"], "".join(cell["source"])) for cell in cells] == [
        ("markdown", "# A\n\nSee b."),
        ("code", "x = 1"),
        ("markdown", "```text\n1\n```"),
        ("code", "!truestroke track"),
    ]
    assert DOCS / "first-wave.md" in stage.tutorials()


def test_a_picture_has_a_light_and_a_dark_image() -> None:
    light, dark = github.images('<picture>\n<source srcset="d.png">\n<img alt="a loop" src="l.png">\n</picture>')
    assert (light["uri"], light["classes"], light["alt"]) == ("l.png", ["only-light"], "a loop")
    assert (dark["uri"], dark["classes"], dark["alt"]) == ("d.png", ["only-dark"], "a loop")
    with pytest.raises(ValueError, match="dark source"):
        github.images('<picture><img alt="a loop" src="l.png"></picture>')


def test_an_equation_is_mathml_without_its_number() -> None:
    shown = mathml.mathml(r"\frac{a}{b} \tag{7}", "block")
    assert re.search(r"<mfrac>.*<mi>a</mi>.*<mi>b</mi>.*</mfrac>", shown)
    assert "7" not in shown


def test_lines_of_an_equation_are_lines() -> None:
    shown = mathml.mathml(r"\begin{aligned} a &= b \\ c &= d \end{aligned}", "block")
    assert shown.count("<mtr>") == 2
    assert "\N{MATHEMATICAL BOLD CAPITAL P}" in html.unescape(mathml.mathml(r"\mathbf P u", "inline"))
    assert "x00026" not in shown


def test_pages_that_no_side_bar_lists_share_that_of_their_folder() -> None:
    env = SimpleNamespace(toctree_includes={"index": ["run", "decisions/first"]})
    once, calls = sidebar.Once(), []

    def made(page: str, **options: object) -> str:
        def toctree(**options: object) -> str:
            calls.append(page)
            return f"seen from {page}, {options}"

        context = {"toctree": toctree}
        once(SimpleNamespace(builder=SimpleNamespace(env=env)), page, "page.html", context, None)
        return context["toctree"](**options)

    pages = ["index", "run", "decisions/first", "decisions/0001", "decisions/0002", "changes", "news"]
    shown = [made(page, collapse=False) for page in pages]
    assert calls == [*pages[:4], "changes"]
    assert shown[4] == shown[3]
    assert made("decisions/0002", collapse=True) != shown[3]


# ---- In a browser --------------------------------------------------------------------------------------------------


def needs(*files: Path) -> None:
    """Skip, but not in CI, where the site or the browser is missing."""
    if not shutil.which("chromium") or not all(file.exists() for file in files):
        remedy = "needs the site and a browser: make docs; sudo apt-get install chromium"
        assert not os.environ.get("CI"), remedy
        pytest.skip(remedy)


def look(folder: Path, *pages: str) -> subprocess.CompletedProcess[str]:
    """In a process of its own: playwright wants an event loop for itself."""
    command = [sys.executable, "-m", "docs.site.look", str(folder), *pages]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_pages_are_sound_in_a_browser() -> None:
    """Of the site that was built last; `make docs-look` opens all pages."""
    pages = ("index.html", "first-wave.html")
    needs(*(BUILT / page for page in pages))
    done = look(BUILT, *pages)
    assert done.returncode == 0, done.stderr


def test_an_option_is_not_broken_at_its_hyphens() -> None:
    words = ["--safe-voltage", "-O3", "a-word", "-0.6", "--an-option-wider-than-a-phone"]
    page = access.accessible("".join(f'<code><span class="pre">{word}</span></code>' for word in words))
    assert re.findall(r'<span class="pre option">(.*?)</span>', page) == words[:2]


def test_mistakes_in_a_page_are_seen(tmp_path: Path) -> None:
    needs()
    mistakes = {
        "<div style='width: 1500px'>wide</div>": "1500 px wide in a window of 360 px",
        "<p style='color: #bbb; background: #fff'>faint</p>": "color-contrast",
        "<script>console.error('gone')</script>": "console: gone",
        "<script>null.x</script>": "raises",
        "<img alt='a' src='http://127.0.0.1:9/a.png'>": "asks for http://127.0.0.1:9/a.png",
    }
    head = "<!doctype html><html lang=en><title>a</title><body style='margin: 0'>"
    (tmp_path / "page.html").write_text(head + "".join(mistakes))
    done = look(tmp_path)
    assert done.returncode == 1
    assert [message for message in mistakes.values() if message not in done.stderr] == []


def test_every_command_with_a_page_is_among_the_reports_that_are_looked_at() -> None:
    asked = {line.split()[0] for line in reports.COMMANDS.splitlines()}
    writes = {name for name, one in cli.main.commands.items() if "plots" in {option.name for option in one.params}}
    assert writes | {"commission", "run"} == asked


# ---- The glossary ----------------------------------------------------------------------------------------------------


def test_the_glossary_is_in_order_and_of_words_that_pages_use() -> None:
    rows = re.findall(r"^\| (?!term|---)(.+?) \|", (DOCS / "glossary.md").read_text(), flags=re.MULTILINE)
    assert rows == sorted(rows, key=lambda row: row.strip("`").lower())
    others = " ".join(path.read_text() for path in DOCS.glob("*.md") if path.name != "glossary.md")
    words = re.sub(r"\s+", " ", others).lower()
    assert [term for row in rows for term in row.lower().split(", ") if term not in words] == []
    assert set(Flags.__annotations__) <= set(rows)


# ---- The check finds what is wrong -----------------------------------------------------------------------------------


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A site of two pages with which nothing is wrong."""
    equations = "".join(f'<div id="equation-{n}" class="math"><math ></math></div>' for n in range(1, 24))
    (tmp_path / "theory.html").write_text(
        f'<a href="questions.html#notch">x</a><a href="https://ni.com">y</a>{equations}'
    )
    (tmp_path / "questions.html").write_text(
        '<h1 id="notch">Notch</h1><dt class="sig">f(x)</dt><dd>x: ~1</dd><img src="a.png">'
        '<link rel="stylesheet" href="s.css">'
    )
    (tmp_path / "genindex.html").write_text("Sensor failure, Notch, Windows, Hysteresis")
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "s.css").write_text('a { background: url("a.png") } b { background: url(data:x) }')
    terms = '{"sensor": 0, "failur": 0, "notch": [0, 1], "window": 0, "hysteresi": 1}'
    (tmp_path / "searchindex.js").write_text(
        f'Search.setIndex({{"docnames": ["questions", "theory"], "terms": {terms}, "titleterms": {{}}}})'
    )
    return tmp_path


def test_a_sound_site_passes(site: Path) -> None:
    assert check.wrong(site) == []


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("theory.html", "questions.html#notch", "question.html", "question.html is not there"),
        ("theory.html", "#notch", "#notches", "no such anchor"),
        ("questions.html", "a.png", "b.png", "b.png is not there"),
        ("questions.html", "s.css", "https://x.org/s.css", "from elsewhere"),
        ("questions.html", "a.png", "//x.org/a.png", "from elsewhere"),
        ("s.css", '"a.png"', "https://x.org/f.woff", "from elsewhere"),
        ("s.css", "a {", "@import '//x.org/f.css'; a {", "from elsewhere"),
        ("searchindex.js", '"window": 0', '"window": 1', "does not find 'windows'"),
        ("searchindex.js", '"failur": 0', '"failur": 1', "does not find 'sensor failure'"),
        ("genindex.html", "Notch", "Gap", "has no 'notch'"),
        ("theory.html", 'id="equation-7"', "", "no equation (7)"),
        ("theory.html", "<math >", "$$", "no equation (1)"),
        ("theory.html", "<math >", "<math ><mi>&amp;</mi>", "not understood"),
        ("questions.html", "<h1", '<dt class="sig py">f(x: <b>~numpy.ndarray</b>)</dt><h1', "': ~n' in f(x: ~numpy.nd"),
    ],
)
def test_a_mistake_in_the_site_is_found(site: Path, file: str, old: str, new: str, message: str) -> None:
    changed = site / file
    assert old in changed.read_text()
    changed.write_text(changed.read_text().replace(old, new))
    assert any(message in found for found in check.wrong(site))
