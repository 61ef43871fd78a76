"""What is recorded of each tick, and to which tick a measurement belongs: the same in the loop and in real time.

The native loop (c/loops, `runtime.native`) fills the same channels; a test compares the bits of the two.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base import system
from truestroke.base.checks import SettingError
from truestroke.base.flags import BIT, BY_ADAPT
from truestroke.base.typing import FloatArray
from truestroke.signals.channels import Array
from truestroke.signals.timing import Timing

BYTES = 220.0  # of memory for a tick of an axis that is simulated and recorded
SLOW_PERIOD = 0.01  # s between two entries of the slow channels
DESIRED = ("desired", "desired_velocity")
SIMULATED = ("volts", "measured", "true", "innovation", "flags")
MARK = "flat"
"""Where errors count; of a trajectory that marks it."""
TICK = (*DESIRED, *SIMULATED)
"""Channels with an entry each tick, beside the time. NaN stands where no measurement came, and for the innovation of a
rejected one."""
SLOW = ("weights", "partial_slopes", "trace_P")
"""Channels with an entry each `SLOW_PERIOD`: what the controller has learned."""


def stride(timing: Timing) -> int:
    """Ticks from one slow entry to the next."""
    return max(1, round(SLOW_PERIOD * timing.sample_rate))


def recorded(trajectory: Any, controller: Any, simulated: bool) -> tuple[str, ...]:
    """Those of `TICK` and `MARK` that there are.

    Flags and innovation as the controller has them, the truth of a simulation, the mark of a trajectory.
    """
    attributes = {"innovation": "innovation", "flags": "flag_bits"}
    there = {"true": simulated, **{name: hasattr(controller, of) for name, of in attributes.items()}}
    marks = () if getattr(trajectory, MARK, None) is None else (MARK,)
    return (*(name for name in TICK if there.get(name, True)), *marks)


@dataclass(frozen=True)
class SlowLayout:
    """The slow channels that a controller has, side by side in rows of numbers: shapes of an entry of each."""

    shapes: Mapping[str, tuple[int, ...]]

    @classmethod
    def of(cls, controller: Any) -> SlowLayout:
        """That of a controller: what it or its `diagnostics` has of `SLOW`."""
        return cls({name: value.shape for name, value in _slow_values(controller).items()})

    @property
    def width(self) -> int:
        """Numbers of a row."""
        return sum(map(math.prod, self.shapes.values()))

    def split(self, rows: FloatArray) -> dict[str, FloatArray]:
        """Entries of each channel, from rows of shape (entries, width or more)."""
        ends = itertools.accumulate(map(math.prod, self.shapes.values()))
        return {
            name: rows[:, end - math.prod(shape) : end].reshape(-1, *shape)
            for (name, shape), end in zip(self.shapes.items(), ends, strict=True)
        }


def _slow_values(controller: Any) -> dict[str, FloatArray]:
    source = getattr(controller, "diagnostics", controller)
    values = ((name, getattr(source, name, None)) for name in SLOW)
    return {name: np.asarray(value, np.float64) for name, value in values if value is not None}


class TickRecorder:
    """Records commands and measurements, tick by tick, and flags, innovation and weights as the controller has them.

    With a latency of L ticks, entry k of an exchange is recorded at tick k - L, that of its command. `rows` are arrays
    of `TICK`, all of one size: tick k is at k modulo that size. `slow`, shape (entries, width), are the slow channels
    as `SlowLayout` has them: entry j, of tick j `stride`, is at j modulo the entries.
    """

    def __init__(self, controller: Any, timing: Timing, rows: Mapping[str, Array], slow: FloatArray) -> None:
        self._controller, self._latency, self._slow = controller, timing.latency, slow
        self._flagged, self._innovative = hasattr(controller, "flag_bits"), hasattr(controller, "innovation")
        self._stride, self._size = stride(timing), rows["volts"].size
        # number by number faster than NumPy
        memory: list[memoryview[Any]] = [rows[name].data for name in SIMULATED[1:]]
        self._measured, self._true, self._innovation, self._flags = memory

    def commanded(self, k: int) -> None:
        """After the command of tick k: its flags; nothing is measured yet."""
        row = k % self._size
        self._measured[row] = self._true[row] = self._innovation[row] = math.nan
        self._flags[row] = self._controller.flag_bits & ~BY_ADAPT if self._flagged else 0

    def answers(
        self, start: int, stop: int, measured: FloatArray, truth: FloatArray | None = None
    ) -> Iterator[tuple[int, float, int]]:
        """Each measurement of an exchange, ticks `start` to `stop`: the tick it belongs to, its value, um, its age.

        The loop adapts to each; the result is recorded when the next one is requested.
        """
        for i, z in enumerate(measured.tolist()):
            k = start + i - self._latency
            if k >= 0:  # earlier ones belong to no command
                row = k % self._size
                self._measured[row] = z
                if truth is not None:
                    self._true[row] = truth[i]
                yield k, z, stop - 1 - k  # the age is `ago` of Controller.adapt
                self._adapted(row)
            self.learned(start + i)

    def _adapted(self, row: int) -> None:
        bits = self._controller.flag_bits & BY_ADAPT if self._flagged else 0
        self._flags[row] += bits
        if self._innovative and not bits & BIT["rejected"]:
            self._innovation[row] = self._controller.innovation

    def learned(self, k: int) -> None:
        """After tick k: the slow channels, if it is one of theirs."""
        if k % self._stride:
            return
        row, start = self._slow[k // self._stride % len(self._slow)] if self._slow.size else self._slow, 0
        for value in _slow_values(self._controller).values():
            row[start : start + value.size] = value.ravel()
            start += value.size


def require_memory(name: str, ticks: int, axes: int = 1) -> None:
    """SettingError where the recording of a simulation would not fit the memory."""
    if lacking := system.lacking(BYTES * ticks * axes):
        most = f"at most {system.free_memory() / (BYTES * axes):.3g}"
        bound = f"{most}: a recording of {ticks:.3g} takes {lacking}. Move for less time, or at a lower sample rate"
        raise SettingError(name, f"of {ticks} ticks", bound)
