"""What is believed of an actuator before the first measurement: from stroke and voltage limits alone.

Every number here is relative: to the quotient q = stroke / (highest - lowest voltage), um/V, which is the slope of an
actuator that needs the whole voltage range for the stroke, to the stroke, or to the voltage range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truestroke.base.typing import FloatArray

FIRST_SLOPE = 1.15  # of q: slope at first contact
HYSTERESIS = 0.5  # of q: sum of the weights of all other plays
DECAY = 0.2  # of the voltage range: they fall with the threshold as exp(-r / DECAY)
REACH = 15 / 42  # of the voltage range: thresholds end below this
GAIN_DEVIATION = 0.35  # relative: of all weights together
HYSTERESIS_DEVIATION = 0.5  # relative: of all weights but the first together
WEIGHT_DEVIATION = 0.6, 0.05  # relative, and of q: of each weight but the first by itself
FIRST_DEVIATION = 0.01  # of q: of the first weight by itself
RATE_DEVIATION = 0.1  # of q: of each rate weight
CREEP_DEVIATION = 0.03  # of q: of each creep weight
LAG, LAG_DEVIATION = -0.15e-3, 0.2e-3  # s
OFFSET_DEVIATION = 0.03  # of the stroke
ASYMMETRY_DEVIATION = 0.05  # of the stroke


def thresholds(plays: int, voltage_range: float) -> tuple[float, ...]:
    """Thresholds r, V: evenly over 0 to `REACH` of the voltage range.

    Examples
    --------
    >>> [round(r, 4) for r in thresholds(4, 4.2)]
    [0.0, 0.375, 0.75, 1.125]
    """
    return tuple(i / plays * REACH * voltage_range for i in range(plays))


def play_weights(r: Sequence[float], voltage_range: float, first: float) -> FloatArray:
    """Weights a of the plays, um/V, shape (n,): the first, and a hysteresis that falls with the threshold.

    Examples
    --------
    >>> play_weights([0.0, 0.375, 0.75, 1.125], 4.2, 8.0).round(3)
    array([8.   , 1.697, 1.086, 0.695])
    """
    r_all = np.array(r)
    a = np.full(r_all.size, first)
    if r_all.size > 1:
        widths = (
            np.append(r_all[2:], 2 * r_all[-1] - r_all[-2]) - r_all[:-1]
        ) / 2  # of the thresholds that each stands for
        density = widths * np.exp(-r_all[1:] / voltage_range / DECAY)
        total = density.sum() or 1.0  # thresholds so far out that nothing is expected of them
        a[1:] = density / total * HYSTERESIS / FIRST_SLOPE * first
    return a


def covariance(
    a: FloatArray,
    rate_dependent: Sequence[int],
    *,
    q: float,
    stroke: float,
    creeps: int,
    lag: bool,
    offset: bool,
    asymmetry: int,
) -> FloatArray:
    """Covariance P0 of the parameters, shape (m, m), in the squares of their units.

    Parameters
    ----------
    a : ndarray, shape (n,)
        Weights of the plays that are believed in, um/V.
    rate_dependent : sequence of int
        Which plays have a rate weight.
    q : float
        stroke / (highest - lowest voltage), um/V.
    stroke : float
        um
    creeps, lag, offset, asymmetry
        The terms of the model, as in `ControllerSettings`.

    Returns
    -------
    ndarray, shape (m, m)
        In the order of the parameters: [a0, b0, a1, b1, ...], creeps, lag, offset, asymmetry.

    Examples
    --------
    >>> P0 = covariance(np.array([8.0, 2.0]), (0,), q=7.0, stroke=30.0, creeps=0, lag=False, offset=True, asymmetry=0)
    >>> np.sqrt(np.diag(P0)).round(3)
    array([2.801, 0.7  , 1.973, 0.9  ])
    """
    hysteresis = np.append(0.0, a[1:])
    own = WEIGHT_DEVIATION[0] * a + WEIGHT_DEVIATION[1] * q
    own[0] = FIRST_DEVIATION * q
    of_plays = GAIN_DEVIATION**2 * np.outer(a, a) + HYSTERESIS_DEVIATION**2 * np.outer(hysteresis, hysteresis)
    of_plays += np.diag(own**2)

    place: list[int] = []  # of a_i among the parameters
    other: list[float] = []  # deviation of each b_i
    for i in range(a.size):
        place.append(len(place) + len(other))
        if i in rate_dependent:
            other.append(RATE_DEVIATION * q)
    others = np.setdiff1d(np.arange(len(place) + len(other)), place)
    terms = [CREEP_DEVIATION * q] * creeps + [LAG_DEVIATION] * lag + [OFFSET_DEVIATION * stroke] * offset
    terms += [ASYMMETRY_DEVIATION * stroke] * asymmetry
    m = len(place) + len(other) + len(terms)
    P0 = np.zeros((m, m))
    P0[np.ix_(place, place)] = of_plays
    P0[others, others] = np.square(other)
    P0[range(m - len(terms), m), range(m - len(terms), m)] = np.square(terms)
    return P0
