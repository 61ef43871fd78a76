"""The resonance that is measured while the stage moves: what follows from it, and the stage that is made of it."""

import copy
import math

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LARGEST, FilteringLaw
from truestroke.control.angles import tangent
from truestroke.control.guard import FIRST_WAIT
from truestroke.control.reference import candidate
from truestroke.control.reference.candidate import Candidate
from truestroke.control.reference.command import keep_command, look_ahead_anew
from truestroke.control.reference.first import is_identified, shows_gain
from truestroke.control.reference.hum import power_of_hum
from truestroke.control.reference.state import HISTORY, Growth, State
from truestroke.control.reference.terms import move_voltage, remember_creep, remember_voltage
from truestroke.control.resonance import DRIVEN_ALONE, HIGHEST, SHOWN, shown
from truestroke.control.stage import MOST_DEAD, Stage, found
from truestroke.control.tone import STEADY_TONE
from truestroke.model.operators import dot

FOUND = 0.2  # relative standard deviation of the inertia of a resonance that an oscillation has
FOUND_FILTER = 0.6  # of a stage that was found by its oscillation: corner of the law's filter over its resonance,
FOUND_LAG, FOUND_INERTIA = 0.1, 0.05  # deviations of what its lag and inertia miss, over 1 / w0 and 1 / w0^2
STIFF = 0.12  # cycles per tick: from here on a tick of dead time is more than that lag
CERTAIN = 0.02  # relative deviation of a resonance that takes the place of another one in the model,
CERTAIN_AT_FIRST = 0.05  # and of one where no stage was in the model, until one has failed
MOVED = 0.015  # of the resonance of the model: one that is known and differs by so much replaces it,
FURTHER = 0.15  # unless by so much
DOUBT = 0.01  # of the motion's range: an error that the dynamics of the settings should not leave
LASTS = 8  # windows with such an error, which does not fall: then they are doubted
ELSEWHERE = 0.03  # of the first resonance of the settings: one that differs by so much, where learning has failed
MAY_BE_SECOND = 1.5  # times the first resonance so far: what is shown above may be the second mode
DRIVEN = 0.5  # share of the plays: what our voltage does not drive is of another axis, or comes from outside
ANOTHER = 0.07  # of their first resonance: one that differs by so much is that of another stage
FIRST_HOLD = 4  # blocks of the first hold of weights that had the least error
SLOWEST = 0.025  # of the resonance: a slower motion does not need it
NOISY = 9  # times the variance of a measurement: nor does a smaller error,
SHAKEN = 5e-4  # of the range of the motion: unless the stage rings by so much,
BY_CHANCE = 6  # and with more than so many such errors in a window: noise alone has half of them
TRIED = 0.1  # of a stage that missed more than the law, or failed: what is shown so near to it is it
MOST_SENSITIVE = 0.2  # of a resonance: where fewer plays move it further, it is as doubtful as one after a failure,
KNOWN = 0.01  # until its relative deviation is so small;
STANDS_ALONE = 0.1  # further than this, ringing alone does not show it, where the law is good without it
AGREES = 0.05  # with the resonance that the estimate knows: its lag is that of this stage, and the last window is of it
SEEN = 4e-3  # of the motion's range: a smaller error of what is good shows no other resonance
TURNS = 0.2  # radians at the resonance: a smaller lag is a matter of the weights
TURNED = 0.5  # radians: a stage in the model whose lag turns it by so much,
WHOLE = 0.75  # and takes so many ticks, has another dead time
MOST_GAINED = 5.0  # times their first gain: plays that have more, or less than a fifth, learn from a wrong sensor
BURSTS = 0.05  # of the motion's range: an error for which the stage is looked for in haste
LATE = 2 * MOST_DEAD  # ticks before a measurement: its stage knows no earlier strains
DAMPS = 0.2  # of the ringing: what the active damping takes from the command, a quarter of a period later,
BROAD = 1.0  # behind a filter of twice this damping,
STIFFEST = 0.06  # cycles per tick: less of it above, where what is not known of the lag turns it further,
HIGHEST_DAMPED = 0.25  # and nothing from here on
LOUD = 0.1  # of the motion's range: an error with which given dynamics may be wrong, whatever tone is in it
STEADY_BESIDE_GIVEN = 0.9  # as STEADY_TONE, where dynamics are given, which leave
NOT_URGENT = 0.03  # of the motion's range: a smaller error
OF_SECOND = 0.04  # of it: one with which they may be wrong, and what is shown may be the second mode
LOAD_COUNTS = 0.04  # of a sine that decays: a load lasts, and little of it remains in the mean
AS_GOOD_AS_NONE = 1e-6  # of the prior's variance: of a weight that stays
SLOW = 2.6  # radians at the resonance: a first-order lag that is larger is the amplifier's
WITHOUT_DEAD = 1.5  # ticks of what the estimate shows as a first-order lag: of the hold and the rest of the dead time
LAGS = (SLOW, 3.7, 5.2, 7.5)  # radians at the centre of the estimate, that the voltage is followed behind


