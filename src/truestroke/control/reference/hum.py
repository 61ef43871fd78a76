"""Hum: sines of known frequency that come from outside. The law learns without what has their frequencies.

An adaptive noise canceller: of each line the amplitude a follows what the model does not expect, ::

    a += 20 Hz T e_m exp(j w t)

so that a change of hum is followed within 50 ms, and what is further than some hertz from the line stays. The law would
take what the command does against a load for a property of the actuator: the plays of a stage that is shaken by 0.1 um
at 71 Hz had a third of their slope. So the same canceller takes the lines out of regressor and measurement before it
learns. Where no feedback has resonators for the lines the command subtracts them.

Beside given dynamics a tone beyond their resonance that they do not explain is such a line, too: what a further mode
makes of the motion, or the feedback of that mode. Law and feedback do without it.

Source: Widrow et al., Adaptive noise cancelling: principles and applications, Proc. IEEE 63 (1975).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control import feedback
from truestroke.control.adaptation import LARGEST
from truestroke.control.angles import tangent
from truestroke.control.tone import STEADY_TONE, ToneDetector

if TYPE_CHECKING:
    from truestroke.control.reference.state import State

HEARD = 4  # lines that nobody has named, at most: two loads, and two beyond the resonance; TS_HEARD of the kernel
LINES = feedback.LINES + HEARD  # at most, with those that are named: TS_LINES
FOLLOWED = 20  # 1/s: how fast their amplitudes follow
FORGOTTEN = 4  # 1/s: how fast they decay without measurements
LARGEST_HUM = 0.02  # of the stroke: of one line
LOUD_LINE = 0.002  # of the stroke: twice a line that may have been taken for the stage
NEAR_RESONANCE = 0.5  # of it: from there on a line is not subtracted
AS_LOUD = 2  # times a line: a half-wave of an oscillation beside it
OF_LINE = 0.2  # of the frequency of a line: what is shown so near to it is the line
SAME_LINE = 0.02  # of the frequency of a line: a load that is so near to it is that line
EARS = 8  # detectors that look for a load at the same time
HIGHEST_LOAD = 100  # Hz,
FASTEST_LOAD = 0.1  # and cycles per tick: where the search for a load begins, if no resonance is known,
LOWEST_LOAD = 10  # Hz: where it ends,
NEXT_LOAD = 0.6  # and how it goes down,
NEXT_OF_EAR = 0.01679616  # that of each detector eight times as fast
MEAN_OF = 1  # s: of the mean of what the first weights explain
LARGE_MOTION = 0.1  # of the stroke: rms of a motion, of which a second is remembered
STEADY_LOAD = 0.8  # as `STEADY_TONE`, in the error, which a law that still learns changes,
STEADY_BESIDE_F0 = 0.9  # and in what the first weights do not explain, where f0 alone is given
ORDERS = 20.5  # of a harmonic of the motion: a tone there may be of it
BLOCKS_HEARD = 10  # of a centre
BEGINS = 5  # times 1 / FOLLOWED: until then the amplitudes are not known
LONG_OVER = 0.2  # s at that bound, after which the command drives a line, and leaves it alone
JUDGED_AFTER = 0.5  # s: when it is known what a line that was heard does
NO_LOAD = 0.05  # of the amplitude with which it was heard: a smaller one is none,
DRIVEN_UP = 5  # and so many times it that of a line that the command drives
REFUSED_FOR = 5  # s: how long a line that was dropped is not heard again,
NEAR_REFUSED = 0.1  # nor one so near to it, of its frequency
HIGHEST_BEYOND = 0.42  # cycles per tick: where the search for a line beyond the resonance begins,
LOWEST_BEYOND = 2.2  # times the first resonance of given dynamics: where it ends,
NEXT_BEYOND = 0.7  # and how it goes down
MOST_LOADS = 2  # that are heard at the same time; the others of HEARD are beyond the resonance
TIME_BEYOND = 0.02  # s of a centre, at least
STEADY_BEYOND = 2.4  # as `STEADY_TONE`, over the root of the blocks: noise has more in one window of a hundred,
LEAST_STEADY = 0.4  # and at least
BLOCKS_BEYOND = 9  # of a centre, at least
AUDIBLE_BEYOND = 0.3  # times the noise of the law
LEAST_BEYOND = 0.1  # share of the mean square of the error
SAME_BEYOND = 0.05  # of the frequency of such a line: what is heard so near to it is that line
WIDTH_BEYOND = 0.02  # of 2 pi times its frequency: how fast the amplitude of such a line follows


@dataclass
class Load:
    """One that nobody has named: ts_load of the kernel."""

    line: tuple[float, float, float]  # cosine and sine of its angle in a tick, and 1/s
    announced: float  # um: amplitude with which it was heard
    beyond: bool = False  # the resonance of given dynamics: it is kept from the law, and no load
    age: float = 0.0  # s: since then
    error: list[float] = field(default_factory=lambda: [0.0, 0.0])  # um: what the error has of it,
    first: list[float] = field(default_factory=lambda: [0.0, 0.0])  # and the other signal in which loads are heard
    fed_back: list[float] = field(default_factory=lambda: [0.0, 0.0])  # um: what the error has, kept from the feedback

    def tune(self, line: tuple[float, float, float], amplitude: float) -> None:
        """A line beyond the resonance that is heard again, louder: the louder, the better its frequency is known."""
        if amplitude > self.announced:
            self.line, self.announced = line, amplitude

    def is_none(self, size: float) -> bool:
        """Whether nothing is there, or the command that takes it away makes it larger; size: its amplitude, um."""
        shows, remains = amplitude_of(self.first), amplitude_of(self.error)
        if size > DRIVEN_UP * self.announced and remains > self.announced:
            return True
        nothing = max(size, shows) < NO_LOAD * self.announced
        return self.age > JUDGED_AFTER and (remains > max(size, self.announced) or nothing)


@dataclass
class Ear:
    """A detector that looks for a load: ts_ear of the kernel."""

    centre: float = 0.0  # cycles per tick: about which; 0: it has not begun
    power: float = 0.0  # um^2: sum of squares of what is looked at, beyond the resonance
    tone: ToneDetector | None = None  # begun, of that centre
    of_error: bool = False  # in the error, in place of what the first weights do not explain


@dataclass
class Unexplained:
    """Means and sums of a straight line through measurements: ts_unexplained of the kernel."""

    expected: float = 0.0  # um: mean of the plays with their first weights,
    z: float = 0.0  # and of the measurement
    square: float = 0.0  # um^2 s: what was summed beside them; 0: it has not begun
    product: float = 0.0


@dataclass
class Hum:
    """What is known of each line: ts_hum_state of the kernel."""

    turn: list[list[float]] = field(default_factory=lambda: [[1.0, 0.0] for _ in range(LINES)])
    sine: list[list[float]] = field(default_factory=lambda: [[0.0, 0.0] for _ in range(LINES)])  # um: amplitudes
    heard: list[Load] = field(default_factory=list)  # lines that nobody has named
    refused: list[tuple[float, float]] = field(default_factory=list)  # 1/s and s: of lines that were dropped, how long
    over: list[float] = field(default_factory=lambda: [0.0] * LINES)  # s: at that bound, without a break
    ears: list[Ear] = field(default_factory=lambda: [Ear() for _ in range(EARS)])
    beyond: Ear = field(default_factory=Ear)  # that looks beyond the resonance of given dynamics
    unexplained: Unexplained = field(default_factory=Unexplained)
    subtracted: float = 0.0  # um: of the last command
    regressor: dict[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)  # of a line: V or um
    measurement: list[list[float]] = field(default_factory=lambda: [[0.0, 0.0] for _ in range(LINES)])  # um


def lines_of(c: State) -> list[tuple[float, float, float]]:
    """Those that are named, and those that were heard: of each cosine and sine of its angle in a tick, and 1/s."""
    named: list[tuple[float, float, float]] = c.members["hum.line"]
    return named + [load.line for load in c.hum.heard]


def is_beyond(c: State, i: int) -> bool:
    """Whether it was heard beyond the resonance: what the dynamics miss there, such as a further mode, is no load."""
    named = len(c.members["hum.line"])
    return i >= named and c.hum.heard[i - named].beyond


def share_of(c: State, i: int, times: int) -> float:
    """Share per tick by which a line is followed, `times` as fast as its amplitude."""
    faster = WIDTH_BEYOND * lines_of(c)[i][2] if is_beyond(c, i) else 0.0
    return min(times * max(faster, FOLLOWED) * c.oscillation.tick, 1)


def amplitude_of(a: list[float]) -> float:
    """Of cosine and sine, um."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1])


