"""Records of fifteen more actuators: other hysteresis, waves and disturbances than those of the two other sets.

`benchmarks.coverage --further` takes them: the rule of the interval was made without them. The strokes go from
0.3 um to 0.5 mm, the rates from 5 Hz to 40 kHz.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from benchmarks.foreign_records import (
    Makers,
    bouc_wen,
    clock,
    creep,
    drawn,
    jiles_atherton,
    lagged,
    late,
    low_pass,
    preisach,
    quantised,
    resonance,
    sine,
    stop_elements,
    up_and_down,
    wave,
)
from benchmarks.unseen_records import maxwell_slip, saturating

from truestroke.identification import Record

Made = tuple[np.ndarray, np.ndarray, np.ndarray]  # s, V, um


def moving_thresholds(v: np.ndarray, fs: float, rng: np.random.Generator, widens: float) -> np.ndarray:
    """Plays whose thresholds grow with the rate of the voltage (Al Janaideh and Krejci 2013)."""
    r, w = np.linspace(0.0, 0.4, 12), rng.exponential(0.05, 12)
    rate = np.abs(np.gradient(v) * fs)
    state, out = np.zeros(12), np.empty(v.size)
    for k, x in enumerate(v):
        wide = r * (1 + widens * rate[k])
        state = np.maximum(x - wide, np.minimum(x + wide, state))
        out[k] = w @ state
    return 0.5 * v + out


def backlash_like(v: np.ndarray, alpha: float = 4.0) -> np.ndarray:
    """y' = alpha |v'| (f(v) - y) + g(v) v', both bent (Su, Stepanenko, Svoboda and Leung 2000, Hodgdon 1988)."""
    y = np.zeros(v.size)
    for k, dv in enumerate(np.diff(v), 1):
        aim = 0.5 * np.sinh(1.4 * v[k]) / np.sinh(1.4) + 0.4 * v[k]
        slope = 0.55 + 0.15 * np.tanh(3 * (v[k] - 0.6))
        y[k] = aim + (y[k - 1] + slope * dv - aim) * np.exp(-alpha * abs(dv))
    return y


def lugre(v: np.ndarray, fs: float) -> np.ndarray:
    """A spring that a friction with bristles holds back, which is weaker at speed (Canudas de Wit et al. 1995)."""
    z, out = 0.0, np.empty(v.size)
    for k, dv in enumerate(np.diff(v, prepend=v[0])):
        strength = 0.05 + 0.03 * np.exp(-((dv * fs / 0.5) ** 2))
        z = np.clip(z + dv - abs(dv) * z / strength, -strength, strength)
        out[k] = v[k] + 0.12 * v[k] ** 2 - 0.9 * z
    return out


def switching(v: np.ndarray, fs: float, rng: np.random.Generator) -> np.ndarray:
    """Domains that switch the sooner the further the field is beyond theirs: relays with a rate of their own."""
    middle, half = rng.beta(1.5, 1.5, 800), rng.exponential(0.1, 800)
    state, out = np.zeros(800), np.empty(v.size)
    for k, x in enumerate(v):
        beyond = np.where(state < 0.5, x - middle - half, middle - half - x)
        q = -np.expm1(-np.exp(np.clip(beyond / 0.01, -40, 12)) / (0.1 * fs))
        state += q * (np.where(x > middle, 1.0, 0.0) - state)
        out[k] = state.mean()
    return 0.5 * v + 0.5 * out


def dead_zones(y: np.ndarray) -> np.ndarray:
    """Kuhnen's asymmetry behind plays: a line that bends at five displacements."""
    return y + sum(0.06 * np.maximum(y - d, 0.0) for d in (0.2, 0.4, 0.6)) - 0.1 * np.maximum(y - 0.85, 0.0)


def constant_phase(y: np.ndarray, fs: float, share: float) -> np.ndarray:
    """Share of the motion behind a lag of all time constants alike, 1 ms to 10 s."""
    times = np.geomspace(1e-3, 10.0, 13)
    return (1 - share) * y + share * np.mean([lagged(y, fs, tau) for tau in times if tau * fs > 0.5], axis=0)