def inertia_of(c: State, frequency: float) -> float:
    """1 / (w0^2 T), s, of a first resonance at `frequency`, cycles per tick; 0: not known."""
    w = 2 * math.pi * frequency
    return c.oscillation.tick / (w * w) if frequency > 0 else 0.0


def forget_stage(c: State) -> None:
    """The stage according to the settings."""
    stage, law = c.stage, c.filtering
    end_amplifier(c)
    stage.smoothing, stage.resonance, stage.inertia = c.members["smoothing"], 0.0, 0.0
    before, c.stage.found = c.path if stage.found else None, False
    if not c.members["dynamics.known"]:
        c.path = None
    elif before is not None:
        c.path = Stage(c.members, c.settings.parameters)
        c.path.rest(before.ticks, before.strain, before.z)
        if law is not None:
            law.stop_filters()
    if law is not None:
        stage.resonance, law.filter = c.members["resonance"], c.members["kalman.filter"]
        c.estimator.look(stage.resonance)
        stage.inertia = inertia_of(c, stage.resonance)
    if before is not None:
        stage.z = before.z
        end_growth(c)
        look_ahead_anew(c)


def adopt_resonance(c: State, law: FilteringLaw, frequency: float, highest: float) -> None:
    """The quantities that follow from a measured resonance, cycles per tick.

    The law's filter ends at half of it (at it where the inertia is learned), and is no higher than `highest` unless
    that is far lower; a learned change takes a period of it to reach the command, which includes the inertia.
    """
    learned = c.measures_inertia
    w = (2 * math.pi if learned else math.pi) * frequency
    pole = w / (1 + w)
    if pole > highest:
        pole = max(highest, pole / 8)
    law.filter = min(pole, c.members["kalman.filter"])
    c.stage.smoothing = max(c.stage.smoothing, 1 / (1 + frequency))
    c.estimator.look(frequency)
    c.stage.resonance, c.stage.inertia = frequency, 0.0 if learned else inertia_of(c, frequency)
    if not learned:
        return
    inertia, place = inertia_of(c, frequency) * c.oscillation.tick, c.settings.columns["inertia"].start
    weights = c.weights
    weights[place] = -inertia
    law.weights = weights
    law.separate(place, (FOUND * inertia) * (FOUND * inertia))
    keep_command(c)


def begin_anew(c: State, law: FilteringLaw) -> None:
    """What was learned without the stage is wrong, and so is how sure it is."""
    take_first(c, law)
    law.reset_covariance()


def take_first(c: State, law: FilteringLaw, *, gain_only: bool = False) -> None:
    """The first weights, with the gain that was measured, from the first measurement on.

    With `gain_only` terms beside the plays stay.
    """
    kept, plays, shown = c.kept, c.settings.columns["creep"].start, shows_gain(c)
    weights = c.weights if gain_only else kept.first.copy()
    weights[:plays] = (kept.gain.ratio if shown else 1.0) * kept.first[:plays]
    law.weights = weights
    if shown and not gain_only:
        move_offset(c, law, kept.gain.offset)


def move_offset(c: State, law: FilteringLaw, by: float) -> None:
    """The weight of the offset moves by so much, um."""
    if c.settings.offset:
        weights = c.weights
        at = c.settings.columns["offset"]
        weights[at] = np.clip(weights[at] + by, -LARGEST, LARGEST)
        law.weights = weights


def doubt_learned(c: State, law: FilteringLaw, frequency: float) -> None:
    """What was learned without the stage is good enough for its command, but as a whole it may be wrong.

    It may be as wrong as it is far from the first weights. Until the law's filters have settled, a period of the stage,
    nothing is learned.
    """
    law.reset_covariance()
    law.doubt(law.weights - c.kept.first)
    law.wait(int(1 / frequency))


