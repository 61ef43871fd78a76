"""The distribution of fast stages, and of motions relative to the first resonance of each; docs/robustness.md."""

import dataclasses
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.settings import ControllerSettings
from truestroke.model.dynamics import Dynamics
from truestroke.plant import StagePlant, StageSettings
from truestroke.plant.settings import HYSTERESES
from truestroke.runtime.batch import Simulation
from truestroke.signals.trajectories import Trajectory, smoothstep, smoothstep_curvature
from truestroke.studies.engine import Run

RATES = (5_000.0, 10_000.0, 20_000.0)  # Hz
SEEN = 0.12  # of the sample rate: the highest first resonance
HIGHEST_MODE = 0.4  # of the sample rate: a second mode is below
CONTROLLERS = ("measured", "unknown")
REACH = {"measured": 1 / 2, "known": 1 / 2, "unknown": 1 / 3}  # controller -> highest frequency over f0
TRAVEL = 0.25, 0.9  # of the stroke: where motions are
DURATION = 4.0  # s of a motion
RAMP = 0.3  # s of its beginning
JUMP = 0.05  # of the resonances
DRIFT = 0.01  # of the resonances, a minute
MOTIONS = ("sine", "multi-tone", "raster", "sine whose harmonic meets f0")
LEAST_SLOPE = 0.25  # of the loop, over its mean slope: piezo stages are no steeper
SWIFT = 1e4  # voltage ranges a second: no motion of the study needs as many

Motion = tuple[FloatArray, FloatArray, FloatArray]  # um, um/s, um/s^2


@dataclass(frozen=True)
class Tones:
    """A sum of sines about a middle: frequencies, Hz, amplitudes, um, phases, rad."""

    middle: float
    frequency: FloatArray
    amplitude: FloatArray
    phase: FloatArray

    def at(self, time: FloatArray) -> Motion:
        """Position, velocity and acceleration at these times, s."""
        position, velocity, acceleration = (np.zeros_like(time) for _ in range(3))
        for frequency, amplitude, phase in zip(self.frequency, self.amplitude, self.phase, strict=True):
            omega = 2 * math.pi * frequency
            sine, cosine = amplitude * np.sin(omega * time + phase), amplitude * np.cos(omega * time + phase)
            position += sine
            velocity += omega * cosine
            acceleration -= omega**2 * sine
        return self.middle + position, velocity, acceleration


def blended(first: Motion, second: Motion, time: FloatArray) -> Motion:
    """From the first motion to the second within `RAMP` from time 0 on, by s of `smoothstep`.

    z = z_1 + s d with d = z_2 - z_1, hence v = v_1 + s d' + s' d and a = a_1 + s d'' + 2 s' d' + s'' d.
    """
    u = time / RAMP
    s, rate = smoothstep(u)
    rate, change = rate / RAMP, smoothstep_curvature(u) / RAMP**2
    d, v, a = (later - earlier for earlier, later in zip(first, second, strict=True))
    return first[0] + s * d, first[1] + s * v + rate * d, first[2] + s * a + 2 * rate * v + change * d


@dataclass(frozen=True, eq=False, kw_only=True)
class FastRun(Run):
    """A run whose motion is slower for the controllers that know less.

    Attributes
    ----------
    tones : dict of str to Tones
        By controller: the motion after its ramp.
    motions : dict of str to Trajectory
        By controller.
    """

    tones: dict[str, Tones]
    motions: dict[str, Trajectory]

    def simulation(self, controller: str) -> Simulation:
        """With one of its controllers."""
        return dataclasses.replace(super().simulation(controller), trajectory=self.motions[controller])


def stage_of(run: Run) -> StageSettings:
    """Its plant, which `sample` makes a stage."""
    return cast(StageSettings, run.plant)


def measured(stage: StageSettings, seed: int) -> Dynamics:
    """The dynamics as `truestroke.measure_dynamics` finds them on this stage, before anything else."""
    from truestroke.identification.dynamics import measure_dynamics

    still = dataclasses.replace(stage, resonance_change=1.0, resonance_drift=0.0)
    return measure_dynamics(StagePlant(still, seed), voltage_limits=stage.voltage_limits)


DYNAMICS: dict[str, Callable[[StageSettings, int], Dynamics | None]] = {
    "measured": measured,
    "known": lambda stage, _: stage.dynamics(),
    "unknown": lambda _, __: None,
}


