"""The exit codes that the documentation lists are those that commands end with."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from truestroke.base.exit_codes import ExitCode
from truestroke.cli import main
from truestroke.runtime.realtime.ending import Cause


def test_documentation_lists_each_code() -> None:
    page = (Path(__file__).parents[1] / "docs/exit-codes.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ") and line[2].isdigit()]
    assert rows == [f"| {code.value} | {code.meaning} |" for code in ExitCode]


def test_causes_of_a_run_are_exit_codes() -> None:
    assert {cause.value for cause in Cause} <= set(ExitCode)


STAGE = """
[driver]
name = "simulated"
faults = [{ kind = "open" }]

[[axis]]
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 400.0
trajectory = { kind = "sine", duration = 1.0 }
"""
DRIVING = (
    "run", "serve --live", "commission --yes", "bode", "learn --bandwidth 150", "characterise", "playback wave.csv",
)  # fmt: skip


@pytest.mark.parametrize("command", DRIVING)
@pytest.mark.usefixtures("empty_folder")
def test_hardware_that_does_not_open_has_one_code(command: str) -> None:
    """Of some commands it was 1, and `learn` began a table."""
    Path("stage.toml").write_text(STAGE)
    rows = "".join(f"{k / 2000},{k / 1000}\n" for k in range(20))
    Path("wave.csv").write_text(f"time (s),volts (V)\n{rows}")
    done = CliRunner().invoke(main, [*command.split(), "--config", "stage.toml"])
    assert (done.exit_code, done.stdout) == (ExitCode.DRIVER, ""), done.output
    assert done.stderr.count("\n") == 1
    assert "open: error -2: the simulated device does not answer" in done.stderr
