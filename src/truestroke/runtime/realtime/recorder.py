"""The recorder: a process that takes the ticks out of the ring and appends them to a file that others can read."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base.files import Growing
from truestroke.base.hdf5 import ENDING
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.protocol import Signal
from truestroke.runtime.realtime import watchdog
from truestroke.runtime.realtime.process import Lifeline
from truestroke.runtime.realtime.shared import FIELDS, Helper, Shared, Slot, State, Text
from truestroke.runtime.ticks import SlowLayout
from truestroke.signals.channels import Channel, channel, dtype
from truestroke.signals.recording import MODE, create, describe, seal, sealed

LOOK = 0.05  # s between two looks into the ring
PIECE = 0.1  # s that a chunk of the file holds: with two cycles, the longest loss by a kill
PAGE = 4096  # bytes that a disk writes whole or not at all; none of HDF5's tables crosses the end of one
CHECKSUM = 4  # bytes of that of a chunk
ENDING_SIZE = 16384  # bytes
# `Growing` has the file locked. HDF5's own lock would meet that one outside of Linux, and that of a reader who looks
# at the file while it is made: the run would not begin.
UNLOCKED: dict[str, Any] = {"locking": False}
NEVER_ENDED = "the recording was not ended: it is still running, or its process was killed"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One file: its place and metadata, the channels that there are, and the further signals that stand in it."""

    place: Growing
    about: dict[str, Any]
    channels: tuple[str, ...]
    slow: SlowLayout
    sample_rate: float
    stride: int
    signals: tuple[Signal, ...] = ()


def record(lifeline: Lifeline, shared: Shared, plans: list[Plan]) -> None:
    """Append until the run has ended, or its process is gone; a failure is written to `Text.COMPLAINT`.

    A file that replaces another takes its name at the very end, and only if something was recorded.
    """
    try:
        files = [File(plan) for plan in plans]
        for axis, file in enumerate(files):
            shared.count[Slot.ENDINGS + axis] = file.ending
        shared.count[Slot.RECORDER] = Helper.READY
        _append(lifeline, shared, files)
        for file in files:
            file.close()
        ending = shared.read(Text.ENDING) or _unexpected(shared)
        for file in files:
            write_ending(file.plan.place, file.ending, ending)
            if file.ticks:
                file.plan.place.complete()
    except Exception as error:
        shared.write(Text.COMPLAINT, " ".join(str(error).split()))
        shared.count[Slot.RECORDER] = Helper.FAILED
        os._exit(1)  # at a regular exit HDF5 would try again to write; what is flushed is complete


def _append(lifeline: Lifeline, shared: Shared, files: list[File]) -> None:
    settled, gone = (0, 0), False
    while True:
        over = gone or shared.count[Slot.STATE] == State.ENDED  # before the counters are read: nothing comes later
        written = shared.count[Slot.WRITTEN], shared.count[Slot.SLOW_WRITTEN]
        settled = written if over else settled
        for axis, file in enumerate(files):
            file.append(shared.ring[axis], shared.slow[axis], shared.signals, *settled, over)
        shared.count[Slot.SAVED], shared.count[Slot.SLOW_SAVED] = files[0].ticks, files[0].entries
        if over:
            return
        settled = written
        gone = lifeline.gone(LOOK)


def _unexpected(shared: Shared) -> str:
    """The end of a run whose process is gone; the watchdog has a moment to act."""
    if shared.count[Slot.STATE] == State.IDLE:
        return json.dumps({"interrupted": "the run never began"})
    what = watchdog.outcome(shared)
    return json.dumps({"interrupted": f"the process of the run was killed; {what}", "ended": {"cause": "killed"}})


def write_ending(place: Growing, offset: int, ending: str) -> None:
    """Write the end of the run to the space reserved for it, by any process, without HDF5 and on a full disk.

    Into the open file, under any name.
    """
    place.write(offset, sealed(ending, ENDING_SIZE))


