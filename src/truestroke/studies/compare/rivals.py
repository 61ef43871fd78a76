"""The controllers of the comparison, each identified and tuned on the same actuator, as a user would do it.

What an owner may use: the actuator for a few seconds before the comparison, and waves of the same kind as those of the
comparison, but not the waves themselves.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LMS, Law
from truestroke.control.baselines import ConstantGain, Pid, ProjectedGradient, tune_pid
from truestroke.control.controller import AdaptiveController, Controller
from truestroke.control.reference.published import PublishedController
from truestroke.control.settings import ControllerSettings
from truestroke.identification import FittedWeights, fit
from truestroke.runtime.loop import Actuator, run
from truestroke.signals.recording import Recording
from truestroke.signals.trajectories import Trajectory, random_wave, sine, smoothstep

PLAYS = 16
REACH = 0.75  # largest threshold over the highest voltage; the half of Sec. 2.1 leaves four times the residual here
RATE_SCALE = 0.007  # c_b, s/um
FORGETTING = (0.5, 0.8, 0.9, 0.97)
STEP_SIZES = (0.1, 0.3, 1.0)


@dataclass(frozen=True)
class Rival:
    """One controller of the comparison.

    Attributes
    ----------
    name : str
        As the table says it.
    source : str
        Where it is from.
    tuning : str
        How it was identified and tuned, with the resulting settings.
    make : callable
        Gives a fresh controller.
    """

    name: str
    source: str
    tuning: str
    make: Callable[[], Controller] = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class Workbench:
    """What the owners have: an actuator, what is known of it, and a training wave.

    Attributes
    ----------
    actuator : Actuator
        At rest whenever it is opened; one tick a block, no latency.
    settings : ControllerSettings
        Sample rate, stroke and voltage limits.
    seed : int
        Of the training wave and of the noise that measures the frequency response.
    """

    actuator: Actuator
    settings: ControllerSettings
    seed: int

    def wave(self, duration: float, number: int = 0) -> Trajectory:
        """A random wave over the whole stroke, with a seed of its own."""
        rate, stroke = self.settings.sample_rate, self.settings.stroke
        return random_wave(peak_to_peak=stroke, low=0.0, duration=duration, sample_rate=rate, seed=self.seed + number)

    def play(self, wave: Trajectory, controller: Controller) -> Recording:
        """Run the actuator."""
        return run(wave, controller, self.actuator)

    def best(self, controllers: dict[float, Callable[[], Controller]]) -> float:
        """Which of the named controllers has the smallest measured error on the second half of a training wave."""
        wave = self.wave(2.0, number=1)
        errors = {}
        for name, make in controllers.items():
            recording = self.play(wave, make())
            error = (recording["measured"] - recording["desired"])[len(wave) // 2 :]
            errors[name] = float(np.sqrt(np.nanmean(error**2)))
        return min(errors, key=lambda name: errors[name])


def prepare(bench: Workbench) -> Iterator[Rival]:
    """All controllers, in the order of the table, identified and tuned one after the other."""
    line = _straight_line(bench)
    yield Rival(
        "no compensation",
        "a straight line",
        f"fitted to a random wave of 4 s: {line.sensitivity:.2f} um/V, {line.offset:.2f} um at 0 V",
        lambda: line,
    )
    yield _pid(bench, line)
    record = bench.play(bench.wave(10.0), line)
    first = _fitted(bench, record, rate=False)
    record = bench.play(bench.wave(10.0), _held(_started(bench, first, rate_scale=0.0)))  # now over the whole stroke
    still, moving = _fitted(bench, record, rate=False), _fitted(bench, record, rate=True)
    fixed, rate_dependent = _started(bench, still, rate_scale=0.0), _started(bench, moving, rate_scale=RATE_SCALE)
    yield Rival(
        "fixed inverse",
        "Kuhnen 2003",
        f"{PLAYS} plays and 3 dead zones fitted to 10 s, residual {still.rmse:.2g} um",
        lambda: _held(fixed),
    )
    yield Rival(
        "rate-dependent fixed inverse",
        "Ang, Riviere, Khosla 2007",
        f"the same and a slope with velocity for each play, residual {moving.rmse:.2g} um",
        lambda: _held(rate_dependent),
    )
    gradient = partial(ProjectedGradient, fixed.initial_weights, slope_min=fixed.slope_limits[0])
    make, best = _tuned(bench, fixed, FORGETTING, lambda value: gradient(forgetting=value))
    tuning = f"from the fixed inverse, projected gradient, forgetting factor {best:g}"
    yield Rival("adaptive rate-independent inverse", "Kuhnen and Janocha 1999", tuning, make)
    lms = partial(LMS, rate_dependent.initial_weights)
    make, best = _tuned(bench, rate_dependent, STEP_SIZES, lambda value: lms(step_size=value))
    tuning = f"from the rate-dependent fixed inverse, step size {best:g}"
    yield Rival("LMS", "Widrow and Hoff 1960, normalised", tuning, make)
    yield _paper(bench)
    yield Rival(
        "truestroke",
        "this package",
        "default settings, nothing identified",
        lambda: AdaptiveController.from_settings(bench.settings),
    )


def _straight_line(bench: Workbench) -> ConstantGain:
    """Through a random wave; a slow sine of half the stroke, with a guessed gain, gives its voltage."""
    s = bench.settings
    slow = sine(frequency=2.0, peak_to_peak=s.stroke / 2, duration=2.0, sample_rate=s.sample_rate)
    line = ConstantGain(s.stroke / s.voltage_limits[1], s.voltage_limits)
    for wave in (slow, bench.wave(4.0)):
        recording = bench.play(wave, line)
        slope, offset = np.polyfit(recording["volts"], recording["measured"], 1)
        line = ConstantGain(slope, s.voltage_limits, offset)
    return line


def _fitted(bench: Workbench, record: Recording, *, rate: bool) -> FittedWeights:
    from scipy.signal import savgol_filter

    settings, volts, z = bench.settings, record["volts"], record["measured"]
    window = 2 * round(0.005 * settings.sample_rate) + 1  # 10 ms
    velocity = savgol_filter(z, window, 3, deriv=1, delta=1 / settings.sample_rate)
    return fit(
        volts,
        z,
        thresholds=[i / PLAYS * REACH * float(volts.max()) for i in range(PLAYS)],
        dead_zone_thresholds=(0.0, settings.stroke / 3, settings.stroke * 2 / 3),
        velocity=velocity if rate else None,
        slope_min=0.05 * settings.q,
    )


def _started(bench: Workbench, weights: FittedWeights, rate_scale: float) -> ControllerSettings:
    """The law of the paper, which stays as it is, from identified weights."""
    s = bench.settings
    return ControllerSettings.paper(
        sample_rate=s.sample_rate, stroke=s.stroke, voltage_limits=s.voltage_limits, **weights.settings(rate_scale)
    )


def _held(settings: ControllerSettings) -> AdaptiveController:
    controller = AdaptiveController.from_settings(settings)
    controller.hold()
    return controller


def _tuned(
    bench: Workbench, settings: ControllerSettings, values: tuple[float, ...], law: Callable[[float], Law]
) -> tuple[Callable[[], Controller], float]:
    """What makes the controller with the best of the values in its law, and that value."""

    def make(value: float) -> Controller:
        return PublishedController(settings, law(value))

    best = bench.best({value: partial(make, value) for value in values})
    return partial(make, best), best


def _pid(bench: Workbench, line: ConstantGain) -> Rival:
    frequency, response, spectrum = _frequency_response(bench, line)
    rate, limits = bench.settings.sample_rate, bench.settings.voltage_limits
    g = tune_pid(frequency, response, sample_rate=rate, spectrum=spectrum)
    return Rival(
        "tuned PID",
        "Astrom and Hagglund 2006",
        "least predicted error with M_s <= 2 up to 1.5 times the measured gain: "
        f"k_p {g.k_p:.3g} V/um, k_i {g.k_i:.3g} V/(um s), k_d {g.k_d:.2g} V s/um, T_f {1e3 * g.T_f:g} ms",
        lambda: Pid(g, sample_rate=rate, voltage_limits=limits),
    )


def _paper(bench: Workbench) -> Rival:
    known = {name: getattr(bench.settings, name) for name in ("sample_rate", "stroke", "voltage_limits")}
    return Rival(
        "the paper",
        "Tan et al. 2009",
        "as published: 8 plays, w(0) = [5, 0, ...], forgetting factor 0.9999; nothing identified",
        lambda: AdaptiveController.paper(**known),
    )


def _frequency_response(bench: Workbench, line: ConstantGain) -> tuple[FloatArray, NDArray[np.complex128], FloatArray]:
    """Frequencies, Hz; response to noise around the middle of the stroke, um/V; spectrum of a training wave."""
    from scipy.signal import csd, welch

    rate, stroke = bench.settings.sample_rate, bench.settings.stroke
    segment = 2 * round(0.25 * rate)  # of 0.5 s
    noise = np.random.Generator(np.random.PCG64(bench.seed)).standard_normal(10 * segment)
    rise, _ = smoothstep(np.arange(noise.size) / segment)
    position = stroke * rise * (0.5 + 0.02 * noise)
    recording = bench.play(Trajectory("noise", rate, position, np.zeros_like(position)), line)
    x, z = recording["volts"][2 * segment :], recording["measured"][2 * segment :]
    frequency, cross = csd(x, z, fs=rate, nperseg=segment)
    _, power = welch(x, fs=rate, nperseg=segment)
    _, spectrum = welch(bench.wave(4.0).position, fs=rate, nperseg=segment)
    return frequency[1:], (cross / power)[1:], spectrum[1:]
