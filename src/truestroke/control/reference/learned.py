"""Never worse than not learning: the guard's decisions, and the weights that are kept for them."""

import math

from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import FilteringLaw
from truestroke.control.guard import SWINGS, Action, FirstGain, Guard, Recall
from truestroke.control.reference.command import keep_command, look_ahead_anew
from truestroke.control.reference.first import shows_gain
from truestroke.control.reference.found import (
    DOUBT,
    FIRST_HOLD,
    LASTS,
    begin_growth,
    end_amplifier,
    forget_stage,
    give_up_stage,
    move_offset,
    stage_is_shown,
    take_first,
)
from truestroke.control.reference.ringing import watch_burst
from truestroke.control.reference.state import Growth, Kept, State
from truestroke.control.reference.terms import through_dead_zones
from truestroke.model.operators import dot

PAUSE = 100.0  # 1/s: rate of sudden changes from which on the feedback pauses
FALLEN = 0.8  # of an error that the dynamics leave: learning makes it smaller
MOST_CAUTION = 0.1  # of the motion's range: the largest error that counts as noise after learning has failed
CAUTIOUS = 100  # times the variance of a measurement: from there on the law follows no drift

SLOWER = 8  # times as slow as the poles of the oscillation: the pole of the first gain
SURE = 10  # of a window: for so long a displacement of the floor is as sure as the first gain

WIDER = 1.05  # times the range of the motion so far: a larger motion,
FOLLOWED = 0.02  # once the error is less of it: a larger one may be that of another stage

BLOCK = 0.25  # s: over which an error is taken
GREW = 1.4  # times the least of a block: an error that has grown,
GROWN = 2  # in so many blocks in a row,
LEAST_GROWN = 1e-3  # of the motion's range at least,
NOISES_GROWN = 3  # and so many standard deviations of a measurement
RISES = 1.2  # times that of the window before: an error that has risen,
RISING = 4  # in so many windows in a row,
ABOVE = 4  # to so many times the least
AS_FAST = 1.2  # times as fast, or as slow: another motion
SETTLED_HELD = 3  # windows until held weights are judged
HELPS = 0.8  # of the error that had grown: earlier weights are better,
AS_GOOD = 1.3  # and, times the least, as good as they were
AT_ONCE = 1.5  # times the error that had grown: held weights are not waited for,
RINGS_OUT = 1  # behind so many windows in which the stage still rings of their coming
WORN = 1.5  # times the error that they had at first: they are old
LONGEST_HOLD = 256  # blocks


def first_gain(c: State) -> FirstGain:
    """Of the weights of the start: nothing is known."""
    floor = c.guarding.floor
    return FirstGain(c.oscillation.slow / SLOWER, floor * floor * c.guarding.window / SURE)


def keep_start(c: State) -> None:
    """Until there are better ones, the first weights are the best."""
    w = c.law.weights
    c.kept = Kept(Guard(c.guarding), w, w, w, recall=Recall(c.guarding), gain=first_gain(c))


def take_weights(c: State, law: FilteringLaw, weights: FloatArray, *, earlier: bool) -> None:
    """Other weights; earlier ones miss what has drifted since.

    While weights are held the filters of the law are not started: those of the start then predict what they do.
    """
    before = float(dot(law.weights, c.u))
    law.weights = weights
    if earlier and law.started:
        move_offset(c, law, law.missing())
    elif earlier and c.kept.guard.at_start:
        move_offset(c, law, before - float(dot(weights, c.u)))
    hand_over(c)


def hand_over(c: State) -> None:
    """The command goes on from where it is.

    The feedback waits, for its margins are those of a model that has been learned.
    """
    keep_command(c)
    c.alarms = 2 * PAUSE


def weights_at_best(c: State, law: FilteringLaw) -> None:
    """They are at their best: with covariance, noise, and what is known of the stage."""
    kept, stage = c.kept, c.stage
    kept.weights, kept.knowledge, kept.filter = law.weights, law.knowledge(), law.filter
    kept.stage = stage.smoothing, stage.resonance, stage.inertia
    kept.oscillated, kept.failed, kept.staged = stage.detector.found, stage.failed, c.path is not None
    kept.begun = stage.trial = False


def stage_at_best(c: State, law: FilteringLaw) -> None:
    """What was known of the stage when weights were kept: they belong to it."""
    kept, stage = c.kept, c.stage
    stage.smoothing, stage.resonance, stage.inertia = kept.stage
    law.filter, stage.detector.found = kept.filter, kept.oscillated


