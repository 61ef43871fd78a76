"""Play, record, refine: adapt a model from the recording of a waveform that was made with it."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.control import actuator
from truestroke.control.actuator import ActuatorModel
from truestroke.control.repeating import passes as law
from truestroke.control.repeating.harmonics import LEAST, SHY
from truestroke.control.settings import UNLIMITED
from truestroke.identification.fitting import normal, uncertainty
from truestroke.identification.fitting.normal import Prior
from truestroke.identification.fitting.regression import ROWS, Data, Structure
from truestroke.identification.records.record import Record, as_record
from truestroke.identification.waveform import Passes, PredictedWaveform, Waveform, described
from truestroke.model.dynamics import EXPECTED as DYNAMICS
from truestroke.model.dynamics import Dynamics
from truestroke.model.sampled import REST, central_difference
from truestroke.signals.channels import Sampled
from truestroke.signals.metrics import rms
from truestroke.signals.quiet import noise_not_followed, without_noise

STEPS = 3  # Gauss-Newton
QUIET = 1e-6  # of the stroke: the least noise, so that weights that a quiet recording does not identify stay
SAME = 0.03  # of the waveform's peak-to-peak, rms: how far the recorded voltage may be from the one that was put out
EARLIER = 0.5  # of what the voltage has changed since an earlier pass, and of its motion: a nearer record is of it
WORSE = 1.05  # times the best pass of the same motion: a pass that is worse is undone
OTHER = 0.5  # of the deviation of the displacement: a record with a larger residual is not of the model's actuator
AGAINST = 0.5  # correlation with what the model predicts, below which with the other sign a sensor has turned its sign
WHOLE = 0.02  # samples: a shift that is nearer to a whole number is one
EXPLAINED = (
    2.0  # times the noise, of the model or of the pass: a refit that leaves more has learned what is no hysteresis
)
REMEMBERED = 5  # passes that the next waveform has with it


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Refined(Sampled):
    """What `refine` found.

    Attributes
    ----------
    model : ActuatorModel
        The refined one; its provenance has a line for each pass.
    sample_rate : float
        Hz.
    volts, measured : ndarray, shape (samples,)
        The recording, V and um; of a waveform, at its ticks.
    residual : ndarray, shape (samples,)
        Measured minus what the refined model predicts, um.
    before, after : float
        Rmse of the old and of the refined model's prediction of what was fitted, um.
    error : ndarray, shape (samples,), or None
        Measured minus desired, um; None where the waveform is not known.
    undone : str
        In a sentence, that this pass was worse than one before, and what became of it; empty where it was not. `model`
        is then the one that was before the last refinement, or, where none is known, the one that made this pass.
    kept : str
        In a sentence, that the weights are those of before, because the refit explained the pass too badly; or empty.
    correction : ndarray, shape (samples,), or None
        By how much the model has to predict more of the next pass than of the best of `passes`, um.
    expected : float or None
        Rmse that the next pass should have, noise included, um.
    passes : tuple of (ndarray, ndarray)
        Voltage, V, and measurement, um, of the last passes of this motion, this one with them.
    best : int
        On which of `passes` the next one builds.
    rest : float
        Time under the first voltage before each pass, s; infinite of a record whose waveform is not known.
    """

    model: ActuatorModel
    sample_rate: float
    volts: FloatArray
    measured: FloatArray
    residual: FloatArray
    before: float
    after: float
    error: FloatArray | None
    undone: str = ""
    kept: str = ""
    correction: FloatArray | None = None
    expected: float | None = None
    passes: Passes = ()
    best: int = 0
    rest: float = math.inf

    def next(
        self, *, voltage_limits: tuple[float, float] | None = None, slew_limit: float = UNLIMITED
    ) -> PredictedWaveform:
        """The waveform of the next pass.

        Parameters
        ----------
        voltage_limits, slew_limit
            As of `ActuatorModel.invert`.

        Raises
        ------
        SettingError
            The waveform of this pass was not given.
        """
        if self.error is None or self.correction is None:
            raise SettingError("waveform", None, "given to refine: the motion is in there")
        desired, rate = self.measured - self.error, self.sample_rate
        limits = self.model.voltage_range if voltage_limits is None else voltage_limits
        before, _ = self.passes[self.best]
        predicted = self.model.forward(before, rate, rest=self.rest)
        asked: dict[str, Any] = {"voltage_limits": limits, "slew_limit": slew_limit, "rest": self.rest}
        here, there = (
            self.model.invert(y, rate, warn=False, **asked) for y in (predicted, predicted + self.correction)
        )
        volts = _slewed(np.clip(before + there - here, *limits), slew_limit / rate)
        short = self.model.forward(volts, rate, rest=self.rest) - predicted - self.correction
        return described(self.model, volts, desired, desired + short, rate, limits, slew_limit, self.passes)

    @property
    def verdict(self) -> Verdict:
        """Bad where the pass was worse than one before."""
        return Verdict("bad", (self.undone,)) if self.undone else Verdict("good")

    @property
    def rmse(self) -> float | None:
        """Of the pass: measured against desired, um."""
        return None if self.error is None else rms(self.error)

    @property
    def maximum(self) -> float | None:
        """Largest magnitude of the same error, um."""
        return None if self.error is None else float(np.abs(self.error).max())


@one_thread
def refine(
    model: ActuatorModel,
    record: Record,
    *,
    waveform: Waveform | None = None,
    dynamics: Dynamics | None = None,
    rest: float = REST,
) -> Refined:
    """The model adapted to a record, its structure kept, and the correction of the next pass.

    Bayesian least squares: the prior is `ActuatorModel.another_day`, all partial slopes stay positive. The
    noise is the residual, with fewer degrees of freedom where it is coloured. Before a waveform the actuator is assumed
    to rest at the first voltage, for as long as `rest` says; of another record the part is skipped in which the plays
    may remember what was before it. Of a waveform the refit is taken where it explains the pass about as well as the
    model explained its own record.

    `next` corrects the pass at each frequency, through the model and the ratio of the true response to the model's that
    the passes show (`passes`); a pass that was worse than the best one is undone.

    Parameters
    ----------
    model : ActuatorModel
        With which the waveform was made, for one.
    record : Record
        Of voltage and displacement. Of several segments the longest is taken.
    waveform : Waveform, optional
        The waveform that was recorded. The record may begin before it and end behind it; the voltage says where.
    dynamics : Dynamics, optional
        Of the stage, as `truestroke bode` measures them: they replace delay, lag and resonances of the model.
    rest : float
        Time under the first voltage before the waveform, s, as of `truestroke.waveform`; without a waveform it does not
        matter.

    Raises
    ------
    SettingError
        The record is too short, does not hold the waveform, is that of a pass before, or is not of the model's
        actuator.

    Examples
    --------
    A stack that is 10 % softer than the model:

    >>> from truestroke.identification import Record, waveform
    >>> model = ActuatorModel(
    ...     thresholds=(0.0,), weights=[10.0, 0.0, 0.0], covariance=np.eye(3), stroke=20.0, voltage_range=(0.0, 2.0)
    ... )
    >>> made = waveform(model, 9.0 - 9.0 * np.cos(np.arange(400) / 20.0), sample_rate=1000.0)
    >>> record = Record.from_arrays(made.volts, 9.0 * made.volts, sample_rate=1000.0)
    >>> found = refine(model, record, waveform=made)
    >>> round(found.rmse, 2), round(found.before, 2), round(found.after, 2), round(float(found.model.weights[0]), 2)
    (1.07, 1.07, 0.0, 9.0)
    """
    checks.instance("model", model, ActuatorModel, actuator.EXPECTED)
    record = as_record(record)
    if waveform is not None:
        checks.instance("waveform", waveform, Waveform, "a waveform, such as of truestroke.load_waveform(path)")
    rows = _longest(record)
    whole = record.volts[rows], record.displacement[rows], record.sample_rate
    x, z, fs = whole if waveform is None else _aligned(record, waveform)
    if waveform is None:  # as `identify` has it; that of a waveform is as it was made
        x = without_noise(x, noise_not_followed(x, z))
    if x.size < 200:
        raise SettingError("record", f"{x.size} samples", "at least 200 samples")
    if dynamics is not None:
        model = _on(checks.instance("dynamics", dynamics, Dynamics, DYNAMICS).at(fs), model)
    rest = math.inf if waveform is None else actuator.resting_time(rest)
    data = _data(model, x, z, fs, rest)
    skip = 0 if waveform is not None else data.settled
    fitted = _fitted(model, data, skip)
    before, residual = (z - of.forward(x, fs, rest=rest) for of in (model, fitted))
    old, new = (rms(error[skip * data.every :]) for error in (before, residual))
    if new > OTHER * (spread := float(np.std(z[skip * data.every :]))):
        value = f"one of which the refined model leaves {new:.3g} um rms"
        bound = f"of the model's actuator, in the same units: it moves by {spread:.3g} um rms"
        if float(np.corrcoef(z, z - before)[0, 1]) < -AGAINST:
            bound += "; it falls as the voltage rises: `flip_displacement` turns its sign"
        raise SettingError("record", value, bound)
    error = None if waveform is None else z - waveform.desired
    fitted = fitted.replace(before=model.replace(before=None))
    signals: dict[str, Any] = {"volts": x, "measured": z, "residual": residual, "error": error}
    found = Refined(model=fitted, sample_rate=fs, before=old, after=new, rest=rest, **signals)
    source = str(getattr(record, "source", ""))
    best = _best(model, waveform)
    if found.rmse is not None and found.rmse > WORSE * best:
        found = _undone(found, model, best, source)
    else:
        if waveform is not None and found.after > EXPLAINED * min(model.noise, _noise(z)) > 0:
            found = _as_before(found, model)
        found = _documented(found, model, source, _motion(waveform, min(best, found.rmse or best)))
    return found if waveform is None else _corrected(found, waveform)


def _on(dynamics: Dynamics, model: ActuatorModel) -> ActuatorModel:
    """The model with these dynamics in place of its own."""
    model._check_resonance(dynamics)
    weights = model.weights.copy()
    for term in ("lag", "inertia"):
        weights[model.columns[term]] = 0.0
    plain = None if model.plain is None else _on(dynamics, model.plain)
    return model.replace(dynamics=dynamics, weights=weights, delay=0.0, time_constant=0.0, plain=plain)


def _as_before(found: Refined, old: ActuatorModel) -> Refined:
    """With the weights that made the pass."""
    text = (
        f"A refit of the weights leaves {found.after:.3g} um of this pass, more than its noise: the weights stay, and "
        "the next pass learns what the model does not explain."
    )
    residual = found.measured - old.forward(found.volts, found.sample_rate, rest=found.rest)
    model = found.model.before
    assert model is not None
    same = model.replace(before=model)
    return dataclasses.replace(found, residual=residual, after=found.before, model=same, kept=text)


def _noise(z: FloatArray) -> float:
    """Standard deviation of what changes from sample to sample, um: by fourth differences."""
    return rms(np.diff(z, 4)) / math.sqrt(70.0)


def _slewed(volts: FloatArray, step: float) -> FloatArray:
    """No faster than `step` a sample: it follows as soon as it can."""
    if np.abs(np.diff(volts)).max() <= step:
        return volts
    made = volts.copy()
    for k in range(1, made.size):
        made[k] = min(max(volts[k], made[k - 1] - step), made[k - 1] + step)
    return made


def _corrected(found: Refined, waveform: Waveform) -> Refined:
    """With the correction of the next pass, which builds on the best of the last passes."""
    made = (*waveform.passes, (waveform.volts, found.measured))
    errors = [rms(z - waveform.desired) for _, z in made]
    best = int(np.argmin(errors))
    best = len(made) - 1 if errors[-1] <= WORSE * errors[best] else best
    worse = sum(1 for error in errors[best + 1 :] if error > WORSE * errors[best])
    predicted = [(found.model.forward(x, found.sample_rate, rest=found.rest), z) for x, z in made]
    known: dict[str, Any] = {"dynamics": found.model.stage(found.sample_rate), "step": max(LEAST, SHY**worse)}
    planned = law.following(predicted, waveform.desired, found.sample_rate, best=best, **known)
    last = sorted({best, *range(max(0, len(made) - REMEMBERED + 1), len(made))})
    return dataclasses.replace(
        found,
        correction=planned.change,
        expected=planned.expected,
        passes=tuple(made[k] for k in last),
        best=last.index(best),
    )


# ---- The fit -------------------------------------------------------------------------------------------------------


def _data(model: ActuatorModel, x: FloatArray, z: FloatArray, fs: float, rest: float) -> Data:
    """As the fit sees it; the range of the voltage grows, stroke and zero stay: they scale the asymmetry."""
    low, high = model.voltage_range
    every = -(-x.size // ROWS)
    return Data(
        volts=x,
        displacement=(z - model.zero)[::every],
        known=np.ones(-(-z.size // every), dtype=np.bool_),
        sample_rate=fs,
        every=every,
        voltage_range=(min(low, float(x.min())), max(high, float(x.max()))),
        stroke=model.stroke,
        zero=model.zero,
        delay=model.delay,
        time_constant=model.time_constant,
        dynamics=model.stage(fs),
        duration=x.size / fs,
        rest=rest,
    )


def _fitted(model: ActuatorModel, data: Data, skip: int) -> ActuatorModel:
    """Gauss-Newton on the prediction error of the rows behind the first `skip`, from the old weights."""
    fs, measured = data.sample_rate, data.displacement[skip:]
    branches = None if model.branches is None else dataclasses.replace(model.branches, weights=())
    s = Structure(**model.terms, rested=True, branches=branches)
    prior = _prior(model, s, data)
    before = model.strain(data.volts, fs, rest=data.rest)
    velocity = max(model.velocity, float(np.abs(central_difference(before, fs)).max()))
    c = prior.mean
    for _ in range(STEPS):
        z_m = data.model(s, c, velocity).strain(data.volts, fs, rest=data.rest)
        rows, kept = data.columns(s, z_m)[skip:], data.through(z_m)[:: data.every][skip:]
        J = rows[:, :-1] / data.slope(s, kept, c)[:, None]
        residual = measured - kept
        weight = max(uncertainty.white_variance(residual), (QUIET * model.stroke) ** 2)
        shown = normal.reduced(np.column_stack([J, residual + J @ c]))
        c = normal.solve(prior.rows(weight), *data.constraints(s, velocity), above=shown)
    made = data.model(s, c, velocity)
    residual = measured - data.through(made.strain(data.volts, fs, rest=data.rest))[:: data.every][skip:]
    F = uncertainty.covariance_root(J, shown[:-1, :-1], residual, prior, weight)[: s.parameters]
    times = {"delay": model.delay, "time_constant": model.time_constant, "dynamics": model.dynamics}
    plain = None if model.plain is None else _fitted(model.plain, data, skip)
    return made.replace(covariance=F @ F.T, noise=rms(residual), plain=plain, **times)


def _prior(model: ActuatorModel, s: Structure, data: Data) -> Prior:
    """The old weights in the scale of `data`, as sure as on another day; the offset is where the record begins.

    Those of the branches may be off by `DRIFT` of what was expected of them.
    """
    rates = np.ones(s.parameters)
    rates[s.b] = model.rate_scale / data.rate_scale
    mean, P = model.weights * rates, model.another_day() * np.outer(rates, rates)
    offset = s.columns["offset"]
    P[offset], P[:, offset] = 0.0, 0.0
    P[offset, offset] = data.stroke**2
    if model.branches is None:
        return Prior(mean, P)
    covariance = actuator.DRIFT**2 * data.prior(s).covariance
    covariance[: s.parameters, : s.parameters] = P
    return Prior(np.append(mean, model.branches.weights), covariance)


def _motion(waveform: Waveform | None, best: float) -> dict[str, float]:
    """Values by which the next pass is recognised as one of the same motion, and the error of the best pass."""
    if waveform is None:
        return {}
    return {"samples": float(waveform.desired.size), "spread_um": float(np.std(waveform.desired)), "best_pass_um": best}


def _best(model: ActuatorModel, waveform: Waveform | None) -> float:
    """Rmse of the best pass of the same motion so far, um; infinite where there was none."""
    known = model.metrics.get("best_pass_um")
    same = _motion(waveform, 0.0)
    if known is None or not same or model.metrics["samples"] != same["samples"]:
        return np.inf
    return known if np.isclose(model.metrics["spread_um"], same["spread_um"], rtol=1e-3) else np.inf


def _undone(found: Refined, old: ActuatorModel, best: float, source: str) -> Refined:
    """What was before: the model from which the one that made this pass was refined; if that is not known, that one."""
    kept = old if old.before is None else old.before
    what = "the refinement of this pass is not taken" if old.before is None else "the model is that before the last one"
    text = f"This pass was worse, {found.rmse:.4g} um rmse where the best one had {best:.4g}: it is undone, {what}."
    number = 1 + sum(key.startswith("pass_") for key in old.provenance)
    provenance = {**old.provenance, f"pass_{number}": f"{source}: {text}"}
    metrics = {name: old.metrics[name] for name in ("samples", "spread_um", "best_pass_um")}
    model = kept.replace(before=None, metrics={**kept.metrics, **metrics}, provenance=provenance)
    residual = found.measured - kept.forward(found.volts, found.sample_rate, rest=found.rest)
    return dataclasses.replace(found, model=model, residual=residual, after=rms(residual), undone=text)


def _documented(found: Refined, old: ActuatorModel, source: str, motion: dict[str, float]) -> Refined:
    """The same, with this pass in the provenance of the model, behind those before."""
    number = 1 + sum(key.startswith("pass_") for key in old.provenance)
    words = "" if found.error is None else f"error {found.rmse:.4g} um rmse, {found.maximum:.4g} um at the most; "
    words += f"prediction {found.before:.4g} um rmse before, {found.after:.4g} um after"
    provenance = {**old.provenance, f"pass_{number}": f"{source}: {words}"}
    if "held_out_rmse_um" in old.metrics:  # which is not of this model
        provenance["held_out"] = f"rmse {old.metrics['held_out_rmse_um']:.4g} um, before the first pass"
    metrics = {"prediction_rmse_before_um": found.before, "prediction_rmse_um": found.after, **motion}
    if found.rmse is not None and found.maximum is not None:
        metrics |= {"pass_rmse_um": found.rmse, "pass_maximum_um": found.maximum}
    return dataclasses.replace(found, model=found.model.replace(metrics=metrics, provenance=provenance))


# ---- The record ----------------------------------------------------------------------------------------------------


def _longest(record: Record) -> slice:
    """Rows of the longest segment without a gap."""
    return max(record.segments, key=lambda s: s.stop - s.start, default=slice(0, record.volts.size))


def _aligned(record: Record, waveform: Waveform) -> tuple[FloatArray, FloatArray, float]:
    """Voltage and displacement of the record at the ticks of the waveform, found by its voltage."""
    from scipy.signal import correlate

    fs, wanted, rows = waveform.sample_rate, waveform.volts, _longest(record)
    time, volts, displacement = record.time[rows], record.volts[rows], record.displacement[rows]
    start, stop = time[0], time[-1]
    grid = start + np.arange(int((stop - start) * fs * (1 + 1e-9)) + 1) / fs
    spare = grid.size - wanted.size
    if spare < 0:
        bound = f"at least as long as the waveform, {wanted.size / fs:g} s: record until it has ended"
        raise SettingError("record", f"{grid.size / fs:g} s", bound)
    x = np.interp(grid, time, volts)
    squares = np.concatenate([[0.0], np.cumsum(x**2)])
    apart = squares[wanted.size :] - squares[: spare + 1] + np.sum(wanted**2)
    apart -= 2 * correlate(x, wanted, mode="valid")
    shift = float(np.argmin(apart))
    k = int(shift)
    if 0 < k < spare:  # between samples, where the clocks differ: the vertex of a parabola
        bend = apart[k - 1] - 2 * apart[k] + apart[k + 1]
        part = 0.5 * (apart[k - 1] - apart[k + 1]) / bend if bend > 0 else 0.0
        shift += part if abs(part) > WHOLE else 0.0
    at = np.clip(start + (shift + np.arange(wanted.size)) / fs, start, stop)
    x, z = np.interp(at, time, volts), np.interp(at, time, displacement)
    off = rms(x - wanted)
    if off > SAME * np.ptp(wanted):
        value = f"a voltage that differs from the waveform's by {off:.3g} V rms"
        bound = f"within {SAME * np.ptp(wanted):.3g} V of it: is it the recording of this waveform, in the same volts, "
        raise SettingError("record", value, bound + "at the sample rate at which it was put out?" + _scaled(x, wanted))
    _refuse_earlier(x, z, waveform)
    return x, z, fs


def _scaled(x: FloatArray, wanted: FloatArray) -> str:
    """A remedy, where a voltage is a multiple of the one that was put out, as behind an amplifier; else ""."""
    times = float(x @ wanted / (wanted @ wanted))
    if times <= 0.0 or rms(x - times * wanted) > SAME * times * np.ptp(wanted):
        return ""
    remedy = f"behind an amplifier or a monitor the record needs `volts_scale` {1 / times:.4g}"
    return f" It is {times:.4g} times the waveform's: {remedy}"


def _refuse_earlier(x: FloatArray, z: FloatArray, waveform: Waveform) -> None:
    """SettingError where the record is that of a pass before: its correction would be made twice."""
    slope = float(np.std(z) / np.std(x))
    for number, (volts, measured) in enumerate(waveform.passes, 1):
        changed = rms(waveform.volts - volts)
        if rms(x - volts) < EARLIER * rms(x - waveform.volts) and rms(z - measured) < EARLIER * slope * changed:
            value = f"the voltage and displacement of pass {number}, which the waveform has with it"
            raise SettingError("record", value, "those of the waveform itself: output it, and record again")