def size_of_line(c: State, i: int) -> float:
    """Amplitude, um."""
    return amplitude_of(c.hum.sine[i])


def rotated(turn: list[float], line: tuple[float, float, float]) -> list[float]:
    """Cosine and sine a tick later; their squares still add up to one."""
    cosine, sine = turn[0] * line[0] - turn[1] * line[1], turn[1] * line[0] + turn[0] * line[1]
    unit = 1.5 - (cosine * cosine + sine * sine) / 2
    return [unit * cosine, unit * sine]


def tick_of_hum(c: State) -> None:
    """The next tick that is measured, or passed over."""
    for i, line in enumerate(lines_of(c)):
        c.hum.turn[i] = rotated(c.hum.turn[i], line)


def miss_hum(c: State) -> None:
    """A tick without a measurement: a frequency that is a little off takes the phase away, so the amplitudes decay."""
    rate = FORGOTTEN * c.oscillation.tick
    kept = 1 - rate if rate < 1 else 0.0
    tick_of_hum(c)
    for i, _ in enumerate(lines_of(c)):
        c.hum.sine[i] = [kept * a for a in c.hum.sine[i]]


def hum_of(c: State) -> float:
    """In the measurement of this tick, um."""
    total = 0.0
    for a, turn, _ in zip(c.hum.sine, c.hum.turn, lines_of(c), strict=False):
        total += a[0] * turn[0] + a[1] * turn[1]
    return total


