"""What a motion needs of voltage and slew, before anything moves; whether stroke and limits allow it.

The numbers are those of the controller's prior: z = gain * x on a long way, and the
slope after a reversal, which is the first weight, where the voltage has to be fastest.
Where the first resonance is known, the voltage also moves the inertia of the stage:
z + 2 zeta / w zdot + zddot / w^2 in place of z.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from truestroke.base.checks import SettingError
from truestroke.base.display import at_least, figures
from truestroke.base.errors import shown_as_public
from truestroke.base.flags import Flags
from truestroke.base.typing import FloatArray
from truestroke.control.settings import ControllerSettings, default_slew_limit
from truestroke.model import prior
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.signals.trajectories import Trajectory

LOOP = 2.0  # times the hysteresis of the prior: as much as some stages have
SPARE = 1.1  # a motion may be longer than the stroke by so much
DOUBT = 2.0  # an actuator may move so many times further a volt than in the prior: a motion beyond even that is refused
SLEW_SPARE = 2.0  # times what a motion needs: the default slew limit, where it is raised
HELD = 0.1  # s: for so long the default limit has held a motion that nobody knew, when it is reported
DAMPING = 0.02  # of a resonance whose damping nobody states
SHARP = 0.003  # of the peak-to-peak: ringing of a stage that follows corners, from which on they are reported
HALVES = 12  # of the step in which a motion is moved up, until it is away from a limit
LONGEST = 1 << 17  # ticks at the end of a motion, of which its ringing is computed
USUAL = 95.0  # percent of the ticks: a slew that is exceeded in more of them is not one of short moves
NAMES: Mapping[str, str] = {
    "motion": "trajectory",
    "stroke": "stroke",
    "voltage_limits": "voltage_limits",
    "slew": "slew_limit",
}
"""The words of Python for what can be changed; other callers give their own."""
LOWER = "; set {} to keep it lower"  # behind a limit that was raised


@shown_as_public
class LimitWarning(UserWarning):
    """A limit of the controller will probably hold the motion back; `truestroke.run` gives it before it begins.

    In a loop of one's own nobody knows the motion: there `AdaptiveController.command` gives it, once, when the default
    slew limit has held the voltage back.
    """


class Pursued(Protocol):
    """Bounds of a motion that is given during the run; a `SetPoint` of `truestroke.runtime.realtime` is one."""

    @property
    def reach(self) -> tuple[float, float]:
        """Lowest and highest target, um."""

    @property
    def speed(self) -> float:
        """Highest velocity, um/s."""

    @property
    def ramp(self) -> float:
        """From rest to full speed, s."""


@dataclass(frozen=True, kw_only=True)
class Demands:
    """What a motion needs.

    Attributes
    ----------
    reach : tuple[float, float]
        Lowest and highest position, um.
    speed, usual_speed : float
        Largest absolute velocity, and that which 95 % of the ticks keep to, um/s.
    acceleration : float
        Largest absolute acceleration, um/s^2.
    volts : tuple[float, float]
        Lowest and highest voltage, V, according to the prior of the settings.
    slew, usual_slew : float
        Fastest change of the voltage, and that which 95 % of the ticks keep to, V/s.
    resonance : float
        First resonance of the stage, Hz; 0 where it is not known.
    ringing : float
        What corners of the motion, where its velocity jumps, leave of a stage that is otherwise followed, um rms.
    back : float
        Voltage at its lowest position behind its highest one, V: with twice the loop of the prior, or that of a model.
    down : tuple[float, float]
        That highest and that lowest position, um.
    later : tuple[float, float]
        Lowest and highest position in its second half, behind its start from 0 um, um; 0 where it is not known.
    """

    reach: tuple[float, float]
    speed: float
    usual_speed: float
    acceleration: float
    volts: tuple[float, float]
    slew: float
    usual_slew: float
    resonance: float = 0.0
    ringing: float = 0.0
    back: float = 0.0
    down: tuple[float, float] = (0.0, 0.0)
    later: tuple[float, float] = (0.0, 0.0)


def gains(settings: ControllerSettings) -> tuple[float, float]:
    """The prior of the actuator, um/V: the gain on a long way, and the slope after a reversal.

    Those of the first weights; "rls" starts with a number of the paper, and is counted with the prior if that is more.

    Examples
    --------
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> [round(gain, 2) for gain in gains(s)]
    [11.79, 8.21]
    """
    plays = np.asarray(settings.initial_weights)[settings.a] * sum(settings.dead_zone_weights)
    long_way, first = float(plays.sum()), float(plays[0])
    if settings.law == "rls":
        first = max(first, prior.FIRST_SLOPE * settings.q)
        long_way = max(long_way, first + prior.HYSTERESIS * settings.q)
    return long_way, first


def _way_back(settings: ControllerSettings, top: float, bottom: float) -> float:
    """Voltage where an actuator comes back from one position to a lower one, um.

    Of a loop each half has the form of the first rise, twice as large (Madelung). One that is not identified has `LOOP`
    times the loop expected.
    """
    weights = np.array(settings.initial_weights)
    slopes = np.cumsum(weights[settings.a] * sum(settings.dead_zone_weights))
    weights[settings.columns["lag"]] = 0.0
    loop = 1.0 if weights[settings.columns["creep"].start :].any() else LOOP
    volts = np.append(settings.thresholds, 1e3 * (settings.voltage_limits[1] - settings.voltage_limits[0]))
    z = np.append(0.0, np.cumsum(slopes * np.diff(volts)))
    rise, back = np.interp([max(bottom, 0.0), (top - bottom) / 2], z, volts)
    return float(rise - loop * (rise + 2 * back - np.interp(top, z, volts)))


def _way_up(settings: ControllerSettings, down: tuple[float, float], low: float) -> float:
    """By how much higher, um, an actuator has to move for its way back to need no less than `low`, V."""
    top, bottom = down
    too_little, enough = 0.0, settings.stroke / 1024
    while _way_back(settings, top + enough, bottom + enough) < low and enough < settings.stroke:
        too_little, enough = enough, 2 * enough
    for _ in range(HALVES):
        middle = (too_little + enough) / 2
        if _way_back(settings, top + middle, bottom + middle) < low:
            too_little = middle
        else:
            enough = middle
    return enough


def reach(trajectory: Trajectory | Pursued) -> tuple[float, float]:
    """Lowest and highest position of a motion, um; its start from 0 um counts."""
    if isinstance(trajectory, Trajectory):
        return min(0.0, float(trajectory.position.min())), max(0.0, float(trajectory.position.max()))
    return trajectory.reach


def first_mode(controller: Any) -> Mode | None:
    """First mode of the stage of a controller: of its `dynamics`, or of the setting `resonance`; None if not known."""
    settings = getattr(controller, "settings", controller)
    dynamics = getattr(settings, "dynamics", None)
    if isinstance(dynamics, Dynamics):
        return dynamics.modes[0]
    known = getattr(settings, "resonance", 0.0)
    return Mode(frequency=known, damping=DAMPING) if known else None


def demands(trajectory: Trajectory | Pursued, settings: ControllerSettings, mode: Mode | None = None) -> Demands:
    """What a trajectory needs of an actuator according to the prior of the settings; 0 um is at 0 V.

    Parameters
    ----------
    trajectory : Trajectory or SetPoint
        Desired motion.
    settings : ControllerSettings
        Of the controller that is to follow it.
    mode : Mode, optional
        First mode of the stage; by default that of the setting `resonance`, if it is set.

    Returns
    -------
    Demands

    Examples
    --------
    A sine of 100 Hz is faster than the default slew limit:

    >>> from truestroke.signals import trajectories
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> needs = demands(trajectories.sine(frequency=100.0, peak_to_peak=20.0, duration=1.0), s)
    >>> print(f"{needs.slew:.0f} V/s, the limit is {s.slew_limit:.0f} V/s")
    765 V/s, the limit is 504 V/s
    """
    if isinstance(trajectory, Trajectory):
        speeds = np.abs(trajectory.velocity)
        speed, usual_speed = float(speeds.max()), float(np.percentile(speeds, USUAL))
        corners = np.abs(np.diff(trajectory.velocity)) * trajectory.sample_rate  # the acceleration does not have them
        acceleration = float(corners.max(initial=trajectory.peak_acceleration))
    else:  # only its bounds are known
        speed = usual_speed = trajectory.speed
        acceleration = 4 * speed / trajectory.ramp
    ends, (long_way, first) = reach(trajectory), gains(settings)
    needs = Demands(
        reach=ends,
        speed=speed,
        usual_speed=usual_speed,
        acceleration=acceleration,
        volts=(ends[0] / long_way, ends[1] / long_way),
        slew=speed / first,
        usual_slew=usual_speed / first,
    )
    mode = first_mode(settings) if mode is None else mode
    if not isinstance(trajectory, Trajectory):
        return needs
    z = trajectory.position
    half = z[z.size // 2 :]
    needs = replace(needs, later=(float(half.min()), float(half.max())))
    top = int(z.argmax())
    if settings.law == "kalman" and z[top] > 0:
        down = float(z[top]), float(z[top:].min())
        needs = replace(needs, back=_way_back(settings, *down), down=down)
    if mode is None:
        return needs
    return _with_inertia(needs, trajectory, settings, mode)


def _with_inertia(needs: Demands, wave: Trajectory, settings: ControllerSettings, mode: Mode) -> Demands:
    """The same for a command that passes the inverse of the first mode."""
    long_way, first = gains(settings)
    w = 2 * math.pi * mode.frequency
    shaped = wave.position + 2 * mode.damping / w * wave.velocity + wave.acceleration / w**2
    rates = np.abs(np.diff(shaped)) * wave.sample_rate
    return replace(
        needs,
        volts=(min(0.0, float(shaped.min())) / long_way, max(0.0, float(shaped.max())) / long_way),
        slew=float(rates.max(initial=0.0)) / first,
        usual_slew=float(np.percentile(rates, USUAL)) / first if rates.size else 0.0,
        resonance=mode.frequency,
        ringing=_ringing(wave, shaped, mode),
    )


def _ringing(wave: Trajectory, shaped: FloatArray, mode: Mode) -> float:
    """Rms of what the mode makes of the shaped command, less the motion, um: only corners are not in the command."""
    if np.abs(np.diff(wave.velocity)).max(initial=0.0) * wave.sample_rate <= 2 * wave.peak_acceleration:
        return 0.0  # no corner
    end = slice(max(0, len(wave) - LONGEST), None)
    window = np.hanning(len(wave.time[end]))
    frequency = np.fft.rfftfreq(window.size, 1 / wave.sample_rate)
    answer, motion = np.fft.rfft(window * shaped[end]), np.fft.rfft(window * wave.position[end])
    error = mode.response(2j * math.pi * frequency) / mode.share * answer - motion
    return float(np.sqrt(2 * np.sum(np.abs(error) ** 2) / (window.size * np.sum(window**2))))


def check(
    needs: Demands,
    settings: ControllerSettings,
    *,
    slew: float | None = None,
    voltage_limits: tuple[float, float] | None = None,
    names: Mapping[str, str] = NAMES,
) -> None:
    """Refuse a motion that the actuator cannot make, even if it moves twice as far a volt as in the prior.

    Parameters
    ----------
    needs : Demands
        Of the motion.
    settings : ControllerSettings
        Stroke and limits.
    slew : float, optional
        Fastest change of the voltage where it is not that of the settings, V/s.
    voltage_limits : tuple[float, float], optional
        Lowest and highest voltage where they are not those of the settings, V.
    names : Mapping[str, str]
        How motion, stroke, voltage_limits and slew are called where the reader can change them.

    Raises
    ------
    SettingError
        The motion is longer than the stroke, needs voltages beyond the limits, or is too fast for the slew limit in
        more than 5 % of the ticks. It names the first of them, and what the motion needs.

    Examples
    --------
    >>> from truestroke.signals import trajectories
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> wave = trajectories.sine(frequency=8.0, peak_to_peak=200.0, duration=1.0)
    >>> check(demands(wave, s), s)
    Traceback (most recent call last):
        ...
    truestroke.SettingError: trajectory = 0 to 199.992 um: must be within the stroke, 30 um (it moves at up to \
5027 um/s and 2.53e+05 um/s^2: about 612 V/s); make it smaller, or change stroke
    """
    limit = settings.slew_limit if slew is None else slew
    low, high = settings.voltage_limits if voltage_limits is None else voltage_limits
    (least, most), motion = needs.reach, names["motion"]
    pace = f"at up to {figures(needs.speed, 4)} um/s and {needs.acceleration:.3g} um/s^2"
    bound = ""
    if most - least > SPARE * settings.stroke:
        bound = f"within the stroke, {settings.stroke:g} um (it moves {pace}: about {figures(needs.slew)} V/s); "
        bound += f"{_remedy(needs, settings.stroke)}, or change {names['stroke']}"
    elif needs.volts[0] / DOUBT < min(low, 0.0) or needs.volts[1] / DOUBT > max(high, 0.0):
        bound = f"within reach: about {figures(needs.volts[0])} to {figures(needs.volts[1])} V are needed at "
        bound += f"{gains(settings)[0]:.3g} um/V, {names['voltage_limits']} are {low:g} to {high:g} V; "
        rings = f", or its resonance of {settings.resonance:g} Hz" if settings.resonance > 0 else ""
        bound += f"{_remedy(needs, gains(settings)[0] * high)}, or correct the limits or the model (um, V){rings}"
    if bound:
        raise SettingError(motion, f"{least:g} to {most:.6g}", bound, "um")
    if needs.usual_slew / DOUBT > limit:
        bound = f"about {figures(needs.slew)} V/s for a motion {pace} (at {gains(settings)[1]:.3g} um/V); "
        raise SettingError(names["slew"], f"{limit:g}", f"{bound}raise it, or make {motion} slower", "V/s")


def _remedy(needs: Demands, highest: float) -> str:
    """For a motion that needs more than what is from 0 to the highest position, um."""
    least, most = needs.later
    if not 0 < most - least <= highest or (least >= 0 and most <= highest):
        return "make it smaller"
    return f"shift it, as by its offset: behind its start it is from {figures(least)} to {figures(most)} um"


def notices(
    needs: Demands,
    settings: ControllerSettings,
    *,
    slew: float | None = None,
    voltage_limits: tuple[float, float] | None = None,
    names: Mapping[str, str] = NAMES,
) -> tuple[str, ...]:
    """Report, before the run, which limit will probably slow the motion, and what it needs; () if none will.

    Parameters as those of `check`.

    Examples
    --------
    >>> from truestroke.signals import trajectories
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> fast = trajectories.sine(frequency=100.0, peak_to_peak=20.0, duration=1.0)
    >>> notices(demands(fast, s), s)
    ('slew_limit = 504 V/s will hold the motion back: it needs about 765 V/s (6283 um/s at 8.21 um/V)',)
    """
    limit = settings.slew_limit if slew is None else slew
    low, high = settings.voltage_limits if voltage_limits is None else voltage_limits
    found = []
    if needs.volts[0] < min(low, 0.0) or needs.volts[1] > max(high, 0.0):
        found.append(
            f"{names['voltage_limits']} = {low:g} to {high:g} V will hold the motion back: it needs about "
            f"{figures(needs.volts[0])} to {figures(needs.volts[1])} V ({needs.reach[0]:.4g} to {needs.reach[1]:.4g} "
            f"um at {gains(settings)[0]:.3g} um/V)"
        )
    elif needs.back < min(low, 0.0):
        found.append(
            f"{names['voltage_limits']} = {low:g} to {high:g} V may hold the motion back where it comes back to its "
            f"lowest position: hysteresis takes up to {needs.back:.2g} V there; move it up by "
            f"{at_least(_way_up(settings, needs.down, min(low, 0.0)))} um"
        )
    if needs.slew > limit:
        found.append(
            f"{names['slew']} = {limit:g} V/s will hold the motion back: it needs about {figures(needs.slew)} V/s "
            f"({_pace(needs, settings)})"
        )
    span = needs.reach[1] - needs.reach[0]
    if needs.ringing > SHARP * span:
        found.append(
            f"{names['motion']} is too sharp for the stage: its corners ({needs.acceleration:.3g} um/s^2) leave it "
            f"ringing at {needs.resonance:.4g} Hz by {needs.ringing:.2g} um rms ({100 * needs.ringing / span:.2g} % of "
            "its peak-to-peak); the turns of a raster that knows the dynamics do not"
        )
    return tuple(found)


def _pace(needs: Demands, settings: ControllerSettings) -> str:
    inertia = f", with the inertia of a stage of {needs.resonance:.4g} Hz" if needs.resonance else ""
    return f"{figures(needs.speed, 4)} um/s at {gains(settings)[1]:.3g} um/V{inertia}"


def needed_slew(
    trajectory: Trajectory, settings: ControllerSettings, mode: Mode | None = None, most: float = math.inf
) -> float | None:
    """The slew limit for a motion that is known and faster than the default one; None where the limit may stay.

    A limit that is not the default was chosen by somebody, and stays. The default one is raised to twice what the
    motion needs, for an actuator may be half as sensitive as in the prior.

    Parameters
    ----------
    trajectory : Trajectory
        Desired motion.
    settings : ControllerSettings
        Of the controller that is to follow it.
    mode : Mode, optional
        First mode of the stage, as in `demands`.
    most : float
        Limit of something else that stays, such as that of an axis, V/s.

    Returns
    -------
    float or None
        V/s.

    Examples
    --------
    >>> from truestroke.signals import trajectories
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> slow, fast = (trajectories.sine(frequency=f, peak_to_peak=20.0, duration=1.0) for f in (10.0, 100.0))
    >>> needed_slew(slow, s), round(needed_slew(fast, s))
    (None, 1530)
    """
    default = default_slew_limit(settings)
    if settings.slew_limit != default or default >= most:
        return None
    needs = demands(trajectory, settings, mode)
    raised = SLEW_SPARE * needs.slew
    return min(raised, most) if raised > default else None


class UnknownMotion:
    """Whether the default slew limit holds back a motion that nobody knows ahead, as in a loop of one's own.

    Parameters
    ----------
    settings : ControllerSettings
        Of the controller that follows it.

    Attributes
    ----------
    unhindered : float
        The velocity up to which the limit holds nothing back, um/s; infinite where a limit was chosen.

    Examples
    --------
    >>> s = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> round(UnknownMotion(s).unhindered), UnknownMotion(replace(s, slew_limit=100.0)).unhindered
    (4140, inf)
    """

    def __init__(self, settings: ControllerSettings) -> None:
        chosen = settings.slew_limit != default_slew_limit(settings)
        self.unhindered = math.inf if chosen else settings.slew_limit * gains(settings)[1]
        self._settings = settings
        self._last = math.nan, math.nan
        self._ticks = 0

    def held(self, z_d: float, zdot_d: float, flags: Flags) -> str | None:
        """One tick of a faster motion, um and um/s, and the flags of its command; once, what to say of the limit.

        It counts where the motion is smooth, for `HELD` in all: a jump, noise or a short move needs no other limit.
        """
        s, (z, v), z_d, zdot_d = self._settings, self._last, float(z_d), float(zdot_d)
        smooth = abs(zdot_d - v) < abs(zdot_d) / 2 and abs(s.sample_rate * (z_d - z) - zdot_d) < abs(zdot_d) / 2
        self._last = z_d, zdot_d
        if not smooth:
            self._ticks = max(self._ticks - 1, 0)
        elif flags.slewed and not flags.saturated:
            self._ticks += 1
        if self._ticks < HELD * s.sample_rate:
            return None
        self.unhindered, speed, gain = math.inf, abs(zdot_d), gains(s)[1]
        return (
            f"slew_limit = {figures(s.slew_limit, 4)} V/s, the default, holds the motion back: {figures(speed, 4)} "
            f"um/s need about {figures(speed / gain)} V/s; give resonance=, f0 of the data sheet in Hz, or "
            f"slew_limit=, twice the highest velocity over {gain:.3g} um/V"
        )


def raise_slew(
    trajectory: Trajectory | Pursued, controller: Any, most: float = math.inf, named: str = NAMES["slew"]
) -> tuple[str, ...]:
    """Raise the default slew limit of a controller as `needed_slew` states, and report it; () where it stays.

    `named` is what keeps it lower.
    """
    settings = getattr(controller, "settings", None)
    if not isinstance(settings, ControllerSettings) or not isinstance(trajectory, Trajectory):
        return ()
    mode = first_mode(controller)
    slew = needed_slew(trajectory, settings, mode, most)
    if slew is None or not hasattr(controller, "change"):
        return ()
    controller.change(slew_limit=slew)
    needs = demands(trajectory, settings, mode)
    return (
        f"{NAMES['slew']} is {figures(slew, 4)} V/s in place of its default, {settings.slew_limit:g} V/s: the motion "
        f"needs about {figures(needs.slew)} V/s ({_pace(needs, settings)}){LOWER.format(named)}",
    )


def remedied(trajectory: Trajectory, controller: object) -> tuple[str, ...]:
    """The notices for this controller, each with the remedy; () of one that has no `ControllerSettings`."""
    settings = getattr(controller, "settings", None)
    if not isinstance(settings, ControllerSettings) or not trajectory.position.size:
        return ()
    found = notices(demands(trajectory, settings, first_mode(controller)), settings)
    return tuple(f"{notice}; change it, or make {NAMES['motion']} slower or smaller" for notice in found)
