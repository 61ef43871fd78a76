"""Fast feedback of the error through a bank of filters: its design from the measured dynamics, and its margins.

The kernel passes the error e = z_ref - z of each measured tick through the bank K and adds the sum to the displacement
that is asked of the hysteresis in the next command. The hysteresis is inverted, so the open loop is

    L(q) = K(q) q^-(1 + latency) G(q),    S = 1 / (1 + L)

with G of `model.dynamics.Dynamics`, the sensor in it. The bank has two parts:

- *Filters with fixed poles*: an integrator that leaks, a lag, and five biquads with poles from a third to six times the
  first resonance. `loop_shaping` finds their numerators together: those that leave least of a load that moves the
  stage at random, least of all two periods later, and of the noise of the sensor in displacement and command. Active
  damping of the first mode is a part of the answer, for a load makes it ring.
- *A narrow resonator for each line of the mains*, with the phase of 1 / (P S), P = q^-(1 + latency) G.

|S| stays below 2 for every gain from 0.7 to 1.3 of what the dynamics say, every resonance within 5 %, and a measurement
that comes a tick later. From 1.5 times the last mode on |K| is bounded, more tightly beyond `trusted_to`: modes that
are not in the dynamics are not excited, and the noise of the sensor does not move the hysteresis of the model.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, figures, quantity
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.control import loop_shaping
from truestroke.model.dynamics import SEEN, Dynamics

LINES = 6  # of hum, at most: TS_FEEDBACKS of the kernel less those of `POLES`
ANY = 1e9  # a gain margin that has no end: finite, so that it can be written to any file
MOST = 0.1  # of the stroke: of the sum of the bank
PEAK = 2.0  # of |S|, at most, for all gains and resonances below
RESERVED = 0.85  # of it, for the choice beside hum: the rest is for the resonators
SPARE = 0.96  # of it, for the search: between the frequencies and the resonances of its grid
GAINS = 0.7, 1.3  # of the loop, over what the dynamics say: slopes of the hysteresis that are not yet learned
RESONANCES = (0.95, 0.965, 0.98, 0.99, 1.0, 1.01, 1.02, 1.035, 1.05)  # over what the dynamics say
LATE = (1.0,)  # with which of them a measurement also comes a tick later than the dynamics say
CLOSER = (0.95, 0.957, 0.965, 0.972, 0.98, 0.985, 0.99, 0.995, 1.0, 1.005, 1.01, 1.015, 1.02, 1.028, 1.035, 1.043, 1.05)
LOAD = 0.16  # of the stroke in a second: standard deviation of a load that moves at random
SLOWEST_LOAD = 0.2  # Hz: a slower one is no larger
LASTING = np.arange(2.0, 6.0, 0.1)  # of the times below: what then remains of a step of load
HEAVIER = 10.0  # ... counts so many times more
BANDWIDTH = 3.0  # Hz: with less there is no feedback; the law learns what is as slow
HUM_GAIN = 30.0  # of a resonator at its line, over that of the loop without it
HUM_WIDTHS = 0.05, 0.025  # of the line: half the bandwidth of its closed loop; mains are within 0.4 %
HARMONICS_OF_HUM = 3

POLES = (0.003, 1.0), (0.03, 1.0), (0.3, 0.7), (0.8, 0.4), (1.3, 0.3), (2.5, 0.7), (6.0, 0.7)  # frequency, damping:
FASTEST = 0.2  # ... over the first resonance, or over this divided by the delay of the loop, where that is less
BEYOND = 1.5  # times the last known mode: from there on the stage may have modes that are not in the dynamics
LOUDEST = (
    2.0,
    0.4,
)  # |K| from there on, up to and beyond the frequency up to which the dynamics are trusted: further modes
# of 0.5 and 3 % of the travel with a damping of 0.01 are not excited

Biquad = tuple[float, float, float, float, float]


@dataclass(frozen=True, kw_only=True, repr=False)
class Feedback(Displayed):
    """A bank of filters for the error, and the margins of its loop; `design` makes it.

    Attributes
    ----------
    sample_rate : float
        Hz
    latency : int
        Ticks that pass before a measurement can be used, beside the one until the next command.
    filters : tuple of (b0, b1, b2, a1, a2)
        Parallel biquads (b0 + b1 q^-1 + b2 q^-2) / (1 + a1 q^-1 + a2 q^-2), from error to displacement, both in um;
        none where feedback was refused.
    most : float
        Bound of their sum, um.
    hum : tuple of float
        Lines of the mains that have a resonator, Hz.
    damping : float
        |1 + L(f0)| without the resonators: by how much the first resonance is lower.
    gain_margin : float
        Factor by which the gain may rise, or fall if that is nearer, until the loop is unstable; 1e9: any.
    phase_margin : float
        deg; 180 where |L| does not cross 1.
    sensitivity_peak : float
        Largest |S| at any frequency, for all gains from 0.7 to 1.3 and resonances within 5 % of the dynamics.
    bandwidth_hz : float
        Frequency up to which |S| is below 0.71: slower loads are reduced; 0 where none is.
    noise_gain : float
        Standard deviation of the displacement that the noise of the sensor causes, over that of a measurement.
    reasons : tuple of str
        What was left out and why, a sentence each.

    Examples
    --------
    >>> from truestroke.model.dynamics import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.01),), dead_time=1e-4)
    >>> found = design(stage, stroke=20.0)
    >>> len(found.filters), found.sensitivity_peak < 2, found.verdict.level
    (7, True, 'good')
    """

    sample_rate: float
    latency: int
    filters: tuple[Biquad, ...] = ()
    most: float = 0.0
    hum: tuple[float, ...] = ()
    damping: float = 1.0
    gain_margin: float = ANY
    phase_margin: float = 180.0
    sensitivity_peak: float = 1.0
    bandwidth_hz: float = 0.0
    noise_gain: float = 0.0
    reasons: tuple[str, ...] = ()

    def response(self, frequency: npt.ArrayLike) -> ComplexArray:
        """K at frequencies, Hz, of any shape, up to half of the sample rate; without unit.

        >>> Feedback(sample_rate=1000.0, latency=0, filters=((0.5, 0.0, 0.0, -0.5, 0.0),)).response([0.0])
        array([1.+0.j])
        """
        q = np.exp(-2j * math.pi * np.asarray(frequency, dtype=np.float64) / self.sample_rate)
        return _response(self.filters, q)

    def open_loop(self, dynamics: Dynamics, frequency: npt.ArrayLike) -> ComplexArray:
        """L = K q^-(1 + latency) G at frequencies, Hz, of any shape, up to half of the sample rate; without unit."""
        f = np.asarray(frequency, dtype=np.float64)
        late = np.exp(-2j * math.pi * f / self.sample_rate * (1 + self.latency))
        response = dynamics.check_rate(self.sample_rate).response(f, sensor=True)
        return np.asarray(self.response(f) * late * response)

    def is_stable(self, dynamics: Dynamics) -> bool:
        """Whether the loop with these dynamics is stable (Nyquist): with others than those of the design it may not be.

        >>> from truestroke.model.dynamics import Mode
        >>> stage, other = (
        ...     Dynamics(sample_rate=10000.0, modes=(Mode(frequency=f, damping=0.01),), dead_time=1e-4)
        ...     for f in (900.0, 300.0)
        ... )
        >>> found = design(stage, stroke=20.0)
        >>> found.is_stable(stage), found.is_stable(other)
        (True, False)
        """
        return bool(loop_shaping.stable(self.open_loop(dynamics, grid(dynamics, self.hum))))

    def sensitivity(self, dynamics: Dynamics, frequency: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """|S| at frequencies, Hz, of any shape; and its largest for gains from 0.7 to 1.3, resonances within 5 %."""
        worst = [_nearest(self.open_loop(_moved(dynamics, factor), frequency)) for factor in CLOSER]
        return np.asarray(np.abs(1 / (1 + self.open_loop(dynamics, frequency)))), np.asarray(1 / np.min(worst, axis=0))

    @property
    def summary(self) -> str:
        """Bandwidth, margins and hum in a line, as pages and controllers show them.

        >>> Feedback(sample_rate=1000.0, latency=0).summary
        'none'
        """
        if not self.filters:
            return " ".join(("none", *self.reasons))
        hum = f"; hum of {', '.join(f'{line:g}' for line in self.hum)} Hz" if self.hum else ""
        margins = f"gain margin {self.gain_margin:.2g}, phase margin {self.phase_margin:.0f} deg"
        return f"reduces loads below {figures(self.bandwidth_hz)} Hz, its bandwidth{hum}; {margins}"

    @property
    def verdict(self) -> Verdict:
        """Good, or doubtful with the reasons for what was left out."""
        level: Level = "doubtful"
        return Verdict.of((level, reason) for reason in self.reasons)

    def _display(self) -> tuple[str, Rows]:
        if not self.filters:
            return "Feedback: none", [("left out", reason) for reason in self.reasons]
        rows = [
            ("gain margin", quantity(float(f"{self.gain_margin:.3g}"))),
            ("phase margin", quantity(float(f"{self.phase_margin:.3g}"), "deg")),
            ("sensitivity peak", quantity(float(f"{self.sensitivity_peak:.3g}"))),
            ("bandwidth", quantity(float(f"{self.bandwidth_hz:.3g}"), "Hz")),
            ("damping", f"{figures(self.damping)} times"),
            ("noise gain", quantity(float(f"{self.noise_gain:.2g}"))),
            ("hum", quantity(self.hum, "Hz") if self.hum else "-"),
            *(("left out", reason) for reason in self.reasons),
        ]
        return f"Feedback: {len(self.filters)} filters" if self.filters else "Feedback: none", rows


def design(
    dynamics: Dynamics,
    *,
    latency: int = 0,
    stroke: float,
    noise: float | None = None,
    hum: float | Sequence[float] = (),
) -> Feedback:
    """The bank that reduces loads, ringing and hum as far as its margins allow.

    |S| stays below 2 for every gain from 0.7 to 1.3 of what the dynamics say, and every resonance within 5 % of it.
    Where there is no such bank it is empty, and `reasons` says why.

    Parameters
    ----------
    dynamics : Dynamics
        Of the stage, with the sample rate of the loop.
    latency : int
        Ticks that pass before a measurement can be used, 0 to 20, beside the one until the next command.
    stroke : float
        um
    noise : float, optional
        Standard deviation of a measurement, um; by default 1e-3 of the stroke.
    hum : float or sequence of float
        Of the mains, Hz: 50 means 50, 100 and 150 Hz; a sequence means its lines.

    Returns
    -------
    Feedback
        Its filters, margins and what was left out.

    Raises
    ------
    SettingError
        An argument is out of bounds.

    Examples
    --------
    >>> from truestroke.model.dynamics import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.01),), dead_time=1e-4)
    >>> design(stage, stroke=20.0, hum=50.0).hum
    (50.0, 100.0, 150.0)

    Where a measurement comes too late, nothing is fed back:

    >>> slow = Dynamics(sample_rate=100.0, modes=(Mode(frequency=30.0, damping=0.01),))
    >>> late = design(slow, stroke=20.0, latency=20)
    >>> late.filters, len(late.reasons)
    ((), 1)
    """
    checks.instance("dynamics", dynamics, Dynamics, "a Dynamics, such as of truestroke.measure_dynamics(actuator)")
    latency = checks.count("latency", latency, 0, 20)
    stroke = checks.sized("stroke", stroke, "um")
    noise = 1e-3 * stroke if noise is None else checks.within("noise", noise, 0.0, stroke, "um")
    lines = lines_of(hum, dynamics.sample_rate)
    seen = replace(dynamics, uncertainty={})
    return _designed(_Hashable(seen), latency, stroke, noise, lines)


class _Hashable:
    """Dynamics by their numbers: equal ones have one design."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics

    def __hash__(self) -> int:
        return hash((self.dynamics.modes, self.dynamics.sample_rate, self.dynamics.dead_time))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Hashable) and self.dynamics == other.dynamics