def follow_hum(c: State, innovation: float) -> None:
    """What the model did not expect of this tick, um, is hum as far as it has its frequency."""
    tick, stroke = c.oscillation.tick, c.settings.stroke
    for i, _ in enumerate(lines_of(c)):
        most = stroke if is_beyond(c, i) else LARGEST_HUM * stroke
        step = share_of(c, i, 1) * innovation
        a, turn = c.hum.sine[i], c.hum.turn[i]
        a = [min(max(a[0] + step * turn[0], -most), most), min(max(a[1] + step * turn[1], -most), most)]
        c.hum.sine[i] = a
        if c.hum.over[i] < LONG_OVER:
            c.hum.over[i] = 0.0 if max(abs(a[0]), abs(a[1])) < most else c.hum.over[i] + tick


def without_hum(c: State, u: FloatArray, y: float) -> tuple[FloatArray, float]:
    """The same canceller takes each line out of a regressor and out of what belongs to it.

    Their linear relation stays, without what the command does against the line.
    """
    for i, _ in enumerate(lines_of(c)):
        rate = share_of(c, i, 2)
        (cosine, sine), of_y = c.hum.turn[i], c.hum.measurement[i]
        a, b = c.hum.regressor.get(i) or (np.zeros(u.size), np.zeros(u.size))
        u = u - cosine * a - sine * b
        c.hum.regressor[i] = a + rate * cosine * u, b + rate * sine * u
        y = y - cosine * of_y[0] - sine * of_y[1]
        c.hum.measurement[i] = [of_y[0] + rate * cosine * y, of_y[1] + rate * sine * y]
    return u, y


def without_beyond(c: State, error: float) -> float:
    """The error that is fed back, um: without what is beyond the resonance, where no margin is known."""
    named = len(c.members["hum.line"])
    for i, load in enumerate(c.hum.heard, named):
        if not load.beyond:
            continue
        rate, turn, of = share_of(c, i, 2), c.hum.turn[i], load.fed_back
        error = error - turn[0] * of[0] - turn[1] * of[1]
        load.fed_back = [of[0] + rate * turn[0] * error, of[1] + rate * turn[1] * error]
    return error


