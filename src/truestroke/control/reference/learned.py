"""Never worse than not learning: the guard's decisions, and the weights that are kept for them."""

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LARGEST, FilteringLaw
from truestroke.control.guard import SWINGS, Action, Guard, Recall
from truestroke.control.reference.command import keep_command, look_ahead_anew
from truestroke.control.reference.found import DOUBT, LASTS, forget_stage, give_up_stage, stage_is_shown
from truestroke.control.reference.state import Kept, State
from truestroke.control.reference.terms import through_dead_zones
from truestroke.model.operators import dot

PAUSE = 100.0  # 1/s: rate of sudden changes from which on the feedback pauses
FALLEN = 0.8  # of an error that the dynamics leave: learning makes it smaller
MOST_CAUTION = 0.1  # of the motion's range: the largest error that counts as noise after learning has failed
CAUTIOUS = 100  # times the variance of a measurement: from there on the law follows no drift


def keep_start(c: State) -> None:
    """Until there are better ones, the first weights are the best."""
    w = c.law.weights
    c.kept = Kept(Guard(c.guarding), w, w, w, recall=Recall(c.guarding))


def move_offset(c: State, law: FilteringLaw, by: float) -> None:
    """The weight of the offset moves by so much, um."""
    if c.settings.offset:
        weights = c.weights
        at = c.settings.columns["offset"]
        weights[at] = np.clip(weights[at] + by, -LARGEST, LARGEST)
        law.weights = weights


def take_weights(c: State, law: FilteringLaw, weights: FloatArray, *, earlier: bool) -> None:
    """The command goes on from where it is with other weights; earlier ones miss what has drifted since.

    The feedback waits, for its margins are those of a model that has been learned.
    """
    law.weights = weights
    if earlier:
        move_offset(c, law, law.missing())
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
    if not guard.lost or kept.staged or c.held or c.lagged.ticks < 2:
        kept.recall.ticks = 0
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
    if c.path is not None:
        stage.z, c.path, stage.found = c.path.z, None, False
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


def watch_learning(c: State, error: float, z_d: float, counts: bool) -> None:
    """One tick of the guard, and what it decides."""
    law, kept, guard = c.filtering, c.kept, c.kept.guard
    if law is None or guard.settings.window == 0 or c.held:
        return
    resting = c.stage.rest > 0 and guard.held == 0
    noise = max(kept.knowledge[1] if guard.kept else law.sigma, c.resolution)
    if c.stage.resonance > 0:  # known: what rings there is judged by its windows
        guard.swings = 0
    match guard.update(error, z_d, counts=counts and not resting, noise=noise):
        case Action.KEEP:
            weights_at_best(c, law)
        case Action.RESTORE:
            kept.aside = law.weights
            end_trial(c, law)
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
    if guard.ticks == 0 and c.is_given:
        doubt_dynamics(c, guard.error)
    if guard.held > 0 or law.caution > CAUTIOUS * (law.sigma * law.sigma):
        move_offset(c, law, guard.drift)
    if guard.held == 0 and guard.ticks == 0:
        law.caution *= 1 - 0.8 / guard.wait
    c.restored = guard.held > 0
