"""The state of the controller in NumPy: what its parts read and write."""

import copy
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.control.adaptation import RLS, BoundedKalman, FilteringLaw, KalmanSettings, Law
from truestroke.control.controller import Counters
from truestroke.control.guard import FirstGain, Guard, GuardSettings, Recall
from truestroke.control.oscillation import OscillationDetector, OscillationSettings
from truestroke.control.reference.candidate import Candidate
from truestroke.control.reference.hum import Hum
from truestroke.control.resonance import SHOWN, ResonanceEstimator
from truestroke.control.sensor import Sensor
from truestroke.control.settings import ControllerSettings, kernel_settings
from truestroke.control.stage import Stage
from truestroke.model.models import Motion
from truestroke.signals.timing import LONGEST_AGO

HISTORY = LONGEST_AGO + 1
"""Commands that may wait for their measurement. TS_HISTORY of the kernel."""
SLOWER = 4  # lags of an amplifier that a stage may be found behind: TS_SLOWER of the kernel
BACKLOG = 64
"""Ticks without a measurement, beside those that one takes to come, after which the oldest is passed over."""
FEEDBACKS = 13  # filters at most: TS_FEEDBACKS of the kernel
AT_FIRST = 60.0  # 1/s: rate of sudden changes at the start, so that the feedback begins a tenth of a second later
RINGS = 4  # times the noise's: mean square of the second difference of the error where the stage rings
JUMP = 16  # times the noise's: what one tick may add to it; a jump is no ringing
BEYOND = 10
"""Limited ticks beyond the desired displacement after which the model is considered wrong, not the limit. TS_BEYOND."""


@dataclass(frozen=True)
class Command:
    """A tick that waits for its measurement."""

    x: float  # V
    motion: Motion
    limited: bool  # the voltage met a limit


@dataclass
class Growth:
    """While a stage that was found is in the model: the error over the range of the motion, in blocks, and its least.

    ts_growth of the kernel.
    """

    weights: FloatArray  # with the least error
    wait: int  # blocks: of the next hold
    late: bool = False  # the law has a third pole
    ticks: int = 0  # of this block so far,
    windows: int = 0  # and windows
    speed: float = 0.0  # um^2/s^2: sum of zdot_d^2 in it,
    square: float = 0.0  # and of the squares of the windows' errors
    least: float = 0.0  # error and speed of the block with the least error;
    swift: float = 0.0
    known: bool = False  # there is one
    bad: int = 0  # blocks in a row whose error has grown
    failed: float = 0.0  # error for which earlier weights were taken,
    held: int = 0  # windows since; 0: the law learns;
    good: float = 0.0  # error of those weights; 0: not known yet
    left: int = 0  # blocks until the hold ends, or until an error may have grown
    pace: float = 0.0  # um^2/s^2: sum of zdot_d^2 in this window,
    paced: float = 0.0  # and in the one before,
    before: float = 0.0  # and its error; 0: not known
    rising: int = 0  # windows in a row whose error has risen


@dataclass
class FirstResonance:
    """The stage's first resonance, and the quantities that follow from it; at first from the settings."""

    detector: OscillationDetector
    older: FloatArray  # earlier weights, to be restored
    newer: FloatArray
    resonance: float = 0.0  # cycles per tick; 0: not known
    inertia: float = 0.0  # 1 / (w0^2 T), s: displacement that a change of zdot_d in a tick takes
    smoothing: float = 0.0  # share of a learned change that the command still lacks a tick later
    rest: float = 0.0  # ticks until learning begins again
    age: float = 0.0  # s since `newer` was kept
    found: bool = False  # it is in the model,
    amplifier: float = 0.0  # with an amplifier whose lag keeps this share of the voltage of the last tick; 0: none
    failed: bool = False  # with the stage that was found learning has failed,
    trial: bool = False  # or has not been better than before yet
    doubt: float = 0.0  # error over the range that the dynamics of the settings leave,
    doubted: int = 0  # and windows in which it has not fallen
    widest: float = 0.0  # um: range of the motion so far, while the stage is known
    given_up: float = 0.0  # cycles per tick: of a stage with which learning has failed; 0: with none
    strain: dict[int, float] = field(default_factory=dict)  # um: while learning rests, by tick,
    since: int = 0  # from this one on,
    z: tuple[float, float] = (0.0, 0.0)  # um: and the last two measurements, the newer first
    growth: Growth | None = None  # of the error, with a stage that was found


