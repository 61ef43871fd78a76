"""Self-excited oscillation: seen, its frequency measured, ended."""

import math
from collections.abc import Sequence
from itertools import pairwise

from truestroke.control.adaptation import FilteringLaw
from truestroke.control.reference.command import keep_command, rate_dependent_slopes, sum_of_plays
from truestroke.control.reference.first import shows_gain
from truestroke.control.reference.found import (
    adopt_resonance,
    adopt_stage,
    begin_anew,
    forget_stage,
    take_first,
)
from truestroke.control.reference.hum import LOUD_LINE, begins, is_hum, lines_of, size_of_line
from truestroke.control.reference.state import State
from truestroke.control.tone import OF_LOAD

BEGUN = 0.6  # of the motion so far: an oscillation so large, of two half-waves, begins to burst,
BEYOND = 2  # and times that one of which a half-wave is enough
LOWER = 0.7  # factor of the filter's corner where it was not low enough
NOT_BELOW = 0.2  # of the known resonance: a slower error is that of the motion
REST_PERIODS = 6  # of the oscillation: longest pause of adaptation,
REST_HALF_WAVES = 7  # and half-waves of the ringing after which it continues
KEEP = 0.03  # s: how often the weights are kept
FREE = 6  # half-waves of the ringing while weights are held, which show the resonance,
DECAYED = 0.98  # of the first of them: the last one is smaller, or something drives it,
LOUDER = 2  # times a load: a half-wave of an oscillation beside it
UNEVEN = 2  # times as large as one beside it: the half-wave is not that of a ringing


def retreat(c: State, law: FilteringLaw, frequency: float) -> None:
    """The first time: earlier weights, the covariance of the prior; then a pause, with a lower filter."""
    stage = c.stage
    if not stage.detector.found:
        if shows_gain(c):
            take_first(c, law)
        else:
            law.weights = stage.older
        stage.newer = stage.older = law.weights
        stage.age = 0.0
        law.reset_covariance()
    adopt_resonance(c, law, frequency, LOWER * law.filter if stage.detector.found else 1.0)
    keep_command(c)
    stage.rest, stage.since = 1 + REST_PERIODS / frequency, c.counters["commands"]
    stage.detector.regular, stage.detector.found = 0, True
    c.count(oscillating=True)


def learn_gain(c: State, law: FilteringLaw, zdot_d: float) -> None:
    """While the law rests before anything was good; what it changes of the command decays, as what went before."""
    c.slopes, _ = rate_dependent_slopes(c, zdot_d)
    before = sum_of_plays(c)
    take_first(c, law, gain_only=True)
    c.slopes, _ = rate_dependent_slopes(c, zdot_d)
    c.bumpless += sum_of_plays(c) - before


def watch_burst(c: State, law: FilteringLaw, error: float) -> None:
    """Before anything was good, an error of half of the motion so far is an oscillation from two half-waves on.

    One twice as large is one from the first.
    """
    stage, detector, guard = c.stage, c.stage.detector, c.kept.guard
    known = detector.found or guard.was_good or guard.held > 0 or stage.rest > 0 or stage.resonance > 0
    n = min(detector.regular, 2)
    least = max((BEYOND if n < 2 else 1) * (BEGUN * guard.range), c.oscillation.large)
    if known or n < 1 or not abs(error) > least:
        return
    frequency = detector.frequency(n)
    if detector.is_fast(frequency):
        retreat(c, law, frequency)


def noise_of(c: State, law: FilteringLaw) -> float:
    """Standard deviation of a measurement, um: as it is now, and no less than the sensor's steps."""
    return max(math.sqrt(max(law.sigma * law.sigma, 0.5 * law.ringing)), c.resolution)


def know_resonance(c: State, law: FilteringLaw, frequency: float) -> None:
    """It is measured, in cycles per tick: then the stage is known.

    Not where that failed, the sensor is late, or its measurements are older than the strains that were kept.
    """
    adopt_resonance(c, law, frequency, law.filter if c.counters["oscillating"] > 1 else 1.0)
    kept = c.lagged.ticks >= c.stage.since + 4
    if kept and not (c.stage.failed or c.sensor.late):
        if not c.kept.guard.kept:
            begin_anew(c, law)
        adopt_stage(c, law, frequency, c.stage.detector.peaks[0])


