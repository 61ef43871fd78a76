"""The distribution: which plants and motions there are, and how likely each is; docs/robustness.md states it."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.settings import ControllerSettings
from truestroke.plant import Change, PlantSettings, RealisticPlant
from truestroke.signals import trajectories
from truestroke.signals.trajectories import Trajectory, smoothstep, smoothstep_curvature
from truestroke.studies.engine import Run
from truestroke.studies.tracking import STROKE, VOLTAGE_LIMITS

SAMPLE_RATE = 2000.0  # Hz
MARGIN = 0.15  # V that a motion leaves of each voltage limit
LOWEST, HIGHEST = 0.7, 29.3  # um: the paper's 28.6 um peak to peak
DURATION = 10.0  # s of a motion
PRELUDE = 60.0  # s of rest or of one small sine before it
BEFORE = 4.0  # s of another full motion before the prelude, in half of those runs
BLEND = 0.3  # s from one part of a motion to the next
MOTIONS = ("random 10 Hz", "random 20 Hz", "sine 1 Hz", "sine 4 Hz", "sine 8 Hz", "sine 12 Hz", "triangle", "staircase")
BLIND = 0.06  # s after a change in which the sensor does not drop out: nothing can be learned without it


CONTROLLERS: dict[str, Callable[..., ControllerSettings]] = {
    "adaptive": ControllerSettings,
    "paper": ControllerSettings.paper,
}
KNOWN = {"sample_rate": SAMPLE_RATE, "stroke": STROKE, "voltage_limits": VOLTAGE_LIMITS}  # to each controller


def sample(seed: int, number: int, controllers: Iterable[str] = CONTROLLERS, **settings: Any) -> Run:
    """The run of this number: a plant, a motion, and what happens on the way.

    Parameters
    ----------
    seed, number : int
        Of the study, and of the run in it: the same two give the same run, to the bit.
    controllers : iterable of str
        Of `CONTROLLERS`.
    **settings
        Of the adaptive controller, for trying others.

    Returns
    -------
    Run
        Its `sampled` has: what, in a line; motion, one of `MOTIONS`; prelude, "", "rest" or "small sine": what comes
        before the motion; reach, lowest and highest position that is asked for, um; begin, when the motion proper
        begins, s: the first half of what follows is not judged for rmse.

    Examples
    --------
    >>> sample(0, 2).sampled["what"]
    'sine 8 Hz, gain 0.95, hysteresis 0.88 at 7.49 s'
    """
    laws = {}
    for name in controllers:
        if name not in CONTROLLERS:
            raise SettingError("controller", repr(name), f"one of {', '.join(CONTROLLERS)}")
        laws[name] = CONTROLLERS[name](**KNOWN, **settings if name == "adaptive" else {})
    random = np.random.Generator(np.random.PCG64([seed, number]))
    plant = _plant(random)
    motion = MOTIONS[random.integers(len(MOTIONS))]
    prelude = ("rest", "small sine", *[""] * 6)[random.integers(8)]
    changes, drops = random.random() < 0.5, random.random() < 0.2
    if prelude and motion not in ("random 10 Hz", "random 20 Hz", "staircase"):  # a full-stroke wave comes after it
        motion = MOTIONS[random.integers(2)]
    before = BEFORE if prelude and random.random() < 0.5 else 0.0
    begin = before + PRELUDE if prelude else 0.0
    if changes:
        time = begin + random.uniform(1.5, DURATION - 1.5)
        change = Change(time=time, gain=random.uniform(0.8, 1.2), hysteresis=random.uniform(0.6, 1.4))
        plant = dataclasses.replace(plant, change=change)
    reach = _reach(plant, begin + DURATION)
    trajectory = _trajectory(random, motion, prelude, before, reach)
    dropouts = _dropouts(random, len(trajectory), change_tick(plant)) if drops else ()
    return Run(
        number=number,
        seed=number,
        plant=plant,
        trajectory=trajectory,
        controllers=laws,
        sampled={
            "what": _what(motion, prelude, plant.change, len(dropouts)),
            "motion": motion,
            "prelude": prelude,
            "reach": list(reach),
            "begin": begin,
        },
        dropouts=dropouts,
    )


def plant_of(run: Run) -> PlantSettings:
    """Its plant, which `sample` makes a realistic one."""
    return cast(PlantSettings, run.plant)


def change_tick(plant: PlantSettings) -> int | None:
    """First tick of the changed actuator; None if it does not change."""
    return None if plant.change is None else plant.change.tick(SAMPLE_RATE)


def _what(motion: str, prelude: str, change: Change | None, dropouts: int) -> str:
    parts = [motion, f"after {prelude}" if prelude else ""]
    if change:
        parts.append(f"gain {change.gain:.2f}, hysteresis {change.hysteresis:.2f} at {change.time:.2f} s")
    parts.append(f"{dropouts} dropouts" if dropouts else "")
    return ", ".join(filter(None, parts))


# ---- The plant -----------------------------------------------------------------------------------------------------


def _plant(random: np.random.Generator) -> PlantSettings:
    def log_uniform(low: float, high: float) -> float:
        return float(low * (high / low) ** random.random())

    gain = PlantSettings().amplifier_gain
    hysteresis = random.uniform(0.20, 0.45)
    slope = random.uniform(6.0, 11.0) / (1 - hysteresis)  # of the chord: only its linear part moves at first contact
    threshold_max = gain * random.uniform(1.0, 1.8)
    drift_time = log_uniform(10.0, 300.0)
    return PlantSettings(
        sensitivity=slope / gain,
        hysteresis=hysteresis,
        threshold_max=threshold_max,
        threshold_scale=threshold_max * log_uniform(0.2, 5.0),
        threshold_exponent=log_uniform(0.5, 2.0),
        asymmetry=random.uniform(-0.05, 0.05),
        asymmetry_stroke=STROKE,
        creep=random.uniform(0.03, 0.12) / 4,
        creep_span=(1e-2, 1e2),
        amplifier_bandwidth=log_uniform(500.0, 5000.0),
        resonance=log_uniform(400.0, 2000.0),
        damping=log_uniform(0.01, 0.08),
        noise=random.uniform(0.010, 0.060),
        drift=random.uniform(-0.001, 0.001) * STROKE * drift_time,
        drift_time=drift_time,
    )


def _reach(s: PlantSettings, duration: float) -> tuple[float, float]:
    """Lowest and highest position that the plant holds within the voltage limits, before and after its change, um.

    A slow move up and down again without creep and drift; creep and drift are added as what they can be at most.
    """
    still = s.without("lag", "creep", "resonance", "drift", "noise", "da_quantisation", "ad_quantisation", "change")
    drift = -s.drift * math.expm1(-duration / s.drift_time)
    crept = s.creep * 4 * HIGHEST
    low, high = LOWEST, HIGHEST
    changes = [None] if s.change is None else [None, dataclasses.replace(s.change, time=0.0)]
    for change in changes:
        plant = RealisticPlant(dataclasses.replace(still, change=change))
        up = np.linspace(0.0, VOLTAGE_LIMITS[1] - MARGIN, 700)
        plant.exchange(up)
        enough = int(np.searchsorted(plant.truth, HIGHEST - min(drift, 0.0), side="right"))
        high = min(high, float(plant.truth[-1]) + min(drift, 0.0))
        plant.open()
        top = up[min(enough, up.size - 1)]
        plant.exchange(np.append(up[up < top], np.linspace(top, VOLTAGE_LIMITS[0] + MARGIN, 700)))
        low = max(low, float(plant.truth[-1]) + max(drift, 0.0) + 0.5 * crept)
    return low, high


# ---- The motion ----------------------------------------------------------------------------------------------------

Piece = tuple[FloatArray, FloatArray, FloatArray, int]
"""Position (um), velocity (um/s), acceleration (um/s^2), tick at which it begins."""


def _trajectory(
    random: np.random.Generator, motion: str, prelude: str, before: float, reach: tuple[float, float]
) -> Trajectory:
    low, high = reach
    settings: dict[str, object] = {"motion": motion, "prelude": prelude, "reach": reach}
    wave = _motion(random, motion, reach, DURATION)
    if not prelude:
        position, velocity, acceleration = joined([_piece(wave, 0)])
        return Trajectory(f"robustness, {motion}", SAMPLE_RATE, position, velocity, settings, acceleration)
    pieces: list[Piece] = []
    if before:
        first = _motion(random, "random 20 Hz", reach, before + BLEND)
        pieces.append(_piece(first, 0))
    time = np.arange(round((PRELUDE + BLEND) * SAMPLE_RATE)) / SAMPLE_RATE
    size, omega = random.uniform(0.3, 1.5) / 2, 2 * math.pi * random.uniform(1.0, 8.0)
    level = random.uniform(low + size, high - size)
    size = size if prelude == "small sine" else 0.0
    swing = size * np.sin(omega * time)
    small = level + swing, size * omega * np.cos(omega * time), -(omega**2) * swing
    pieces.append((*small, round(before * SAMPLE_RATE)))
    pieces.append(_piece(wave, round((before + PRELUDE) * SAMPLE_RATE)))
    position, velocity, acceleration = joined(pieces)
    name = f"robustness, {prelude}, {motion}"
    return Trajectory(name, SAMPLE_RATE, position, velocity, settings, acceleration)


def _piece(wave: Trajectory, start: int) -> Piece:
    return wave.position, wave.velocity, wave.acceleration, start


def joined(pieces: Sequence[Piece]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration from rest at 0 um through pieces that blend within `BLEND`, by `smoothstep`.

    z = z_1 + s (z_2 - z_1), hence the velocity v_1 + s (v_2 - v_1) + s' (z_2 - z_1), and the acceleration
    a_1 + s (a_2 - a_1) + 2 s' (v_2 - v_1) + s'' (z_2 - z_1).
    """
    ticks = max(start + position.size for position, _, _, start in pieces)
    z, v, a = np.zeros(ticks), np.zeros(ticks), np.zeros(ticks)
    for position, velocity, acceleration, start in pieces:
        part = slice(start, start + position.size)
        u = np.arange(position.size) / (BLEND * SAMPLE_RATE)
        (s, slope), curvature = smoothstep(u), smoothstep_curvature(u)
        away, faster = position - z[part], velocity - v[part]
        a[part] += s * (acceleration - a[part]) + 2 * slope / BLEND * faster + curvature / BLEND**2 * away
        v[part] += s * faster + slope / BLEND * away
        z[part] += s * away
    return z, v, a