@dataclass
class Kept:
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
    gain: FirstGain = field(kw_only=True)  # of the first weights, while nothing is kept


@dataclass
class Ringing:
    """Whether the stage rings, and what the measured acceleration needs of earlier ticks: ts_ringing of the kernel."""

    u: FloatArray | None = None  # the regressor of the tick before, or behind a third pole; None: there is none
    y: float = 0.0  # um: and what w.u should have been, or is there
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
class Memory:
    """States of the model that depend on the voltage: of the commanded and of the measured tick."""

    play: FloatArray  # play states, V; the first is the voltage of the last tick
    creep: FloatArray  # first-order states, V
    duhem: FloatArray  # states of Duhem, V
    ticks: int = 0  # so far


def law_of(settings: ControllerSettings) -> Law:
    """The law of the settings, at its start."""
    s = settings
    if s.law == "rls":
        memory = {"forgetting": s.forgetting, "regularization": s.regularization}
        return RLS(s.initial_weights, **memory, covariance_limit=s.covariance_limit)
    part = s.vector([1.0, *[2.0] * (s.plays - 1)])  # 1 for the weight of the first play, 2 for that of another
    return BoundedKalman(s.initial_weights, s.prior_covariance, part, kalman_settings(s))


def kalman_settings(s: ControllerSettings) -> KalmanSettings:
    """Those of the law, in ticks."""
    members = kernel_settings(s)
    names = {f.name: f"kalman.{f.name}" for f in fields(KalmanSettings)} | {"first_noise": "first_noise"}
    return KalmanSettings(**{name: members[member] for name, member in names.items()})


