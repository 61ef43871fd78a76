"""What the processes of a run share: counters, targets, a ring of the last seconds, and short texts."""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from truestroke.base.system import Memory
from truestroke.base.typing import FloatArray
from truestroke.runtime.drivers.paced import EDGES_US
from truestroke.runtime.ticks import MARK, TICK

FIELDS = (*TICK, MARK, "lateness")
TEXT = 16384  # bytes of a text


class Slot(IntEnum):
    """The counters."""

    BEAT = 0  # blocks begun: constant if the loop has stopped
    WRITTEN = 1  # ticks that are complete in the ring
    SAVED = 2  # ticks that the recorder has taken out of it
    SLOW_WRITTEN = 3  # entries of the slow ring
    SLOW_SAVED = 4
    STATE = 5  # a State
    RECORDER = 6  # a Helper
    WATCHDOG = 7  # a Helper
    OVERRUNS = 8
    TICKS = 9  # of the whole run
    SERVER = 10  # a Helper
    STOP = 11  # not 0: somebody asks for the end of the run
    DEPUTY = 12  # a Helper: the watchdog's deputy
    WATCHDOG_BEAT = 13  # checks that they have made: constant if the process has stopped
    DEPUTY_BEAT = 14
    HOLD = 15  # not 0: somebody asks that nothing is learned
    REFUSED = 16  # requests that the door of the live page has refused, one slot a kind
    SEEK = 30  # of a replay: 1 more than the tick that somebody asks for; 0: none
    REPLAY = 31  # not 0: a recording is shown, this many thousandths as fast as the run; HOLD then pauses it
    PAGES = 32  # port at which the door reaches the pages; 0: they are not ready
    REFUSED_THERE = 33  # requests that the pages have refused, one slot a kind
    ENDINGS = 48  # where in each file the JSON of its end stands, one slot an axis


class State(IntEnum):
    """Where the run is; between IDLE and ENDED the output may be anywhere."""

    IDLE, STARTING, LIVE, STOPPING, ENDED = range(5)


class Helper(IntEnum):
    """State of a helping process."""

    ABSENT, READY, FAILED, RESCUED, NO_RESCUE, RESCUING = range(6)


class Text(IntEnum):
    """The texts."""

    ENDING = 0  # JSON for the recording, by the loop
    COMPLAINT = 1  # what the recorder failed at
    SERVER = 2  # what the server failed at


class Pulse:
    """For how long a counter of another process has been constant, as far as this process was running.

    Of the time between two checks at most `SEEN` counts: if the computer itself stopped, all processes did.
    """

    SEEN = 0.25  # s

    def __init__(self) -> None:
        self._mark: object = None
        self._still, self._looked = 0.0, time.monotonic()

    def still(self, mark: object) -> float:
        """Seconds since `mark` was another."""
        now = time.monotonic()
        self._still = self._still + min(now - self._looked, self.SEEN) if mark == self._mark else 0.0
        self._mark, self._looked = mark, now
        return self._still


SLOTS = Slot.ENDINGS + 64
BINS = len(EDGES_US) + 1


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Sizes of the shared memory.

    Axes, ticks in the ring, entries of the slow ring, numbers in each of them, further signals.
    """

    channels: int
    size: int
    slow_size: int
    slow_width: int
    signals: int = 0


class Shared:
    """Memory that goes when the last process that has it ends.

    The loop alone writes the rings, a server alone the targets. A reader takes what was WRITTEN when it looked the time
    before: that has settled.

    Attributes
    ----------
    count : memoryview of uint64
        The counters, by `Slot`.
    histogram : memoryview of uint64
        Blocks by lateness, see `drivers.paced.EDGES_US`.
    targets : memoryview of float64
        Where a `SetPoint` of each channel is sent, um, then how fast each goes, um/s; 0 at the start, which is as fast
        as it may.
    ring : ndarray, shape (channels, fields, size)
        Tick k is at k % size.
    slow : ndarray, shape (channels, slow_size, slow_width)
        What the controllers have estimated.
    signals : ndarray, shape (signals, size)
        What further inputs read in the ticks of the ring.
    """

    def __init__(self, layout: Layout, handle: int | str | None = None) -> None:
        self.layout = layout
        c, s = layout.channels, layout
        rings = (8 * c * len(FIELDS) * s.size, 8 * c * s.slow_size * s.slow_width, 8 * s.signals * s.size)
        sizes = (8 * SLOTS, 8 * BINS, 16 * c, *rings, len(Text) * TEXT)
        starts = np.concatenate([[0], np.cumsum(sizes)]).tolist()
        self._memory = Memory(starts[-1], handle)
        parts = self._memory.buffer
        counts, histogram, targets, ring, slow, signals, self._texts = (
            parts[a:b] for a, b in itertools.pairwise(starts)
        )
        self.count: memoryview[int] = counts.cast("Q")
        self.histogram: memoryview[int] = histogram.cast("Q")
        self.targets: memoryview[float] = targets.cast("d")
        self.ring: FloatArray = np.frombuffer(ring).reshape(c, len(FIELDS), s.size)
        self.slow: FloatArray = np.frombuffer(slow).reshape(c, s.slow_size, s.slow_width)
        self.signals: FloatArray = (np.frombuffer(signals) if s.signals else np.empty(0)).reshape(s.signals, s.size)

    def __reduce__(self) -> tuple[type[Shared], tuple[Layout, int | str]]:
        return Shared, (self.layout, self._memory.handle)

    @property
    def descriptors(self) -> tuple[int, ...]:
        """What a process has to inherit to get it."""
        return self._memory.descriptors

    def last(self, channel: int, end: int, length: int) -> FloatArray:
        """Rows desired, measured (um), volts (V) of an axis: `length` ticks up to tick `end`, or those there are."""
        rows = np.arange(max(0, end - length), end) % self.layout.size
        return np.array([self.ring[channel, FIELDS.index(name)][rows] for name in ("desired", "measured", "volts")])

    def write(self, text: Text, value: str) -> None:
        """Leave a text for the others, cut to the space."""
        data = value.encode()[: TEXT - 1]
        self._texts[text * TEXT : text * TEXT + len(data) + 1] = data + b"\0"

    def read(self, text: Text) -> str:
        """A text that another has left, or an empty one."""
        return bytes(self._texts[text * TEXT : (text + 1) * TEXT]).split(b"\0")[0].decode(errors="replace")

    def refused(self, kinds: int) -> list[int]:
        """Requests that the live page has refused, by kind, at its door and behind it."""
        both = (Slot.REFUSED, Slot.REFUSED_THERE)
        return [sum(self.count[slot + kind] for slot in both) for kind in range(kinds)]

    def close(self) -> None:
        """Let go of its handle; the memory itself is freed with the arrays."""
        self._memory.close()