def last_strains(c: State) -> range:
    """The ticks of the strains that a stage knows."""
    now = c.counters["commands"]
    return range(max(c.lagged.ticks - LATE, now - HISTORY, 0), now)


def restate(c: State, law: FilteringLaw, gain: float, offset: float, lag: float) -> None:
    """The last strains, and the weights that give them, with this gain and offset, um.

    The strains also with a weight of the lag, s.
    """
    for tick in last_strains(c):
        c.stage.strain[tick] = gain * c.stage.strain[tick] + offset + lag * c.waiting[tick].motion.zdot_d
    law.weights = np.clip(gain * c.weights, -LARGEST, LARGEST)
    move_offset(c, law, offset)


def separate_terms(c: State, law: FilteringLaw, frequency: float, left: float) -> None:
    """The terms that a stage of this frequency, cycles per tick, has in itself.

    But for what it misses: a lag, s, inertia, and rates.
    """
    s, tick = c.settings, c.oscillation.tick
    time = tick / (2 * math.pi * frequency)
    lag, inertia = FOUND_LAG * time + (tick if frequency > STIFF else 0.0), FOUND_INERTIA * (time * time)
    places = {s.columns["lag"].start: lag * lag + left * left} if s.lag else {}
    places |= {s.columns["inertia"].start: inertia * inertia} if s.inertia else {}
    rates = np.arange(s.parameters)[s.b].tolist()
    places |= {at: AS_GOOD_AS_NONE * s.prior_covariance[at][at] for at in rates}
    weights = c.weights
    weights[list(places)] = 0.0
    if s.lag:
        weights[s.columns["lag"]] = left
    law.weights = weights
    for place, variance in places.items():
        law.separate(place, variance)


def adopt_stage(c: State, law: FilteringLaw, frequency: float, ringing: float, shown: Candidate | None = None) -> None:
    """From now on the stage is between hysteresis and sensor; it rings by so much, um.

    Lag and inertia are in it, but for what it misses, and so is what the rate weights have learned. What the last
    window has `shown` that the weights miss beside it is in them from now on.
    """
    s, stage, tick, before = c.settings, c.stage, c.oscillation.tick, c.path
    again = stage.found
    slow = 0.0 if again else lag_of_amplifier(c, frequency)
    dead = 1 if slow > 0 else dead_time(c, frequency, before.dead if again and before is not None else 1)
    left = 0.0
    if shown is not None:
        left = shown.lag + dead * tick
        restate(c, law, 1 + shown.gain, shown.offset, left)
    elif slow > 0:
        left = float(law.weights[s.columns["lag"]].sum())
        restate(c, law, 1.0, 0.0, left)
    c.path, stage.found = Stage(found(frequency, tick, dead), s.parameters), True
    stage.amplifier = stage.amplifier if again else 0.0
    if slow > 0:
        begin_amplifier(c, slow)
        left += slow * tick
    left = min(max(left, -LARGEST), LARGEST)
    if before is None:
        c.path.go_on(c.lagged.ticks, dict(stage.strain), stage.z)
    else:
        c.path.go_on(before.ticks, before.strain, before.z)
    corner = 2 * math.pi * FOUND_FILTER * frequency
    law.filter = corner / (1 + corner)
    law.disturbance = law.caution = 0.0
    stage.smoothing, stage.inertia = max(c.members["smoothing"], 1 / (1 + frequency)), 0.0
    separate_terms(c, law, frequency, left)
    law.stop_filters()
    c.ringing.u = None
    begin_growth(c, first=not again)
    c.damping = damping(frequency, dead + c.answered)
    look_ahead_anew(c)
    keep_command(c)
    guard = c.kept.guard
    if not again:
        c.damped = [0.0, 0.0]
        stage.trial = guard.kept  # what was good before is good to go back to
        c.kept.begun = c.kept.begun or not guard.kept
        guard.begin()
    guard.ringing = max(guard.ringing, ringing)


