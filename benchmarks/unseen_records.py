"""Records of actuators on which no threshold of `identify` was chosen: other structures, units, rates and lengths.

`benchmarks.coverage` and `benchmarks.foreign_rivals` take them with --unseen. Voltages are in V and displacements in um
throughout, as everywhere; the strokes go from 0.08 um to 2 mm, the rates from 0.5 Hz to 50 kHz.
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
    lagged,
    low_pass,
    quantised,
    resonance,
    sine,
    up_and_down,
    wave,
)

from truestroke.identification import Record

Made = tuple[np.ndarray, np.ndarray, np.ndarray]  # s, V, um


def maxwell_slip(v: np.ndarray, rng: np.random.Generator, elements: int = 9) -> np.ndarray:
    """Springs with sliders of random strength (Goldfarb and Celanovic 1997), between voltage and displacement."""
    k, limit = rng.uniform(0.02, 0.06, elements), np.geomspace(0.002, 0.05, elements)
    force, out = np.zeros(elements), np.empty(v.size)
    for i, dv in enumerate(np.diff(v, prepend=v[0])):
        force = np.clip(force + k * dv, -k * limit / 0.05, k * limit / 0.05)
        out[i] = force.sum()
    return v - 1.5 * out


def backlash(v: np.ndarray, gap: float) -> np.ndarray:
    """One play."""
    y, out = 0.0, np.empty(v.size)
    for i, x in enumerate(v):
        y = max(x - gap, min(x + gap, y))
        out[i] = y
    return out


def saturating(v: np.ndarray, rng: np.random.Generator, elements: int = 30) -> np.ndarray:
    """Krasnoselskii and Pokrovskii: relays with ramps in place of jumps, on a grid of random density."""
    low, width, ramp = rng.beta(1.3, 1.3, elements), rng.exponential(0.15, elements), 0.15
    state, out = np.zeros(elements), np.empty(v.size)
    for i, x in enumerate(v):
        up, down = np.clip((x - low - width) / ramp, 0, 1), np.clip((x - low + width) / ramp, 0, 1)
        state = np.maximum(up, np.minimum(down, state))
        out[i] = state.mean()
    return 0.3 * v + 0.7 * out


def rate_dependent_bouc_wen(v: np.ndarray, fs: float, widens: float) -> np.ndarray:
    """Bouc and Wen, whose loops grow with the logarithm of the rate."""
    h, rate = np.zeros(v.size), np.abs(np.gradient(v) * fs)
    for i, dv in enumerate(np.diff(v), 1):
        alpha = 0.3 * (1 + widens * np.log10(1 + rate[i]))
        h[i] = h[i - 1] + alpha * dv - 2.0 * abs(dv) * h[i - 1] + 0.5 * dv * abs(h[i - 1])
    return v - h


def fractional_creep(y: np.ndarray, fs: float, share: float, power: float) -> np.ndarray:
    """Creep as a power of the time behind each step, by a sum of lags whose weights are that power's."""
    slow, times = np.zeros_like(y), np.geomspace(1 / fs, 1e4, 20)
    for tau in times:
        slow += (lagged(y, fs, tau) - y[0]) * (tau / times[-1]) ** power
    return y + share * slow


def nanometres(rng: np.random.Generator) -> Made:
    """Maxwell slip, 80 nm, noise of 0.1 nm: multi-tone below 400 Hz, 50 kHz, 0.5 s"""
    t = clock(0.5, 5e4)
    v = wave(t, rng, 400.0, 12)
    return t, 5 * v - 2, 0.08 * maxwell_slip(v, rng) + rng.normal(0, 1e-4, t.size)


def millimetres(rng: np.random.Generator) -> Made:
    """Ramped relays, power-law creep, 2 mm: triangles of random height, 0.5 Hz, 2 hours"""
    t = clock(7200.0, 0.5)
    height = rng.uniform(0.2, 1.0, 40)[(t / 300).astype(int)]
    v = up_and_down(t, 1 / 300.0) * height
    return t, 12 * v, 2000 * fractional_creep(saturating(v, rng), 0.5, 0.03, 0.15) + rng.normal(0, 1.0, t.size)


def one_play(rng: np.random.Generator) -> Made:
    """Backlash of 6 % alone, in series with a lag: chirp up and down, 400 Hz"""
    t = clock(30.0, 400.0)
    phase = 2 * np.pi * np.cumsum(0.3 + 2.0 * up_and_down(t, 1 / 15)) / 400
    v = (0.5 - 0.5 * np.cos(phase)) * rng.uniform(0.5, 1.0, 30)[(t).astype(int)]
    v = low_pass(v, 400.0, 8.0)
    return t, 200 * v, 120 * lagged(backlash(v, 0.06), 400.0, 0.02) + rng.normal(0, 0.1, t.size)


