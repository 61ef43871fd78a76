"""The whole controller in NumPy: the algorithm of the C kernel, readable beside the paper (Sec. 3, Fig. 5).

The kernel's tests compare with it to the last bit. Use it to try a law or a model first. It is
some hundred times slower: `AdaptiveController` is for the loop.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows
from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import LARGEST, RLS, BoundedKalman, FilteringLaw, KalmanSettings, Law, UpdateRefused
from truestroke.control.controller import Counters, controller_rows
from truestroke.control.guard import FIRST_WAIT, Action, Guard, GuardSettings, Recall
from truestroke.control.oscillation import OscillationDetector, OscillationSettings
from truestroke.control.resonance import SHOWN, ResonanceEstimator, shown
from truestroke.control.sensor import Sensor
from truestroke.control.settings import CHANGEABLE, SETTINGS, ControllerSettings, kernel_settings
from truestroke.control.stage import FOUND_DAMPING, Stage, found, lead_of_dead_time, strain_of
from truestroke.model.models import (
    Motion,
    creep_step,
    known_terms,
    limit_slopes,
    play_inverse,
    play_terms,
    weighted_sum,
)
from truestroke.model.operators import dead_zone, dot, play
from truestroke.signals.timing import LONGEST_AGO

HISTORY = LONGEST_AGO + 1
"""Commands that may wait for their measurement. TS_HISTORY of the kernel."""
BACKLOG = 64
"""Ticks without a measurement, beside those that one takes to come, after which the oldest is passed over."""

LOWER = 0.7  # factor of the filter's corner where it was not low enough
NOT_BELOW = 0.2  # of the known resonance: a slower error is that of the motion
FEEDBACKS = 13  # filters at most: TS_FEEDBACKS of the kernel
ALARMS = 0.1  # s: over which the rate of sudden changes is taken,
PAUSE = 100.0  # 1/s: from which on the feedback pauses,
RESUME = 20.0  # 1/s: and below which it continues;
AT_FIRST = 60.0  # 1/s: that of the start, so that it begins a tenth of a second later
REST_PERIODS = 6  # of the oscillation: longest pause of adaptation,
REST_HALF_WAVES = 7  # and half-waves of the ringing after which it continues
KEEP = 0.03  # s: how often the weights are kept
RINGS = 4  # times the noise's: mean square of the second difference of the error where the stage rings
JUMP = 16  # times the noise's: what one tick may add to it; a jump is no ringing
RINGING_RATE = 50  # 1/s: how fast that mean follows
IN_MOTION = 0.05  # of the smallest slope: that of the inverse, of weights that are held at rest
FOUND = 0.2  # relative standard deviation of the inertia of a resonance that an oscillation has
FOUND_FILTER = 0.6  # of a stage that was found by its oscillation: corner of the law's filter over its resonance,
FOUND_LAG, FOUND_INERTIA = 0.1, 0.05  # deviations of what its lag and inertia miss, over 1 / w0 and 1 / w0^2
STIFF = 0.12  # cycles per tick: from here on a tick of dead time is more than that lag
CERTAIN = 0.02  # relative deviation of a resonance that is put into the model
MOVED = 0.015  # of the resonance of the model: one that is known and differs by so much replaces it,
FURTHER = 0.15  # unless by so much
SMOOTH = 8  # times the third difference of velocities: no more than the sum of their first ones
DOUBT = 0.01  # of the motion's range: an error that the dynamics of the settings should not leave
FALLEN = 0.8  # of that error: learning makes it smaller
LASTS = 8  # windows in which it does not
ELSEWHERE = 0.03  # of the first resonance of the settings: one that differs by so much, where learning has failed
DRIVEN = 0.5  # share of the plays: what our voltage does not drive is of another axis, or comes from outside
ANOTHER = 0.07  # of their first resonance: one that differs by so much is that of another stage
FREE = 6  # half-waves of the ringing while weights are held, which show the resonance,
DECAYED = 0.98  # of the first of them: the last one is smaller, or something drives it
SLOWEST = 0.025  # of the resonance: a slower motion does not need it
NOISY = 9  # times the variance of a measurement: nor does a smaller error
MOST_CAUTION = 0.1  # of the motion's range: the largest error that counts as noise after learning has failed
CAUTIOUS = 100  # times the variance of a measurement: from there on the law follows no drift
AGREES = 0.05  # with the resonance that the estimate knows: its lag is that of this stage
TURNS = 0.2  # radians at the resonance: a smaller lag is a matter of the weights
MOST_DEAD = 8  # ticks of lag and dead time
AS_GOOD_AS_NONE = 1e-6  # of the prior's variance: of a weight that stays

BEYOND = 10
"""Limited ticks beyond the desired displacement after which the model is considered wrong, not the limit. TS_BEYOND."""


@dataclass(frozen=True)
class _Command:
    """A tick that waits for its measurement."""

    x: float  # V
    motion: Motion
    limited: bool  # the voltage met a limit


@dataclass
class _Stage:
    """The stage's first resonance, and the quantities that follow from it; at first from the settings."""

    detector: OscillationDetector
    older: FloatArray  # earlier weights, to be restored
    newer: FloatArray
    resonance: float = 0.0  # cycles per tick; 0: not known
    inertia: float = 0.0  # 1 / (w0^2 T), s: displacement that a change of zdot_d in a tick takes
    smoothing: float = 0.0  # share of a learned change that the command still lacks a tick later
    rest: float = 0.0  # ticks until learning begins again
    age: float = 0.0  # s since `newer` was kept
    found: bool = False  # it is in the model
    failed: bool = False  # with the stage that was found learning has failed,
    trial: bool = False  # or has not been better than before yet
    doubt: float = 0.0  # error over the range that the dynamics of the settings leave,
    doubted: int = 0  # and windows in which it has not fallen
    strain: dict[int, float] = field(default_factory=dict)  # um: while learning rests, by tick,
    since: int = 0  # from this one on,
    z: tuple[float, float] = (0.0, 0.0)  # um: and the last two measurements, the newer first


@dataclass
class _Kept:
    """What the guard restores."""

    guard: Guard
    first: FloatArray  # weights of the start,
    weights: FloatArray  # those at their best,
    aside: FloatArray  # and those that failed
    knowledge: Any = None  # of the law at its best,
    filter: float = 1.0  # its filter,
    stage: tuple[float, float, float] = (0.0, 0.0, 0.0)  # smoothing, resonance and inertia of the stage then,
    oscillated: bool = False  # whether an oscillation was found,
    failed: bool = False  # a stage has failed,
    staged: bool = False  # or one was in the model
    begun: bool = False  # at the first weights again, since they were kept
    recall: Recall = field(kw_only=True)


