"""The realistic plant as readable Python, a thousand times slower than the C: the text to read and to edit first.

Symbols: x stack voltage, y_i play states, u the strain that the stage follows, z the displacement. The C kernel is
held equal to this text by tests/test_plant.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from truestroke.base.typing import FloatArray
from truestroke.plant.settings import PlantSettings, StageSettings


def thresholds(s: PlantSettings) -> FloatArray:
    """r_i, stack volts, shape (plays,): the quantiles ((i + 1/2) / plays)^e of the density exp(-r / rho) on (0, R)."""
    mass = 1 - math.exp(-s.threshold_max / s.threshold_scale)
    quantiles = ((np.arange(s.plays) + 0.5) / s.plays) ** s.threshold_exponent
    return np.asarray(-s.threshold_scale * np.log(1 - mass * quantiles))


def play_weight(s: PlantSettings) -> float:
    """Weight w of each play, um per stack volt: the plays give the part h of the chord S over 0..2 R.

    On that branch a play of threshold r moves by 2 R - 2 r, so the chord is (1 - h) S + w sum(1 - r_i / R) = S.
    """
    return float(s.hysteresis * s.sensitivity / np.sum(1 - thresholds(s) / s.threshold_max))


def creep_time_constants(s: PlantSettings | StageSettings) -> FloatArray:
    """tau_j, s, shape (creep_operators,): equal steps of log time."""
    first, last = np.log10(s.creep_span)
    quantiles = (np.arange(s.creep_operators) + 0.5) / s.creep_operators
    return np.asarray(10 ** (first + (last - first) * quantiles))


def creep_weight(s: PlantSettings | StageSettings) -> float:
    """Weight of each creep operator: gamma times its decades."""
    return s.creep * math.log10(s.creep_span[1] / s.creep_span[0]) / s.creep_operators


def stage_transition(s: PlantSettings, step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phi, G_c, G_e of (z, z'/omega) over a `step` (s) in which u(t) = c + e exp(-t / tau), tau of the amplifier.

    z'' + 2 zeta omega z' + omega^2 z = omega^2 u. Exact: the exponential of the system extended by c and e.
    """
    from scipy.linalg import expm

    angle = 2 * math.pi * s.resonance * step
    system = np.zeros((4, 4))
    system[0, 1] = angle
    system[1] = [-angle, -2 * s.damping * angle, angle, angle]
    system[3, 3] = -2 * math.pi * s.amplifier_bandwidth * step
    whole = expm(system)
    return whole[:2, :2], whole[:2, 2], whole[:2, 3]


def converted(value: float, step: float, limits: tuple[float, float] | None) -> float:
    """A converter: nearest multiple of `step`, within `limits`, in the unit of `value`."""
    value = step * round(value / step) if step else value
    return min(max(value, limits[0]), limits[1]) if limits else value


@dataclass(frozen=True, eq=False)
class Constants:
    """What follows from the settings and stays: named as the functions above, for one step of the integration."""

    r: FloatArray
    w: float
    lag: float
    creep_decay: FloatArray
    creep_weight: float
    stage: tuple[FloatArray, FloatArray, FloatArray]

    @classmethod
    def of(cls, s: PlantSettings) -> Constants:
        """The constants of these settings."""
        step = 1 / (s.sample_rate * s.steps_per_tick)
        return cls(
            r=thresholds(s),
            w=play_weight(s),
            lag=math.exp(-2 * math.pi * s.amplifier_bandwidth * step) if s.amplifier_bandwidth else 0.0,
            creep_decay=np.exp(-step / creep_time_constants(s)),
            creep_weight=creep_weight(s),
            stage=stage_transition(s, step),
        )


@dataclass
class State:
    """State after a tick: stack volts, play states (V), creep operators (um), stage (z, z'/omega) (um)."""

    x: float
    y: FloatArray
    creep: FloatArray
    stage: FloatArray

    @classmethod
    def at_rest(cls, s: PlantSettings) -> State:
        """Everything at 0."""
        return cls(0.0, np.zeros(s.plays), np.zeros(s.creep_operators), np.zeros(2))


