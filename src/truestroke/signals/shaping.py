"""Moves from rest to rest that do not excite the resonances of a stage: polynomials and input shapers.

A second-order mode with the pole p = -zeta w + j w sqrt(1 - zeta^2) that follows a move z(t) of duration D swings, when
the move has ended, with the amplitude

    A = abs(integral from 0 to D of z'(t) exp(p (D - t)) dt) / sqrt(1 - zeta^2)

of its height. A is 0 where the Laplace transform of the velocity z' has a zero at p. With a double zero A rises with
the square of the error of p: the move also settles where the resonance is not exactly known.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import Legendre

from truestroke.base import checks
from truestroke.base.typing import FloatArray
from truestroke.model.dynamics import EXPECTED, Dynamics, Mode, zeros_of

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""Position, um; velocity, um/s; acceleration, um/s^2."""

PERIODS = 1.4  # of the first mode: duration of a polynomial move; shorter ones go far back on their way
TURNS = 1.8  # of the first mode: duration of a turn; beyond 2.5 f0 it has a fifth of what one of 1.4 periods has
TURNING = 0.4  # share of the period that turns longer than 1.4 periods may take
SHORT_RISE = 0.25  # periods of the first mode: duration of the move that a shaper repeats
SMOOTH = 6.0  # periods of a mode in a move: in a longer one it is hardly excited, whatever the shape
LONGER = 1.02  # factor from one duration that is tried to the next
SETTLED = 0.01  # of the height of a step: vibration after it, with resonances that are known within `KNOWN`
DAMPED = 0.1  # damping of a first mode that forgets by itself: exact zeros at it would make the move swing
KNOWN = 0.05  # relative: error of the resonances up to which a step settles
VIBRATION = 1e-3  # of the height: vibration of a further mode that counts as much as the others below
WRONG = 0.02  # relative: error of the frequency of a further mode whose vibration counts as well
RINGING = 1e-2  # of the height: strain that rings at a zero between the modes
JERK = 200.0  # of the height, over the cube of the duration, rms: a minimum-jerk move has 27
FURTHER = 4  # polynomials more than there are conditions
SHAPERS = ("zv", "zvd", "ei")
SHAPES = ("polynomial", *SHAPERS)


@dataclass(frozen=True, eq=False)
class Move:
    """A move from 0 to 1, at rest before and after: a polynomial, repeated with the impulses of a shaper.

    Attributes
    ----------
    polynomial : numpy.polynomial.Legendre
        s(u) for u from 0 to 1, from 0 to 1.
    rise : float
        Duration of the polynomial, s.
    impulses : tuple of (float, float)
        Amplitude, without unit, and delay, s, of each repetition; the amplitudes add up to 1.
    """

    polynomial: Legendre
    rise: float
    impulses: tuple[tuple[float, float], ...] = ((1.0, 0.0),)

    @property
    def duration(self) -> float:
        """From rest to rest, s."""
        return self.rise + self.impulses[-1][1]

    def at(self, time: FloatArray) -> Motion:
        """Position, velocity (1/s) and acceleration (1/s^2) at these times from its beginning, s."""
        first, second = self.polynomial.deriv(), self.polynomial.deriv(2)
        position, velocity, acceleration = (np.zeros_like(time) for _ in range(3))
        for amplitude, delay in self.impulses:
            u = (time - delay) / self.rise
            inside, over = (u > 0) & (u < 1), u >= 1
            position[over] += amplitude
            position[inside] += amplitude * self.polynomial(u[inside])
            velocity[inside] += amplitude / self.rise * first(u[inside])
            acceleration[inside] += amplitude / self.rise**2 * second(u[inside])
        return position, velocity, acceleration

    def integral(self, time: FloatArray) -> FloatArray:
        """Integral of the position from the beginning of a move without a shaper, s, at times within it."""
        return np.asarray(self.rise * self.polynomial.integ(lbnd=0)(time / self.rise))

    def peaks(self) -> tuple[float, float]:
        """Largest absolute velocity, 1/s, and acceleration, 1/s^2."""
        _, velocity, acceleration = self.at(np.linspace(0.0, self.duration, 2001))
        return float(np.abs(velocity).max()), float(np.abs(acceleration).max())

    def vibration(self, frequency: float, damping: float = 0.0) -> float:
        """Amplitude A of a mode after the move, as a part of the height of the move.

        Parameters
        ----------
        frequency, damping : float
            Undamped natural frequency, Hz, and zeta of the mode.

        Examples
        --------
        >>> move = minimum_jerk(1e-3)  # the longer it is, the less it excites
        >>> [round(move.vibration(frequency), 3) for frequency in (100.0, 700.0, 2000.0)]
        [0.993, 0.698, 0.029]
        """
        return abs(_transform(self, _pole(frequency, damping))) / math.sqrt(1 - damping**2)


