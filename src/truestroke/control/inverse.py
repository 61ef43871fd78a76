"""The voltage of a model with branches, sample by sample: the kernel, which inverts the others, has no such terms."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.model.branches import Branches
from truestroke.model.models import Motion, known_terms

if TYPE_CHECKING:
    from truestroke.control.actuator import ActuatorModel

STEPS = 100  # of the search at most
FLATTEST = 0.1  # of the last slope: how far the next one may be below it
CONVERGED = 1e-12  # of the stroke
WIDER = 1.25  # times the step of the last slope, so that the wanted voltage is between


class State:
    """Plays of all curves and cells and states of Duhem after the last sample, and what a voltage would make of them.

    Parameters
    ----------
    model : ActuatorModel
        With branches.
    volts : float
        Voltage under which it rests, V, reached from 0 V.
    """

    def __init__(self, model: ActuatorModel, volts: float) -> None:
        assert model.branches is not None  # the caller's branch
        b: Branches = model.branches
        self.branches, self.n, self.close = b, len(model.thresholds), CONVERGED * model.stroke
        self.r = np.concatenate([model.thresholds, *[b.thresholds] * len(b.curves), b.cell_thresholds])
        followed = [*range(1 + len(b.curves)), 0]
        self.group = np.repeat(followed, [self.n, *[b.plays] * len(b.curves), b.levels])
        self.curved, end = self.n + len(b.curves) * b.plays, len(b.names) - 2 * len(b.betas)
        weights = np.array(b.weights)
        self.w = np.concatenate([np.zeros(self.n), weights[: self.curved - self.n]])
        self.of_cells, self.of_states = weights[self.curved - self.n : end], weights[end:]
        self.beta = np.repeat(b.betas, 2) / (2 * b.half)
        self.x, self.slope = float(volts), model.sensitivity
        self.y = np.zeros(self.r.size)
        self.y = self.plays(self.x)
        self.c: FloatArray = b.states(np.array([self.x]))[0]
        self._from: dict[float, FloatArray] = {}

    def plays(self, x: float) -> FloatArray:
        """States of the plays at the voltage x, V."""
        b = self.branches
        u = np.array([x, *[b.curved(curve, x) for curve in b.curves]])[self.group]
        return np.asarray(np.maximum(u - self.r, np.minimum(u + self.r, self.y)))

    def states(self, x: float) -> FloatArray:
        """States of Duhem at the voltage x, V."""
        if not self.c.size:
            return self.c
        sign, b = -1.0 if x < self.x else 1.0, self.branches
        if sign not in self._from:
            self._from[sign] = self.c - b.settles(b.scaled(self.x), sign)
        return np.asarray(b.settles(b.scaled(x), sign) + self._from[sign] * np.exp(-self.beta * abs(x - self.x)))

    def sum(self, x: float) -> float:
        """Weighted sum at the voltage x, um."""
        y = self.plays(x)
        cells = self.of_cells @ self.branches.in_cells(y[self.curved :])
        return float(self.w @ y[: self.curved] + cells + self.of_states @ self.states(x))

    def solve(self, y_d: float, limits: tuple[float, float]) -> float:
        """The voltage whose sum is y_d, um, or the limit before it, by false position (Illinois)."""
        start = self.sum(self.x)
        at, gap = self.x, y_d - start
        if abs(gap) <= self.close:
            return at
        end = limits[1] if gap > 0 else limits[0]
        other, beyond, step = at, gap, WIDER * gap / self.slope
        while beyond * gap > 0:  # a voltage on the other side
            at, gap = other, beyond
            if at == end:
                return end
            other = min(max(at + step, limits[0]), limits[1])
            beyond, step = y_d - self.sum(other), 2 * step
        for _ in range(STEPS):
            x = at + (other - at) * gap / (gap - beyond)
            off = y_d - self.sum(x)
            if abs(off) <= self.close or x in (at, other):
                break
            if off * beyond < 0:
                at, gap = other, beyond
            else:
                gap /= 2
            other, beyond = x, off
        if x != self.x:
            self.slope = max((y_d - off - start) / (x - self.x), FLATTEST * self.slope)
        return x

    def go(self, x: float) -> None:
        """To the voltage x, V."""
        self.y, self.c, self.x = self.plays(x), self.states(x), x
        self._from = {}


def waveform(
    model: ActuatorModel,
    z_d: FloatArray,
    velocity: FloatArray,
    rest: float,
    limits: tuple[float, float],
    slew: float,
    sample_rate: float,
) -> FloatArray:
    """Voltage, V, that makes z_d, um above `zero`, from rest at a voltage; slew in V per sample.

    The terms that do not depend on the voltage of this sample are known: z_d without them is the sum of plays and
    states, which rises with the voltage.
    """
    w, state = model.weights, State(model, rest)
    a, b = model.of_all_plays(w)
    shares = -np.expm1(-1 / (np.array(model.creep_times) * sample_rate))
    creep = np.full(shares.size, rest)
    free = known_terms(model, np.zeros((shares.size, z_d.size)), Motion(z_d, velocity), model.stroke)
    left = z_d - w[model.of_plays :] @ free
    of_creep, volts = w[model.columns["creep"]], np.empty_like(z_d)
    for k, wanted in enumerate(left):
        creep += shares * (state.x - creep)
        state.w[: state.n] = a + model.rate_scale * velocity[k] * b
        low, high = max(limits[0], state.x - slew), min(limits[1], state.x + slew)
        state.go(state.solve(float(wanted - of_creep @ creep), (low, high)))
        volts[k] = state.x
    return volts
