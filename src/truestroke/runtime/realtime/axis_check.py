"""The axis check: a small, slow motion before the run shows that the axis is the one that the settings describe.

First the sensor at rest, then one axis after the other: up and back by so little that even an actuator that moves ten
times further a volt than expected stays within 5 % of the stroke, and then, with what was seen, by a little more.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from truestroke.base.display import taken_for_um
from truestroke.base.typing import FloatArray
from truestroke.control import feasibility
from truestroke.control.settings import ControllerSettings
from truestroke.runtime import gains
from truestroke.runtime.realtime.ending import Cause, Stop
from truestroke.runtime.realtime.settings import Axis
from truestroke.signals.timing import Timing
from truestroke.signals.trajectories import smoothstep

FIRST = 0.004  # of the stroke: expected displacement of the first probe
LARGEST = 0.035  # of the stroke: what the last one may be
OTHERS = 0.3  # of the answer that is expected: another sensor that shows as much answers in place of its own
CLEAR, AT_ONCE = 3.0, 12.0  # times its uncertainty: an answer that stands out; one that needs no larger probe
REPEATED = 4  # times that a probe is repeated where the answer is not clear
LARGE_OFFSET = 0.1  # of the stroke: a reading at rest that is so far off is no position, the sensor was not zeroed
QUIET, RESTLESS = 0.005, 0.05  # of the stroke: noise, or motion within the window, at rest; of an axis that is not
CALMING = 0.9  # from one window to the next: an axis that rings calms down by more
WINDOW, RISE, SETTLE = 0.04, 0.03, 0.02  # s
FEWEST = 8  # ticks of a window, whatever the sample rate
PATIENCE = 5.0  # s for the axis to come to rest
CHORD = 0.5, 3.0  # times the slope of a small motion: the gain on a long way

Move = Callable[[FloatArray], FloatArray]
"""Voltages of all axes, shape (channels, ticks), to the displacements that answer them, NaN where none came."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """What was seen of an axis before its run.

    Attributes
    ----------
    rest : float
        What the sensor showed at rest at the safe voltage, um.
    noise : float
        Standard deviation of a tick of it, um.
    zero : float
        What is subtracted from all measurements of the run, um.
    gain : float
        um/V of the probe; NaN where there was none.
    probe : float
        The largest probe, V; 0 where there was none.
    """

    rest: float = float("nan")
    noise: float = float("nan")
    zero: float = 0.0
    gain: float = float("nan")
    probe: float = 0.0


def examine(axes: Sequence[Axis], timing: Timing, move: Move, probing: bool) -> list[Found]:
    """Look at all axes at their safe voltages, and `move` each of them a little; there they stand again afterwards.

    Without `probing` nothing moves, and axes are looked at only if the `zero` of one is to be measured. `Stop` where an
    axis is not what its settings say.
    """
    if not probing and all(axis.zero != "measured" for axis in axes):
        return [Found(zero=axis.zero if isinstance(axis.zero, float) else 0.0) for axis in axes]
    bench = _Bench(axes, timing, move)
    rests = bench.at_rest()
    found = []
    for channel, (axis, (rest, noise)) in enumerate(zip(axes, rests, strict=True)):
        gain, probe = bench.probe(channel, noise) if probing and axis.known else (float("nan"), 0.0)
        zero = _zero(axis, rest, gain)
        found.append(Found(rest=rest, noise=noise, zero=zero, gain=gain, probe=probe))
    return found


def _zero(axis: Axis, rest: float, gain: float) -> float:
    """What to subtract, um: so that 0 um is at 0 V, where the sensor does not say that by itself."""
    settings = axis.known
    slope = gain if gain == gain or settings is None else feasibility.gains(settings)[1]
    here = axis.safe_voltage * (slope if slope == slope else 0.0)
    return zero_of(axis.zero, rest, here, settings.stroke if settings else np.inf)


def zero_of(given: float | Literal["measured"] | None, rest: float, here: float, stroke: float) -> float:
    """What to subtract, um, where the sensor reads `rest` at a voltage under which the model has it `here`, um.

    Examples
    --------
    >>> zero_of(None, 2.9, 0.0, 30.0), zero_of(None, 203.0, 0.0, 30.0), zero_of("measured", 2.9, 0.0, 30.0)
    (0.0, 203.0, 2.9)
    """
    if isinstance(given, float):
        return given
    low, high = sorted((CHORD[0] * here, CHORD[1] * here))
    large = LARGE_OFFSET * stroke
    if given is None and low - large <= rest <= high + large:
        return 0.0
    return rest - here


class _Bench:
    """All axes at their safe voltages, and the motions of one of them."""

    def __init__(self, axes: Sequence[Axis], timing: Timing, move: Move) -> None:
        self._axes, self._move, self._rate = axes, move, timing.sample_rate
        self._safe = np.array([[axis.safe_voltage] for axis in axes])
        self._window = self._ticks(WINDOW)

    def _ticks(self, seconds: float) -> int:
        return max(FEWEST, round(seconds * self._rate))

    def _hold(self, ticks: int) -> FloatArray:
        return self._move(np.repeat(self._safe, ticks, axis=1))

    def at_rest(self) -> list[tuple[float, float]]:
        """Reading and noise of each axis, um, when all of them are quiet."""
        self._hold(self._ticks(SETTLE))
        before = np.full(len(self._axes), np.inf)
        for _ in range(max(2, round(PATIENCE * self._rate / (2 * self._window)))):
            seen = self._hold(2 * self._window)
            unrest = np.array([_unrest(axis, row) for axis, row in zip(self._axes, seen, strict=True)])
            if np.all((unrest <= QUIET) | (unrest <= RESTLESS) & (unrest >= CALMING * before)):
                return [(float(np.nanmedian(row)), float(np.nanstd(row))) for row in seen]
            before = unrest
        worst = int(np.argmax(unrest))
        raise Stop(Cause.CHECK, _restless(self._axes[worst], seen[worst]))

    def probe(self, channel: int, noise: float) -> tuple[float, float]:
        """The gain of an axis, um/V, and the largest probe, V; `Stop` where it is not that of the settings."""
        axis, settings = self._axes[channel], self._axes[channel].known
        assert settings
        expected_gain = feasibility.gains(settings)[0]
        first, most = (share * settings.stroke / expected_gain for share in (FIRST, LARGEST))
        sign = 1.0 if axis.safe_voltage + most <= axis.voltage_limits[1] else -1.0
        volts = sign * first
        while True:
            grows = 3.0 * abs(volts) <= most  # then an answer with a margin need not be measured twice
            small = LARGEST * settings.stroke / 3.0 if grows else 0.0
            answers, uncertainty = self._answers(channel, volts, noise, small)
            seen = abs(answers[channel]) + uncertainty
            largest = min(most, abs(volts) * LARGEST * settings.stroke / seen) if seen else most
            if abs(answers[channel]) > AT_ONCE * uncertainty or largest < 1.2 * abs(volts):
                break
            volts = sign * min(largest, 3.0 * abs(volts))
        answer = _Answer(axis, settings, volts, float(answers[channel]), uncertainty, expected_gain)
        _judge(answer, channel, answers, self._axes)
        return float(answers[channel] / volts), float(volts)

    def _answers(self, channel: int, volts: float, noise: float, small: float) -> tuple[FloatArray, float]:
        """Answers of all sensors and the uncertainty of `channel`, um; repeated until it is clear, or `small`, um."""
        seen: list[FloatArray] = []
        for _ in range(REPEATED):
            seen += self._twice(channel, volts)
            answers, spread = np.mean(seen, axis=0), float(np.std(seen, axis=0)[channel])
            uncertainty = max(spread, 1.3 * noise / np.sqrt(self._window)) / np.sqrt(len(seen) - 1)
            if abs(answers[channel]) > AT_ONCE * uncertainty or abs(answers[channel]) + uncertainty < small:
                break
        return answers, float(uncertainty)

    def _twice(self, channel: int, volts: float) -> list[FloatArray]:
        """Up by `volts` and back, twice: two answers of all sensors, um, each without what drifts meanwhile."""
        rise = max(self._ticks(RISE), int(np.ceil(2.0 * abs(volts) / self._axes[channel].slew * self._rate)))
        up = smoothstep(np.arange(1, rise + 1) / rise)[0]
        hold, window = self._ticks(SETTLE) + self._window, self._window
        there_and_back = (up, np.ones(hold), up[::-1], np.zeros(hold))
        parts = (np.zeros(window), *there_and_back, *there_and_back)
        ends = np.cumsum([part.size for part in parts])
        moves = np.repeat(self._safe, ends[-1], axis=1)
        moves[channel] += volts * np.concatenate(parts)
        rows = list(zip(self._axes, self._move(moves), strict=True))
        low, top, middle, high, last = (
            np.array([_middle(axis, row[end - window : end]) for axis, row in rows]) for end in ends[[0, 2, 4, 6, 8]]
        )
        return [top - (low + middle) / 2, high - (middle + last) / 2]


def _middle(axis: Axis, seen: FloatArray) -> float:
    """Median of what came, um."""
    usable = seen[np.isfinite(seen)]
    if 2 * usable.size < seen.size:
        lost = f"{seen.size - usable.size} of {seen.size} measurements at rest are no numbers"
        raise Stop(Cause.SENSOR, f"axis {axis.name}: {lost}: look at the sensor and its cable")
    return float(np.median(usable))


def _motion(axis: Axis, seen: FloatArray) -> tuple[float, float]:
    """How far the sensor wanders between the halves, and its standard deviation, um."""
    half = seen.size // 2
    return abs(_middle(axis, seen[half:]) - _middle(axis, seen[:half])), float(np.nanstd(seen))


def _unrest(axis: Axis, seen: FloatArray) -> float:
    """How far an axis is from rest, as a part of its stroke; 0 of one whose stroke is not known."""
    moved, noise = _motion(axis, seen)
    settings = axis.known
    return max(moved, noise) / settings.stroke if settings else 0.0


def _restless(axis: Axis, seen: FloatArray) -> str:
    """What is said of an axis that does not come to rest."""
    moved, noise = _motion(axis, seen)
    settings = axis.known
    most = RESTLESS * settings.stroke if settings else np.inf
    return (
        f"axis {axis.name}: at {axis.safe_voltage:g} V it does not come to rest within {PATIENCE:g} s: the sensor "
        f"wanders by {moved:.3g} um and is noisy by {noise:.3g} um, at most {most:.3g} um are expected, 5 % of stroke; "
        "look at sensor and cable, and at what shakes the stage"
    )


# ---- What an answer says -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Answer:
    axis: Axis
    settings: ControllerSettings
    volts: float  # V of the probe
    seen: float  # um
    uncertainty: float  # um
    expected: float  # um/V

    @property
    def probe(self) -> str:
        """It, and what was expected, in words."""
        return (
            f"axis {self.axis.name}: to a probe of {self.volts:+.3g} V the sensor should answer about "
            f"{self.expected * self.volts:+.3g} um (stroke {self.settings.stroke:g} um, voltage_limits "
            f"{self.settings.voltage_limits[0]:g} to {self.settings.voltage_limits[1]:g} V)"
        )


def _judge(a: _Answer, channel: int, answers: FloatArray, axes: Sequence[Axis]) -> None:
    """`Stop` where the answer is not that of the axis that the settings describe."""
    gain, uncertainty = a.seen / a.volts, a.uncertainty / abs(a.volts)
    low, high = min(a.settings.q, a.expected) * gains.RUN[0], max(a.settings.q, a.expected) * gains.RUN[1]
    instead = _instead(a, channel, answers)
    if abs(gain) <= CLEAR * uncertainty or (instead and abs(gain) < low):  # the rest is cross-talk
        raise Stop(Cause.CHECK, _no_answer(a, channel, answers, axes))
    if gain < 0:
        raise Stop(
            Cause.CHECK,
            f"{a.probe}; it answers {a.seen:+.3g} um: the sign is wrong. Change the sign of um_per_volt (um_per_unit) "
            "in [driver], or the polarity of the amplifier",
        )
    if not low - uncertainty <= gain <= high + uncertainty:
        remedy = "Correct um_per_volt (um_per_unit) in [driver], or stroke, or voltage_limits"
        why = taken_for_um(gain / a.expected)
        raise Stop(
            Cause.CHECK,
            f"{a.probe}; it answers {a.seen:+.3g} um: {gain:.3g} um/V, where stroke and voltage_limits allow {low:.3g} "
            f"to {high:.3g} um/V{why and f': {why}'}. {remedy}",
        )
    _check_reach(a, gain)


def _instead(a: _Answer, channel: int, answers: FloatArray) -> list[int]:
    """Channels whose sensors have answered as that of this axis should."""
    least = OTHERS * abs(a.expected * a.volts)
    return [i for i, seen in enumerate(answers) if i != channel and abs(seen) > least]


def _no_answer(a: _Answer, channel: int, answers: FloatArray, axes: Sequence[Axis]) -> str:
    expected = a.expected * a.volts
    loud = [axes[i].name for i in _instead(a, channel, answers)]
    remedy = "look at inputs and outputs in [driver], at cables, and whether amplifier and sensor are switched on"
    if loud:
        remedy = f"the sensor of axis {loud[0]} answers instead: inputs or outputs in [driver] are swapped"
        if len(axes) == 2:  # a rotation by so many degrees has sin in the row of the second axis, -sin in the other one
            degrees = 90 if (answers[1 - channel] / expected > 0) == (channel == 0) else -90
            remedy += f", or the sensors stand at {degrees} degrees: rotation = {degrees}.0 in [coupled], or more by it"
    return (
        f"axis {a.axis.name}: no answer to a probe of {a.volts:+.3g} V: the sensor shows {a.seen:+.2g} um, "
        f"uncertain by {a.uncertainty:.2g} um, where about {expected:+.3g} um are expected; {remedy}"
    )


def _check_reach(a: _Answer, gain: float) -> None:
    """Refuse a motion that this gain does not reach with all of the voltage."""
    reach = feasibility.reach(a.axis.trajectory)
    low, high = a.axis.voltage_limits
    most = CHORD[1] * gain
    ends = most * min(low, 0.0), most * max(high, 0.0)
    if reach[1] > ends[1] or reach[0] < ends[0]:
        shift = "" if reach[1] - reach[0] > ends[1] - ends[0] else "Shift the motion, as by its offset (where sensors "
        shift += (
            shift and f"are turned, in their frame): {a.axis.name} moves from {ends[0]:.3g} to {ends[1]:.3g} um. Or m"
        )
        raise Stop(
            Cause.CHECK,
            f"{a.probe}; it answers {a.seen:+.3g} um: with {gain:.3g} um/V, even {CHORD[1]:g} times as much on a long "
            f"way, voltage_limits of {low:g} to {high:g} V do not reach {reach[0]:.4g} to {reach[1]:.4g} um. "
            f"{shift or 'M'}ake the motion smaller, or correct um_per_volt (um_per_unit) in [driver], or "
            "voltage_limits",
        )
