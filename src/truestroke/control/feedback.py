"""Fast feedback of the error through a bank of filters: its design from the measured dynamics, and its margins.

The kernel passes the error e = z_ref - z of each measured tick through the bank K and adds the sum to the displacement
that is asked of the hysteresis in the next command. The hysteresis is inverted, so the open loop is

    L(q) = K(q) q^-(1 + latency) G(q),    S = 1 / (1 + L)

with G of `model.dynamics.Dynamics`, the sensor in it. The bank has three parts:

- *An integrator* against loads, with a corner far below the crossover in place of its pole at 1; and a lag beside it,
  w/s (1 + 0.1 w / (s + 0.03 w)) in sum, against loads that are slower than a tenth of the crossover w.
- *A biquad at the first mode*, its poles there or at 2.5 times it. Its complex gain at f0 makes L real and positive
  there, or turned by a small angle: that is active damping, by 1 + L(f0). Its third coefficient is the gain at 0 Hz,
  beside the integrator: a notch for the integrator is one of its cases.
- *A narrow resonator for each line of the mains*, with the phase of 1 / (P S), P = q^-(1 + latency) G.

Integrator, lag and biquad are selected together, from a grid: the least error from noise, harmonics at the resonance
and loads, among those whose margins hold for every gain from 0.7 to 1.3 of what the dynamics say, and every resonance
within 5 %, and that do not amplify noise at half of the sample rate: it would move the hysteresis of the model.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.base.verdict import Level, Verdict
from truestroke.model.dynamics import SEEN, Dynamics

LINES = 6  # of hum, at most: TS_FEEDBACKS of the kernel less three
ALWAYS = 3  # filters: integrator, lag, biquad; those of hum follow
ANY = 1e9  # a gain margin that has no end: finite, so that it can be written to any file
MOST = 0.1  # of the stroke: of the sum of the bank
PEAK = 2.0  # of |S|, at most, for all gains and resonances below
RESERVED = 0.85  # of it, for the choice beside hum: the rest is for the resonators
GAINS = 0.7, 1.3  # of the loop, over what the dynamics say: slopes of the hysteresis that are not yet learned
RESONANCES = 0.95, 1.0, 1.05  # over what the dynamics say
CLOSER = (0.95, 0.965, 0.98, 0.99, 1.0, 1.01, 1.02, 1.035, 1.05)  # the same, for the choice
HARMONICS = 1e-4  # of the stroke: amplitude of an unknown disturbance at the resonance
LOAD, LOAD_FREQUENCY = 0.005, 10.0  # of the stroke, Hz: a load
CROSSOVERS = 180.0 * 0.8 ** np.arange(18.0)  # Hz: of the integrator by itself
LEAK = 0.01  # of the crossover: corner of the integrator
LAG, LAG_LEAK = 0.1, 0.03  # of the crossover: corner below which the lag adds to it, and its own
HUM_GAIN = 30.0  # of a resonator at its line, over that of the loop without it
HUM_WIDTHS = 0.05, 0.025  # of the line: half the bandwidth of its closed loop; mains are within 0.4 %
HARMONICS_OF_HUM = 3

POLES = (1.0, 0.5), (1.0, 1.0), (2.5, 0.7)  # of the biquad: frequency over the first mode's, and damping
SLOPES = -1.5, -1.0, -0.5, 0.0, 0.5  # gain of the biquad at 0 Hz, in crossovers per resonance
LOUDEST = 1.0  # |K| at half of the sample rate: the noise of the sensor moves the hysteresis, too
DAMPED = 0.5 * 2.0 ** np.arange(8.0)  # |L(f0)| of the active damping
TURNED = -30.0, 0.0, 30.0  # deg: its angle

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
    (3, True, 'good')
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
        return f"reduces loads below {self.bandwidth_hz:.3g} Hz, its bandwidth{hum}; {margins}"

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
            ("damping", f"{self.damping:.3g} times"),
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
    rough, fine = _plants(dynamics, latency, RESONANCES, (), 60), _plants(dynamics, latency, CLOSER, lines, 150)
    peak = RESERVED * PEAK if lines else PEAK
    filters = _best(dynamics, latency, (rough, fine), peak, noise, stroke)
    empty = Feedback(sample_rate=dynamics.sample_rate, latency=latency)
    if not filters:
        return replace(empty, reasons=(_refusal(dynamics, latency),))
    filters, heard, reasons = _with_resonators(filters, dynamics, latency, fine, lines)
    bank = replace(empty, filters=tuple(filters), most=MOST * stroke, hum=tuple(heard), reasons=tuple(reasons))
    return _with_margins(bank, dynamics, fine)


# ---- The loop on its grid --------------------------------------------------------------------------------------------


class _Plants(NamedTuple):
    """q^-(1 + latency) G for several resonances, each on a grid of its own: shape (resonances, frequencies)."""

    frequency: FloatArray  # Hz
    q: ComplexArray
    response: ComplexArray
    nominal: int  # which of them is that of the dynamics


def _plants(dynamics: Dynamics, latency: int, factors: Sequence[float], lines: Sequence[float], points: int) -> _Plants:
    rate, f, G = dynamics.sample_rate, [], []
    for factor in factors:
        moved = _moved(dynamics, factor)
        f.append(grid(moved, lines, points))
        G.append(moved.response(f[-1], sensor=True))
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


def _stable(L: ComplexArray) -> npt.NDArray[np.bool_]:
    """Whether 1 + L does not turn around 0 between 0 Hz and half of the sample rate, along the last axis (Nyquist)."""
    distance = 1 + L
    turned = np.angle(distance[..., 1:] / distance[..., :-1]).sum(axis=-1) + np.angle(distance[..., 0])
    return np.asarray(np.abs(turned) < 1.0)


def _nearest(L: ComplexArray) -> FloatArray:
    """Least |1 + g L| over the gains g of `GAINS`."""
    gain = np.clip(-L.real / np.maximum(np.abs(L) ** 2, 1e-30), *GAINS)
    return np.asarray(np.abs(1 + gain * L))


def _holds(L: ComplexArray, peak: float = PEAK) -> npt.NDArray[np.bool_]:
    """Whether the loop is stable, with |S| below `peak`, for all gains and resonances: over the last two axes."""
    return np.asarray((_nearest(L).min(axis=(-2, -1)) > 1 / peak) & _stable(L).all(axis=-1))


def _noise_gain(T: ComplexArray, frequency: FloatArray) -> FloatArray:
    """Of white noise through T, on a grid from 0 to half of the sample rate."""
    power = np.abs(T) ** 2
    return np.asarray(np.sqrt(np.trapezoid(power, frequency, axis=-1) / frequency[..., -1]))


# ---- Integrator and active damping -----------------------------------------------------------------------------------


def _poles(frequency: float, damping: float, rate: float) -> tuple[float, float]:
    """a1, a2 of 1 + a1 q^-1 + a2 q^-2, with the poles of s^2 + 2 damping w s + w^2, damping at most 1."""
    w = 2 * math.pi * frequency / rate
    radius = math.exp(-damping * w)
    return -2 * radius * math.cos(w * math.sqrt(1 - damping**2)), radius**2


def _slow(crossover: float, rate: float) -> tuple[Biquad, Biquad]:
    """The integrator, and the lag: w/(1 - a q) (1 + LAG w/(1 - b q)) in partial fractions."""
    w = 2 * math.pi * crossover / rate
    a, b = math.exp(-LEAK * w), math.exp(-LAG_LEAK * w)
    share = LAG * w / (a - b)
    return (w * (1 + share * a), 0.0, 0.0, -a, 0.0), (-w * share * b, 0.0, 0.0, -b, 0.0)


def _response(filters: Sequence[Biquad], q: ComplexArray) -> ComplexArray:
    return np.asarray(sum((_biquad(one, q) for one in filters), start=np.zeros_like(q)))


def _candidates(dynamics: Dynamics, latency: int, crossover: float) -> FloatArray:
    """Biquads beside integrator and lag: shape (candidates, 5)."""
    rate, f0 = dynamics.sample_rate, dynamics.modes[0].frequency
    q = np.exp(-2j * math.pi * f0 / rate)
    response = complex(dynamics.response(f0, sensor=True) * q ** (1 + latency))
    integral = complex(_response(_slow(crossover, rate), q))
    angles = np.exp(1j * np.radians(TURNED))
    damped = np.append(np.outer(DAMPED, angles).ravel(), 0.0) / response - integral
    slopes = np.array(SLOPES) * crossover / f0
    found = []
    for factor, damping in POLES:
        a1, a2 = _poles(min(factor * f0, SEEN * rate), damping, rate)
        there = damped * (1 + a1 * q + a2 * q * q)
        still = slopes * (1 + a1 + a2)
        equations = [[1.0, q.real, (q * q).real], [0.0, q.imag, (q * q).imag], [1.0, 1.0, 1.0]]
        wanted = [np.repeat(there.real, still.size), np.repeat(there.imag, still.size), np.tile(still, there.size)]
        b = np.linalg.solve(equations, wanted).T
        found.append(np.column_stack([b, np.full(len(b), a1), np.full(len(b), a2)]))
    return np.concatenate(found)


def _best(
    dynamics: Dynamics, latency: int, plants: tuple[_Plants, _Plants], peak: float, noise: float, stroke: float
) -> list[Biquad]:
    """Integrator, lag and biquad with the least cost among those with |S| below `peak`; none where none are."""
    rough, fine = plants
    rate, n = dynamics.sample_rate, rough.nominal
    best: list[Biquad] = []
    least = math.inf
    k = int(np.searchsorted(rough.frequency[n], min(LOAD_FREQUENCY, 0.02 * dynamics.modes[0].frequency)))
    for crossover in (float(c) for c in CROSSOVERS if c < dynamics.modes[0].frequency):
        slow = _slow(crossover, rate)
        candidates = _candidates(dynamics, latency, crossover)
        # what loads alone cost: most of the lower crossovers need no more
        K = _biquad(candidates.T[..., None], rough.q[n, k : k + 1]) + _response(slow, rough.q[n, k : k + 1])
        candidates = candidates[LOAD * stroke / np.abs(1 + K * rough.response[n, k])[:, 0] < least]
        candidates = candidates[np.abs(_biquad(candidates.T, np.full(1, -1.0 + 0j))) < LOUDEST]
        K = _biquad(candidates.T[..., None, None], rough.q) + _response(slow, rough.q)
        L = K * rough.response
        good = _holds(L, peak)
        L, candidates = L[good], candidates[good]
        S = 1 / (1 + L)
        ringing = np.abs(S * rough.response).max(axis=(-2, -1))
        heard = _noise_gain((L * S)[:, n], rough.frequency[n])
        cost = np.hypot(noise * heard, HARMONICS * stroke * ringing)
        cost = np.hypot(cost, LOAD * stroke * np.abs(S[:, n, k]))
        for i in np.argsort(cost):
            if cost[i] >= least:
                break
            filters = [*slow, _plain(candidates[i])]
            if _holds(_response(filters, fine.q) * fine.response, peak):
                best, least = filters, float(cost[i])
    return best


def _plain(coefficients: FloatArray) -> Biquad:
    b0, b1, b2, a1, a2 = map(float, coefficients)
    return b0, b1, b2, a1, a2


def _refusal(dynamics: Dynamics, latency: int) -> str:
    rate, f0 = dynamics.sample_rate, dynamics.modes[0].frequency
    late = latency + 1 + (dynamics.dead_time + dynamics.sensor_delay) * rate
    return (
        f"There is no feedback: a measurement moves the stage {late:.3g} ticks later, {late * f0 / rate:.2g} periods "
        f"of the resonance. No bank above {CROSSOVERS[-1]:.2g} Hz keeps |S| below {PEAK:g} for gains of {GAINS[0]:g} "
        f"to {GAINS[1]:g} and a resonance that is 5 % wrong: raise the sample rate, or shorten the latency."
    )


# ---- Hum -------------------------------------------------------------------------------------------------------------


def lines_of(hum: float | Sequence[float], rate: float) -> tuple[float, ...]:
    """The lines of the mains below 0.45 of the sample rate, Hz."""
    if isinstance(hum, Sequence | np.ndarray):
        lines = [checks.positive("hum", line, "Hz") for line in hum]
    else:
        first = checks.within("hum", hum, 0.0, 1e6, "Hz")
        lines = [first * i for i in range(1, HARMONICS_OF_HUM + 1)] if first else []
    checks.count("the number of lines in hum", len(lines), 0, LINES)
    return tuple(checks.within("hum", line, 1e-4 * rate, SEEN * rate, "Hz") for line in lines)


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
    above = np.flatnonzero(S**2 > 0.5)
    gain, phase = margins(nominal)
    return replace(
        bank,
        damping=float(abs(1 + replace(bank, filters=bank.filters[:ALWAYS]).open_loop(dynamics, f0))),
        gain_margin=gain,
        phase_margin=phase,
        sensitivity_peak=float(1 / _nearest(L).min()),
        bandwidth_hz=float(f[above[0]]) if above.size else float(f[-1]),
        noise_gain=float(_noise_gain(nominal / (1 + nominal), f)),
    )


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
