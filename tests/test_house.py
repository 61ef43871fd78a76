"""docs/house.md is true: its packages are those of the code, in order of imports; its lists of files are complete."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src/truestroke"
PAGE = (ROOT / "docs/house.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def rows(heading: str) -> list[list[str]]:
    """The cells of each row of the table whose first heading this is."""
    table = re.search(rf"^\| {re.escape(heading)} \|.*\n\|[-|]+\n((?:\|.*\n)+)", PAGE, flags=re.MULTILINE)
    assert table, f"docs/house.md has no table of {heading}"
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table[1].splitlines()]


def test_packages_are_in_the_order_of_imports() -> None:
    layers = PROJECT["tool"]["importlinter"]["contracts"][0]["layers"]
    assert [row[0].strip("`/") for row in rows("package")] == layers[::-1]