def begins(c: State, ago: int = 0) -> bool:
    """Whether the amplitudes are not known yet, so many ticks ago."""
    return c.measured_ticks < ago or (c.measured_ticks - ago) * c.oscillation.tick * FOLLOWED < BEGINS


def power_of_hum(c: State) -> float:
    """Mean square of the lines but those beyond the resonance, um^2: a smaller error shows nothing of a resonance."""
    total = 0.0
    for i, _ in enumerate(lines_of(c)):
        a = c.hum.sine[i]
        if not is_beyond(c, i):
            total += (a[0] * a[0] + a[1] * a[1]) / 2
    return total


def is_hum(c: State, frequency: float, amplitude: float) -> bool:
    """Whether an oscillation of this frequency, cycles per tick, and amplitude, um, is a line.

    One beyond the resonance may be the stage.
    """
    for i, line in enumerate(lines_of(c)):
        turns = line[2] * c.oscillation.tick / (2 * math.pi)
        near = abs(frequency / turns - 1) < OF_LINE
        if not is_beyond(c, i) and near and amplitude < AS_LOUD * size_of_line(c, i):
            return True
    return False


def first_resonance(c: State) -> float:
    """Of the stage, cycles per tick; 0: it is not known."""
    return float(c.members["dynamics.first"] if c.is_given else c.stage.resonance)


def is_near_resonance(c: State, line: tuple[float, float, float]) -> bool:
    """Near the resonance, or above it, the model does not know enough of what the stage makes of a command."""
    turns, resonance = line[2] * c.oscillation.tick / (2 * math.pi), first_resonance(c)
    return resonance > 0 and turns > NEAR_RESONANCE * resonance


def subtracted(c: State) -> tuple[float, float]:
    """What a command that takes hum away subtracts from the displacement, and from what the stage asks beyond it, um.

    A feedback that has resonators takes it away itself.
    """
    total = ahead = 0.0
    if begins(c):
        return total, ahead
    first, second = c.path.lead if c.path is not None else (0.0, c.stage.inertia * c.oscillation.tick)
    taken = len(c.members["hum.line"]) if c.is_given and c.members["feedback.filter"] else 0  # by the feedback
    for i, line in enumerate(lines_of(c)):
        if i < taken:
            continue
        if not c.hum.over[i] < LONG_OVER or is_beyond(c, i) or is_near_resonance(c, line):
            continue
        turn, a, w = c.hum.turn[i], c.hum.sine[i], line[2]
        for _ in range(c.measured_ticks, c.counters["commands"] + 1):
            turn = rotated(turn, line)
        now, quarter = a[0] * turn[0] + a[1] * turn[1], a[1] * turn[0] - a[0] * turn[1]
        total += now
        ahead += first * (w * quarter) - second * (w * w * now)
    return total, ahead


def loudness_of(c: State, i: int) -> float:
    """Amplitude, um, which another line has to exceed by far that takes the place of this one.

    What is beyond the resonance may be quiet since it is kept from law and feedback.
    """
    announced = c.hum.heard[i - len(c.members["hum.line"])].announced if is_beyond(c, i) else 0.0
    return max(size_of_line(c, i), announced)


def place_of(c: State, beyond: bool) -> int:
    """The place of a line that is heard, among those that were.

    A free one, or, where as many of its kind were heard before as can be, that of the quietest of them.
    """
    named, most = len(c.members["hum.line"]), HEARD - MOST_LOADS if beyond else MOST_LOADS
    of_kind = [i for i, load in enumerate(c.hum.heard) if load.beyond == beyond]
    return len(c.hum.heard) if len(of_kind) < most else min(of_kind, key=lambda i: loudness_of(c, named + i))


