"""The stage's dynamics as the controller uses them: coefficients for the kernel, the strain that a motion needs.

The voltage acts through the hysteresis on the strain, the strain through the stage G on the displacement. Four things
follow from G, of `model.dynamics.Dynamics`:

- *The command* asks the hysteresis for the strain G^-1 z_d in place of z_d: `strain` where the motion is known ahead,
  by the first terms of 1 / G, in velocity and acceleration, where it is not.
- *Adaptation* passes the regressor through A G and the measurement through A, so that both stay in their linear
  relation. A has its zeros at the poles of the modes; without it the law would learn little but the resonance. A
  further mode keeps a damping of 0.3: one that has moved costs a factor of a few, not of a hundred.
- *The lag of the amplifier* is before the hysteresis. There a voltage that leads undoes it to the end of each tick; G
  is without it. Behind the hysteresis it would be undone for a sine, not for the corners of the plays.
- *The innovation*, from which the noise and spikes are taken, is the measurement less what G gives for the strain of
  the model.

With exact poles p of G(s), each exp(p T), the numerators follow from the exact response in closed form; here they are
fitted to it, which is the same to 1e-9.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.model.dynamics import Dynamics, Mode

TAPS = 5  # TS_TAPS of the kernel
DIRECT = 3  # of G beside its sections
POINTS = 400  # at which the response is fitted
EXACT = 1e-4  # largest error of a fit, relative to the static gain
APART = 1e-3  # of poles: nearer ones are fitted as if they were so far apart
SLOW = 0.02, 0.04  # of the first resonance: where 1 / G is expanded
INVERTED = (2.5, 4.0), (1.5, 2.5)  # of the first resonance: inverted in full up to the first, not above the second
VISIBLE = 0.3, 0.45  # of the sample rate: the same bounds where it is low
MOST_DEAD = 8  # ticks of lag and dead time of a stage that is found: TS_MOST_DEAD of the kernel
DAMPED = 0.3  # damping of a second or third mode in the equation of the law
AMPLE = 2.0  # times the motion, peak to peak: a strain that needs more is inverted up to the next of `INVERTED`
FOUND_DAMPING = 0.02  # of a stage that was found by its oscillation
STEP_TERMS = 32  # of a series: enough up to half of the sample rate
KEPT = 2**19 + 1  # frequencies whose inverse is computed, and kept for the next motion, at a time: 8 MB
QUIET = 0.2  # s: rest before and after a motion, for its inversion
BLOCK = 2**18  # ticks of a longer motion that are inverted at a time
FADED = 2000.0  # over the width of the edge of the inverse, in Hz: s after which its response has decayed to 1e-12


def members(dynamics: Dynamics) -> dict[str, Any]:
    """The members of ts_settings.dynamics in c/include/truestroke.h.

    Parameters
    ----------
    dynamics : Dynamics
        Of the stage, with the sample rate of the controller.

    Returns
    -------
    dict
        By the names of the members, "dynamics.known" and so on.

    Raises
    ------
    SettingError
        Poles are too near each other.

    Examples
    --------
    >>> from truestroke.model.dynamics import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),), dead_time=2.5e-4)
    >>> found = members(stage)
    >>> found["dynamics.dead"], [round(x, 3) for x in found["dynamics.section"][0][2:]]
    (2, [-1.794, 0.983])
    """
    sections, dead, f, q, G = _sampled(dynamics)
    kept = kept_by_amplifier(dynamics)
    if kept > 0:
        sections, G = _sections(replace(dynamics, amplifier_bandwidth=0.0)), G * _undone(kept, q)
    a1, a2 = sections[0]
    notch = np.array([1.0, a1, a2]) / (1 + a1 + a2)
    A, others, modes = _polynomial(notch, q), sections[1:], []
    for place, mode in enumerate(dynamics.modes[1:]):
        damped = _poles(mode.frequency, DAMPED, dynamics.sample_rate)
        zeros, poles = np.array([1.0, *others[place]]), np.array([1.0, *damped])
        zeros *= poles.sum() / zeros.sum()
        modes.append([*zeros.tolist(), *damped])
        A = A * _polynomial(zeros, q) / _polynomial(poles, q)
        others[place] = damped
    direct, own = _numerators(G, q, sections, DIRECT)
    # behind the first mode everything is small, and there the fit need not be as good
    weight = 1 / (1 + (f / dynamics.modes[0].frequency) ** 2)
    tap, rest = _numerators(G * A, q, others, TAPS, weight)
    return {
        "dynamics.known": True,
        "dynamics.first": dynamics.modes[0].frequency / dynamics.sample_rate,
        "dynamics.sections": len(own),
        "dynamics.section": own,
        "dynamics.direct": direct,
        "dynamics.dead": dead,
        "dynamics.notch": notch.tolist(),
        "dynamics.modes": len(modes),
        "dynamics.mode": modes,
        "dynamics.quiet": (notch / _noise_gain(notch)).tolist(),
        "dynamics.tap": tap,
        "dynamics.others": len(rest),
        "dynamics.rest": rest,
        "dynamics.amplifier": kept,
        "dynamics.lead": _expansion(1 / of_strain(dynamics, _slow(dynamics)), dynamics),
        "dynamics.sensor": _expansion(
            dynamics.response(_slow(dynamics), sensor=True) / dynamics.response(_slow(dynamics)), dynamics
        ),
    }


NOT_KNOWN: dict[str, Any] = {
    "dynamics.known": False,
    **dict.fromkeys(("dynamics.first", "dynamics.amplifier"), 0.0),
    **dict.fromkeys(("dynamics.sections", "dynamics.dead", "dynamics.modes", "dynamics.others"), 0),
    **{
        f"dynamics.{name}": []
        for name in ("section", "direct", "notch", "mode", "quiet", "tap", "rest", "lead", "sensor")
    },
}
"""The members of a controller that does not know the stage."""


def _step_of_mode(w: float) -> tuple[float, float, float]:
    """The step response of a mode at the end of a tick, by series: its integral, itself and its rate, per tick."""
    drag, stiff = 2 * FOUND_DAMPING * w, w * w
    before, term = 0.0, stiff / 6
    integral, step, rate = term, 3 * term, 6 * term
    for n in range(4, STEP_TERMS + 1):
        before, term = term, -(drag * term / n + stiff * before / (n * (n - 1)))
        integral += term
        step += n * term
        rate += n * (n - 1) * term
    return integral, step, rate


def lead_of_dead_time(dead: int) -> tuple[float, float, float, float]:
    """exp(d x) of so many ticks d, times the inverse of the hold, 1 - x^2 / 12 + x^4 / 240: coefficients of x to x^4.

    Examples
    --------
    >>> [round(240 * c) for c in lead_of_dead_time(1)]
    [240, 100, 20, 1]
    """
    d = float(dead)
    return d, (6 * d**2 - 1) / 12, (2 * d**3 - d) / 12, (d**4 - d**2) / 24 + 1 / 240


def found(frequency: float, tick: float, dead: int = 1) -> dict[str, Any]:
    """The members of a stage of which only the first resonance is known: one mode of damping 0.02 behind a dead time.

    Parameters
    ----------
    frequency : float
        Of the resonance, cycles per tick, below 0.5.
    tick : float
        s
    dead : int
        Whole ticks of dead time.

    Returns
    -------
    dict
        As of `members`, here in closed form: the controller makes them while it runs.

    Examples
    --------
    >>> from truestroke.model.dynamics import Mode
    >>> same = Dynamics(sample_rate=2000.0, modes=(Mode(frequency=100.0, damping=0.02),), dead_time=5e-4)
    >>> mine, theirs = found(0.05, 5e-4), members(same)
    >>> [round(x, 6) for x in mine["dynamics.section"][0]], [round(x, 6) for x in theirs["dynamics.section"][0]]
    ([-0.000103, 0.09578, -1.890238, 0.987512], [-0.000103, 0.09578, -1.890238, 0.987512])
    """
    w = 2 * math.pi * frequency
    w0 = w / tick
    integral, step, rate = _step_of_mode(w)
    drag, pulse = 2 * FOUND_DAMPING * w, rate / (w * w)
    kept = 1 - step - drag * pulse  # of a velocity, whose way is `pulse`
    still = step * (step + drag * pulse) + pulse * rate
    a1 = -(1 - step + kept)
    a2 = still - (1 + a1)
    from_rate, from_place = step / (w * w) * rate, 1 - integral
    b0, b1 = integral, integral * a1 + from_place * step + from_rate
    b2 = integral * a2 - from_place * (kept * step - pulse * rate) - from_rate
    direct, (first, second, _, _) = b2 / a2, lead_of_dead_time(dead)
    n0, n1, n2 = notch = [1 / still, a1 / still, a2 / still]
    d1, d2, d3 = n1 - 2 * n0, n2 - 2 * n1 + n0, n1 - 2 * n2  # the second difference behind the notch
    gain = math.sqrt((n0 * n0 + d1 * d1 + d2 * d2 + d3 * d3 + n2 * n2) / 6)
    return {
        "dynamics.known": True,
        "dynamics.sections": 1,
        "dynamics.section": [[b0 - direct, b1 - direct * a1, a1, a2]],
        "dynamics.direct": [direct, 0.0, 0.0],
        "dynamics.dead": dead,
        "dynamics.notch": notch,
        "dynamics.modes": 0,
        "dynamics.mode": [],
        "dynamics.quiet": [n / gain for n in notch],
        "dynamics.tap": [b0 / still, b1 / still, b2 / still, 0.0, 0.0],
        "dynamics.others": 0,
        "dynamics.rest": [],
        "dynamics.amplifier": 0.0,
        "dynamics.lead": [
            2 * FOUND_DAMPING / w0 + first * tick,
            1 / (w0 * w0) + first * (2 * FOUND_DAMPING * tick / w0) + second * (tick * tick),
        ],
        "dynamics.sensor": [0.0, 0.0],
    }


def _sampled(
    dynamics: Dynamics,
) -> tuple[list[tuple[float, float]], int, FloatArray, ComplexArray, ComplexArray]:
    """Denominators, whole ticks of dead time, frequencies, Hz, exp(-j w T) there, and S G without those ticks."""
    dead = max(0, math.floor((dynamics.dead_time + dynamics.sensor_delay) * dynamics.sample_rate + 1e-9))
    f = (np.arange(POINTS) + 0.5) / POINTS * dynamics.sample_rate / 2
    q = np.exp(-2j * math.pi * f / dynamics.sample_rate)
    return _sections(dynamics), dead, f, q, dynamics.response(f, sensor=True) / q**dead


def kept_by_amplifier(dynamics: Dynamics) -> float:
    """Share of the voltage of the last tick that the lag of the amplifier keeps; 0: it has none."""
    corner = dynamics.amplifier_bandwidth
    return _kept(corner, dynamics.sample_rate) if corner else 0.0


def _kept(corner: float, rate: float) -> float:
    """Share of a tick before that a first-order lag keeps: its pole."""
    return math.exp(-2 * math.pi * corner / rate)


def _undone(kept: float, q: ComplexArray) -> ComplexArray:
    """From the voltage of the stack at the end of a tick to that of the amplifier's input in it, at q = exp(-j w T)."""
    return (1 - kept * q) / (1 - kept)


