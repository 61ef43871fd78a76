"""What is known of the ratio R of a true response to a given one, before and after passes have shown some of it.

A stage differs from its model by few numbers: gain g, dead time d, f0 and damping of the first mode M(s). With them::

    R(s) = exp(g - s d) / (1 + a M(s) s^2 / w^2 + b M(s) 2 zeta s / w)

is exact for one mode, as 1 / M is linear in 1 / w^2 and 2 zeta / w. What a pass shows at one harmonic is then known at
all others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.repeating.steps import Steps
from truestroke.model.dynamics import Dynamics

UNSURE = 25.0  # variance of R at most: its sign is not known then
GAIN = 0.15  # relative standard deviation of the gain, of which a part is another one at each harmonic: hysteresis
APART = 0.1  # that part at the first resonance; it grows with f^2, for further modes
DAMPING = 0.3  # the same of a damping that was measured, beside its own deviation
FREQUENCY = 0.02  # the same of a resonance: it moves with load and temperature
LATE = 0.7  # ticks: standard deviation of the dead time
LARGEST = 0.5  # step of a number at a time, standard deviations before the first pass
ROUNDS = 5  # such steps, in which what a batch shows is understood


class Prior(Protocol):
    """What is known of R without the passes, at each harmonic."""

    def giving(self, weighted: ComplexArray, information: FloatArray) -> Steps[tuple[ComplexArray, FloatArray]]:
        """Mean and variance of R, as what passes show of all harmonics together makes them, in steps.

        The passes show weighted / information, with a variance of 1 / information. Another call comes nearer.
        """


@dataclass(frozen=True, eq=False)
class Independent:
    """Each harmonic by itself: R is 1 with these variances."""

    variance: FloatArray

    def giving(self, weighted: ComplexArray, information: FloatArray) -> Steps[tuple[ComplexArray, FloatArray]]:
        """As of `Prior`; what the passes show of other harmonics does not matter."""
        yield
        return np.ones_like(weighted), self.variance


def beside(f: FloatArray, first: float, band: float, growing: float = APART) -> FloatArray:
    """Variance of R at each harmonic by itself, up to `band`, Hz; it grows with f^2, by `growing` at `first`, Hz."""
    apart = np.maximum(APART, growing * (f / first) ** 2)
    return np.where(f > band, UNSURE, np.minimum(apart**2, UNSURE))


class FewNumbers:
    """Gain, dead time, and f0 and damping of the first mode, which all harmonics share.

    Parameters
    ----------
    dynamics : Dynamics or None
        Of the stage; None: it is taken for a spring.
    f : ndarray
        Of the harmonics, Hz.
    sample_rate : float
        Hz
    variance : ndarray
        Of R at each harmonic by itself, beside them.

    Attributes
    ----------
    deviations : ndarray
        Standard deviations of the numbers before the first pass, that of the gain first.
    """

    def __init__(self, dynamics: Dynamics | None, f: FloatArray, sample_rate: float, variance: FloatArray) -> None:
        s = 2j * math.pi * f
        above, below, deviations = [np.ones_like(s), -s / sample_rate], [np.zeros_like(s)] * 2, [GAIN, LATE]
        if dynamics is not None:
            mode, own = dynamics.modes[0], dynamics.uncertainty.get("frequency[0]", 0.0)
            w, response = 2 * math.pi * mode.frequency, mode.response(s) / mode.share
            above += [np.zeros_like(s)] * 2
            below += [response * s**2 / w**2, response * 2 * mode.damping * s / w]
            deviations += [2 * math.hypot(FREQUENCY, own / mode.frequency), DAMPING]
        self._above, self._below, self.deviations = np.array(above), np.array(below), np.array(deviations)
        self.variance, self._prior = variance, np.diag(self.deviations**-2.0)
        self._found = np.zeros(self.deviations.size)

    def giving(self, weighted: ComplexArray, information: FloatArray) -> Steps[tuple[ComplexArray, FloatArray]]:
        """As of `Prior`, by least squares: a step of Gauss and Newton in each call."""
        found, weight = self._found, information / (1 + self.variance * information)
        shown = weighted / np.maximum(information, 1e-300)
        yield
        R, slopes = yield from self.ratio(found)
        yield
        of_slopes = slopes.conj() * weight
        yield
        inverse = np.linalg.inv((of_slopes @ slopes.T).real + self._prior)
        yield
        step = inverse @ ((of_slopes @ (shown - R)).real - self._prior @ found)
        largest = float(np.abs(step / self.deviations).max())
        self._found = found + step * min(1.0, LARGEST / max(largest, 1e-300))
        yield
        R, slopes = yield from self.ratio(self._found)
        yield
        shared = np.sum((inverse @ slopes) * slopes.conj(), axis=0).real
        yield
        return R, np.minimum(self.variance * np.maximum(np.abs(R) ** 2, 1.0) + shared, UNSURE)

    def ratio(self, numbers: FloatArray) -> Steps[tuple[ComplexArray, ComplexArray]]:
        """R, and its slopes by the numbers."""
        under = 1 + numbers @ self._below
        R = np.asarray(np.exp(numbers @ self._above) / under, dtype=np.complex128)
        yield
        return R, np.asarray(R * (self._above - self._below / under), dtype=np.complex128)
