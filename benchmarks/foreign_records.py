"""Records of actuators that are built otherwise than the model: how well `identify` predicts what it never saw.

python benchmarks/foreign_records.py          the table of docs/identify.md; about a minute
python -m benchmarks.foreign_rivals           the same records beside the models of others; some minutes
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.signal import bessel, chirp, cont2discrete, lfilter, sawtooth, sosfilt

from truestroke.identification import Record, identify
from truestroke.model.operators import play_history

SHARE = 0.6  # of the record, at its start, that all are fitted to

# ---- Hysteresis, of a voltage and for a displacement of about 0 to 1 -------------------------------------------------


def bouc_wen(v: np.ndarray, alpha: float = 0.35, beta: float = 2.2, gamma: float = -0.6) -> np.ndarray:
    """h' = alpha v' - beta |v'| h - gamma v' |h|, y = v - h: asymmetric, as Low and Guo (1995) have it for stacks."""
    h = np.zeros(v.size)
    for k, dv in enumerate(np.diff(v), 1):
        h[k] = h[k - 1] + alpha * dv - beta * abs(dv) * h[k - 1] - gamma * dv * abs(h[k - 1])
    return v - h


def preisach(v: np.ndarray, rng: np.random.Generator, relays: int = 4000) -> np.ndarray:
    """Relays with random switching points, more of them near the diagonal and at high voltage; and half a line."""
    middle, half = rng.beta(1.6, 1.2, relays), rng.exponential(0.12, relays)
    weights = rng.lognormal(0.0, 0.8, relays) / relays
    closes, opens = middle + half, middle - half
    state, out, before = np.zeros(relays), np.empty(v.size), -np.inf
    for k, x in enumerate(v):
        if x > before:
            np.putmask(state, x > closes, 1.0)
        else:
            np.putmask(state, x < opens, 0.0)
        out[k], before = weights @ state, x
    return 0.5 * v + 0.5 * out


def duhem(v: np.ndarray, alpha: float = 6.0, slope: float = 0.6) -> np.ndarray:
    """y' = alpha |v'| (f(v) - y) + slope v', f(v) = 0.75 v + 0.35 v^2 (Coleman and Hodgdon)."""
    y = np.zeros(v.size)
    for k, dv in enumerate(np.diff(v), 1):
        aim = 0.75 * v[k] + 0.35 * v[k] ** 2
        y[k] = aim + (y[k - 1] + slope * dv - aim) * np.exp(-alpha * abs(dv))
    return y


def dahl(v: np.ndarray, sigma: float = 9.0, friction: float = 0.12) -> np.ndarray:
    """F' = sigma v' (1 - sgn(v') F / friction)^1.5 with a softening spring, y = v + 0.1 v^2 - F / 2."""
    F = np.zeros(v.size)
    for k, dv in enumerate(np.diff(v), 1):
        share = max(1 - np.sign(dv) * F[k - 1] / friction, 0.0)
        F[k] = np.clip(F[k - 1] + 0.3 * sigma * dv * share**1.5, -friction, friction)
    return v + 0.1 * v**2 - 0.5 * F


def generalised_plays(v: np.ndarray) -> np.ndarray:
    """Plays between two tanh envelopes (Al Janaideh et al. 2009): a loop that saturates at both ends."""
    rise, fall = np.tanh(2.6 * v - 1.4), np.tanh(2.4 * v - 1.0)
    y = 0.15 * v
    for r in np.linspace(0.0, 0.5, 12):
        state, out = 0.0, np.empty(v.size)
        for k in range(v.size):
            state = max(rise[k] - r, min(fall[k] + r, state))
            out[k] = state
        y = y + 0.09 * np.exp(-3 * r) * out
    return y