def end_trial(c: State, law: FilteringLaw) -> None:
    """A stage on trial has failed: without it, and its resonance, unless an oscillation has shown that since."""
    if not c.stage.trial or not c.stage.found:
        return
    shown = c.stage.detector.found and not c.kept.oscillated
    give_up_stage(c, law)
    if shown or c.kept.staged or c.kept.begun or c.members["dynamics.known"]:
        return
    stage_at_best(c, law)
    look_ahead_anew(c)


def watch_kept(c: State, law: FilteringLaw, u: FloatArray, z: float) -> None:
    """While the model is lost: whether the kept weights predict again, without a stage that was found since.

    z, um, belongs to the regressor u.
    """
    kept, guard = c.kept, c.kept.guard
    watched = guard.settings.window > 0 and c.oscillation.tick > 0
    if watched and not guard.was_good and c.path is None:
        kept.gain.update(float(dot(kept.first, u)), through_dead_zones(c, z))
        return
    kept.gain.begin()
    if not guard.lost or kept.staged or c.held or c.lagged.ticks < 2:
        kept.recall.begin()
        return
    newer, older = (c.waiting[c.lagged.ticks - back].motion.zdot_d for back in (1, 2))
    predicted = float(dot(kept.weights, u))
    missed = through_dead_zones(c, z) + kept.stage[2] * (newer - older) - predicted
    noise = max(kept.knowledge[1], c.resolution)
    if kept.recall.update(predicted, missed, span=guard.range, noise=noise):
        recall(c, law, kept.recall.offset)


def recall(c: State, law: FilteringLaw, offset: float) -> None:
    """The kept weights again, moved by this offset, um, and what was known of the stage with them."""
    kept, stage, known = c.kept, c.stage, c.estimator
    staged = c.path is not None
    end_amplifier(c)
    if c.path is not None:
        stage.z, c.path, stage.found = c.path.z, None, False
    c.ringing.u, stage.growth = None, None
    stage.trial, stage.failed, stage.rest = False, kept.failed, 0.0
    stage.detector.sign = stage.detector.regular = 0
    known.known = known.variance = 0.0
    known.windows = known.ticks = 0
    law.restore(kept.knowledge)
    law.disturbance = law.caution = 0.0
    stage_at_best(c, law)
    if staged:
        look_ahead_anew(c)
    take_weights(c, law, kept.weights, earlier=False)
    move_offset(c, law, offset)
    stage.older = stage.newer = law.weights
    stage.age = 0.0
    keep_command(c)
    kept.guard.recall()
    c.count(restored=True)
    c.oscillating, c.restored = False, True  # in this tick


def learn_cautiously(c: State, law: FilteringLaw) -> None:
    """What was held is better: its covariance; an error as large as the one that failed counts as noise a while."""
    guard = c.kept.guard
    if guard.kept:
        law.restore(c.kept.knowledge)
    else:
        law.reset_covariance()
    error = min(guard.failed, MOST_CAUTION) * guard.range
    law.caution = error * error * guard.settings.window / 4


def doubt_dynamics(c: State, error: float) -> None:
    """After a window with this error over the range: whether it is large and does not fall with those given."""
    stage = c.stage
    if error > DOUBT and stage.doubted > 0 and error > FALLEN * stage.doubt:
        stage.doubted = min(stage.doubted + 1, LASTS)
    else:
        stage.doubt, stage.doubted = error, int(error > DOUBT)


def doubt_outgrown(c: State, law: FilteringLaw) -> None:
    """At the end of a window: where the motion has become larger, the weights are not as sure as they seemed.

    In a smaller one what the model of the stage misses was as small as the noise, and the law took it for knowledge.
    """
    stage, guard = c.stage, c.kept.guard
    if c.path is None:
        stage.widest = 0.0
    elif guard.held == 0 and guard.error < FOLLOWED:
        outgrown, slow = guard.range > WIDER * stage.widest, c.settings.other_axes > 0  # as y of a scan
        if outgrown or (slow and guard.range > stage.widest):
            stage.widest = guard.range
        law.outgrown = law.outgrown or outgrown


def is_restored(c: State) -> bool:
    """Whether earlier weights are held, since learning made the error larger."""
    return c.kept.guard.held > 0 or (c.stage.growth is not None and c.stage.growth.held > 0)


def keep_least(g: Growth, weights: FloatArray, error: float, speed: float) -> None:
    """The weights of this block have the least error."""
    g.weights, g.known, g.least, g.swift, g.bad = weights, True, error, speed, 0