def of_strain(dynamics: Dynamics, frequency: FloatArray, *, amplifier: bool = False) -> ComplexArray:
    """From the strain at the end of a tick to the displacement: G, or G without the lag of the amplifier."""
    found, kept = dynamics.response(frequency), kept_by_amplifier(dynamics)
    if kept > 0 and not amplifier:
        found *= _undone(kept, np.exp(-2j * math.pi * frequency / dynamics.sample_rate))
    return found


def through(dynamics: Dynamics, strain: FloatArray) -> FloatArray:
    """What the sensor reads where the hysteresis gives a strain: S G, along axis 0; at rest before the first sample.

    Parameters
    ----------
    dynamics : Dynamics
        Of the stage, with the sample rate of the strain.
    strain : ndarray, shape (samples, ...)
        um, or any other unit.

    Returns
    -------
    ndarray, shape (samples, ...)
        In the same unit.

    Examples
    --------
    A step overshoots by exp(-pi zeta) of its height, nearly:

    >>> from truestroke.model.dynamics import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=200.0, damping=0.1),))
    >>> moved = through(stage, np.minimum(np.arange(3000.0), 1.0))
    >>> round(float(moved.max()), 2), round(float(moved[-1]), 4)
    (1.73, 1.0)
    """
    from scipy.signal import lfilter

    direct, own, dead = difference_equation(dynamics)
    rest = strain[:1]
    u = strain - rest
    if dead:
        u = np.concatenate([np.zeros_like(u[:dead]), u[: max(len(u) - dead, 0)]])
    parts = [lfilter([b0, b1], [1.0, a1, a2], u, axis=0) for b0, b1, a1, a2 in own]
    taps = [np.concatenate([np.zeros_like(u[:k]), tap * u[: max(len(u) - k, 0)]]) for k, tap in enumerate(direct)]
    return np.asarray(rest + sum(taps) + sum(parts))


