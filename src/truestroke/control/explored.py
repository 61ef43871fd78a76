"""Where the record of a model has been: the error of a prediction grows with the distance of a motion from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truestroke import _kernel
from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray

PLAYS = (0.05, 0.15, 0.3)  # of the voltage range: plays that stand for the turns before
OF_VELOCITY = 0.1  # the coordinate of motion as fast as the fastest of the record
PLACES = 300  # at most, of a record
ROWS = 2000  # of which they are taken, at most
EDGE = 0.01  # of the voltage range: so far from its ends the places may be
DIGIT = 3  # decimals of a coordinate, 0.1 % of the voltage range


@dataclass(frozen=True, eq=False)
class Explored:
    """Places of a record's motion, and how the error grows with the distance from the nearest of them.

    Attributes
    ----------
    places : ndarray, shape (n, 5)
        Voltage, voltage beyond three plays, all over the voltage range, and velocity over ten times the fastest of the
        record: see `places`.
    growth : float
        Standard deviation of the error for a unit of the distance, um.
    inner : float
        Of a record whose loops are of one family: the standard deviation of the error inside of the largest loop, over
        the height of that loop at the voltage, 0 to 1; 0 where the record has inner loops of several kinds.

    Raises
    ------
    SettingError
        An entry is out of bounds.
    """

    places: FloatArray
    growth: float
    inner: float = 0.0

    def __post_init__(self) -> None:
        places = checks.finite_array("explored.places", self.places, ndim=2)
        if not len(places) or places.shape[1] != len(PLAYS) + 2:
            raise SettingError("explored.places", f"array of shape {places.shape}", f"of shape (n, {len(PLAYS) + 2})")
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "growth", checks.within("explored.growth", self.growth, 0.0, 1e9, "um"))
        object.__setattr__(self, "inner", checks.within("explored.inner", self.inner, 0.0, 1.0))

    def distance(self, at: FloatArray) -> FloatArray:
        """Of places, shape (samples, 5), from the nearest of the record, shape (samples,)."""
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(self.places).query(at)[0], dtype=np.float64)

    def beyond(self, x: FloatArray) -> FloatArray:
        """How far a voltage over the range of the record's, shape (samples,), is outside of that; else 0."""
        low, high = float(self.places[:, 0].min()), float(self.places[:, 0].max())
        return np.asarray(np.maximum(np.maximum(x - high, low - x) - EDGE, 0.0))


def places(
    volts: FloatArray, velocity: FloatArray, voltage_range: tuple[float, float], fastest: float, every: int = 1
) -> FloatArray:
    """Where a motion is, shape (samples / every, 5), without unit.

    The voltage x, its distances x - H_r[x] from three plays, all over the voltage range; and the velocity over ten
    times the `fastest`. Two motions that are near each other in all of them have the same recent turns.

    Parameters
    ----------
    volts : ndarray, shape (samples,)
        V.
    velocity : ndarray, shape (samples,)
        um/s.
    voltage_range : tuple[float, float]
        Of the record, V.
    fastest : float
        Of the record, um/s.
    every : int
        Of how many samples one is taken.

    Examples
    --------
    >>> places(np.array([0.0, 1.0, 2.0]), np.array([0.0, 5.0, 10.0]), (0.0, 2.0), 10.0).round(2)
    array([[0.  , 0.  , 0.  , 0.  , 0.  ],
           [0.5 , 0.05, 0.15, 0.3 , 0.05],
           [1.  , 0.05, 0.15, 0.3 , 0.1 ]])
    """
    span = voltage_range[1] - voltage_range[0]
    held, x = np.empty((-(-volts.size // every), len(PLAYS))), volts[::every, None]
    _kernel.play_history(np.ascontiguousarray(volts), span * np.array(PLAYS), np.zeros(len(PLAYS)), every, held)
    rate = velocity[::every, None] / fastest if fastest else np.zeros_like(x)
    return np.hstack([x / span, (x - held) / span, OF_VELOCITY * rate])


def spread(rows: FloatArray) -> FloatArray:
    """At most `PLACES` of the rows, each the one farthest from those before it, rounded; shape (n, 5).

    The first two are those of the least and the largest voltage.
    """
    few = np.unique(rows[:: -(-len(rows) // ROWS)].round(DIGIT), axis=0)
    if len(few) <= PLACES:
        return np.asarray(few)
    chosen = np.empty(PLACES, np.int64)
    _kernel.farthest(np.ascontiguousarray(few.T), chosen)
    return np.asarray(few[np.sort(chosen)])
