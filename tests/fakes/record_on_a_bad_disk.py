"""The recorder on a disk that fails at each of its writes in turn; run with tests/fakes/bad_disk.c in LD_PRELOAD.

For each kind of failure and each write a process records 230 ticks, and what it leaves is read with the disk well
again. Prints how many cases there were; ends with 1 and the case where anything that was said to be saved is not.
"""

from __future__ import annotations

import errno
import json
import os
import sys
from pathlib import Path

import numpy as np

from truestroke import Recording
from truestroke.base import files
from truestroke.runtime.realtime import recorder
from truestroke.runtime.realtime.shared import FIELDS, Layout, Shared, Slot, State, Text
from truestroke.runtime.ticks import SlowLayout

TICKS, RATE, STEP = 230, 500.0, 60
CHANNELS = ("volts", "measured", "flags")  # the others are written in the same way
KINDS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "short writes": -1}
STATE = np.memmap(os.environ["BAD_DISK"], np.int64, "r+")


class Feed:
    """A lifeline that plays the loop: with each look of the recorder the run goes on."""

    def __init__(self, shared: Shared) -> None:
        self.shared = shared

    def gone(self, seconds: float) -> bool:
        count = self.shared.count
        count[Slot.WRITTEN] = min(TICKS, count[Slot.WRITTEN] + STEP)
        count[Slot.SLOW_WRITTEN] = count[Slot.WRITTEN] // 5
        if count[Slot.WRITTEN] == TICKS:
            self.shared.write(Text.ENDING, json.dumps({"interrupted": None}))
            count[Slot.STATE] = State.ENDED
        return False


def expected(field: str, ticks: np.ndarray) -> np.ndarray:
    return ticks % 200 if field == "flags" else 1.0 + FIELDS.index(field) * 1000 + ticks


def shared() -> Shared:
    made = Shared(Layout(channels=1, size=256, slow_size=64, slow_width=3))
    for i, field in enumerate(FIELDS):
        made.ring[0, i, :TICKS] = expected(field, np.arange(TICKS))
    made.slow[0] = np.arange(64)[:, None] + np.arange(3)
    made.count[Slot.STATE] = State.LIVE
    return made


def one(kind: int, passes: int, old: bytes) -> tuple[int, Shared]:
    """Record in a process of its own; how it ended, and what it said."""
    Path("run.h5").write_bytes(old)
    told = shared()
    pid = os.fork()
    if not pid:
        place = files.grow(Path("run.h5").absolute(), True, lambda path: True)
        sizes = {"sample_rate": RATE, "stride": 5, "channels": CHANNELS, "slow": SlowLayout({"weights": (3,)})}
        STATE[:] = kind, passes, 0, 0
        recorder.record(Feed(told), told, [recorder.Plan(place=place, about={"a": 1}, **sizes)])
        os._exit(0)
    _, status = os.waitpid(pid, 0)
    STATE[0] = 0
    return os.waitstatus_to_exitcode(status), told


def check(code: int, told: Shared, old: bytes) -> None:
    """What was said to be saved is there and right; a failure replaces nothing; no failure and all is there."""
    saved, new = told.count[Slot.SAVED], Path("run.new.h5")
    if STATE[3]:
        assert code == 1, "it did not say so"
        assert told.read(Text.COMPLAINT)
        assert not new.exists() or Path("run.h5").read_bytes() == old
    else:
        assert (code, saved, new.exists()) == (0, TICKS, False), told.read(Text.COMPLAINT)
    if not new.exists() and Path("run.h5").read_bytes() == old:
        assert not saved, "said to be saved, but nothing is there"
        return
    file = new if new.exists() else Path("run.h5")
    try:
        recording = Recording.load(file)
    except files.FileError:
        assert not saved, "what was said to be saved cannot be read"
        return
    n = len(recording["time"])
    assert n >= saved, f"{saved} said to be saved, {n} are there"
    for name in CHANNELS:
        np.testing.assert_array_equal(recording[name], expected(name, np.arange(n)), name)
    m = len(recording["weights"])
    np.testing.assert_array_equal(recording["weights"], np.arange(m)[:, None] + np.arange(3))
    assert m >= saved // 5 - 10


def main() -> int:
    old = b"precious"
    cases = failed = 0
    every = int(sys.argv[1])
    for name, kind in KINDS.items():
        passes, more = 0, True
        while more:
            code, told = one(kind, passes, old)
            more = kind > 0 and STATE[3] > 0
            try:
                check(code, told, old)
            except AssertionError as error:
                sys.stdout.write(f"{name} after {passes} writes: {error}\n")
                failed += 1
            told.close()
            Path("run.new.h5").unlink(missing_ok=True)
            cases, passes = cases + 1, passes + (1 if kind == errno.ENOSPC else every)
    sys.stdout.write(f"{cases} cases, {failed} failed\n")
    return failed > 0


if __name__ == "__main__":
    sys.exit(main())