class State:
    """All that the controller knows: its settings, and what changes from tick to tick."""

    slopes: FloatArray  # of the branches at the last rate, um/V
    kept: Kept

    def __init__(self, settings: ControllerSettings, law: Law) -> None:
        self.fresh_law = law
        self.take(settings)
        self.begin()

    def take(self, settings: ControllerSettings) -> None:
        """The settings, and their times turned into coefficients of a tick."""
        self.settings = settings
        self.members: dict[str, Any] = kernel_settings(settings)  # times turned into coefficients of a tick
        s = settings
        self.thresholds, self.dead_zones = np.array(s.thresholds), np.array(s.dead_zone_thresholds)
        self.dead_zone_weights = np.array(s.dead_zone_weights)
        self.creep_rates, self.duhem_lengths = np.array(self.members["creep"]), np.array(self.members["duhem"])
        self.oscillation = OscillationSettings(
            **{f.name: self.members[f"oscillation.{f.name}"] for f in fields(OscillationSettings)}
        )
        self.guarding = GuardSettings(**{f.name: self.members[f"guard.{f.name}"] for f in fields(GuardSettings)})

    def begin(self) -> None:
        """Plays at 0 V, the law as it was given, counters at zero, not on hold."""
        s = self.settings
        self.law = copy.deepcopy(self.fresh_law)
        self.filtering = self.law if isinstance(self.law, FilteringLaw) else None
        self.now = Memory(np.zeros(s.plays), np.zeros(self.creep_rates.size), np.zeros(self.duhem_lengths.size))
        self.lagged = copy.deepcopy(self.now)
        self.u = np.zeros(s.parameters)  # the regressor of the last tick that was measured or passed over
        self.waiting: dict[int, Command] = {}  # by tick: not yet in self.lagged
        self.answered = 0  # commands up to that of the last measurement that was given, it included
        self.last = Command(0.0, Motion(0.0, 0.0), limited=False)
        self.path = Stage(self.members, s.parameters) if self.members["dynamics.known"] else None
        self.sensor = Sensor({name: value for name, value in self.members.items() if name.startswith("sensor.")})
        self.alarms, self.paused = AT_FIRST, True  # sudden changes per second; nothing is learned yet
        self.feedback, self.feedback_states = 0.0, np.zeros((FEEDBACKS, 2)).tolist()  # um
        self.hum = Hum()
        self.damping, self.damped = [0.0] * 5, [0.0, 0.0]  # filter that damps a stage that was found, its states, um
        self.side = self.since_swing = self.swings = 0  # where it was large last, ticks since it turned there, swings
        self.peak = self.first_peak = 0.0  # largest of this swing, um, and of the first one that counts
        self.bumpless = self.integral = self.innovation = 0.0  # um
        self.handed = 0.0  # um: learned, not yet in the command, but in the feedback, which hands it over
        self.z_before = self.predicted_before = 0.0  # um: the last new measurement, the model's value then
        self.resolution = 0.0  # um: the smallest step from one measurement to a different one; 0: none so far
        self.beyond = 0  # ticks at a voltage limit and beyond z_d, since one that was not limited
        self.fastest = 0.0  # largest rate so far, at most the velocity limit, um/s
        kinds = [field.name for field in fields(Counters)]
        self.counters = dict.fromkeys(kinds, 0)
        self.saturated = self.projected = self.rejected = self.held = self.changed = self.slewed = False
        self.oscillating = self.restored = False
        self.ringing = Ringing()
        self.estimator, self.shown, self.rate = ResonanceEstimator(), np.zeros(SHOWN), 0.0
        self.slower = [0.0] * SLOWER  # V: that of `lagged`, behind lags of which one may be the amplifier's
        self.candidate = Candidate()
        self.stage = FirstResonance(OscillationDetector(self.oscillation), self.law.weights, self.law.weights)

    def count(self, **kinds: bool) -> None:
        """One more of each kind that happened."""
        for kind, happened in kinds.items():
            self.counters[kind] += happened

    @property
    def weights(self) -> FloatArray:
        """A copy of them."""
        return np.array(self.law.weights)

    @property
    def measured_ticks(self) -> int:
        """Number of ticks whose measurement was used or passed over."""
        return self.lagged.ticks if self.path is None else self.path.ticks

    @property
    def waits(self) -> int:
        """Commands that may wait for their measurement."""
        return HISTORY - (0 if self.path is None else self.path.dead + 4)

    @property
    def patience(self) -> int:
        """The same, while the measurements come as late as the last one.

        A gap in them is passed over tick by tick, so that the first one after it does not take long.
        """
        return min(self.waits, self.answered + BACKLOG - 1) if self.answered else self.waits

    @property
    def measures_inertia(self) -> bool:
        """Whether the inertia of the stage is learned from the measured acceleration."""
        return self.settings.inertia and self.path is None and self.oscillation.tick > 0

    @property
    def amplifier(self) -> float:
        """Share of the last tick's voltage that the lag of the amplifier keeps, as given or found; 0: it has none."""
        given = self.members["dynamics.known"] or not self.stage.found
        return float(self.members["dynamics.amplifier"]) if given else self.stage.amplifier

    @property
    def is_given(self) -> bool:
        """Whether the dynamics of the settings are in use."""
        return self.members["dynamics.known"] and not self.stage.found


class StateShown:
    """What a controller in NumPy shows of its state."""

    _state: State

    @property
    def weights(self) -> FloatArray:
        """w = [a0, b0, a1, b1, ...] of (21), um/V, and those of the other terms, shape (m,)."""
        return self._state.weights

    @property
    def partial_slopes(self) -> FloatArray:
        """Slopes of the branches at the last rate, as the inverse used them, shape (n,), um/V."""
        return self._state.slopes.copy()

    @property
    def innovation(self) -> float:
        """e_m of (15) at the last measurement, um."""
        return self._state.innovation

    @property
    def flag_bits(self) -> int:
        """The flags of the last tick as a bit mask, in the order of `truestroke.base.flags`."""
        return sum(bit for name, bit in BIT.items() if getattr(self._state, name))