def learn_on(c: State, law: FilteringLaw, g: Growth) -> None:
    """The law continues, when its filters have settled: after a period of the stage."""
    g.held = 0
    law.wait(int(1 / c.stage.resonance))


def least_grown(c: State, noise: float) -> float:
    """The least error over the range that has grown: a smaller one is noise."""
    return max(NOISES_GROWN * noise / c.kept.guard.range, LEAST_GROWN)


def hold_least(c: State, law: FilteringLaw, g: Growth, error: float) -> None:
    """The weights with the least error, for this one."""
    c.kept.aside = law.weights
    take_weights(c, law, g.weights, earlier=True)
    g.failed, g.held, g.good = error, 1, 0.0
    c.count(restored=True)


def judge_growth(
    c: State, law: FilteringLaw, g: Growth, error: float, *, speed: float, other: bool, noise: float
) -> None:
    """A block of the weights that learn.

    Where the error has grown while the motion is as fast, those with the least error are held.
    """
    g.left -= g.left > 0
    if not g.known or other or error <= g.least:
        keep_least(g, law.weights, error, speed)
        return
    grew = error > GREW * g.least and error > least_grown(c, noise) and not g.left
    g.bad = g.bad + 1 if grew else 0
    if g.bad >= (GROWN if g.wait == FIRST_HOLD else 1):
        hold_least(c, law, g, error)


def has_risen(c: State, g: Growth, noise: float) -> bool:
    """At the end of a window: whether the error has risen in each of the last ones.

    To many times that of the weights that are kept, which promise to be better, in a motion that is as fast as before
    and goes through its range in a window.
    """
    kept, guard = c.kept, c.kept.guard
    window, span = guard.settings.window, guard.range
    time = window * c.oscillation.tick
    passes, as_fast = g.pace * (time * time) > window * (span * span), g.pace < AS_FAST * AS_FAST * g.paced
    rises = passes and as_fast and g.before > 0 and guard.error > RISES * g.before
    g.rising = g.rising + 1 if rises else 0
    g.before, g.paced, g.pace = guard.error, g.pace, 0.0
    of_model = guard.kept and not kept.begun and kept.staged is (c.path is not None)
    far = guard.error > max(least_grown(c, noise), ABOVE * guard.best)
    return of_model and g.rising >= RISING and far and guard.promises(guard.error)


def judge_restored(c: State, law: FilteringLaw, g: Growth, error: float, *, speed: float, burst: bool) -> None:
    """The first block of the held weights.

    The law goes on from there with a third pole, unless it had that; then they stay, if they are as good as they were.
    Where they are no better, learning was not the cause.
    """
    if burst or error > HELPS * g.failed:
        take_weights(c, law, c.kept.aside, earlier=False)
        learn_on(c, law, g)
        c.stage.growth = again = Growth(g.weights, g.wait, g.late)
        keep_least(again, c.kept.aside, g.failed, speed)
        again.left = g.wait
        return
    before, g.late, g.good = g.late, True, error
    if not before or error > AS_GOOD * g.least:
        keep_least(g, g.weights, error, speed)
        learn_on(c, law, g)
        return
    g.left, g.wait = g.wait, 2 * g.wait if g.wait < LONGEST_HOLD else LONGEST_HOLD


def judge_hold(c: State, law: FilteringLaw, g: Growth, error: float, *, speed: float, other: bool, burst: bool) -> None:
    """Each further one: the law goes on when the hold ends, or they are old."""
    worn = other or burst or error > WORN * g.good
    g.left -= 1
    if g.left > 0 and not worn:
        return
    learn_on(c, law, g)
    if worn and (other or g.left > 0):
        begin_growth(c, first=False)
    else:
        keep_least(g, g.weights, error, speed)


