"""The guided first volts: rest, small steps that grow, ringing, the whole range, each within a level of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from truestroke.base.display import taken_for_um
from truestroke.base.errors import TruestrokeError
from truestroke.base.typing import FloatArray
from truestroke.runtime.commissioning import answer
from truestroke.runtime.commissioning.answer import Gain, Rest
from truestroke.runtime.commissioning.resonance import Resonance, resonance
from truestroke.runtime.drivers.one_axis import OneAxis
from truestroke.runtime.gains import COMMISSIONING
from truestroke.signals.timing import Timing

STEPS = (0.001, 0.003, 0.01, 0.02, 0.05)  # of the voltage range: how the first steps grow
ENOUGH = 2  # which of them is the last one where the answer is clear
CLEAR = 0.03  # of the gain: the standard error of a clear answer
CYCLES = 4  # of each first step
HOLD, RING = 0.06, 0.25  # s that a level is held, of the first steps and of those that ring
RINGING = 0.02  # of the voltage range: a step that rings, at most
RINGS = 4  # of them: up and down
SETTLE = 0.5  # s at rest to begin with
LEVEL = 16.0  # standard deviations of the noise, and times what a step makes: a motion beyond is stopped
SPIKES = 3  # samples in a row beyond it
TARGETS = (0.1, 0.25, 0.5, 0.75, 1.0)  # of the way to a voltage limit
WHOLE = 2.0  # s that the way over the whole range takes at least
ENDS = 0.15  # of the gain of small steps: a sensor that shows less is at its end
LOST = 0.1  # of the samples: with more of them lost nothing is commissioned


class AnswerError(TruestrokeError, RuntimeError):
    """The axis does not respond as configured: the measurement and what to check, in a sentence or two."""


@dataclass(frozen=True, eq=False)
class Record:
    """What was put out and what came back, in the same ticks: V, um."""

    volts: FloatArray
    z: FloatArray


@dataclass(frozen=True, eq=False)
class Small:
    """What steps of up to 5 % of the voltage range say.

    Attributes
    ----------
    timing : Timing
        As the driver states it.
    rest : Rest
        Of the sensor, before anything moves.
    gains : tuple[Gain, ...]
        Of the first steps, from the smallest on.
    resonance : Resonance
        What the ringing says.
    latency : float
        Ticks from a command to its answer in the record, as measured.
    unsure : float
        By so many ticks it may be wrong.
    steps, ringing : Record
        What was done.
    """

    timing: Timing
    rest: Rest
    gains: tuple[Gain, ...]
    resonance: Resonance
    latency: float
    unsure: float
    steps: Record
    ringing: Record

    @property
    def gain(self) -> Gain:
        """Of the largest first step."""
        return self.gains[-1]


@dataclass(frozen=True, eq=False)
class Range:
    """What the whole voltage range reaches.

    Attributes
    ----------
    low, high : float
        Displacement at the lower and at the upper voltage limit, um from rest under the safe voltage.
    ends : str
        Where the sensor ended before the voltage did; else empty.
    path : Record
        What was done.
    """

    low: float
    high: float
    ends: str
    path: Record

    @property
    def reach(self) -> float:
        """From end to end, um."""
        return self.high - self.low


def small_steps(axis: OneAxis, stroke: float | None = None, report: Callable[[str], None] = lambda _: None) -> Small:
    """Noise, polarity, gain, latency and first resonance, by steps from the safe voltage that begin tiny.

    Parameters
    ----------
    axis : OneAxis
        Closed; it is closed again behind, at the safe voltage, whatever happens.
    stroke : float, optional
        That is asked for, um; with it a gain that cannot be is refused.
    report : callable, optional
        Called with what is being done.

    Raises
    ------
    AnswerError
        The sensor does not answer, answers the wrong way, by a gain that cannot be, or moves by itself.
    DriverError, SettingError
        As `OneAxis`.

    Examples
    --------
    >>> from truestroke.runtime.drivers import SimulatedDriver
    >>> axis = OneAxis(SimulatedDriver(), voltage_limits=(-0.6, 3.6), slew=400.0)
    >>> found = small_steps(axis, stroke=30.0)
    >>> print(f"{found.gain.gain:.0f} um/V")
    9 um/V
    """
    with _opened(axis) as bench:
        report("rest")
        still = bench.hold(SETTLE)
        rest = _usable(answer.rest(still.z[bench.timing.latency :], bench.rate))
        report("first steps")
        gains, steps = _first_steps(bench, rest, stroke)
        report("ringing")
        step = float(np.clip(40 * rest.noise / gains[-1].gain, STEPS[0] * bench.span, RINGING * bench.span))
        ringing = bench.steps(step * bench.up, _level(step, gains[-1].gain, rest), rest, RINGS, RING)
    report("fitting")
    begins = answer.onset(ringing.volts, ringing.z, rest.noise)
    if begins is None:
        raise AnswerError(f"steps of {step:.3g} V were answered, and then not any more: is a cable loose?")
    found = resonance(ringing.volts, ringing.z, bench.rate, begins, rest.noise)
    return Small(
        timing=bench.timing,
        rest=rest,
        gains=gains,
        resonance=found,
        latency=found.delay,
        unsure=1.0 + (0.05 * bench.rate / found.frequency if found.frequency else 0.0),
        steps=steps,
        ringing=ringing,
    )


def whole_range(axis: OneAxis, small: Small, report: Callable[[str], None] = lambda _: None) -> Range:
    """How far the axis goes: to the voltage limits and back, slowly, looking at each part of the way.

    Parameters
    ----------
    axis, report
        As of `small_steps`.
    small : Small
        What `small_steps` has found.

    Raises
    ------
    AnswerError
        The axis moves further than its gain allows, or the other way.
    DriverError, SettingError
        As `OneAxis`.
    """
    with _opened(axis) as bench:
        report("whole range")
        before = bench.hold(SETTLE / 2)
        zero = answer.rest(before.z, bench.rate).zero
        parts, reached, ends = [before], {axis.safe_voltage: 0.0}, []
        for limit in axis.voltage_limits[::-1]:
            found, end = _to(limit, bench, small, zero, parts)
            reached |= found
            ends += [end] if end else []
        path = Record(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("volts", "z")))
    low, high = min(reached.values()), max(reached.values())
    return Range(low, high, "; ".join(ends), replace(path, z=path.z - zero))


def _to(limit: float, bench: _Bench, small: Small, zero: float, parts: list[Record]) -> tuple[dict[float, float], str]:
    """To a voltage limit and back: displacement (um from `zero`) at each target, and where the sensor ended."""
    safe, gain, reached, end = bench.safe, small.gain.gain, {}, ""
    start = last = bench.settled(parts[-1]) - zero  # behind the other limit not zero: hysteresis
    volts = safe
    for part in TARGETS if limit != safe else ():
        target = safe + part * (limit - safe)
        allowed = 3 * gain * abs(target - safe) + _level(0.0, gain, small.rest)
        parts.append(bench.go(target, (zero + min(start, 0.0) - allowed, zero + max(start, 0.0) + allowed)))
        z = bench.settled(parts[-1]) - zero
        moved, most = (z - last) * np.sign(target - volts), gain * abs(target - volts)
        if moved < -ENDS * most:
            raise AnswerError(f"from {volts:.3g} to {target:.3g} V the axis went back by {-moved:.3g} um")
        if not moved > ENDS * most:
            end = f"from {volts:.3g} V on the sensor shows no more than {last:.4g} um: its end, or that of the stage"
            break
        reached[target], last, volts = z, z, target
    parts.append(bench.go(safe, None))
    return reached, end


def _first_steps(bench: _Bench, rest: Rest, stroke: float | None) -> tuple[tuple[Gain, ...], Record]:
    """Steps that grow until the answer is clear; AnswerError where it is not as it has to be."""
    gains: list[Gain] = []
    records: list[Record] = []
    expected = None if stroke is None else stroke / bench.span
    for i, part in enumerate(STEPS):
        step = part * bench.span * bench.up
        level = None if expected is None else _level(step, COMMISSIONING[1] * expected, rest)
        records.append(bench.steps(step, level, rest))
        found = answer.gain(records[-1].volts, records[-1].z, bench.timing.latency, rest.noise)
        gains.append(found)
        if found.seen:
            _possible(found, expected, bench)
            if i >= ENOUGH and found.uncertainty < CLEAR * found.gain and _steady(gains):
                break
    if not (gains[-1].seen and _steady(gains)):
        _no_answer(gains, rest, bench, records[-1])
    if expected is not None and gains[-1].gain < COMMISSIONING[0] * expected:
        raise AnswerError(_wrong_gain(gains[-1], expected, bench))
    path = Record(*(np.concatenate([getattr(record, name) for record in records]) for name in ("volts", "z")))
    return tuple(gains), path


def _steady(gains: list[Gain]) -> bool:
    """Whether two steps of different height, one after the other, have about the same gain."""
    if len(gains) < 2 or not gains[-2].seen:
        return len(gains) == len(STEPS)  # seen at the largest only: there is nothing to compare with
    return bool(0.5 < gains[-1].gain / gains[-2].gain < 2.0)


def _possible(found: Gain, expected: float | None, bench: _Bench) -> None:
    if found.gain < 0:
        raise AnswerError(
            f"more voltage makes the displacement smaller, by {-found.gain:.3g} um/V, in steps of {found.step:.3g} V: "
            "turn the sign of the sensor in [driver] (um_per_volt, um_per_unit), or that of the amplifier"
        )
    if expected is not None and found.gain - 4 * found.uncertainty > COMMISSIONING[1] * expected:
        raise AnswerError(_wrong_gain(found, expected, bench))


def _wrong_gain(found: Gain, expected: float, bench: _Bench) -> str:
    (low, high), stroke = (share * expected for share in COMMISSIONING), expected * bench.span
    why = taken_for_um(found.gain / expected)
    return (
        f"the gain is {found.gain:.3g} um/V; stroke over voltage_limits is {expected:.3g} um/V ({stroke:.4g} um over "
        f"{bench.span:.4g} V), which allows {low:.3g} to {high:.3g}: {why and f'{why}; '}look at um_per_volt "
        "(um_per_unit), stroke, limits"
    )


def _no_answer(gains: list[Gain], rest: Rest, bench: _Bench, record: Record) -> None:
    spread, white = float(np.nanstd(record.z)), float(np.nanstd(np.diff(record.z)) / np.sqrt(2))
    if np.nanmax(record.z) == np.nanmin(record.z):
        seen = f"the sensor shows {record.z[0]:.6g} um to the last bit"
    elif spread > 4 * min(rest.noise, white):
        seen = f"the sensor moves by {spread:.3g} um rms, but not with the voltage: is it that of another axis?"
    else:
        seen = f"the sensor shows its noise alone, {spread:.3g} um rms"
    raise AnswerError(
        f"no answer to steps of {gains[-1].step:.3g} V, {100 * STEPS[-1]:g} % of voltage_limits: {seen}; look at "
        "amplifier, cables, and the channels in [driver]"
    )


def _usable(rest: Rest) -> Rest:
    if rest.lost > LOST:
        raise AnswerError(f"{100 * rest.lost:.0f} % of the samples are lost at rest: look at the sensor and its cable")
    return rest


def _level(step: float, gain: float, rest: Rest) -> float:
    """How far from zero a step may lead, um, with ringing that builds up."""
    return LEVEL * (gain * abs(step) + rest.noise) + abs(rest.drift)


class _Bench:
    """An axis that is open: waveforms from the safe voltage and back, with an eye on how far it moves."""

    def __init__(self, axis: OneAxis, timing: Timing) -> None:
        self.axis, self.timing, self.rate, self.safe = axis, timing, timing.sample_rate, axis.safe_voltage
        low, high = axis.voltage_limits
        self.span, self.up = high - low, 1.0 if high - self.safe > STEPS[-1] * (high - low) else -1.0
        self._last, self._tick, self._beyond = self.safe, axis.slew / self.rate, 0
        self._random = np.random.default_rng(0)  # levels of uneven length: nothing periodic keeps pace with them

    def apply(self, volts: FloatArray, within: tuple[float, float] | None = None) -> Record:
        """Put `volts` out, and hold the last until its answer has come."""
        block = self.timing.block
        blocks = -(-(volts.size + self.timing.latency) // block)
        volts = np.append(volts, np.full(blocks * block - volts.size, volts[-1]))
        z = np.empty(volts.size)
        self._beyond = 0
        for k in range(0, volts.size, block):
            z[k : k + block] = self.axis.exchange(volts[k : k + block])
            if within:
                self._look(z[k : k + block], *within, volts[k])
        self._last = float(volts[-1])
        return Record(volts, z)

    def _look(self, z: FloatArray, low: float, high: float, volts: float) -> None:
        """End it where `SPIKES` samples in a row are beyond what can be; lost ones are not."""
        for value in z.tolist():
            self._beyond = self._beyond + 1 if value < low or value > high else 0
            if self._beyond >= SPIKES:
                raise AnswerError(
                    f"the sensor shows {value:.4g} um, where {volts:.3g} V can lead to {low:.4g} to {high:.4g} um: "
                    "look at um_per_volt (um_per_unit), stroke, and whether this is the sensor of this axis"
                )

    def hold(self, seconds: float) -> Record:
        """Stay where it is."""
        return self.apply(np.full(max(round(seconds * self.rate), 20), self._last))

    def settled(self, record: Record) -> float:
        """Mean of the end of a record, um; NaN where nothing came."""
        part = record.z[-max(round(0.5 * HOLD * self.rate), 10) :]
        return float(np.nanmean(part)) if np.isfinite(part).any() else np.nan

    def go(self, target: float, within: tuple[float, float] | None) -> Record:
        """Slowly to a voltage, and stay there for `HOLD`."""
        tick = min(self._tick, self.span / WHOLE / self.rate)
        return self.apply(self._level(target, HOLD, tick), within)

    def steps(self, step: float, level: float | None, rest: Rest, cycles: int = CYCLES, hold: float = HOLD) -> Record:
        """Up and down by `step` (V) so many times, each level held for `hold` s; at most `level` (um) from rest."""
        parts = [np.full(max(round(hold * self.rate), 20), self.safe)]
        self._last = self.safe
        for target in [self.safe + step, self.safe] * cycles:
            parts.append(self._level(target, hold * (1 + 0.4 * self._random.random()), self._tick))
            self._last = target
        within = None if level is None else (rest.zero - level, rest.zero + level)
        return self.apply(np.concatenate(parts), within)

    def _level(self, target: float, hold: float, tick: float) -> FloatArray:
        """From the last voltage to `target`, by at most `tick` (V) a tick, and held for `hold` s."""
        ticks = max(1, int(np.ceil(abs(target - self._last) / tick - 1e-9)))
        ramp = np.linspace(self._last, target, ticks + 1)[1:]
        return np.append(ramp, np.full(max(round(hold * self.rate), 20), target))


@contextmanager
def _opened(axis: OneAxis) -> Iterator[_Bench]:
    """Open, and closed behind: no signal interrupts the way to the safe voltage."""
    with axis:
        yield _Bench(axis, axis.open())
