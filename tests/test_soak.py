"""Half a minute in real time: no memory is taken, no sample is lost. Lateness is the machine's, and not judged."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SOAK = Path(__file__).parents[1] / "benchmarks/soak.py"


@pytest.mark.soak
def test_half_a_minute_in_real_time() -> None:
    done = subprocess.run(
        [sys.executable, SOAK, "--minutes", "0.5", "--spin", "0", "--json"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert (found["ticks"], found["lost"]) == (60_000, 0)
    assert found["axes"]["axis"]["true_rmse_um"] < 0.05
