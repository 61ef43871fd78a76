"""A measurement: what the model expected, whether it is used, what law and feedback make of it."""

import math
from collections.abc import Sequence

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LARGEST, FilteringLaw, Law, UpdateRefused
from truestroke.control.guard import SETTLED
from truestroke.control.reference.command import slopes_at
from truestroke.control.reference.first import least_slope
from truestroke.control.reference.found import follow_slower, watch_resonance
from truestroke.control.reference.hum import (
    follow_hum,
    hum_of,
    listen,
    miss_hum,
    tick_of_hum,
    without_beyond,
    without_hum,
)
from truestroke.control.reference.learned import PAUSE, is_restored, watch_kept, watch_learning
from truestroke.control.reference.ringing import forget_hum, watch_stage
from truestroke.control.reference.state import BEYOND, HISTORY, Command, State
from truestroke.control.reference.terms import regressor, remember_creep, remember_voltage, through_dead_zones
from truestroke.control.stage import Stage
from truestroke.model.models import Motion
from truestroke.model.operators import dot

ALARMS = 0.1  # s: over which the rate of sudden changes is taken
A_WHILE = 8  # of a period of the stage: a part of it for which the law learns between two waits, at least
RESUME = 20.0  # 1/s: the rate below which the feedback continues after a pause
RINGING_RATE = 50  # 1/s: how fast the mean square of the second difference follows
LATER = 1.2  # of the resonance that was found: a third pole of the law, where its weights drift
DAMPS_MOST = 0.1  # of the stroke: what the active damping adds to the command
LARGE_SWING = 0.5  # of that: so much to one side, and to the other one
HALF_WAVE = 0.75  # periods of the stage: within that, is a swing,
DRIVES = 8  # and so many of them in a row drive the stage,
SHRINKS = 0.75  # where the last one is not smaller than this times the first one
WITHOUT_STAGE = 2  # times as fast as with a stage in the model the usual error follows without one,
SMALL = 0.02  # where the error of the motion, over its range, is smaller
UNSURE = 10  # times the variance of the first slope, for what it was learned from is not white,
ALLOWED = 0.5  # without so much of what a sudden change adds to it


def measure(c: State, z: float) -> bool:
    """One tick with its measurement z, um; returns whether it was used."""
    tick, path, law = c.measured_ticks, c.path, c.filtering
    command, learned = c.waiting[tick], c.waiting[c.lagged.ticks].limited
    limited, beyond, motion = command.limited, is_beyond(c, command, z), command.motion
    before = c.waiting.get(tick - 1) if path is not None else None
    stands = command.x == (c.lagged.play[0] if before is None else before.x)
    u = c.sensor.sensed(next_lagged(c)) if path is None else None  # (20)
    now = regressor(c, c.now, c.last.motion) if c.stage.smoothing > 0 else None
    first = 0.0 if now is None else float(dot(c.law.weights, now))
    learns = adapts(c, learned, beyond) and not c.stage.rest > 0 and not is_restored(c)
    tick_of_hum(c)
    hum = hum_of(c)
    alone = z - hum
    used = learn_from(c, u, z, hum, motion, learn=learns, stands=stands)
    if used and now is not None:
        admit_learned(c, float(dot(c.law.weights, now)) - first)
    to_sensor = c.sensor.slow if path is None else path.sensor
    error = z - (motion.z_d + to_sensor[0] * motion.zdot_d + to_sensor[1] * motion.zddot_d)
    # The trim: at a voltage limit only away from it; the slew limit only delays.
    if used and (not limited or beyond):
        c.integral -= c.members["trim"] * error
    feed_back(c, -without_beyond(c, error) if used and (not limited or beyond) else 0.0)  # no wind-up at a limit
    if used and path is None:
        c.stage.z = alone, c.stage.z[0]
    low, high = c.settings.voltage_limits
    at_limit = not low < command.x < high
    if not used:
        c.stage.detector.miss(error)
    elif path is None:
        watch_stage(c, error, motion.zdot_d, limited if c.kept.guard.was_good else at_limit)
    forget_hum(c)
    listen(c, error, z, motion.zdot_d, used)
    watch_resonance(c, alone, error, motion.zdot_d, path)
    watch_learning(c, error, motion.z_d, used and (not at_limit or beyond))
    if law is not None and path is not None and path.ticks != c.lagged.ticks + 1:
        c.kept.recall.begin()  # the regressor is not that of the measurement before
    elif law is not None and used:
        watch_kept(c, law, c.u if u is None else u, alone if path is None else path.z[1])
    return used


def next_lagged(c: State) -> FloatArray:
    """The regressor of the next tick that was not yet measured."""
    tick = c.lagged.ticks
    command = c.waiting[tick]
    if tick - HISTORY in c.waiting:
        del c.waiting[tick - HISTORY]
    remember_creep(c, c.lagged)
    remember_voltage(c, c.lagged, command.x)
    follow_slower(c, command.x)
    c.u = regressor(c, c.lagged, command.motion)
    return c.u


