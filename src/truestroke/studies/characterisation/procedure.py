"""What the actuator is made to do: triangles at several speeds, one after the other, in one run."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.controller import AdaptiveController
from truestroke.runtime.loop import Actuator, run
from truestroke.signals.recording import Recording
from truestroke.signals.trajectories import Trajectory, triangle
from truestroke.studies.characterisation.lines import MIN_PASSES, Characterisation, fit_lines

SPEEDS = (50.0, 100.0, 150.0, 200.0, 250.0, 300.0)  # um/s: Sec. 4.3 goes to 300
DURATION = 8.0  # s at each speed
RAMP = 1.0  # s in which the first triangle builds up
MIN_CYCLES = MIN_PASSES + 2  # the first is left out, and the second may still be learned in


def sweep(
    *,
    stroke: float,
    speeds: Sequence[float] = SPEEDS,
    duration: float = DURATION,
    sample_rate: float = 2000.0,
    ramp: float = RAMP,
) -> Trajectory:
    """Triangles of one stroke and several speeds, from the slowest to the fastest, each for whole cycles.

    Parameters
    ----------
    stroke : float
        From 0 um to there and back, um.
    speeds : sequence of float
        At least two, um/s, in any order.
    duration : float
        At each speed, s, beside the ramp; five cycles at least.
    sample_rate : float
        Hz.
    ramp : float
        Time in which the first triangle builds up from rest, s.

    Raises
    ------
    SettingError
        Names the argument, its value, the bound and the unit.

    Examples
    --------
    >>> wave = sweep(stroke=30.0, speeds=(100.0, 200.0), duration=4.0)
    >>> wave.duration, wave.peak_to_peak, wave.peak_speed, float(wave.position[0])
    (9.6, 30.0, 200.0, 0.0)
    """
    stroke = checks.positive("stroke", stroke, "um")
    ordered = sorted({checks.positive("speeds", speed, "um/s") for speed in speeds})
    if len(ordered) < 2:
        raise SettingError("speeds", tuple(speeds), "at least two, or there is no line", "um/s")
    duration, ramp = checks.positive("duration", duration, "s"), checks.within("ramp", ramp, 0.0, 3600.0, "s")
    sample_rate = checks.positive("sample_rate", sample_rate, "Hz")
    parts: list[Trajectory] = []
    for speed in ordered:
        period = 2 * stroke / speed
        cycles = max(math.ceil(duration / period - 1e-9), MIN_CYCLES)
        cycles += 0 if parts else math.ceil(ramp / period)  # those that build up do not count
        ticks = math.ceil(cycles * period * sample_rate - 1e-9)  # the next triangle begins at 0 um, where this one ends
        shape: dict[str, Any] = {"speed": speed, "peak_to_peak": stroke, "duration": ticks / sample_rate}
        parts.append(triangle(**shape, sample_rate=sample_rate, ramp=0.0 if parts else ramp))
    names = ("position", "velocity", "acceleration")
    position, velocity, acceleration = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
    settings = {"speeds": ordered, "stroke": stroke, "duration": duration, "ramp": ramp}
    return Trajectory("triangles at several speeds", sample_rate, position, velocity, settings, acceleration)


def characterise(
    actuator: Actuator,
    *,
    stroke: float,
    voltage_limits: tuple[float, float],
    speeds: Sequence[float] = SPEEDS,
    duration: float = DURATION,
    sample_rate: float = 2000.0,
    ramp: float = RAMP,
    slew_limit: float | None = None,
    thresholds: npt.ArrayLike | None = None,
    plays: int = 8,
    offset: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Characterisation:
    """How the weights of an actuator depend on velocity, by the procedure of Sec. 2.4 (Fig. 4).

    The default controller drives the triangles of `sweep`, which it learns to follow; then each pass, the way up or
    down, gives the weights of its velocity by least squares, and `fit_lines` puts a line through them.

    Parameters
    ----------
    actuator : Actuator
        Simulated or real; it is opened once.
    stroke : float
        From 0 um to there, um. The larger, the more plays move.
    voltage_limits : tuple[float, float]
        Lowest and highest output voltage, V at the D/A converter.
    speeds, duration, sample_rate, ramp
        As in `sweep`: um/s, s, Hz, s.
    slew_limit : float, optional
        Fastest change of the voltage, V/s; by default that of `ControllerSettings`.
    thresholds, plays, offset
        As in `fit_lines`.
    progress : callable, optional
        Called as progress(ticks done, all ticks).

    Raises
    ------
    SettingError
        An argument is out of bounds, or a threshold too large for the voltages that the motion took.
    RunInterrupted
        Anything went wrong on the way, or Ctrl-C was pressed. Its `recording` goes into `fit_lines` when two speeds
        are complete.
    NotConverged
        Fewer than two speeds were followed; it has the recording.

    Examples
    --------
    The published weights are found again:

    >>> from truestroke.plant import MatchedPlant, MatchedSettings
    >>> bench = {"stroke": 38.0, "speeds": (100.0, 200.0, 300.0), "duration": 4.0}
    >>> plant = MatchedPlant(sweep(**bench).velocity)
    >>> thresholds = MatchedSettings().thresholds
    >>> found = characterise(plant, voltage_limits=(-0.6, 3.6), thresholds=thresholds, **bench)
    >>> found.a[:3].round(1), found.b[:3].round(1)
    (array([8.4, 1.3, 0.9]), array([-0.9,  1. , -0.2]))

    References
    ----------
    Tan et al. 2009, Sec. 2.4.
    """
    wave = sweep(stroke=stroke, speeds=speeds, duration=duration, sample_rate=sample_rate, ramp=ramp)
    recording = drive(wave, actuator, voltage_limits=voltage_limits, slew_limit=slew_limit, progress=progress)
    return fit_lines(recording, thresholds=thresholds, plays=plays, offset=offset)


def drive(
    wave: Trajectory,
    actuator: Actuator,
    *,
    voltage_limits: tuple[float, float],
    slew_limit: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Follow the triangles of `sweep` with the default controller; arguments and errors as in `characterise`."""
    controller = AdaptiveController(
        sample_rate=wave.sample_rate, stroke=wave.peak_to_peak, voltage_limits=voltage_limits, slew_limit=slew_limit
    )
    return run(wave, controller, actuator, progress)
