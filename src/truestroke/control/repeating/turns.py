"""The ticks in which a motion repeats a period, or goes through it in turns that grow, as a spiral does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.repeating.repetition import EARLIER, LASTS, LEFT, check_repeats
from truestroke.signals.trajectories import Trajectory

GROWS = 0.1  # of its peak-to-peak: by no more a turn differs from the next one
SMALL = 0.2  # of the largest turn: smaller ones count as this one, for their errors are those of the noise
SHIFT, PER_TURN = 0.01, 2e-4  # of a period, by which turns are earlier or later: more is another period
WHOLE = 1e-3  # ticks: a period that is as near to whole ones is


@dataclass(frozen=True, eq=False)
class Turns:
    """Periods of a motion, and how large they are.

    Attributes
    ----------
    period : int
        Ticks.
    start, stop : int
        Ticks in which it repeats: the first of them, and that behind the last.
    sizes : ndarray, shape (periods,)
        Peak-to-peak of each of these periods, over the largest; empty where all are alike.
    """

    period: int
    start: int
    stop: int
    sizes: FloatArray = field(default_factory=lambda: np.empty(0))

    def size(self, ticks: npt.NDArray[np.int_]) -> FloatArray:
        """That of the turn around each of some ticks, 1; between the middles of the periods along straight lines."""
        n = self.sizes.size
        if not n:
            return np.ones(ticks.shape)
        middles = np.clip((ticks - self.start) / self.period - 0.5, 0.0, n - 1.0)
        before = np.minimum(middles.astype(int), n - 2)
        return np.asarray(self.sizes[before] + (middles - before) * (self.sizes[before + 1] - self.sizes[before]))

    def at(self, tick: int) -> float:
        """The same of one tick."""
        return self.size(np.array(tick)).item() if self.sizes.size else 1.0

    @property
    def largest(self) -> slice:
        """The ticks of the largest period."""
        begin = self.start + self.period * (int(self.sizes.argmax()) if self.sizes.size else 0)
        return slice(begin, begin + self.period)


def turns_of(motion: Sequence[Trajectory], period: int, begin: int) -> Turns:
    """The turns of the first axis that has some, from a whole number of periods after the start on.

    Parameters
    ----------
    motion : sequence of Trajectory
        Of the axes.
    period : int
        Ticks.
    begin : int
        First tick that may count.

    Raises
    ------
    SettingError
        No axis repeats the period, nor does one go through it in turns that are alike but for their size; or its turns
        come ever earlier or later in it, for they take a little less or more.

    Examples
    --------
    >>> from truestroke import scans
    >>> scan = scans.spiral(turns=100, rotation=50.0, sample_rate=5000.0)
    >>> turns = turns_of(scan.axes, 100, 2500)
    >>> turns.start, turns.stop, turns.size(np.array([4000, 8000])).round(2).tolist()
    (3000, 12500, [0.2, 0.55])
    """
    refused = None
    for one in motion:
        try:
            start = check_repeats(one, period / one.sample_rate)
        except SettingError as error:
            refused = refused or error
            continue
        return _in_step(one, _alike(one.position, period, max(start, begin)))
    assert refused is not None
    first = motion[0]
    if first.settings.get("velocity") == "linear":
        raise refused  # its turns in the middle alone are of equal time
    for one in motion:
        if (growing := _growing(one.position, period, begin)) is not None:
            return _in_step(one, growing)
    if "rotation" in first.settings and abs(_own(first, period) - period) > WHOLE:
        raise _another(first, period, _own(first, period))
    raise refused


def _in_step(one: Trajectory, turns: Turns) -> Turns:
    """The same; SettingError where they come ever earlier or later in the period, by their strongest harmonic."""
    period, rate = turns.period, one.sample_rate
    if turns.stop > len(one):
        begin, least = turns.start / rate, turns.stop / rate
        bound = f"left out, or the motion {least:g} s long or longer: nothing is learned in its first {begin:g} s"
        raise SettingError("period", period / rate, f"{bound}, and it has {len(one) / rate:g} s", "s")
    part = one.position[turns.start : turns.stop]
    spectra = np.fft.rfft(part[: part.size // period * period].reshape(-1, period), axis=1)[:, 1:]
    k = int(np.sum(np.abs(spectra) ** 2, axis=0).argmax())
    late = np.unwrap(np.angle(spectra[:, k])) / (-2 * math.pi * (k + 1))  # periods
    if np.ptp(late) > SHIFT + PER_TURN * late.size:
        raise _another(one, period, _own(one, period * (1 + np.median(np.diff(late)).item())))
    return turns


def _own(one: Trajectory, about: float) -> float:
    """Ticks of the period that a motion states, where it is near this one or a spiral's; else this one."""
    if isinstance(rotation := one.settings.get("rotation"), float):
        return one.sample_rate / rotation
    rates = (one.settings.get(key) for key in ("frequency", "rate"))
    stated = (one.sample_rate / rate for rate in rates if isinstance(rate, float) and rate > 0)
    return next((ticks for ticks in stated if abs(ticks / about - 1) < EARLIER), about)


def _another(one: Trajectory, period: int, own: float) -> SettingError:
    """Of a motion that has another period, ticks."""
    rate, whole = one.sample_rate, round(own)
    remedy = f"{own / rate:.6g} s"
    if abs(own - whole) > WHOLE:
        remedy = f"its own is {own:.6g} ticks, no whole number; at {rate / whole:.10g} Hz it has {whole / rate:.6g} s"
    return SettingError("period", period / rate, f"a period of the motion, here a {one.name}: {remedy}", "s")


def _alike(z: FloatArray, period: int, begin: int) -> Turns:
    """Until a tick is another than that of the period before, from then on."""
    start = -(-begin // period) * period
    apart = np.flatnonzero(np.abs(z[start + period :] - z[start:-period]) > LEFT * np.ptp(z))
    return Turns(period, start, start + period + (int(apart[0]) if apart.size else max(len(z) - start - period, 0)))


def _growing(z: FloatArray, period: int, begin: int) -> Turns | None:
    """The longest part whose periods are each near the one before; None: there are only a few."""
    start = -(-begin // period) * period
    turns = z[start : start + max(z.size - start, 0) // period * period].reshape(-1, period)
    if len(turns) <= LASTS:
        return None
    span, apart = np.ptp(turns, axis=1), np.abs(np.diff(turns, axis=0)).max(axis=1)
    near = (apart < GROWS * np.minimum(span[1:], span[:-1])) & (apart < LEFT * np.ptp(z))
    edges = np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2)  # first and behind the last
    if not edges.size or np.ptp(longest := edges[np.diff(edges, axis=1).argmax()]) < LASTS:
        return None
    part = slice(int(longest[0]), int(longest[1]) + 1)
    sizes = np.maximum(span[part] / span[part].max(), SMALL)
    return Turns(period, start + period * part.start, start + period * part.stop, sizes)