def difference_equation(dynamics: Dynamics) -> tuple[FloatArray, FloatArray, int]:
    """S G: taps, rows b0, b1, a1, a2 of the sections beside them, and whole ticks of dead time before both."""
    sections, dead, _, q, G = _sampled(dynamics)
    direct, own = _numerators(G, q, sections, DIRECT)
    return np.array(direct), np.array(own), dead


def _sections(dynamics: Dynamics) -> list[tuple[float, float]]:
    """a1, a2 of 1 + a1 q^-1 + a2 q^-2: of each mode, and of each lag, whose a2 is 0."""
    found = [_poles(mode.frequency, mode.damping, dynamics.sample_rate) for mode in dynamics.modes]
    lags: list[float] = []
    for corner in (dynamics.amplifier_bandwidth, dynamics.sensor_bandwidth):
        if corner:
            pole = _kept(corner, dynamics.sample_rate)
            lags.append(pole * (1 - APART) if any(abs(pole - lag) < APART * lag for lag in lags) else pole)
    return found + [(-pole, 0.0) for pole in lags]


def _poles(frequency: float, damping: float, rate: float) -> tuple[float, float]:
    """a1, a2 of 1 + a1 q^-1 + a2 q^-2 of a mode."""
    w = 2 * math.pi * frequency / rate
    radius = math.exp(-damping * w)
    return -2 * radius * math.cos(w * math.sqrt(1 - damping**2)), radius**2