def decays(peaks: Sequence[float]) -> bool:
    """Whether the last half-waves, the newest first, are those of a ringing that decays.

    The last one is smaller than the first, and none is twice as large as the one beside it. Those of hum may be, on the
    error of the motion.
    """
    even = all(a < UNEVEN * b and b < UNEVEN * a for a, b in pairwise(peaks[:FREE]))
    return even and peaks[0] < DECAYED * peaks[FREE - 1]


def rings_freely(c: State) -> bool:
    """Whether weights are held and the stage rings by itself, faster than the motion: that shows its resonance."""
    detector, late = c.stage.detector, c.sensor.late or c.members["resonance"] > 0
    ended = detector.length == 0 and detector.regular >= FREE
    if c.kept.guard.held == 0 or c.stage.failed or late or not ended or c.lagged.ticks < 8:
        return False
    if not decays(detector.peaks):
        return False
    return detector.peaks[0] > c.oscillation.floor and detector.is_fast(detector.frequency(FREE))


def count_ringing(c: State, law: FilteringLaw) -> None:
    """Ringing at the resonance counts as noise: once in a half-wave."""
    f, detector = c.stage.resonance, c.stage.detector
    if not f > 0 or detector.length != 0:
        return
    ratio = detector.frequency(2) / f if detector.regular >= 2 else 0.0
    if not 0.7 <= ratio <= 1.4:
        law.disturbance /= 2
        return
    law.disturbance = law.noise_of_sine(detector.peaks[0], f)


def is_load(c: State, frequency: float) -> bool:
    """Whether an oscillation of this frequency, cycles per tick, is hum, or the load that was seen."""
    seen = c.estimator
    if is_hum(c, frequency, c.stage.detector.peaks[0]):
        return True
    if not (seen.load > 0 and c.stage.detector.peaks[0] < LOUDER * seen.load):
        return False
    return abs(frequency / seen.load_at - 1) < OF_LOAD


def forget_hum(c: State) -> None:
    """When the amplitudes are known: what was taken for the stage before is forgotten where it is the loudest line."""
    given = c.members["resonance"] > 0 or c.members["dynamics.known"]
    if not lines_of(c) or given or not c.stage.resonance > 0 or begins(c) or not begins(c, 1):
        return
    most = LOUD_LINE * c.settings.stroke
    most = max(most, *(size_of_line(c, i) for i, _ in enumerate(lines_of(c))))
    if is_hum(c, c.stage.resonance, most):
        forget_stage(c)
        keep_command(c)


def watch_stage(c: State, error: float, zdot_d: float, limited: bool) -> None:
    """One tick of the detection of a self-excited oscillation, and the reaction to it."""
    law, stage, detector = c.filtering, c.stage, c.stage.detector
    if law is None or not c.oscillation.tick > 0:
        return
    found = detector.update(error, zdot_d, noise_of(c, law), learned=c.kept.guard.was_good)
    if limited:  # before anything was good, only a voltage at its limit is one
        detector.sign = detector.regular = 0  # the law does not cause the error there
    count_ringing(c, law)
    if (c.kept.guard.held > 0 or stage.rest > 0) and shows_gain(c):
        learn_gain(c, law, zdot_d)
    if rings_freely(c):
        stage.resonance, stage.rest, c.oscillating = detector.frequency(FREE), 0.0, False
        c.estimator.look(stage.resonance)
        begin_anew(c, law)
        adopt_stage(c, law, stage.resonance, detector.peaks[0])
        return
    if stage.rest > 0:
        stage.rest = 0.0 if detector.regular >= REST_HALF_WAVES or stage.rest < 1 else stage.rest - 1
        if not stage.rest > 0 and detector.regular >= 4:
            frequency = detector.frequency(4 if detector.regular < 6 else 6)
            if detector.is_fast(frequency):
                know_resonance(c, law, frequency)
    elif (
        found > 0
        and c.kept.guard.held == 0
        and not (detector.found and c.measures_inertia)
        and not limited
        and found > NOT_BELOW * stage.resonance
        and not c.held
        and not is_load(c, found)
    ):
        retreat(c, law, found)
    else:
        stage.age += c.oscillation.tick
        if stage.age > KEEP and detector.regular < 3:
            stage.older, stage.newer, stage.age = stage.newer, law.weights, 0.0
    c.oscillating = stage.rest > 0