@dataclass
class _Ringing:
    """Whether the stage rings, and what the measured acceleration needs of earlier ticks: ts_ringing of the kernel."""

    u: FloatArray | None = None  # the regressor of the tick before; None: there is none
    y: float = 0.0  # um: and what w.u should have been
    error: tuple[float, float] = (0.0, 0.0)  # um: measured less desired, of the last two ticks, the newer first
    once: float = 0.0  # um: behind the first of the two poles,
    twice: tuple[float, float] = (0.0, 0.0)  # and behind both in the last two ticks
    power: float = 0.0  # um^2: mean square of the second difference of that
    rings: bool = False

    def update(self, error: float, a: float, rate: float, noise: float) -> bool:
        """Whether the error, behind the law's filter a, moves more than noise of that variance, um^2, does."""
        rest = 2 - a
        self.once += a * (error - self.once)
        newer, older = self.twice
        twice = newer + a * (self.once - newer)
        d, noise = twice - 2 * newer + older, noise * (2 * (a * a * a * a) * (4 - a) / (rest * rest * rest))
        self.twice = twice, newer
        self.power += min(rate, 1.0) * (min(d * d, JUMP * noise) - self.power)
        return self.power > RINGS * noise


@dataclass
class _Memory:
    """States of the model that depend on the voltage: of the commanded and of the measured tick."""

    play: FloatArray  # play states, V; the first is the voltage of the last tick
    creep: FloatArray  # first-order states, V
    ticks: int = 0  # so far


def law_of(settings: ControllerSettings) -> Law:
    """The law of the settings, at its start."""
    s = settings
    if s.law == "rls":
        memory = {"forgetting": s.forgetting, "regularization": s.regularization}
        return RLS(s.initial_weights, **memory, covariance_limit=s.covariance_limit)
    part = s.vector([1.0, *[2.0] * (s.plays - 1)])  # 1 for the weight of the first play, 2 for that of another
    return BoundedKalman(s.initial_weights, s.prior_covariance, part, _kalman_settings(s))


def _kalman_settings(s: ControllerSettings) -> KalmanSettings:
    members = kernel_settings(s)
    names = {f.name: f"kalman.{f.name}" for f in fields(KalmanSettings)} | {"first_noise": "first_noise"}
    return KalmanSettings(**{name: members[member] for name, member in names.items()})


def _bounded(argument: str, value: float, unit: str) -> float:
    return min(max(checks.number(argument, value, unit), -LARGEST), LARGEST)


def _others(values: Sequence[float] | None, axes: int) -> tuple[tuple[float, float, float], ...]:
    """Displacement, velocity and acceleration of each other axis; () where they are not known."""
    if values is None:
        return ()
    if len(values) != 3 * axes:
        raise checks.wrong_others(values, axes)
    bounded = [_bounded("others", value, "um, um/s, um/s^2") for value in values]
    return tuple((bounded[3 * i], bounded[3 * i + 1], bounded[3 * i + 2]) for i in range(axes))


