"""Exit codes do not depend on who reads what a command prints; signals that are ignored stay so."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from truestroke.base import interrupts

pytestmark = pytest.mark.usefixtures("empty_folder")

COMMAND = str(Path(sys.executable).with_name("truestroke"))
CONFIG = """
[driver]
name = "simulated"
faults = [{ kind = "FAULT", at = 1000, count = 99999 }]
[[axis]]
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 400.0
[axis.trajectory]
kind = "sine"
frequency = 4.0
duration = 20.0
[realtime]
spin = 0.0
overrun_streak = 0
watchdog_timeout = 20.0
[recording]
file = "run.h5"
"""
STREAMS = {"unread": "| true", "closed": ">&-", "all closed": "<&- >&- 2>&-"}


def shell(line: str) -> tuple[int, str]:
    """Exit code of `truestroke` with redirections in bash, and what came to stderr."""
    script = f"set -o pipefail; '{COMMAND}' {line}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("kind", "code", "streams"), [("error", 12, "closed"), ("error", 12, "all closed"), ("nan", 10, "unread")]
)
def test_a_run_ends_with_its_code(kind: str, code: int, streams: str) -> None:
    Path("run.toml").write_text(CONFIG.replace("FAULT", kind))
    found, stderr = shell(f"run --config run.toml {STREAMS[streams]}")
    assert found == code
    if streams == "unread":
        assert "truestroke: stdout: Broken pipe; what was printed is not complete\n" in stderr
    assert Path("run.h5").read_bytes()[:4] == b"\x89HDF"  # no line of a closed stream has gone into it


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("run --example | true", 0),
        ("run --example 2>&-", 0),
        ("run --example >/dev/full", 1),
        ("run --config nowhere.toml 2>&-", 2),
        ("run --config nowhere.toml 2>/dev/full >&-", 2),
    ],
)
def test_a_line_ends_with_its_code(line: str, code: int) -> None:
    found, stderr = shell(line)
    assert found == code
    assert stderr.count("\n") == ("full" in line and code == 1) or line.endswith("true")


def test_nohup_stays_nohup(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupts.handled(lambda number, _: heard.append(number)):
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGTERM)
        assert heard == [signal.SIGTERM]
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)
