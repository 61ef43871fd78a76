"""The examples run and print what they say; their notebooks and their list are the same."""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path

import matplotlib as mpl
import pytest
from printed import assert_prints

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("[0-9]*.py"))
notebooks = runpy.run_path(str(EXAMPLES / "notebooks.py"))

every_script = pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)


@every_script
def test_it_prints_what_it_says(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"backend": "agg"}):
        runpy.run_path(str(script), run_name="__main__")
    _, _, expected = script.read_text().partition("# Prints:\n#\n")
    assert_prints(expected.replace("#    ", ""), capsys.readouterr().out, tolerance=0.02)
    assert list(tmp_path.iterdir()) == []


@every_script
def test_its_notebook_is_the_same(script):
    text = (EXAMPLES / "notebooks" / f"{script.stem}.ipynb").read_text()
    assert text == notebooks["notebook"](script), "python examples/notebooks.py makes it anew"
    cells = json.loads(text)["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    whole = ast.parse(script.read_text())
    whole.body.pop(0)  # the title
    assert ast.dump(ast.parse(code)) == ast.dump(whole)


@every_script
def test_the_list_says_what_it_shows(script):
    shows = ast.get_docstring(ast.parse(script.read_text()))
    assert (
        f"| [{script.name}]({script.name}) | [notebook](notebooks/{script.stem}.ipynb) | {shows} |"
        in (EXAMPLES / "README.md").read_text()
    )


def test_there_are_no_other_notebooks():
    assert {path.stem for path in EXAMPLES.glob("notebooks/*")} == {script.stem for script in SCRIPTS}
