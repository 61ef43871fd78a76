"""The recorder: a process that takes the ticks out of the ring and appends them to a file that others can read."""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truestroke import loop
from truestroke._typing import FloatArray
from truestroke.realtime import watchdog
from truestroke.realtime.child import Lifeline
from truestroke.realtime.shared import FIELDS, Helper, Shared, Slot, State, Text
from truestroke.recording import ENDING, FORMAT, FORMAT_VERSION

LOOK = 0.05  # s between two looks into the ring
FLUSH = 0.1  # s between two flushes: with a look, what a kill may cost
CHUNK = 2048  # entries of a chunk of the file
ENDING_SIZE = 16384  # bytes
LATENESS = ("us", "how late the block began that the tick is in")
NEVER_ENDED = "the recording was not ended: it is still running, or its process was killed"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One file: its path and metadata, the channels that there are, the slow ones with the shape of an entry."""

    path: Path
    about: dict[str, Any]
    channels: tuple[str, ...]
    slow: tuple[tuple[str, tuple[int, ...]], ...]
    sample_rate: float
    stride: int


def record(lifeline: Lifeline, shared: Shared, plans: list[Plan]) -> None:
    """Append until the run has ended, or its process is gone; a failure is told through `Text.COMPLAINT`."""
    try:
        files = [File(plan) for plan in plans]
        for axis, file in enumerate(files):
            shared.count[Slot.ENDINGS + axis] = file.ending
        shared.count[Slot.RECORDER] = Helper.READY
        _append(lifeline, shared, files)
        for file in files:
            file.close()
    except Exception as error:
        shared.write(Text.COMPLAINT, " ".join(str(error).split()))
        shared.count[Slot.RECORDER] = Helper.FAILED
        os._exit(1)  # at a regular exit HDF5 would try again to write; what is flushed is complete
    ending = shared.read(Text.ENDING) or _unexpected(shared)
    for axis, plan in enumerate(plans):
        write_ending(plan.path, shared.count[Slot.ENDINGS + axis], ending)


def _append(lifeline: Lifeline, shared: Shared, files: list[File]) -> None:
    settled, flushed, gone = (0, 0), time.monotonic(), False
    while True:
        over = gone or shared.count[Slot.STATE] == State.ENDED  # before the counters are read: nothing comes later
        written = shared.count[Slot.WRITTEN], shared.count[Slot.SLOW_WRITTEN]
        settled = written if over else settled
        for axis, file in enumerate(files):
            file.append(shared.ring[axis], shared.slow[axis], *settled)
        shared.count[Slot.SAVED], shared.count[Slot.SLOW_SAVED] = settled
        if over:
            return
        if time.monotonic() - flushed > FLUSH - LOOK / 2:
            flushed = time.monotonic()
            for file in files:
                file.flush()
        settled = written
        gone = lifeline.gone(LOOK)


def _unexpected(shared: Shared) -> str:
    """The end of a run whose process is gone; the watchdog has a moment to act."""
    if shared.count[Slot.STATE] == State.IDLE:
        return json.dumps({"interrupted": "the run never began"})
    what = watchdog.outcome(shared)
    return json.dumps({"interrupted": f"the process of the run was killed; {what}", "ended": {"cause": "killed"}})


def write_ending(path: Path, offset: int, ending: str) -> None:
    """Write how the run ended to the place that is reserved for it, by any process, without HDF5 and on a full disk."""
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(ending.encode()[:ENDING_SIZE])


class File:
    """A recording that grows, by HDF5's single-writer multiple-reader mode.

    Attributes
    ----------
    ending : int
        Where in the file the bytes of `recording.ENDING` are.
    """

    def __init__(self, plan: Plan) -> None:
        import h5py

        self.plan, self._h5py = plan, h5py
        self._file = h5py.File(plan.path, "w", libver="latest", track_order=True)
        about = {**plan.about, "interrupted": NEVER_ENDED}
        self._file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION, metadata=json.dumps(about))
        for key, value in about.items():
            self._file.attrs[f"about {key}"] = json.dumps(value, indent=1)
        for name in ("time", *plan.channels):
            self._create(name, *loop.CHANNELS[name], "time", dtype=np.uint8 if name == "flags" else np.float64)
        self._create("lateness", *LATENESS, "time")
        if plan.slow:
            self._create("weights_time", *loop.SLOW_TIME, "weights_time")
        for name, shape in plan.slow:
            self._create(name, *loop.SLOW_CHANNELS[name], "weights_time", shape)
        reserved = self._file.create_dataset(ENDING, data=np.zeros(ENDING_SIZE, np.uint8))
        self._file.flush()
        self.ending: int = reserved.id.get_offset()
        self._file.swmr_mode = True
        self._done = self._slow_done = 0

    def _create(
        self, name: str, unit: str, description: str, time: str, shape: tuple[int, ...] = (), dtype: Any = np.float64
    ) -> None:
        sizes = {"shape": (0, *shape), "maxshape": (None, *shape), "chunks": (CHUNK if not shape else 64, *shape)}
        dataset = self._file.create_dataset(name, dtype=dtype, **sizes)
        dataset.attrs.update(unit=unit, description=description, time=time)

    def append(self, ring: FloatArray, slow: FloatArray, ticks: int, entries: int) -> None:
        """Add what is new of `ticks` ticks and `entries` slow entries."""
        new = np.arange(self._done, ticks)
        if new.size:
            rows = ring[:, new % ring.shape[1]]
            self._extend("time", new / self.plan.sample_rate)
            for name in (*self.plan.channels, "lateness"):
                self._extend(name, rows[FIELDS.index(name)])
        new = np.arange(self._slow_done, entries)
        if new.size and self.plan.slow:
            rows = slow[new % len(slow)]
            self._extend("weights_time", new * self.plan.stride / self.plan.sample_rate)
            start = 0
            for name, shape in self.plan.slow:
                width = int(np.prod(shape))
                self._extend(name, rows[:, start : start + width].reshape(-1, *shape))
                start += width
        self._done, self._slow_done = ticks, entries

    def _extend(self, name: str, values: FloatArray) -> None:
        dataset = self._file[name]
        length = len(dataset)
        dataset.resize(length + len(values), axis=0)
        dataset[length:] = values

    def flush(self) -> None:
        """Let readers see it, and let it survive us."""
        self._file.flush()

    def close(self) -> None:
        """Complete: an ordinary HDF5 file."""
        self._file.close()
