"""Repetitive control: the error of a controller in a motion that repeats is learned while it runs, period by period.

The voltage is that of the controller inside, which does not learn meanwhile, and a correction v of the period T::

    x(t) = command(z_d, z_d', ...) + v(t mod T)

From the mean of some periods, the law of `harmonics` makes the strain of the next x, and a model of the
hysteresis, which the first of them show, its voltage. A new v takes over smoothly. The mean of the error, which creeps,
is taken away from period to period, from when the controller inside rests. Until the motion repeats, and when it no
longer does, the controller inside is alone, and learns.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, snapshot
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.flags import BIT, BY_ADAPT, Flags
from truestroke.base.typing import FloatArray
from truestroke.control.controller import Controller, State
from truestroke.control.repeating import batches, iterative
from truestroke.control.repeating.batches import Batch, Kept, Learned, Measured, Outcome
from truestroke.control.repeating.online import OnlineLaw
from truestroke.control.repeating.periodic_hysteresis import PeriodicHysteresis
from truestroke.control.repeating.repetition import (
    GAP,
    LONGEST,
    SHORTEST,
    LearnedPeriod,
    Periods,
    RepetitionSettings,
    Shape,
    begun,
    derivatives,
    kernel_repetition,
)
from truestroke.control.repeating.response_prior import FewNumbers
from truestroke.control.repeating.spikes import Spikes
from truestroke.control.repeating.steps import Steps, Task
from truestroke.control.settings import UNLIMITED
from truestroke.model.dynamics import Dynamics, Mode
from truestroke.signals.timing import LONGEST_AGO

LEVEL, MOST = 0.3, 0.7  # of the mean error of a period, which the next one takes away, and in a long one at most
LONG = 300  # ticks: the mean of more has less noise, so that more of it may be taken away
CREEPS = 0.03  # s: and not faster
FADE = 0.01, 0.05  # s: a correction takes over within a period, but not faster or slower than this
DECAY = 0.15  # s: until a change of the correction has decayed, with a resonance that rings for so long
LATEST = LONGEST_AGO + 1  # ticks: `ago` of a measurement is below
FOUND_DAMPING = 0.02  # of a resonance that the controller has found
STEP = 1e-4  # s: a tick has a step of the learning for each of these
TIMES, RESTS = 4, 2  # how often a correction is taken back, the last time all of it; periods that do not count then
SETTLED = 2.0  # s of a controller that only commands, until its hysteresis has its loop and its creep is slow
KEPT = 1000  # batches in `batches`


class _Watch:
    """The error of each period with a correction that is tried: where it is too much, half of the change is taken back.

    Parameters
    ----------
    outcome : Outcome
        With the correction, and that on which it builds.
    rests : int
        Periods after a change that do not count.
    """

    def __init__(self, outcome: Outcome, rests: int = RESTS) -> None:
        learned = outcome.learned
        assert outcome.volts is not None
        assert outcome.base is not None
        self.volts, self._base, self._most = outcome.volts, outcome.base, outcome.most
        self._unlearned, self._counts = learned.unlearned, learned.counts
        self._times, self._after = 0, rests
        self._begin(rests)

    def _begin(self, rests: int) -> None:
        """The next period begins, after some that do not count."""
        self._rests, self._ticks, self._many, self._sum, self._squares = rests, 0, 0, 0.0, 0.0

    def see(self, place: int, error: float) -> bool:
        """The error of a tick, um, at a place in the period; whether a part of the correction is to be taken back."""
        self._ticks += 1
        if self._counts.item(place):
            missing = error + self._unlearned.item(place)
            self._many, self._sum, self._squares = self._many + 1, self._sum + missing, self._squares + missing**2
        if self._ticks < self._counts.size:
            return False
        mean = self._sum / max(self._many, 1)
        above = self._squares / max(self._many, 1) - mean**2 > self._most
        if self._rests > 0 or not above or self._times == TIMES:
            self._begin(max(self._rests - 1, 0))
            return False
        self._times += 1
        self.volts = self._base if self._times == TIMES else (self.volts + self._base) / 2
        self._begin(self._after)
        return True


def _share(ticks: float) -> float:
    """Of the mean error of a period, which the next one takes away, as its noise permits.

    A share s of noise of variance v makes the level vary by s v / (2 - s).

    >>> [round(_share(ticks), 2) for ticks in (62, 300, 600, 8192)]
    [0.3, 0.3, 0.52, 0.7]
    """
    varies = LEVEL / (2 - LEVEL) * max(ticks / LONG, 1.0)
    return min(2 * varies / (1 + varies), MOST)


def _settled(controller: Controller, wave: FloatArray, rate: float) -> FloatArray:
    """The last of some periods of a motion, which begins softly: what a controller outputs that only commands, V."""
    periods = max(math.ceil(SETTLED * rate / wave.size), 4)
    z_d = begun(wave, periods * wave.size + 1)
    motion = np.stack([z_d, *derivatives(z_d, rate)], axis=1)[:-1].tolist()
    command: Any = controller.command
    return np.array([command(*row) for row in motion][-wave.size :])


class RepetitiveController(Displayed):
    """A controller, and a correction of its error in a motion that repeats, learned while it runs.

    Two periods that are alike begin a repetition. The controller inside learns until its error does not fall any more;
    from then on it rests, and a correction is learned from each batch of periods. It is taken back where the motion no
    longer repeats. Where only amplitude, offset or period of the motion have changed, what the stage has shown stays.

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
    ['0.775', '0.133', '0.009', '0.001']
    """

    _text = staticmethod(kernel_repetition)
    """What runs in each tick: in the kernel, or the NumPy text of it."""

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
        if isinstance(controller, RepetitiveController):
            raise SettingError("controller", controller, "one that has no period yet; change the period of this one")
        settings = getattr(controller, "settings", None)
        given = {"sample_rate": sample_rate, "voltage_limits": voltage_limits, "dynamics": dynamics}
        known: dict[str, Any] = {
            name: getattr(settings, name, None) if value is None else value for name, value in given.items()
        }
        for name in ("sample_rate", "voltage_limits"):
            if known[name] is None:
                raise SettingError(name, None, "given, as the controller has no settings")
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
        self._limited = self._number = self._commands = 0
        self._late = 1  # ticks: the oldest measurement so far
        self._phases, self._asked = [math.nan] * LATEST, [math.nan] * LATEST
        self._kept: Kept | None = None
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
        self._told, settings = period, self._settings(period)
        self._repetition, self._change = self._text(settings), settings.change
        size = self._repetition.size
        self._table = np.zeros(size)  # the correction
        self._task: Task | None = None  # the learning, step by step
        self._learned: Learned | None = None
        self._watch: _Watch | None = None
        self._errors, self._added, self._inside = (Periods(size) for _ in range(3))
        self._spikes, self._missing = Spikes(size), 0
        self._count = max(2, math.ceil(self.averaged / period))
        self._joined = self._rests = self._counts = False
        self._gave_up = False  # of this motion: the controller alone is better
        self._whole: FloatArray | None = None  # the voltage that was learned, until it is known what of it is missing
        self._until = -1
        self._period: float | None = None  # the next one, while the correction of this one is taken back

    def _settings(self, period: float) -> RepetitionSettings:
        change = min(max(period, FADE[0]), FADE[1]) * self.sample_rate
        ticks = period * self.sample_rate
        return RepetitionSettings(period=ticks, change=change, share=min(_share(ticks), period / CREEPS))

    @property
    def repeats(self) -> bool:
        """Whether the motion repeats, so that the correction is learned."""
        return self._joined

    @property
    def limited(self) -> int:
        """Ticks in which a limit of voltage or slew has held the sum back."""
        return self._limited + self._repetition.limited

    @property
    def period(self) -> float:
        """Of the motion, s, as it is followed; another one is taken up without a bump."""
        return self._repetition.period / self.sample_rate

    @period.setter
    def period(self, period: float) -> None:
        period = self._checked(period)
        if not self._repetition.corrects:
            self._again(period)
            return
        self._period = period
        self._repetition.leave()
        if self._joined:
            self._leave()

    def _again(self, period: float) -> None:
        self._limited += self._repetition.limited
        self._begin(period)

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
        if self._repetition.tick(z_d):
            self._turned()
        at = self._repetition.at
        place = self._commands % LATEST
        self._phases[place], self._asked[place] = at, z_d
        self._commands += 1
        low, high, slew = self._limits
        volts = self._repetition.volts(inside, low, high, slew / self.sample_rate)
        if self._whole is not None:
            self._restore(self._inside.put(at, inside))
        if self._until == self._commands:
            self._waited()
        if self._counts:
            self._see_output(self._added.put(at, volts - inside), self._inside.put(at, inside))
        return volts

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Take a measurement, um, of `ago` commands before the last one.

        The controller inside gets it unless it rests. Steps of the learning, if some wait, are done here, when the
        voltage of this tick has left.
        """
        z_measured, ago = checks.measurement(z_measured, ago)
        self._late = max(self._late, 1 + ago)
        if not self._rests:
            self.controller.adapt(z_measured, ago)
        if self._task is not None and self._task.tick():
            outcome: Outcome = self._task.result
            self._task = None
            self._take(outcome)
        if (self._counts or (self._repetition.corrects and self._joined)) and not self._held:
            self._see_error(z_measured, (self._commands - 1 - ago) % LATEST)

    def _see_error(self, z_measured: float, place: int) -> None:
        """A measurement, um, of the command at a place of those that are kept."""
        error, learned = z_measured - self._asked[place], self._learned
        if self._is_lost(int(self._phases[place]) % self._repetition.size, error):
            return
        slope = 0.0
        if self._repetition.corrects and learned is not None and (learned.carries or learned.hysteresis is not None):
            slope = learned.slope
        if not self._repetition.see(error, slope):
            return
        if self._watch is not None and self._watch.see(int(self._phases[place]) % self._repetition.size, error):
            self._become(self._watch.volts)
        if self._counts:
            period = self._errors.put(self._phases[place], error)
            if period is not None:
                self._see_period(period)

    def _is_lost(self, place: int, error: float) -> bool:
        """Whether an error, um, at a place is missing or a spike; not where so many in a row are that none counts."""
        if math.isfinite(error) and not self._spikes.is_one(place, error):
            self._missing = 0
            return False
        self._missing += 1
        return self._missing <= GAP * self._repetition.size

    # ---- The motion ------------------------------------------------------------------------------------------------

    def _turned(self) -> None:
        """A period of the motion is complete, or it no longer repeats."""
        motion = self._repetition
        if not motion.repeats:
            self._gave_up = False
            if self._joined:
                self._leave()
        elif not self._joined and not motion.corrects and not self._gave_up:
            self._joined = True
            dynamics, f = self._known(), np.arange(motion.size // 2 + 1) / self.period
            band = self._band(dynamics)
            self._do(batches.joined(motion.wave, f, self.sample_rate, dynamics, band, self._kept, self._held))

    def _known(self) -> Dynamics | None:
        """Dynamics of the stage, as far as they are known now."""
        found = getattr(self.controller, "resonance", None)
        if self._dynamics is not None or not found or not math.isfinite(found):
            return self._dynamics
        return Dynamics(sample_rate=self.sample_rate, modes=(Mode(frequency=found, damping=FOUND_DAMPING),))

    def _leave(self) -> None:
        """The correction is taken back; the controller inside, which has not followed, learns again at once."""
        self._task = self._learned = self._watch = self._whole = None
        self._joined = self._rests = False
        self._spikes = Spikes(self._repetition.size)
        if self._kept is not None:
            self._kept = replace(self._kept, level=self._repetition.goal)
        self._repetition.move(0.0, self._change)
        self._become(np.empty(0))

    def _become(self, volts: FloatArray) -> None:
        """The correction changes to this one; what is measured meanwhile does not count."""
        self._table = volts if volts.size else np.zeros(self._repetition.size)
        changes = self._repetition.become(volts if volts.size else None, waits=self._decays)
        assert changes, "the last change has ended"
        self._wait()

    @property
    def _decays(self) -> int:
        """Ticks until a change of the correction, or of what the controller inside does, has decayed."""
        return math.ceil(self._change + DECAY * self.sample_rate) + self._late

    def _wait(self) -> None:
        """Until a change has decayed."""
        self._until = self._commands + self._decays
        self._counts = False
        for periods in (self._errors, self._added, self._inside):
            periods.restart()
        self._measured: list[FloatArray] = []
        self._sums, self._outputs = np.zeros((2, self._repetition.size)), [0, 0]

    def _waited(self) -> None:
        self._counts = self._joined
        if self._joined:
            return
        self._rests = False
        if self._period is not None:
            self._again(self._period)

    # ---- Learning ----------------------------------------------------------------------------------------------------

    def _see_output(self, *periods: FloatArray | None) -> None:
        """A period of the correction as it was output, and of the controller inside, V."""
        for i, period in enumerate(periods):
            if period is not None:
                self._sums[i] += period
                self._outputs[i] += 1

    def _see_period(self, error: FloatArray) -> None:
        """A period was measured: its error against the motion, um."""
        self._measured.append(error.copy())
        if len(self._measured) >= self._count and min(self._outputs) > 0:
            self._counts, self._watch = False, None
            assert self._learned is not None
            added, inside = (total / k for total, k in zip(self._sums, self._outputs, strict=True))
            measured = Measured(self._measured, added, inside, self._table, self._number, self._commands)
            self._do(batches.concluded(self._learned, measured))

    def _do(self, steps: Steps[Outcome]) -> None:
        """In the next ticks."""
        self._task = Task(steps, max(1, round(1 / (STEP * self.sample_rate))))

    def _take(self, outcome: Outcome) -> None:
        """What follows from a batch, or from joining a motion, begins."""
        self._learned = learned = outcome.learned
        self._rests = learned.listens == 0
        if outcome.batch is not None:
            self.batches.append(outcome.batch)
            self._number += 1
        if outcome.gives_up:
            self._gave_up, self._kept = True, None
            self._leave()
            return
        if outcome.volts is None:
            if learned.law.fresh and not learned.carries:
                self._kept = None
            if self._rests and not self._repetition.corrects:
                self._become(np.zeros(self._repetition.size))  # the mean, which creeps, is followed at once
            else:
                self._wait()
            return
        if outcome.whole is not None:
            self._whole = outcome.whole
            self._become(np.zeros(self._repetition.size))
            return
        if outcome.batch is not None:  # else the mean is that of the controller inside, which has learned meanwhile
            rests = max(RESTS, math.ceil(self._change / self._repetition.size))
            self._kept, self._watch = Kept(learned, outcome.volts, 0.0), _Watch(outcome, rests)
        self._become(outcome.volts)

    def _restore(self, inside: FloatArray | None) -> None:
        """The voltage that was learned begins again, whatever the controller inside has learned meanwhile."""
        if inside is None or self._whole is None:
            return
        volts, self._whole = self._whole - inside, None
        self._become(volts - volts.mean())

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
        if self._counts or (self._task is not None and self._learned is not None):  # a batch of both kinds is none
            self._task = self._watch = None
            self._wait()

    def learned_period(self, alone: Controller) -> RepetitionSettings:
        """What was learned, for a `Repetition` around another controller that does not learn: for `export_c`.

        Its correction is the whole voltage of a period that was learned, less that of the other controller.

        Parameters
        ----------
        alone : Controller
            That takes desired displacement, velocity and acceleration, from its start on.

        Raises
        ------
        SettingError
            No batch has shown a correction yet.
        """
        if self._task is not None:
            self._task.finish()
        if self._kept is None:
            raise SettingError("controller", f"{len(self.batches)} batches", "one that has learned a correction")
        learned, size = self._kept.learned, self._kept.volts.size
        wave = np.fft.irfft(learned.motion, size)
        volts = self._kept.volts if self._watch is None else self._watch.volts
        level = self._repetition.goal if self._joined else self._kept.level
        assert learned.inside is not None
        missing = np.fft.irfft(learned.inside, size) + volts + level - _settled(alone, wave, self.sample_rate)
        mean = float(missing.mean())
        own = LearnedPeriod(Shape.of(wave), missing - mean, mean, learned.slope)
        return replace(self._settings(1 / float(learned.f[1])), settles=self._decays, learned=own)

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
        if self._task is not None:
            self._task.finish()
        own = {name: value for name, value in vars(self).items() if name not in GIVEN}
        made = {f"{INSIDE}{name}": value for name, value in inside.state().items()}
        made |= {f"{MOTION}{name}": value for name, value in self._repetition.state().items()}
        return made | snapshot.made_with(self._made_with()) | snapshot.taken(own, KINDS)

    def restore(self, state: State) -> None:
        """Restore a state of `state`, of a controller that was made with the same arguments.

        Raises
        ------
        SettingError
            It is not such a state, or one of other arguments, which are named; nothing has changed.
        """
        remedy = "make this one with the arguments of the other; or go on without its state"
        snapshot.check_made_with(state, self._made_with(), UNITS, remedy)
        inside: Any = self.controller
        arrays = dict(state.items())
        try:
            own = snapshot.rebuilt(arrays, KINDS)
            settings = self._settings(self._checked(own["_told"]))
            repetition = self._text(settings)
            repetition.restore(snapshot.named(arrays, MOTION))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SettingError("state", f"{len(arrays)} entries", f"what `state` gave: {error}") from None
        with checks.inside("controller."):
            inside.restore(snapshot.named(arrays, INSIDE))
        kept = {name: value for name, value in vars(self).items() if name in GIVEN}
        vars(self).clear()
        vars(self).update(own | kept | {"_repetition": repetition})

    def _made_with(self) -> dict[str, Any]:
        low, high, slew = self._limits
        return {
            "sample_rate": self.sample_rate,
            "voltage_limits": (low, high),
            "slew_limit": slew,
            "dynamics": None if self._dynamics is None else self._dynamics.to_dict(),
            "bandwidth": self._bandwidth,
            "averaged": self.averaged,
        }

    # ---- The controller inside ---------------------------------------------------------------------------------------

    @property
    def innovation(self) -> float:
        """Of the controller inside, um; NaN while it rests."""
        return math.nan if self._rests else float(self.controller.innovation)  # type: ignore[attr-defined]

    @property
    def flag_bits(self) -> int:
        """The flags of the last tick as a bit mask: of the controller inside, and of the limits of the sum."""
        inside: int = self.controller.flag_bits  # type: ignore[attr-defined]
        own = (BIT["slewed"] if self._repetition.slewed else 0) | (
            BIT["saturated"] if self._repetition.saturated else 0
        )
        return (inside & ~BY_ADAPT if self._rests else inside) | own

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


KINDS = (
    Batch,
    FewNumbers,
    Kept,
    Learned,
    OnlineLaw,
    Outcome,
    PeriodicHysteresis,
    Task,
    _Watch,
    Periods,
    Spikes,
)
"""What a state may hold."""
GIVEN = ("controller", "sample_rate", "averaged", "_given", "_dynamics", "_bandwidth", "_repetition")
"""What a controller is made with, and what has a state of its own."""
UNITS = {"sample_rate": "Hz", "voltage_limits": "V", "slew_limit": "V/s", "bandwidth": "Hz", "averaged": "s"}
"""Of these arguments."""
INSIDE, MOTION = "inside ", "repetition "
"""What the names of these states begin with."""