def faster_wider(rng: np.random.Generator) -> Made:
    """Bouc-Wen whose loops widen with the rate: wave below 30 Hz in bursts, 4 kHz"""
    t = clock(8.0, 4e3)
    burst = 0.3 + 0.7 * (np.sin(2 * np.pi * 0.4 * t + 0.5) > 0)
    v = 0.5 + (wave(t, rng, 30.0) - 0.5) * low_pass(burst, 4e3, 5.0)
    return t, 60 * v, 9 * rate_dependent_bouc_wen(v, 4e3, 0.08) + rng.normal(0, 0.006, t.size)


def pink_sensor(rng: np.random.Generator) -> Made:
    """Maxwell slip behind a sensor with 1/f noise: staircase of both ways with ramps, 250 Hz"""
    t = clock(60.0, 250.0)
    v = low_pass(rng.uniform(0, 1, 121)[(t / 0.5).astype(int)], 250.0, 3.0)
    f = np.fft.rfftfreq(t.size, 1 / 250.0)
    pink = np.fft.irfft(np.fft.rfft(rng.normal(0, 1, t.size)) / np.sqrt(np.maximum(f, f[1])), t.size)
    return t, 100 * v, 16 * maxwell_slip(v, rng) + 0.02 * pink / pink.std() + rng.normal(0, 0.005, t.size)


def warming_up(rng: np.random.Generator) -> Made:
    """Ramped relays whose gain grows by 1 % as they warm up: random wave below 2 Hz, 100 Hz, 5 minutes"""
    t = clock(300.0, 100.0)
    v = wave(t, rng, 2.0)
    gain = 1 + 0.01 * (1 - np.exp(-t / 120))
    return t, 24 * v, 50 * gain * saturating(v, rng) + rng.normal(0, 0.02, t.size)


def friction(rng: np.random.Generator) -> Made:
    """Dahl: sines of random height, 1 kHz"""
    t = clock(12.0, 1e3)
    v = 0.5 + (sine(t, 1.5) - 0.5) * rng.uniform(0.4, 1.0, 18)[np.minimum((1.5 * t).astype(int), 17)]
    v = low_pass(v, 1e3, 30.0)
    return t, 80 * v, 35 * dahl(v) + rng.normal(0, 0.01, t.size)


def outliers(rng: np.random.Generator) -> Made:
    """Ramped relays, noise of Student's t with three degrees of freedom: wave below 8 Hz, 1 kHz"""
    t = clock(15.0, 1e3)
    v = wave(t, rng, 8.0)
    return t, 3 * v - 1, 4 * saturating(v, rng) + 0.004 * rng.standard_t(3, t.size)


def two_modes(rng: np.random.Generator) -> Made:
    """Maxwell slip, modes at 90 and 240 Hz: hard steps and a wave, 2 kHz"""
    t = clock(10.0, 2e3)
    v = 0.5 * rng.uniform(0, 1, 40)[(t / 0.25).astype(int)] + 0.5 * wave(t, rng, 20.0)
    y = maxwell_slip(v, rng)
    z = 0.8 * resonance(y, 2e3, 90.0, 0.04) + 0.2 * resonance(y, 2e3, 240.0, 0.02)
    return t, 10 * v, 8 * z + rng.normal(0, 0.004, t.size)


def coarse(rng: np.random.Generator) -> Made:
    """Ramped relays, a sensor of 8 bits, linear drift of 2 %: triangles of many sizes, 50 Hz"""
    t = clock(120.0, 50.0)
    v = up_and_down(t, 0.2) * rng.uniform(0.3, 1.0, 24)[np.minimum((0.2 * t).astype(int), 23)]
    return t, 1000 * v, quantised(70 * saturating(v, rng) + 1.4 * t / 120, 70 / 256)


def clock_of_software(rng: np.random.Generator) -> Made:
    """Maxwell slip, creep: true times up to 20 % of the interval off the stamps, wave below 3 Hz, 200 Hz"""
    t = clock(40.0, 200.0)
    v = wave(t, rng, 3.0)
    z = 30 * creep(maxwell_slip(v, rng), 200.0, 0.01)
    return t, 90 * v, np.interp(t + rng.uniform(-1e-3, 1e-3, t.size), t, z) + rng.normal(0, 0.01, t.size)


def clipped_at_both_ends(rng: np.random.Generator) -> Made:
    """Rate-dependent Bouc-Wen, a sensor that ends at 6 and 93 %: two tones, 500 Hz"""
    t = clock(20.0, 500.0)
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 0.9 * t) + np.cos(2 * np.pi * 2.3 * t))
    z = 14 * rate_dependent_bouc_wen(v, 500.0, 0.05) + rng.normal(0, 0.005, t.size)
    low, high = z.min() + 0.06 * np.ptp(z), z.max() - 0.07 * np.ptp(z)
    return t, 75 * v, np.clip(z, low, high)


MAKERS: Makers = (
    nanometres,
    millimetres,
    one_play,
    faster_wider,
    pink_sensor,
    warming_up,
    friction,
    outliers,
    two_modes,
    coarse,
    clock_of_software,
    clipped_at_both_ends,
)


def records(seed: int = 0, makers: Makers = MAKERS) -> Iterator[Record]:
    """The records of this seed, none of which is one of the other collections."""
    return drawn(MAKERS, makers, 100 + seed)
