"""Lateness of the blocks of a run without a live page, with one, and with ten readers: python benchmarks/live_page.py.

The runs take turns, so that what else the machine does meets all of them. The readers stand for other computers, so
they have the lowest priority here. On a busy machine compare p99 of each run with that of the runs beside it.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import urllib.request
from concurrent.futures import ThreadPoolExecutor
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
        crowd = subprocess.Popen([sys.executable, __file__, *found.groups(), str(readers)])
    out, err = process.communicate()
    if readers is not None:
        crowd.kill()
        crowd.wait()
    assert out, err
    assert json.loads(out)["ticks"] > 0
    return Recording.load(folder / "run.h5")["lateness"]


def be_readers(address: str, token: str, readers: int) -> None:
    """All of them, until they are ended."""
    os.nice(19)
    with ThreadPoolExecutor(max(1, readers)) as pool:
        for _ in range(readers):
            pool.submit(read, address, token)


def main() -> None:
    """Print the table."""
    if len(sys.argv) == 4:
        be_readers(sys.argv[1], sys.argv[2], int(sys.argv[3]))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = re.sub(r"(?m)^duration = .*", f"duration = {SECONDS}", config.example())
        text = re.sub(r"(?m)^overrun_streak = .*", "overrun_streak = 0", text)
        (folder / "stage.toml").write_text(re.sub(r"(?m)^watchdog_timeout = .*", "watchdog_timeout = 20.0", text))
        kinds = {"no page": None, "page, no reader": 0, "page, ten readers": 10}
        found: dict[str, list[np.ndarray]] = {kind: [] for kind in kinds}
        for _ in range(TURNS):
            for kind, readers in kinds.items():
                found[kind].append(lateness(folder, readers))
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    print(f"{'lateness of a block, us':24}{'p50':>10}{'p99':>10}{'p99.9':>10}{'largest':>10}{'p99 of each run':>24}")
    for kind, runs in found.items():
        late = np.concatenate(runs)
        each = " ".join(f"{np.percentile(run, 99):.0f}" for run in runs)
        print(f"{kind:24}" + "".join(f"{np.percentile(late, p):10.1f}" for p in (50, 99, 99.9, 100)) + f"{each:>24}")


if __name__ == "__main__":
    main()
