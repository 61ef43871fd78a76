"""Lateness of the blocks of a run without a live page, with one, and with ten readers: python benchmarks/live_page.py.

The runs take turns, so that what else the machine does meets all of them.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import threading
import urllib.request
from pathlib import Path

import numpy as np

from truestroke import Recording
from truestroke.runtime.realtime import config

TURNS, SECONDS = 3, 10.0
PROGRAM = str(Path(sys.executable).with_name("truestroke"))
COMMAND = [PROGRAM, "run", "--config", "stage.toml", "--json", "--overwrite"]


def read(address: str, token: str) -> None:
    """All frames until the run has ended."""
    request = urllib.request.Request(f"{address}stream", headers={"Authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request) as stream:
        while stream.readline():
            pass


def lateness(folder: Path, readers: int | None) -> np.ndarray:
    """us, of each block; None: no page."""
    command = COMMAND + (["--live"] if readers is not None else [])
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    if readers is not None:
        found = next(found for line in process.stderr if (found := re.search(r"(http://[^#]*)#(\S+)", line)))
        for _ in range(readers):
            threading.Thread(target=read, args=found.groups(), daemon=True).start()
    out, _ = process.communicate()
    assert json.loads(out)["ticks"] > 0
    return Recording.load(folder / "run.h5")["lateness"]


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = re.sub(r"(?m)^duration = .*", f"duration = {SECONDS}", config.example())
        (folder / "stage.toml").write_text(re.sub(r"(?m)^overrun_streak = .*", "overrun_streak = 0", text))
        kinds = {"no page": None, "page, no reader": 0, "page, ten readers": 10}
        found: dict[str, list[np.ndarray]] = {kind: [] for kind in kinds}
        for _ in range(TURNS):
            for kind, readers in kinds.items():
                found[kind].append(lateness(folder, readers))
    print(f"{'lateness of a block, us':24}{'p50':>10}{'p99':>10}{'p99.9':>10}{'largest':>10}")
    for kind, runs in found.items():
        late = np.concatenate(runs)
        print(f"{kind:24}" + "".join(f"{np.percentile(late, p):10.1f}" for p in (50, 99, 99.9, 100)))


if __name__ == "__main__":
    main()