def minimum_jerk(duration: float) -> Move:
    """The move 6 u^5 - 15 u^4 + 10 u^3 with u = t / duration, s.

    >>> minimum_jerk(0.1).at(np.array([0.0, 0.05, 0.1]))[0].round(6).tolist()
    [0.0, 0.5, 1.0]
    """
    return Move(_solved(duration, [], ends=2, centred=False), duration)


def settling_move(
    dynamics: Dynamics, shape: str = "polynomial", *, velocity: float = math.inf, acceleration: float = math.inf
) -> Move:
    """The shortest move of a shape after which the stage is at rest, also where its first mode is known within 5 %.

    Parameters
    ----------
    dynamics : Dynamics
        Modes of the stage.
    shape : str
        "polynomial": s'(u) = (u (1 - u))^3 times the polynomial of least degree for which the transform of the velocity
        has a double zero at the pole of the first mode. With further modes, or a damping above 0.1, it has the least
        sum of squares of what they vibrate, of the strain that rings at the zeros between the modes, where a controller
        that inverts the dynamics needs much of it, and of the jerk: exact zeros at all would shake the stage by many
        times the height.
        It takes 1.4 periods of the first mode, or, with further modes, as long as it needs to settle within 1 %. Its
        jerk is continuous, so that the samples of its acceleration, which a controller that inverts the dynamics
        sends, excite nothing either. "zv", "zvd", "ei": a minimum-jerk move of a quarter of a period, repeated
        with the `impulses` of the shaper; they take 0.75, 1.25 and 1.25 periods.
    velocity, acceleration : float
        Largest values that are allowed, of a move of height 1, 1/s and 1/s^2: the move takes as long as they demand.

    Returns
    -------
    Move

    Raises
    ------
    SettingError
        An argument is out of its bounds.

    Examples
    --------
    >>> from truestroke.model.dynamics import Dynamics, Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
    >>> for shape in SHAPES:
    ...     move = settling_move(stage, shape)
    ...     known, wrong = (100 * move.vibration(frequency, 0.02) for frequency in (700.0, 735.0))
    ...     print(f"{shape:10} {1000 * move.duration:.2f} ms; at 700 Hz {known:.2f} %, at 735 Hz {wrong:.2f} %")
    polynomial 2.00 ms; at 700 Hz 0.00 %, at 735 Hz 0.51 %
    zv         1.07 ms; at 700 Hz 0.00 %, at 735 Hz 7.11 %
    zvd        1.79 ms; at 700 Hz 0.00 %, at 735 Hz 0.54 %
    ei         1.79 ms; at 700 Hz 0.88 %, at 735 Hz 0.33 %
    """
    checks.instance("settle", dynamics, Dynamics, EXPECTED)
    checks.one_of("shape", shape, SHAPES)
    period = 1 / dynamics.modes[0].frequency
    rise = PERIODS * period if shape == "polynomial" else SHORT_RISE * period
    while True:
        move = _of_rise(dynamics, shape, rise)
        faster, harder = np.divide(move.peaks(), (velocity, acceleration))
        if faster <= 1 and harder <= 1 and (shape != "polynomial" or _settles(move, dynamics)):
            return move
        rise *= LONGER


def _settles(move: Move, dynamics: Dynamics) -> bool:
    """Whether the vibration after a move is small, also where all resonances are known within `KNOWN` only."""
    for factor in (1 - KNOWN, 1 + KNOWN):
        each = [abs(mode.share) * move.vibration(factor * mode.frequency, mode.damping) for mode in dynamics.modes]
        if sum(each) > SETTLED:
            return False
    return True


def _of_rise(dynamics: Dynamics, shape: str, rise: float) -> Move:
    if shape == "polynomial":
        return Move(_without_vibration(dynamics, rise, ends=3, centred=False), rise)
    repeated = impulses(dynamics.modes[0], shape)
    return Move(minimum_jerk(rise).polynomial, rise, repeated)


