"""Play, measure, learn, and again: the voltage of a motion that repeats, learned on hardware."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable
from typing import Any, Literal, TypeGuard, cast

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, display, system
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.control.actuator import ActuatorModel
from truestroke.control.model_file import taken
from truestroke.control.repeating.iterative import (
    SIZE,
    IterativeLearning,
    Learned,
    Pass,
    at_the_noise,
    check_motion,
    least_slew,
    one_period,
)
from truestroke.identification.dynamics import DynamicsError, NoResonanceError, measure_bode, spring_to
from truestroke.identification.identified import identify
from truestroke.identification.records.record import Record
from truestroke.identification.refine import refine
from truestroke.model.dynamics import Dynamics
from truestroke.runtime.drivers.guard import Limits
from truestroke.runtime.drivers.one_axis import OneAxis
from truestroke.runtime.drivers.playback import RAMP, playback, ramp
from truestroke.runtime.drivers.protocol import Driver, DriverError
from truestroke.runtime.loop import Actuator
from truestroke.runtime.realtime.axis_check import zero_of
from truestroke.runtime.realtime.settings import checked_zero
from truestroke.signals.tables import RecordError
from truestroke.signals.trajectories import Trajectory

PASSES = 8
SETTLE = 0.3, 5.0  # s of each pass before the periods that count, at least and at most: the start decays
RUNG = 7.0  # time constants of a mode: its ringing is a thousandth after them
AVERAGED = 0.5  # s of periods that count, at least
PERIODS = 2, 3  # of the motion, at least: before those that count, and those
ROUNDED = 1e-6  # of the stroke: a motion of its whole length may be so much longer
BEYOND = 1.0  # of the stroke: so far out of reach a motion may seem, where the stroke is twice what is stated
LOOKS = 16, 0.05  # samples, s: so long at least the sensor is read at rest
PATIENCE = 2, 4  # passes in a row without an improvement, after which it ends: near the noise, and far from it
CLOSE = 1.5  # times the noise: an error that is near it
EASED = 0.5  # of the slew that a spring needs: with less no stage makes a motion well below its resonance
LONGEST = 86_400.0  # s of all passes: the stage has changed meanwhile
BYTES = 400.0  # of memory that a sample of a pass takes
PART = 2**18  # samples of a simulated pass after which it is shown how far it is
GAP = 0.5  # s between them in the record of the model
BETTER = 0.95  # times the rmse of the best pass before: an improvement


def learn(
    driver: Driver | Actuator,
    motion: Trajectory | npt.ArrayLike,
    *,
    voltage_limits: tuple[float, float],
    slew: float,
    safe_voltage: float = 0.0,
    stroke: float | None = None,
    zero: float | Literal["measured"] | None = None,
    sample_rate: float | None = None,
    dynamics: Dynamics | None = None,
    resonance: float = 0.0,
    bandwidth: float | None = None,
    model: ActuatorModel | str | os.PathLike[str] | None = None,
    passes: int = PASSES,
    settle: float | None = None,
    averaged: float = AVERAGED,
    report: Callable[[Learned], None] = lambda _: None,
    doing: Callable[[str], None] = lambda _: None,
    begins: Callable[[], None] = lambda: None,
) -> Learned:
    """Learn the voltage of a motion that repeats, pass by pass, until the error is that of the noise.

    Each pass is a `playback`: from the safe voltage to the first voltage, periods until the start has decayed, periods
    that count, and back. `IterativeLearning` corrects the voltage between two passes.

    Parameters
    ----------
    driver : Driver or Actuator
        Closed, of one channel; its output is at the safe voltage after each pass. Or a simulated actuator such as
        `StagePlant`, whose passes take no time.
    motion : Trajectory or array_like, shape (samples,)
        What repeats, as of `IterativeLearning`.
    voltage_limits : tuple[float, float]
        Lowest and highest voltage, V.
    slew : float
        Fastest change of the voltage, V/s.
    safe_voltage : float
        Where each pass starts and ends, V.
    stroke : float, optional
        Displacement over the whole of `voltage_limits`, um; within ten times, the first pass corrects it. By default
        that of the model.
    zero : float, "measured" or None
        What is subtracted from all measurements, um; "measured": so much that 0 um is at 0 V, by the sensor at rest at
        the safe voltage; None: the same where it shows a tenth of the stroke or more beside what that voltage explains.
    sample_rate : float, optional
        Of an array, Hz.
    dynamics : Dynamics, optional
        Of the stage; by default they are measured first, unless `bandwidth` is given.
    resonance : float
        First resonance, Hz, where it is known and the dynamics are not: a motion too fast for it is refused
        before the dynamics are measured.
    bandwidth : float, optional
        Highest harmonic that is learned, Hz. Without dynamics the stage is taken for a spring up to there; where the
        measurement shows no resonance, or dynamics that are bad, up to the frequency to which it answers as a spring.
    model : ActuatorModel, str or PathLike, optional
        Of `identify`, or its file: the first pass is made with it. One that is not good is refused, or warned of, as by
        `AdaptiveController.from_model`.
    passes : int
        At most, from 1 to 1000; the first one has learned nothing.
    settle : float, optional
        Duration of the periods that do not count, at least, s; by default until the ringing of the start is a
        thousandth, as the dynamics say, 0.3 to 5 s.
    averaged : float
        Duration of those that count, at least, s.
    report : callable, optional
        Called after each pass with what was learned so far, from the first one that was measured.
    doing : callable, optional
        Called with what begins: a part of the measurement of the dynamics, as of `measure_bode`, or a pass.
    begins : callable, optional
        Called once, before the first pass: the driver is open, and the motion begins.

    Returns
    -------
    Learned

    Raises
    ------
    SettingError
        An argument is out of bounds, or the motion does not repeat.
    DriverError
        The hardware failed, or no pass was measured; what was reported before remains valid.
    BadModelError, ModelFileError
        The verdict of the model in the file is bad, or it is no model.
    DynamicsError
        The dynamics could not be measured, or the stage shows none and the motion is too fast for a spring.

    Examples
    --------
    >>> from truestroke import trajectories
    >>> from truestroke.plant import StagePlant, StageSettings
    >>> stage = StagePlant(StageSettings(hysteresis_kind="preisach"))
    >>> wave = trajectories.raster(frequency=50.0, peak_to_peak=20.0, duration=1.0, sample_rate=10_000.0)
    >>> limits = {"voltage_limits": (-0.6, 3.6), "slew": 20_000.0}
    >>> found = learn(stage, wave, stroke=35.0, **limits, passes=5, averaged=0.2)
    >>> print(found.verdict.level, found.passes[0].rmse > 0.5, found.best.rmse < 0.02)
    good True True
    """
    limits = Limits(voltage_limits=voltage_limits, slew=slew, safe_voltage=safe_voltage)
    most, zero = checks.count("passes", passes, 1, 1000), checked_zero(zero)
    checks.able("driver", driver, ("open", "exchange"), "a driver or a simulated actuator; the order is driver, motion")
    known = None if model is None else taken(model)
    stroke = _stroke(stroke, known, limits)
    gain = stroke / (limits.voltage_limits[1] - limits.voltage_limits[0])
    _refuse_reach(motion, gain, limits)
    measures = dynamics is None and bandwidth is None
    rate = check_motion(motion, sample_rate, checks.within("resonance", resonance, 0.0, 1e9, "Hz") if measures else 0.0)
    lasting(motion, sample_rate, passes=most, settle=settle, averaged=averaged)
    spring = ""
    if measures:
        _refuse_slew(motion, sample_rate, gain, limits, resonance)
        dynamics, bandwidth, spring = _measured(driver, limits, rate, doing)
    given: dict[str, Any] = {"voltage_limits": limits.voltage_limits, "slew_limit": slew, "model": known}
    try:
        with checks.inside("", {"slew_limit": "slew"}):
            learning = IterativeLearning(
                motion, sample_rate, gain=gain, dynamics=dynamics, bandwidth=bandwidth, **given
            )
    except SettingError as error:
        if spring and error.argument == "bandwidth":
            raise DynamicsError(f"the motion is too fast where {spring}") from error
        raise
    settle = _settles(dynamics) if settle is None else settle
    play = _player(driver, rate, limits, doing)
    begun = Learned(passes=(), learning=learning, spring=spring, zero=_zero(play, limits, rate, stroke, zero))
    periods = _periods(learning, settle, PERIODS[0]), _periods(learning, averaged, PERIODS[1])
    begins()
    return _passes(begun, play, most, periods, report, doing)


def lasting(
    motion: Trajectory | npt.ArrayLike,
    sample_rate: float | None = None,
    *,
    passes: int = PASSES,
    settle: float | None = None,
    averaged: float = AVERAGED,
) -> tuple[float, float]:
    """How long `learn` takes at most, and each of its passes, s: without its ramps and the measurement of the dynamics.

    Parameters
    ----------
    motion, sample_rate, passes, settle, averaged
        As of `learn`.

    Raises
    ------
    SettingError
        The motion does not repeat, all passes take longer than a day, or one does not fit the memory.

    Examples
    --------
    >>> lasting(np.sin(2 * np.pi * np.arange(10_000) / 10_000), 10_000.0, passes=8)
    (64.0, 8.0)
    """
    wave, _, rate, periods = one_period(motion, sample_rate)
    return lasting_of(wave.size, periods, rate, passes=passes, settle=settle, averaged=averaged)


def lasting_of(
    samples: int, periods: int, rate: float, *, passes: int, settle: float | None, averaged: float
) -> tuple[float, float]:
    """`lasting` of a motion that has not been made: its `repetition` at this rate, Hz."""
    for name, value in (("settle", SETTLE[0] if settle is None else settle), ("averaged", averaged)):
        checks.within(name, value, 0.0, 3600.0, "s")
    seconds, frequency = samples / rate, periods * rate / samples
    count = sum(
        _repetitions(samples, periods, rate, *one)
        for one in ((SETTLE[1] if settle is None else settle, PERIODS[0]), (averaged, PERIODS[1]))
    )
    each = count * seconds
    faster = f"repeat it faster than its {frequency:.3g} Hz"
    if passes * each > LONGEST:
        bound = f"at most a day in {passes} passes of {display.duration(each)}: {faster}, or in fewer passes"
        raise SettingError("duration of the motion", display.duration(passes * each), bound)
    if lacking := system.lacking(BYTES * rate * each):
        bound = f"less, as a pass of {rate * each:.3g} samples takes {lacking}: {faster}, or at a lower sample rate"
        raise SettingError("duration of a pass", display.duration(each), bound)
    return passes * each, each


def _stroke(stroke: float | None, known: ActuatorModel | None, limits: Limits) -> float:
    """Of the actuator over the voltage limits, um: the one that is given, else that of its model."""
    low, high = limits.voltage_limits
    if stroke is None and known is not None:
        stroke = known.stroke / (known.voltage_range[1] - known.voltage_range[0]) * (high - low)
    if stroke is None:
        raise SettingError("stroke", None, "the displacement over the whole of voltage_limits, or a model", "um")
    return checks.positive("stroke", stroke, "um")


def _passes(
    found: Learned,
    play: Callable[[FloatArray], FloatArray],
    most: int,
    periods: tuple[int, int],
    report: Callable[[Learned], object],
    doing: Callable[[str], object],
) -> Learned:
    """Passes of periods that do not count and of those that do, until the error is that of the noise, or does not fall.

    Raises
    ------
    DriverError
        None of them was measured.
    """
    learning, first, seen = found.learning, periods[0] * found.learning.samples, False
    for number in range(most):
        doing(f"pass {number}")
        volts = np.tile(learning.volts, sum(periods))
        measured = play(volts)[first:]
        made = learning.learn(measured - found.zero)
        records = found.records
        if not made.missed:
            records = (*records[:1], *records[1:][-1:], (volts[first:], measured))
        found = dataclasses.replace(found, passes=(*found.passes, made), records=records)
        seen = seen or made.measured.size > 0
        if seen:
            report(found)
        if at_the_noise(made) or _idle(found.passes):
            break
    if not seen:
        raise DriverError(
            f"no pass of {most} was measured: samples at the same place of each period were lost, as where a trigger "
            "is late or missing, or a pass is cut short; look at one by `truestroke playback`"
        )
    return found


def model_of(found: Learned, model: ActuatorModel | None = None) -> ActuatorModel:
    """A model of the actuator from the passes: identified, or refined where there was one before.

    Parameters
    ----------
    found : Learned
        Of `learn`.
    model : ActuatorModel, optional
        The one before.

    Raises
    ------
    SettingError, RecordError
        The passes do not suffice: they are too short, or the motion too small.
    """
    rate = found.learning.sample_rate
    time, volts, measured, start = [], [], [], 0.0
    for x, z in found.records if model is None else found.records[-1:]:
        seen = np.isfinite(z)
        time.append(start + np.flatnonzero(seen) / rate)
        volts.append(x[seen])
        measured.append(z[seen])
        start += x.size / rate + GAP
    arrays = np.concatenate(volts), np.concatenate(measured)
    if np.cov(*arrays)[0, 1] <= 0:
        raise RecordError(
            "the passes",
            "the displacement falls where the voltage rises: in so fast a motion the stage answers a quarter of a "
            "period late, or more. The waveform needs no model; for one, learn a motion below the resonance",
        )
    record = Record.from_arrays(*arrays, time=np.concatenate(time), source="passes of truestroke learn")
    return identify(record, branches=False).model if model is None else refine(model, record).model


def _refuse_reach(motion: Trajectory | npt.ArrayLike, gain: float, limits: Limits) -> None:
    """SettingError for a motion that is out of reach, before anything moves."""
    position = np.asarray(motion.position if isinstance(motion, Trajectory) else motion, dtype=np.float64)
    low, high = (gain * volts for volts in limits.voltage_limits)
    repeats = position[position.size // 2 :] if isinstance(motion, Trajectory) else position  # behind the way from 0 um
    if repeats.size and (length := float(np.ptp(repeats))) > (high - low) * (1 + ROUNDED):
        bound = f"at most the stroke, {high - low:.4g} um over voltage_limits: make it smaller, or correct the stroke"
        raise SettingError(SIZE, f"{length:.4g} um from end to end", bound)
    spare = BEYOND * (high - low)
    if position.size and (position.min() < low - spare or position.max() > high + spare):
        bound = (
            f"within {low:.4g} to {high:.4g} um, which voltage_limits of {limits.voltage_limits[0]:g} to "
            f"{limits.voltage_limits[1]:g} V reach at {gain:.3g} um/V: make it smaller, shift it "
            "(`offset`), or correct the stroke"
        )
        ends = [round(float(end), 9) + 0.0 for end in (position.min(), position.max())]
        raise SettingError("place of the motion", f"{ends[0]:.4g} to {ends[1]:.4g}", bound, "um")


def _refuse_slew(
    motion: Trajectory | npt.ArrayLike, rate: float | None, gain: float, limits: Limits, resonance: float
) -> None:
    """SettingError for a slew that is too low by far, before the dynamics are measured.

    How much less than a spring the motion needs near its resonance, Hz, is known then only.
    """
    fastest, frequency = least_slew(motion, rate, gain)
    eased = min(abs(1 - (frequency / resonance) ** 2), 1.0) if resonance else 1.0
    if limits.slew < EASED * eased * fastest:
        bound = f"at least {fastest:.4g} V/s, which the motion needs below the resonance: raise it, move slower or less"
        raise SettingError("slew", limits.slew, f"{bound}; of a motion near it give the `dynamics`", "V/s")


def _measured(
    driver: Driver | Actuator, limits: Limits, rate: float, doing: Callable[[str], None]
) -> tuple[Dynamics | None, float | None, str]:
    """The dynamics; where none can be used, up to which frequency, Hz, the stage is a spring, and why."""
    about: dict[str, Any] = {"voltage_limits": limits.voltage_limits, "safe_voltage": limits.safe_voltage}
    about |= {"slew_limit": limits.slew, "report": lambda what: doing(f"dynamics: {what}")}
    try:
        if _is_driver(driver):
            with OneAxis(driver, **dataclasses.asdict(limits)) as axis:
                _check_rate(axis, rate)
                found = measure_bode(axis, **about)
        else:
            _check_rate(cast(Actuator, driver), rate)
            found = measure_bode(cast(Actuator, driver), **about)
    except NoResonanceError as error:
        end, why = error.spring_to, str(error)
    else:
        if not found.verdict.is_bad:
            return found.dynamics, None, ""
        end, why = spring_to(found.frequency, found.measured), " ".join(found.verdict.reasons)
    return None, end, f"the stage is taken for a spring, up to {end:.4g} Hz: {why}"


def _check_rate(actuator: Actuator, rate: float) -> None:
    """Open it, and refuse a motion of another sample rate, Hz."""
    if (own := actuator.open().sample_rate) != rate:
        raise SettingError("sample_rate", rate, f"that of the actuator, {own:g} Hz", "Hz")


def _is_driver(driver: Driver | Actuator) -> TypeGuard[Driver]:
    return hasattr(driver, "start")


def _player(
    driver: Driver | Actuator, rate: float, limits: Limits, doing: Callable[[str], object]
) -> Callable[[FloatArray], FloatArray]:
    """From a waveform, V, to the displacement, um; the output is at the safe voltage before and after it."""
    if _is_driver(driver):
        return lambda volts: playback(driver, volts, rate, **dataclasses.asdict(limits)).displacement[0]
    actuator = cast(Actuator, driver)
    _check_rate(actuator, rate)
    step = min(limits.slew, float(np.ptp(limits.voltage_limits)) / RAMP) / rate

    def play(volts: FloatArray) -> FloatArray:
        actuator.exchange(ramp(limits.safe_voltage, volts[0], step))
        measured = np.empty(volts.size)
        for start in range(0, volts.size, PART):  # which ticks are exchanged together changes nothing
            if start:
                doing(f"{100 * start // volts.size} % of a pass")
            part = slice(start, start + PART)
            measured[part] = actuator.exchange(volts[part])
        actuator.exchange(ramp(volts[-1], limits.safe_voltage, step))
        return measured

    return play


def _settles(dynamics: Dynamics | None) -> float:
    """Time until the start of a pass has decayed, s."""
    modes = () if dynamics is None else dynamics.modes
    rings = max((1 / (2 * math.pi * mode.frequency * mode.damping) for mode in modes), default=0.0)
    return min(max(SETTLE[0], RUNG * rings), SETTLE[1])


def _periods(learning: IterativeLearning, duration: float, least: int) -> int:
    """Repetitions that take at least this long, s."""
    return _repetitions(learning.samples, learning.periods, learning.sample_rate, duration, least)


def _repetitions(samples: int, periods: int, rate: float, duration: float, least: int) -> int:
    """The same, of a repetition of so many samples and periods at a sample rate, Hz."""
    return max(least if periods < least else 1, math.ceil(duration * rate / samples))


def _zero(
    play: Callable[[FloatArray], FloatArray],
    limits: Limits,
    rate: float,
    stroke: float,
    given: float | Literal["measured"] | None,
) -> float:
    """What is subtracted of the sensor, um, by its reading at rest: as of an axis of `truestroke.run`."""
    if isinstance(given, float):
        return given
    measured = play(np.full(max(LOOKS[0], round(LOOKS[1] * rate)), limits.safe_voltage))
    seen = measured[np.isfinite(measured)]
    if not seen.size:
        return 0.0  # passes that are lost, too, will be reported
    low, high = limits.voltage_limits
    return zero_of(given, float(np.median(seen)), limits.safe_voltage * stroke / (high - low), stroke)


def _idle(passes: tuple[Pass, ...]) -> bool:
    """Whether the last passes were no improvement on those before.

    Far from the noise two may be none, and show what the next one needs.
    """
    seen = [one for one in passes if one.measured.size]
    made = [one.rmse for one in seen]
    close = any(at_the_noise(one, CLOSE) for one in seen)
    last = PATIENCE[0] if close else PATIENCE[1]
    return len(made) > last and min(made[-last:]) > BETTER * min(made[:-last])