def watch_growth(c: State, law: FilteringLaw, noise: float) -> None:
    """One tick beside the guard: an error that grows, far below what the guard takes for a failure."""
    guard, g = c.kept.guard, c.stage.growth
    if g is None:
        return
    if guard.held > 0 or c.stage.trial or c.changed:
        begin_growth(c, first=False)
        return
    g.speed += c.rate * c.rate
    g.ticks += 1
    g.pace += c.rate * c.rate
    if g.held > 0:
        move_offset(c, law, guard.drift)
    if guard.ticks > 0:  # within a window
        return
    if has_risen(c, g, noise) and g.held == 0:
        keep_least(g, c.kept.weights, guard.best, math.sqrt(g.paced / guard.settings.window))
        hold_least(c, law, g, guard.error)
        g.windows, g.square, g.speed, g.ticks, g.rising = 0, 0.0, 0.0, 0, 0
    burst = g.held > RINGS_OUT and guard.error > AT_ONCE * g.failed
    g.held += g.held > 0
    if 0 < g.held <= SETTLED_HELD and not burst:
        g.speed, g.ticks = 0.0, 0
        return
    g.windows += 1
    g.square += guard.error * guard.error
    if not burst and g.windows * (guard.settings.window * c.oscillation.tick) < BLOCK:
        return
    error, speed = math.sqrt(g.square / g.windows), math.sqrt(g.speed / g.ticks)
    other = g.known and (speed > AS_FAST * g.swift or AS_FAST * speed < g.swift)
    g.windows, g.square, g.speed, g.ticks = 0, 0.0, 0.0, 0
    if other:
        g.wait = FIRST_HOLD
    if g.held == 0:
        judge_growth(c, law, g, error, speed=speed, other=other, noise=noise)
    elif g.good > 0:
        judge_hold(c, law, g, error, speed=speed, other=other, burst=burst)
    else:
        judge_restored(c, law, g, error, speed=speed, burst=burst)


def compare_kept(c: State, law: FilteringLaw) -> None:
    """What the weights that would be restored miss, if they belong to the model as it is.

    After a bad window, or one whose error rises.
    """
    kept = c.kept
    other = c.stage.trial or (not kept.begun and kept.staged is not (c.path is not None))
    if law.started and not other and not shows_gain(c):
        kept.guard.compare(law.missing(kept.first if kept.begun else kept.weights))


def decide(c: State, law: FilteringLaw, action: Action) -> None:
    """What the guard has decided."""
    kept, guard = c.kept, c.kept.guard
    match action:
        case Action.KEEP:
            weights_at_best(c, law)
        case Action.RESTORE:
            kept.aside = law.weights
            end_trial(c, law)
            if shows_gain(c):
                take_first(c, law)
                hand_over(c)
            else:
                swings = guard.kept and guard.swings >= SWINGS  # a swing is no offset
                take_weights(c, law, kept.first if kept.begun else kept.weights, earlier=not swings)
            c.count(restored=True)
        case Action.FIRST:
            if not stage_is_shown(c, law):
                give_up_stage(c, law)
            take_weights(c, law, kept.first, earlier=True)
        case Action.ADOPT:
            learn_cautiously(c, law)
        case Action.RETURN if c.stage.found and not stage_is_shown(c, law):
            give_up_stage(c, law)
            take_weights(c, law, kept.first, earlier=True)
            law.reset_covariance()
        case Action.RETURN:
            of_motion = c.stage.resonance < c.estimator.lowest(c.oscillation.tick)
            if of_motion and not (c.members["resonance"] > 0 or c.path is not None):  # it was no resonance
                forget_stage(c)
                c.stage.detector.found = False
            take_weights(c, law, kept.aside, earlier=False)


def watch_learning(c: State, error: float, z_d: float, counts: bool) -> None:
    """One tick of the guard, and what it decides."""
    law, kept, guard = c.filtering, c.kept, c.kept.guard
    if law is None or guard.settings.window == 0 or c.held:
        return
    resting = c.stage.rest > 0 and guard.held == 0
    noise = max(kept.knowledge[1] if guard.kept else law.sigma, c.resolution)
    if c.stage.resonance > 0:  # known: what rings there is judged by its windows
        guard.swings = 0
    if c.path is None:
        watch_burst(c, law, error)
    known = guard.kept
    rising = c.stage.growth is not None and c.stage.growth.rising >= RISING - 1
    if (guard.bad > 0 or rising) and counts and not resting:
        compare_kept(c, law)
    decide(c, law, guard.update(error, z_d, counts=counts and not resting, noise=noise))
    if guard.kept is not known and not guard.lost:
        kept.gain.begin()
        kept.recall.begin()
    if guard.ticks == 0 and c.is_given:
        doubt_dynamics(c, guard.error)
    if guard.ticks == 0:
        doubt_outgrown(c, law)
    if guard.held > 0 or law.caution > CAUTIOUS * (law.sigma * law.sigma):
        move_offset(c, law, guard.drift)
    if guard.held == 0 and guard.ticks == 0:
        law.caution *= 1 - 0.8 / guard.wait
    watch_growth(c, law, noise)
    c.restored = is_restored(c)
