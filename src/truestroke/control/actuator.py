"""The identified model of an actuator: voltage to displacement, displacement to voltage, on whole arrays."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke import _kernel
from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.display import Displayed, Rows, quantity
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.control import feasibility, interval, inverse, reach, stage, tested
from truestroke.control.explored import Explored
from truestroke.control.settings import (
    UNLIMITED,
    ControllerSettings,
    default_duhem_lengths,
    expected_terms,
    kernel_settings,
)
from truestroke.control.spans import Beyond, spans
from truestroke.model import prior
from truestroke.model.branches import Branches
from truestroke.model.dynamics import EXPECTED as DYNAMICS
from truestroke.model.dynamics import Dynamics
from truestroke.model.layout import Layout
from truestroke.model.models import Motion, asymmetry_terms, known_terms
from truestroke.model.sampled import (
    after_lag,
    ahead,
    central_difference,
    creep_states,
    creep_to_come,
    play_sum,
    respond,
)
from truestroke.signals import quiet

SLOPES = 0.4, 4.0  # of the straight line's slope: limits of the partial slopes; wider by default, where it is not known
PROVEN = 2.0  # deviations of a lag, beyond which it is one: motion that is faster than the record lags by no more
SUBSTITUTIONS = 8  # of the velocity of such motion, in its voltage
STEPPED = 5.0  # times the usual speed of a record: the fastest is that of a step
DRIFT = 0.1  # relative: how far an actuator may be from its record, in deviations of the default prior

ALIKE = 4.0  # times the noise of the record's voltage, or over it: that of the same measurement
OTHER_VOLTS = 0.1, 8.0  # times the voltage range of the record: limits beyond are those of another place or unit
OTHER_STAGE = 1.5  # times the first resonance of the record, or less: loads and temperature move it by less
ROUNDED = 1e-3  # of the fastest motion of the record: one that is faster by less is that motion, rounded

EXPECTED = "an ActuatorModel, such as of truestroke.load_model(path) or identify(record).model"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ActuatorModel(Displayed, Layout):
    """The terms of the default controller's model, with weights from a record and their covariance.

    ::

        z - asymmetry(z) = (a + c_b zdot b).H_r[x] + creep.c[x] + lag zdot + offset

    z is the displacement above `zero` before dead time and lag, c first-order states of x, and asymmetry
    4 s (1 - s) and 8 s (1 - s)(1 - 2 s) with s = z / stroke, as in `ControllerSettings`. The sensor reads z `delay`
    later, behind a first-order lag: exp(-s delay) / (1 + s time_constant). With `dynamics`, z is the strain, which
    the stage answers. Rate weights and lag are those up to `velocity`; what is faster is behind a first-order lag of
    `proven_lag`.

    Attributes
    ----------
    thresholds : tuple[float, ...]
        r of the plays, V, ascending from 0.
    rate_dependent, creep_times, lag, offset, asymmetry
        The terms, as in `Layout`; by default lag and offset alone.
    delay : float
        Dead time between voltage and displacement, s.
    time_constant : float
        Of a first-order lag between voltage and displacement, s; 0 is none.
    rate_scale : float
        c_b, s/um.
    stroke : float
        Length of the travel that the record shows, um.
    zero : float
        What the sensor reads where the model has its 0 um, um.
    voltage_range : tuple[float, float]
        Lowest and highest voltage of the record, V.
    velocity : float
        Fastest motion of the record, um/s.
    usual_velocity : float
        Speed that all but a fiftieth of the record's travel has at most, without a step with which it begins, um/s:
        beyond it the interval grows; 0 is not known.
    tested_frequency : float
        Up to which the record tests the response of the stage, Hz (`tested.frequency`); 0 is not known.
    dynamics : Dynamics or None
        Of the stage, where the record shows resonances. At sample rates that do not see them they are left out.
    weights : ndarray, shape (m,)
        [a0, b0, a1, ...], um/V; creep, um/V; lag, s; offset, um; asymmetry, um: in the order
        of `ControllerSettings.names`.
    covariance : ndarray, shape (m, m)
        Of the weights, in the squares of their units.
    noise : float
        Standard deviation of the residual of the record, um.
    voltage_noise : float
        Noise of the record's voltage that the displacement does not follow, V: that of its measurement; 0 is none.
    walk : float
        Random walk of the zero, um/sqrt(s): its variance grows by walk^2 a second.
    trend : float
        Rate of a zero that moves steadily, whichever way, um/s: its variance is at least (trend t)^2 in a time t no
        longer than the record.
    drift : float
        Rate of the zero at the end of the record, um/s; not in the prediction, whose zero is that at the end.
    jitter : float
        By how much the error grows with the velocity, s: its variance has (jitter v)^2 beside noise^2.
    coverage_factor : float
        Half width of the 95 % interval over the standard deviation, but for the zero's: 1.96 where errors are normal.
    explored : Explored or None
        Where the record has been: the error grows with the distance of a motion from it.
    metrics : mapping of str to float
        What the fit reports of itself, such as "held_out_rmse_um".
    provenance : mapping of str to str
        Where it comes from, such as "source".
    branches : Branches or None
        Hysteresis that plays of the voltage do not have: its sum is added to that of the plays.
    plain : ActuatorModel or None
        With `branches`, the model of plays alone from the same record: a controller starts from it.
    before : ActuatorModel or None
        The model that `refine` made it from, so that a pass that is worse can be undone; without one of its own.

    Raises
    ------
    SettingError
        An entry is out of bounds or does not fit the others.
    """

    weights: FloatArray
    stroke: float
    voltage_range: tuple[float, float]
    covariance: FloatArray
    delay: float = 0.0
    time_constant: float = 0.0
    rate_scale: float = 0.0
    zero: float = 0.0
    velocity: float = 0.0
    usual_velocity: float = 0.0
    tested_frequency: float = 0.0
    noise: float = 0.0
    voltage_noise: float = 0.0
    walk: float = 0.0
    trend: float = 0.0
    drift: float = 0.0
    jitter: float = 0.0
    coverage_factor: float = 1.96
    explored: Explored | None = None
    dynamics: Dynamics | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)
    branches: Branches | None = None
    plain: ActuatorModel | None = None
    before: ActuatorModel | None = None

    def __post_init__(self) -> None:
        made = self._settings(1.0, law="rls")  # checks the terms; the other law would make a covariance of them
        if made.duhem_lengths:
            raise SettingError("duhem_lengths", made.duhem_lengths, "(): a model has them as `branches`", "V")
        weights = np.array(made.initial_weights)
        covariance = checks.finite_array("covariance", self.covariance, ndim=2)
        if covariance.shape != (weights.size, weights.size) or not np.allclose(covariance, covariance.T):
            bound = f"symmetric, of shape ({weights.size}, {weights.size})"
            raise SettingError("covariance", f"array of shape {covariance.shape}", bound)
        if np.linalg.eigvalsh(covariance).min() < -1e-9 * np.trace(covariance):
            raise SettingError("covariance", "matrix with a negative eigenvalue", "positive semidefinite")
        if self.dynamics is not None:
            checks.instance("dynamics", self.dynamics, Dynamics, DYNAMICS)
        if self.explored is not None:
            checks.instance("explored", self.explored, Explored, "that of a model of `identify`")
        values: dict[str, object] = {
            "stroke": made.stroke,
            "rate_scale": made.rate_scale,
            **made.terms,
            "weights": weights,
            "covariance": covariance,
            "voltage_range": made.voltage_limits,
            "delay": checks.within("delay", self.delay, 0.0, 3600.0, "s"),
            "time_constant": checks.within("time_constant", self.time_constant, 0.0, 3600.0, "s"),
            "zero": checks.number("zero", self.zero, "um"),
            "velocity": checks.within("velocity", self.velocity, 0.0, 1e12, "um/s"),
            "usual_velocity": checks.within("usual_velocity", self.usual_velocity, 0.0, 1e12, "um/s"),
            "tested_frequency": checks.within("tested_frequency", self.tested_frequency, 0.0, 1e12, "Hz"),
            "noise": checks.within("noise", self.noise, 0.0, 1e9, "um"),
            "voltage_noise": checks.within("voltage_noise", self.voltage_noise, 0.0, 1e9, "V"),
            "walk": checks.within("walk", self.walk, 0.0, 1e9, "um/sqrt(s)"),
            "trend": checks.within("trend", self.trend, 0.0, 1e12, "um/s"),
            "drift": checks.within("drift", self.drift, -1e9, 1e9, "um/s"),
            "jitter": checks.within("jitter", self.jitter, 0.0, 3600.0, "s"),
            "coverage_factor": checks.within("coverage_factor", self.coverage_factor, 0.0, 1e9),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _display(self) -> tuple[str, Rows]:
        units = {
            **{"stroke": "um", "voltage_range": "V", "velocity": "um/s", "zero": "um", "delay": "s"},
            **{
                "time_constant": "s",
                "tested_frequency": "Hz",
                "noise": "um",
                "voltage_noise": "V",
                "walk": "um/sqrt(s)",
                "trend": "um/s",
                "drift": "um/s",
                "jitter": "s",
                "coverage_factor": "",
            },
            **{"thresholds": "V", "rate_dependent": "", "creep_times": "s", "rate_scale": "s/um"},
        }
        rows = [(name, quantity(getattr(self, name), unit)) for name, unit in units.items()]
        if self.dynamics is not None:
            modes = ", ".join(f"{mode.frequency:.4g}" for mode in self.dynamics.modes)
            rows += [("dynamics", f"resonance at {modes} Hz")]
        if self.branches is not None:
            rows += [("branches", self.branches.described)]
        if self.plain is not None:
            rows += [("plain", f"for controllers, noise {quantity(self.plain.noise, 'um')}")]
        rows += [("weight a0", f"{self.weights[0]:.6g} +- {self.deviations[0]:.2g} um/V")]
        rows += [(name, quantity(value)) for name, value in {**self.metrics, **self.provenance}.items()]
        return f"ActuatorModel: {len(self.thresholds)} plays, {self.weights.size} weights", rows

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations of the weights, in their units, shape (m,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def verdict(self) -> Verdict:
        """Of `identify`, by its provenance; good where it does not have one."""
        return Verdict.named(self.provenance)

    @property
    def duration(self) -> float:
        """Of the record, s, by its metrics; 0 where they do not have it."""
        rate = self.metrics.get("record_sample_rate_hz", 0.0)
        return self.metrics.get("record_samples", 0.0) / rate if rate else 0.0

    @property
    def sensitivity(self) -> float:
        """Stroke over voltage range of the record, um/V."""
        return self.stroke / (self.voltage_range[1] - self.voltage_range[0])

    def settings(self, sample_rate: float, **changes: Any) -> ControllerSettings:
        """Settings of a controller with this model and its weights.

        Delay and time constant go into the lag, and the limits of the slopes follow from the record's stroke and
        voltage. The `dynamics` are passed on, where the sample rate sees the resonances. A `sensor_delay` and a
        `sensor_bandwidth` are parts of the record's delay and time constant. A controller has no branches: of a model
        with `branches` they are those of `plain`.

        Parameters
        ----------
        sample_rate : float
            Ticks per second, Hz.
        **changes
            Members of `ControllerSettings` that replace what follows from the model, such as `voltage_limits`. Of
            `dynamics` that are given see `beside_dynamics`.

        Raises
        ------
        SettingError
            A setting is out of bounds, or `dynamics` are of a stage with another first resonance.
        """
        if self.branches is not None:
            return self._plays_alone().settings(sample_rate, **changes)
        known: dict[str, Any] = {"slope_limits": (SLOPES[0] * self.sensitivity, SLOPES[1] * self.sensitivity)}
        if changes.get("dynamics") is not None:
            made = self.beside_dynamics()._settings(sample_rate, **{**known, **changes})
            self._check_resonance(made.dynamics)
            return made
        late = self.delay + self.time_constant - _sensor_lag(**changes)
        known["initial_weights"] = self.delayed(late)
        if changes.get("law", "kalman") == "kalman":
            known["dynamics"] = self.stage(sample_rate)
        return self._settings(sample_rate, **{**known, **changes})

    def beside_dynamics(self) -> ActuatorModel:
        """The model for a controller with measured `dynamics`: dead time, lag and resonances are in these.

        Its delay, time constant and lag are 0, and so is the weight of the inertia, which is added where it has none.
        """
        at, there = self.columns["inertia"].start, int(self.inertia)
        kept = np.delete(np.arange(self.parameters), np.s_[at : at + there])
        weights = np.insert(self.weights[kept], at, 0.0)
        weights[self.columns["lag"]] = 0.0
        P = np.insert(np.insert(self.covariance[np.ix_(kept, kept)], at, 0.0, axis=0), at, 0.0, axis=1)
        return self.replace(
            inertia=True, weights=weights, covariance=P, delay=0.0, time_constant=0.0, dynamics=None, before=None
        )

    def check_volts(self, voltage_limits: Any = None, narrower: bool = False, **_: Any) -> None:
        """SettingError where limits, V, are of another place or unit than the voltage of the record.

        `narrower` ones than a tenth of its range are for a waveform, which may use a part of it.
        """
        if voltage_limits is None:
            return
        low, high = checks.interval("voltage_limits", voltage_limits, "V")
        known = self.voltage_range[1] - self.voltage_range[0]
        if not (narrower or OTHER_VOLTS[0] * known <= high - low) or high - low > OTHER_VOLTS[1] * known:
            bound = (
                f"{OTHER_VOLTS[0] * known:.4g} to {OTHER_VOLTS[1] * known:.4g} V apart, {OTHER_VOLTS[0]:g} to "
                f"{OTHER_VOLTS[1]:g} times the range of the model's record: both must be volts at the D/A converter; "
                "identify a record of that voltage"
            )
            raise SettingError("voltage_limits", f"{low:g} to {high:g}", bound, "V")

    def _check_resonance(self, dynamics: Dynamics | None) -> None:
        """SettingError where dynamics are of another stage than those of the record."""
        if dynamics is None or self.dynamics is None:
            return
        here, there = dynamics.modes[0].frequency, self.dynamics.modes[0].frequency
        if not 1 / OTHER_STAGE < here / there < OTHER_STAGE:
            words = f"that of the same stage: the record of the model has {there:.4g} Hz; measure one of them again"
            raise SettingError("dynamics", f"first resonance {here:.4g} Hz", words)

    def stage(self, sample_rate: float) -> Dynamics | None:
        """The dynamics at a sample rate, Hz; None without any, or where it does not see the resonances."""
        try:
            return None if self.dynamics is None else self.dynamics.at(sample_rate)
        except SettingError:
            return None

    def delayed(self, delay: float) -> tuple[float, ...]:
        """The weights with a delay, s, in the lag."""
        w = self.weights.copy()
        w[self.columns["lag"]] -= delay
        return tuple(w.tolist())

    def start(self, sample_rate: float, **changes: Any) -> ControllerSettings:
        """`settings` of a controller that starts at rest, with a prior as sure of the weights as the record allows.

        The offset starts at 0 um: that of the record is where the record happened to begin. The prior is that of
        `another_day`. The law also returns to the prior, and takes sudden changes to be a share of it: too sure a
        prior would not follow them. States of Duhem, which the model does not have, start with weights of 0 um/V.

        Raises
        ------
        SettingError
            As of `settings`, and where `voltage_limits` are less than 0.1 or more than 8 times as far apart as the
            voltages of the record: of another place or unit.
        """
        if self.branches is not None:
            return self._plays_alone().start(sample_rate, **changes)
        self.check_volts(**changes)
        lengths = changes.pop("duhem_lengths", None)
        of_all = "initial_weights", "prior_covariance"  # of the states of Duhem, too, which `fixed` does not have
        fixed = self.settings(sample_rate, **{name: value for name, value in changes.items() if name not in of_all})
        measured = changes.get("dynamics") is not None
        model = self.beside_dynamics() if measured else self
        weights = np.array(fixed.initial_weights)
        weights[model.columns["offset"]] = 0.0
        lengths = default_duhem_lengths(fixed) if lengths is None else lengths
        still = [0.0] * len(checks.several("duhem_lengths", lengths, "V"))
        from_rest = {"duhem_lengths": lengths, "initial_weights": (*weights.tolist(), *still), **changes}
        if fixed.law != "kalman":
            return self.settings(sample_rate, **from_rest)
        P = model.another_day()
        for term in ("lag", "inertia") if measured else ():  # what the dynamics may miss, and no more
            place = model.columns[term]
            P[place], P[:, place] = 0.0, 0.0
            P[place, place] = np.array(fixed.prior_covariance)[place, place]
        unknown = (expected_terms(fixed)["duhem"].deviation * self.sensitivity) ** 2 * np.eye(len(still))
        P = np.block([[P, np.zeros((len(P), len(still)))], [np.zeros((len(still), len(P))), unknown]])
        return self.settings(sample_rate, **{"prior_covariance": tuple(map(tuple, P.tolist())), **from_rest})

    def _plays_alone(self) -> ActuatorModel:
        if self.plain is None:
            raise SettingError("model.plain", None, "the model of plays alone: a controller has no branches")
        return self.plain

    def another_day(self) -> FloatArray:
        """Covariance of the weights on another day than that of the record, in the squares of their units, (m, m).

        That of the record plus `DRIFT`^2 of the default prior: the record does not contain the load, temperature and
        polarisation of another day, and the model is not the actuator. The offset has its default variance.
        """
        default = prior.covariance(self, np.abs(self.weights[self.a]), q=self.sensitivity, stroke=self.stroke)
        P = self.covariance + DRIFT**2 * default
        offset = self.columns["offset"]
        P[offset], P[:, offset] = default[offset], default[:, offset]
        return np.asarray(P)

    def _settings(self, sample_rate: float, **changes: Any) -> ControllerSettings:
        model: dict[str, Any] = {
            "stroke": self.stroke,
            "voltage_limits": self.voltage_range,
            "plays": len(checks.several("thresholds", self.thresholds, "V")),
            **self.terms,
            "rate_scale": self.rate_scale,
            "initial_weights": tuple(checks.finite_array("weights", self.weights).tolist()),
        }
        return ControllerSettings(sample_rate=sample_rate, **{**model, **changes})

    # ---- Forward ---------------------------------------------------------------------------------------------------

    def predict(
        self,
        volts: npt.ArrayLike,
        sample_rate: float,
        *,
        offset: float = 0.0,
        measured: bool | None = None,
        rest: float = math.inf,
    ) -> FloatArray:
        """Displacement that the voltage makes, um, as the sensor of the record reads it.

        The actuator is taken to have rested at the first voltage, reached from rest at 0 V. The zero of another day is
        another one: `identification.score` estimates it.

        Parameters
        ----------
        volts : array_like, shape (samples,)
            Voltage, V.
        sample_rate : float
            Samples per second, Hz.
        offset : float
            By how much the sensor's zero is above that of the record, um.
        measured : bool, optional
            True: the voltage was measured. White noise of 1e-4 to 0.02 of the range of the record is taken off, for the
            actuator does not see it. False: it is the voltage at the actuator. By default noise is taken off where the
            record's voltage had some, too (`voltage_noise`), of a quarter to four times the size.
        rest : float
            Time under the first voltage before the first sample, s, at least 0: creep that is slower goes on. By
            default it has ended.
        """
        return self.forward(self._at_the_actuator(volts, measured), sample_rate, offset=offset, rest=rest)

    def forward(
        self, volts: npt.ArrayLike, sample_rate: float, *, offset: float = 0.0, rest: float = math.inf
    ) -> FloatArray:
        """Displacement that a voltage at the actuator makes, um, such as one that a model made: it has no noise.

        volts, sample_rate, offset, rest and the errors as of `predict`.
        """
        zero = self.zero + checks.number("offset", offset, "um")
        return zero + self._moved(self.strain(volts, sample_rate, rest=rest), float(sample_rate))

    def _moved(self, strain: FloatArray, fs: float) -> FloatArray:
        """What the stage, dead time and lag make of a strain, um above `zero`."""
        known = self.stage(fs) if strain.size else None
        moved = strain if known is None else stage.through(known, strain)
        return respond(moved, self.delay * fs, self.time_constant * fs)

    def _at_the_actuator(self, volts: npt.ArrayLike, measured: bool | None) -> FloatArray:
        """The voltage, V, without the noise of its measurement; arguments as of `predict`."""
        x = checks.finite_array("volts", volts, "V")
        if measured is not None:
            checks.flag("measured", measured)
        if measured is False or (measured is None and not self.voltage_noise):
            return x
        deviation = quiet.noise_of(x, self.voltage_range[1] - self.voltage_range[0])
        alike = measured or self.voltage_noise / ALIKE < deviation < self.voltage_noise * ALIKE
        return quiet.without_noise(x, deviation) if alike else x

    def strain(self, volts: npt.ArrayLike, sample_rate: float, *, rest: float = math.inf) -> FloatArray:
        """What the voltage at the actuator makes before dead time, lag and `dynamics`, um above `zero`.

        volts, sample_rate and rest as of `predict`.
        """
        x = checks.finite_array("volts", volts, "V")
        fs = checks.positive("sample_rate", sample_rate, "Hz")
        rest = resting_time(rest)
        if x.size == 0:
            return x
        w = self.weights
        a, b = self.of_all_plays(w)
        creep = creep_states(x, self.creep_times, fs)
        if rest < math.inf and creep:
            creep = list(creep - creep_to_come(float(x[0]), self.creep_times, rest, np.arange(x.size) / fs))
        further = 0.0 if self.branches is None else self.branches.sum(x)

        def response(velocity: FloatArray) -> FloatArray:
            plays = play_sum(x, self.rate_scale * velocity, a, b, self.thresholds) + further
            return displacement(self, w, plays, creep, velocity)

        velocity = central_difference(response(np.zeros_like(x)), fs)
        seen = self.seen(velocity)
        return response(seen) - after_lag(self.proven_lag * (velocity - seen), self.proven_lag * fs)

    def interval(
        self, volts: npt.ArrayLike, sample_rate: float, *, after: float = 0.0, measured: bool | None = None
    ) -> FloatArray:
        """Half width of the 95 % interval of what the sensor reads, um, shape (samples,): `predict` plus or minus it.

        ::

            sqrt(
                k^2 (diag(J P J') + noise^2 + (jitter v)^2 + (g d)^2) + 1.96^2 (a^2 + (late s)^2 + n^2)
                + 2.45^2 (max(walk^2 t, trend^2 t min(t, T)) + (drift t)^2 + creep^2)
            )

        k is the `coverage_factor`, J the derivative of the prediction by the weights, P their covariance, v the
        predicted velocity, d the distance of the motion from all that the record shows and g its growth (`explored`),
        a how far `plain` differs from a model with branches beyond their usual difference, s by how much the motion is
        faster than `usual_velocity`, late by how much such motion may be late (`interval.of_speed`), n the error
        `interval.beyond` the voltages of the record, t the time since its end, T its `duration`: the zero walks and
        drifts on, at rest, too, and creeps by 1 % of the stroke or more in each tenfold of T. Where the record has
        loops of one family, such as one sine, the interval of motion inside of them is no less than that of
        `interval.of_inner_loops`.

        Parameters
        ----------
        volts, sample_rate, measured
            As of `predict`.
        after : float
            Time between the end of the record and the first sample, s, at least 0.

        Examples
        --------
        >>> model = ActuatorModel(
        ...     thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.zeros((3, 3)), stroke=20.0,
        ...     voltage_range=(0.0, 2.0), noise=0.03, walk=0.01,
        ... )
        >>> model.interval([0.0, 1.0], 1.0).round(4), model.interval([0.0, 1.0], 1.0, after=1800.0).round(4)
        (array([0.0588, 0.0637]), array([1.0411, 1.0414]))
        """
        x = self._at_the_actuator(volts, measured)
        fs = checks.positive("sample_rate", sample_rate, "Hz")
        since = checks.within("after", after, 0.0, 1e12, "s") + np.arange(x.size) / fs
        return interval.half_width(self, x, fs, interval.of_zero(self, since))

    def seen(self, velocity: FloatArray) -> FloatArray:
        """A velocity, um/s, within that of the record: beyond it the rate weights are as at its fastest."""
        return np.clip(velocity, -self.velocity, self.velocity) if self.velocity else velocity

    @property
    def fastest(self) -> float:
        """Fastest motion that the record shows, um/s: `velocity`, or the usual one where that is of a step or two."""
        stepped = 0.0 < STEPPED * self.usual_velocity < self.velocity
        return self.usual_velocity if stepped else self.velocity

    @property
    def proven_lag(self) -> float:
        """As much of the lag's weight as is beyond `PROVEN` deviations, s: what is faster than the record lags by it.

        At the speed of the record the weight is in full. Where its deviation is 0, and so not known, none is proven.
        """
        late = -float(self.weights[self.columns["lag"]].sum())
        deviation = float(self.deviations[self.columns["lag"]].sum())
        return max(late - PROVEN * deviation, 0.0) if deviation else 0.0

    def before_lag(self, z: FloatArray, velocity: FloatArray, sample_rate: float) -> tuple[FloatArray, FloatArray]:
        """The strain, um, that makes z of this velocity, um/s, behind `proven_lag`; and its velocity without a lag.

        By repeated substitution, each of which leaves less.
        """
        lag = self.proven_lag
        if not lag or not (velocity - self.seen(velocity)).any():
            return z, velocity
        for _ in range(SUBSTITUTIONS):
            velocity = central_difference(z + after_lag(lag * velocity, lag * sample_rate), sample_rate)
        return z + after_lag(lag * (velocity - self.seen(velocity)), lag * sample_rate), velocity

    # ---- Inverse ---------------------------------------------------------------------------------------------------

    def invert(
        self,
        displacement: npt.ArrayLike,
        sample_rate: float,
        *,
        velocity: npt.ArrayLike | None = None,
        voltage_limits: tuple[float, float] | None = None,
        slew_limit: float = UNLIMITED,
        offset: float = 0.0,
        rest: float = math.inf,
        warn: bool = True,
    ) -> FloatArray:
        """Voltage that makes the displacement, V, found by the kernel of the controller.

        The actuator is taken to have rested at the first voltage, as by `predict`, which undoes it: of whole ticks the
        voltage is ahead by the delay. With `dynamics` the voltage makes the strain that the stage needs
        (`control.stage.strain`), up to 2.5 first resonances. `beyond` gives the spans in which the model extrapolates.

        Parameters
        ----------
        displacement : array_like, shape (samples,)
            Desired displacement as the sensor of the record reads it, um.
        sample_rate : float
            Samples per second, Hz.
        velocity : array_like, shape (samples,), optional
            Desired velocity, um/s; by default central differences. With `dynamics` it is that of the strain.
        voltage_limits : tuple[float, float], optional
            By default the range of the record, V.
        slew_limit : float
            Fastest change of the voltage, V/s.
        offset : float
            By how much the sensor's zero is above that of the record, um.
        rest : float
            As of `predict`.
        warn : bool
            False: the caller looks for itself where a limit holds the voltage back.

        Warns
        -----
        LimitWarning
            A limit holds the voltage back, and the prediction is farther from the motion than is tolerable:
            `truestroke.waveform` says where, and has a verdict.
        """
        zero = self.zero + checks.number("offset", offset, "um")
        desired = checks.finite_array("displacement", displacement, "um")
        fs = checks.positive("sample_rate", sample_rate, "Hz")
        limits = self.voltage_range if voltage_limits is None else voltage_limits
        known = self.stage(fs) if desired.size else None
        z_d = desired - zero
        if known is not None:
            z_d, velocity = stage.strain(known, z_d, amplifier=True), None
        rate = central_difference(z_d, fs) if velocity is None else checks.finite_array("velocity", velocity, "um/s")
        volts = self._voltage(self._without_creep(z_d, fs, limits, resting_time(rest)), rate, fs, limits, slew_limit)
        if checks.flag("warn", warn) and reach.at_a_limit(volts, fs, limits, slew_limit):
            predicted = self.forward(volts, fs, offset=offset, rest=rest)
            self._warn_of_limits(reach.Made(volts, desired, predicted, fs, limits, slew_limit))
        return volts

    def _warn_of_limits(self, made: reach.Made) -> None:
        """LimitWarning for the caller of `invert`, where a limit keeps the motion from what is tolerable."""
        held = made.held_back(self)
        if held.worst > reach.tolerable(self, made.desired):
            low, high = made.voltage_limits
            words = f"voltage_limits = {low:.4g} to {high:.4g} V or the slew limit hold the motion back: "
            words += "; ".join(held.warnings) + ". Move it, make it smaller or slower, or give other limits; "
            words += "truestroke.waveform has a verdict on it"
            warnings.warn(words, feasibility.LimitWarning, stacklevel=3)

    def _voltage(
        self, z_d: FloatArray, rate: FloatArray, fs: float, limits: tuple[float, float], slew_limit: float
    ) -> FloatArray:
        """Voltage, V, that makes the strain z_d, um above `zero`, of a rate, um/s."""
        shift = round(self.delay * fs)
        late = self.delay - shift / fs + self.time_constant
        if late:
            z_d = z_d + late * rate  # what the lag needs before it
            rate = central_difference(z_d, fs)
        z_d, rate = self.before_lag(z_d, rate, fs)
        changes = {"voltage_limits": limits, "slew_limit": slew_limit, "smoothing_time": 0.0, "dynamics": None}
        alike = self.settings if self.branches is None else self._settings
        fixed = alike(fs, initial_weights=self.delayed(0.0), **changes)
        volts, rest = np.empty_like(z_d), 0.0
        if z_d.size:
            rest = self._resting(float(z_d[0]), fixed.voltage_limits)
        if self.branches is not None:
            wanted = ahead(z_d, shift, z_d[-1:]), ahead(self.seen(rate), shift, np.zeros(1))
            return inverse.waveform(self, *wanted, rest, fixed.voltage_limits, slew_limit / fs, fs)
        kernel = _kernel.Kernel(kernel_settings(fixed))
        if z_d.size:
            kernel.start(rest, float(self.predict([rest], fs)[0]) - self.zero)
        rate = self.seen(rate)
        kernel.process(ahead(z_d, shift, z_d[-1:]), ahead(rate, shift, np.zeros(1)), None, volts)
        return volts

    def _without_creep(self, z: FloatArray, fs: float, limits: tuple[float, float], rest: float) -> FloatArray:
        """The strain, um above `zero`, whose voltage makes z after a rest of so long, s, not after an endless one."""
        if not self.creep_times or not z.size or rest == math.inf:
            return z
        since = np.maximum(np.arange(z.size) / fs - self.delay, 0.0)  # where the voltage of each strain is
        first = self._resting(float(z[min(round(self.delay * fs), z.size - 1)]), limits, rest)
        to_come = self.weights[self.columns["creep"]] @ creep_to_come(first, self.creep_times, rest, since)
        bend = self.weights[self.columns["asymmetry"]]
        shape = bend @ np.array(asymmetry_terms(z, self.stroke))[: bend.size] if bend.size else 0.0
        still = np.zeros((len(self.creep_times), z.size))
        left = z - shape + to_come - self.weights[self.columns["offset"]].sum()
        return displacement(self, self.weights, left, still, np.zeros_like(z))

    def _resting(self, z: float, limits: tuple[float, float], rest: float = math.inf) -> float:
        """Voltage within the limits under which the actuator is at z, um above `zero`, after a rest of so long, s.

        Or as near as can be.
        """
        from scipy.optimize import brentq

        def over(volts: float) -> float:
            return float(self.forward([volts], 1.0, rest=rest)[0]) - self.zero - z

        if over(limits[0]) >= 0 or over(limits[1]) <= 0:
            return min(limits, key=lambda volts: abs(over(volts)))
        return float(brentq(over, *limits, xtol=1e-14))

    def beyond(self, volts: npt.ArrayLike, sample_rate: float, *, measured: bool | None = None) -> Beyond:
        """Spans in which a voltage is beyond the record of the model, so that the prediction is an extrapolation.

        Parameters
        ----------
        volts : array_like, shape (samples,)
            Voltage, V.
        sample_rate : float
            Samples per second, Hz.
        measured : bool, optional
            As of `predict`.

        Returns
        -------
        Beyond
            Spans above or below `voltage_range`, V; spans where the prediction is faster than `fastest`, um/s; and
            spans where it has motion above `tested_frequency`, um, more than twice the noise of the record.

        Examples
        --------
        >>> model = ActuatorModel(
        ...     thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.eye(3), stroke=20.0,
        ...     voltage_range=(0.0, 2.0), velocity=50.0,
        ... )
        >>> model.beyond([0.0, 1.0, 2.0, 2.5, 2.5], sample_rate=10.0).voltage
        (Span(start=0.3, stop=0.5, worst=0.5),)
        """
        x = self._at_the_actuator(volts, measured)
        low, high = self.voltage_range
        strain, fs = self.strain(x, sample_rate), float(sample_rate)
        speed = np.abs(central_difference(strain, fs))
        above = tested.above(self._moved(strain, fs), fs, self.tested_frequency)
        return Beyond(
            voltage=spans(np.maximum(x - high, low - x), fs),
            velocity=spans(speed - (1 + ROUNDED) * self.fastest, fs),
            frequency=spans(above - tested.SEEN * self.noise, fs, above),
            tested_frequency=self.tested_frequency,
        )

    def replace(self, **changes: Any) -> ActuatorModel:
        """A copy with some members replaced."""
        return dataclasses.replace(self, **changes)


def displacement(
    model: ActuatorModel, w: FloatArray, plays: FloatArray, creep: Sequence[Any] | FloatArray, velocity: FloatArray
) -> FloatArray:
    """Displacement z above `zero`, um, of the sum of the plays, um, the creep states, V, and the velocity, um/s.

    z - asymmetry(z) is the sum of the other terms, natively by Newton's method: each sample until it has converged.
    """
    motion = Motion(np.zeros_like(velocity), velocity)  # at 0 um there is no asymmetry
    weights, asymmetry = w[model.of_plays :], w[model.columns["asymmetry"]]
    known = known_terms(model, creep, motion, model.stroke).reshape(weights.size, velocity.size)
    z = np.empty_like(velocity)
    _kernel.displacement(plays, known, weights, asymmetry, model.stroke, z)
    return z


def resting_time(rest: float) -> float:
    """A time of rest, s; infinity is one."""
    return math.inf if rest == math.inf else checks.within("rest", rest, 0.0, 1e12, "s")


def _sensor_lag(sensor_delay: float | None = None, sensor_bandwidth: float | None = None, **_: Any) -> float:
    """By how much a sensor is late at low frequencies, s, of its settings; the kernel has it apart."""
    return (sensor_delay or 0.0) + (1 / (2 * math.pi * sensor_bandwidth) if sensor_bandwidth else 0.0)
