"""The stage for fast motion as readable Python, a thousand times slower than the C: the text to read and to edit first.

Symbols: x voltage behind the amplifier over the upper voltage, P[x] the operator of the hysteresis, u the strain that
the modes follow, z the displacement. The C kernel is held equal to this text by tests/test_stage.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.plant.reference import creep_time_constants, creep_weight
from truestroke.plant.settings import StageSettings, first_tick

POINTS, CYCLES = 256, 4  # of the loop that is measured: points a branch, cycles


# ---- Hysteresis: operators of x ---------------------------------------------------------------------------------


class Plays:
    """Mean of plays y = max(x - a x^2 - r, min(x + a x^2 + r, y)): the rising and the falling envelope differ."""

    def __init__(self, s: StageSettings) -> None:
        self.envelope = s.envelope
        self.r = s.threshold_max * ((np.arange(s.plays) + 0.5) / s.plays) ** s.threshold_exponent
        self.y = np.zeros(s.plays)

    def __call__(self, x: float) -> float:
        """Move to x."""
        bend = self.envelope * x * x
        self.y = np.maximum(x - bend - self.r, np.minimum(x + bend + self.r, self.y))
        return float(np.mean(self.y))


def everett(s: StageSettings, high: float, low: float) -> float:
    """Integral of the density over the relays that switch up at a, down at b, low <= b <= a <= high.

    The density is exp(-(a - b) / rho) (1 + k1 c + k2 c^2) with c = (a + b) / 2 - 1/2. Along a line of equal
    d = a - b, of length L = D - d and with its middle at c = m, the polynomial gives
    L (1 + k1 m + k2 m^2) + k2 L^3 / 12. The integral I_n of L^n exp(-d / rho) over d = 0..D is rho D^n - n rho I_(n-1).
    """
    span, middle, rho = high - low, (high + low) / 2 - 0.5, s.preisach_scale
    integral = [-rho * math.expm1(-span / rho)]
    for n in (1, 2, 3):
        integral.append(rho * (span**n - n * integral[-1]))
    even = 1 + s.preisach_tilt * middle + s.preisach_curvature * middle**2
    return even * integral[1] + s.preisach_curvature / 12 * integral[3]


class Preisach:
    """A Preisach operator by its Everett function: it remembers what no larger swing has wiped out.

    `turns` are the turning points (x, P[x]): the lowest voltage, a high, a low, ... each within the two before it.
    """

    def __init__(self, s: StageSettings) -> None:
        self.s, self.x = s, 0.0
        self.turns = [(s.voltage_limits[0] / s.voltage_limits[1], 0.0)]

    def __call__(self, x: float) -> float:
        """Move to x."""
        rising = len(self.turns) % 2 == 1
        if x < self.x if rising else x > self.x:
            self.turns.append((self.x, self._at(self.x)))
            rising = not rising
        while len(self.turns) > 2 and (x >= self.turns[-2][0] if rising else x <= self.turns[-2][0]):
            del self.turns[-2:]
        if len(self.turns) == 2 and x <= self.turns[0][0]:
            del self.turns[1]
        self.x = x
        return self._at(x)

    def _at(self, x: float) -> float:
        """Along the branch from the last turning point."""
        turn, value = self.turns[-1]
        return value + everett(self.s, x, turn) if len(self.turns) % 2 else value - everett(self.s, turn, x)


class BoucWen:
    """q' = x' - beta |x'| q |q|^(n-1) - gamma x' |q|^n by Runge and Kutta, in steps of at most 0.01 of x."""

    def __init__(self, s: StageSettings) -> None:
        self.s, self.x, self.q = s, 0.0, 0.0

    def slope(self, q: float, way: float) -> float:
        """dq/dx where x rises (way = 1) or falls (-1)."""
        size = math.pow(abs(q), self.s.bouc_wen_exponent)
        return 1 - self.s.bouc_wen_beta * way * math.copysign(size, q) - self.s.bouc_wen_gamma * size

    def __call__(self, x: float) -> float:
        """Move to x."""
        way = -1.0 if x < self.x else 1.0
        parts = math.ceil(abs(x - self.x) / 0.01)
        for _ in range(parts):
            h = (x - self.x) / parts
            k1 = self.slope(self.q, way)
            k2 = self.slope(self.q + h / 2 * k1, way)
            k3 = self.slope(self.q + h / 2 * k2, way)
            k4 = self.slope(self.q + h * k3, way)
            self.q += h / 6 * (k1 + 2 * (k2 + k3) + k4)
        self.x = x
        return self.q


Operator = Plays | Preisach | BoucWen
OPERATORS: dict[str, type[Plays] | type[Preisach] | type[BoucWen]] = {
    "plays": Plays,
    "preisach": Preisach,
    "bouc-wen": BoucWen,
}


def weights(s: StageSettings) -> tuple[float, float, float]:
    """A, B, u_0 of the strain A x + B P[x] - u_0, um.

    They make the loop over x = 0..1 as high as the stroke, as wide as `loop_width`, and the strain 0 at rest; the loop
    of P is measured on its fourth cycle.
    """
    operator = OPERATORS[s.hysteresis_kind](s)
    rest = operator(0.0)
    x = np.arange(1, POINTS + 1) / POINTS
    for _ in range(CYCLES):
        up = np.array([operator(value) for value in x])
        down = np.array([operator(value) for value in 1 - x])
    distance = down[-2::-1] - up[:-1]  # at the same x
    width = distance[np.argmax(np.abs(distance))]
    share = s.loop_width / width
    return s.stroke * (1 - share * (up[-1] - down[-1])), s.stroke * share, s.stroke * share * rest


# ---- The chain ---------------------------------------------------------------------------------------------------


@dataclass
class State:
    """State between two pieces of a step."""

    operator: Operator
    creep: FloatArray  # um
    modes: FloatArray  # (z, z') of each, um and um/s, without its share
    volts: float = 0.0  # behind the amplifier
    strain: float = 0.0  # um
    displaced: float = 0.0  # um
    sensed: list[float] = field(default_factory=list)  # displacement behind the sensor's lag at the end of each step


def resonance_factor(s: StageSettings, tick: int) -> float:
    """Of all resonances in a tick: the drift and the change."""
    changed = tick >= first_tick(s.resonance_change_time, s.sample_rate)
    return (1 + s.resonance_drift * tick / s.sample_rate / 60) * (s.resonance_change if changed else 1.0)


@lru_cache(maxsize=64)
def transition(omega: float, zeta: float, rate: float, length: float) -> FloatArray:
    """Of (z, z'/omega, c, e) over `length` (s): z'' + 2 zeta omega z' + omega^2 z = omega^2 (c + e exp(-rate t))."""
    from scipy.linalg import expm

    system = np.zeros((4, 4))
    system[0, 1] = omega
    system[1] = [-omega, -2 * zeta * omega, omega, omega]
    system[3, 3] = -rate
    return np.asarray(expm(system * length))


def follow(s: StageSettings, state: State, factor: float, length: float, u: tuple[float, float]) -> None:
    """The modes over a piece of `length` (s) in which the strain goes from u[0] to u[1], um, as the voltage does.

    As c + e exp(-t / tau), tau of the amplifier; without lag it is their mean.
    """
    rate = 2 * math.pi * s.amplifier_bandwidth
    part = (u[0] - u[1]) / -math.expm1(-rate * length) if rate else 0.0
    rest = u[0] - part if rate else (u[0] + u[1]) / 2
    for i, (resonance, zeta) in enumerate(zip(s.resonances, s.dampings, strict=True)):
        omega = 2 * math.pi * resonance * factor
        z, velocity = state.modes[i]
        moved = transition(omega, zeta, rate, length) @ [z, velocity / omega, rest, part]
        state.modes[i] = moved[0], moved[1] * omega


def advance(
    s: StageSettings, state: State, w: tuple[float, float, float], factor: float, length: float, target: float,
    force: tuple[float, float],
) -> None:  # fmt: skip
    """A piece of a step in which the amplifier is at `target` (V) and the force on the stage changes, um."""

    def strain() -> float:
        x = state.volts / s.voltage_limits[1]
        return w[0] * x + w[1] * state.operator(x) - w[2]

    if not s.amplifier_bandwidth and state.volts != target:
        state.volts = target
        state.strain = strain()
    before, crept = state.strain, creep_weight(s) * float(np.sum(state.creep))
    lag = math.exp(-2 * math.pi * s.amplifier_bandwidth * length) if s.amplifier_bandwidth else 0.0
    state.volts = target + lag * (state.volts - target)
    state.strain = strain()
    if s.creep:
        decay = np.exp(-length / creep_time_constants(s))
        state.creep = decay * state.creep + (1 - decay) * (before + state.strain) / 2
    crept_now = creep_weight(s) * float(np.sum(state.creep))
    follow(s, state, factor, length, (before + crept + force[0], state.strain + crept_now + force[1]))


def load_at(s: StageSettings, tick: int, seconds: float) -> float:
    """Of the settings, um, so many seconds after the tick began."""
    begin = first_tick(s.load_time, s.sample_rate)
    if tick < begin:
        return 0.0
    after = (tick - begin) / s.sample_rate + seconds
    return s.load * math.sin(2 * math.pi * s.load_frequency * after) if s.load_frequency else s.load


def sensed(s: StageSettings, state: State, z: float) -> float:
    """What the sensor gives at the end of a step: its lag of a straight line, its delay by a cubic through four."""
    from scipy.interpolate import lagrange

    step = 1 / (s.sample_rate * s.steps_per_tick)
    ratio = 2 * math.pi * s.sensor_bandwidth * step
    last = state.sensed[-1] if state.sensed else 0.0
    slope = (z - state.displaced) / ratio if ratio else 0.0  # the answer to a ramp lags by its slope times tau
    lagged = z - slope + math.exp(-ratio) * (last - state.displaced + slope) if ratio else z
    state.sensed.append(lagged)
    state.displaced = z
    delay = s.sensor_delay / step
    base = math.floor(delay + 1e-9)
    if delay - base > 1e-9 and base > 0:
        base -= 1
    ago = np.arange(base, base + 4)
    values = [state.sensed[-1 - k] if k < len(state.sensed) else 0.0 for k in ago]
    return float(lagrange(ago - base, values)(delay - base))


def one_tick(
    s: StageSettings, state: State, w: tuple[float, float, float], tick: int, held: FloatArray, load: float
) -> tuple[FloatArray, FloatArray]:
    """True and sensed displacement at the samples of a tick, um; `held` are all voltages so far, V."""
    step = 1 / (s.sample_rate * s.steps_per_tick)
    late = s.dead_time * s.sample_rate
    whole = math.floor(late + 1e-9)
    switch = (late - whole) * s.steps_per_tick  # in steps after the tick begins
    old, new = (float(held[k]) if k >= 0 else 0.0 for k in (tick - whole - 1, tick - whole))
    factor, force = resonance_factor(s, tick), (load + load_at(s, tick, 0.0)) * s.load_on_stage
    z, seen = np.zeros(s.steps_per_tick), np.zeros(s.steps_per_tick)
    for i in range(s.steps_per_tick):
        loaded = load + load_at(s, tick, (i + 1) * step)
        pushes = loaded * s.load_on_stage
        part = min(max(switch - i, 0.0), 1.0)  # of the step before the voltage changes
        part = part if 1e-9 < part < 1 - 1e-9 else round(part)
        between = force + part * (pushes - force)
        if part > 0:
            advance(s, state, w, factor, part * step, old, (force, between))
        if part < 1:
            advance(s, state, w, factor, (1 - part) * step, new, (between, pushes))
        force = pushes
        time = tick / s.sample_rate + (i + 1) * step
        hum = s.hum * math.sin(2 * math.pi * s.hum_frequency * time)
        z[i] = float(np.dot(s.shares, state.modes[:, 0])) + hum + loaded * (not s.load_on_stage)
        seen[i] = sensed(s, state, z[i])
    stride = s.steps_per_tick // s.samples_per_tick
    return z[stride // 2 - 1 :: stride], seen[stride // 2 - 1 :: stride]


def simulate(
    s: StageSettings, volts: FloatArray, noise: FloatArray, load: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """The stage from rest.

    Parameters
    ----------
    s : StageSettings
        Every number.
    volts : ndarray, shape (ticks,)
        Voltages at the D/A converter, V, each held for a tick.
    noise : ndarray, shape (ticks, samples_per_tick)
        Standard normal numbers.
    load : ndarray, shape (ticks,), optional
        Static displacement of a load in each tick, um, beside that of the settings.

    Returns
    -------
    measured, truth : ndarray, shape (ticks,)
        Mean displacement over each tick, um, as measured and as it is.

    Examples
    --------
    >>> measured, truth = simulate(StageSettings(), np.full(30, 1.0), np.zeros((30, 5)))
    >>> truth[[0, 29]].round(3)
    array([0.074, 1.992])
    """
    held = np.clip(volts, *s.voltage_limits)
    state = State(OPERATORS[s.hysteresis_kind](s), np.zeros(s.creep_operators), np.zeros((len(s.resonances), 2)))
    w = weights(s)
    state.operator(0.0)
    measured, truth = np.zeros_like(held), np.zeros_like(held)
    for k in range(len(held)):
        z, seen = one_tick(s, state, w, k, held, 0.0 if load is None else float(load[k]))
        truth[k], measured[k] = np.mean(z), np.mean(seen + s.noise * noise[k])
    return measured, truth
