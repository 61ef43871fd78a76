"""Lateness of the blocks of a run without a live page, with one, and with ten readers: python benchmarks/live_page.py.

The runs take turns, so that what else the machine does meets all of them. The readers stand for other computers, so
they have the lowest priority here. On a busy machine compare p99 of each run with that of the runs beside it, or put
the run before all other programs: `--first` or `--priority 50`, which need root. `--without slices` and `--without way`
are runs as they were before decision 83; with `--steps 19` the pages give way further (decision 135).
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from http.client import HTTPException
from pathlib import Path

import numpy as np
import psutil

from truestroke import Recording
from truestroke.base import system
from truestroke.runtime.realtime import config
from truestroke.runtime.realtime.live_page.pages import FEWER

PROGRAM = str(Path(sys.executable).with_name("truestroke"))
COMMAND = [PROGRAM, "run", "--config", "stage.toml", "--json"]
KINDS = {"no page": None, "page, no reader": 0, "page, ten readers": 10}
FIRST = -20  # steps of the sessions of a run that is put before others
LOWEST = 19  # steps of the readers
STARTED = 2.0  # s after which all processes of a run are there
WITHOUT = {  # what each process of the run does when it starts
    "slices": "import contextlib; system.short_slices = lambda seconds: contextlib.nullcontext()",
    "way": "import os; system.yield_to_others = os.nice",
}
STEPS = "before = system.yield_to_others; system.yield_to_others = lambda _: before({})"


def read(address: str, token: str) -> float:
    """All frames until the run has ended; how many there were a second, from the first one on."""
    request = urllib.request.Request(f"{address}stream", headers={"Authorization": f"Bearer {token}"})
    times: list[float] = []
    with suppress(OSError, HTTPException), urllib.request.urlopen(request) as stream:
        while stream.readline():
            times.append(time.monotonic())
    return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0


def put_first(run: int, steps: int) -> None:
    """The sessions of a run before those of all other programs: sched(7), autogroup."""
    for one in [psutil.Process(run), *psutil.Process(run).children(recursive=True)]:
        group = Path(f"/proc/{one.pid}/autogroup")
        gave_way = group.read_text().split()[-1] != "0"
        group.write_text(str(FIRST + steps if gave_way else FIRST))


def lateness(folder: Path, readers: int | None, asked: argparse.Namespace) -> tuple[np.ndarray, float]:
    """us, of each block but those of the start, and frames a second of a reader; readers None: no page."""
    (folder / "run.h5").unlink(missing_ok=True)
    command = COMMAND + (["--live"] if readers is not None else [])
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    beside = {**os.environ, "PYTHONPATH": str(folder)}
    run = subprocess.Popen(command, cwd=folder, env=beside, text=True, start_new_session=True, **pipes)
    assert run.stderr
    if readers is not None:  # the terminal has the address
        found = next(found for line in run.stderr if (found := re.search(r"(http://[^#]*)#(\S+)", line)))
    if readers:
        crowd = subprocess.Popen(
            [sys.executable, __file__, f"--read={'#'.join(found.groups())}", f"--readers={readers}"],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    if asked.first:
        while not (folder / "run.h5").exists():
            time.sleep(0.1)
        time.sleep(STARTED)
        put_first(run.pid, asked.steps)
    out, err = run.communicate()
    frames = float(crowd.communicate()[0]) if readers else 0.0
    assert out, err
    late = Recording.load(folder / "run.h5")["lateness"]
    return late[len(late) // 4 :], frames


def be_readers(address: str, token: str, readers: int) -> None:
    """All of them, until the run has ended."""
    system.yield_to_others(LOWEST)  # of this session, which they lead: a priority counts within a session only
    with ThreadPoolExecutor(readers) as pool:
        print(np.mean(list(pool.map(read, [address] * readers, [token] * readers))))


def prepare(folder: Path, asked: argparse.Namespace) -> None:
    """The configuration, and what the processes of the run leave out."""
    text = re.sub(r"(?m)^duration = .*", f"duration = {asked.seconds}", config.example())
    changes = {"overrun_streak": 0, "watchdog_timeout": 20.0}
    if asked.priority:
        changes |= {"spin": 0.0}
        text = text.replace("[realtime]", f"[realtime]\npriority = {asked.priority}")
    for key, value in changes.items():
        text = re.sub(rf"(?m)^{key} = .*", f"{key} = {value}", text)
    (folder / "stage.toml").write_text(f"{text}\n[live]\nport = 0\n")
    changed = [*(WITHOUT[one] for one in asked.without), *([STEPS.format(asked.steps)] if asked.steps != FEWER else [])]
    if changed:
        (folder / "sitecustomize.py").write_text("\n".join(["from truestroke.base import system", *changed]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each run")
    parser.add_argument("--first", action="store_true", help="the sessions of the run are before all others")
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO of the loop, with spin = 0")
    parser.add_argument("--without", choices=list(WITHOUT), action="append", default=[])
    parser.add_argument("--steps", type=int, default=FEWER, help="of priority by which the pages give way, up to 19")
    parser.add_argument("--read", help=argparse.SUPPRESS)  # address#token
    parser.add_argument("--readers", type=int, default=1, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.read:
        be_readers(*asked.read.split("#"), asked.readers)
        return
    found: dict[str, list[tuple[np.ndarray, float]]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name), asked)
        for _ in range(asked.turns):
            for kind, readers in KINDS.items():
                found[kind].append(lateness(Path(name), readers, asked))
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    print(f"{'lateness of a block, us':24}{'p50':>10}{'p99':>10}{'p99.9':>10}{'largest':>10}   p99 of each run")
    for kind, runs in found.items():
        late = np.concatenate([late for late, _ in runs])
        each = " ".join(f"{np.percentile(late, 99):.0f}" for late, _ in runs)
        print(f"{kind:24}" + "".join(f"{np.percentile(late, p):10.1f}" for p in (50, 99, 99.9, 100)) + f"   {each}")

    print(f"frames a second of a reader: {np.mean([frames for _, frames in found['page, ten readers']]):.1f}")


if __name__ == "__main__":
    main()