def piece(entries: float, size: int) -> int:
    """Entries of `size` bytes in a chunk, about as many, so that little of its pages, or of its part of one, is empty.

    Examples
    --------
    >>> piece(200, 8), piece(10, 424)
    (255, 9)
    """
    whole = max(1, round(entries)) * size + CHECKSUM
    room = PAGE // (PAGE // whole) if whole <= PAGE else whole // PAGE * PAGE
    return max(1, (room - CHECKSUM) // size)


class File:
    """A recording that grows, by HDF5's single-writer multiple-reader mode.

    Each chunk is written whole and once, before the lengths that readers use: they never read a half written chunk, or
    one that a full disk refused. `ticks` are in the file, taken by the system; its byte `ending` is the first of
    `recording.ENDING`.
    """

    def __init__(self, plan: Plan) -> None:
        import h5py

        self.plan, self._h5py = plan, h5py
        self._name = plan.place.name
        slow = plan.slow.shapes
        widest = max(map(math.prod, slow.values()), default=1)
        self._piece = piece(PIECE * plan.sample_rate, 8)
        self._slow_piece = piece(PIECE * plan.sample_rate / plan.stride, 8 * widest)
        paged: dict[str, Any] = {"fs_strategy": "page", "fs_page_size": PAGE}
        paged |= {"rdcc_nbytes": 0}  # a cache of chunks would be 1 MB of each dataset
        self._file = h5py.File(self._name, "w", **MODE, **UNLOCKED, **paged)
        describe(self._file, {**plan.about, "interrupted": NEVER_ENDED})
        self._sets: dict[str, Any] = {}  # kept open: HDF5 reports a failure to write only where one is used or flushed
        for name in ("time", *plan.channels, "lateness"):
            self._create(name, self._piece)
        for signal in plan.signals:
            self._create(signal.name, self._piece, of=Channel(np.empty(0), signal.unit, signal.source))
        for name, shape in {"weights_time": (), **slow}.items() if slow else ():
            self._create(name, self._slow_piece, shape, "weights_time")
        seal(self._file)
        reserved = self._file.create_dataset(ENDING, data=np.zeros(ENDING_SIZE, np.uint8))
        self._file.flush()
        reserved.make_scale(ENDING)  # of its own axis: no reader has to invent one
        self._file.flush()
        self.ending: int = reserved.id.get_offset()
        self._file.swmr_mode = True
        self.ticks = self.entries = 0

    def _create(
        self, name: str, piece: int, shape: tuple[int, ...] = (), time: str = "time", of: Channel | None = None
    ) -> None:
        sizes = {"maxshape": (None, *shape), "chunks": (piece, *shape)}
        empty = of or channel(name, np.empty((0, *shape), dtype(name)), time)
        self._sets[name] = create(self._file, name, empty, fletcher32=True, **sizes)

    def append(
        self, ring: FloatArray, slow: FloatArray, signals: FloatArray, ticks: int, entries: int, last: bool
    ) -> None:
        """Add what is new of `ticks` ticks and `entries` slow entries: whole chunks, if it is not the last time."""
        if not last:
            ticks, entries = ticks - ticks % self._piece, entries - entries % self._slow_piece
        if ticks <= self.ticks and entries <= self.entries:
            return
        self._append_ticks(ring, signals, ticks)
        self._append_slow(slow, entries)
        for dataset in self._sets.values():
            dataset.flush()
        self._file.flush()
        self.ticks, self.entries = ticks, entries

    def _append_ticks(self, ring: FloatArray, signals: FloatArray, ticks: int) -> None:
        new = np.arange(self.ticks, ticks)
        if new.size:
            rows = ring[:, new % ring.shape[1]]
            self._extend("time", new / self.plan.sample_rate)
            for name in (*self.plan.channels, "lateness"):
                self._extend(name, rows[FIELDS.index(name)])
            for signal, row in zip(self.plan.signals, signals, strict=False):  # they stand in one of the files
                self._extend(signal.name, row[new % ring.shape[1]])

    def _append_slow(self, slow: FloatArray, entries: int) -> None:
        new = np.arange(self.entries, entries)
        if new.size and self.plan.slow.width:
            self._extend("weights_time", new * self.plan.stride / self.plan.sample_rate)
            for name, values in self.plan.slow.split(slow[new % len(slow)]).items():
                self._extend(name, values)

    def _extend(self, name: str, values: FloatArray) -> None:
        dataset = self._sets[name]
        length = len(dataset)
        dataset.resize(length + len(values), axis=0)
        dataset[length:] = values

    def close(self) -> None:
        """Complete: an ordinary HDF5 file. It is opened once more, as HDF5 does not report every failure at the end."""
        lengths = {name: len(dataset) for name, dataset in self._sets.items()}
        self._file.close()
        with self._h5py.File(self._name, "r", **UNLOCKED) as file:
            short = [name for name, length in lengths.items() if len(file[name]) != length]
        if short:
            raise OSError(f"{', '.join(short)}: not all of it is in the file")