def hear(c: State, frequency: float, amplitude: float, beyond: bool) -> None:
    """What has this frequency, cycles per tick, and amplitude, um, is from now on a line, if it is none yet.

    It is louder than the noise, and twice as loud as the one whose place it takes.
    """
    g, hum, named = tangent(math.pi * frequency), c.hum, len(c.members["hum.line"])
    whole = 1 + g * g
    w = 2 * math.pi * frequency / c.oscillation.tick
    line, place = ((1 - g * g) / whole, 2 * g / whole, w), place_of(c, beyond)
    sigma = c.filtering.sigma if c.filtering is not None else 0.0
    least, most = (AUDIBLE_BEYOND, 1) if beyond else (1, LARGEST_HUM)
    audible = least * sigma < amplitude <= most * c.settings.stroke
    refused = any(left > 0 and abs(w / one - 1) < NEAR_REFUSED for one, left in hum.refused)
    if not audible or (not beyond and is_near_resonance(c, line)) or refused:
        return
    for i, one in enumerate(lines_of(c)):
        if abs(w / one[2] - 1) < (SAME_BEYOND if is_beyond(c, i) else SAME_LINE):
            if is_beyond(c, i):
                hum.heard[i - named].tune(line, amplitude)
            return
    if place < len(hum.heard) and amplitude < AS_LOUD * loudness_of(c, named + place):
        return
    hum.heard[place : place + 1] = [Load(line, amplitude, beyond)]
    place += named
    hum.sine[place], hum.over[place], hum.measurement[place] = [0.0, 0.0], 0.0, [0.0, 0.0]
    hum.regressor.pop(place, None)


def drop(c: State, i: int) -> None:
    """A line that was heard is none any more. Those behind it move up."""
    hum, named, last = c.hum, len(c.members["hum.line"]), len(lines_of(c)) - 1
    hum.refused = [(hum.heard[i].line[2], REFUSED_FOR), *hum.refused][:HEARD]
    for to in range(named + i, last):
        for states in (hum.turn, hum.sine, hum.measurement):
            states[to] = states[to + 1]
        hum.over[to] = hum.over[to + 1]
        if to + 1 in hum.regressor:
            hum.regressor[to] = hum.regressor[to + 1]
        else:
            hum.regressor.pop(to, None)
    del hum.heard[i]


def demodulated(of: list[float], turn: list[float], signal: float, rate: float) -> list[float]:
    """What a signal, um, has of a line: cosine and sine, over the last 1 / FOLLOWED."""
    return [of[0] + rate * (2 * signal * turn[0] - of[0]), of[1] + rate * (2 * signal * turn[1] - of[1])]


def judge(c: State, signals: tuple[float, float]) -> None:
    """One tick in which lines that were heard are judged by the signals in which they were."""
    hum, named, tick = c.hum, len(c.members["hum.line"]), c.oscillation.tick
    rate = min(FOLLOWED * tick, 1)
    hum.refused = [(w, left - tick if left > 0 else left) for w, left in hum.refused]
    for i in reversed(range(len(hum.heard))):
        load, turn = hum.heard[i], hum.turn[named + i]
        load.first = demodulated(load.first, turn, signals[0], rate)
        load.error = demodulated(load.error, turn, signals[1], rate)
        load.age += tick
        # beyond the resonance it may be quiet since the feedback no longer drives it; of other dynamics it is none
        if not c.is_given if load.beyond else load.is_none(size_of_line(c, named + i)):
            drop(c, i)


def unexplained(c: State, z: float, used: bool) -> float:
    """What a measurement has beside a straight line of the plays with their first weights, um.

    A load that the law follows is in it, too. The line is that of motion that no load makes.
    """
    f, tick = c.hum.unexplained, c.oscillation.tick
    rate, least, large = min(tick / MEAN_OF, 1), LARGEST_HUM * c.settings.stroke, LARGE_MOTION * c.settings.stroke
    expected = 0.0
    for place, play in zip(c.settings.a.tolist(), c.lagged.play.tolist(), strict=True):
        expected += float(c.kept.first[place]) * play
    if not f.square > 0:
        f.expected, f.z = expected, z
        f.square = f.product = least * least * tick
    if used:
        f.expected += rate * (expected - f.expected)
        f.z += rate * (z - f.z)
    x, y = (min(max(beside, -LARGEST), LARGEST) for beside in (expected - f.expected, z - f.z))
    if used and abs(x) > least:
        f.square += tick * x * x
        f.product += tick * x * y
        most = large * large
        kept = most / f.square if f.square > most else 1.0
        f.square, f.product = kept * f.square, kept * f.product
    return y - f.product / f.square * x