def _noise_gain(taps: FloatArray) -> float:
    """By how much the second difference of white noise is larger behind taps than before."""
    second = np.array([1.0, -2.0, 1.0])
    return float(np.linalg.norm(np.convolve(second, taps)) / np.linalg.norm(second))


def _polynomial(coefficients: FloatArray, q: ComplexArray) -> ComplexArray:
    return np.asarray(np.polyval(coefficients[::-1], q))


def _numerators(
    response: ComplexArray,
    q: ComplexArray,
    sections: Sequence[tuple[float, float]],
    taps: int,
    weight: FloatArray | float = 1.0,
) -> tuple[list[float], list[list[float]]]:
    """Taps, and [b0, b1, a1, a2] of each section, whose sum is the response at q = exp(-j w T)."""
    columns = [q**k for k in range(taps)]
    for a1, a2 in sections:
        denominator = 1 + a1 * q + a2 * q * q
        columns += [1 / denominator, q / denominator] if a2 else [1 / denominator]
    basis = np.array(columns).T * np.reshape(weight, (-1, 1)) * np.ones((q.size, 1))
    scale, wanted = np.abs(basis).max(axis=0), response * weight
    equations = np.vstack([basis.real, basis.imag]) / scale
    numbers = np.linalg.lstsq(equations, np.concatenate([wanted.real, wanted.imag]), rcond=None)[0] / scale
    if (error := float(np.abs(basis @ numbers - wanted).max())) > EXACT:
        words = "of poles that are further apart: leave out the mode or lag that matters least"
        raise SettingError("dynamics", f"an error of {error:.2g} in their difference equation", words)
    found, rest = [], numbers[taps:].tolist()
    for a1, a2 in sections:
        b0, b1 = rest.pop(0), rest.pop(0) if a2 else 0.0
        found.append([b0, b1, a1, a2])
    return numbers[:taps].tolist(), found