@functools.lru_cache(maxsize=64)
def _designed(known: _Hashable, latency: int, stroke: float, noise: float, lines: tuple[float, ...]) -> Feedback:
    dynamics = known.dynamics
    plants = _plants(dynamics, latency, lines)
    filters = _shaped(dynamics, latency, plants, RESERVED * PEAK if lines else PEAK, noise, stroke)
    empty = Feedback(sample_rate=dynamics.sample_rate, latency=latency)
    bank = replace(empty, filters=tuple(filters), most=MOST * stroke)
    stated = _plants(dynamics, latency, lines, CLOSER, 300)
    if not filters or _with_margins(bank, dynamics, stated).bandwidth_hz < BANDWIDTH:
        return replace(empty, reasons=(_refusal(dynamics, latency),))
    filters, heard, reasons = _with_resonators(filters, dynamics, latency, plants, lines)
    bank = replace(bank, filters=tuple(filters), hum=tuple(heard), reasons=tuple(reasons))
    return _with_margins(bank, dynamics, stated)


# ---- The loop on its grid --------------------------------------------------------------------------------------------


class _Plants(NamedTuple):
    """q^-(1 + latency) G for several resonances, each on a grid of its own: shape (resonances, frequencies)."""

    frequency: FloatArray  # Hz
    q: ComplexArray
    response: ComplexArray
    nominal: int  # which of them is that of the dynamics