def explains(c: State) -> bool:
    """Whether loads are listened for in what the first weights do not explain, too.

    Where it is given, no load is taken for the stage. Beside other axes their motion is in that, whose harmonics are
    not those of this axis.
    """
    return bool(c.members["dynamics.known"] or c.members["resonance"] > 0) and c.settings.other_axes == 0


def steady_load(c: State, of_error: bool) -> float:
    """How steady a tone is a load, in the error or not."""
    if of_error:
        return STEADY_LOAD
    return STEADY_TONE if c.members["dynamics.known"] else STEADY_BESIDE_F0


def listen_about(c: State, ear: Ear, first: float, signals: tuple[float, float], zdot_d: float) -> None:
    """One tick of a detector, whose centres begin at `first`, cycles per tick.

    Each time it begins again it is that of the other signal.
    """
    lowest = LOWEST_LOAD * c.oscillation.tick
    if ear.tone is not None and ear.tone.blocks >= BLOCKS_HEARD:
        of_error = ear.of_error or not explains(c)
        if (load := ear.tone.shown(steady_load(c, of_error), ORDERS)) > 0:
            hear(c, load, ear.tone.amplitude, beyond=False)
        ear.centre, ear.tone = ear.centre * NEXT_OF_EAR, None
        if ear.centre < lowest:
            ear.of_error = not ear.of_error
    if ear.centre < lowest:
        ear.centre = first
    ear.tone = ear.tone or ToneDetector(ear.centre)
    ear.tone.update(signals[ear.of_error], zdot_d)


def hear_beyond(c: State, ear: Ear, tone: ToneDetector, lowest: float) -> None:
    """A tone that was looked for beyond the resonance is a line where it matters."""
    steady = max(STEADY_BEYOND / math.sqrt(tone.blocks), LEAST_STEADY)
    shown, amplitude = tone.shown(steady, 0), tone.amplitude
    share = amplitude * amplitude / 2 * tone.ticks
    if shown > lowest and share > LEAST_BEYOND * ear.power:
        hear(c, shown, amplitude, beyond=True)


def listen_beyond(c: State, error: float, zdot_d: float) -> None:
    """One tick of the search for a line beyond the resonance of given dynamics, in the error.

    There a harmonic of the motion is one, too: what a further mode makes of it.
    """
    ear, lowest, tick = c.hum.beyond, LOWEST_BEYOND * first_resonance(c), c.oscillation.tick
    if not lowest < HIGHEST_BEYOND:
        return
    if (tone := ear.tone) is not None and tone.blocks >= BLOCKS_BEYOND and tone.ticks * tick >= TIME_BEYOND:
        hear_beyond(c, ear, tone, lowest)
        ear.centre, ear.tone = ear.centre * NEXT_BEYOND, None
    if ear.centre < lowest:
        ear.centre = HIGHEST_BEYOND
    if ear.tone is None:
        ear.tone, ear.power = ToneDetector(ear.centre), 0.0
    ear.power += error * error
    ear.tone.update(error, zdot_d)


def listen(c: State, error: float, z: float, zdot_d: float, used: bool) -> None:
    """One tick of the search for a load; error: measured z less desired, um.

    Each detector has every eighth centre, for 20 periods each, from half of the first resonance downwards, or, where it
    is not known, from HIGHEST_LOAD.
    """
    tick, first = c.oscillation.tick, NEAR_RESONANCE * first_resonance(c)
    if c.filtering is None or not tick > 0 or c.settings.trim_rate > 0:
        return
    if not first > 0:
        first = min(HIGHEST_LOAD * tick, FASTEST_LOAD)
    signals = unexplained(c, z, used) if explains(c) else error, error
    if used:
        judge(c, signals)
    if c.is_given:
        listen_beyond(c, error, zdot_d)
    for ear in c.hum.ears:
        if first >= LOWEST_LOAD * tick:
            listen_about(c, ear, first, signals, zdot_d)
        first *= NEXT_LOAD