def raster(rng: np.random.Generator) -> Made:
    """Plays with dead zones: lines of a raster on a staircase, 1 kHz"""
    t = clock(24.0, 1e3)
    v = 0.15 + 0.3 * low_pass(up_and_down(t, 2.0), 1e3, 60.0) + 0.5 * np.floor(2 * t) / 48
    return t, 110 * v, 45 * dead_zones(stop_elements(v, rng)) + rng.normal(0, 0.01, t.size)


def two_level(rng: np.random.Generator) -> Made:
    """Preisach, lag of 4 ms: pseudo-random binary steps on three levels, 500 Hz"""
    t = clock(30.0, 500.0)
    v = rng.integers(0, 2, 151)[(5 * t).astype(int)] * 0.35 + np.choose((t / 2).astype(int) % 3, [0.05, 0.3, 0.6])
    return t, 100 * v, 12 * lagged(preisach(v, rng), 500.0, 0.004) + rng.normal(0, 0.008, t.size)


def spiral(rng: np.random.Generator) -> Made:
    """Backlash-like with a bent curve: a spiral in and out, 2 kHz"""
    t = clock(8.0, 2e3)
    v = 0.5 + 0.5 * (1 - up_and_down(t, 0.25) * 0.9) * np.sin(2 * np.pi * 4.0 * t - 0.5 * np.pi)
    return t, 10 * v, 30 * backlash_like(v) + rng.normal(0, 0.02, t.size)


def modulated(rng: np.random.Generator) -> Made:
    """Plays with thresholds that grow with the rate: sines of changing amplitude and frequency, 5 kHz"""
    t = clock(6.0, 5e3)
    phase = 2 * np.pi * np.cumsum(3.0 + 22.0 * sine(t, 0.37)) / 5e3
    v = 0.5 - (0.15 + 0.35 * sine(t, 0.9)) * np.cos(phase)
    return t, 120 * v, 18 * moving_thresholds(v, 5e3, rng, 0.004) + rng.normal(0, 0.01, t.size)


def bias_loops(rng: np.random.Generator) -> Made:
    """Ramped relays: small loops at random biases, held in between, 200 Hz"""
    t = clock(90.0, 200.0)
    bias = low_pass(rng.uniform(0.1, 0.9, 31)[(t / 3).astype(int)], 200.0, 2.0)
    size = rng.uniform(0.02, 0.1, 31)[(t / 3).astype(int)]
    v = bias + np.where(t % 3 > 1.5, size * np.sin(2 * np.pi * 2 * t), 0.0)
    return t, 60 * v, 80 * saturating(v, rng) + rng.normal(0, 0.02, t.size)


def stick(rng: np.random.Generator) -> Made:
    """LuGre friction: wave below 6 Hz, 1 kHz"""
    t = clock(15.0, 1e3)
    v = wave(t, rng, 6.0)
    return t, 100 * v, 60 * lugre(v, 1e3) + rng.normal(0, 0.03, t.size)


def domains(rng: np.random.Generator) -> Made:
    """Domains that switch in time: triangles of many sizes and rates, 100 Hz"""
    t = clock(60.0, 100.0)
    phase = np.cumsum(rng.uniform(0.2, 1.5, 31)[(t / 2).astype(int)]) / 100.0
    v = up_and_down(phase, 1.0) * rng.uniform(0.4, 1.0, 31)[(t / 2).astype(int)]
    v = low_pass(v, 100.0, 8.0)
    return t, 1000 * v, 25 * switching(v, 100.0, rng) + rng.normal(0, 0.01, t.size)


def constant_phase_element(rng: np.random.Generator) -> Made:
    """Maxwell slip behind a constant-phase lag: tones of three decades, 400 Hz"""
    t = clock(40.0, 400.0)
    v = sum(a * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f, a in ((0.07, 3.0), (0.71, 2.0), (6.1, 1.0)))
    v = (v - v.min()) / np.ptp(v)
    return t, 30 * v, 7 * constant_phase(maxwell_slip(v, rng), 400.0, 0.08) + rng.normal(0, 0.004, t.size)


def magnetostrictive(rng: np.random.Generator) -> Made:
    """Square of a Jiles-Atherton magnetisation on a bias: wave below 3 Hz, 250 Hz"""
    t = clock(40.0, 250.0)
    v = 0.15 + 0.7 * wave(t, rng, 3.0)
    m = jiles_atherton(np.concatenate([np.linspace(0, v[0], 200), v]))[200:]
    return t, 10 * v, 20 * m**2 + rng.normal(0, 0.02, t.size)


