"""What the mean of a pass answers to that of the strain, by a secant, and how it creeps.

A loop hangs on its turn that is further from rest: the actuator has come to it by the way from rest, which is steeper
than the loop, and creep has time to follow. So with the change m of the mean of the strain and h of half its height,
the mean of the displacement changes by::

    y = r (m + side h) - side h + creep

with r of 1.05 to 1.8. The first pass shows r by its turn, seen from rest, and each further one by what it has changed.
r and the creep of a pass are estimated together, by a Kalman filter.
"""

from __future__ import annotations

import math

import numpy as np

from truestroke.base.typing import FloatArray

RATIO = 1.2, 0.2  # r before the first pass, and its standard deviation
FROM_REST = 0.12  # standard deviation of r as the first pass shows it: a pass may not begin at rest, 0 um at 0 V
WANDERS = 0.03  # the same from one pass to the next: the loop is another one
CROSSED = 0.1  # of the rms by which the motion itself has changed: the mean moves with it
JUMPS = 1e-3  # of the motion: standard deviation of what a pass creeps, beside what the last one did
NEAR = 0.6, 2.5  # an answer beyond is a jump of the zero, and no answer
LASTS = 0.8  # of the creep of a pass: that of the next one


class MeanAnswer:
    """What the mean answers.

    Parameters
    ----------
    span : float
        Of the motion, in the unit of all that follows.

    Attributes
    ----------
    ratio : float
        r as it is known.
    side : float
        Where the loop is seen from rest: 1 above it, -1 below it, between where it is around it.
    foreseen : float
        Creep until the next pass, as far as that of the pass before had the same sense.

    Examples
    --------
    >>> answer = MeanAnswer(span=20.0)
    >>> answer.begin(12.0, 10.0, 18.0)
    >>> for m, h, y in ((-4.0, 1.0, -4.9), (0.5, 0.0, 0.65)):
    ...     answer.see(m, h, y)
    >>> print(f"{answer.ratio:.2f}, for 1 um more: {answer.change(1.0, 0.0):.2f} um of strain")
    1.30, for 1 um more: 0.77 um of strain
    """

    def __init__(self, span: float) -> None:
        self.ratio, self.side, self.foreseen, self._jumps2 = RATIO[0], 0.0, 0.0, (JUMPS * span) ** 2
        self._covariance: FloatArray = np.diag([RATIO[1] ** 2, 0.0])  # of r and of the creep
        self._creep = 0.0

    @property
    def variance(self) -> float:
        """Of r."""
        return float(self._covariance[0, 0])

    def begin(self, mean: float, height: float, measured: float) -> None:
        """The first pass: mean and half height of the strain by the gain, and mean of what was measured."""
        self.side = min(max(mean / max(height, 1e-300), -1.0), 1.0)
        self._learn(mean + self.side * height, measured + self.side * height, FROM_REST**2, 0.0)

    def see(self, mean: float, height: float, measured: float, noise2: float = 0.0, moved: float = 0.0) -> None:
        """By what a pass is another one than that before, with the variance of what was measured.

        `moved` is the rms by which the motion itself has changed.
        """
        before, hidden = self._creep, math.sqrt(self._covariance[1, 1])
        self._covariance = np.diag([1.0, LASTS]) @ self._covariance @ np.diag([1.0, LASTS])
        self._covariance += np.diag([WANDERS**2, self._jumps2])
        self._creep *= LASTS
        other2 = noise2 + (CROSSED * moved) ** 2
        self._learn(mean + self.side * height, measured + self.side * height, WANDERS**2, other2)
        sense = math.copysign(1.0, self._creep)
        self.foreseen = LASTS * sense * min(abs(self._creep), max(sense * before + 2 * hidden, 0.0))

    def change(self, wanted: float, height: float) -> float:
        """Of the mean of the strain, for a change of the displacement, where half the height changes, too."""
        return (wanted + self.side * height) / self.ratio - self.side * height

    def _learn(self, x: float, y: float, relative2: float, other2: float) -> None:
        """From y = r x + creep."""
        slope = np.array([x, 1.0])
        if x == 0.0 or not NEAR[0] <= y / x <= NEAR[1]:
            slope[0] = self._covariance[0, 1] = self._covariance[1, 0] = 0.0  # it says nothing of r
        off, through = y - self.ratio * x - self._creep, self._covariance @ slope
        share = through / max(float(slope @ through) + relative2 * x * x + other2, 1e-300)
        self.ratio += share[0].item() * off
        self._creep += share[1].item() * off
        self._covariance -= np.outer(share, through)
