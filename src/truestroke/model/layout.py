"""The layout of the weights: to which term each one belongs, its name, its unit, and what is expected of it.

The weights are [a0, b0, a1, b1, ...] of the plays, as in (21), then those of the terms that are known before the
voltage is chosen, in the order of `TERMS`. Such a term has a member of `Layout`, a row of `TERMS` and of
`SETTINGS`, and a line in `models.known_terms` and in `known_terms` of c/src/terms.c.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, declared
from truestroke.base.declared import Setting
from truestroke.base.typing import FloatArray

MAX_PLAYS = 32
MAX_CREEPS = 8
MAX_ASYMMETRY = 2
MAX_DUHEM = 4
MAX_OTHERS = 2

Places = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Term:
    """A term that is known before the voltage is chosen.

    Attributes
    ----------
    setting : str
        Member of `Layout` that says how many weights it has: a flag, a number, or a time constant for each.
    unit : str
        Of its weights: "um/V", "um", or one that does not scale with the actuator, such as "s".
    most : int
        Number of its weights at most.
    deviation : float
        Standard deviation of a weight before the first measurement: relative to stroke / voltage range where the unit
        is um/V, to the stroke where it is um, else in the unit.
    mean : float
        Of a weight before the first measurement, in its unit.
    """

    setting: str
    unit: str
    most: int
    deviation: float
    mean: float = 0.0


TERMS = {
    "creep": Term("creep_times", "um/V", MAX_CREEPS, deviation=0.03),
    "lag": Term("lag", "s", 1, deviation=0.2e-3, mean=-0.15e-3),
    "inertia": Term("inertia", "s^2", 1, deviation=1.5e-7, mean=-1e-7),
    "offset": Term("offset", "um", 1, deviation=0.03),
    "asymmetry": Term("asymmetry", "um", MAX_ASYMMETRY, deviation=0.05),
    "duhem": Term("duhem_lengths", "um/V", MAX_DUHEM, deviation=0.01),
    "coupling": Term("other_axes", "um/um", MAX_OTHERS, deviation=0.05),
    "coupling_lag": Term("other_axes", "s", MAX_OTHERS, deviation=5e-5),
    "coupling_inertia": Term("other_axes", "s^2", MAX_OTHERS, deviation=5e-8),
}
"""The known terms by name, in the order of their weights: `ts_term` of the kernel."""


def _sizes(most: int) -> Any:
    """Numbers above 0, at most so many."""

    @declared.bound(f"each in [1e-15, 1e15], up to {most}")
    def bound(_: Any, name: str, value: Any, unit: str) -> tuple[float, ...]:
        found = tuple(checks.sized(name, size, unit) for size in checks.several(name, value, unit))
        checks.count(f"the number of {name}", len(found), 0, most)
        return found

    return bound


COUNTED: dict[str, Any] = {"kernel": "terms", "convert": lambda _, s: list(s.counts.values())}
SETTINGS: declared.Table = {
    "creep_times": Setting(
        "Time constants of the creep states; () is no creep", "s", _sizes(MAX_CREEPS), kernel="creep terms",
        convert=lambda taus, s: ([-math.expm1(-1 / (tau * s.sample_rate)) for tau in taus], list(s.counts.values())),
    ),
    "lag": Setting("Whether the model has a term in the velocity (a delay)", "", declared.FLAG, **COUNTED),
    "inertia": Setting("Whether it has a term in the acceleration (the stage's inertia)", "", declared.FLAG, **COUNTED),
    "offset": Setting("Whether it has a constant (drift)", "", declared.FLAG, **COUNTED),
    "asymmetry": Setting(
        "Number of asymmetry terms: 4 s (1 - s) and 8 s (1 - s)(1 - 2 s), s = z_d / stroke", "",
        declared.whole(0, MAX_ASYMMETRY), **COUNTED,
    ),
    "duhem_lengths": Setting(
        "Lengths of the states of Duhem: how far the voltage moves until each has forgotten; () is none", "V",
        _sizes(MAX_DUHEM), kernel="duhem terms", convert=lambda lengths, s: (list(lengths), list(s.counts.values())),
    ),
    "other_axes": Setting(
        "Number of other axes that act on this one: terms in the displacement (coupling), the velocity (coupling_lag) "
        "and the acceleration (coupling_inertia) of each", "", declared.whole(0, MAX_OTHERS), **COUNTED,
    ),
}  # fmt: skip
"""The settings that say which known terms the model has; the kernel takes how many weights each has."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Layout:
    """Which terms a model has, and where their weights are.

    Attributes
    ----------
    thresholds : tuple[float, ...]
        r of the plays, V, ascending from 0.
    rate_dependent : tuple[int, ...]
        Which plays have a rate weight, ascending.
    creep_times : tuple[float, ...]
        Time constants of the creep states, s.
    lag, inertia, offset : bool
        Whether there is a term in the velocity, one in the acceleration, and a constant.
    asymmetry : int
        Number of terms of asymmetry, 0 to 2.
    duhem_lengths : tuple[float, ...]
        How far the voltage moves, up and down, until a state of Duhem has forgotten, V.
    other_axes : int
        Number of other axes whose displacement, velocity and acceleration are terms of this one, 0 to 2.

    Examples
    --------
    >>> layout = Layout(thresholds=(0.0, 0.5), rate_dependent=(0,), creep_times=(0.3,), asymmetry=1)
    >>> layout.names
    ('a0', 'b0', 'a1', 'creep 0.3 s', 'lag', 'offset', 'asymmetry 1')
    >>> layout.columns["offset"], layout.units[5]
    (slice(5, 6, None), 'um')
    """

    thresholds: tuple[float, ...]
    rate_dependent: tuple[int, ...] = ()
    creep_times: tuple[float, ...] = ()
    lag: bool = True
    inertia: bool = False
    offset: bool = True
    asymmetry: int = 0
    duhem_lengths: tuple[float, ...] = ()
    other_axes: int = 0

    @property
    def terms(self) -> dict[str, Any]:
        """The members of `Layout` by name: two models with the same ones have the same weights."""
        return {member.name: getattr(self, member.name) for member in fields(Layout)}

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of weights of each known term, in their order."""
        return {name: len(_labels(name, getattr(self, term.setting))) for name, term in TERMS.items()}

    @cached_property
    def a(self) -> Places:
        """Places of the weights a of all plays, shape (n,)."""
        places = np.arange(len(self.thresholds))
        return places + np.searchsorted(np.sort(self.rate_plays), places)

    @cached_property
    def rate_plays(self) -> Places:
        """Which plays have a rate weight, as an array."""
        return np.array(self.rate_dependent, dtype=np.intp)

    @cached_property
    def b(self) -> Places:
        """Places of the rate weights b, of those plays that have one."""
        return self.a[self.rate_plays] + 1

    @cached_property
    def of_plays(self) -> int:
        """Number of the weights of plays, a and b: those of the known terms follow them."""
        return len(self.thresholds) + len(self.rate_dependent)

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Places of the weights of each known term, by its name; empty where the model does not have it."""
        ends = self.of_plays + np.cumsum([0, *self.counts.values()])
        return {name: slice(int(ends[k]), int(ends[k + 1])) for k, name in enumerate(TERMS)}

    @cached_property
    def parameters(self) -> int:
        """Number m of the weights."""
        return self.of_plays + sum(self.counts.values())

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the weights, in their order."""
        plays = np.empty(self.of_plays, dtype=object)
        plays[self.a] = [f"a{i}" for i in range(len(self.thresholds))]
        plays[self.b] = [f"b{i}" for i in self.rate_dependent]
        known = [label for name, term in TERMS.items() for label in _labels(name, getattr(self, term.setting))]
        return (*plays.tolist(), *known)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the weights, in their order."""
        known = [TERMS[name].unit for name, count in self.counts.items() for _ in range(count)]
        return (*["um/V"] * self.of_plays, *known)

    def vector(self, a: npt.ArrayLike, b: npt.ArrayLike = 0.0, **known: npt.ArrayLike) -> FloatArray:
        """Weights, or anything with an entry for each of them, shape (m,).

        Parameters
        ----------
        a, b : array_like
            Of the plays, and of those plays that have a rate weight.
        **known
            Of the known terms, by name; 0 where left out.

        Examples
        --------
        >>> Layout(thresholds=(0.0, 0.5), rate_dependent=(0,), asymmetry=1).vector([8.0, 2.0], offset=0.5)
        array([8. , 0. , 2. , 0. , 0.5, 0. ])
        """
        entries = np.zeros(self.parameters)
        entries[self.a], entries[self.b] = a, b
        for name, value in known.items():
            entries[self.columns[name]] = value
        return entries

    def of_all_plays(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights a and b of all plays, each of shape (n,); b is 0 where a play has no rate weight."""
        b = np.zeros(len(self.thresholds))
        b[self.rate_plays] = weights[self.b]
        return weights[self.a], b


def _labels(name: str, value: Sequence[float] | float) -> list[str]:
    """Names of the weights of a term, from the member of `Layout` that says how many there are."""
    if isinstance(value, bool):
        return [name] * value
    if isinstance(value, int | float):
        return [f"{name} {i + 1}" for i in range(int(value))]
    return [f"{name} {size:g} {SETTINGS[TERMS[name].setting].unit}" for size in value]
