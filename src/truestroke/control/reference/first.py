"""The first weights, until others are good: the gain that was measured, and the least slope."""

import numpy as np

from truestroke.control.reference.state import State

NO_LESS = 0.5  # of the least first slope: a smaller one is none of the actuator, while the motion grows


def is_identified(c: State) -> bool:
    """Whether the law begins with an identified model, whose lag is that of the stage, too.

    Terms beside plays and lag then have weights.
    """
    weights = np.array(c.settings.initial_weights)
    weights[c.settings.columns["lag"]] = 0.0
    return bool(np.any(weights[c.settings.columns["creep"].start :]))


def shows_gain(c: State) -> bool:
    """Whether measurements have shown the gain of the first weights: until others are kept."""
    return not c.kept.guard.was_good and c.kept.gain.shown and not is_identified(c)


def least_slope(c: State, zdot_d: float) -> float:
    """The least partial slope at this rate, um/V; 0: any may be.

    Until weights were good, in a motion that grows, ringing looks like a slope that is too small. None is far below the
    least of the first weights, with the gain that was shown.
    """
    guard = c.kept.guard
    if guard.settings.window == 0 or guard.grown or guard.was_good:
        return 0.0
    gain = c.kept.gain.ratio if shows_gain(c) else 1.0
    a, b = c.settings.of_all_plays(c.kept.first)
    least = (a + c.settings.rate_scale * zdot_d * b).cumsum().min()
    return float(NO_LESS * least * min(gain, 1.0))