def damping(frequency: float, ticks: int) -> list[float]:
    """b0, b1, b2, a1, a2 of the filter of the error that damps a stage of this frequency, cycles per tick.

    The error behind a low pass at it, which is a quarter of a period late there, is taken from the command. Where the
    loop is later, so many ticks in all, a band pass at the same frequency leads by as much::

        -0.2 w0 (w0 cos a + s sin a) / (s^2 + w0 s + w0^2),  a = w0 T ticks

    Examples
    --------
    >>> b0, b1, b2, a1, a2 = damping(0.01, 1)
    >>> q = np.exp(-2j * np.pi * 0.01)
    >>> response = (b0 + b1 * q + b2 * q**2) / (1 + a1 * q + a2 * q**2)
    >>> print(f"{abs(response):.3f}, {np.degrees(np.angle(response * q)):.1f} degrees")
    0.200, 90.0 degrees
    """
    g = tangent(math.pi * min(frequency, HIGHEST_DAMPED))
    square = g * g
    whole = 1 + g * BROAD + square
    cosine, sine = (1 - square) / (1 + square), 2 * g / (1 + square)  # of the angle of a tick,
    low, band = 1.0, 0.0  # and of them all
    for _ in range(ticks):
        low, band = low * cosine - band * sine, band * cosine + low * sine
    share = 0.0 if frequency > HIGHEST_DAMPED else DAMPS * STIFFEST / frequency if frequency > STIFFEST else DAMPS
    low *= -share * BROAD * square / whole
    band *= -share * BROAD * g / whole
    return [low + band, 2 * low, low - band, 2 * (square - 1) / whole, (1 - g * BROAD + square) / whole]


def shown_dead(c: State, before: int) -> int:
    """Ticks of dead time that the estimate shows, where so many are in the model."""
    return int(min(max(before + c.estimator.lag + 0.5, 0), MOST_DEAD))


def dead_time(c: State, frequency: float, before: int) -> int:
    """Whole ticks of dead time of a stage of this frequency, cycles per tick, so many were in use `before`.

    Where the estimate knows that stage, and its lag is not small beside a period, they are that lag.
    """
    known, dead = c.estimator, 1
    if known.windows > 0 and abs(frequency / known.known - 1) < AGREES:
        turns = abs(known.lag) * 2 * math.pi * frequency
        dead = shown_dead(c, before) if turns > TURNS else before
    if c.members["dynamics.known"]:
        dead = c.members["dynamics.dead"]
    known.lag -= dead - before
    known.first_order -= dead - before
    if dead != before:
        known.ticks = 0
    return dead


def follow_slower(c: State, x: float) -> None:
    """One tick of the voltages behind each of the `LAGS`, with this one, V."""
    w = 2 * math.pi * c.estimator.centre
    if w > 0:
        c.slower = [slow + w / (w + lag) * (x - slow) for slow, lag in zip(c.slower, LAGS, strict=True)]


def lag_of_amplifier(c: State, frequency: float) -> float:
    """Ticks of the lag of an amplifier before a stage of this frequency; 0: none is shown.

    A dead time that turns the resonance as far is shown as a smaller lag, or has more ticks than any here.
    """
    known, w = c.estimator, 2 * math.pi * frequency
    t = known.first_order - WITHOUT_DEAD
    if c.members["dynamics.known"] or not known.windows > 0 or not abs(frequency / known.known - 1) < AGREES:
        return 0.0
    return min(t, LAGS[-1] / w) if t > MOST_DEAD and t * w > SLOW else 0.0


def behind_lag(c: State, ticks: float) -> float:
    """What `lagged` has seen of the voltage behind a lag of so many ticks, V."""
    radians = min(max(ticks * (2 * math.pi * c.estimator.centre), LAGS[0]), LAGS[-1])
    i = next((i for i in range(1, len(LAGS) - 1) if not radians > LAGS[i]), len(LAGS) - 1)
    share = (radians - LAGS[i - 1]) / (LAGS[i] - LAGS[i - 1])
    return c.slower[i - 1] + share * (c.slower[i] - c.slower[i - 1])


def move_all(c: State, to: float) -> None:
    """The voltage that the plays of the last measured tick see is another one, V; those of the command follow it."""
    ticks = c.now.ticks
    move_voltage(c, c.lagged, to)
    c.now = copy.deepcopy(c.lagged)
    for tick in range(c.lagged.ticks, ticks):
        remember_creep(c, c.now)
        remember_voltage(c, c.now, c.waiting[tick].x)


def begin_amplifier(c: State, ticks: float) -> None:
    """From now on the plays see the voltage behind a lag of so many ticks, and have seen it."""
    c.stage.amplifier = ticks / (1 + ticks)
    c.estimator.lag = c.estimator.first_order = 0.0
    c.estimator.ticks = 0
    move_all(c, behind_lag(c, ticks))


