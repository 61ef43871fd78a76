"""The exit codes that the documentation lists are those that commands end with."""

from __future__ import annotations

from pathlib import Path

from truestroke.base.exit_codes import ExitCode
from truestroke.runtime.realtime.ending import Cause


def test_documentation_lists_each_code() -> None:
    page = (Path(__file__).parents[1] / "docs/exit-codes.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ") and line[2].isdigit()]
    assert rows == [f"| {code.value} | {code.meaning} |" for code in ExitCode]


def test_causes_of_a_run_are_exit_codes() -> None:
    assert {cause.value for cause in Cause} <= set(ExitCode)
