"""What to compare with: a straight line, a PID with the tuning of a textbook, and a projected law for the inverse.

The other controllers of the comparison are the paper's inverse with other settings or laws: see `studies.compare`.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import FloatArray

FADED = 1e-6  # V^2: a trace of R below it is memory no more

GAINS = {"k_p": "V/um", "k_i": "V/(um s)", "k_d": "V s/um", "T_f": "s"}  # and their units


class ConstantGain(Displayed):
    """No compensation: the voltage is that of a straight line, x = (z_d - offset) / sensitivity.

    Parameters
    ----------
    sensitivity : float
        Slope of the line, um/V, above 0.
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V.
    offset : float
        Displacement of the line at 0 V, um: it runs through the middle of the loop, which begins at its edge.

    Examples
    --------
    >>> ConstantGain(12.5, voltage_limits=(-0.6, 3.6)).command(25.0, 0.0)
    2.0
    """

    def __init__(self, sensitivity: float, voltage_limits: tuple[float, float], offset: float = 0.0) -> None:
        self.offset = checks.number("offset", offset, "um")
        self.sensitivity = checks.positive("sensitivity", sensitivity, "um/V")
        self.voltage_limits = checks.interval("voltage_limits", voltage_limits, "V")

    def _display(self) -> tuple[str, Rows]:
        values = {"sensitivity": "um/V", "offset": "um", "voltage_limits": "V"}
        return "ConstantGain", [(name, quantity(getattr(self, name), unit)) for name, unit in values.items()]

    def command(self, z_d: float, zdot_d: float) -> float:
        """Voltage, V, for the desired displacement, um; the velocity is not used."""
        low, high = self.voltage_limits
        return min(max((checks.number("z_d", z_d, "um") - self.offset) / self.sensitivity, low), high)

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Nothing: it does not learn."""


@dataclass(frozen=True, kw_only=True)
class PidGains:
    """Gains of a `Pid`: C(s) = (k_p + k_i / s + k_d s) / (1 + T_f s)^2.

    Attributes
    ----------
    k_p, k_i, k_d : float
        V/um, V/(um s) and V s/um, each 0 or more.
    T_f : float
        Time constant of the filter of the error, s, 0 or more.
    """

    k_p: float
    k_i: float
    k_d: float
    T_f: float

    def __post_init__(self) -> None:
        for name, unit in GAINS.items():
            checks.within(name, getattr(self, name), 0.0, math.inf, unit)

    def response(self, frequency: FloatArray, sample_rate: float) -> npt.NDArray[np.complex128]:
        """C at the frequencies (Hz), exactly as `Pid` computes it at the sample rate (Hz)."""
        delay = np.exp(-2j * np.pi * frequency / sample_rate)  # of one tick
        keep = _kept(self.T_f, sample_rate)
        terms = self.k_p + self.k_i / sample_rate / (1 - delay) + self.k_d * sample_rate * (1 - delay)
        return np.asarray(terms * ((1 - keep) / (1 - keep * delay)) ** 2)