def pass_over(c: State) -> None:
    """A tick for which no measurement came."""
    c.estimator.ticks = 0  # its window begins anew
    miss_hum(c)
    law, learn = c.filtering, not c.waiting[c.lagged.ticks].limited
    if c.path is not None:
        learn_staged(c, c.path, c.path.expected() + hum_of(c), 0.0, measured=False, learn=learn)
    else:
        u = c.sensor.sensed(next_lagged(c))
        if law is not None:
            update_law(c, law, u, float(dot(u, law.weights)) + hum_of(c), 0.0, measured=False, learn=learn)
    if law is not None:
        c.stage.detector.miss(None)
    feed_back(c, 0.0)


def pauses(c: State, tick: float) -> bool:
    """Whether the feedback waits while there are many alarms: its margins are those of a model that was learned."""
    c.alarms += min(tick / ALARMS, 1.0) * ((1 / tick if c.changed else 0.0) - c.alarms)
    c.paused = c.alarms > (RESUME if c.paused else PAUSE)
    return c.paused


def admit_learned(c: State, change: float) -> None:
    """A learned change, um, reaches the command gradually, so that it does not excite the stage.

    What the law learns just after a sudden change the feedback has corrected already: it hands that over so slowly that
    it is not corrected twice.
    """
    law, feeds_back = c.filtering, c.is_given and c.members["feedback.filter"] and not c.paused
    if law is not None and feeds_back and law.since_change < law.settings.refractory:
        c.handed += change
    else:
        c.bumpless += c.stage.smoothing * change


def pass_biquad(coefficients: Sequence[float], x: list[float], error: float) -> float:
    """One tick of a filter of the error, um: b0, b1, b2, a1, a2, and its states."""
    b0, b1, b2, a1, a2 = coefficients
    y = b0 * error + x[0]
    x[0], x[1] = b1 * error - a1 * y + x[1], b2 * error - a2 * y
    return y


def count_swing(c: State, late: bool) -> None:
    """A swing of the active damping is over, or none came.

    So many in a row drive the stage, unless they become smaller: the damping has its limit, and what rings far above it
    takes many swings to end.
    """
    c.swings = 0 if late else c.swings + 1
    if c.swings >= DRIVES and c.peak < SHRINKS * c.first_peak:
        c.swings = 2
    if c.swings == 2:
        c.first_peak = c.peak  # the one before began with the ringing, anywhere in a swing
    c.peak = 0.0


def damp_ringing(c: State, error: float) -> float:
    """One tick of the active damping, um, before its limit.

    Where the loop is later than the model knows, it drives what it should damp, up to its limit: from then on there is
    none.
    """
    total, large = pass_biquad(c.damping, c.damped, error), LARGE_SWING * DAMPS_MOST * c.settings.stroke
    side = int(total > large) - int(total < -large)
    if c.swings >= DRIVES:
        return 0.0
    c.since_swing += 1
    late, turns = c.since_swing * c.stage.resonance > HALF_WAVE, side * c.side < 0
    if late or turns:
        count_swing(c, late)
    if turns or abs(side) > abs(c.side):
        c.since_swing = 0
    c.side = side or c.side
    c.peak = max(c.peak, abs(total))
    return total


def share_of_feedback(c: State) -> float:
    """The share of the feedback that is used, as cautious control has it: b^2 / (b^2 + P).

    A small correction passes the slope b of the first play alone, which a slow motion does not show: where it is far
    too small in the model, the loop has a gain far unsure its margins. They allow for a change of the gain, of
    which the law is unsure after each sudden change.
    """
    if c.filtering is None:
        return 1.0
    square, gain = float(c.slopes[0]) * float(c.slopes[0]), c.members["kalman.change_gain"]
    unsure = c.filtering.variance_of(0) - ALLOWED * (gain * gain * square)
    return square / (square + UNSURE * unsure) if unsure > 0 else 1.0


def feed_back(c: State, error: float) -> None:
    """One tick of the feedback, for the command after it; error: desired less measured, um.

    Its margins are those of the stage that was given: one that was found is damped.
    """
    total, tick, most, kept = 0.0, c.oscillation.tick, c.members["feedback.most"], c.members["dynamics.amplifier"]
    if c.stage.found:
        c.feedback_states = [[0.0, 0.0] for _ in c.feedback_states]
        total, most, kept = damp_ringing(c, error), DAMPS_MOST * c.settings.stroke, 0.0
    elif c.members["feedback.filter"] and tick > 0 and pauses(c, tick):
        c.feedback_states = [[0.0, 0.0] for _ in c.feedback_states]
    else:
        for coefficients, x in zip(c.members["feedback.filter"], c.feedback_states, strict=False):
            total += pass_biquad(coefficients, x, error)
        total = share_of_feedback(c) * total
    total = min(max(total, -most), most)
    # its margins are those behind the amplifier, whose lag the command undoes
    c.feedback = total + kept * (c.feedback - total) if kept > 0 else total