def end_amplifier(c: State) -> None:
    """The plays see the voltage itself again, where an amplifier was found with the stage."""
    if c.stage.found and c.stage.amplifier > 0:
        c.stage.amplifier = 0.0
        move_all(c, c.waiting[c.lagged.ticks - 1].x)


def begin_growth(c: State, *, first: bool) -> None:
    """Nothing is known of the present error, and nothing held; what a hold has shown stays, but for another stage."""
    before = c.stage.growth
    if first or before is None:
        c.stage.growth = Growth(c.law.weights, FIRST_HOLD)
    else:
        c.stage.growth = Growth(before.weights, before.wait, before.late)


def end_growth(c: State) -> None:
    """The stage is no longer in the model: the weights to be restored are those at their best."""
    c.ringing.u, c.stage.growth = None, None
    c.stage.older = c.stage.newer = c.kept.weights
    c.stage.age = 0.0


def give_up_stage(c: State, law: FilteringLaw) -> None:
    """It was not that: the stage is that of the settings, or the resonance alone is known, as before."""
    if c.path is None or not c.stage.found:
        return
    stage = c.stage
    stage.failed, stage.trial, c.estimator.windows = True, False, 0
    stage.given_up = stage.resonance
    if c.members["dynamics.known"]:
        forget_stage(c)
        keep_command(c)
        return
    end_amplifier(c)
    stage.z = c.path.z
    c.estimator.lag += c.path.dead - 1  # behind the plays of a tick before
    c.estimator.ticks = 0
    c.path, stage.found = None, False
    end_growth(c)
    adopt_resonance(c, law, stage.resonance, 1.0)
    look_ahead_anew(c)


def noisy(c: State, law: FilteringLaw) -> float:
    """Mean square of an error that may be noise, um^2. What the model misses is looked for, so it is no noise."""
    noise = max(law.sigma, c.resolution)
    return NOISY * noise * noise


def may_have_stage(c: State) -> bool:
    """Whether a stage may be put into the model now: the last strains are known, and the sensor is not late."""
    return not (c.held or c.stage.rest > 0 or c.sensor.late or c.lagged.ticks < 8)


def burst_of(c: State) -> float:
    """Mean square of an error that is a burst, um^2."""
    error = BURSTS * c.kept.guard.range
    return error * error


def is_assumed(c: State) -> bool:
    """Whether the resonance of the stage in the model is that of the settings: nothing has shown it."""
    return c.stage.found and c.stage.resonance == c.members["resonance"]


def may_be_second(c: State) -> bool:
    """Whether what is shown is so far above the first resonance that it may be the second mode.

    The first one is that of the stage that was found, or of the settings. It explains no burst then.
    """
    known = c.estimator
    first = c.stage.resonance if c.stage.found else c.members["resonance"]
    if c.members["dynamics.known"] or not first > 0 or not known.known > MAY_BE_SECOND * first:
        return False
    return not (known.power > burst_of(c) and known.driven > DRIVEN)


def is_late(c: State) -> bool:
    """Whether the stage that was found answers ticks later, or sooner, than in the model.

    The model is then as wrong as with another resonance.
    """
    known, path = c.estimator, c.path
    moved, lag = known.known / c.stage.resonance - 1, abs(known.lag)
    if path is None or c.members["dynamics.known"] or known.windows < 2 or not moved * moved < FURTHER * FURTHER:
        return False
    return lag > WHOLE and lag * 2 * math.pi * known.known > TURNED and shown_dead(c, path.dead) != path.dead


def shows_rest(c: State) -> bool:
    """Whether the last window has shown what the weights miss beside the stage that is put into the model.

    In a slow motion it has not: a load does.
    """
    stage, fast = c.stage, c.estimator.motion > SLOWEST * c.stage.resonance
    return c.settings.lag and fast and not stage.found and abs(c.candidate.shown / stage.resonance - 1) < TRIED


