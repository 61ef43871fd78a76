"""Records of sixteen more actuators, of structures and motions that none of the three other sets has.

`benchmarks.foreign_rivals --other` and `benchmarks.coverage --other` take them: friction, saturation, switching fields,
rates in three classes, and sensors and clocks that are coarse.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from benchmarks.foreign_records import (
    Makers,
    clock,
    creep,
    dahl,
    drawn,
    jiles_atherton,
    lagged,
    low_pass,
    quantised,
    sine,
    stop_elements,
    up_and_down,
    wave,
)
from benchmarks.further_records import backlash_like, lugre, moving_thresholds
from benchmarks.unseen_records import backlash, fractional_creep, saturating

from truestroke.identification import Record

Made = tuple[np.ndarray, np.ndarray, np.ndarray]  # s, V, um


def strokes(t: np.ndarray, rng: np.random.Generator, seconds: float, smooth: float = 0.0) -> np.ndarray:
    """Straight ways between random voltages from 0 to 1, a new one each so many seconds; both ends in the first."""
    corners = rng.uniform(0, 1, int(t[-1] / seconds) + 3)
    corners[:3] = 0.0, 1.0, 0.0
    v = np.interp(t, seconds * np.arange(corners.size), corners)
    return np.clip(low_pass(v, 1 / float(t[1] - t[0]), smooth), 0, 1) if smooth else v


def envelopes_of_tanh(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Plays between tanh envelopes of random bend, which saturate at both ends."""
    up, down = rng.uniform(2.0, 3.5), rng.uniform(2.0, 3.5)
    rise, fall = np.tanh(up * (v - 0.55)), np.tanh(down * (v - 0.45))
    y = 0.1 * v
    for r in np.linspace(0.0, 0.4, 10):
        state, out = rise[0], np.empty(v.size)
        for k in range(v.size):
            state = max(rise[k] - r, min(fall[k] + r, state))
            out[k] = state
        y = y + 0.1 * np.exp(-rng.uniform(1, 5) * r) * out
    return y


def smooth_bouc_wen(v: np.ndarray, power: float, alpha: float = 0.4, beta: float = 9.0) -> np.ndarray:
    """h' = alpha v' - (beta |v'| |h|^(n-1) h + gamma v' |h|^n), with n above 1."""
    h = np.zeros(v.size)
    for k, dv in enumerate(np.diff(v), 1):
        last = h[k - 1]
        h[k] = last + alpha * dv - beta * abs(dv) * abs(last) ** (power - 1) * last + 2.0 * dv * abs(last) ** power
    return v - h


def polarisation(v: np.ndarray, rng: np.random.Generator, coercive: float) -> np.ndarray:
    """Relays about 0 with a coercive field, v from -1 to 1; from -1 to 1 and with a linear part."""
    middle, half = rng.normal(0.0, 0.25, 3000), np.abs(rng.normal(coercive, 0.15, 3000))
    state, out = np.ones(3000), np.empty(v.size)
    for k, x in enumerate(v):
        state[x > middle + half] = 1.0
        state[x < middle - half] = -1.0
        out[k] = state.mean()
    return out + 0.25 * v


def fractional(y: np.ndarray, fs: float, order: float, gain: float) -> np.ndarray:
    """y plus the gain times its derivative of an order below 1, by Gruenwald and Letnikov."""
    weights = np.cumprod(np.concatenate([[1.0], 1 - (order + 1) / np.arange(1, min(y.size, 4000))]))
    moved = y - y[0]
    made = np.fft.irfft(np.fft.rfft(weights, 2 * y.size) * np.fft.rfft(moved, 2 * y.size))[: y.size]
    return np.asarray(y - gain * made * fs**order)


def friction_in_strokes(rng: np.random.Generator) -> Made:
    """Dahl: straight ways between random voltages, 500 Hz"""
    t = clock(30.0, 500.0)
    v = strokes(t, rng, 0.25, 20.0)
    return t, 100 * v, 40 * dahl(v, rng.uniform(6, 14), rng.uniform(0.08, 0.15)) + rng.normal(0, 0.02, t.size)