def turn_time(dynamics: Dynamics, frequency: float) -> float:
    """Duration of a turn between lines of so many periods per second, s, that leaves no vibration.

    1.8 periods of the first mode; less where both turns would take more than 0.4 of the period, but at least 1.4.

    Examples
    --------
    >>> from truestroke.model.dynamics import Dynamics, Mode
    >>> stage = Dynamics(sample_rate=10000.0, modes=(Mode(frequency=700.0, damping=0.02),))
    >>> [round(700.0 * turn_time(stage, frequency), 3) for frequency in (10.0, 90.0, 200.0)]
    [1.8, 1.556, 1.4]
    """
    period = 1 / dynamics.modes[0].frequency
    return max(PERIODS * period, min(TURNS * period, TURNING / (2 * frequency)))


def reversal(duration: float, dynamics: Dynamics | None = None) -> Move:
    """The course of a turn: the velocity goes from v to -v as v (1 - 2 s(u)), and the line back begins where it ended.

    s'(u) = (u (1 - u))^2 times a polynomial, so that the jerk is continuous; the integral of s is 1/2. With dynamics
    the polynomial is that of `settling_move`: the turn leaves no vibration.

    >>> turn = reversal(1e-3)
    >>> [round(float(s), 4) for s in turn.at(np.array([0.0, 2.5e-4, 5e-4, 1e-3]))[0]]
    [0.0, 0.1035, 0.5, 1.0]
    """
    if dynamics is None:
        return Move(_solved(duration, [], ends=2, centred=True), duration)
    return Move(_without_vibration(dynamics, duration, ends=2, centred=True), duration)


def impulses(mode: Mode, shaper: str, tolerance: float = 0.01) -> tuple[tuple[float, float], ...]:
    """Amplitudes and delays, s, of an input shaper for a mode: every move that passes it leaves no vibration.

    ::

        "zv"   1, K               at 0, T/2         zero vibration
        "zvd"  1, 2 K, K^2        at 0, T/2, T      its derivative is zero, too
        "ei"   (1 + V)/4, K (1 - V)/2, K^2 (1 + V)/4   at 0, T/2, T   extra-insensitive: V remains at the mode

    each divided by its sum, with K = exp(-pi zeta / sqrt(1 - zeta^2)), T the period of the damped mode and V the
    tolerance [@singer1990; @singhose1994]. The amplitudes of "ei" are those of an undamped mode times powers of K.

    Examples
    --------
    >>> from truestroke.model.dynamics import Mode
    >>> [(round(a, 3), round(1000 * t, 3)) for a, t in impulses(Mode(frequency=500.0, damping=0.05), "zvd")]
    [(0.291, 0.0), (0.497, 1.001), (0.212, 2.003)]
    """
    K = math.exp(-math.pi * mode.damping / math.sqrt(1 - mode.damping**2))
    half = 0.5 / (mode.frequency * math.sqrt(1 - mode.damping**2))
    V = checks.within("tolerance", tolerance, 0.0, 0.5)
    weights = {"zv": (1, K), "zvd": (1, 2 * K, K**2), "ei": ((1 + V) / 4, K * (1 - V) / 2, K**2 * (1 + V) / 4)}
    chosen = weights[checks.one_of("shaper", shaper, SHAPERS)]
    return tuple((amplitude / sum(chosen), i * half) for i, amplitude in enumerate(chosen))


# ---- Zeros of the transform ------------------------------------------------------------------------------------------


def _pole(frequency: float, damping: float) -> complex:
    w = 2 * math.pi * frequency
    return complex(-damping * w, w * math.sqrt(1 - damping**2))


Zero = tuple[complex, int]
"""Where a transform is 0, and how often."""
Weight = tuple[complex, int, float]
"""Where a transform or a derivative is to be small: a root, the order of the derivative, and how small, inverted."""


def _without_vibration(dynamics: Dynamics, duration: float, *, ends: int, centred: bool) -> Legendre:
    """s(u) of a move of this duration, s, after which the modes are at rest."""
    zeros, small = list[Zero](), list[Weight]()
    for i, mode in enumerate(dynamics.modes):
        pole, share = _pole(mode.frequency, mode.damping), abs(mode.share)
        if mode.frequency * duration >= SMOOTH:
            continue
        if i == 0 and mode.damping <= DAMPED:
            zeros.append((pole, 2))
        else:
            small += [(pole, 0, share / VIBRATION), (pole, 1, share * WRONG * abs(pole) * duration / VIBRATION)]
    for zero in map(complex, zeros_of(dynamics.modes)):
        if zero.imag > 0 and abs(zero) * duration < 2 * math.pi * SMOOTH:
            small.append((zero, 0, _ringing(dynamics.modes, zero) / RINGING))
    return _solved(duration, zeros, small, ends=ends, centred=centred)