def matters(c: State) -> bool:
    """Whether the stage is put into the model, or its resonance or dead time there replaced.

    The motion is then fast enough, and the error larger than noise; or it rings.
    """
    law, known, stage = c.filtering, c.estimator, c.stage
    if law is None or not may_have_stage(c) or may_be_second(c):
        return False
    assumed = is_assumed(c)
    bursts = not stage.found and known.windows > 0 and known.power > burst_of(c)
    if bursts and not known.driven > DRIVEN:
        return False
    sensitive = known.sensitivity > MOST_SENSITIVE and known.variance > KNOWN * KNOWN
    doubtful = stage.failed or (c.kept.guard.kept and not bursts and sensitive)
    certain = CERTAIN if doubtful or c.path is not None else CERTAIN_AT_FIRST
    if not (known.suffices or bursts) or (known.variance > certain * certain and not assumed):
        return False
    if not stage.found and abs(known.centre / known.known - 1) > AGREES:  # windows that walk are not noise about it
        return False
    again = abs(known.known - stage.given_up) < TRIED * stage.given_up
    if not stage.found and not c.is_given and again and not bursts:
        return False
    if stage.found:
        moved = known.known / stage.resonance - 1
        if is_late(c):
            return True
        seen = SEEN * c.kept.guard.range
        if c.kept.guard.kept and known.power < seen * seen:
            return False
        anywhere = assumed or stage.trial  # it has never been better than none
        far = moved * moved > MOVED * MOVED and (anywhere or moved * moved < FURTHER * FURTHER)
        return far and moved * moved > 4 * known.variance
    if c.is_given:
        guard = c.kept.guard
        failing = guard.held > 0 or guard.wait > FIRST_WAIT
        if not (failing or bursts) and stage.doubted < LASTS:
            return False
        away, least = known.known / c.members["dynamics.first"] - 1, ELSEWHERE if failing else ANOTHER
        large = (OF_SECOND if away > MAY_BE_SECOND - 1 else DOUBT) * guard.range
        return away * away > least * least and known.power > large * large and known.driven > DRIVEN_ALONE
    least, large = noisy(c, law), DOUBT * c.kept.guard.range
    fast, worse = known.motion > SLOWEST * known.known, abs(c.candidate.worse / known.known - 1) < TRIED
    if fast and worse and not bursts:
        return False
    if doubtful and c.kept.guard.kept:
        least = max(least, large * large)
    if fast and known.power > least:
        return True
    if doubtful or (c.kept.guard.kept and known.sensitivity > STANDS_ALONE):
        return False
    rings, ringing = SHAKEN * c.kept.guard.range, known.ringing
    return ringing > rings * rings and ringing * known.window > BY_CHANCE * noisy(c, law)


def forget_lag(c: State, law: FilteringLaw) -> None:
    """The last strains as the model has them when lag and inertia are in the stage.

    Weights that were in their place would be a step of the strain, at which the stage of the model rings.
    """
    columns = c.settings.columns
    lag, inertia = (float(law.weights[columns[name]].sum()) for name in ("lag", "inertia"))
    for tick in last_strains(c):
        motion = c.waiting[tick].motion
        less = lag * motion.zdot_d + inertia * motion.zddot_d
        c.stage.strain[tick] -= less
        if c.path is not None and tick in c.path.strain:
            c.path.strain[tick] -= less