def _slow(dynamics: Dynamics) -> FloatArray:
    return np.array(SLOW) * dynamics.modes[0].frequency


def _expansion(response: ComplexArray, dynamics: Dynamics) -> list[float]:
    """c1 (s) and c2 (s^2) of 1 + c1 s + c2 s^2 near 0 Hz, from the response at `_slow`."""
    w = 2 * math.pi * _slow(dynamics)
    first, second = response.imag / w, (1 - response.real) / w**2
    r = (w[1] / w[0]) ** 2  # the next terms are of the order w^2 times these: extrapolated to 0 Hz
    return [float((r * c[0] - c[1]) / (r - 1)) for c in (first, second)]


def strain_of(dynamics: Dynamics | None, position: FloatArray) -> FloatArray | None:
    """`strain`; None where the dynamics are not known."""
    return None if dynamics is None else strain(dynamics, position)


def strain(dynamics: Dynamics, position: FloatArray, *, amplifier: bool = False) -> FloatArray:
    """The strain G^-1 z_d that the hysteresis should give so that the stage moves as desired.

    The whole motion is known: the inverse looks ahead, by as much as the stage is late. Frequencies above 2.5 first
    resonances are inverted less and less, above 4 they are left out. Where that strain is twice as large as the motion,
    as of a sharp one that meets a zero between two modes, the bounds are 1.5 and 2.5 first resonances.

    Parameters
    ----------
    dynamics : Dynamics
        Of the stage, with the sample rate of the motion.
    position : ndarray, shape (ticks,)
        Desired displacement z_d, um; at rest before the first tick.
    amplifier : bool
        Whether its lag is in G. If not, the strain is that at the end of each tick, and the voltage undoes the lag.

    Returns
    -------
    ndarray, shape (ticks,)
        um

    Examples
    --------
    A sine of half the resonance needs three quarters of its amplitude, and 0.4 % for the hold of each tick:

    >>> from truestroke.model.dynamics import Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.001),))
    >>> time = np.arange(20000) / 10000.0
    >>> wave = np.clip(time / 0.5, 0, 1) * np.sin(2 * np.pi * 350.0 * time)
    >>> round(float(np.abs(strain(stage, wave)[10000:15000]).max()), 3)
    0.753
    """
    *wider, narrowest = INVERTED
    for bounds in wider:
        found = strain_within(dynamics, position, bounds, amplifier=amplifier)
        if np.ptp(found) <= AMPLE * np.ptp(position):
            return found
    return strain_within(dynamics, position, narrowest, amplifier=amplifier)


def strain_within(
    dynamics: Dynamics, position: FloatArray, bounds: tuple[float, float], *, amplifier: bool = False
) -> FloatArray:
    """`strain` with these bounds, in first resonances; of a long motion in blocks, for their memory."""
    rate = dynamics.sample_rate
    low, high = _bounds(rate, dynamics.modes[0].frequency, bounds)
    margin = math.ceil(FADED / (high - low) * rate)
    size = max(BLOCK, 2 ** math.ceil(math.log2(6 * margin)))
    quiet, step = margin, size - 3 * margin
    if position.size <= size:
        quiet, step = round(QUIET * rate), position.size
        size = 2 ** math.ceil(math.log2(step + 2 * quiet))
    inverted = functools.partial(
        _inverse, rate, dynamics.modes, dynamics.amplifier_bandwidth, dynamics.dead_time, size, bounds
    )
    found = np.empty(position.size)
    for start in range(0, position.size, step):
        spectrum = np.fft.rfft(_extended(position, start - quiet, size, rate))
        for one in range(0, spectrum.size, KEPT):
            spectrum[one : one + KEPT] *= inverted(one, amplifier=amplifier)
        found[start : start + step] = np.fft.irfft(spectrum, size)[quiet : quiet + min(step, position.size - start)]
    return found


