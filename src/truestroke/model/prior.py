"""What is expected of an actuator before the first measurement: from stroke and voltage limits alone.

Every number here is relative: to the quotient q = stroke / (highest - lowest voltage), um/V, which is the slope of an
actuator that needs the whole voltage range for the stroke, to the stroke, or to the voltage range. Those of the known
terms are in `layout.TERMS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.model.layout import TERMS, Layout, Term

FIRST_SLOPE = 1.15  # of q: slope at first contact
HYSTERESIS = 0.5  # of q: sum of the weights of all other plays
DECAY = 0.2  # of the voltage range: they fall with the threshold as exp(-r / DECAY)
REACH = 15 / 42  # of the voltage range: thresholds end below this
EVEN = 8  # of them are even: those of the paper
NEAR, FAR = 0.4, 3.0  # of their distance: nearer than the one and beyond the other, thresholds are even again
GAIN_DEVIATION = 0.35  # relative: of all weights together
HYSTERESIS_DEVIATION = 0.5  # relative: of all weights but the first together
WEIGHT_DEVIATION = 0.6, 0.05  # relative, and of q: of each weight but the first by itself
FIRST_DEVIATION = 0.01  # of q: of the first weight by itself
RATE_DEVIATION = 0.1, 0.2  # of q: of each rate weight but the second, which is largest in the published ones; of that


def thresholds(plays: int, voltage_range: float) -> tuple[float, ...]:
    """Thresholds r, V: over 0 to `REACH` of the voltage range, the denser the nearer to 0.

    The first `EVEN` are even, as in the paper. Each further one halves the interval that is the widest beside its
    distance from 0, so that the loop of an actuator that needs a fifth of the voltage range still has some.

    Examples
    --------
    >>> [round(r, 4) for r in thresholds(4, 4.2)]
    [0.0, 0.375, 0.75, 1.125]
    >>> [round(r, 4) for r in thresholds(12, 4.2)]
    [0.0, 0.0234, 0.0469, 0.0938, 0.1875, 0.2812, 0.375, 0.5625, 0.75, 0.9375, 1.125, 1.3125]
    """
    return tuple((_even_and_halved(plays) / min(plays, EVEN) * REACH * voltage_range).tolist())


@lru_cache(maxsize=64)
def _even_and_halved(plays: int) -> FloatArray:
    """In units of the distance of the even ones."""
    even = min(plays, EVEN)
    r = np.arange(even, dtype=float)
    while r.size < plays:
        widths = np.diff(r, append=even)
        widest = int(np.argmax(widths / (np.minimum(r, FAR) + NEAR)))
        r = np.insert(r, widest + 1, r[widest] + widths[widest] / 2)
    r.flags.writeable = False
    return r


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
        ) / 2  # of the range of thresholds of each
        density = widths * np.exp(-r_all[1:] / voltage_range / DECAY)
        total = density.sum() or 1.0  # thresholds so far out that nothing is expected of them
        a[1:] = density / total * HYSTERESIS / FIRST_SLOPE * first
    return a


def mean(layout: Layout, a: FloatArray, terms: Mapping[str, Term] = TERMS) -> FloatArray:
    """Expected weights, shape (m,): `a` of the plays, no rate weights, and those of the known terms."""
    return layout.vector(a, **{name: term.mean for name, term in terms.items()})


def covariance(
    layout: Layout, a: FloatArray, *, q: float, stroke: float, terms: Mapping[str, Term] = TERMS
) -> FloatArray:
    """Covariance P0 of the weights, shape (m, m), in the squares of their units.

    Parameters
    ----------
    layout : Layout
        Which terms the model has.
    a : ndarray, shape (n,)
        Expected weights of the plays, um/V.
    q : float
        stroke / (highest - lowest voltage), um/V.
    stroke : float
        um
    terms : mapping of str to Term
        What is expected of the known terms.

    Returns
    -------
    ndarray, shape (m, m)
        In the order of the weights.

    Examples
    --------
    >>> layout = Layout(thresholds=(0.0, 0.4), rate_dependent=(0,), lag=False)
    >>> P0 = covariance(layout, np.array([8.0, 2.0]), q=7.0, stroke=30.0)
    >>> np.sqrt(np.diag(P0)).round(3)
    array([2.801, 0.7  , 1.973, 0.9  ])
    """
    hysteresis = np.append(0.0, a[1:])
    own = WEIGHT_DEVIATION[0] * a + WEIGHT_DEVIATION[1] * q
    own[0] = FIRST_DEVIATION * q
    of_plays = GAIN_DEVIATION**2 * np.outer(a, a) + HYSTERESIS_DEVIATION**2 * np.outer(hysteresis, hysteresis)
    scale = {"um/V": q, "um": stroke}
    known = {name: term.deviation * scale.get(term.unit, 1.0) for name, term in terms.items()}
    rates = np.where(np.arange(len(layout.rate_dependent)) == 1, RATE_DEVIATION[1], RATE_DEVIATION[0])
    P0 = np.diag(np.square(layout.vector(0.0, rates * q, **known)))
    P0[np.ix_(layout.a, layout.a)] = of_plays + np.diag(own**2)
    return P0