def _motion(random: np.random.Generator, motion: str, reach: tuple[float, float], duration: float) -> Trajectory:
    low, span = reach[0], reach[1] - reach[0]
    kind, _, rest = motion.partition(" ")
    shared = {"duration": duration, "sample_rate": SAMPLE_RATE}
    if kind == "random":
        cutoff, seed = float(rest.removesuffix(" Hz")), int(random.integers(2**32))
        return trajectories.random_wave(cutoff=cutoff, peak_to_peak=span, low=low, seed=seed, ramp=0.0, **shared)
    if kind == "staircase":
        steps = int(random.integers(2, 11))
        move = {"hold": random.uniform(0.03, 0.3), "velocity_limit": random.uniform(300.0, 1000.0)}
        stairs = trajectories.staircase(steps=steps, peak_to_peak=span, **move, **shared)
        return dataclasses.replace(stairs, position=stairs.position + low)  # `joined` leads there
    size = span * random.uniform(0.4, 1.0)
    place = {"peak_to_peak": size, "offset": random.uniform(low + size / 2, low + span - size / 2), "ramp": 0.0}
    if kind == "triangle":
        return trajectories.triangle(frequency=random.uniform(0.5, 4.0), **place, **shared)
    return trajectories.sine(frequency=float(rest.removesuffix(" Hz")), **place, **shared)


def _dropouts(random: np.random.Generator, ticks: int, change: int | None) -> tuple[tuple[int, int], ...]:
    """About one burst a second, 1 to 200 ticks long, but not just after the change."""
    starts = np.flatnonzero(random.random(ticks) < 1 / SAMPLE_RATE)
    bursts = [(int(start), int(start + 200 ** random.random())) for start in starts]
    if change is None:
        return tuple(bursts)
    last = change + round(BLIND * SAMPLE_RATE)
    return tuple(burst for burst in bursts if burst[1] <= change or burst[0] >= last)