def is_beyond(c: State, command: Command, z: float) -> bool:
    """At a voltage limit, and already beyond the desired displacement: the model is wrong there, not the limit."""
    low, high = c.settings.voltage_limits
    beyond = (command.x >= high and z > command.motion.z_d) or (command.x <= low and z < command.motion.z_d)
    return command.limited and beyond


def adapts(c: State, limited: bool, beyond: bool) -> bool:
    """Whether a tick is used: a limited one from the tenth on that was beyond without an unlimited one between.

    Otherwise weights that always demand more than the limit would never be corrected.
    """
    c.beyond = min(c.beyond + beyond, BEYOND) if limited else 0
    return not c.held and (not limited or (beyond and c.beyond >= BEYOND))


def is_frozen(c: State, z: float, predicted: float, stands: bool) -> bool:
    """Whether the sensor repeats a number while voltage and model move: others have noise, or steps as large."""
    law = c.filtering
    if law is None:
        return False
    if z != c.z_before or stands:
        step = abs(z - c.z_before)
        first = c.lagged.ticks <= 1  # there is none before it
        if not first and 0 < step < c.settings.stroke / 20 and not 0 < c.resolution <= step:
            c.resolution = step
        c.z_before, c.predicted_before = z, predicted
        return False
    noise = law.sigma + law.settings.model_error
    return abs(predicted - c.predicted_before) > max(6 * noise, c.resolution + 2 * noise)


def learn_from(
    c: State, u: FloatArray | None, measured: float, hum: float, motion: Motion, *, learn: bool, stands: bool
) -> bool:
    """Adapt to a measurement, um, of which `hum` is hum; u: the regressor (20), None where the stage is known.

    Whether it was used.
    """
    path, law, z = c.path, c.filtering, measured - hum
    if path is not None:
        predicted = path.expected()
        c.innovation = z - predicted
    else:
        assert u is not None
        predicted = float(dot(c.law.weights, u))
        c.innovation = through_dead_zones(c, z) + motion.ahead - predicted  # (15)
    if law is None:
        return learn_otherwise(c, u)
    expected = predicted + hum
    used = not is_frozen(c, measured, expected, stands)
    noisy = path.quiet(c.innovation) if path is not None else c.innovation if c.ringing.rings else None
    used = used and not law.is_spike(c.innovation, noisy)
    innovation = c.innovation if used else 0.0
    if path is not None:
        learn_staged(c, path, measured if used else expected, innovation, measured=used, learn=learn)
    elif u is not None:
        update_law(c, law, u, expected + innovation, innovation, measured=used, learn=learn)
    if used:
        follow_hum(c, innovation)
    return used


def learn_otherwise(c: State, u: FloatArray | None) -> bool:
    """With a law that takes regressor and error: (23)."""
    try:
        if not c.held and u is not None:
            returned: object = c.law.update(u, c.innovation)  # type: ignore[func-returns-value]
            if returned is not None:
                raise SettingError(
                    "law.update()", checks.described(returned), "None; assign new weights to self.weights"
                )
            check_weights(c.law, u.size)
    except UpdateRefused:
        return False
    return True


def check_weights(law: Law, size: int) -> None:
    """Refuse weights with which no command can be computed: a law of a user's own may make them.

    Raises
    ------
    SettingError
        They are missing, no array of this size, or not finite.
    """
    weights: object = getattr(law, "weights", None)
    if not isinstance(weights, np.ndarray) or weights.shape != (size,):
        raise SettingError("law.weights", checks.described(weights), f"an array of shape ({size},)")
    if not np.isfinite(weights).all():
        column = int(np.flatnonzero(~np.isfinite(weights))[0])
        raise SettingError(f"law.weights[{column}]", weights[column], "finite; a smaller step size may help", "um/V")


def start_filters(c: State, law: FilteringLaw) -> None:
    """The law's filters start at 0, for one notched sample is noise, thousands of times that of z on a soft stage.

    Of the noise of the samples before they have a part alone: behind a pause the law waits until it has decayed.
    Behind the wait it learns for a while, whatever pauses come: a limit that is met in each half-wave of f0 would end
    all learning.
    """
    period = int(1 / (c.stage.resonance if c.stage.found else c.members["dynamics.first"]))
    if not law.started and c.lagged.ticks > 1 and law.since_change >= period // A_WHILE:
        law.wait(period)
    law.start_filters()