class ReferenceController(Displayed):
    """`AdaptiveController` in NumPy, with any law.

    Parameters
    ----------
    settings : ControllerSettings
        The same settings; `precision` must be "double".
    law : Law, optional
        What adapts the weights: an object with `weights`, shape (m,), in the order of the settings, and
        `update(u, e_m)`. By default the one of the settings: `BoundedKalman` or `RLS`. A law of your own is updated at
        every measured tick; spikes, changes and the limits of the slopes are those of `BoundedKalman` alone.

    Attributes
    ----------
    settings : ControllerSettings
        As given.
    law : Law
        The law in use; `reset` puts a copy of the one that was given in its place.
    counters : dict[str, int]
        Commands, adaptations, and saturated, projected, rejected, changed and slewed ticks since the start or the last
        reset.

    Raises
    ------
    SettingError
        `precision` is not "double", or the law has another number of weights than the settings.

    Examples
    --------
    >>> settings = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> controller = ReferenceController(settings)
    >>> for tick in range(200):
    ...     z_d = 15.0 + 10.0 * np.sin(0.05 * tick)
    ...     volts = controller.command(z_d, 0.05 * 2000.0 * 10.0 * np.cos(0.05 * tick))
    ...     controller.adapt(10.0 * volts)
    >>> round(controller.command(10.0, 0.0), 2)
    1.0
    """

    def __init__(self, settings: ControllerSettings, law: Law | None = None) -> None:
        if settings.precision != "double":
            raise SettingError(
                "precision", repr(settings.precision), "'double': NumPy states the paper in double alone"
            )
        law = law_of(settings) if law is None else law
        if np.shape(law.weights) != (settings.parameters,):
            raise SettingError(
                "law.weights", f"array of shape {np.shape(law.weights)}", f"{settings.parameters} numbers"
            )
        self._fresh_law = law
        self._take(settings)
        self.reset()

    def _take(self, settings: ControllerSettings) -> None:
        self.settings = settings
        self._c: dict[str, Any] = kernel_settings(settings)  # times turned into coefficients of a tick
        s = settings
        self._r, self._d, self._w_s = (np.array(v) for v in (s.thresholds, s.dead_zone_thresholds, s.dead_zone_weights))
        self._creep = np.array(self._c["creep"])
        self._oscillation = OscillationSettings(
            **{f.name: self._c[f"oscillation.{f.name}"] for f in fields(OscillationSettings)}
        )
        self._guarding = GuardSettings(**{f.name: self._c[f"guard.{f.name}"] for f in fields(GuardSettings)})

    def reset(self) -> None:
        """Back to the first tick: plays at 0 V, the law as it was given, counters at zero, not on hold."""
        s = self.settings
        self.law = copy.deepcopy(self._fresh_law)
        self._filtering = self.law if isinstance(self.law, FilteringLaw) else None
        self._now = _Memory(np.zeros(s.plays), np.zeros(self._creep.size))
        self._lagged = copy.deepcopy(self._now)
        self._seen = np.zeros(s.parameters)  # the regressor of the last tick that was measured or passed over
        self._waiting: dict[int, _Command] = {}  # by tick: not yet in self._lagged
        self._answered = 0  # commands up to that of the last measurement that was given, it included
        self._last = _Command(0.0, Motion(0.0, 0.0), limited=False)
        self._path = Stage(self._c, s.parameters) if self._c["dynamics.known"] else None
        self._sensor = Sensor({name: value for name, value in self._c.items() if name.startswith("sensor.")})
        self._alarms, self._paused = AT_FIRST, True  # sudden changes per second; nothing is learned yet
        self._feedback, self._feedback_states = 0.0, np.zeros((FEEDBACKS, 2)).tolist()  # um
        self._bumpless = self._integral = self._innovation = 0.0  # um
        self._z_before = self._predicted_before = 0.0  # um: the last new measurement, the model's value then
        self._resolution = 0.0  # um: the smallest step from one measurement to a different one; 0: none so far
        self._beyond = 0  # ticks at a voltage limit and beyond z_d, since one that was not limited
        self._fastest = 0.0  # largest rate so far, at most the velocity limit, um/s
        kinds = [field.name for field in fields(Counters)]
        self.counters = dict.fromkeys(kinds, 0)
        self._saturated = self._projected = self._rejected = self._held = self._changed = self._slewed = False
        self._oscillating = self._restored = False

        self._oscillating = False
        self._ringing = _Ringing()
        self._estimator, self._shown, self._rate = ResonanceEstimator(), np.zeros(SHOWN), 0.0
        self._stage = _Stage(OscillationDetector(self._oscillation), self.law.weights, self.law.weights)
        self._forget_stage()
        self._begin_guard()
        self._slopes, _ = self._rate_dependent_slopes(0.0)

    def start(self, volts: float, z: float) -> None:
        """Start with an actuator that rests at z, um, under `volts`, V: the command for z is `volts`.

        The difference between z and the model is added to the offset where there is one, otherwise to the next
        commands.
        """
        s = self.settings
        low, high = s.voltage_limits
        volts, z = checks.within("volts", volts, low, high, "V"), checks.number("z", z, "um")
        s.check_reach("z", z, volts)
        self.reset()
        self._now = _Memory(play(volts, self._r, self._now.play), np.full(self._creep.size, volts))
        self._lagged = copy.deepcopy(self._now)
        missing = self._wanted_of_plays(Motion(z, 0.0)) - self._sum_of_plays()
        if s.offset:
            weights = self.weights
            weights[s.columns["offset"]] += missing
            self.law.weights = weights
        else:
            self._bumpless = -missing
        self._stage.older = self._stage.newer = self.weights
        self._begin_guard()

    def strain(self, position: FloatArray) -> FloatArray | None:
        """`strain_d` of a motion that is known ahead, um; None where the dynamics are not known."""
        return strain_of(self.settings.dynamics, checks.finite_array("position", position, "um"))

    def change(self, settings: ControllerSettings | None = None, **changes: Any) -> None:
        """New settings while running, or some of them by name, without a jump of the command.

        Only those in `CHANGEABLE` may differ.

        Raises
        ------
        SettingError
            Another differs; nothing has changed.
        """
        checks.known(changes, SETTINGS)
        settings = (settings or self.settings).changed(changes)
        for name in SETTINGS.keys() - set(CHANGEABLE):
            if getattr(settings, name) != getattr(self.settings, name):
                words = "as it was: a controller that runs keeps its law, model and prior"
                raise SettingError(name, getattr(settings, name), words, SETTINGS[name].unit)
        before = self._c
        self._take(settings)
        self._stage.detector.settings = self._oscillation
        self._kept.guard.settings = self._kept.recall.settings = self._guarding
        if any(before[name] != self._c[name] for name in ("kalman.filter", "smoothing", "resonance")):
            self._forget_stage()
        if self._filtering is not None:
            self._filtering.take(_kalman_settings(settings))
        elif isinstance(self.law, RLS):
            self.law.forgetting, self.law.covariance_limit = settings.forgetting, settings.covariance_limit
        if not settings.trim_rate > 0:
            self._integral = 0.0  # its share goes into the bumpless transfer
        self._keep_command()

    # ---- The two calls ----------------------------------------------------------------------------------------------

    def command(
        self,
        z_d: float,
        zdot_d: float,
        zddot_d: float | None = None,
        strain_d: float | None = None,
        others: Sequence[float] | None = None,
    ) -> float:
        """Voltage, V, for the desired displacement z_d, um, and velocity zdot_d, um/s; the play states advance.

        zddot_d, um/s^2, and strain_d, um, of `AdaptiveController.strain` are used where they are known, and so are
        `others`: displacement, velocity and acceleration of each other axis, um, um/s, um/s^2.

        Raises
        ------
        SettingError
            An argument is NaN or infinite; nothing has changed.
        """
        z_d, zdot_d = _bounded("z_d", z_d, "um"), _bounded("zdot_d", zdot_d, "um/s")
        zddot_d = None if zddot_d is None else _bounded("zddot_d", zddot_d, "um/s^2")
        strain_d = None if strain_d is None else _bounded("strain_d", strain_d, "um")
        moving = _others(others, self.settings.other_axes)
        if self.counters["commands"] - self._measured_ticks >= self._patience:
            self._pass_over()  # a measurement of it would be too late now
        self._see_creep(self._now)
        zddot_d = self._acceleration(zdot_d) if zddot_d is None else zddot_d
        ahead = self._ahead(zdot_d, zddot_d) if strain_d is None or self._stage.found else strain_d - z_d
        motion = Motion(z_d, zdot_d, zddot_d, ahead, moving)
        y_d = self._wanted_of_plays(motion)  # (11)
        self._slopes, self._projected = self._rate_dependent_slopes(zdot_d)  # (7)
        x = self._within_limits(play_inverse(y_d, self._slopes, self._r, self._now.play))  # (12)
        self._see_voltage(self._now, x)  # (1)
        self._bumpless *= self._stage.smoothing
        self._fastest = max(self._fastest, min(abs(zdot_d), self.settings.velocity_limit))
        self._last = _Command(x, motion, self._saturated or self._slewed)
        if self._filtering is not None:
            tick = self.counters["commands"]
            self._stage.strain[tick] = self._sum_of_plays() + self._known(motion)
            self._stage.strain.pop(tick - HISTORY, None)
            if self._path is not None:
                self._path.strain[tick] = self._stage.strain[tick]
        self._waiting[self.counters["commands"]] = self._last
        self._count(commands=True, saturated=self._saturated, projected=self._projected, slewed=self._slewed)
        return x

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Adapt to the displacement, um, measured for the command `ago` commands before the last one, 0 to 1023.

        NaN, infinity, a spike, and a measurement older than one already used are rejected, flagged and counted.

        Raises
        ------
        SettingError
            The first measurement, within 1024 ticks, is beyond the reach of the voltage: nothing has changed.
        """
        if 0 <= ago < min(HISTORY, self.counters["commands"]):
            ago += self._sensor.ticks
            self._answered = ago + 1
            if ago >= self.counters["commands"]:  # it shows what was before the first command
                self._changed = self._rejected = False
                return
        tick = self.counters["commands"] - 1 - ago
        in_time = 0 <= ago < self._waits and self._measured_ticks <= tick and tick in self._waiting
        if in_time and self._measured_ticks == 0 and math.isfinite(z_measured):
            self.settings.check_reach("z_measured", z_measured, self._waiting[tick].x)
        used = in_time and abs(z_measured) <= self.settings.measurement_limit
        self._changed = False
        if used:
            while self._measured_ticks < tick:
                self._pass_over()
            used = self._measure(z_measured)
        self._rejected = not used
        self._count(rejected=self._rejected, adaptations=not (self._rejected or self._held), changed=self._changed)

    def _measure(self, z: float) -> bool:
        """One tick with its measurement z, um; returns whether it was used."""
        tick, path, law = self._measured_ticks, self._path, self._filtering
        command, learned = self._waiting[tick], self._waiting[self._lagged.ticks].limited
        limited, beyond, motion = command.limited, self._is_beyond(command, z), command.motion
        before = self._waiting.get(tick - 1) if path is not None else None
        stands = command.x == (self._lagged.play[0] if before is None else before.x)
        u = self._sensor.sensed(self._next_lagged()) if path is None else None  # (20)
        now = self._regressor(self._now, self._last.motion)
        first = float(dot(self.law.weights, now))
        learns = self._adapts(learned, beyond) and not self._stage.rest > 0 and self._kept.guard.held == 0
        used = self._learn(u, z, motion, learn=learns, stands=stands)
        if used:  # a learned change reaches the command gradually, so that it does not excite the stage
            self._bumpless += self._stage.smoothing * (float(dot(self.law.weights, now)) - first)
        to_sensor = self._sensor.slow if path is None else path.sensor
        error = z - (motion.z_d + to_sensor[0] * motion.zdot_d + to_sensor[1] * motion.zddot_d)
        # The trim: at a voltage limit only away from it; the slew limit only delays.
        if used and (not limited or beyond):
            self._integral -= self._c["trim"] * error
        self._feed_back(-error if used and (not limited or beyond) else 0.0)  # no wind-up at a limit
        if used and path is None:
            self._stage.z = z, self._stage.z[0]
        if not used:
            self._stage.detector.miss(error)
        elif path is None:
            self._watch_stage(error, motion.zdot_d, limited)
        self._watch_resonance(z, error, motion.zdot_d, path)
        low, high = self.settings.voltage_limits
        self._watch_learning(error, motion.z_d, used and (low < command.x < high or beyond))
        if law is not None and path is not None and path.ticks != self._lagged.ticks + 1:
            self._kept.recall.ticks = 0  # the regressor is not that of the measurement before
        elif law is not None and used:
            self._watch_kept(law, self._seen if u is None else u, z if path is None else path.z[1])
        return used

    def _count(self, **kinds: bool) -> None:
        for kind, happened in kinds.items():
            self.counters[kind] += happened

    # ---- The arrows of Fig. 5: command ------------------------------------------------------------------------------

    def _through_dead_zones(self, z: float) -> float:
        """(11) of a desired, (14) of a measured displacement; the settings hold the dead zones of the inverse."""
        return float(dot(dead_zone(z, self._d), self._w_s))

    def _acceleration(self, zdot_d: float) -> float:
        """From the rates of this tick and of the last one, um/s^2; 0 at the first."""
        tick = self._oscillation.tick
        return float((zdot_d - self._last.motion.zdot_d) / tick) if self.counters["commands"] > 0 and tick > 0 else 0.0

    def _ahead(self, zdot_d: float, zddot_d: float) -> float:
        """What the stage asks of the hysteresis beyond z_d, um: 1 / G for slow motion, or the inertia z'' / w0^2.

        The inertia is within a tenth of the stroke.
        """
        if self._path is not None and self._stage.found:
            return self._ahead_of_found(self._path, zdot_d, zddot_d)
        if self._path is not None:
            return float(self._path.lead[0] * zdot_d + self._path.lead[1] * zddot_d)
        if not self._stage.inertia > 0 or self.counters["commands"] == 0:
            return 0.0
        most = self.settings.stroke / 10
        change = float(zdot_d - self._last.motion.zdot_d)
        return min(max(self._stage.inertia * change, -most), most)

    def _ahead_of_found(self, path: Stage, zdot_d: float, zddot_d: float) -> float:
        """What a stage that was found asks of the hysteresis beyond z_d, um: 1 / G up to its fourth derivative.

        From the last four velocities: a motion at a third of the resonance turns by up to a quarter of a radian in a
        tick. Where the velocities are noise, or jump, their differences do not fall: there two derivatives are used.
        """
        now = self.counters["commands"]
        v = [zdot_d, *[self._waiting[now - i].motion.zdot_d for i in (1, 2, 3)]]
        newest, before, oldest = v[0] - v[1], v[1] - v[2], v[2] - v[3]
        second = newest - before
        third = second - (before - oldest)
        if SMOOTH * abs(third) > abs(newest) + abs(before) + abs(oldest):
            return float(path.lead[0] * zdot_d + path.lead[1] * zddot_d)
        w = 2 * math.pi * self._stage.resonance
        drag, stiff = 2 * FOUND_DAMPING / w, 1 / (w * w)
        l1, l2, l3, l4 = lead_of_dead_time(path.dead)
        of_change = (stiff + l1 * drag + l2) * (newest + second / 2 + third / 3)
        of_jerk = (l1 * stiff + l2 * drag + l3) * (second + third)
        of_snap = (l2 * stiff + l3 * drag + l4) * third
        return float(path.lead[0] * zdot_d + self._oscillation.tick * (of_change + of_jerk + of_snap))

    def _known(self, motion: Motion) -> float:
        """The displacement of the known terms, um."""
        s = self.settings
        return float(dot(self.law.weights[s.of_plays :], known_terms(s, self._now.creep, motion, s.stroke)))

    def _wanted_of_plays(self, motion: Motion) -> float:
        """(11), the stage, the trim, the feedback and the bumpless transfer, less the known terms, um."""
        wanted = self._through_dead_zones(motion.z_d) + motion.ahead + self._integral + self._feedback + self._bumpless
        return float(wanted) - self._known(motion)

    def _rate_dependent_slopes(self, zdot_d: float) -> tuple[FloatArray, bool]:
        """(7) in the scale of (20), w_h = a + c_b zdot_d b, summed up; within limits, and whether one was moved."""
        low, high = self.settings.slope_limits
        least = low if self._filtering is None else IN_MOTION * low
        return limit_slopes(self._slopes_at(zdot_d), (least, high))

    def _slopes_at(self, zdot_d: float) -> FloatArray:
        a, b = self.settings.of_all_plays(self.law.weights)
        slopes: FloatArray = np.cumsum(a + self.settings.rate_scale * zdot_d * b)
        return slopes

    def _sum_of_plays(self) -> float:
        """Displacement of the plays at the present voltage, um: the forward of the inverse."""
        return float(weighted_sum(self._slopes, self._now.play))

    def _within_limits(self, x: float) -> float:
        """The output voltage: within the slew of the last one, and within the limits, whatever x is."""
        (low, high), last, slew = self.settings.voltage_limits, float(self._now.play[0]), self._c["slew"]
        number = not math.isnan(x)
        if not number:
            x = last
        self._slewed = x > last + slew or x < last - slew
        if self._slewed:
            x = last + slew if x > last else last - slew
        self._saturated = not number or not low <= x <= high
        return min(max(x, low), high)

    # ---- States of the model ----------------------------------------------------------------------------------------

    def _see_creep(self, memory: _Memory) -> None:
        memory.creep = creep_step(memory.creep, memory.play[0], self._creep)

    def _see_voltage(self, memory: _Memory, x: float) -> None:
        memory.play = play(x, self._r, memory.play)
        memory.ticks += 1

    def _regressor(self, memory: _Memory, motion: Motion) -> FloatArray:
        """(20): u = [H_0, c_b zdot_d H_0, H_1, ...], with c_a = 1; and the known terms."""
        s = self.settings
        plays = play_terms(s, memory.play, s.rate_scale * motion.zdot_d)
        return np.concatenate([plays, known_terms(s, memory.creep, motion, s.stroke)])

    @property
    def _measured_ticks(self) -> int:
        """Number of ticks whose measurement was used or passed over."""
        return self._lagged.ticks if self._path is None else self._path.ticks

    @property
    def _waits(self) -> int:
        """Commands that may wait for their measurement."""
        return HISTORY - (0 if self._path is None else self._path.dead + 4)

    @property
    def _patience(self) -> int:
        """The same, while the measurements come as late as the last one.

        A gap in them is passed over tick by tick, so that the first one after it does not take long.
        """
        return min(self._waits, self._answered + BACKLOG - 1) if self._answered else self._waits

    def _next_lagged(self) -> FloatArray:
        """The regressor of the next tick that was not yet measured."""
        tick = self._lagged.ticks
        command = self._waiting[tick]
        if tick - HISTORY in self._waiting:
            del self._waiting[tick - HISTORY]
        self._see_creep(self._lagged)
        self._see_voltage(self._lagged, command.x)
        self._seen = self._regressor(self._lagged, command.motion)
        return self._seen

    def _pass_over(self) -> None:
        """A tick for which no measurement came."""
        self._estimator.ticks = 0  # its window begins anew
        law, learn = self._filtering, not self._waiting[self._lagged.ticks].limited
        if self._path is not None:
            self._learn_staged(self._path, self._path.expected(), 0.0, measured=False, learn=learn)
        else:
            u = self._sensor.sensed(self._next_lagged())
            if law is not None:
                self._update(law, u, float(dot(u, law.weights)), 0.0, measured=False, learn=learn)
        if law is not None:
            self._stage.detector.miss(None)
        self._feed_back(0.0)

    def _pauses(self, tick: float) -> bool:
        """Whether the feedback waits while there are many alarms: its margins are those of a model that was learned."""
        self._alarms += min(tick / ALARMS, 1.0) * ((1 / tick if self._changed else 0.0) - self._alarms)
        self._paused = self._alarms > (RESUME if self._paused else PAUSE)
        return self._paused

    def _feed_back(self, error: float) -> None:
        """One tick of the feedback, for the command after it; error: desired less measured, um."""
        total, tick = 0.0, self._oscillation.tick
        if self._c["feedback.filter"] and (self._stage.found or (tick > 0 and self._pauses(tick))):
            self._feedback, self._feedback_states = 0.0, [[0.0, 0.0] for _ in self._feedback_states]
            return
        for (b0, b1, b2, a1, a2), x in zip(self._c["feedback.filter"], self._feedback_states, strict=False):
            y = b0 * error + x[0]
            x[0], x[1] = b1 * error - a1 * y + x[1], b2 * error - a2 * y
            total += y
        most = self._c["feedback.most"]
        self._feedback = min(max(total, -most), most)

    # ---- The arrows of Fig. 5: adapt --------------------------------------------------------------------------------

    def _is_beyond(self, command: _Command, z: float) -> bool:
        """At a voltage limit, and already beyond the desired displacement: the model is wrong there, not the limit."""
        low, high = self.settings.voltage_limits
        beyond = (command.x >= high and z > command.motion.z_d) or (command.x <= low and z < command.motion.z_d)
        return command.limited and beyond

    def _adapts(self, limited: bool, beyond: bool) -> bool:
        """Whether a tick is used: a limited one from the tenth on that was beyond without an unlimited one between.

        Otherwise weights that always demand more than the limit would never be corrected.
        """
        self._beyond = min(self._beyond + beyond, BEYOND) if limited else 0
        return not self._held and (not limited or (beyond and self._beyond >= BEYOND))

    def _is_frozen(self, z: float, predicted: float, stands: bool) -> bool:
        """Whether the sensor repeats a number while voltage and model move: others have noise, or steps as large."""
        law = self._filtering
        if law is None:
            return False
        if z != self._z_before or stands:
            step = abs(z - self._z_before)
            first = self._lagged.ticks <= 1  # there is none before it
            if not first and 0 < step < self.settings.stroke / 20 and not 0 < self._resolution <= step:
                self._resolution = step
            self._z_before, self._predicted_before = z, predicted
            return False
        noise = law.sigma + law.settings.model_error
        return abs(predicted - self._predicted_before) > max(6 * noise, self._resolution + 2 * noise)

    def _learn(self, u: FloatArray | None, z: float, motion: Motion, *, learn: bool, stands: bool) -> bool:
        """Adapt to the measurement z, um; u: the regressor (20), None where the stage is known. Whether z was used."""
        path, law = self._path, self._filtering
        if path is not None:
            predicted = path.expected()
            self._innovation = z - predicted
        else:
            assert u is not None
            predicted = float(dot(self.law.weights, u))
            self._innovation = self._through_dead_zones(z) + motion.ahead - predicted  # (15)
        if law is None:
            return self._learn_otherwise(u)
        used = not self._is_frozen(z, predicted, stands)
        noisy = path.quiet(self._innovation) if path is not None else self._innovation if self._ringing.rings else None
        used = used and not law.is_spike(self._innovation, noisy)
        innovation = self._innovation if used else 0.0
        if path is not None:
            self._learn_staged(path, z if used else predicted, innovation, measured=used, learn=learn)
        elif u is not None:
            self._update(law, u, predicted + innovation, innovation, measured=used, learn=learn)
        return used

    def _learn_otherwise(self, u: FloatArray | None) -> bool:
        """With a law that takes regressor and error: (23)."""
        try:
            if not self._held and u is not None:
                self.law.update(u, self._innovation)
        except UpdateRefused:
            return False
        return True

    def _learn_staged(self, path: Stage, z: float, innovation: float, *, measured: bool, learn: bool) -> None:
        """One tick of the stage with the measurement z, or what was expected: it shows the tick `dead` before."""
        y, noisy = path.notched(z), path.quiet(innovation)
        path.remember(innovation)
        if path.ticks > self._lagged.ticks + path.dead and self._filtering is not None:
            while (
                path.ticks > self._lagged.ticks + path.dead + 1
            ):  # the dead time is shorter than that of the stage before
                self._next_lagged()
            u = path.passed(self._next_lagged())
            if learn:  # one notched sample is noise, thousands of times that of z where f0 is far below the rate
                self._filtering.start_filters()
            self._update(self._filtering, u, y, noisy, measured=measured, learn=learn)

    def _update(
        self, law: FilteringLaw, u: FloatArray, y: float, innovation: float, *, measured: bool, learn: bool
    ) -> None:
        if self._measures_inertia:
            u, y = self._with_inertia(law, u, y, learn=learn)
        law.relates = self._path is not None
        if law.tick(u, y, innovation, measured=measured, learn=learn):  # (23)
            self._project_slope(law, self._fastest)  # slopes are linear in the rate:
            self._project_slope(law, -self._fastest)  # its two ends are the worst
            self._changed = law.changed

    @property
    def _measures_inertia(self) -> bool:
        """Whether the inertia of the stage is learned from the measured acceleration."""
        return self.settings.inertia and self._path is None and self._oscillation.tick > 0

    def _with_inertia(self, law: FilteringLaw, u: FloatArray, y: float, *, learn: bool) -> tuple[FloatArray, float]:
        """Regressor and measurement for the law: u and y, or, while the stage rings, those of the tick before.

        Velocity and acceleration are then the measured ones, as central differences about that tick.
        """
        r, tick, motion = self._ringing, self._oscillation.tick, self._waiting[self._lagged.ticks - 1].motion
        shown = self._sensor.slow[0] * motion.zdot_d + self._sensor.slow[1] * motion.zddot_d
        error = y - (self._through_dead_zones(motion.z_d) + motion.ahead + shown)
        before = r.u if learn else None
        if before is None:
            r.error, r.once, r.twice = (error, error), error, (error, error)
        noise = law.sigma * law.sigma + law.settings.model_error * law.settings.model_error
        r.rings = r.update(error, law.filter, tick * RINGING_RATE, noise) and before is not None
        used = u, y
        if r.rings and before is not None:
            newer, older = r.error
            columns, moved = self.settings.columns, before.copy()
            moved[columns["lag"]] += min(max((error - older) / (2 * tick), -LARGEST), LARGEST)
            moved[columns["inertia"]] += min(max((error - 2 * newer + older) / (tick * tick), -LARGEST), LARGEST)
            used = moved, r.y
        r.u, r.y, r.error = u if learn else None, y, (error, r.error[0])
        return used

    def _project_slope(self, law: FilteringLaw, zdot_d: float) -> None:
        """Move the weights so that the partial slope that is furthest outside its limits is on its limit."""
        slopes, (low, high) = self._slopes_at(zdot_d), self.settings.slope_limits
        over, under = slopes - high, low - slopes
        worst = int(np.argmax(np.maximum(over, under)))
        missing = -over[worst] if over[worst] > under[worst] else under[worst]
        if over[worst] > 0 or under[worst] > 0:
            columns = worst + 1 + int(np.searchsorted(self.settings.rate_plays, worst, "right"))  # weights up to it
            law.project(columns, self.settings.rate_scale * zdot_d, float(missing))

    # ---- Self-excited oscillation of the stage -----------------------------------------------------------------------

    def _keep_command(self) -> None:
        """Bumpless transfer: the command for the last tick stays as it was; the difference decays."""
        last = self._last
        self._slopes, _ = self._rate_dependent_slopes(last.motion.zdot_d)
        if self.counters["commands"] > 0:
            self._bumpless += self._sum_of_plays() - self._wanted_of_plays(last.motion)

    def _inertia_of(self, frequency: float) -> float:
        """1 / (w0^2 T), s, of a first resonance at `frequency`, cycles per tick; 0: not known."""
        w = 2 * math.pi * frequency
        return self._oscillation.tick / (w * w) if frequency > 0 else 0.0

    def _forget_stage(self) -> None:
        """The stage according to the settings."""
        stage, law = self._stage, self._filtering
        stage.smoothing, stage.resonance, stage.inertia = self._c["smoothing"], 0.0, 0.0
        before, self._stage.found = self._path if stage.found else None, False
        if not self._c["dynamics.known"]:
            self._path = None
        elif before is not None:
            self._path = Stage(self._c, self.settings.parameters)
            self._path.rest(before.ticks, before.strain, before.z)
            if law is not None:
                law.stop_filters()
        if law is not None:
            stage.resonance, law.filter = self._c["resonance"], self._c["kalman.filter"]
            stage.inertia = self._inertia_of(stage.resonance)

    def _adopt_resonance(self, law: FilteringLaw, frequency: float, highest: float) -> None:
        """The quantities that follow from a measured resonance, cycles per tick.

        The law's filter ends at half of it (at it where the inertia is learned), and is no higher than `highest` unless
        that is far lower; a learned change takes a period of it to reach the command, which includes the inertia.
        """
        learned = self._measures_inertia
        w = (2 * math.pi if learned else math.pi) * frequency
        pole = w / (1 + w)
        if pole > highest:
            pole = max(highest, pole / 8)
        law.filter = min(pole, self._c["kalman.filter"])
        self._stage.smoothing = max(self._stage.smoothing, 1 / (1 + frequency))
        self._estimator.look(frequency)
        self._stage.resonance, self._stage.inertia = frequency, 0.0 if learned else self._inertia_of(frequency)
        if not learned:
            return
        inertia, place = self._inertia_of(frequency) * self._oscillation.tick, self.settings.columns["inertia"].start
        weights = self.weights
        weights[place] = -inertia
        law.weights = weights
        law.separate(place, (FOUND * inertia) * (FOUND * inertia))
        self._keep_command()

    def _retreat(self, law: FilteringLaw, frequency: float) -> None:
        """The first time: earlier weights, the covariance of the prior; then a pause, with a lower filter."""
        stage = self._stage
        if not stage.detector.found:
            law.weights = stage.newer = stage.older
            stage.age = 0.0
            law.reset_covariance()
        self._adopt_resonance(law, frequency, LOWER * law.filter if stage.detector.found else 1.0)
        self._keep_command()
        stage.rest, stage.since = 1 + REST_PERIODS / frequency, self.counters["commands"]
        stage.detector.regular, stage.detector.found = 0, True
        self._count(oscillating=True)

    def _know_resonance(self, law: FilteringLaw, frequency: float) -> None:
        """It is measured, in cycles per tick: then the stage is known.

        Not where that failed, the sensor is late, or its measurements are older than the strains that were kept.
        """
        self._adopt_resonance(law, frequency, law.filter if self.counters["oscillating"] > 1 else 1.0)
        kept = self._lagged.ticks >= self._stage.since + 4
        if kept and not (self._stage.failed or self._sensor.late):
            if not self._kept.guard.kept:
                self._begin_anew(law)
            self._adopt_stage(law, frequency, self._stage.detector.peaks[0])

    def _begin_anew(self, law: FilteringLaw) -> None:
        """What was learned without the stage is wrong, and so is how sure it is."""
        law.weights = self._kept.first
        law.reset_covariance()

    def _rings_freely(self) -> bool:
        """Whether weights are held and the stage rings by itself, faster than the motion: that shows its resonance."""
        detector, late = self._stage.detector, self._sensor.late or self._c["resonance"] > 0
        ended = detector.length == 0 and detector.regular >= FREE
        if self._kept.guard.held == 0 or self._stage.failed or late or not ended or self._lagged.ticks < 8:
            return False
        if not detector.peaks[0] < DECAYED * detector.peaks[FREE - 1]:
            return False
        omega = 2 * math.pi * detector.frequency(FREE)
        return detector.peaks[0] > self._oscillation.floor and omega * detector.speed >= 2.5 * detector.acceleration

    def _adopt_stage(self, law: FilteringLaw, frequency: float, ringing: float) -> None:
        """From now on the stage is between hysteresis and sensor; it rings by so much, um.

        Lag and inertia are in it, but for what it misses, and so is what the rate weights have learned.
        """
        s, stage, tick, before = self.settings, self._stage, self._oscillation.tick, self._path
        again = stage.found
        dead = self._dead_time(frequency, before.dead if again and before is not None else 1)
        self._path, stage.found = Stage(found(frequency, tick, dead), s.parameters), True
        if before is None:
            self._path.go_on(self._lagged.ticks, dict(stage.strain), stage.z)
        else:
            self._path.go_on(before.ticks, before.strain, before.z)
        corner, time = 2 * math.pi * FOUND_FILTER * frequency, tick / (2 * math.pi * frequency)
        law.filter = corner / (1 + corner)
        law.disturbance = law.caution = 0.0
        stage.smoothing, stage.inertia = max(self._c["smoothing"], 1 / (1 + frequency)), 0.0
        lag = FOUND_LAG * time + (tick if frequency > STIFF else 0.0)
        inertia = FOUND_INERTIA * (time * time)
        places = {s.columns["lag"].start: lag * lag} if s.lag else {}
        places |= {s.columns["inertia"].start: inertia * inertia} if s.inertia else {}
        rates = np.arange(s.parameters)[s.b].tolist()
        places |= {at: AS_GOOD_AS_NONE * s.prior_covariance[at][at] for at in rates}
        weights = self.weights
        weights[list(places)] = 0.0
        law.weights = weights
        for place, variance in places.items():
            law.separate(place, variance)
        law.stop_filters()
        self._keep_command()
        guard = self._kept.guard
        if not again:
            stage.trial = guard.kept  # what was good before is good to go back to
            self._kept.begun = self._kept.begun or not guard.kept
            guard.begin()
        guard.ringing = max(guard.ringing, ringing)

    def _dead_time(self, frequency: float, before: int) -> int:
        """Whole ticks of dead time of a stage of this frequency, cycles per tick, so many were in use `before`.

        Where the estimate knows that stage, and its lag is not small beside a period, they are that lag.
        """
        known, dead = self._estimator, 1
        if known.windows > 0 and abs(frequency / known.known - 1) < AGREES:
            turns = abs(known.lag) * 2 * math.pi * frequency
            dead = int(min(max(before + known.lag + 0.5, 1), MOST_DEAD)) if turns > TURNS else before
        if self._c["dynamics.known"]:
            dead = self._c["dynamics.dead"]
        known.lag -= dead - before
        if dead != before:
            known.ticks = 0
        return dead

    @property
    def _is_given(self) -> bool:
        """Whether the dynamics of the settings are in use."""
        return self._c["dynamics.known"] and not self._stage.found

    def _give_up_stage(self, law: FilteringLaw) -> None:
        """It was not that: the stage is that of the settings, or the resonance alone is known, as before."""
        if self._path is None or not self._stage.found:
            return
        stage = self._stage
        stage.failed, stage.trial, self._estimator.windows = True, False, 0
        if self._c["dynamics.known"]:
            self._forget_stage()
            self._keep_command()
            return
        stage.z = self._path.z
        self._estimator.lag += self._path.dead - 1  # behind the plays of a tick before
        self._estimator.ticks = 0
        self._path, stage.found = None, False
        self._adopt_resonance(law, stage.resonance, 1.0)

    def _count_ringing(self, law: FilteringLaw) -> None:
        """Ringing at the resonance counts as noise: once in a half-wave.

        Its variance after the filter, over the ticks of half a half-wave, times four because it is not white.
        """
        f, detector = self._stage.resonance, self._stage.detector
        if not f > 0 or detector.length != 0:
            return
        ratio = detector.frequency(2) / f if detector.regular >= 2 else 0.0
        if not 0.7 <= ratio <= 1.4:
            law.disturbance /= 2
            return
        w = 2 * math.pi * f * (1 - law.filter) / law.filter
        left = detector.peaks[0] / (1 + w * w)
        law.disturbance = left * left / (2 * f)

    def _watch_stage(self, error: float, zdot_d: float, limited: bool) -> None:
        """One tick of the detection of a self-excited oscillation, and the reaction to it."""
        law, stage, detector = self._filtering, self._stage, self._stage.detector
        if law is None or not self._oscillation.tick > 0:
            return
        found = detector.update(error, zdot_d, self._noise(law))
        if limited:
            detector.sign = detector.regular = 0  # the law does not cause the error at a limit
        self._count_ringing(law)
        if self._rings_freely():
            stage.resonance, stage.rest, self._oscillating = detector.frequency(FREE), 0.0, False
            self._estimator.look(stage.resonance)
            self._begin_anew(law)
            self._adopt_stage(law, stage.resonance, detector.peaks[0])
            return
        if stage.rest > 0:
            stage.rest = 0.0 if detector.regular >= REST_HALF_WAVES or stage.rest < 1 else stage.rest - 1
            if not stage.rest > 0 and detector.regular >= 4:
                self._know_resonance(law, detector.frequency(4 if detector.regular < 6 else 6))
        elif (
            found > 0
            and self._kept.guard.held == 0
            and not (detector.found and self._measures_inertia)
            and not limited
            and found > NOT_BELOW * stage.resonance
            and not self._held
        ):
            self._retreat(law, found)
        else:
            stage.age += self._oscillation.tick
            if stage.age > KEEP and detector.regular < 3:
                stage.older, stage.newer, stage.age = stage.newer, law.weights, 0.0
        self._oscillating = stage.rest > 0

    # ---- The resonance from what is measured anyway ------------------------------------------------------------------

    def _matters(self) -> bool:
        """Whether the stage is put into the model, or its resonance there replaced.

        The motion is then fast enough, and the error larger than noise.
        """
        law, known, stage = self._filtering, self._estimator, self._stage
        if law is None or self._c["resonance"] > 0 or self._held or stage.rest > 0:
            return False
        if self._sensor.late or self._lagged.ticks < 8:
            return False
        if known.windows < 2 or known.variance > CERTAIN * CERTAIN:
            return False
        if stage.found:
            moved = known.known / stage.resonance - 1
            far = MOVED * MOVED < moved * moved < FURTHER * FURTHER
            return far and moved * moved > 4 * known.variance
        if self._is_given:
            guard = self._kept.guard
            failing = guard.held > 0 or guard.wait > FIRST_WAIT
            if not failing and stage.doubted < LASTS:
                return False
            away, least = known.known / self._c["dynamics.first"] - 1, ELSEWHERE if failing else ANOTHER
            large = DOUBT * guard.range
            return away * away > least * least and known.power > large * large and known.driven > DRIVEN
        noise = max(law.sigma, self._resolution)  # ringing is what is looked for
        return known.motion > SLOWEST * known.known and known.power > NOISY * noise * noise

    def _noise(self, law: FilteringLaw) -> float:
        """Standard deviation of a measurement, um: as it is now, and no less than the sensor's steps."""
        return max(math.sqrt(max(law.sigma * law.sigma, 0.5 * law.ringing)), self._resolution)

    def _watch_resonance(self, z: float, error: float, zdot_d: float, path: Stage | None) -> None:
        """One tick of the estimate: the plays of a tick before the measurement, which is about its dead time."""
        law, tick = self._filtering, self._oscillation.tick
        if law is None or not tick > 0:
            return
        if self._is_given and not self._kept.guard.error > DOUBT:  # no reason to look for another
            self._estimator.ticks = 0
            return
        now = shown(self._lagged.play)
        before, self._shown = self._shown if path is None else now, now
        known = self._estimator.update(tick, before, z, error, zdot_d, zdot_d - self._rate)
        self._rate = zdot_d
        if not known or not self._matters():
            return
        self._stage.resonance, guard = self._estimator.known, self._kept.guard
        guard.settled = guard.settled and guard.lost  # else it was no wrong sensor: there is nothing to return to
        if not self._stage.found:
            self._begin_anew(law)
        self._adopt_stage(law, self._estimator.known, math.sqrt(self._estimator.power))

    # ---- Never worse than not learning -------------------------------------------------------------------------------

    def _begin_guard(self) -> None:
        """Until there are better ones, the first weights are the best."""
        w = self.law.weights
        self._kept = _Kept(Guard(self._guarding), w, w, w, recall=Recall(self._guarding))

    def _move_offset(self, law: FilteringLaw, by: float) -> None:
        if self.settings.offset:
            weights = self.weights
            at = self.settings.columns["offset"]
            weights[at] = np.clip(weights[at] + by, -LARGEST, LARGEST)
            law.weights = weights

    def _take_weights(self, law: FilteringLaw, weights: FloatArray, *, earlier: bool) -> None:
        """The command goes on from where it is with other weights; earlier ones miss what has drifted since.

        The feedback waits, for its margins are those of a model that has been learned.
        """
        law.weights = weights
        if earlier:
            self._move_offset(law, law.missing())
        self._keep_command()
        self._alarms = 2 * PAUSE

    def _keep_weights(self, law: FilteringLaw) -> None:
        """They are at their best: with covariance, noise, and what is known of the stage."""
        kept, stage = self._kept, self._stage
        kept.weights, kept.knowledge, kept.filter = law.weights, law.knowledge(), law.filter
        kept.stage = stage.smoothing, stage.resonance, stage.inertia
        kept.oscillated, kept.failed, kept.staged = stage.detector.found, stage.failed, self._path is not None
        kept.begun = stage.trial = False

    def _watch_kept(self, law: FilteringLaw, u: FloatArray, z: float) -> None:
        """While the model is lost: whether the kept weights predict again, without a stage that was found since.

        z, um, belongs to the regressor u.
        """
        kept, guard = self._kept, self._kept.guard
        if not guard.lost or kept.staged or self._held or self._lagged.ticks < 2:
            kept.recall.ticks = 0
            return
        newer, older = (self._waiting[self._lagged.ticks - back].motion.zdot_d for back in (1, 2))
        predicted = float(dot(kept.weights, u))
        missed = self._through_dead_zones(z) + kept.stage[2] * (newer - older) - predicted
        noise = max(kept.knowledge[1], self._resolution)
        if kept.recall.update(predicted, missed, span=guard.range, noise=noise):
            self._recall(law, kept.recall.offset)

    def _recall(self, law: FilteringLaw, offset: float) -> None:
        """The kept weights again, moved by this offset, um, and what was known of the stage with them."""
        kept, stage, known = self._kept, self._stage, self._estimator
        if self._path is not None:
            stage.z, self._path, stage.found = self._path.z, None, False
        stage.smoothing, stage.resonance, stage.inertia = kept.stage
        stage.trial, stage.failed, stage.rest = False, kept.failed, 0.0
        stage.detector.found, stage.detector.sign, stage.detector.regular = kept.oscillated, 0, 0
        known.known = known.variance = 0.0
        known.windows = known.ticks = 0
        law.restore(kept.knowledge)
        law.filter, law.disturbance, law.caution = kept.filter, 0.0, 0.0
        self._take_weights(law, kept.weights, earlier=False)
        self._move_offset(law, offset)
        stage.older = stage.newer = law.weights
        stage.age = 0.0
        self._keep_command()
        kept.guard.recall()
        self._count(restored=True)
        self._oscillating, self._restored = False, True  # in this tick

    def _learn_cautiously(self, law: FilteringLaw) -> None:
        """What was held is better: its covariance; an error as large as the one that failed counts as noise a while."""
        guard = self._kept.guard
        if guard.kept:
            law.restore(self._kept.knowledge)
        else:
            law.reset_covariance()
        error = min(guard.failed, MOST_CAUTION) * guard.range
        law.caution = error * error * guard.settings.window / 4

    def _stage_is_shown(self, law: FilteringLaw) -> bool:
        """Whether the stage of the model is the one that the measurements show. Where it is near, it is moved there."""
        shown, stage = self._estimator, self._stage
        if not stage.found or not shown.known > 0 or shown.variance > CERTAIN * CERTAIN:
            return False
        moved = shown.known / stage.resonance - 1
        if moved * moved > FURTHER * FURTHER:
            return False
        if moved * moved > MOVED * MOVED:
            stage.resonance = shown.known
            self._adopt_stage(law, shown.known, 0.0)
        return True

    def _doubt_dynamics(self, error: float) -> None:
        """After a window with this error over the range: whether it is large and does not fall with those given."""
        stage = self._stage
        if error > DOUBT and stage.doubted > 0 and error > FALLEN * stage.doubt:
            stage.doubted = min(stage.doubted + 1, LASTS)
        else:
            stage.doubt, stage.doubted = error, int(error > DOUBT)

    def _watch_learning(self, error: float, z_d: float, counts: bool) -> None:
        law, kept, guard = self._filtering, self._kept, self._kept.guard
        if law is None or guard.settings.window == 0 or self._held:
            return
        resting = self._stage.rest > 0 and guard.held == 0
        noise = max(kept.knowledge[1] if guard.kept else law.sigma, self._resolution)
        match guard.update(error, z_d, counts=counts and not resting, noise=noise):
            case Action.KEEP:
                self._keep_weights(law)
            case Action.RESTORE:
                kept.aside = law.weights
                if self._stage.trial:
                    self._give_up_stage(law)
                self._take_weights(law, kept.first if kept.begun else kept.weights, earlier=True)
                self._count(restored=True)
            case Action.FIRST:
                if not self._stage_is_shown(law):
                    self._give_up_stage(law)
                self._take_weights(law, kept.first, earlier=True)
            case Action.ADOPT:
                self._learn_cautiously(law)
            case Action.RETURN if self._stage.found and not self._stage_is_shown(law):
                self._give_up_stage(law)
                self._take_weights(law, kept.first, earlier=True)
                law.reset_covariance()
            case Action.RETURN:
                of_motion = self._stage.resonance < self._estimator.lowest(self._oscillation.tick)
                if of_motion and not (self._c["resonance"] > 0 or self._path is not None):  # it was no resonance
                    self._forget_stage()
                    self._stage.detector.found = False
                self._take_weights(law, kept.aside, earlier=False)
        if guard.ticks == 0 and self._is_given:
            self._doubt_dynamics(guard.error)
        if guard.held > 0 or law.caution > CAUTIOUS * (law.sigma * law.sigma):
            self._move_offset(law, guard.drift)
        if guard.held == 0 and guard.ticks == 0:
            law.caution *= 1 - 0.8 / guard.wait
        self._restored = guard.held > 0

    # ---- Hold, and diagnostics ---------------------------------------------------------------------------------------

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def _display(self) -> tuple[str, Rows]:
        title = f"ReferenceController: {type(self.law).__name__}, {self.settings.summary}"
        return title, controller_rows(self.settings, self.weights, self._innovation, self.counters)

    def hold(self) -> None:
        """Stop adapting; commands continue with the weights as they are."""
        self._held = True

    def resume(self) -> None:
        """Adapt again."""
        self._held = False

    @property
    def weights(self) -> FloatArray:
        """w = [a0, b0, a1, b1, ...] of (21), um/V, and those of the other terms, shape (m,)."""
        return np.array(self.law.weights)

    @property
    def partial_slopes(self) -> FloatArray:
        """Slopes of the branches at the last rate, as the inverse used them, shape (n,), um/V."""
        return self._slopes.copy()

    @property
    def play_states(self) -> FloatArray:
        """Forward play states after the last command, shape (n,), V."""
        return self._now.play.copy()

    @property
    def innovation(self) -> float:
        """e_m of (15) at the last measurement, um."""
        return self._innovation

    @property
    def flag_bits(self) -> int:
        """The flags of the last tick as a bit mask, in the order of `truestroke.base.flags`."""
        adapted = (self._rejected, self._held, self._changed)
        flags = (self._saturated, self._projected, *adapted, self._slewed, self._oscillating, self._restored)
        return sum(bool(flag) << place for place, flag in enumerate(flags))