def friction_at_three_rates(rng: np.random.Generator) -> Made:
    """LuGre friction: triangles of 0.5, 5 and 25 Hz in turn, 2 kHz"""
    t = clock(16.0, 2e3)
    phase = np.cumsum(np.choose((t / 1.0).astype(int) % 4, [0.5, 5.0, 25.0, 1.0])) / 2e3
    v = up_and_down(phase, 1.0) * rng.uniform(0.5, 1.0, 17)[t.astype(int)]
    v = low_pass(v, 2e3, 80.0)
    return t, 120 * v, 25 * lagged(lugre(v, 2e3), 2e3, 0.001) + rng.normal(0, 0.01, t.size)


def few_sliders(rng: np.random.Generator) -> Made:
    """Maxwell slip of three elements: reversal curves, 100 Hz"""
    t = clock(80.0, 100.0)
    v = up_and_down(t, 0.25) * (1 - 0.8 * (np.floor(t / 4) * 7 % 20) / 20)
    k, limit = rng.uniform(0.5, 1.5, 3), np.array([0.02, 0.07, 0.2])
    force, out = np.zeros(3), np.empty(v.size)
    for i, dv in enumerate(np.diff(v, prepend=v[0])):
        force = np.clip(force + dv, -limit, limit)
        out[i] = k @ force
    return t, 150 * v, 30 * (v - 0.25 * out) + rng.normal(0, 0.01, t.size)


def saturated_magnet(rng: np.random.Generator) -> Made:
    """Jiles-Atherton on a bias, saturated at one end: two tones, 500 Hz"""
    t = clock(20.0, 500.0)
    v = 0.2 + 0.8 * (0.6 * sine(t, 1.0) + 0.4 * sine(t, 2.37))
    m = jiles_atherton(np.concatenate([np.linspace(0, v[0], 200), 1.5 * v]))[200:]
    return t, 3 * v, 50 * np.tanh(1.6 * m) + rng.normal(0, 0.03, t.size)


def reversal_of_polarisation(rng: np.random.Generator) -> Made:
    """Strain of a polarisation that begins to switch at the lowest voltages: random strokes, 200 Hz"""
    t = clock(60.0, 200.0)
    v = 1.0 - 1.35 * (1 - strokes(t, rng, 0.6, 10.0))
    p = polarisation(v, rng, 0.75)
    return t, 200 * v, 20 * p**2 + rng.normal(0, 0.02, t.size)


def switched_field(rng: np.random.Generator) -> Made:
    """Preisach about 0 with a coercive field: bipolar wave below 2 Hz, 200 Hz"""
    t = clock(60.0, 200.0)
    v = 2 * wave(t, rng, 2.0) - 1
    return t, 300 * v, 10 * polarisation(v, rng, 0.25) + rng.normal(0, 0.02, t.size)


def tanh_curves(rng: np.random.Generator) -> Made:
    """Plays between tanh envelopes of random bend: random strokes, 300 Hz"""
    t = clock(40.0, 300.0)
    v = strokes(t, rng, 0.5)
    return t, 60 * v, 15 * envelopes_of_tanh(v, rng) + rng.normal(0, 0.005, t.size)


def ramped_relays(rng: np.random.Generator) -> Made:
    """Krasnoselskii and Pokrovskii: triangles of random turns, 250 Hz"""
    t = clock(48.0, 250.0)
    v = strokes(t, rng, 0.4)
    return t, 100 * v, 12 * saturating(v, rng, 60) + rng.normal(0, 0.006, t.size)


def hodgdon(rng: np.random.Generator) -> Made:
    """Coleman and Hodgdon, both curves bent: wave below 8 Hz and its half, 1 kHz"""
    t = clock(16.0, 1e3)
    v = wave(t, rng, 8.0) * (0.55 + 0.45 * (t % 4 < 2))
    v = low_pass(v, 1e3, 30.0)
    return t, 90 * v, 33 * backlash_like(v, rng.uniform(3, 8)) + rng.normal(0, 0.015, t.size)


def smooth_friction(rng: np.random.Generator) -> Made:
    """Bouc-Wen with a power of 1.8: sines of random height, 400 Hz"""
    t = clock(30.0, 400.0)
    v = sine(t, 1.0) * rng.uniform(0.2, 1.0, 31)[t.astype(int)]
    return t, 100 * v, 22 * smooth_bouc_wen(v, 1.8) + rng.normal(0, 0.01, t.size)


