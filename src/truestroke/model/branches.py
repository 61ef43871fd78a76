"""Hysteresis that plays of the voltage do not have: plays of a curved voltage, cells, and states of Duhem.

With s = (2 x - low - high) / (high - low), which is -1 and 1 at the ends of the record's voltages, and half = (high -
low) / 2, there are plays H_r[half f(s)] of three curves,

    f(s) = s + 0.45 s^2,   s - 0.45 s^2,   s / sqrt(1 + 4 s^2),

each continued by straight lines beyond -1 and 1; cells of Preisach's plane,

    min(max(H_r[x], a), b) - min(max(0, a), b),

for plays of `levels` thresholds between 0 and half, the ends a and b of their cells 2 half / levels apart, so that the
slope of a play depends on where it is (a Preisach operator whose density is constant in each cell); and states that
follow the voltage with its variation, not with time,

    dc / d|x| = (p(s) - c) beta,   p(s) = half s,  half s^2 / 2.

A loop between unlike envelopes is made by differences of the plays of the first two curves, one that saturates at
both ends by those of the third. Any loops that wipe out and close are sums of cells, if these are small enough.
The states of Duhem make minor loops that do not close, as those of Bouc-Wen, Dahl, Coleman and Hodgdon.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from truestroke import _kernel
from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.model.operators import dot

ROWS = 2048  # of all terms that are summed at once: what the cache of a processor holds

CURVES: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "convex": (lambda s: s + 0.45 * s * s, lambda s: 1 + 0.9 * s),
    "concave": (lambda s: s - 0.45 * s * s, lambda s: 1 - 0.9 * s),
    "sigmoid": (lambda s: s / (1 + 4 * s * s) ** 0.5, lambda s: 1 / ((1 + 4 * s * s) * (1 + 4 * s * s) ** 0.5)),
}
"""Curves f of s by name, each with its derivative, of numbers and arrays; both are taken within -1 to 1."""


@dataclass(frozen=True, kw_only=True)
class Branches:
    """Plays of curved voltages, cells of Preisach's plane and states of Duhem, with their weights.

    Attributes
    ----------
    voltage_range : tuple[float, float]
        low and high, V.
    curves : tuple[str, ...]
        Names in `CURVES`.
    plays : int
        Of each curve: their thresholds are i / plays of half the voltage range.
    levels : int
        Of the cells: their thresholds are i / levels of half the voltage range, and that of number i has levels - i.
    betas : tuple[float, ...]
        beta times the voltage range; for each a state of s and one of s^2.
    weights : tuple[float, ...]
        Of the plays of each curve, then of the cells, then of the states, um/V; empty for 0.

    Examples
    --------
    >>> b = Branches(voltage_range=(0.0, 2.0), betas=(4.0,))
    >>> b.names, b.columns(np.array([0.0, 2.0, 0.0])).round(3).tolist()
    (('duhem 4', 'duhem 4 of s^2'), [[-1.0, 0.5], [0.509, 0.236], [-0.518, 0.231]])
    """

    voltage_range: tuple[float, float]
    curves: tuple[str, ...] = ()
    plays: int = 0
    levels: int = 0
    betas: tuple[float, ...] = ()
    weights: tuple[float, ...] = field(default=())

    def __post_init__(self) -> None:
        for curve in self.curves:
            if curve not in CURVES:
                raise SettingError("curves", curve, f"one of {', '.join(CURVES)}")
        low, high = checks.interval("voltage_range", self.voltage_range, "V")
        made: dict[str, object] = {
            "voltage_range": (low, high),
            "curves": tuple(self.curves),
            "plays": checks.count("plays", self.plays, 0, 64),
            "levels": checks.count("levels", self.levels, 0, 64),
            "betas": tuple(checks.positive("betas", beta) for beta in self.betas),
            "weights": tuple(checks.finite_array("weights", self.weights, "um/V").tolist()),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)
        if len(self.weights) not in (0, len(self.names)):
            raise SettingError("weights", f"{len(self.weights)} numbers", f"{len(self.names)}, as there are terms")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the weights, in their order."""
        plays = [f"{curve} a{i}" for curve in self.curves for i in range(self.plays)]
        cells = [f"cell a{i} {j}" for i in range(self.levels) for j in range(self.levels - i)]
        return (*plays, *cells, *[f"duhem {beta:g}{of}" for beta in self.betas for of in ("", " of s^2")])

    @property
    def described(self) -> str:
        """In words."""
        curved = [f"{self.plays} plays of a {curve} voltage" for curve in self.curves]
        cells = [f"{self.levels} levels of cells of Preisach's plane"] * bool(self.levels)
        return ", ".join([*curved, *cells, *[f"states of Duhem, beta {self.betas}"] * bool(self.betas)])

    @property
    def half(self) -> float:
        """Half of the voltage range, V."""
        return (self.voltage_range[1] - self.voltage_range[0]) / 2

    @property
    def thresholds(self) -> FloatArray:
        """r of the plays of each curve, V."""
        return np.arange(self.plays) / max(self.plays, 1) * self.half

    def scaled(self, x: Any) -> Any:
        """s of x, V: a number or an array."""
        return (x - self.voltage_range[0]) / self.half - 1

    @cached_property
    def at_zero(self) -> dict[str, float]:
        """What the curves are at 0 V by their names, V."""
        return {curve: self._continued(curve, self.scaled(0.0)) for curve in self.curves}

    def _continued(self, curve: str, s: Any) -> Any:
        """half f(s), V, beyond -1 and 1 a straight line."""
        f, slope = CURVES[curve]
        inside = _inside(s)
        return self.half * (f(inside) + slope(inside) * (s - inside))

    def curved(self, curve: str, x: Any) -> Any:
        """half (f(s) - f(s of 0 V)), V: what the plays follow, 0 at 0 V, at which they rest."""
        return self._continued(curve, self.scaled(x)) - self.at_zero[curve]

    def curved_slope(self, curve: str, x: FloatArray) -> FloatArray:
        """Its derivative by x."""
        return np.asarray(CURVES[curve][1](_inside(self.scaled(x))))

    def columns(self, x: FloatArray, every: int = 1) -> FloatArray:
        """The terms along a voltage, V, of every `every`-th sample, shape (rows, terms); from rest at 0 V."""
        return np.hstack([*self.parts(x, every)])

    def parts(self, x: FloatArray, every: int = 1) -> Iterator[FloatArray]:
        """The same in parts: of each curve, of the cells of each play, and of the states."""
        yield from self._parts(*self._moved(x, every))

    def sum(self, x: FloatArray) -> FloatArray:
        """All terms with their weights along a voltage, um."""
        if not self.weights or not x.size:
            return np.zeros_like(x)
        plays, y, states = self._moved(x, 1)
        w = np.array(self.weights)
        ends = np.cumsum([self.plays * len(self.curves), self.cells[0].size])
        of_plays, of_cells, of_states = np.split(w, ends)
        others, blocks = np.append(of_plays, of_states), [slice(k, k + ROWS) for k in range(0, x.size, ROWS)]
        terms = (np.hstack([*(a[rows] for a in plays), states[rows]]) for rows in blocks)
        total = np.concatenate([dot(part, others) for part in terms])
        for i in range(self.levels):
            total += self._of_cells(i, np.ascontiguousarray(y[:, i]), of_cells[self.cells[0] == i])
        return total

    def _of_cells(self, i: int, y: FloatArray, w: FloatArray) -> FloatArray:
        """The cells of one play with their weights, um: a polygon with a corner at each of their ends."""
        _, low, high = (of[self.cells[0] == i] for of in self.cells)
        ends = float(min(y.min(), low[1:].min(initial=0.0))), float(max(y.max(), high[:-1].max(initial=0.0)))
        corners = np.concatenate([[ends[0] - self.half], low[1:], [ends[1] + self.half]])
        return np.asarray(np.interp(y, corners, dot(self._ways(corners[:, None], low, high), w)))

    def _moved(self, x: FloatArray, every: int) -> tuple[list[FloatArray], FloatArray, FloatArray]:
        """Plays of each curve, plays of the cells, and states of Duhem of every `every`-th sample."""
        plays = [self._plays(curve, x, every) for curve in self.curves]
        return plays, self._cell_plays(x, every), self.states(x, every)

    def _parts(self, plays: Sequence[FloatArray], y: FloatArray, states: FloatArray) -> Iterator[FloatArray]:
        yield from plays
        play, low, high = self.cells
        for i in range(self.levels):
            yield self._ways(y[:, i : i + 1], low[play == i], high[play == i])
        yield states

    def _plays(self, curve: str, x: FloatArray, every: int) -> FloatArray:
        rows = np.empty((-(-x.size // every), self.plays))
        _kernel.play_history(self.curved(curve, x), self.thresholds, np.zeros(self.plays), every, rows)
        return rows

    # ---- Cells of Preisach's plane ---------------------------------------------------------------------------------

    @cached_property
    def cells(self) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """The play of each cell, and its lower and upper end, V; the first and the last cell of a play have no end."""
        n, width = self.levels, 2 * self.half / max(self.levels, 1)
        play = np.repeat(np.arange(n), n - np.arange(n))
        place = np.array([j for i in range(n) for j in range(n - i)], dtype=np.float64)
        first = self.voltage_range[0] + play * width / 2 + place * width
        return play, np.where(place == 0, -np.inf, first), np.where(place == n - play - 1, np.inf, first + width)

    @cached_property
    def cell_thresholds(self) -> FloatArray:
        """r of the plays of the cells, V."""
        return np.arange(self.levels) / max(self.levels, 1) * self.half

    def in_cells(self, y: FloatArray) -> FloatArray:
        """Ways of play states, shape (..., levels), from 0 V within each cell, V, shape (..., cells)."""
        play, low, high = self.cells
        return self._ways(y[..., play], low, high)

    @staticmethod
    def _ways(y: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
        return np.asarray(np.clip(y, low, high) - np.clip(0.0, low, high))

    def _cell_plays(self, x: FloatArray, every: int) -> FloatArray:
        rows = np.empty((-(-x.size // every), self.levels))
        _kernel.play_history(np.ascontiguousarray(x), self.cell_thresholds, np.zeros(self.levels), every, rows)
        return rows

    # ---- States of Duhem -------------------------------------------------------------------------------------------

    @cached_property
    def _lengths(self) -> FloatArray:
        """1 / beta in units of s."""
        return 2 / np.array(self.betas)

    def settles(self, s: Any, sign: Any) -> FloatArray:
        """What the states approach on a way up (sign 1) or down (-1), V, shape (..., states).

        Straight lines between samples: c = P(s) + (c0 - P(s0)) exp(-beta |dx|), P the particular solution. So the
        states do not depend on how densely a way is sampled.
        """
        lag, s = np.multiply.outer(sign, self._lengths), np.asarray(s)[..., None]
        made = np.empty((*lag.shape[:-1], 2 * lag.shape[-1]))
        made[..., ::2], made[..., 1::2] = s - lag, 0.5 * s * s - (s - lag) * lag
        made *= self.half
        return made

    def states(self, x: FloatArray, every: int = 1) -> FloatArray:
        """The states along a voltage, V, of every `every`-th sample, shape (rows, states); they rest at 0 V before it.

        Natively, as `settles` says of each way.
        """
        rows = np.empty((-(-x.size // every), 2 * len(self.betas)))
        s = self.scaled(np.concatenate([np.zeros(1), x]))
        _kernel.duhem_states(s, np.array(self.betas) / 2, self.half, every, rows)
        return rows

    # ---- Slopes ----------------------------------------------------------------------------------------------------

    def slopes(self, x: FloatArray, sign: int) -> FloatArray:
        """Derivatives of the terms by x where the voltage goes on up (sign 1) or down (-1), shape (samples, terms)."""
        parts = []
        for curve in self.curves:
            u, r = self.curved(curve, x)[:, None], self.thresholds
            moves = sign * (u - self._plays(curve, x, 1)) >= r - 1e-9 * self.half
            parts.append(moves * self.curved_slope(curve, x)[:, None])
        parts.append(self._cell_slopes(x, sign))
        s = self.scaled(x)
        p = self.half * np.stack([s, 0.5 * s**2], axis=-1)
        beta = np.repeat(self.betas, 2) / (2 * self.half)
        parts.append(sign * beta * (np.tile(p, len(self.betas)) - self.states(x)))
        return np.hstack(parts)

    def _cell_slopes(self, x: FloatArray, sign: int) -> FloatArray:
        """1 for the cell in which each play that moves goes on, else 0."""
        play, low, high = self.cells
        y, next_to = self._cell_plays(x, 1), 1e-9 * self.half
        moves = sign * (x[:, None] - y) >= self.cell_thresholds - next_to
        ahead = y[:, play] + sign * next_to
        return np.asarray((moves[:, play] & (ahead >= low) & (ahead < high)).astype(np.float64))


def _inside(s: Any) -> Any:
    """s within -1 to 1."""
    return min(max(s, -1.0), 1.0) if isinstance(s, float) else np.clip(s, -1.0, 1.0)