def learn_staged(c: State, path: Stage, z: float, innovation: float, *, measured: bool, learn: bool) -> None:
    """One tick of the stage with the measurement z, or what was expected: it shows the tick `dead` before."""
    y, noisy = path.notched(z), path.quiet(innovation)
    path.remember(innovation)
    if path.ticks > c.lagged.ticks + path.dead and c.filtering is not None:
        while path.ticks > c.lagged.ticks + path.dead + 1:  # the dead time is shorter than that of the stage before
            next_lagged(c)
        u = path.passed(next_lagged(c))
        if learn:
            start_filters(c, c.filtering)
        update_law(c, c.filtering, u, y, noisy, measured=measured, learn=learn)


def update_law(
    c: State, law: FilteringLaw, u: FloatArray, y: float, innovation: float, *, measured: bool, learn: bool
) -> None:
    """One tick of the law: u . w should be y, um."""
    u, y = without_hum(c, u, y)
    third = third_pole(c, law)
    if c.measures_inertia:
        u, y = with_inertia(c, law, u, y, learn=learn)
    elif third > 0:
        u, y = behind_pole(c, u, y, third, learn=learn)
    law.small = c.kept.guard.error < SMALL
    law.relates = relates(c, law)
    law.steady = c.is_given and c.kept.guard.small >= SETTLED
    law.calm = c.path is None and c.kept.guard.small > 0
    if law.tick(u, y, innovation, measured=measured, learn=learn):  # (23)
        project_slope(c, law, c.fastest)  # slopes are linear in the rate:
        project_slope(c, law, -c.fastest)  # its two ends are the worst
        c.changed = law.changed


def relates(c: State, law: FilteringLaw) -> int:
    """How fast the usual error follows, to which a change is related; 0: it is not.

    Without a stage in the model an error that grows slowly would be one change after the other; a large one may be.
    """
    if c.path is not None:
        return 1
    return WITHOUT_STAGE if law.small else 0


def third_pole(c: State, law: FilteringLaw) -> float:
    """The third pole of the law, as a share per tick; 0: it has none. With given dynamics that of its filter."""
    if c.is_given:
        return law.filter
    if c.stage.growth is None or not c.stage.growth.late:
        return 0.0
    w = 2 * math.pi * LATER * c.stage.resonance
    return w / (1 + w)


def behind_pole(c: State, u: FloatArray, y: float, pole: float, *, learn: bool) -> tuple[FloatArray, float]:
    """Regressor and measurement behind this pole, which removes what is beyond the stage of the model."""
    r = c.ringing
    if not learn:
        r.u = None
        return u, y
    if r.u is None:
        r.u, r.y = np.zeros(u.size), 0.0
    r.u = r.u + pole * (u - r.u)
    r.y += pole * (y - r.y)
    return r.u, r.y


def with_inertia(c: State, law: FilteringLaw, u: FloatArray, y: float, *, learn: bool) -> tuple[FloatArray, float]:
    """Regressor and measurement for the law: u and y, or, while the stage rings, those of the tick before.

    Velocity and acceleration are then the measured ones, as central differences about that tick.
    """
    r, tick, motion = c.ringing, c.oscillation.tick, c.waiting[c.lagged.ticks - 1].motion
    shown = c.sensor.slow[0] * motion.zdot_d + c.sensor.slow[1] * motion.zddot_d
    error = y - (through_dead_zones(c, motion.z_d) + motion.ahead + shown)
    before = r.u if learn else None
    if before is None:
        r.error, r.once, r.twice = (error, error), error, (error, error)
    noise = law.sigma * law.sigma + law.settings.model_error * law.settings.model_error
    r.rings = r.update(error, law.filter, tick * RINGING_RATE, noise) and before is not None
    used = u, y
    if r.rings and before is not None:
        newer, older = r.error
        columns, moved = c.settings.columns, before.copy()
        moved[columns["lag"]] += min(max((error - older) / (2 * tick), -LARGEST), LARGEST)
        moved[columns["inertia"]] += min(max((error - 2 * newer + older) / (tick * tick), -LARGEST), LARGEST)
        used = moved, r.y
    r.u, r.y, r.error = u if learn else None, y, (error, r.error[0])
    return used


def project_slope(c: State, law: FilteringLaw, zdot_d: float) -> None:
    """Move the weights so that the partial slope that is furthest outside its limits is on its limit."""
    slopes, (low, high) = slopes_at(c, zdot_d), c.settings.slope_limits
    over, under = slopes - high, max(least_slope(c, zdot_d), low) - slopes
    worst = int(np.argmax(np.maximum(over, under)))
    missing = -over[worst] if over[worst] > under[worst] else under[worst]
    if over[worst] > 0 or under[worst] > 0:
        columns = worst + 1 + int(np.searchsorted(c.settings.rate_plays, worst, "right"))  # weights up to it
        law.project(columns, c.settings.rate_scale * zdot_d, float(missing))