def power_law_steps(rng: np.random.Generator) -> Made:
    """Preisach-like plays, creep as a power of time: steps up and down, held for 5 s, 20 Hz"""
    t = clock(400.0, 20.0)
    v = low_pass(rng.uniform(0, 1, 81)[(t / 5).astype(int)], 20.0, 3.0)
    return t, 100 * v, 60 * fractional_creep(stop_elements(v, rng), 20.0, 0.03, 0.2) + rng.normal(0, 0.03, t.size)


def fractional_rate(rng: np.random.Generator) -> Made:
    """Plays behind half a derivative of order 0.3: triangles of 0.3 to 30 Hz, 1 kHz"""
    t = clock(20.0, 1e3)
    phase = np.cumsum(0.3 * 100 ** ((t * 7 / 20) % 1.0)) / 1e3
    v = low_pass(up_and_down(phase, 1.0), 1e3, 150.0) * rng.uniform(0.4, 1.0, 21)[t.astype(int)]
    v = low_pass(v, 1e3, 60.0)
    return t, 75 * v, 9 * fractional(stop_elements(v, rng), 1e3, 0.3, 0.015) + rng.normal(0, 0.004, t.size)


def loose_lever(rng: np.random.Generator) -> Made:
    """Plays, a lever with a backlash of 2 % and a bent ratio: raster with random heights, 500 Hz"""
    t = clock(24.0, 500.0)
    v = 0.1 + up_and_down(t, 1.0) * rng.uniform(0.3, 0.9, 25)[t.astype(int)]
    y = stop_elements(v, rng)
    y = 0.7 * y + 0.3 * backlash(y, 0.02)
    return t, 100 * v, 200 * (y - 0.08 * y**2) + rng.normal(0, 0.05, t.size)


def bent_and_coarse(rng: np.random.Generator) -> Made:
    """Plays, a sensor that is bent by 2 % and coarse, with log creep: random wave, unequal times of 50 Hz"""
    t = np.sort(clock(100.0, 50.0) + rng.uniform(-6e-3, 6e-3, 5000))
    v = wave(t, rng, 1.0)
    y = creep(stop_elements(v, rng), 50.0, 0.01)
    return t, 10 * v, quantised(100 * (y + 0.08 * y * (1 - y)), 0.2)


def sparse(rng: np.random.Generator) -> Made:
    """Bouc-Wen, 16 bits, eight samples a stroke: random strokes, 40 Hz"""
    t = clock(150.0, 40.0)
    fine = clock(150.0, 400.0)
    v = strokes(fine, rng, 0.2, 15.0)
    z = 12 * creep(smooth_bouc_wen(v, 1.0, 0.3, 2.5), 400.0, 0.01)[::10]
    return t, quantised(120 * v[::10], 120 / 65536), quantised(z, 15 / 65536) + rng.normal(0, 0.002, t.size)


def widening(rng: np.random.Generator) -> Made:
    """Plays with thresholds that grow with the rate, a lag: sines of 1, 10 and 40 Hz in turn, 4 kHz"""
    t = clock(9.0, 4e3)
    phase = np.cumsum(np.choose((2 * t).astype(int) % 3, [1.0, 10.0, 40.0])) / 4e3
    v = (0.5 - 0.5 * np.cos(2 * np.pi * phase)) * rng.uniform(0.5, 1.0, 19)[(2 * t).astype(int)]
    v = low_pass(v, 4e3, 100.0)
    return t, 100 * v, 20 * lagged(moving_thresholds(v, 4e3, rng, 0.004), 4e3, 5e-4) + rng.normal(0, 0.01, t.size)


MAKERS: Makers = (
    friction_in_strokes,
    friction_at_three_rates,
    few_sliders,
    saturated_magnet,
    reversal_of_polarisation,
    switched_field,
    tanh_curves,
    ramped_relays,
    hodgdon,
    smooth_friction,
    power_law_steps,
    fractional_rate,
    loose_lever,
    bent_and_coarse,
    sparse,
    widening,
)


def records(seed: int = 0, makers: Makers = MAKERS) -> Iterator[Record]:
    """The records of this seed, none of which is one of the other collections."""
    return drawn(MAKERS, makers, 300 + seed)
