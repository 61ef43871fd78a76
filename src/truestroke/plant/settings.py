"""Settings of the simulated actuators: one number a member, with its unit; docs/plant.md gives the source of each."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from truestroke._plant import (
    MATCHED_MAX_DEAD_ZONES,
    MATCHED_MAX_PLAYS,
    MAX_CREEP_OPERATORS,
    MAX_PLAYS,
    STAGE_MAX_CREEP_OPERATORS,
    STAGE_MAX_DELAY,
    STAGE_MAX_MODES,
    STAGE_MAX_PLAYS,
    STAGE_MAX_STEPS,
)
from truestroke.base import checks, declared
from truestroke.base.checks import SettingError
from truestroke.base.declared import FLAG, Bound, Setting, Times, ascending, between, bound, whole, word
from truestroke.model.dynamics import Dynamics, Mode

NEVER = 2**64 - 1  # a tick: TS_NEVER of the kernel

EFFECTS: Mapping[str, Mapping[str, object]] = MappingProxyType(
    {
        "da_quantisation": {"da_step": 0.0},
        "da_limits": {"da_limits": None},
        "lag": {"amplifier_bandwidth": 0.0},
        "stack_limits": {"stack_limits": None},
        "hysteresis": {"hysteresis": 0.0},
        "asymmetry": {"asymmetry": 0.0},
        "creep": {"creep": 0.0},
        "resonance": {"resonance": 0.0},
        "drift": {"drift": 0.0},
        "noise": {"noise": 0.0},
        "ad_quantisation": {"ad_step": 0.0},
        "ad_limits": {"ad_limits": None},
        "averaging": {"samples_per_tick": 1},
        "change": {"change": None},
        "ageing": {"ageing_gain": 0.0, "ageing_hysteresis": 0.0},
    }
)
"""The effects of the realistic plant by name, in the order of its chain, and what switches each of them off."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """A sudden change of the actuator (Sec. 4.2), from the first tick that begins at `time` or later.

    Attributes
    ----------
    time : float
        When it happens, s.
    gain : float
        Factor on the sensitivity, without unit.
    hysteresis : float
        Factor on the hysteretic part: on the loop width at the same sensitivity (realistic plant), on the weights of
        all plays but the first (matched plant).

    Examples
    --------
    >>> Change(time=2.5, gain=0.8).tick(2000.0)
    5000
    """

    time: float
    gain: float = 1.0
    hysteresis: float = 1.0

    def __post_init__(self) -> None:
        checks.within("change.time", self.time, 0.0, 1e9, "s")
        checks.within("change.gain", self.gain, 0.01, 100.0)
        checks.within("change.hysteresis", self.hysteresis, 0.0, 100.0)

    def tick(self, sample_rate: float) -> int:
        """The first tick of the changed actuator; `sample_rate` in Hz."""
        return first_tick(self.time, sample_rate)


def first_tick(time: float, sample_rate: float) -> int:
    """The first tick that begins at `time` (s) or later; `sample_rate` in Hz.

    >>> first_tick(0.0123, 2000.0)
    25
    """
    return math.ceil(time * sample_rate * (1 - 1e-12))


@bound("above 0")
def _rate(_: Any, name: str, value: Any, unit: str) -> float:
    return checks.positive(name, value, unit)


@bound("a multiple of samples_per_tick, up to 100000")
def _steps(s: PlantSettings, name: str, value: Any, unit: str) -> int:
    steps = checks.count(name, value, s.samples_per_tick, 100_000)
    if steps % s.samples_per_tick:
        raise SettingError(name, steps, f"a multiple of samples_per_tick, {s.samples_per_tick}")
    return steps


@bound("low < high, or None")
def _limits(_: Any, name: str, value: Any, unit: str) -> tuple[float, float] | None:
    return None if value is None else checks.interval(name, value, unit)


@bound("0 < low < high")
def _span(_: Any, name: str, value: Any, unit: str) -> tuple[float, float]:
    low, high = checks.interval(name, value, unit)
    return checks.positive(f"{name}[0]", low, unit), high


@bound("a Change, or None")
def _change(s: PlantSettings | MatchedSettings, name: str, value: Any, unit: str) -> Change | None:
    change = None if value is None else checks.instance(name, value, Change, "a Change, or None")
    if change and isinstance(s, PlantSettings):
        checks.within("hysteresis * change.hysteresis", s.hysteresis * change.hysteresis, 0.0, 0.95)
    return change


def _unlimited(limits: tuple[float, float] | None, _: PlantSettings) -> tuple[float, float]:
    return limits or (-math.inf, math.inf)


def _changes(change: Change | None, s: PlantSettings) -> tuple[float, ...]:
    return (change.tick(s.sample_rate), change.gain, change.hysteresis) if change else (NEVER, 1.0, 1.0)


# fmt: off
PLANT_SETTINGS: declared.Table = {
    "sample_rate": Setting("Ticks per second", "Hz", _rate),
    "samples_per_tick": Setting(
        "Samples of the displacement that one measurement averages; 1 takes the sample at the end of the tick", "",
        whole(1, 1000),
    ),
    "steps_per_tick": Setting("Steps of the integration", "", _steps),
    "da_step": Setting("Step of the D/A converter", "V", between(0, 10)),
    "da_limits": Setting("Range of the D/A converter", "V", _limits, kernel="da_low da_high", convert=_unlimited),
    "amplifier_gain": Setting("Stack voltage over D/A voltage", "V/V", between(1e-3, 1e6)),
    "amplifier_bandwidth": Setting("Corner of the amplifier's first-order lag; 0 is no lag", "Hz", between(0, 1e9)),
    "stack_limits": Setting("Range at the stack", "V", _limits, kernel="stack_low stack_high", convert=_unlimited),
    "sensitivity": Setting(
        "S: slope of the chord of the major loop over 0 to twice `threshold_max`, at the stack", "um/V",
        between(1e-6, 1e6),
    ),
    "hysteresis": Setting("h: part of S that comes from the play operators", "", between(0, 0.95)),
    "plays": Setting("Number of play operators", "", whole(1, MAX_PLAYS)),
    "threshold_scale": Setting("rho of the density exp(-r / rho), 0 < r < R, of their thresholds, at the stack", "V",
                               between(1e-3, 1e6)),
    "threshold_max": Setting("R of it, at the stack", "V", between(1e-3, 1e6)),
    "threshold_exponent": Setting(
        "e: thresholds are at the quantiles q^e of that density; above 1 they are dense at 0, below 1 sparse", "",
        between(0.1, 10),
    ),
    "asymmetry": Setting(
        "alpha: z = y (1 + alpha (y / Y - 1)); below 0 the actuator softens with the stroke", "", between(-0.3, 0.3)
    ),
    "asymmetry_stroke": Setting("Y: displacement that the asymmetry does not change", "um", between(1e-3, 1e6)),
    "creep": Setting("gamma: creep per decade of time over the displacement", "", between(0, 0.2)),
    "creep_operators": Setting("Number of first-order operators", "", whole(1, MAX_CREEP_OPERATORS)),
    "creep_span": Setting("Span in which creep is logarithmic", "s", _span, kernel="creep_shortest creep_longest"),
    "resonance": Setting("First resonance of the stage under load; 0 is a massless stage", "Hz", between(0, 1e9)),
    "damping": Setting("Its damping ratio zeta", "", between(0, 0.99)),
    "drift": Setting("A: thermal expansion when warm", "um", between(-1e3, 1e3)),
    "drift_time": Setting("Time constant of warming up", "s", between(1e-3, 1e9)),
    "noise": Setting("Standard deviation of one sample of the sensor", "um", between(0, 1e3)),
    "ad_step": Setting("Step of the A/D converter", "um", between(0, 1e3)),
    "ad_limits": Setting("Range of the A/D converter", "um", _limits, kernel="ad_low ad_high", convert=_unlimited),
    "change": Setting("A sudden change (Sec. 4.2)", "", _change, kernel="change_tick change_gain change_hysteresis",
                      convert=_changes),
    "ageing_gain": Setting("Relative change of the sensitivity per hour, linear in time", "1/h", between(-1, 1)),
    "ageing_hysteresis": Setting("The same of the hysteretic part", "1/h", between(-1, 1)),
}
# fmt: on


@declared.documented(PLANT_SETTINGS)
@dataclass(frozen=True, kw_only=True)
class PlantSettings:
    """A driven piezo stage, in the order of its chain. A number at 0, or limits at None, switch their effect off.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> PlantSettings().without("noise", "drift").noise
    0.0
    >>> PlantSettings(damping=1.5)
    Traceback (most recent call last):
        ...
    truestroke.SettingError: damping = 1.5: must be from 0 to 0.99
    """

    sample_rate: float = 2000.0
    samples_per_tick: int = 5
    steps_per_tick: int = 10
    da_step: float = 20.0 / 2**16
    da_limits: tuple[float, float] | None = (-10.0, 10.0)
    amplifier_gain: float = 100.0 / 3.0
    amplifier_bandwidth: float = 500.0
    stack_limits: tuple[float, float] | None = (-20.0, 120.0)
    sensitivity: float = 0.3771
    hysteresis: float = 0.332
    plays: int = 60
    threshold_scale: float = 30.0
    threshold_max: float = 60.0
    threshold_exponent: float = 1.0
    asymmetry: float = -0.056
    asymmetry_stroke: float = 45.0
    creep: float = 0.015
    creep_operators: int = 16
    creep_span: tuple[float, float] = (1e-2, 1e3)
    resonance: float = 900.0
    damping: float = 0.03
    drift: float = 0.2
    drift_time: float = 600.0
    noise: float = 0.030
    ad_step: float = 100.0 / 2**16
    ad_limits: tuple[float, float] | None = (-25.0, 75.0)
    change: Change | None = None
    ageing_gain: float = 0.0
    ageing_hysteresis: float = 0.0

    def __post_init__(self) -> None:
        declared.complete(self, PLANT_SETTINGS)
        if self.change is not None and self.change.gain == self.change.hysteresis == 1.0:
            raise SettingError(
                "change", f"one at {self.change.time:g} s of nothing", "one of gain or hysteresis, such as gain = 0.8"
            )

    @property
    def input_sensitivity(self) -> float:
        """Slope of the chord of the major loop, um per volt at the D/A converter."""
        return self.amplifier_gain * self.sensitivity

    def without(self, *effects: str) -> PlantSettings:
        """A copy with these effects, named as in `EFFECTS`, switched off; ``without(*EFFECTS)`` is a straight line.

        Raises
        ------
        SettingError
            There is no effect of that name.
        """
        off: dict[str, Any] = {}
        for name in effects:
            if name not in EFFECTS:
                raise SettingError("effects", repr(name), f"one of {', '.join(EFFECTS)}")
            off |= EFFECTS[name]
        return dataclasses.replace(self, **off)


def _one_for_each(of: str) -> Bound:
    @bound(f"as many numbers as {of}")
    def check(s: MatchedSettings, name: str, value: Any, unit: str) -> tuple[float, ...]:
        size = len(getattr(s, of))
        values = tuple(checks.number(name, entry, unit) for entry in checks.several(name, value, unit))
        if len(values) != size:
            raise SettingError(name, values, f"{size} numbers, one for each threshold", unit)
        return values

    return check


@bound("[0, 1], 0 without a change")
def _spread(s: MatchedSettings, name: str, value: Any, unit: str) -> float:
    spread = checks.within(name, value, 0.0, 1.0)
    if spread and s.change is None:
        raise SettingError(name, value, "0 where no change is scheduled")
    return spread


# fmt: off
MATCHED_SETTINGS: declared.Table = {
    "sample_rate": Setting("Ticks per second", "Hz", _rate, kernel=""),
    "thresholds": Setting(
        "r of the plays, at the D/A converter", "V", ascending(MATCHED_MAX_PLAYS), kernel="thresholds plays",
        convert=lambda r, _: (r, len(r)),
    ),
    "a": Setting(
        "a_p: weights of the plays are a_i + rate_scale zdot_d b_i (7)", "um/V", _one_for_each("thresholds"), kernel=""
    ),
    "b": Setting("b_p", "um/V", _one_for_each("thresholds"), kernel=""),
    "rate_scale": Setting("c_b", "s/um", between(0, 1e6)),
    "dead_zone_thresholds": Setting(
        "d of the forward dead zones (4)", "um", ascending(MATCHED_MAX_DEAD_ZONES),
        kernel="dead_zone_thresholds dead_zones", convert=lambda d, _: (d, len(d)),
    ),
    "dead_zone_weights": Setting(
        "w_s of the forward dead zones (5); (1,) is a symmetric actuator", "", _one_for_each("dead_zone_thresholds")
    ),
    "noise": Setting("Standard deviation of one measurement", "um", between(0, 1e3)),
    "change": Setting(
        "A sudden change (Sec. 4.2)", "", _change, kernel="change_tick", convert=lambda c, s: _changes(c, s)[0],
    ),
    "weight_spread": Setting(
        "At the change each weight is also multiplied by a factor sampled uniformly from 1 - spread to 1 + spread", "",
        _spread, kernel="",
    ),
}
# fmt: on


@declared.documented(MATCHED_SETTINGS)
@dataclass(frozen=True, kw_only=True)
class MatchedSettings:
    """The paper's plant (13), of exactly the controller's structure; defaults are the published P-885.90 (Sec. 4.3).

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.
    """

    sample_rate: float = 2000.0
    thresholds: tuple[float, ...] = tuple(i / 8 * 1.5 for i in range(8))
    a: tuple[float, ...] = (8.4, 1.3, 0.92, 0.7, 0.88, 0.74, -2.6, 2.23)
    b: tuple[float, ...] = (-0.9, 1.03, -0.244, 0.1, 0.05, -0.02, 0.01, -0.01)
    rate_scale: float = 0.007
    dead_zone_thresholds: tuple[float, ...] = (0.0,)
    dead_zone_weights: tuple[float, ...] = (1.0,)
    noise: float = 0.05
    change: Change | None = None
    weight_spread: float = 0.0

    def __post_init__(self) -> None:
        declared.complete(self, MATCHED_SETTINGS)


# ---- The stage for fast motion -------------------------------------------------------------------------------------

HYSTERESES = ("plays", "preisach", "bouc-wen")  # in the order of the kernel's numbers


@bound(f"a multiple of 2 samples_per_tick, up to {STAGE_MAX_STEPS}")
def _stage_steps(s: StageSettings, name: str, value: Any, unit: str) -> int:
    steps = checks.count(name, value, 2 * s.samples_per_tick, STAGE_MAX_STEPS)
    if steps % (2 * s.samples_per_tick):
        raise SettingError(name, steps, f"a multiple of 2 * samples_per_tick, {2 * s.samples_per_tick}")
    return steps


@bound("low <= 0 < high")
def _around_zero(_: Any, name: str, value: Any, unit: str) -> tuple[float, float]:
    low, high = checks.interval(name, value, unit)
    if low > 0 or high <= 0:
        raise SettingError(name, value, "low <= 0 < high: the stage rests at 0 V", unit)
    return low, high


@bound(f"[0, {STAGE_MAX_DELAY}] ticks")
def _delay(s: StageSettings, name: str, value: Any, unit: str) -> float:
    return checks.within(name, value, 0.0, STAGE_MAX_DELAY / s.sample_rate, unit)


@bound(f"1 to {STAGE_MAX_MODES} numbers above 0 that ascend")
def _resonances(_: Any, name: str, value: Any, unit: str) -> tuple[float, ...]:
    values = tuple(checks.within(name, entry, 1e-3, 1e9, unit) for entry in checks.several(name, value, unit))
    checks.count(f"the number of {name}", len(values), 1, STAGE_MAX_MODES)
    if list(values) != sorted(set(values)):
        raise SettingError(name, values, "numbers that ascend", unit)
    return values


def _of_modes(s: StageSettings, name: str, value: Any, low: float, high: float) -> tuple[float, ...]:
    values = tuple(checks.within(name, entry, low, high) for entry in checks.several(name, value))
    if len(values) != len(s.resonances):
        raise SettingError(name, values, f"{len(s.resonances)} numbers, one for each of resonances")
    return values


@bound("one number in [0, 0.99] for each of resonances")
def _dampings(s: StageSettings, name: str, value: Any, _: str) -> tuple[float, ...]:
    return _of_modes(s, name, value, 0.0, 0.99)


@bound("one number in [-10, 10] for each of resonances, 1 in sum")
def _shares(s: StageSettings, name: str, value: Any, _: str) -> tuple[float, ...]:
    values = _of_modes(s, name, value, -10.0, 10.0)
    if abs(sum(values) - 1) > 1e-9:
        raise SettingError(name, values, "1 in sum")
    return values


def _tick(time: float, s: StageSettings) -> int:
    return first_tick(time, s.sample_rate)


# fmt: off
STAGE_SETTINGS: declared.Table = {
    "sample_rate": Setting("Ticks per second", "Hz", _rate),
    "samples_per_tick": Setting(
        "Samples of the displacement that one measurement averages, in the middle of equal parts of the tick", "",
        whole(1, STAGE_MAX_STEPS // 2),
    ),
    "steps_per_tick": Setting("Steps of the integration", "", _stage_steps),
    "voltage_limits": Setting("Range of the D/A converter", "V", _around_zero, kernel="volts_low volts_high"),
    "dead_time": Setting("From the D/A converter to the amplifier", "s", _delay),
    "amplifier_bandwidth": Setting("Corner of the amplifier's first-order lag; 0 is no lag", "Hz", between(0, 1e9)),
    "stroke": Setting("Height of the loop from 0 V to the upper voltage and back", "um", between(1e-3, 1e6)),
    "hysteresis_kind": Setting("Structure of the hysteresis", "", word(*HYSTERESES), kernel="hysteresis",
                               convert=lambda kind, _: HYSTERESES.index(kind)),
    "loop_width": Setting(
        "Greatest distance of the two branches of that loop over its height; 0 is no hysteresis", "", between(0, 0.5)
    ),
    "plays": Setting('"plays": their number', "", whole(1, STAGE_MAX_PLAYS)),
    "threshold_max": Setting('"plays": R, over the upper voltage', "", between(0.05, 1)),
    "threshold_exponent": Setting('"plays": e of the thresholds R ((i + 1/2) / plays)^e', "", between(0.1, 10)),
    "envelope": Setting('"plays": a; rising plays follow x - a x^2, falling ones x + a x^2', "", between(0, 0.4)),
    "preisach_scale": Setting(
        '"preisach": rho of the density exp(-(up - down) / rho) (1 + k1 s + k2 s^2), s = (up + down) / 2 - 1/2', "",
        between(0.05, 10),
    ),
    "preisach_tilt": Setting('"preisach": k1', "", between(-0.6, 0.6)),
    "preisach_curvature": Setting('"preisach": k2', "", between(0, 10)),
    "bouc_wen_beta": Setting('"bouc-wen": beta of q\' = x\' - beta |x\'| q |q|^(n-1) - gamma x\' |q|^n', "",
                             between(0.5, 20)),
    "bouc_wen_gamma": Setting(
        '"bouc-wen": gamma; beyond beta q would not be bounded', "",
        between(Times(-1, "bouc_wen_beta"), Times(1, "bouc_wen_beta")),
    ),
    "bouc_wen_exponent": Setting('"bouc-wen": n', "", between(1, 3)),
    "creep": Setting("gamma: creep per decade of time over the displacement", "", between(0, 0.2)),
    "creep_operators": Setting("Number of first-order operators", "", whole(1, STAGE_MAX_CREEP_OPERATORS)),
    "creep_span": Setting("Span in which creep is logarithmic", "s", _span, kernel="creep_shortest creep_longest"),
    "resonances": Setting("Undamped natural frequencies of the modes", "Hz", _resonances, kernel="resonances modes",
                          convert=lambda f, _: (f, len(f))),
    "dampings": Setting("Their damping ratios zeta", "", _dampings),
    "shares": Setting("Their parts of the static displacement", "", _shares),
    "resonance_change": Setting("Factor on all resonances from `resonance_change_time` on", "", between(0.5, 2)),
    "resonance_change_time": Setting("When it happens", "s", between(0, 1e9), kernel="resonance_change_tick",
                                     convert=_tick),
    "resonance_drift": Setting("Relative change of all resonances per minute, linear in time", "1/min",
                               between(-0.2, 0.2)),
    "load": Setting("Static displacement of a load; the amplitude where it has a frequency", "um", between(-1e3, 1e3)),
    "load_frequency": Setting("Of a load that is a sine; 0 is a step", "Hz", between(0, 1e6)),
    "load_time": Setting("When it begins", "s", between(0, 1e9), kernel="load_tick", convert=_tick),
    "load_on_stage": Setting("Whether it is a force that the modes answer, or a displacement behind them", "", FLAG),
    "hum": Setting("Amplitude of a sine on the true displacement", "um", between(0, 1e3)),
    "hum_frequency": Setting("Its frequency", "Hz", between(0, 1e6)),
    "sensor_bandwidth": Setting("Corner of the sensor's first-order lag; 0 is no lag", "Hz", between(0, 1e9)),
    "sensor_delay": Setting("From the displacement to its sample", "s", _delay),
    "noise": Setting("Standard deviation of one sample of the sensor", "um", between(0, 1e3)),
}
# fmt: on


@declared.documented(STAGE_SETTINGS)
@dataclass(frozen=True, kw_only=True)
class StageSettings:
    """A stage for fast motion: hysteresis of three structures, up to three modes, dead time, loads, hum, a slow sensor.

    Raises
    ------
    SettingError
        Names the setting, its value, the bound and the unit.

    Examples
    --------
    >>> StageSettings(resonances=(700.0, 2100.0), dampings=(0.02, 0.01), shares=(0.9, 0.2))
    Traceback (most recent call last):
        ...
    truestroke.SettingError: shares = (0.9, 0.2): must be 1 in sum
    """

    sample_rate: float = 10_000.0
    samples_per_tick: int = 5
    steps_per_tick: int = 10
    voltage_limits: tuple[float, float] = (-0.6, 3.6)
    dead_time: float = 0.0
    amplifier_bandwidth: float = 3000.0
    stroke: float = 30.0
    hysteresis_kind: str = "plays"
    loop_width: float = 0.13
    plays: int = 40
    threshold_max: float = 0.5
    threshold_exponent: float = 1.0
    envelope: float = 0.1
    preisach_scale: float = 0.5
    preisach_tilt: float = 0.4
    preisach_curvature: float = 1.0
    bouc_wen_beta: float = 4.0
    bouc_wen_gamma: float = 1.0
    bouc_wen_exponent: float = 1.0
    creep: float = 0.015
    creep_operators: int = 6
    creep_span: tuple[float, float] = (1e-2, 1e2)
    resonances: tuple[float, ...] = (700.0,)
    dampings: tuple[float, ...] = (0.02,)
    shares: tuple[float, ...] = (1.0,)
    resonance_change: float = 1.0
    resonance_change_time: float = 0.0
    resonance_drift: float = 0.0
    load: float = 0.0
    load_frequency: float = 0.0
    load_time: float = 0.0
    load_on_stage: bool = True
    hum: float = 0.0
    hum_frequency: float = 50.0
    sensor_bandwidth: float = 0.0
    sensor_delay: float = 0.0
    noise: float = 0.030

    def __post_init__(self) -> None:
        declared.complete(self, STAGE_SETTINGS)

    @property
    def input_sensitivity(self) -> float:
        """Slope of the chord of the loop, um per volt at the D/A converter."""
        return self.stroke / self.voltage_limits[1]

    def dynamics(self) -> Dynamics:
        """What is linear in it, as it is before its resonances change or drift.

        Raises
        ------
        SettingError
            A `Dynamics` cannot be like that: a resonance beyond 0.45 of the sample rate, a damping of 0, or modes
            without a stable inverse.

        Examples
        --------
        >>> StageSettings(resonances=(700.0,), dampings=(0.02,), dead_time=5e-5).dynamics().modes
        (Mode(frequency=700.0, damping=0.02, share=1.0),)
        """
        modes = zip(self.resonances, self.dampings, self.shares, strict=True)
        return Dynamics(
            sample_rate=self.sample_rate,
            modes=tuple(Mode(frequency=f, damping=zeta, share=share) for f, zeta, share in modes),
            amplifier_bandwidth=self.amplifier_bandwidth,
            dead_time=self.dead_time,
            sensor_delay=self.sensor_delay,
            sensor_bandwidth=self.sensor_bandwidth,
        )