def _plants(
    dynamics: Dynamics, latency: int, lines: Sequence[float], factors: Sequence[float] = RESONANCES, points: int = 150
) -> _Plants:
    rate, f, G = dynamics.sample_rate, [], []
    cases = [*((factor, 0) for factor in factors), *((factor, 1) for factor in LATE)]
    for factor, later in cases:
        moved = _moved(dynamics, factor)
        f.append(grid(moved, lines, points))
        G.append(moved.response(f[-1], sensor=True) * np.exp(-2j * math.pi * f[-1] / rate * later))
    frequency = np.array(f)
    q = np.exp(-2j * math.pi * frequency / rate)
    return _Plants(frequency, q, np.array(G) * q ** (1 + latency), factors.index(1.0))


def _moved(dynamics: Dynamics, factor: float) -> Dynamics:
    """The same with all resonances times a factor, at most those that the sample rate sees."""
    highest = 0.999 * SEEN * dynamics.sample_rate
    modes = tuple(replace(mode, frequency=min(mode.frequency * factor, highest)) for mode in dynamics.modes)
    return replace(dynamics, modes=modes)


def grid(dynamics: Dynamics, lines: Sequence[float] = (), points: int = 150) -> FloatArray:
    """Frequencies, Hz, up to half of the sample rate, dense about the modes and the lines of the mains, Hz."""
    rate = dynamics.sample_rate
    parts = [np.geomspace(1e-6 * rate, rate / 2, points)]
    sharp = [(line, HUM_WIDTHS[-1] / HUM_GAIN) for line in lines]
    for frequency, damping in [*((mode.frequency, mode.damping) for mode in dynamics.modes), *sharp]:
        beside = np.geomspace(0.1 * damping, 0.5, points // 6)
        parts.append(frequency * np.concatenate([1 - beside, [1.0], 1 + beside]))
    return np.sort(np.minimum(np.concatenate(parts), rate / 2))


def _biquad(coefficients: Sequence[float] | FloatArray, q: ComplexArray) -> ComplexArray:
    b0, b1, b2, a1, a2 = coefficients
    return np.asarray((b0 + (b1 + b2 * q) * q) / (1 + (a1 + a2 * q) * q))


def _nearest(L: ComplexArray) -> FloatArray:
    """Least |1 + g L| over the gains g of `GAINS`."""
    gain = np.clip(-L.real / np.maximum(np.abs(L) ** 2, 1e-30), *GAINS)
    return np.asarray(np.abs(1 + gain * L))


def _holds(L: ComplexArray, peak: float = PEAK) -> npt.NDArray[np.bool_]:
    """Whether the loop is stable, with |S| below `peak`, for all gains and resonances: over the last two axes."""
    return np.asarray((_nearest(L).min(axis=(-2, -1)) > 1 / peak) & loop_shaping.stable(L).all(axis=-1))


def _noise_gain(T: ComplexArray, frequency: FloatArray) -> FloatArray:
    """Of white noise through T, on a grid from 0 to half of the sample rate."""
    power = np.abs(T) ** 2
    return np.asarray(np.sqrt(np.trapezoid(power, frequency, axis=-1) / frequency[..., -1]))


# ---- Filters with fixed poles ----------------------------------------------------------------------------------------


def _poles(frequency: float, damping: float, rate: float) -> tuple[float, float]:
    """a1, a2 of 1 + a1 q^-1 + a2 q^-2, with the poles of s^2 + 2 damping w s + w^2; for a damping of 1 one at -w."""
    w = 2 * math.pi * frequency / rate
    if damping == 1.0:
        return -math.exp(-w), 0.0
    radius = math.exp(-damping * w)
    return -2 * radius * math.cos(w * math.sqrt(1 - damping**2)), radius**2


def _unit(dynamics: Dynamics, latency: int) -> float:
    """The first resonance, Hz, or what the delay of the loop allows in its place."""
    rate, lag = dynamics.sample_rate, dynamics.amplifier_bandwidth
    delay = (1.5 + latency) / rate + dynamics.dead_time + dynamics.sensor_delay
    delay += sum(1 / (2 * math.pi * corner) for corner in (lag, dynamics.sensor_bandwidth) if corner)
    return min(dynamics.modes[0].frequency, FASTEST / delay)


def _fixed(dynamics: Dynamics, unit: float) -> list[tuple[float, float, float]]:
    """a1, a2 and the static gain 1 / (1 + a1 + a2) of each filter of the bank."""
    rate = dynamics.sample_rate
    found = [_poles(min(factor * unit, 0.4 * rate), damping, rate) for factor, damping in POLES]
    return [(a1, a2, 1 / (1 + a1 + a2)) for a1, a2 in found]


def _parts(fixed: Sequence[tuple[float, float, float]], q: ComplexArray) -> ComplexArray:
    """Each filter with a numerator of 1, and of q^-1 and q^-2 where it has two poles: along a new last axis."""
    each = []
    for a1, a2, gain in fixed:
        one = 1 / (gain * (1 + (a1 + a2 * q) * q))
        each += [one, one * q, one * q * q] if a2 else [one]
    return np.stack(each, axis=-1)


def _filters(fixed: Sequence[tuple[float, float, float]], x: FloatArray) -> list[Biquad]:
    """With numerators x, in the order of `_parts`."""
    found, at = [], 0
    for a1, a2, gain in fixed:
        count = 3 if a2 else 1
        b0, b1, b2 = np.append(x[at : at + count] / gain, np.zeros(3 - count)).tolist()
        found.append((b0, b1, b2, a1, a2))
        at += count
    return found


def _shaped(
    dynamics: Dynamics, latency: int, plants: _Plants, peak: float, noise: float, stroke: float
) -> list[Biquad]:
    """The filters that reduce loads most, with |S| below `peak`; none where that is not so."""
    unit, rate = _unit(dynamics, latency), dynamics.sample_rate
    fixed = _fixed(dynamics, unit)
    band = np.gradient(plants.frequency, axis=-1)  # Hz, that each frequency stands for
    w = 2 * math.pi * np.maximum(plants.frequency, SLOWEST_LOAD)
    each = zip((*RESONANCES, *LATE), plants.frequency, strict=True)
    modes = np.array([abs(_modes(_moved(dynamics, factor), f)) for factor, f in each])
    unknown = np.geomspace(min(BEYOND * dynamics.modes[-1].frequency, 0.4 * rate), rate / 2, 80)
    problem = loop_shaping.Problem(
        plants=plants.response,
        filters=_parts(fixed, plants.q),
        load=LOAD * stroke * modes * np.sqrt(2 * band) / w,
        noise=noise * np.sqrt(band[plants.nominal] / (rate / 2)),
        nominal=plants.nominal,
        gains=GAINS,
        peak=SPARE * peak,
        unknown=_parts(fixed, np.exp(-2j * math.pi * unknown / rate)),
        loudest=np.where(unknown < dynamics.trusted_to, *LOUDEST),
        left=LOAD * stroke * _left(dynamics, plants.frequency[plants.nominal], unit),
    )
    filters = _filters(fixed, loop_shaping.shape(problem))
    return filters if _holds(_response(filters, plants.q) * plants.response, peak) else []


def _left(dynamics: Dynamics, f: FloatArray, unit: float) -> ComplexArray:
    """From S at f, Hz, to the root of the power that remains of a step of load of 1 at times of `LASTING` / unit."""
    times = LASTING[:, np.newaxis] / unit
    weight = math.sqrt(HEAVIER * (LASTING[1] - LASTING[0]) / unit)
    return np.asarray(weight * 2 * _modes(dynamics, f) / (2j * math.pi * f) * _integrals(f, times))


def _integrals(f: FloatArray, time: FloatArray) -> ComplexArray:
    """Weights of the values at f, Hz, in the integral of exp(2 pi i f time) times what is linear between them."""
    width = np.diff(f)
    turned = 2 * math.pi * time * width
    near = turned < 1e-2  # closed forms lose digits there
    angle = np.where(near, 1.0, turned)
    left = width * np.where(near, 0.5 + 1j * turned / 6, (1 + 1j * angle - np.exp(1j * angle)) / angle**2)
    weights = np.zeros((len(time), f.size), dtype=complex)
    weights[:, :-1] += left
    weights[:, 1:] += left.conj()
    return np.asarray(weights * np.exp(2j * math.pi * time * f))


def _modes(dynamics: Dynamics, f: FloatArray) -> ComplexArray:
    """What the modes make of a load, at f, Hz."""
    return np.asarray(sum(mode.response(2j * math.pi * f) for mode in dynamics.modes))


def _response(filters: Sequence[Biquad], q: ComplexArray) -> ComplexArray:
    return np.asarray(sum((_biquad(one, q) for one in filters), start=np.zeros_like(q)))


def _refusal(dynamics: Dynamics, latency: int) -> str:
    rate, f0 = dynamics.sample_rate, dynamics.modes[0].frequency
    late = latency + 1 + (dynamics.dead_time + dynamics.sensor_delay) * rate
    return (
        f"There is no feedback: a measurement moves the stage {late:.3g} ticks later, {late * f0 / rate:.2g} periods "
        f"of the resonance. No bank with a bandwidth of {BANDWIDTH:g} Hz keeps |S| below {PEAK:g} for gains "
        f"of {GAINS[0]:g} to {GAINS[1]:g} and a resonance 5 % wrong: raise the sample rate, or shorten the latency."
    )


# ---- Hum -------------------------------------------------------------------------------------------------------------


def lines_of(hum: float | Sequence[float], rate: float) -> tuple[float, ...]:
    """The lines of the mains below 0.45 of the sample rate, Hz."""
    highest = SEEN * rate
    if isinstance(hum, Sequence | np.ndarray) and not isinstance(hum, str):
        lines = [checks.positive("hum", line, "Hz") for line in hum]
    else:
        first = checks.within("hum", hum, 0.0, 1e6, "Hz")
        lines = [first * i for i in range(1, HARMONICS_OF_HUM + 1)] if first else []
        if lines and first <= highest < lines[-1]:
            bound = f"up to {highest / HARMONICS_OF_HUM:g} Hz, its harmonics below {SEEN} of the sample rate"
            alone = [line for line in lines if line <= highest]
            raise SettingError("hum", first, f"{bound}; without those above write the lines, hum = {alone}", "Hz")
    checks.count("the number of lines in hum", len(lines), 0, LINES)
    return tuple(checks.within("hum", line, 1e-4 * rate, highest, "Hz") for line in lines)


def _with_resonators(
    filters: list[Biquad], dynamics: Dynamics, latency: int, plants: _Plants, lines: Sequence[float]
) -> tuple[list[Biquad], list[float], list[str]]:
    """The bank with a resonator for each line whose margins hold; which they are, and a reason for each other one."""
    heard: list[float] = []
    reasons: list[str] = []
    for line in lines:
        made = (_resonator(filters, dynamics, latency, line, width) for width in HUM_WIDTHS)
        bank = sum(_biquad(one, plants.q) for one in filters)
        resonator = next((one for one in made if _holds((bank + _biquad(one, plants.q)) * plants.response)), None)
        if resonator:
            filters, heard = [*filters, resonator], [*heard, line]
        else:
            words = f"a resonator there would take |S| above {PEAK:g} where gain or resonance differ"
            reasons.append(f"Hum of {line:g} Hz is not reduced: {words}.")
    return filters, heard, reasons


def _resonator(filters: Sequence[Biquad], dynamics: Dynamics, latency: int, line: float, width: float) -> Biquad:
    """Whose gain at the line, behind the loop with the other filters, is `HUM_GAIN`."""
    q = np.exp(-2j * math.pi * line / dynamics.sample_rate)
    P = complex(dynamics.response(line, sensor=True) * q ** (1 + latency))
    behind = P / (1 + P * sum(complex(_biquad(one, q)) for one in filters))
    a1, a2 = _poles(line, width / (1 + HUM_GAIN), dynamics.sample_rate)
    wanted = HUM_GAIN / behind * (1 + a1 * q + a2 * q * q)
    b1 = wanted.imag / q.imag
    return wanted.real - b1 * q.real, b1, 0.0, a1, a2


# ---- Margins ---------------------------------------------------------------------------------------------------------


def _with_margins(bank: Feedback, dynamics: Dynamics, plants: _Plants) -> Feedback:
    f0 = dynamics.modes[0].frequency
    L = sum(_biquad(one, plants.q) for one in bank.filters) * plants.response
    f, nominal = plants.frequency[plants.nominal], L[plants.nominal]
    S = np.abs(1 / (1 + nominal))
    gain, phase = margins(nominal)
    return replace(
        bank,
        damping=float(abs(1 + replace(bank, filters=bank.filters[: len(POLES)]).open_loop(dynamics, f0))),
        gain_margin=gain,
        phase_margin=phase,
        sensitivity_peak=float(1 / _nearest(L).min()),
        bandwidth_hz=_bandwidth(f, S),
        noise_gain=float(_noise_gain(nominal / (1 + nominal), f)),
    )


def _bandwidth(f: FloatArray, S: FloatArray) -> float:
    """Frequency, Hz, at which |S| first is 0.71; 0 where it begins there."""
    above = np.flatnonzero(S**2 > 0.5)
    if not above.size:
        return float(f[-1])
    i = int(above[0])
    return float(np.interp(0.5**0.5, S[i - 1 : i + 1], f[i - 1 : i + 1])) if i else 0.0


def margins(L: ComplexArray) -> tuple[float, float]:
    """Gain margin, the nearest factor to instability, and phase margin, deg, of an open loop on a dense grid.

    >>> f = np.geomspace(1e-3, 10.0, 4000)
    >>> gain, phase = margins(2 / (1 + 1j * f) ** 3)
    >>> round(gain, 3), round(phase, 1)
    (4.0, 67.6)
    """
    here, after = L[:-1], L[1:]
    crosses = (here.imag * after.imag < 0) & (np.minimum(here.real, after.real) < 0)
    a, b = here[crosses], after[crosses]
    real = (a.real * b.imag - b.real * a.imag) / (b.imag - a.imag)
    factors = -1 / real[real < 0]
    gain = float(factors[np.abs(np.log(factors)).argmin()]) if factors.size else ANY
    size = np.log(np.abs(L))
    unity = size[:-1] * size[1:] < 0
    share = size[:-1][unity] / (size[:-1] - size[1:])[unity]
    angle = np.angle(-here[unity]) + share * np.angle(after[unity] / here[unity])
    return gain, float(np.degrees(np.abs(angle).min())) if angle.size else 180.0
