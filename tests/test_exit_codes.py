"""The exit codes that the documentation lists are those that commands end with."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from truestroke.base.exit_codes import ExitCode
from truestroke.base.verdict import Verdict
from truestroke.cli import main
from truestroke.identification import load_model, save_model
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


SCANNER = Path(__file__).with_name("vectors") / "scanner.toml"
USING = (
    ("track", ExitCode.NOT_TRACKING),
    ("learn", ExitCode.NOT_TRACKING),
    ("export c --sample-rate 2000 --output chip", ExitCode.NOT_TRACKING),
    ("export fmu --actuator --output model.fmu", ExitCode.NOT_TRACKING),
    ("unwarp wave.csv --record wave.csv", ExitCode.NOT_TRACKING),
    ("run", ExitCode.USAGE),
)


@pytest.mark.parametrize(("command", "code"), USING)
@pytest.mark.usefixtures("empty_folder")
def test_a_bad_model_is_refused_wherever_it_is_used(command: str, code: ExitCode) -> None:
    """Its verdict was read by `invert`, `playback` and qudi alone."""
    model = load_model(SCANNER)
    save_model("bad.toml", model.replace(provenance=Verdict("bad", ("The sensor was noisy.", "It crept.")).entries))
    Path("stage.toml").write_text(STAGE.replace("stroke = 30.0", 'model = "bad.toml"'))
    Path("wave.csv").write_text("")
    given = ["--config", "stage.toml"] if command == "run" else ["--model", "bad.toml"]
    done = CliRunner().invoke(main, [*command.split(), *given])
    assert (done.exit_code, done.stdout) == (code, ""), done.output
    assert "bad.toml: the verdict of this model is bad: The sensor was noisy" in done.stderr
    assert done.stderr.count("\n") == 1
    assert ("or use it by --force" in done.stderr) == (command != "run")