def _ringing(modes: Sequence[Mode], zero: complex) -> float:
    """Amplitude of the strain that rings at a zero of the modes, over the transform of the velocity there."""
    slope = 0j
    for mode in modes:
        w = 2 * math.pi * mode.frequency
        slope -= mode.share * w**2 * 2 * (zero + mode.damping * w) / (zero**2 + 2 * mode.damping * w * zero + w**2) ** 2
    return 2 / abs(zero * slope)


@cache
def _quadrature() -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of Gauss's quadrature from 0 to 1: not at the import, of which this was a fortieth."""
    nodes, weights = (0.5 * part for part in np.polynomial.legendre.leggauss(80))
    return nodes + 0.5, weights


def _transform(move: Move, pole: complex) -> complex:
    """Integral of z'(t) exp(p (D - t)) dt."""
    parts = 1 + int(abs(pole) * move.rise / 30)  # of a few periods each, which the quadrature resolves
    nodes, weights = _quadrature()
    u = (np.arange(parts)[:, None] + nodes) / parts
    of_one = np.sum(move.polynomial.deriv()(u) * weights / parts * np.exp(pole * move.rise * (1 - u)))
    end = move.duration - move.rise
    return complex(sum(a * of_one * cmath.exp(pole * (end - delay)) for a, delay in move.impulses))


@cache
def _parts(number: int, ends: int) -> tuple[list[Legendre], FloatArray]:
    """So many polynomials (u (1 - u))^ends times one of Legendre, and their values at the nodes of the quadrature.

    They were four fifths of the time of a move, each of whose durations that are tried asks for them.
    """
    u = Legendre.identity(domain=[0, 1])
    parts = [(u * (1 - u)) ** ends * Legendre.basis(i, domain=[0, 1]) for i in range(number)]
    nodes, _ = _quadrature()
    return parts, np.array([part(nodes) for part in parts])


def _solved(
    duration: float, zeros: Sequence[Zero], small: Sequence[Weight] = (), *, ends: int, centred: bool
) -> Legendre:
    """s(u) from 0 to 1: s' = (u (1 - u))^ends times a polynomial, with these zeros of its transform.

    Of least degree; or, where it is to be small elsewhere, with the least sum of squares of that and of the jerk.
    `centred`: the integral of s from 0 to 1 is 1/2.
    """
    least = 1 + centred + 2 * sum(order for _, order in zeros)
    parts, rates = _parts(least + (2 * len(small) + FURTHER if small else 0), ends)
    nodes, weights = _quadrature()
    rows, wanted = [rates @ weights], [1.0]
    if centred:
        rows.append(rates @ (weights * (1 - nodes)))  # the integral of s, by parts
        wanted.append(0.5)
    for pole, order in zeros:
        for power in range(order):
            moments = rates @ (weights * nodes**power * np.exp(pole * duration * (1 - nodes)))
            rows += [moments.real, moments.imag]
            wanted += [0.0, 0.0]
    matrix = np.array(rows)
    scale = np.abs(matrix).max(axis=1)
    exact = matrix / scale[:, None], np.array(wanted) / scale
    if small:
        each = [rates @ (w * weights * (1 - nodes) ** n * np.exp(at * duration * (1 - nodes))) for at, n, w in small]
        jerks = np.array([part.deriv(2)(nodes) for part in parts]) * np.sqrt(weights) / JERK
        factors = _least_squares(*exact, np.array([row for one in each for row in (one.real, one.imag)] + [*jerks.T]))
    else:
        factors = np.linalg.solve(*exact)
    rate: Legendre = sum((c * part for c, part in zip(factors[1:], parts[1:], strict=True)), factors[0] * parts[0])
    whole: Legendre = rate.integ(lbnd=0)
    return whole


def _least_squares(matrix: FloatArray, wanted: FloatArray, small: FloatArray) -> FloatArray:
    """x with matrix @ x = wanted and the least sum of squares of small @ x."""
    count = wanted.size
    q, r = np.linalg.qr(matrix.T, mode="complete")
    x = q[:, :count] @ np.linalg.solve(r[:count].T, wanted)
    free = q[:, count:]
    return np.asarray(x - free @ np.linalg.lstsq(small @ free, small @ x, rcond=None)[0])