def _extended(position: FloatArray, first: int, size: int, rate: float) -> FloatArray:
    """So many ticks of a motion, from tick `first` on: at rest before it, and behind it on its way back."""
    made = np.full(size, position[0])
    known = position[max(first, 0) : first + size]
    ends = max(-first, 0) + known.size
    made[ends - known.size : ends] = known
    _way_back(position, made[ends:], rate)
    return made


def _bounds(rate: float, first: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """Frequencies up to which a stage is inverted in full, and above which it is not, Hz."""
    low, high = (min(a * first, b * rate) for a, b in zip(bounds, VISIBLE, strict=True))
    return low, high


@functools.lru_cache(maxsize=8)  # of one motion and of those of the axes beside it, of 4 million ticks
def _inverse(
    rate: float,
    modes: tuple[Mode, ...],
    bandwidth: float,
    dead_time: float,
    size: int,
    bounds: tuple[float, float],
    start: int,
    *,
    amplifier: bool,
) -> ComplexArray:
    """1 / G of these dynamics at frequencies of so many ticks, from one on, 0 where it is left out."""
    dynamics = Dynamics(sample_rate=rate, modes=modes, amplifier_bandwidth=bandwidth, dead_time=dead_time)
    first = modes[0].frequency
    f = np.fft.rfftfreq(size, 1 / rate)[start : start + KEPT]
    low, high = _bounds(rate, first, bounds)
    passed = 0.5 + 0.5 * np.cos(math.pi * np.clip((f - low) / (high - low), 0.0, 1.0))
    inverse = np.zeros_like(passed, dtype=complex)
    inside = passed > 0
    inverse[inside] = passed[inside] / of_strain(dynamics, f[inside], amplifier=amplifier)
    inverse.flags.writeable = False
    return inverse


def _way_back(position: FloatArray, into: FloatArray, rate: float) -> None:
    """From the end of a motion to its start, so that it is periodic: the last velocity decays, then a smooth move."""
    ticks = into.size
    decay = 0.01 * rate  # ticks
    last = position[-1] - position[-2] if position.size > 1 else 0.0
    for start in range(0, ticks, KEPT):
        after = np.arange(start + 1, min(start + KEPT, ticks) + 1)
        along = position[-1] + last * decay * -np.expm1(-after / decay)
        u = np.clip(2 * after / ticks - 1, 0.0, 1.0)
        back = u**3 * (10.0 + u * (6.0 * u - 15.0))
        into[start : start + KEPT] = along * (1 - back) + position[0] * back


class Stage:
    """The stage in the loop, tick by tick: what the kernel does in `expected`, `notched` and `pass_stage`.

    Parameters
    ----------
    known : mapping
        What `members` gave.
    parameters : int
        Number of weights.

    Attributes
    ----------
    strain : dict of int to float
        Of the ticks that were commanded: what the model's hysteresis gives, um.
    ticks : int
        Whose measurement was used, or passed over.
    """

    def __init__(self, known: dict[str, Any], parameters: int) -> None:
        get = {name.removeprefix("dynamics."): value for name, value in known.items()}
        self.dead: int = get["dead"]
        self._sections, self._direct, self._notch = get["section"], get["direct"], get["notch"]
        self._tap, self._rest, self.lead, self.sensor = get["tap"], get["rest"], get["lead"], get["sensor"]
        self._quiet = get["quiet"]
        self._modes, self._mode_states = get["mode"], [[0.0, 0.0] for _ in get["mode"]]
        self.strain: dict[int, float] = {}
        self.ticks = 0
        self._outputs = [[0.0, 0.0] for _ in self._sections]
        self._z = [0.0, 0.0]
        self._innovation = [0.0, 0.0]
        self._taps = np.zeros((TAPS, parameters))  # the last row stays 0
        self._states = np.zeros((len(self._rest), 2, parameters))
        self._started = False
        self._rests = True  # before the first regressor: noise of which a part alone is filtered would be a jump

    def go_on(self, ticks: int, strain: dict[int, float], z: tuple[float, float]) -> None:
        """After so many ticks, of which these are the last strains and the last two measurements, um: it rings on."""
        self.ticks, self.strain, self._z, self._rests = ticks, strain, list(z), False
        before = [self._strain(self.dead + 1 + i) for i in range(len(z))]
        self._outputs = [[y - self._direct[0] * x for x, y in zip(before, z, strict=True)]]

    def rest(self, ticks: int, strain: dict[int, float], z: tuple[float, float]) -> None:
        """The same, as if the stage had rested where the last measurement is."""
        self.ticks, self.strain, self._z, self._rests = ticks, strain, list(z), False
        self._rest_sections(self._strain(self.dead + 1))
        for (_, b1, b2, a1, a2), x in zip(self._modes, self._mode_states, strict=True):
            x[1] = (b2 - a2) * z[0]
            x[0] = (b1 - a1) * z[0] + x[1]

    def stand(self) -> None:
        """Until the first regressor it is at rest, as at the start."""
        self._rests = True

    def _strain(self, back: int) -> float:
        """So many ticks before the one that is measured next; at rest before the first one. um."""
        return self.strain[max(self.ticks - back, 0)]

    def _rest_sections(self, strain: float) -> None:
        """The states of G after a long rest with this strain, um."""
        for (b0, b1, a1, a2), y in zip(self._sections, self._outputs, strict=True):
            y[0] = y[1] = (b0 + b1) * strain / (1 + a1 + a2)

    @property
    def z(self) -> tuple[float, float]:
        """The last two measurements, um, the newer first."""
        return self._z[0], self._z[1]

    def expected(self) -> float:
        """G: the measurement that the model expects of the next tick, um. At rest before the first one."""
        u = [self._strain(self.dead + i) for i in range(4)]
        if self.ticks == 0:
            self._rest_sections(u[0])
        z = 0.0
        for (b0, b1, a1, a2), y in zip(self._sections, self._outputs, strict=True):
            y[0], y[1] = b0 * u[0] + b1 * u[1] - a1 * y[0] - a2 * y[1], y[0]
            z += y[0]
        for tap, entry in zip(self._direct, u, strict=False):
            z += tap * entry
        return z

    def quiet(self, innovation: float) -> float:
        """The innovation without the first mode, as noisy as it was, um: ringing that the model knows is no noise."""
        before = self._innovation
        return float(self._quiet[0] * innovation + self._quiet[1] * before[0] + self._quiet[2] * before[1])

    def remember(self, innovation: float) -> None:
        """The innovation of the tick, um."""
        self._innovation = [innovation, self._innovation[0]]

    def notched(self, z: float) -> float:
        """A: the measurement without the modes, um; the next tick."""
        if self._rests:
            self._z = [z, z]
        y: float = self._notch[0] * z + self._notch[1] * self._z[0] + self._notch[2] * self._z[1]
        self._z = [z, self._z[0]]
        for (b0, b1, b2, a1, a2), x in zip(self._modes, self._mode_states, strict=True):
            if self._rests:
                x[1] = (b2 - a2) * y
                x[0] = (b1 - a1) * y + x[1]
            before, y = y, b0 * y + x[0]
            x[0], x[1] = b1 * before - a1 * y + x[1], b2 * before - a2 * y
        self.strain.pop(self.ticks - max(self.dead, MOST_DEAD) - 4, None)  # another stage may be later
        self.ticks += 1
        return y

    def passed(self, u: FloatArray) -> FloatArray:
        """A G: the regressor as the measurement without the modes shows it; at rest before the first tick."""
        s, tap = self._taps, self._tap
        self._rests = False
        if not self._started:
            for k in range(TAPS - 2, -1, -1):
                s[k] = s[k + 1] + tap[k + 1] * u
        y = s[0] + tap[0] * u
        for k in range(TAPS - 1):
            s[k] = s[k + 1] + tap[k + 1] * u
        for (b0, b1, a1, a2), t in zip(self._rest, self._states, strict=True):
            if not self._started:
                rest = 0.0 + (b0 + b1) / (1 + a1 + a2) * u
                t[1] = 0.0 + -a2 * rest
                t[0] = t[1] + b1 * u + -a1 * rest
            out = t[0] + b0 * u
            t[0] = t[1] + b1 * u + -a1 * out
            t[1] = 0.0 + -a2 * out
            y = y + 1.0 * out
        self._started = True
        return np.asarray(y)
