"""The command: from the desired motion to the voltage, (9) to (14), within slew and limits."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LARGEST
from truestroke.control.reference.first import least_slope
from truestroke.control.reference.state import State
from truestroke.control.reference.terms import of_known_terms, slope_of_duhem, through_dead_zones
from truestroke.control.stage import FOUND_DAMPING, Stage, lead_of_dead_time
from truestroke.model.models import Motion, limit_slopes, play_walk, weighted_sum

IN_MOTION = 0.05  # of the smallest slope: that of the inverse, of weights that are held at rest
HANDS_OVER = 20.0  # periods of the first resonance: in them the feedback hands over what was learned after a change
LEAST_SHARE = 0.25  # of a slope of the plays: with states of Duhem it is no less
SMOOTH = 8  # times the third difference of velocities: no more than the sum of their first ones


def acceleration(c: State, zdot_d: float) -> float:
    """From the rates of this tick and of the last one, um/s^2; 0 at the first."""
    tick = c.oscillation.tick
    return float((zdot_d - c.last.motion.zdot_d) / tick) if c.counters["commands"] > 0 and tick > 0 else 0.0


def ahead_of(c: State, zdot_d: float, zddot_d: float, tick: int) -> float:
    """What the stage asks of the hysteresis beyond z_d in this tick, um: 1 / G for slow motion, or the inertia.

    The inertia is z'' / w0^2, within a tenth of the stroke.
    """
    if c.path is not None and c.stage.found:
        return ahead_of_found(c, c.path, zdot_d, zddot_d, tick)
    if c.path is not None:
        return float(c.path.lead[0] * zdot_d + c.path.lead[1] * zddot_d)
    if not c.stage.inertia > 0 or tick == 0:
        return 0.0
    most = c.settings.stroke / 10
    change = float(zdot_d - c.waiting[tick - 1].motion.zdot_d)
    return min(max(c.stage.inertia * change, -most), most)


def ahead_of_found(c: State, path: Stage, zdot_d: float, zddot_d: float, tick: int) -> float:
    """What a stage that was found asks of the hysteresis beyond z_d, um: 1 / G up to its fourth derivative.

    From the last four velocities: a motion at a third of the resonance turns by up to a quarter of a radian in a
    tick. Where the velocities are noise, or jump, their differences do not fall: there two derivatives are used.
    """
    v = [zdot_d, *[c.waiting[tick - i].motion.zdot_d for i in (1, 2, 3)]]
    newest, before, oldest = v[0] - v[1], v[1] - v[2], v[2] - v[3]
    second = newest - before
    third = second - (before - oldest)
    if SMOOTH * abs(third) > abs(newest) + abs(before) + abs(oldest):
        return float(path.lead[0] * zdot_d + path.lead[1] * zddot_d)
    w = 2 * math.pi * c.stage.resonance
    drag, stiff = 2 * FOUND_DAMPING / w, 1 / (w * w)
    l1, l2, l3, l4 = lead_of_dead_time(path.dead)
    of_change = (stiff + l1 * drag + l2) * (newest + second / 2 + third / 3)
    of_jerk = (l1 * stiff + l2 * drag + l3) * (second + third)
    of_snap = (l2 * stiff + l3 * drag + l4) * third
    return float(path.lead[0] * zdot_d + c.oscillation.tick * (of_change + of_jerk + of_snap))


def wanted(c: State, motion: Motion) -> float:
    """(11), the stage, the trim, the feedback and the bumpless transfer, less hum, um."""
    total = through_dead_zones(c, motion.z_d) + motion.ahead + c.integral + c.feedback + c.bumpless + c.handed
    return float(total - c.hum.subtracted)


def wanted_of_plays(c: State, motion: Motion) -> float:
    """The same less the known terms, um."""
    return wanted(c, motion) - of_known_terms(c, motion)


def rate_dependent_slopes(c: State, zdot_d: float) -> tuple[FloatArray, bool]:
    """(7) in the scale of (20), w_h = a + c_b zdot_d b, summed up; within limits, and whether one was moved."""
    low, high = c.settings.slope_limits
    least = low if c.filtering is None else max(least_slope(c, zdot_d), IN_MOTION * low)
    return limit_slopes(slopes_at(c, zdot_d), (least, high))


def slopes_at(c: State, zdot_d: float) -> FloatArray:
    """Partial sums of w_h at this rate, um/V."""
    a, b = c.settings.of_all_plays(c.law.weights)
    slopes: FloatArray = (a + c.settings.rate_scale * zdot_d * b).cumsum()
    return slopes


def sum_of_plays(c: State) -> float:
    """Displacement of the plays at the present voltage, um: the forward of the inverse."""
    return float(weighted_sum(c.slopes, c.now.play))


def inverse(c: State, y_d: float) -> float:
    """The voltage for which the model has y_d: by the plays (12), and by the slopes that states of Duhem add to theirs.

    First by those as the voltage begins to move, then by those of its whole move.
    """
    play, gap = c.now.play, y_d - sum_of_plays(c)
    if not c.now.duhem.size:
        return play_walk(gap, c.slopes, c.thresholds, play)
    (low, high), moved = c.settings.voltage_limits, 0.0
    for _ in range(2):
        slopes = np.maximum(c.slopes + slope_of_duhem(c, moved, up=gap >= 0), LEAST_SHARE * c.slopes)
        x = play_walk(gap, slopes, c.thresholds, play)
        moved = min(max(x - float(play[0]), low - high), high - low)
    return x


def within_limits(c: State, x: float) -> float:
    """The output voltage: within the slew of the last one, and within the limits, whatever x is."""
    (low, high), slew = c.settings.voltage_limits, c.members["slew"]
    last = c.last.x if c.counters["commands"] > 0 else float(c.now.play[0])
    number = not math.isnan(x)
    if not number:
        x = last
    c.slewed = x > last + slew or x < last - slew
    if c.slewed:
        x = last + slew if x > last else last - slew
    c.saturated = not number or not low <= x <= high
    return min(max(x, low), high)


def look_ahead_anew(c: State) -> None:
    """What the stage that is in the model from now on asks of the last command, too.

    Else the next one, which has what it asks, would jump by that, for `keep_command` keeps what the stage before asked.
    """
    tick, motion = c.counters["commands"] - 1, c.last.motion
    if tick >= 0:
        motion = motion._replace(ahead=ahead_of(c, motion.zdot_d, motion.zddot_d, tick))
        c.last = c.waiting[tick] = dataclasses.replace(c.last, motion=motion)


def keep_command(c: State) -> None:
    """Bumpless transfer: the command for the last tick stays as it was; the difference decays."""
    last = c.last
    c.slopes, _ = rate_dependent_slopes(c, last.motion.zdot_d)
    if c.counters["commands"] > 0:
        c.bumpless += sum_of_plays(c) - wanted_of_plays(c, last.motion)


def bounded(argument: str, value: float, unit: str) -> float:
    """A number of the caller, finite, within what the arithmetic bears."""
    return min(max(checks.number(argument, value, unit), -LARGEST), LARGEST)


def others_of(values: Sequence[float] | None, axes: int) -> tuple[tuple[float, float, float], ...]:
    """Displacement, velocity and acceleration of each other axis; () where they are not known."""
    if values is None:
        return ()
    if len(values) != 3 * axes:
        raise checks.wrong_others(values, axes)
    numbers = [bounded("others", value, "um, um/s, um/s^2") for value in values]
    return tuple((numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]) for i in range(axes))
