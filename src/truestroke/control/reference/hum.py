"""Hum: sines of known frequency that come from outside. The law learns from a measurement without them.

An adaptive noise canceller: of each line the amplitude a follows what the model does not expect, ::

    a += 20 Hz T e_m exp(j w t)

so that a change of hum is followed within 50 ms, and what is further than some hertz from the line stays. The law would
take what the command does against a load for a property of the actuator: the plays of a stage that is shaken by 0.1 um
at 71 Hz had a third of their slope. Where no feedback has resonators for the lines the command subtracts them.

Source: Widrow et al., Adaptive noise cancelling: principles and applications, Proc. IEEE 63 (1975).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from truestroke.control.reference.state import State

LINES = 6  # at most: TS_LINES of the kernel
FOLLOWED = 20  # 1/s: how fast their amplitudes follow
LARGEST_HUM = 0.02  # of the stroke: of one line
LOUD_LINE = 0.002  # of the stroke: twice a line that may have been taken for the stage
NEAR_RESONANCE = 0.5  # of it: from there on a line is not subtracted
AS_LOUD = 2  # times a line: a half-wave of an oscillation beside it
OF_LINE = 0.2  # of the frequency of a line: what is shown so near to it is the line
BEGINS = 5  # times 1 / FOLLOWED: until then the amplitudes are not known
LONG_OVER = 0.2  # s at that bound, after which the command drives a line, and leaves it alone


@dataclass
class Hum:
    """What is known of each line: ts_hum_state of the kernel."""

    turn: list[list[float]] = field(default_factory=lambda: [[1.0, 0.0] for _ in range(LINES)])
    sine: list[list[float]] = field(default_factory=lambda: [[0.0, 0.0] for _ in range(LINES)])  # um: amplitudes
    over: list[float] = field(default_factory=lambda: [0.0] * LINES)  # s: at that bound, without a break
    subtracted: float = 0.0  # um: of the last command


def rotated(turn: list[float], line: tuple[float, float, float]) -> list[float]:
    """Cosine and sine a tick later; their squares still add up to one."""
    cosine, sine = turn[0] * line[0] - turn[1] * line[1], turn[1] * line[0] + turn[0] * line[1]
    unit = 1.5 - (cosine * cosine + sine * sine) / 2
    return [unit * cosine, unit * sine]


def tick_of_hum(c: State) -> None:
    """The next tick that is measured, or passed over."""
    for i, line in enumerate(c.members["hum.line"]):
        c.hum.turn[i] = rotated(c.hum.turn[i], line)


def hum_of(c: State) -> float:
    """In the measurement of this tick, um."""
    total = 0.0
    for a, turn, _ in zip(c.hum.sine, c.hum.turn, c.members["hum.line"], strict=False):
        total += a[0] * turn[0] + a[1] * turn[1]
    return total


def follow_hum(c: State, innovation: float) -> None:
    """What the model did not expect of this tick, um, is hum as far as it has its frequency."""
    tick, most = c.oscillation.tick, LARGEST_HUM * c.settings.stroke
    step = min(FOLLOWED * tick, 1) * innovation
    for i, _ in enumerate(c.members["hum.line"]):
        a, turn = c.hum.sine[i], c.hum.turn[i]
        a = [min(max(a[0] + step * turn[0], -most), most), min(max(a[1] + step * turn[1], -most), most)]
        c.hum.sine[i] = a
        if c.hum.over[i] < LONG_OVER:
            c.hum.over[i] = 0.0 if max(abs(a[0]), abs(a[1])) < most else c.hum.over[i] + tick


def begins(c: State, ago: int = 0) -> bool:
    """Whether the amplitudes are not known yet, so many ticks ago."""
    return c.measured_ticks < ago or (c.measured_ticks - ago) * c.oscillation.tick * FOLLOWED < BEGINS


def power_of_hum(c: State) -> float:
    """Mean square of the lines, um^2: beside a smaller error nothing is shown of a resonance."""
    total = 0.0
    for a, _ in zip(c.hum.sine, c.members["hum.line"], strict=False):
        total += (a[0] * a[0] + a[1] * a[1]) / 2
    return total


def is_hum(c: State, frequency: float, amplitude: float) -> bool:
    """Whether an oscillation of this frequency, cycles per tick, and amplitude, um, is a line."""
    for a, line in zip(c.hum.sine, c.members["hum.line"], strict=False):
        turns = line[2] * c.oscillation.tick / (2 * math.pi)
        if abs(frequency / turns - 1) < OF_LINE and amplitude < AS_LOUD * math.sqrt(a[0] * a[0] + a[1] * a[1]):
            return True
    return False


def is_near_resonance(c: State, line: tuple[float, float, float]) -> bool:
    """Near the resonance, or above it, the model does not know enough of what the stage makes of a command."""
    turns = line[2] * c.oscillation.tick / (2 * math.pi)
    resonance = c.members["dynamics.first"] if c.is_given else c.stage.resonance
    return bool(resonance > 0 and turns > NEAR_RESONANCE * resonance)


def subtracted(c: State) -> tuple[float, float]:
    """What a command that takes hum away subtracts from the displacement, and from what the stage asks beyond it, um.

    A feedback that has resonators takes it away itself.
    """
    total = ahead = 0.0
    if (c.is_given and c.members["feedback.filter"]) or begins(c):
        return total, ahead
    first, second = c.path.lead if c.path is not None else (0.0, c.stage.inertia * c.oscillation.tick)
    for i, line in enumerate(c.members["hum.line"]):
        if not c.hum.over[i] < LONG_OVER or is_near_resonance(c, line):
            continue
        turn, a, w = c.hum.turn[i], c.hum.sine[i], line[2]
        for _ in range(c.measured_ticks, c.counters["commands"] + 1):
            turn = rotated(turn, line)
        now, quarter = a[0] * turn[0] + a[1] * turn[1], a[1] * turn[0] - a[0] * turn[1]
        total += now
        ahead += first * (w * quarter) - second * (w * w * now)
    return total, ahead