def expected_of_plays(c: State) -> FloatArray | None:
    """Weights that are expected of the plays that stand for all of them, um/V, shape (7,).

    The first ones, with the gain that was learned. Each play counts for the nearest of them. None: that gain is not one
    of this actuator.
    """
    places = c.settings.a.tolist()
    last = max(len(places) - 1, 1)
    expected, before, now = np.zeros(SHOWN), 0.0, 0.0
    for i, place in enumerate(places):
        first = float(c.kept.first[place])
        expected[(i * (SHOWN - 1) + last // 2) // last] += first
        before += first
        now += float(c.law.weights[place])
    if not (now * MOST_GAINED > before and now < MOST_GAINED * before):
        return None
    return expected * (now / before)


def highest_first(c: State) -> float:
    """The highest frequency of a first resonance, cycles per tick.

    Where the stage of the model has long been good, what is shown further above is its second mode.
    """
    guard = c.kept.guard
    good = c.path is not None and c.stage.found and guard.settled and not guard.lost and not c.stage.trial
    return (1 + FURTHER) * c.stage.resonance if good else HIGHEST


def loudest_load(c: State) -> float:
    """Mean square of an error from which on a tone is no load, um^2. With a trim it may be one that this sustains."""
    if c.settings.trim_rate > 0:
        return 0.0
    whole = c.kept.guard.range
    return LOUD * LOUD * (whole * whole) if c.is_given else LARGEST * LARGEST


def try_candidate(c: State, z: float, zdot_d: float) -> None:
    """One tick of a law without a stage in its model, with what it has learned.

    The strain is that of all terms but the lag, the inertia and the rate weights, which the stage has.
    """
    s, weights = c.settings, c.law.weights
    expected = strain = float(dot(weights, c.u))
    for term in ("lag", "inertia"):
        for place in range(s.parameters)[s.columns[term]]:
            strain -= float(weights[place] * c.u[place])
    for place in np.arange(s.parameters)[s.b].tolist():
        strain -= float(weights[place] * c.u[place])
    if c.estimator.ticks == 0 or not c.candidate.frequency > 0:
        c.candidate = candidate.begun(c.estimator.known, c.oscillation.tick, strain, c.candidate.strain)
    if c.candidate.frequency > 0:
        c.candidate.count(z, zdot_d, strain, z - expected)
    c.candidate.strain = strain


def watch_resonance(c: State, z: float, error: float, zdot_d: float, path: Stage | None) -> None:
    """One tick of the estimate: the plays of a tick before the measurement, which is about its dead time."""
    law, tick = c.filtering, c.oscillation.tick
    if law is None or not tick > 0:
        return
    if c.is_given and not c.kept.guard.error > DOUBT:  # no reason to look for another
        c.estimator.ticks = 0
        law.load = 0.0
        return
    now = shown(c.lagged.play)
    before, c.shown = c.shown if path is None else now, now
    guard = c.kept.guard
    good = guard.kept and path is None  # a stage that is wrong would lose what was learned
    span = guard.range if good and not c.members["dynamics.known"] else 0.0
    most, burst = guard.range * guard.range, 0.0 if c.stage.found else burst_of(c)
    ends = path is None and c.estimator.ends(noisy(c, law), most)  # with a stage in the model weights may go with it
    expected = expected_of_plays(c) if ends else None
    noise = 0.0 if c.members["resonance"] > 0 else law.sigma * law.sigma  # where f0 is given windows begin about it
    motion, powers = (zdot_d, zdot_d - c.rate), (power_of_hum(c), loudest_load(c), noise)
    unknown = path is None and not c.is_given
    if unknown:
        try_candidate(c, z, zdot_d)
    steady = STEADY_BESIDE_GIVEN if c.is_given and guard.error < NOT_URGENT else STEADY_TONE
    search, driven = (span, highest_first(c), burst), DRIVEN_ALONE if path is None else 1.0
    known = c.estimator.update(tick, before, z, error, *motion, *search, expected, powers, steady, driven)
    c.rate = zdot_d
    if unknown and c.estimator.ticks == 0:
        c.candidate.end(tick)
    if c.estimator.ticks == 0:
        load = c.estimator.load
        law.load = LOAD_COUNTS * law.noise_of_sine(load, c.estimator.load_at) if load > 0 else 0.0
    assumes = c.members["resonance"] > 0 and c.path is None and not c.stage.failed
    assumes = assumes and not is_identified(c) and may_have_stage(c)
    if not assumes and not (known and matters(c)):
        return
    c.stage.resonance = frequency = c.members["resonance"] if assumes else c.estimator.known
    guard.settled = guard.settled and guard.lost  # else it was no wrong sensor: there is nothing to return to
    forget_lag(c, law)
    takes = not assumes and shows_rest(c)
    if not c.stage.found and (guard.kept or not assumes):  # at the start nothing is learned
        doubt_learned(c, law, frequency)
    ringing = 0.0 if assumes else math.sqrt(c.estimator.power)
    adopt_stage(c, law, frequency, ringing, c.candidate if takes else None)
    if assumes and not guard.kept and c.path is not None:  # at the start learning does not wait
        c.path.stand()
        law.start_filters()
    if c.stage.growth is not None and not assumes and 0 < burst < c.estimator.power:
        c.stage.growth.late = True  # a burst excites the second mode, too


def stage_is_shown(c: State, law: FilteringLaw) -> bool:
    """Whether the stage of the model is the one that the measurements show. Where it is near, it is moved there."""
    shown, stage = c.estimator, c.stage
    if not stage.found:
        return False
    if not shown.known > 0 or shown.variance > CERTAIN * CERTAIN:
        return bool(c.members["resonance"] > 0) and c.kept.guard.kept  # nothing shows another one
    moved = shown.known / stage.resonance - 1
    if moved * moved > FURTHER * FURTHER:
        return False
    if moved * moved > MOVED * MOVED:
        stage.resonance = shown.known
        adopt_stage(c, law, shown.known, 0.0)
    return True