class Pid(Displayed):
    """Feedback alone: a PID on the displacement that was measured in the last tick.

    The error passes two equal low passes before the three terms. While the voltage is at a limit the integral moves
    only away from it (anti-windup by clamping). There is no feedforward.

    Parameters
    ----------
    gains : PidGains
        See `tune_pid`.
    sample_rate : float
        Ticks per second, Hz.
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V.

    Examples
    --------
    A linear actuator of 10 um/V comes to its place and stays there:

    >>> pid = Pid(PidGains(k_p=0.0, k_i=20.0, k_d=0.0, T_f=0.0), sample_rate=2000.0, voltage_limits=(-0.6, 3.6))
    >>> for tick in range(200):
    ...     volts = pid.command(20.0, 0.0)
    ...     pid.adapt(10.0 * volts)
    >>> round(volts, 6)
    2.0

    References
    ----------
    K. J. Astrom, T. Hagglund, "Advanced PID Control", ISA 2006: the filter of the whole error in ch. 3, anti-windup.
    """

    def __init__(self, gains: PidGains, *, sample_rate: float, voltage_limits: tuple[float, float]) -> None:
        self.gains = gains
        self.sample_rate = checks.positive("sample_rate", sample_rate, "Hz")
        self.voltage_limits = checks.interval("voltage_limits", voltage_limits, "V")
        self._keep = _kept(gains.T_f, sample_rate)
        self._measured = 0.0  # um
        self._once = self._twice = 0.0  # the error after one and after both low passes, um
        self._integral = 0.0  # V

    def _display(self) -> tuple[str, Rows]:
        gains = [(name, quantity(getattr(self.gains, name), unit)) for name, unit in GAINS.items()]
        limits = ("voltage_limits", quantity(self.voltage_limits, "V"))
        return "Pid", [*gains, ("sample_rate", quantity(self.sample_rate, "Hz")), limits]

    def command(self, z_d: float, zdot_d: float) -> float:
        """Voltage, V, for the desired displacement, um; the velocity is not used."""
        g, last = self.gains, self._twice
        error = checks.number("z_d", z_d, "um") - self._measured
        self._once += (1 - self._keep) * (error - self._once)
        self._twice += (1 - self._keep) * (self._once - self._twice)
        step = g.k_i * self._twice / self.sample_rate
        wanted = g.k_p * self._twice + self._integral + step + g.k_d * (self._twice - last) * self.sample_rate
        low, high = self.voltage_limits
        volts = min(max(wanted, low), high)
        if (wanted - volts) * step <= 0:
            self._integral += step
        return volts

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Take the measurement, um, for the next command; NaN and infinity are ignored."""
        if math.isfinite(z_measured):
            self._measured = z_measured


def _kept(T_f: float, sample_rate: float) -> float:
    """What a low pass of one pole keeps of its state in one tick, without unit."""
    return math.exp(-1 / (T_f * sample_rate)) if T_f > 0 else 0.0


class ProjectedGradient:
    """Rate-independent law with positive partial sums: a gradient step on all that was measured, then a projection.

    With s the partial sums of w_h and v the corresponding plays (w_h.H_r = s.v), and y_a = w_s'.S_d'[z], ::

        R(n) = lambda R(n-1) + v v',    q(n) = lambda q(n-1) + v y_a
        s(n) = max(s(n-1) - (R s(n-1) - q) / trace R, slope_min)

    It descends on the constrained, exponentially forgotten least squares problem, and cannot wind up: at 0 V, R fades
    and s comes to rest. The rate weights b do not change. It is a `truestroke.control.adaptation.Law`.

    Parameters
    ----------
    initial_weights : array_like, shape (2 n,)
        w(0) = [a0, b0, a1, b1, ...], um/V.
    forgetting : float
        lambda, above 0, at most 1.
    slope_min : float
        Smallest partial sum, um/V.

    Examples
    --------
    >>> law = ProjectedGradient([5.0, 0.0, 0.0, 0.0], forgetting=0.99, slope_min=0.1)
    >>> for x, play in 500 * [(1.0, 0.5), (2.0, 1.5), (1.0, 1.5), (0.0, 0.5)]:
    ...     u = np.array([x, 0.0, play, 0.0])
    ...     law.update(u, 10.0 * x + 2.0 * play - law.weights @ u)
    >>> law.weights.round(3)
    array([10.,  0.,  2.,  0.])

    References
    ----------
    K. Kuhnen, P. Krejci, "Identification of linear error-models with projected dynamical systems", Mathematical and
    Computer Modelling of Dynamical Systems 10 (2004) 59-91, for the principle in continuous time.
    """

    def __init__(self, initial_weights: npt.ArrayLike, *, forgetting: float, slope_min: float) -> None:
        self.weights = checks.finite_array("initial_weights", initial_weights, "um/V").copy()
        self.forgetting = checks.within("forgetting", forgetting, 0.0, 1.0)
        self.slope_min = checks.positive("slope_min", slope_min, "um/V")
        n = self.weights.size // 2
        self._R, self._q = np.zeros((n, n)), np.zeros(n)  # V^2, V um

    def update(self, u: FloatArray, e_m: float) -> None:
        """One step, with the regressor u of (20), V, and the error of the model e_m of (15), um."""
        H, s = u[0::2], self.weights[0::2].cumsum()
        v = H.copy()
        v[:-1] -= H[1:]
        self._R = self.forgetting * self._R + v[:, np.newaxis] * v
        self._q = self.forgetting * self._q + v * (e_m + float(v @ s))
        trace = float(self._R.trace())
        if trace > FADED:
            s = np.maximum(s - (self._R @ s - self._q) / trace, self.slope_min)
        self.weights = self.weights.copy()
        s[1:] -= s[:-1]
        self.weights[0::2] = s


def tune_pid(
    frequency: npt.ArrayLike,
    response: npt.ArrayLike,
    *,
    sample_rate: float,
    spectrum: npt.ArrayLike,
    sensitivity_peak: float = 2.0,
    gain_spread: float = 1.5,
) -> PidGains:
    """The gains that track best in theory, of all that keep a stated distance from instability.

    The owner measures the frequency response G of the actuator with a little noise. A grid of gains is searched for
    the smallest predicted error of the desired motion, sum of abs(1 - C G / (1 + C G q))^2 spectrum, q the delay of one
    tick. Allowed is what is stable (Nyquist) and has M_s = max abs(1 / (1 + C G q)) up to `sensitivity_peak`, with
    G and with `gain_spread` times G: the slope of a hysteresis branch grows with its length, and G was measured on
    short ones.

    Parameters
    ----------
    frequency : array_like, shape (n,)
        Ascending evenly from above 0 to half the sample rate, Hz, fine enough to show the resonance.
    response : array_like of complex, shape (n,)
        G from voltage to the mean displacement over the same tick, um/V.
    sample_rate : float
        Ticks per second, Hz.
    spectrum : array_like, shape (n,)
        Power spectrum of the desired motion, any unit.
    sensitivity_peak : float
        Largest M_s, above 1; textbooks recommend 1.4 to 2.
    gain_spread : float
        Largest gain, in units of that of `response`, at least 1.

    Raises
    ------
    SettingError
        An argument is out of bounds, or no gains of the grid keep the distance.

    References
    ----------
    K. J. Astrom, T. Hagglund, "Advanced PID Control", ISA 2006, ch. 4 and 7 (design under a bound on M_s).
    """
    f = checks.finite_array("frequency", frequency, "Hz")
    G = np.asarray(response, dtype=np.complex128)
    power = checks.finite_array("spectrum", spectrum)
    if not G.shape == power.shape == f.shape:
        raise SettingError("response", f"array of shape {G.shape}", f"of the shape of frequency, {f.shape}", "um/V")
    peak = checks.within("sensitivity_peak", sensitivity_peak, 1.0, math.inf)
    spread = checks.within("gain_spread", gain_spread, 1.0, math.inf)
    q = np.exp(-2j * np.pi * f / sample_rate)
    best, best_error = None, math.inf
    for gains in _grid(float(np.abs(G[0])), sample_rate):
        CG = gains.response(f, sample_rate) * G
        error = float(np.sum(np.abs(1 - CG / (1 + CG * q)) ** 2 * power))
        if error < best_error and all(_keeps_distance(k * CG * q, peak) for k in (1.0, spread)):
            best, best_error = gains, error
    if best is None:
        raise SettingError("sensitivity_peak", peak, "larger for this actuator: no gains of the grid keep it")
    return best


def _grid(gain: float, sample_rate: float) -> list[PidGains]:
    """Gains for an actuator of that gain (um/V): corners of the integral, parts of P and D, filters."""
    corners = 2 * np.pi * np.geomspace(sample_rate / 500, sample_rate / 8, 28)  # k_i G, rad/s
    parts = (0.0, 0.05, 0.2, 0.4, 0.8, 1.6)  # k_p G
    leads = (0.0, 0.5, 1.0, 2.0)  # k_d G in ticks
    filters = (0.0, *(np.array([0.5, 1, 1.5, 2, 4, 8]) / sample_rate).tolist())
    return [
        PidGains(k_p=p / gain, k_i=w / gain, k_d=lead / sample_rate / gain, T_f=T_f)
        for w, p, lead, T_f in itertools.product(corners.tolist(), parts, leads, filters)
    ]


def _keeps_distance(L: npt.NDArray[np.complex128], peak: float) -> bool:
    """Whether the loop L, stable when open and with an integral, is stable when closed, with M_s up to the peak."""
    distance = 1 + L
    if np.abs(distance).min() * peak < 1:
        return False
    angle = np.angle(distance[0]) + np.angle(distance[1:] / distance[:-1]).sum()
    return bool(abs(angle) < 1.0)  # Nyquist: from -j infinity to the positive real axis, without a turn around -1