def interferometer(rng: np.random.Generator) -> Made:
    """Preisach, a sensor with a periodic error of 2 nm: slow ramps and turns, 200 Hz"""
    t = clock(60.0, 200.0)
    v = low_pass(np.interp(t, np.arange(0, 62, 2.0), rng.uniform(0, 1, 31)), 200.0, 10.0)
    z = 5 * preisach(v, rng)
    return t, 75 * v, z + 0.002 * np.sin(4 * np.pi * z / 0.633) + rng.normal(0, 0.001, t.size)


def room(rng: np.random.Generator) -> Made:
    """Bouc-Wen, zero that follows the air conditioning: triangles and rests, 5 Hz, 40 minutes"""
    t = clock(2400.0, 5.0)
    v = up_and_down(t, 1 / 60) * (0.4 + 0.6 * rng.random(41)[(t / 60).astype(int)]) * ((t / 60).astype(int) % 5 < 4)
    z = 100 * creep(bouc_wen(v, 0.3, 1.8, -0.3), 5.0, 0.01) + 0.25 * np.sin(2 * np.pi * t / 700 + rng.uniform(0, 6))
    return t, 100 * v, z + rng.normal(0, 0.02, t.size)


def bent_sensor(rng: np.random.Generator) -> Made:
    """Two stacks in series, a sensor that is 0.5 % bent: wave below 50 Hz, 10 kHz"""
    t = clock(3.0, 1e4)
    v = wave(t, rng, 50.0)
    y = 0.5 * stop_elements(v, rng) + 0.5 * preisach(v, rng)
    z = late(t, y, 3e-4)
    return t, 150 * v, 32 * (z + 0.02 * z * (1 - z)) + rng.normal(0, 0.01, t.size)


def floor(rng: np.random.Generator) -> Made:
    """Maxwell slip, a mode at 310 Hz, a floor that shakes at 17 Hz: wave below 20 Hz, 4 kHz"""
    t = clock(6.0, 4e3)
    v = wave(t, rng, 20.0)
    shakes = 0.006 * np.sin(2 * np.pi * 17.3 * t) * (1 + 0.5 * np.sin(2 * np.pi * 0.3 * t + 1.0))
    return t, 5 * v, 4 * resonance(maxwell_slip(v, rng), 4e3, 310.0, 0.03) + shakes + rng.normal(0, 0.002, t.size)


def stack_of_charge(rng: np.random.Generator) -> Made:
    """Duhem behind a capacitance that grows with the voltage: two tones that beat, 3 kHz"""
    t = clock(5.0, 3e3)
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 9.0 * t) + np.cos(2 * np.pi * 11.3 * t))
    u, held = np.empty_like(v), 0.0
    for k, x in enumerate(v):
        held += (x - held) * -np.expm1(-1 / (3e3 * 4e-4 * (1 + 0.5 * held)))
        u[k] = held
    return t, 24 * v, 0.3 * backlash_like(u, 3.0) + rng.normal(0, 2e-4, t.size)


def bimorph(rng: np.random.Generator) -> Made:
    """Preisach, 0.5 mm bimorph, log creep, counts of 12 bits: sines of growing height with rests, 20 Hz"""
    t = clock(300.0, 20.0)
    part = (t / 10).astype(int)
    v = np.where(part % 4 == 3, 0.5, 0.5 + 0.5 * rng.uniform(0.2, 1.0, 31)[part] * np.sin(2 * np.pi * 0.4 * t))
    v = low_pass(v, 20.0, 2.0)
    return t, 200 * v, quantised(500 * creep(preisach(v, rng), 20.0, 0.02), 600 / 4096) + rng.normal(0, 0.05, t.size)


MAKERS: Makers = (
    raster,
    two_level,
    spiral,
    modulated,
    bias_loops,
    stick,
    domains,
    constant_phase_element,
    magnetostrictive,
    interferometer,
    room,
    bent_sensor,
    floor,
    stack_of_charge,
    bimorph,
)


def records(seed: int = 0, makers: Makers = MAKERS) -> Iterator[Record]:
    """The records of this seed, none of which is one of the other collections."""
    return drawn(MAKERS, makers, 200 + seed)
