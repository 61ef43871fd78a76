"""Repetitive control: the error of a controller in a motion that repeats is learned while it runs, period by period.

The voltage is that of the controller inside, which does not learn meanwhile, and a correction v of the period T::

    x(t) = command(z_d, z_d', ...) + v(t mod T)

From the mean of some periods, the law of `control.harmonics` makes the strain of the next x, and a model of the
hysteresis, which the first of them show, its voltage. A new v takes over smoothly. The mean of the error, which creeps,
is taken away from period to period. Until the motion repeats, and when it no longer does, the controller inside is
alone, and learns.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, snapshot
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.flags import BIT, BY_ADAPT, Flags
from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control import iterative
from truestroke.control.controller import Controller, State
from truestroke.control.harmonics import BoolArray, HarmonicLaw, Nearest
from truestroke.control.online import OnlineLaw
from truestroke.control.periodic_hysteresis import STEPS, PeriodicHysteresis, identified
from truestroke.control.repetition import LONGEST, SHORTEST, Periods, Repetition, Seen, Shape
from truestroke.control.response_prior import APART, ROUNDS, FewNumbers, beside
from truestroke.control.settings import UNLIMITED
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.signals.timing import LONGEST_AGO

LEVEL = 0.3  # of the mean error of a period, which the next one takes away, at most
CREEPS = 0.03  # s: and not faster
FADE = 0.01, 0.05  # s: a correction takes over within a period, but not faster or slower than this
DECAY = 0.15  # s: until a change of the correction has decayed, with a resonance that rings for so long
LATEST = LONGEST_AGO + 1  # ticks: `ago` of a measurement is below
UNKNOWN = 0.01  # of the sample rate: without dynamics the response is known to there; R is less sure with f^4
FOUND_DAMPING = 0.02  # of a resonance that the controller has found
STRAIGHT = 1e-3  # of the largest acceleration: where there is less, the motion is straight
LINES = 0.3  # of a period: errors of a motion that is straight for so long count there alone
LEARNED = 0.8  # times the error: while it falls below from batch to batch, the controller inside goes on learning
PATIENCE = 6  # batches, at most
ALIKE = 0.02  # of the rms of a motion: another one within it is the same, but for amplitude, offset and phase
LEARNING = frozenset({"_conclude", "_model", "_see", "_know", "_listen", "_follow", "_invert"})
"""Steps of the learning from a batch."""
CARRIED = 3.0  # times: how much more a correction may become where the period changes
KEPT = 1000  # batches in `batches`


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Batch(Displayed):
    """What the periods with one correction have shown.

    Attributes
    ----------
    number : int
        From 0 on; the first one is without a correction.
    tick : int
        Commands until its end.
    rmse, maximum : float
        Error of the mean of its periods, where errors count, um.
    noise : float
        Standard deviation of that mean, um: an error like it cannot be learned.
    expected : float
        Rmse that the next one should have, um.
    undone : str
        In a sentence, why the next one does not build on it; empty where it does.
    """

    number: int
    tick: int
    rmse: float
    maximum: float
    noise: float
    expected: float
    undone: str = ""

    def _display(self) -> tuple[str, Rows]:
        rows = [(name, quantity(getattr(self, name), "um")) for name in ("rmse", "maximum", "noise", "expected")]
        return f"Batch {self.number}: {self.undone or 'taken'}", rows


class _Correction:
    """One period of voltage that becomes another one smoothly.

    Parameters
    ----------
    ticks : float
        Of the change.
    """

    def __init__(self, ticks: float) -> None:
        self.ticks = ticks
        self._old, self._new, self._pace, self._share = np.empty(0), np.empty(0), 1 / ticks, 1.0
        self._values: tuple[list[float], list[float]] = [], []

    def become(self, volts: FloatArray) -> None:
        """From the next tick on it changes to this one, V; empty: to none."""
        size = max(self._old.size, self._new.size, volts.size)
        old, new = (x if x.size else np.zeros(size) for x in (self._old, self._new))
        g = _smooth(self._share)
        self._old, self._new, self._share = (1 - g) * old + g * new, volts, 0.0
        self._values = self._old.tolist(), self._new.tolist()

    @property
    def volts(self) -> FloatArray:
        """One period of both, V."""
        return np.concatenate([self._old, self._new])

    def at(self, phase: float) -> float:
        """In this tick, V."""
        old, new = self._values
        if self._share < 1.0:
            self._share = min(self._share + self._pace, 1.0)
            g = _smooth(self._share)
            return (1 - g) * _entry(old, phase) + g * _entry(new, phase)
        return _entry(new, phase)


class _Level:
    """A voltage against the mean of the error, which creeps, from period to period; it moves in straight lines.

    Parameters
    ----------
    ticks : int
        Of a period.
    share : float
        Of the mean of a period, which the next one takes away.
    """

    def __init__(self, ticks: int, share: float) -> None:
        self.ticks, self.share = ticks, share
        self._volts = self.goal = self._pace = 0.0
        self.restart()

    def restart(self) -> None:
        """The next period begins with the next error."""
        self._sum, self._many = 0.0, 0

    def see(self, error: float, gain: float) -> None:
        """The error of a tick, um, and the displacement by voltage, um/V."""
        self._sum, self._many = self._sum + error, self._many + 1
        if self._many == self.ticks:
            self.move(self.goal - self.share * self._sum / (gain * self._many), self.ticks)
            self.restart()

    def move(self, volts: float, ticks: float) -> None:
        """To a voltage, within so many ticks."""
        self.goal, self._pace = volts, abs(volts - self._volts) / ticks

    def tick(self) -> float:
        """In this tick, V."""
        left = self.goal - self._volts
        self._volts += math.copysign(min(abs(left), self._pace), left)
        return self._volts


def _smooth(u: float) -> float:
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


def _entry(values: list[float], phase: float) -> float:
    """Between two samples of a period."""
    if not values:
        return 0.0
    place = math.floor(phase)
    share, this = phase - place, values[place % len(values)]
    return this if share == 0.0 else this + share * (values[(place + 1) % len(values)] - this)


class RepetitiveController(Displayed):
    """A controller, and a correction of its error in a motion that repeats, learned while it runs.

    Two periods that are alike begin a repetition. The controller inside learns until its error does not fall any more;
    from then on it rests, and a correction is learned from each batch of periods. It is kept, and scaled, where
    amplitude or offset of the motion change, and taken back where the motion no longer repeats.

    Everything else that the controller inside has, such as `settings`, is that of this one, too.

    Parameters
    ----------
    controller : Controller
        Any that has `command` and `adapt`.
    period : float
        Of the motion, s, 16 to 8192 ticks. The motion's may be 1 % another, and vary as much.
    sample_rate : float, optional
        Ticks per second, Hz; by default that of `controller.settings`.
    voltage_limits : tuple[float, float], optional
        Lowest and highest voltage, V; by default those of `controller.settings`.
    slew_limit : float, optional
        Fastest change of the voltage, V/s; by default that of `controller.settings`, or none.
    dynamics : Dynamics, optional
        Of the stage; by default those of `controller.settings`, or a mode at the resonance that it has found.
    bandwidth : float, optional
        Highest harmonic that is learned, Hz; by default 2.4 times the first resonance, at most 0.45 of the sample rate.
    averaged : float
        Time of the periods of a batch, s; at least two periods.

    Attributes
    ----------
    batches : deque of Batch
        The last thousand of them.
    limited : int
        Ticks in which a limit of voltage or slew has held the sum back.

    Raises
    ------
    SettingError
        An argument is out of its bounds, or missing where the controller has no settings.

    Examples
    --------
    A gain that is a tenth wrong, of an actuator that is late by a tick; the error falls:

    >>> from truestroke.control.baselines import ConstantGain
    >>> inside = ConstantGain(11.0, voltage_limits=(0.0, 3.0))
    >>> controller = RepetitiveController(
    ...     inside, period=0.05, sample_rate=2000.0, voltage_limits=(0.0, 3.0), bandwidth=300.0
    ... )
    >>> before = 0.0
    >>> for tick in range(8000):
    ...     angle = 2 * np.pi * 20.0 * tick / 2000.0
    ...     volts = controller.command(10.0 - 10.0 * np.cos(angle), 400.0 * np.pi * np.sin(angle))
    ...     controller.adapt(10.0 * before)
    ...     before = volts
    >>> [f"{batch.rmse:.3f}" for batch in controller.batches][:4]
    ['1.191', '0.479', '0.042', '0.018']
    """

    def __init__(
        self,
        controller: Controller,
        period: float,
        *,
        sample_rate: float | None = None,
        voltage_limits: tuple[float, float] | None = None,
        slew_limit: float | None = None,
        dynamics: Dynamics | None = None,
        bandwidth: float | None = None,
        averaged: float = 0.3,
    ) -> None:
        checks.able("controller", controller, ("command", "adapt"), "a controller, such as an AdaptiveController")
        settings = getattr(controller, "settings", None)
        given = {"sample_rate": sample_rate, "voltage_limits": voltage_limits, "dynamics": dynamics}
        known: dict[str, Any] = {
            name: getattr(settings, name, None) if value is None else value for name, value in given.items()
        }
        self.controller = controller
        self.sample_rate = checks.positive("sample_rate", known["sample_rate"], "Hz")
        self._given = voltage_limits, slew_limit
        checks.interval("voltage_limits", known["voltage_limits"], "V")
        checks.positive("slew_limit", self._limits[2], "V/s")
        self._dynamics: Dynamics | None = known["dynamics"]
        if self._dynamics is not None:
            words = "a Dynamics, such as truestroke.measure_dynamics gives"
            checks.instance("dynamics", self._dynamics, Dynamics, words).check_rate(self.sample_rate)
        seen = iterative.SEEN * self.sample_rate
        self._bandwidth = None if bandwidth is None else checks.within("bandwidth", bandwidth, 0.0, seen, "Hz")
        self.averaged = checks.positive("averaged", averaged, "s")
        self.batches: deque[Batch] = deque(maxlen=KEPT)
        self.limited = self._number = self._commands = self._bits = 0
        self._late = 1  # ticks: the oldest measurement so far
        self._phases, self._asked, self._last = [math.nan] * LATEST, [math.nan] * LATEST, math.nan
        self._todo: deque[str] = deque()  # names of steps
        self._past: _Past | None = None
        self._held = False
        self._begin(self._checked(period))

    @property
    def _limits(self) -> tuple[float, float, float]:
        """Lowest and highest voltage, V, and slew, V/s, as they are now."""
        settings: Any = getattr(self.controller, "settings", None)
        limits, slew = self._given
        low, high = settings.voltage_limits if limits is None else limits
        return low, high, getattr(settings, "slew_limit", UNLIMITED) if slew is None else slew

    def _begin(self, period: float) -> None:
        """With a motion of this period, s, that has not yet repeated."""
        rate = self.sample_rate
        self._motion = Repetition(period * rate)
        size = self._motion.size
        self._f: FloatArray = np.arange(size // 2 + 1) / period
        self._errors, self._added, self._inside = (Periods(size) for _ in range(3))
        self._count = max(2, math.ceil(self.averaged / period))
        self._level = _Level(size, min(LEVEL, period / CREEPS))
        self._hysteresis: PeriodicHysteresis | None = None
        self._slope = 1.0
        self._correction = _Correction(min(max(period, FADE[0]), FADE[1]) * rate)
        self._heard: BoolArray = self._f <= iterative.SEEN * rate
        self._response = self._responses(self._dynamics)
        self._joined = self._rests = self._counts = self._corrects = False
        self._until = -1
        self._period: float | None = None  # the next one, while the correction of this one is taken back

    @property
    def repeats(self) -> bool:
        """Whether the motion repeats, so that the correction is learned."""
        return self._joined

    @property
    def period(self) -> float:
        """Of the motion, s, as it is followed; another one is taken up without a bump."""
        return self._motion.period / self.sample_rate

    @period.setter
    def period(self, period: float) -> None:
        period = self._checked(period)
        if not self._corrects:
            self._begin(period)
            return
        self._period = period
        self._motion.leave()
        if self._joined:
            self._leave()

    def _checked(self, period: float) -> float:
        rate = self.sample_rate
        period = checks.within("period", period, SHORTEST / rate, LONGEST / rate, "s")
        highest = self._band(self._dynamics)
        if period * highest < 1:
            words = f"at least {1 / highest:.4g} s: its frequency is above the bandwidth of {highest:.4g} Hz"
            raise SettingError("period", period, words, "s")
        return period

    def _band(self, dynamics: Dynamics | None) -> float:
        """Highest harmonic that is learned, Hz."""
        return iterative.band(dynamics, self.sample_rate) if self._bandwidth is None else self._bandwidth

    # ---- A tick ------------------------------------------------------------------------------------------------------

    def command(self, z_d: float, zdot_d: float, *ahead: Any) -> float:
        """Voltage for this tick, V: that of the controller inside, with its arguments, and the correction.

        Raises
        ------
        SettingError
            As of the controller inside; nothing has changed.
        """
        inside = self.controller.command(z_d, zdot_d, *ahead)
        if self._motion.tick(z_d):
            self._turned()
        at = self._motion.at
        place = self._commands % LATEST
        self._phases[place], self._asked[place] = at, z_d
        self._commands += 1
        volts = self._within(inside + self._correction.at(at) + self._level.tick()) if self._corrects else inside
        if self._until == self._commands:
            self._waited()
        if self._counts:
            self._see_output(self._added.put(at, volts - inside), self._inside.put(at, inside))
        self._last = volts
        return volts

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Take a measurement, um, of `ago` commands before the last one.

        The controller inside gets it unless it rests. The next step of the learning, if one waits, is done here, when
        the voltage of this tick has left.
        """
        self._late = max(self._late, 1 + ago)
        if not self._rests:
            self.controller.adapt(z_measured, ago)
        if self._todo:
            getattr(self, self._todo.popleft())()
        elif (self._counts or (self._corrects and self._joined)) and not self._held:
            self._see_error(z_measured, (self._commands - 1 - ago) % LATEST)

    def _see_error(self, z_measured: float, place: int) -> None:
        """A measurement, um, of the command at a place of those that are kept."""
        error = z_measured - self._asked[place]
        if not abs(error) <= self._span:  # it is lost, NaN, or no displacement
            self._level.restart()
            return
        if self._corrects and self._hysteresis is not None:
            self._level.see(error, self._slope)
        if self._counts:
            period = self._errors.put(self._phases[place], error)
            if period is not None:
                self._see_period(np.fft.rfft(period))

    def _within(self, volts: float) -> float:
        """Within the limits, and the slew since the last tick."""
        low, high, slew = self._limits
        most = slew / self.sample_rate
        held = min(max(volts, self._last - most), self._last + most) if self._last == self._last else volts
        slewed, held = held, min(max(held, low), high)
        self._bits = (BIT["slewed"] if slewed != volts else 0) | (BIT["saturated"] if held != slewed else 0)
        self.limited += held != volts
        return held

    # ---- The motion ------------------------------------------------------------------------------------------------

    def _turned(self) -> None:
        """A period of the motion is complete, or it no longer repeats."""
        if not self._motion.repeats:
            if self._joined:
                self._leave()
        elif not self._joined and not self._corrects:
            assert self._motion.shape is not None
            self._joined = True
            self._todo.append("_join")

    def _leave(self) -> None:
        """The correction is taken back; then the controller inside learns again."""
        self._todo.clear()
        self._joined = False
        if self._past is not None:
            self._past.correction[0] = self._level.goal * self._past.law.samples
        self._level.move(0.0, self._correction.ticks)
        self._become(np.empty(0))

    def _become(self, volts: FloatArray) -> None:
        """The correction changes to this one; what is measured meanwhile does not count."""
        self._correction.become(volts)
        self._corrects = True
        self._wait()

    def _wait(self) -> None:
        """Until a change of the correction, or of what the controller inside does, has decayed."""
        self._until = self._commands + math.ceil(self._correction.ticks + DECAY * self.sample_rate) + self._late
        self._counts = False
        for periods in (self._errors, self._added, self._inside):
            periods.restart()
        none = np.zeros(self._f.size)
        self._sum: ComplexArray = np.zeros(self._f.size, dtype=np.complex128)
        self._before, self._scatter, self._periods = self._sum, none, 0
        self._sums, self._outputs = np.zeros((2, self._motion.size)), [0, 0]

    def _waited(self) -> None:
        self._counts = self._joined
        if self._joined:
            return
        self._rests = self._corrects = False
        if self._period is not None:
            self._begin(self._period)

    # ---- Joining a repetition ----------------------------------------------------------------------------------------

    def _responses(self, dynamics: Dynamics | None) -> tuple[ComplexArray, ComplexArray, FewNumbers]:
        """G at the harmonics with a gain of 1, the sensor alone, and what is known of the ratio of the true G to it."""
        rate = self.sample_rate
        f = np.minimum(self._f, rate / 2)
        G, sensor, _ = iterative.response_of(dynamics, f, rate, 1.0)
        first = UNKNOWN * rate if dynamics is None else dynamics.modes[0].frequency
        alone = beside(f, first, self._band(dynamics), 1.0 if dynamics is None else APART)
        return G, sensor, FewNumbers(dynamics, f, rate, alone)

    def _join(self) -> None:
        """The motion repeats: what of it can be learned is looked for, step by step."""
        dynamics = self._dynamics
        if dynamics is None and (found := getattr(self.controller, "resonance", None)) and math.isfinite(found):
            mode = Mode(frequency=found, damping=FOUND_DAMPING)
            dynamics = Dynamics(sample_rate=self.sample_rate, modes=(mode,))
            self._response = self._responses(dynamics)
        self._learned: BoolArray = self._f <= self._band(dynamics)
        assert self._motion.shape is not None
        wave, self._span = self._motion.shape.wave, self._motion.shape.span
        bent = np.abs(np.roll(wave, 1) - 2 * wave + np.roll(wave, -1))
        straight = bent <= STRAIGHT * bent.max()
        self._where: BoolArray = straight if straight.mean() >= LINES else np.ones(wave.size, dtype=bool)
        self._search = Nearest(wave, self._where, self._learned)
        self._todo.append("_look")

    def _look(self) -> None:
        if self._search.step():
            self._todo.append("_look")
        else:
            self._todo.append("_begin_law")

    def _begin_law(self) -> None:
        """With what was learned of the same motion before, if it was; else the controller inside goes on learning."""
        G, sensor, prior = self._response
        assert self._motion.shape is not None
        motion = np.fft.rfft(self._motion.shape.wave)
        law = OnlineLaw(
            sensor * np.fft.rfft(self._search.found),
            G,
            prior,
            self._heard,
            samples=self._motion.size,
            beyond=self._heard & ~self._learned,
        )
        carried = None if self._past is None else self._past.carried(motion, self._f, law)
        self._law, self._form = law, motion
        self._hysteresis = None
        self._rest_volts: ComplexArray | None = None
        self._error, self._listens = math.inf, 0 if carried is not None else PATIENCE
        if carried is None:
            self._past = None
            self._wait()
        else:
            self._rests = True
            self._level.move(float(carried[0].real) / self._motion.size, self._correction.ticks)
            carried[0] = 0.0
            self._become(np.fft.irfft(carried, self._motion.size))

    # ---- Learning ----------------------------------------------------------------------------------------------------

    def _see_output(self, *periods: FloatArray | None) -> None:
        """A period of the correction as it was output, and of the controller inside, V."""
        for i, period in enumerate(periods):
            if period is not None:
                self._sums[i] += period
                self._outputs[i] += 1

    def _see_period(self, error: ComplexArray) -> None:
        """A period was measured: its error against the motion, which may drift and wander a little."""
        if self._periods > 0:
            self._scatter = self._scatter + np.abs(error - self._before) ** 2
        self._sum, self._before, self._periods = self._sum + error, error, self._periods + 1
        if self._periods >= self._count and min(self._outputs) > 0:
            self._counts = False
            self._todo.append("_conclude")

    def _conclude(self) -> None:
        """Of the periods of a batch: the controller inside goes on, or it rests and the correction is learned."""
        law, n = self._law, self._periods
        Z, self._noise2 = self._form + self._sum / n, self._scatter / (2 * n * (n - 1))
        added, inside = (np.fft.rfft(total / k) for total, k in zip(self._sums, self._outputs, strict=True))
        if self._rest_volts is None and self._listens == 0:  # later ones differ by drift and a wandering period
            self._rest_volts = inside
        output = (inside if self._rest_volts is None else self._rest_volts) + added
        self._volts = np.fft.irfft(output, self._motion.size)
        if law.fresh and self._past is None:
            gain = law.gain(output, Z)
            if not gain > 0:
                self._wait()
                return
            law.scale(gain)
        self._measured = Z
        self._todo.extend(["_model", "_see"])

    def _model(self) -> None:
        """The model of the hysteresis, which the first batch shows, and the strain of this one."""
        law, first = self._law, self._hysteresis is None
        if self._hysteresis is None:
            self._hysteresis = identified(
                self._volts,
                self._measured,
                law.response,
                self._noise2,
                few=self._response[2],
                learned=self._learned,
                periods=1,
            )
        self._strain = np.fft.rfft(self._hysteresis.strain(self._volts))
        if first and self._past is None:
            law.scale(law.gain(self._strain, self._measured))
        self._slope = float(np.abs(law.response[0]))

    def _see(self) -> None:
        law = self._law
        law.see(self._strain, self._measured, self._noise2)
        self._missing = np.fft.irfft(self._measured - law.desired, self._motion.size)[self._where]
        self._todo.extend(["_know"] * ROUNDS)
        self._todo.append("_listen" if self._listens > 0 else "_follow")

    def _know(self) -> None:
        self._law.know()

    def _listen(self) -> None:
        """The controller inside learns; it rests as soon as its error does not fall any more."""
        before, self._error = self._error, float(np.std(self._missing))
        self._listens = self._listens - 1 if self._error < LEARNED * before else 0
        self._rests = self._listens == 0
        self._wait()

    def _follow(self) -> None:
        following = self._law.follow(float(np.std(self._missing)))
        self._batch = Batch(
            number=self._number,
            tick=self._commands,
            rmse=float(np.sqrt(np.mean(self._missing**2))),
            maximum=float(np.abs(self._missing).max()),
            noise=self._law.noise(self._noise2),
            expected=following.expected,
            undone=following.undone,
        )
        if not following.undone:
            self._base = self._volts
        self._next, self._inverted = self._base, 0
        self._strain = following.output
        self._todo.append("_invert")

    def _invert(self) -> None:
        """A step nearer to the voltage of the next strain; at its end that is taken, but for its mean."""
        assert self._hysteresis is not None
        assert self._rest_volts is not None
        strain = np.fft.irfft(self._strain, self._motion.size)
        self._next, done = self._hysteresis.nearer(strain, self._next, self._heard)
        self._inverted += 1
        if not done and self._inverted < STEPS:
            self._todo.append("_invert")
            return
        self.batches.append(self._batch)
        self._number += 1
        v = np.where(self._heard, np.fft.rfft(self._next) - self._rest_volts, 0.0)
        v[0] = 0.0
        self._past = _Past(self._form, v, self._f, self._law)
        self._become(np.fft.irfft(v, self._motion.size))

    def hold(self) -> None:
        """Stop learning: correction and weights stay as they are, and are still taken back where the motion leaves."""
        self._hold(True)

    def resume(self) -> None:
        """Learn again, from the next batch on."""
        self._hold(False)

    def _hold(self, held: bool) -> None:
        if change := getattr(self.controller, "hold" if held else "resume", None):
            change()
        if held == self._held:
            return
        self._held = held
        if LEARNING & set(self._todo) or self._counts:  # a batch of both kinds counts for nothing
            self._todo.clear()
            self._wait()

    # ---- The state -------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The complete state after a tick, as named arrays, for `restore`: "inside weights", and so on.

        A run that is interrupted, saved with ``np.savez(file, **controller.state())``, restored and continued is equal
        to the last bit to one that was not.

        Raises
        ------
        SettingError
            The controller inside has no `state`.
        """
        checks.able(
            "controller", self.controller, ("state", "restore"), "one with a state, such as an AdaptiveController"
        )
        inside: Any = self.controller
        own = {name: value for name, value in vars(self).items() if name not in GIVEN}
        made = {f"inside {name}": value for name, value in inside.state().items()}
        return made | snapshot.taken({"given": self._made(), **own}, KINDS)

    def restore(self, state: State) -> None:
        """Restore a state of `state`, of a controller that was made with the same arguments.

        Raises
        ------
        SettingError
            It is not such a state, or one of another controller; nothing has changed.
        """
        checks.able("state", state, ("items",), "what `state` gave, or numpy.load of its file")
        inside: Any = self.controller
        arrays = dict(state.items())
        try:
            own = snapshot.rebuilt(arrays, KINDS)
            if own.pop("given") != self._made():
                raise ValueError("it is of a controller with other arguments")
            if not isinstance(own["_motion"], Repetition) or not np.isfinite(own["_correction"].volts).all():
                raise ValueError("its motion or its correction is none")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SettingError("state", f"{len(arrays)} entries", f"what `state` gave: {error}") from None
        inside.restore({name.removeprefix("inside "): a for name, a in arrays.items() if name.startswith("inside ")})
        kept = {name: value for name, value in vars(self).items() if name in GIVEN}
        vars(self).clear()
        vars(self).update(own | kept)

    def _made(self) -> list[Any]:
        """What it was made with, as numbers."""
        dynamics = None if self._dynamics is None else repr(self._dynamics)
        return [self.sample_rate, self.averaged, self._bandwidth, *self._limits, dynamics]

    # ---- The controller inside ---------------------------------------------------------------------------------------

    @property
    def innovation(self) -> float:
        """Of the controller inside, um; NaN while it rests."""
        return math.nan if self._rests else float(self.controller.innovation)  # type: ignore[attr-defined]

    @property
    def flag_bits(self) -> int:
        """The flags of the last tick as a bit mask: of the controller inside, and of the limits of the sum."""
        inside: int = self.controller.flag_bits  # type: ignore[attr-defined]
        return (inside & ~BY_ADAPT if self._rests else inside) | (self._bits if self._corrects else 0)

    @property
    def flags(self) -> Flags:
        """The flags of the last tick."""
        return Flags.from_bits(self.flag_bits)

    def __getattr__(self, name: str) -> Any:
        """Whatever else the controller inside has."""
        if name.startswith("_") or name in ("controller", "process"):
            raise AttributeError(f"a RepetitiveController has no attribute {name!r}")
        return getattr(self.controller, name)

    __copy__ = copy.deepcopy  # a shallow copy would share arrays and kernels

    def _display(self) -> tuple[str, Rows]:
        rows = [(f"batch {one.number}", quantity(one.rmse, "um"), one.undone) for one in self.batches]
        state = "repeats" if self._joined else "does not repeat"
        title = (
            f"RepetitiveController: {type(self.controller).__name__}, period {self.period:.6g} s, the motion {state}"
        )
        return title, [*rows, ("limited", quantity(self.limited, "ticks"))]


@dataclass(frozen=True, eq=False)
class _Past:
    """What was learned of a motion: its spectrum, um, the correction, V, their frequencies, Hz, and the law."""

    motion: ComplexArray
    correction: ComplexArray
    f: FloatArray
    law: HarmonicLaw

    def carried(self, motion: ComplexArray, f: FloatArray, law: HarmonicLaw) -> ComplexArray | None:
        """The correction for another amplitude, offset, phase or period of the same form; None: it is another form.

        What the law has learned of the response goes to `law`.
        """
        size = min(motion.size, self.motion.size)
        scale = law.samples / self.law.samples
        now, then = motion[1:size], scale * self.motion[1:size]
        across = np.fft.irfft(np.concatenate([[0.0], now * np.conj(then)]), law.samples)
        h = np.arange(1, size)
        shift = np.exp(-2j * np.pi * h * int(np.argmax(across)) / law.samples)
        product = np.conj(then * shift) * now
        part = float(np.sum(h * product.imag) / max(float(np.sum(h**2 * product.real)), 1e-300))  # of a sample
        shift = shift * np.exp(1j * h * part)
        amplitude = float(np.sum(np.conj(then * shift) * now).real / np.sum(np.abs(then) ** 2))
        if np.sum(np.abs(now - amplitude * shift * then) ** 2) > ALIKE**2 * np.sum(np.abs(now) ** 2):
            return None
        before = self.law.response * self.law.ratio
        law.remember(self.law, self.f, f)
        after = (law.response * law.ratio)[1:size]
        moved = before[1:size] / after
        moved = moved * np.minimum(1.0, CARRIED / np.abs(moved))
        correction = np.zeros(motion.size, dtype=np.complex128)
        correction[0] = scale * self.correction[0]
        correction[1:size] = amplitude * shift * moved * scale * self.correction[1:size]
        return correction


KINDS = (
    _Level,
    Batch,
    FewNumbers,
    Nearest,
    OnlineLaw,
    PeriodicHysteresis,
    Periods,
    Repetition,
    Seen,
    Shape,
    _Correction,
    _Past,
)
"""What a state may hold."""
GIVEN = ("controller", "sample_rate", "averaged", "_given", "_dynamics", "_bandwidth")
"""What a controller is made with."""