def weights_at(s: PlantSettings, c: Constants, tick: int) -> tuple[float, float]:
    """Weight of the linear part and of each play at a tick, um per stack volt: ageing and the sudden change."""
    hours = tick / s.sample_rate / 3600
    gain, hysteresis = 1 + s.ageing_gain * hours, 1 + s.ageing_hysteresis * hours
    if s.change is not None and tick >= s.change.tick(s.sample_rate):
        gain, hysteresis = gain * s.change.gain, hysteresis * s.change.hysteresis
    return gain * s.sensitivity * (1 - s.hysteresis * hysteresis), gain * hysteresis * c.w


def strain(s: PlantSettings, c: Constants, state: State, weights: tuple[float, float]) -> float:
    """u without creep, um: the plays (1) follow the stack voltage, then the asymmetry."""
    state.y = np.maximum(state.x - c.r, np.minimum(state.x + c.r, state.y))
    y = weights[0] * state.x + weights[1] * float(np.sum(state.y))
    return y * (1 + s.asymmetry * (y / s.asymmetry_stroke - 1))


def follow(s: PlantSettings, c: Constants, state: State, before: float, now: float) -> float:
    """Displacement of the stage, um, after a step in which the strain went from `before` to `now`: creep, resonance."""
    crept = c.creep_weight * float(np.sum(state.creep))
    state.creep = c.creep_decay * state.creep + (1 - c.creep_decay) * (before + now) / 2
    u0, u1 = before + crept, now + c.creep_weight * float(np.sum(state.creep))
    part = (u0 - u1) / (1 - c.lag) if s.amplifier_bandwidth else 0.0  # u has the shape of the stack voltage
    phi, from_rest, from_part = c.stage
    moved = phi @ state.stage + from_rest * (u1 - part * c.lag) + from_part * part
    state.stage = moved if s.resonance else np.array([u1, 0.0])
    return float(state.stage[0])


def one_tick(s: PlantSettings, c: Constants, state: State, tick: int, volts: float) -> FloatArray:
    """True displacement at the samples of a tick, um, shape (samples_per_tick,)."""
    target = converted(s.amplifier_gain * converted(volts, s.da_step, s.da_limits), 0, s.stack_limits)
    weights = weights_at(s, c, tick)
    if not s.amplifier_bandwidth:
        state.x = target
    before = strain(s, c, state, weights)  # the weights, and without lag the voltage, jump at the start of the tick
    z = np.zeros(s.steps_per_tick)
    for j in range(s.steps_per_tick):
        state.x = target + c.lag * (state.x - target)
        now = strain(s, c, state, weights)
        z[j] = follow(s, c, state, before, now)
        before = now
    drift = s.drift * (1 - math.exp(-(tick + 0.5) / (s.sample_rate * s.drift_time)))
    stride = s.steps_per_tick // s.samples_per_tick
    return z[stride - 1 :: stride] + drift


def simulate(s: PlantSettings, volts: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The plant from rest.

    Parameters
    ----------
    s : PlantSettings
        Every number.
    volts : ndarray, shape (ticks,)
        Voltages at the D/A converter, V, each held for a tick.
    noise : ndarray, shape (ticks, samples_per_tick)
        Standard normal numbers.

    Returns
    -------
    measured, truth : ndarray, shape (ticks,)
        Mean displacement over each tick, um, as measured and as it is.

    Examples
    --------
    >>> measured, truth = simulate(PlantSettings().without("noise"), np.full(20, 1.0), np.zeros((20, 5)))
    >>> truth[[0, 19]].round(3)
    array([ 4.022, 12.384])
    """
    c, state = Constants.of(s), State.at_rest(s)
    measured, truth = np.zeros_like(volts), np.zeros_like(volts)
    for k in range(len(volts)):
        samples = one_tick(s, c, state, k, float(volts[k]))
        seen = [converted(z, s.ad_step, s.ad_limits) for z in samples + s.noise * noise[k]]
        truth[k], measured[k] = np.mean(samples), np.mean(seen)
    return measured, truth