def sample(seed: int, number: int, controllers: Iterable[str] = CONTROLLERS, **settings: Any) -> FastRun:
    """The run of this number: a stage, a motion relative to its first resonance f0, and what happens to f0.

    Parameters
    ----------
    seed, number : int
        Of the study, and of the run in it: the same two give the same run, to the bit.
    controllers : iterable of str
        Of `REACH`.
    **settings
        Of all controllers, for trying others.

    Returns
    -------
    FastRun
        Its `sampled` has: what, in a line; motion, one of `MOTIONS`; kind of hysteresis; f0, Hz; jump, s, when f0
        jumps, or None; drift of f0, 1/min; span, um, peak to peak, by controller.

    Examples
    --------
    >>> sample(0, 4, ["unknown"]).sampled["what"]
    'sine, f0 94 Hz, damping 0.007, 2 modes, preisach, 5 kHz, f0 drifts by -1 %/min'
    """
    random = np.random.Generator(np.random.PCG64([seed, number, 1]))
    stage = _stage(random)
    motion = MOTIONS[3] if random.random() < 0.1 else MOTIONS[random.integers(3)]
    event, way, time = random.random(), random.choice((-1.0, 1.0)), random.uniform(1.2, 1.8)
    size, shape, noise = random.uniform(0.6, 1.0), int(random.integers(2**32)), random.uniform(5e-3, 60e-3)
    jump = time if event < 0.25 and stage.hysteresis_kind != "bouc-wen" else None
    drift = way * DRIFT if 0.25 <= event < 0.4 else 0.0
    tones = {name: _tones(shape, motion, stage, _reach(name), size) for name in controllers}
    motions = {name: motion_of(one, stage.sample_rate, motion) for name, one in tones.items()}
    span = {name: float(np.ptp(one.position[one.position.size // 2 :])) for name, one in motions.items()}
    stage = dataclasses.replace(
        stage,
        noise=noise / 20.0 * min(span.values()),
        resonance_change=1.0 if jump is None else 1 + way * JUMP,
        resonance_change_time=jump or 0.0,
        resonance_drift=drift,
    )
    return FastRun(
        number=number,
        seed=number,
        plant=stage,
        trajectory=next(iter(motions.values())),
        controllers={name: _law(stage, DYNAMICS[name](stage, number), settings) for name in tones},
        sampled={
            "what": _what(motion, stage, jump),
            "motion": motion,
            "kind": stage.hysteresis_kind,
            "f0": stage.resonances[0],
            "jump": jump,
            "drift": drift,
            "span": span,
        },
        tones=tones,
        motions=motions,
    )


def _reach(controller: str) -> float:
    if controller not in REACH:
        raise SettingError("controller", repr(controller), f"one of {', '.join(REACH)}")
    return REACH[controller]


def _law(stage: StageSettings, dynamics: Dynamics | None, settings: dict[str, Any]) -> ControllerSettings:
    """What a controller knows of the stage."""
    low, high = stage.voltage_limits
    data = {"sample_rate": stage.sample_rate, "stroke": stage.stroke, "voltage_limits": stage.voltage_limits}
    known = {} if dynamics is None else {"dynamics": dynamics}
    return ControllerSettings(**{**data, "slew_limit": SWIFT * (high - low), **known, **settings})


def _what(motion: str, stage: StageSettings, jump: float | None) -> str:
    f0, modes = stage.resonances[0], len(stage.resonances)
    parts = [motion, f"f0 {f0:.0f} Hz", f"damping {stage.dampings[0]:.3f}", f"{modes} mode{'s' * (modes > 1)}"]
    parts += [stage.hysteresis_kind, f"{stage.sample_rate / 1e3:g} kHz"]
    if jump is not None:
        parts.append(f"f0 times {stage.resonance_change:.2f} at {jump:.2f} s")
    parts.append(f"f0 drifts by {100 * stage.resonance_drift:+.0f} %/min" if stage.resonance_drift else "")
    return ", ".join(filter(None, parts))


# ---- The stage -----------------------------------------------------------------------------------------------------


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.random())


def _stage(random: np.random.Generator) -> StageSettings:
    """A stage whose loop is steep enough, and whose modes have a stable inverse: others are sampled again."""
    while True:
        f0 = _log_uniform(random, 50.0, 2000.0)
        rate = float(random.choice([rate for rate in RATES if f0 <= SEEN * rate]))
        high = _log_uniform(random, 1.0, 150.0)
        kind = HYSTERESES[random.integers(3)]
        resonances, dampings, shares = _modes(random, f0, HIGHEST_MODE * rate)
        stage = StageSettings(
            sample_rate=rate,
            voltage_limits=(-high * random.uniform(0.0, 0.25), high),
            dead_time=random.uniform(0.0, 2.0) / rate,
            amplifier_bandwidth=_log_uniform(random, 500.0, 10_000.0),
            stroke=_log_uniform(random, 5.0, 100.0),
            hysteresis_kind=kind,
            loop_width=random.uniform(0.08, 0.18),
            threshold_max=random.uniform(0.3, 0.6),
            threshold_exponent=_log_uniform(random, 0.5, 2.0),
            envelope=random.uniform(0.02, 0.2),
            preisach_scale=_log_uniform(random, 0.2, 2.0),
            preisach_tilt=random.uniform(-0.6, 0.6),
            preisach_curvature=random.uniform(0.0, 4.0),
            bouc_wen_beta=random.uniform(2.0, 6.0),
            bouc_wen_gamma=random.uniform(-1.0, 2.0),
            bouc_wen_exponent=random.uniform(1.0, 2.0),
            creep=random.uniform(0.03, 0.12) / 4,
            resonances=resonances,
            dampings=dampings,
            shares=shares,
            noise=0.0,
        )
        with suppress(SettingError):  # the dynamics have no stable inverse, or the loop is too steep
            stage.dynamics()
            if StagePlant(stage).least_slope >= LEAST_SLOPE:
                return stage


def _modes(random: np.random.Generator, f0: float, highest: float) -> tuple[tuple[float, ...], ...]:
    """Frequencies, dampings and shares: two modes in seven of ten."""
    second = f0 * _log_uniform(random, 2.2, 5.0)
    damping = _log_uniform(random, 0.003, 0.08), _log_uniform(random, 0.003, 0.08)
    share = random.uniform(-0.15, 0.15)
    if random.random() < 0.3 or second > highest:
        return (f0,), damping[:1], (1.0,)
    return (f0, second), damping, (1 - share, share)


# ---- The motion ----------------------------------------------------------------------------------------------------


def _travel(stage: StageSettings) -> float:
    """Length of where motions are, um."""
    return stage.stroke * (TRAVEL[1] - TRAVEL[0])


def _tones(shape: int, motion: str, stage: StageSettings, reach: float, size: float) -> Tones:
    """A motion with nothing above `reach` times f0; the strain and it have the part `size` of the travel at most."""
    random = np.random.Generator(np.random.PCG64(shape))
    f0 = stage.resonances[0]
    top = reach * f0 * _log_uniform(random, 0.4, 1.0)
    if motion == "multi-tone":
        count = int(random.integers(4, 11))
        frequency = np.append(top * random.uniform(0.1, 1.0, count - 1), top)
        amplitude, phase = random.uniform(0.3, 1.0, count) / np.sqrt(frequency), random.uniform(0, 2 * np.pi, count)
    elif motion == "raster":  # the harmonics of a triangle, with the factors of Lanczos, so that turns do not overshoot
        highest = 2 * int(random.integers(1, 4)) + 1
        harmonic = np.arange(1, highest + 1, 2)
        frequency, amplitude = top / highest * harmonic, np.sinc(harmonic / (highest + 2)) / harmonic**2
        phase = np.full(harmonic.size, np.pi / 2)
    else:
        frequency = np.array([top if motion == "sine" else f0 / (3, 5, 7)[random.integers(3)]])
        amplitude, phase = np.ones(1), np.zeros(1)
    tones = Tones(0.0, frequency, amplitude, phase)
    dynamics = stage.dynamics().continuous(frequency)
    strained = Tones(0.0, frequency, amplitude / np.abs(dynamics), phase - np.angle(dynamics))
    time = np.linspace(0.0, min(40.0 / float(np.min(frequency)), DURATION), 40_000)
    largest = max(float(np.max(np.abs(one.at(time)[0]))) for one in (tones, strained))
    scale = 0.5 * size * _travel(stage) / largest
    return Tones(stage.stroke * (TRAVEL[0] + TRAVEL[1]) / 2, frequency, scale * amplitude, phase)


def motion_of(tones: Tones, sample_rate: float, name: str) -> Trajectory:
    """From rest at 0 um into the tones."""
    time = np.arange(round(DURATION * sample_rate)) / sample_rate
    still = (np.zeros_like(time),) * 3
    z, v, a = blended(still, tones.at(time), time)
    return Trajectory(f"fast robustness, {name}", sample_rate, z, v, {"motion": name}, a)