def jiles_atherton(v: np.ndarray, a: float = 0.3, k: float = 0.18, c: float = 0.25, mean: float = 0.35) -> np.ndarray:
    """dM / dH of Jiles and Atherton with Langevin's anhysteretic; v from -1 to 1."""
    m = np.zeros(v.size)
    for i, dv in enumerate(np.diff(v), 1):
        field = (v[i] + mean * m[i - 1]) / a
        still = 1 / np.tanh(field) - 1 / field if abs(field) > 1e-3 else field / 3
        spread = 1 / a * (1 / field**2 - 1 / np.sinh(field) ** 2 if abs(field) > 1e-2 else 1 / 3)
        free = max((still - m[i - 1]) * np.sign(dv), 0.0)
        m[i] = m[i - 1] + abs(dv) * free / k * np.sign(dv) + c * spread * dv
    return m


def stop_elements(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Forty plays of random thresholds and weights, on a voltage that is bent before them."""
    r, w = np.sort(rng.uniform(0.0, 0.45, 40)), rng.exponential(1.0, 40) * 0.012
    return 0.6 * v + play_history(v + 0.15 * v**2, r) @ w


# ---- Dynamics and recording ------------------------------------------------------------------------------------------


def creep(y: np.ndarray, fs: float, share: float, slowest: float = 1e3) -> np.ndarray:
    """About share * log10(t) behind a step, by two first-order states a decade from 10 ms on."""
    slow = np.zeros_like(y)
    for tau in np.geomspace(0.01, slowest, int(2 * np.log10(100 * slowest)) + 1):
        q = -np.expm1(-1 / (tau * fs))
        slow += y[0] + lfilter([q], [1, q - 1], y - y[0])
    return y + 0.5 * share * slow


def resonance(y: np.ndarray, fs: float, frequency: float, damping: float) -> np.ndarray:
    w = 2 * np.pi * frequency
    b, a, _ = cont2discrete(([w * w], [1, 2 * damping * w, w * w]), 1 / fs, method="zoh")
    return y[0] + lfilter(b.ravel(), a, y - y[0])


def low_pass(y: np.ndarray, fs: float, frequency: float) -> np.ndarray:
    return y[0] + sosfilt(bessel(2, frequency, fs=fs, output="sos", norm="mag"), y - y[0])


def late(t: np.ndarray, y: np.ndarray, delay: float) -> np.ndarray:
    return np.interp(t - delay, t, y)


def quantised(y: np.ndarray, step: float) -> np.ndarray:
    return step * np.round(y / step)


def clock(seconds: float, rate: float) -> np.ndarray:
    return np.arange(round(seconds * rate)) / rate


def up_and_down(t: np.ndarray, frequency: float) -> np.ndarray:
    """Triangle from 0 to 1 that starts at 0."""
    return 0.5 + 0.5 * sawtooth(2 * np.pi * frequency * t, 0.5)


def sine(t: np.ndarray, frequency: float) -> np.ndarray:
    return 0.5 - 0.5 * np.cos(2 * np.pi * frequency * t)


def wave(t: np.ndarray, rng: np.random.Generator, highest: float, lines: int = 20) -> np.ndarray:
    f, phase = rng.uniform(0.05 * highest, highest, lines), rng.uniform(0, 2 * np.pi, lines)
    s = sum(np.sin(2 * np.pi * a * t + b) for a, b in zip(f, phase, strict=True))
    return (s - s.min()) / np.ptp(s)


Made = tuple[np.ndarray, np.ndarray, np.ndarray]  # s, V, um


def sines_of_a_stack(rng: np.random.Generator) -> Made:
    """Bouc-Wen: five periods of one sine, 0 to 100 V, 1 kHz"""
    t = clock(5.0, 1e3)
    return t, 100 * sine(t, 1.0), 12 * bouc_wen(sine(t, 1.0)) + rng.normal(0, 0.005, t.size)


def decaying_triangles(rng: np.random.Generator) -> Made:
    """Preisach, log creep: triangles that decay from 150 V, 200 Hz"""
    t = clock(50.0, 200.0)
    v = up_and_down(t, 0.25) * (1 - t / 60)
    return t, 150 * v, 90 * creep(preisach(v, rng), 200.0, 0.012) - 35 + rng.normal(0, 0.02, t.size)


def rising_triangles(rng: np.random.Generator) -> Made:
    """Preisach: triangles that grow beyond what the fit has seen, 500 Hz"""
    t = clock(24.0, 500.0)
    v = up_and_down(t, 0.5) * (0.15 + 0.85 * np.ceil((t + 1e-9) / 2) / 12)
    return t, 120 * v, 30 * preisach(v, rng) + rng.normal(0, 0.01, t.size)


def sweep(rng: np.random.Generator) -> Made:
    """Duhem, resonance at 600 Hz: sweep of 1 to 120 Hz, 10 kHz; the fit sees 18 Hz"""
    t = clock(6.0, 1e4)
    v = 0.5 - 0.5 * chirp(t, 1.0, 6.0, 120.0, method="logarithmic")
    return t, 75 * v, 15 * resonance(duhem(v), 1e4, 600.0, 0.03) + rng.normal(0, 0.01, t.size)


def several_rates(rng: np.random.Generator) -> Made:
    """Plays between tanh envelopes, lag: 1, 10, 50, 5, 20 Hz in turn, 20 kHz"""
    t = clock(4.0, 2e4)
    phase = np.cumsum(np.select([t < 1, t < 1.6, t < 2, t < 3], [1.0, 10.0, 50.0, 5.0], 20.0)) / 2e4
    v = 0.5 - 0.5 * np.cos(2 * np.pi * phase)
    return t, 10 * v, 8 * low_pass(generalised_plays(v), 2e4, 300.0) + rng.normal(0, 0.004, t.size)


def normalised(rng: np.random.Generator) -> Made:
    """Jiles-Atherton: triangles of three sizes, both signals from -1 to 1, 100 Hz"""
    t = clock(40.0, 100.0)
    v = (2 * up_and_down(t + 0.5, 0.5) - 1) * np.choose((t / 4).astype(int) % 3, [1.0, 0.6, 0.8])
    return t, v, jiles_atherton(v) / 0.85 + rng.normal(0, 0.002, t.size)


def staircase(rng: np.random.Generator) -> Made:
    """Preisach, log creep, drift: steps of random height, held for 2 s, 50 Hz"""
    t = clock(160.0, 50.0)
    v = low_pass(rng.uniform(0.0, 1.0, 80)[(t / 2).astype(int)], 50.0, 5.0)
    return t, 100 * v, 20 * creep(preisach(v, rng), 50.0, 0.015) + 0.004 * t + rng.normal(0, 0.01, t.size)


def software_timed(rng: np.random.Generator) -> Made:
    """Plays and a parabola: reversal curves, jitter, coarse sensor, noise on the voltage, 3 holes, 100 Hz"""
    t = clock(80.0, 100.0)
    v = 1 - up_and_down(t + 2.0, 0.25) * (0.1 + 0.9 * np.floor((t + 2) / 4) / 20)
    z = np.interp(t + rng.uniform(-2e-3, 2e-3, t.size), t, 40 * stop_elements(v, rng))
    keep = np.ones(t.size, dtype=bool)
    for start in (1500, 3900, 6400):
        keep[start : start + 40] = False
    return t[keep], (3.6 * v + rng.normal(0, 0.004, t.size))[keep], quantised(z, 0.05)[keep] - 60


def fast(rng: np.random.Generator) -> Made:
    """Random plays, low pass of 1.5 kHz: wave below 200 Hz, 100 kHz, 1 s"""
    t = clock(1.0, 1e5)
    v = wave(t, rng, 200.0)
    z = 6 * low_pass(stop_elements(v, rng), 1e5, 1500.0)
    return t, 150 * v - 20, z + rng.normal(0, 0.01, t.size)


def random_wave(rng: np.random.Generator) -> Made:
    """Preisach, log creep, 3 ms late, offset, 0.3 % noise: wave below 10 Hz, 2 kHz"""
    t = clock(10.0, 2e3)
    v = wave(t, rng, 10.0)
    z = late(t, 30 * creep(preisach(v, rng), 2e3, 0.01), 3e-3)
    return t, 1.5 * v + 0.3, z - 80 + rng.normal(0, 0.09, t.size)


def short(rng: np.random.Generator) -> Made:
    """Dahl: three periods of 50 Hz, 400 rows"""
    t = clock(0.06, 400 / 0.06)
    return t, 60 * sine(t, 50.0), 5 * dahl(sine(t, 50.0)) + rng.normal(0, 0.01, t.size)


def bipolar(rng: np.random.Generator) -> Made:
    """Duhem, mains hum: two tones, -30 to 150 V, 5 kHz"""
    t = clock(8.0, 5e3)
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 1.3 * t) + np.cos(2 * np.pi * 3.1 * t))
    z = 60 * duhem(v) + 0.08 * np.sin(2 * np.pi * 50 * t) + rng.normal(0, 0.02, t.size)
    return t, 180 * v - 30, z


def slow_triangles(rng: np.random.Generator) -> Made:
    """Bouc-Wen, much creep, thermal drift: triangles of 0.02 Hz, 10 Hz, 8 minutes"""
    t = clock(480.0, 10.0)
    v = up_and_down(t, 0.02)
    return t, 100 * v, 50 * creep(bouc_wen(v), 10.0, 0.03) + 1.5e-3 * t + rng.normal(0, 0.01, t.size)


def ringing(rng: np.random.Generator) -> Made:
    """Duhem, lightly damped resonance at 180 Hz: hard steps, 5 kHz"""
    t = clock(10.0, 5e3)
    v = rng.uniform(0.0, 1.0, 50)[(t / 0.2).astype(int)]
    return t, 10 * v, 10 * resonance(duhem(v), 5e3, 180.0, 0.05) + rng.normal(0, 0.01, t.size)


def closed_loop(rng: np.random.Generator) -> Made:
    """None at all: a linear stage with 2 ms of lag, wave below 5 Hz, 1 kHz"""
    t = clock(12.0, 1e3)
    v = wave(t, rng, 5.0)
    return t, 10 * v, late(t, 100 * v, 2e-3) + rng.normal(0, 0.01, t.size)


# ---- What surrounds the hysteresis -----------------------------------------------------------------------------------


def lagged(y: np.ndarray, fs: float, tau: float) -> np.ndarray:
    """First-order lag of tau, s."""
    q = -np.expm1(-1 / (tau * fs))
    return y[0] + lfilter([q], [1, q - 1], y - y[0])


def wide_envelopes(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Plays between envelopes that bend up on the way up and down on the way down, as in large bipolar fields; v from
    -1 to 1. The envelopes are exponential and hyperbolic, their thresholds and weights random."""
    rise, fall = np.expm1(0.9 * v) / 0.9, 1.1 * np.log1p(0.55 * (v + 1.0)) / 0.55 - 1.05
    y = 0.3 * v
    for r, w in zip(np.sort(rng.uniform(0.1, 1.1, 20)), rng.exponential(1.0, 20), strict=True):
        state, out = 0.0, np.empty(v.size)
        for k in range(v.size):
            state = max(rise[k] - r, min(fall[k] + r, state))
            out[k] = state
        y = y + 0.045 * w * out
    return y


def sine_and_step(rng: np.random.Generator) -> Made:
    """Preisach, lag of 0.25 ms: one sine and one large step, then more, 2 kHz"""
    t = clock(8.0, 2e3)
    parts = [sine(t, 1.0), np.zeros_like(t), 0.9 + 0 * t, 0.9 - 0.7 * sine(t - 5.2, 0.83), 0.2 + 0 * t]
    v = np.select([t < 4, t < 4.4, t < 5.2, t < 6.4, t < 6.8], parts, 0.2 + 0.6 * sine(t - 6.8, 1.7))
    return t, 100 * v, 18 * lagged(preisach(v, rng), 2e3, 2.5e-4) + rng.normal(0, 0.01, t.size)


def rest_first(rng: np.random.Generator) -> Made:
    """Preisach, log creep: 4 s of rest in the middle, then triangles of many sizes, 500 Hz"""
    t = clock(20.0, 500.0)
    size = np.array([1.0, 0.7, 0.9, 0.4, 1.0, 0.8, 0.3, 0.6])[np.minimum((np.maximum(t - 4, 0) / 2).astype(int), 7)]
    v = 0.45 + np.where(t < 4, 0.0, 0.45 * size * (2 * up_and_down(t + 0.5, 0.5) - 1))
    before = np.concatenate([0.9 * up_and_down(clock(4.0, 500.0), 0.5), np.linspace(0.0, v[0], 200)])
    z = creep(preisach(np.concatenate([before, v]), rng), 500.0, 0.01)[before.size :]
    return t, 100 * v, 25 * z + rng.normal(0, 0.01, t.size)


def from_near_zero(rng: np.random.Generator) -> Made:
    """Preisach: begins near 0 V on the way down from a larger motion, wave below 4 Hz, 1 kHz"""
    t = clock(14.0, 1e3)
    v = wave(t, rng, 4.0)
    v = 1.3 * v - 0.3
    start = int(np.argmax((np.abs(v) < 0.005) & (np.gradient(v) < 0) & (t > 3.0)))
    z = 22 * preisach(v + 0.3, rng)
    return t[start:] - t[start], 100 * v[start:], (z - 6.0 + rng.normal(0, 0.01, t.size))[start:]


def modes_excited(rng: np.random.Generator) -> Made:
    """Bouc-Wen, three lightly damped modes from 170 Hz on: steps and noise that excite them, 5 kHz"""
    t = clock(6.0, 5e3)
    steps = rng.uniform(0.1, 0.9, 60)[(t / 0.1).astype(int)]
    v = low_pass(np.clip(steps + 0.06 * rng.standard_normal(t.size), 0.0, 1.0), 5e3, 900.0)
    y = bouc_wen(v)
    modes = ((0.75, 170.0, 0.03), (0.17, 395.0, 0.02), (0.08, 710.0, 0.025))
    z = 20 * sum(share * resonance(y, 5e3, f, damping) for share, f, damping in modes)
    return t, 100 * v, z + rng.normal(0, 0.01, t.size)


def log_drift(rng: np.random.Generator) -> Made:
    """Bouc-Wen, log drift that is no creep of this voltage: triangles of two sizes, 100 Hz"""
    t = clock(60.0, 100.0)
    v = up_and_down(t, 0.25) * np.where((t / 4).astype(int) % 2, 0.6, 1.0)
    return t, 120 * v, 40 * bouc_wen(v) + 0.9 * np.log(1 + t / 1.5) + rng.normal(0, 0.01, t.size)


def thermal_walk(rng: np.random.Generator) -> Made:
    """Preisach, zero that walks randomly with temperature: wave below 1 Hz, 100 Hz"""
    t = clock(80.0, 100.0)
    v = wave(t, rng, 1.0)
    walk = np.cumsum(rng.normal(0, 0.006, t.size))
    return t, 100 * v, 30 * preisach(v, rng) + walk + rng.normal(0, 0.01, t.size)


def large_fields(rng: np.random.Generator) -> Made:
    """Plays between unlike envelopes: bipolar triangles of many sizes, 500 Hz"""
    t = clock(24.0, 500.0)
    size = np.array([1.0, 0.8, 0.5, 0.9, 0.3, 1.0, 0.7, 0.95, 0.4, 0.85, 0.6, 1.0])[(t / 2).astype(int)]
    v = size * (2 * up_and_down(t + 0.5, 0.5) - 1)
    return t, 400 * v, 45 * wide_envelopes(v, rng) + rng.normal(0, 0.02, t.size)


def two_days(rng: np.random.Generator) -> Made:
    """Preisach: the last two fifths are of the next day, with another zero, wave below 3 Hz, 500 Hz"""
    t = clock(20.0, 500.0)
    v, day = wave(t, rng, 3.0), t >= SHARE * 20.0
    z = 30 * preisach(v, rng) + rng.normal(0, 0.01, t.size)
    return t + 86400.0 * day, 100 * v, z + 1.1 * day


def jittering_clock(rng: np.random.Generator) -> Made:
    """Bouc-Wen: true times 1 % of the interval off the stamps, two tones, 1 kHz"""
    t = clock(10.0, 1e3)
    true = t + rng.normal(0, 1e-5, t.size)
    v = 0.5 - 0.25 * (np.cos(2 * np.pi * 2.1 * true) + np.cos(2 * np.pi * 5.3 * true))
    return t, 100 * v, 25 * bouc_wen(v) + rng.normal(0, 0.005, t.size)


def clipped_sensor(rng: np.random.Generator) -> Made:
    """Preisach: a sensor that ends at 88 % of the travel, wave below 5 Hz, 1 kHz"""
    t = clock(12.0, 1e3)
    v = wave(t, rng, 5.0)
    z = 20 * preisach(v, rng) + rng.normal(0, 0.005, t.size)
    return t, 100 * v, np.minimum(z, 0.88 * z.max() + 0.12 * z.min())


Makers = tuple[Callable[[np.random.Generator], Made], ...]
MAKERS: Makers = (
    sines_of_a_stack,
    decaying_triangles,
    rising_triangles,
    sweep,
    several_rates,
    normalised,
    staircase,
    software_timed,
    fast,
    random_wave,
    short,
    bipolar,
    slow_triangles,
    ringing,
    closed_loop,
    sine_and_step,
    rest_first,
    from_near_zero,
    modes_excited,
    log_drift,
    thermal_walk,
    large_fields,
    two_days,
    jittering_clock,
    clipped_sensor,
)


def drawn(every: Makers, makers: Makers, seed: int) -> Iterator[Record]:
    """The records of some makers, each with a sequence of its own by its place among `every`.

    The first line of a maker's text is the source.
    """
    for maker in makers:
        rng = np.random.Generator(np.random.PCG64([seed, every.index(maker)]))
        t, volts, z = maker(rng)
        yield Record.from_arrays(volts, z, time=t, source=str(maker.__doc__).splitlines()[0])


def records(seed: int = 0, makers: Makers = MAKERS) -> Iterator[Record]:
    """The records of this seed."""
    return drawn(MAKERS, makers, seed)


# ---- What is compared ------------------------------------------------------------------------------------------------


def baselines(record: Record) -> dict[str, tuple[float, float]]:
    """Errors of plain least squares, % of peak-to-peak: a line, a polynomial of degree 5, ten plays and offset."""
    x, z = record.volts, record.displacement
    train = round(SHARE * x.size)
    low, span = x[:train].min(), np.ptp(x[:train])
    one = np.ones((x.size, 1))
    s = ((x - low) / span)[:, None]
    columns = {
        "line": np.hstack([one, s]),
        "polynomial": s ** np.arange(6),
        "plays": np.hstack([one, play_history(x, tuple(i / 10 * 0.5 * span for i in range(10)))]),
    }
    start = train // 20  # the plays' states are not known at first
    errors = {
        name: C[train:] @ np.linalg.lstsq(C[start:train], z[start:train], rcond=None)[0] - z[train:]
        for name, C in columns.items()
    }
    return {name: percent(error, z) for name, error in errors.items()}


def percent(error: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """rmse and largest error, % of the peak-to-peak displacement."""
    return 100 * float(np.sqrt(np.mean(error**2)) / np.ptp(z)), 100 * float(np.abs(error).max() / np.ptp(z))


def main() -> None:
    print("| record | line | polynomial | ten plays | `identify` |")
    print("|---|---|---|---|---|")
    for record in records():
        rows = baselines(record)
        h = identify(record).held_out
        rows["identified"] = h.rmse_percent, h.maximum_percent
        print(f"| {record.source} |", " | ".join(f"{a:.2f} / {b:.1f}" for a, b in rows.values()), "|", flush=True)


if __name__ == "__main__":
    main()
