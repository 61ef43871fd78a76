"""From a record to a model: its structure, its weights, and how well it is known."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from truestroke.base import checks, display, notebook
from truestroke.base.checks import SettingError
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.control import interval
from truestroke.control.actuator import ActuatorModel, central_difference
from truestroke.identification import coverage, modes, normal, uncertainty, validation, zeros
from truestroke.identification.examine import Findings, examine
from truestroke.identification.modes import ModeSearch
from truestroke.identification.record import Record, as_record
from truestroke.identification.regression import ROWS, Data, Structure
from truestroke.identification.response import Response, find_response
from truestroke.identification.rest import from_step
from truestroke.identification.select import Tried, choose, choose_branches, coarse_delay, first_prediction, with_this
from truestroke.identification.series import Series, series
from truestroke.identification.validation import Evidence
from truestroke.model.dynamics import Dynamics
from truestroke.signals.recording import Recording

CHOICE_ROWS = 15_000  # at most where structures are compared, as `ROWS`
SEARCH_ROWS = 8_000  # at most where modes are looked for
NEAR = 0.25  # of the stroke
FEWEST = 20  # samples in each part
STEPS = 2  # Gauss-Newton
RESONATES = 0.9  # of the rmse of cross-validation: modes of the stage must lower it so far
BRANCHES_GAIN = 0.9  # of the residual without branches: with them it must be below
SEARCHES = 8  # for modes at most, each behind a model that was fitted with those of the one before


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model, its residual in the rows of `Data.fitted`, um, and the drift of the record's zero."""

    model: ActuatorModel
    structure: Structure
    weight: float  # um^2, of the prior
    residual: FloatArray
    drift: Callable[[int], FloatArray]  # um, of so many samples of the record
    strain: FloatArray  # um, what the model gives before dead time, lag and stage, at the full rate


@dataclass(frozen=True)
class HeldOut:
    """Errors of a model that predicts, from voltage alone, the last part of a record, unused for any choice.

    Attributes
    ----------
    rmse_um, maximum_um : float
        Root mean square and largest magnitude of the error, um.
    rmse_percent, maximum_percent : float
        The same in % of the peak-to-peak displacement of the record.
    samples : int
        Length of that part.
    coverage : float
        Share of them within the 95 % interval (`Trace.half_width`), 0 to 1.
    zero_um : float
        By how much the zero behind a long gap is above that before it, um; it is taken off the errors.
    """

    rmse_um: float
    maximum_um: float
    rmse_percent: float
    maximum_percent: float
    samples: int
    coverage: float
    zero_um: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Series):
    """The record as it was fitted beside what the model that was fitted to its first part predicts.

    Attributes
    ----------
    predicted : ndarray, shape (samples,)
        Displacement predicted from the voltage alone, um.
    half_width : ndarray, shape (samples,)
        Of the 95 % interval about it, um, as `ActuatorModel.interval` has it; the drift is in `predicted`.
    held_out : ndarray of bool, shape (samples,)
        The last part, not used for that model; the errors of `HeldOut` are those of its known samples.
    """

    predicted: FloatArray
    half_width: FloatArray
    held_out: npt.NDArray[np.bool_]

    @property
    def residual(self) -> FloatArray:
        """displacement - predicted, um, shape (samples,)."""
        return self.displacement - self.predicted


@dataclass(frozen=True, eq=False)
class Identified:
    """What `identify` found.

    Attributes
    ----------
    model : ActuatorModel
        Fitted to the whole record, with covariance, metrics and provenance.
    held_out : HeldOut
        Of the model that the same procedure, choice of the structure included, makes of the first part of the record.
    trace : Trace
        The record beside the prediction of the model of `held_out`.
    residual : ndarray, shape (rows,)
        Residual in the rows to which it was fitted, um.
    autocorrelation : ndarray, shape (lags,)
        Of the residual, from lag 0, which is 1, in rows; beyond +-2 / sqrt(rows) it is not white.
    effective_samples : float
        How many independent samples the rows count for.
    tried : tuple of Tried
        What cross-validation compared, in its order; the last is what was chosen.
    response : Response
        Dead time and lag, their 95 % intervals, and whether the record separates them.
    evidence : Evidence
        What the error contains.
    verdict : Verdict
        Whether the model is to be used, with reasons; in the provenance of `model`, too.
    """

    model: ActuatorModel
    held_out: HeldOut
    trace: Trace
    residual: FloatArray
    autocorrelation: FloatArray
    effective_samples: float
    tried: tuple[Tried, ...]
    response: Response
    evidence: Evidence
    verdict: Verdict

    def _repr_html_(self) -> str:
        """In a notebook: the verdict, the errors, a picture of the hysteresis, the model."""
        from truestroke.report import notebook as pictures

        held = self.held_out
        rows = [
            ("verdict", "; ".join([self.verdict.level, *self.verdict.reasons])),
            ("rmse, held out", f"{held.rmse_um:.4g} um, {held.rmse_percent:.3g} %"),
        ]
        return display.as_html("Identified", rows) + pictures.identified(self) + self.model._repr_html_()


@normal.one_thread
def identify(
    record: Any,
    *,
    rate: bool | None = None,
    creep_times: Sequence[float] | None = None,
    asymmetry: int | None = None,
    thresholds: Sequence[float] | None = None,
    delay: float | None = None,
    modes: bool | None = None,
    drift: bool | None = None,
    branches: bool | None = None,
    held_out: float = 0.4,
    findings: Findings | None = None,
) -> Identified:
    """The model of an actuator from a record of voltage and displacement.

    Least squares that are pulled to the prior of the controller, all partial slopes positive at every velocity of the
    record. Omitted arguments are chosen by blocked cross-validation. All this is done twice: with
    the first part of the record, whose model gives the errors of `HeldOut` on the last part, and with all of it. Of
    the last part the first fit uses the range and the largest rate of the voltage, but not the displacement.

    Parameters
    ----------
    record : Record, Recording or tuple
        `Record`, or a recording of a run, or the tuple (volts in V, displacement in um, sample rate in Hz). Gaps and
        irregular time stamps are bridged by straight lines, which are not fitted; beyond 500,000 samples, means over
        blocks.
    rate : bool, optional
        Whether the weights depend on the rate.
    creep_times : sequence of float, optional
        Time constants of the creep states, s; () is no creep.
    asymmetry : int, optional
        Terms of asymmetry, 0 to 2.
    thresholds : sequence of float, optional
        r of the plays, V, ascending from 0.
    delay : float, optional
        Between voltage and displacement, s.
    modes : bool, optional
        Whether resonances of the stage are looked for: `ActuatorModel.dynamics`; by default, unless a delay is given.
    drift : bool, optional
        False: the zero of the sensor does not drift within the record. True: a linear or a logarithmic drift.
    branches : bool, optional
        False: hysteresis by plays of the voltage alone. By default plays of curved voltages, cells of Preisach's plane
        or states of Duhem are added where later parts of the record are predicted much better with them, unless
        `thresholds` are given; `ActuatorModel.plain` has none.
    held_out : float
        Share of the record at its end that is held out, above 0, at most 0.5.
    findings : Findings, optional
        Of `examine` for this record, if it was examined before.

    Raises
    ------
    SettingError
        An argument is out of bounds, the record is too short, voltage or displacement does not move, or the
        displacement falls where the voltage rises.

    Examples
    --------
    >>> t = np.arange(4000) / 1000.0
    >>> x = 1.5 - 1.5 * np.cos(2 * np.pi * t) * np.cos(0.8 * t)
    >>> found = identify((x, 10.0 * x, 1000.0))
    >>> round(found.held_out.rmse_percent, 2), found.model.predict([0.0, 1.0], 1000.0).round(1)
    (0.0, array([ 0., 10.]))
    """
    record = as_record(record) if isinstance(record, Recording) else record
    taken = from_step(series(record))
    if rate is not None:
        checks.flag("rate", rate)
    if findings is not None:
        checks.instance("findings", findings, Findings, "those of truestroke.examine(record)")
    share = checks.within("held_out", held_out, 0.01, 0.5)
    train, fs = round((1 - share) * taken.volts.size), taken.sample_rate
    _refuse_empty(taken, train)
    longest = taken.volts.size / fs / 4
    known = None if delay is None else checks.within("delay", delay, 0.0, longest, "s")
    fixed = {
        "rate": rate,
        "creep_times": creep_times,
        "asymmetry": None if asymmetry is None else checks.count("asymmetry", asymmetry, 0, 2),
        "thresholds": thresholds,
        "modes": delay is None if modes is None else checks.flag("modes", modes),
        "drift": None if drift is None else checks.flag("drift", drift),
        "branches": thresholds is None if branches is None else checks.flag("branches", branches),
    }
    with notebook.progress("identify") as shown:
        part, *_ = _found(taken, train, known, fixed, certain=False)
        if shown:
            shown(1, 2)
        final, tried, response = _found(taken, taken.volts.size, known, fixed, start=part.model.dynamics)
    of_model = part.model.predict(taken.volts, fs)
    width = _half_width(part.model, taken, train, of_model)
    predicted = of_model + part.drift(taken.volts.size)
    moved = zeros.ahead(taken, predicted, train)
    predicted += moved
    last = np.arange(taken.volts.size) >= train
    trace = Trace(**vars(taken), predicted=predicted, half_width=width, held_out=last)
    test, residual = _held_out(trace, moved), final.residual
    white = uncertainty.autocorrelation(residual), uncertainty.effective_samples(residual)
    findings = examine(_examined(record, taken)) if findings is None else findings
    evidence = validation.evidence(trace, residual, white[0], findings)
    verdict = validation.verdict(evidence, test, findings, response if known is None else None)
    model = _documented(final, test, taken, verdict)
    return Identified(model, test, trace, residual, *white, tried, response, evidence, verdict)


def _examined(record: Any, s: Series) -> Record:
    """What is examined: the record itself, or one of the arrays that stand for it."""
    if isinstance(record, Record):
        return record
    volts, displacement, rate = record if isinstance(record, tuple | list) else (s.volts, s.displacement, s.sample_rate)
    return Record.from_arrays(volts, displacement, sample_rate=float(rate))


_Chosen = tuple[Structure, float, FloatArray, tuple[Tried, ...]]


def _found(
    s: Series,
    samples: int,
    delay: float | None,
    fixed: Mapping[str, Any],
    certain: bool = True,
    start: Dynamics | None = None,
) -> tuple[Fit, tuple[Tried, ...], Response]:
    """Dead time, lag, structure and weights from the first samples, and what was compared.

    The search for modes begins with those of `start`, and intervals are made where `certain`.
    """
    s, zero = zeros.at_one_zero(s, samples)
    coarse = _data(s, samples, CHOICE_ROWS)
    found = time_constants(s, coarse, delay, certain)
    coarse = dataclasses.replace(coarse, delay=found.delay, time_constant=found.time_constant)
    guess = first_prediction(coarse)
    structure, weight, tried = choose(coarse, guess, fixed)
    fine = dataclasses.replace(_data(s, samples, ROWS), delay=found.delay, time_constant=found.time_constant)
    resonant = fixed["modes"] and _resonances(s, coarse, fixed, (structure, weight, guess, tried), start)
    if resonant:
        dynamics, structure, weight, guess, tried = resonant
        fine = dataclasses.replace(fine, delay=0.0, time_constant=0.0, dynamics=dynamics)
    weight *= fine.displacement.size / coarse.displacement.size  # as sure of the prior as what was compared
    plain = fit_structure(fine, structure, weight, guess)
    fit, more = _branched(plain, fine, coarse, structure, weight) if fixed["branches"] else (plain, ())
    rate = float(np.diff(fit.drift(samples)[-2:])[0]) * s.sample_rate
    model = fit.model.replace(walk=(more or tried)[-1].walk, drift=rate)
    compared = _behind(coarse, fine)
    rows = compared.displacement.size / fine.displacement.size
    model = coverage.calibrated(model, compared, fit.structure, fit.weight * rows)
    drift = fit.drift
    fit = dataclasses.replace(fit, model=model, drift=lambda size: drift(size) + zero[:size])
    return fit, (*tried, *more), found


@normal.one_thread
def time_constants(s: Series, coarse: Data | None = None, delay: float | None = None, certain: bool = True) -> Response:
    """Dead time and lag of all samples, or of those of `coarse`; of `identify`, without a model."""
    coarse = _data(s, s.volts.size, CHOICE_ROWS) if coarse is None else coarse
    first = 0.0 if delay is not None else coarse_delay(coarse)
    samples = coarse.volts.size
    return find_response(_data(s, samples, samples), first, delay, certain)


def _behind(coarse: Data, fine: Data) -> Data:
    """The first with the stage, dead time and lag of the second."""
    return dataclasses.replace(coarse, delay=fine.delay, time_constant=fine.time_constant, dynamics=fine.dynamics)


def _branched(plain: Fit, fine: Data, coarse: Data, s: Structure, weight: float) -> tuple[Fit, tuple[Tried, ...]]:
    """The model with branches, if cross-validation asks for them, and what was compared; else the plain one."""
    rows = fine.displacement.size / coarse.displacement.size
    found = choose_branches(_behind(coarse, fine), s, weight / rows, plain.strain)
    if found is None:
        return plain, ()
    structure, weight, tried = found
    fit = fit_structure(fine, structure, weight * rows, plain.strain)
    if fit.model.noise > BRANCHES_GAIN * plain.model.noise:  # what was compared need not have an inverse
        return plain, ()
    return dataclasses.replace(fit, model=fit.model.replace(plain=plain.model)), tried


def _resonances(
    s: Series, static: Data, fixed: Mapping[str, Any], chosen: _Chosen, start: Dynamics | None
) -> tuple[Dynamics, Structure, float, FloatArray, tuple[Tried, ...]] | None:
    """Modes of the stage with their dead time in place of the delay, and what was chosen behind them.

    None where cross-validation does not ask for them.

    A mode is found between what a static model predicts and the displacement, the next ones from models that were
    fitted behind those before.
    """
    structure, weight, guess, tried = chosen
    data = dataclasses.replace(static, delay=0.0, time_constant=0.0)
    searched = _excerpt(s, min(data.volts.size, modes.ROWS), data)
    if np.count_nonzero(searched.fitted(structure.rested)) < FEWEST:
        return None
    pull = weight * searched.displacement.size / data.displacement.size
    fit = partial(_strain, structure=structure, weight=pull, guess=guess)
    dynamics = _searched(s, searched, 0 if structure.rested else searched.settled * searched.every, fit, start)
    if dynamics is None:
        return None
    data = dataclasses.replace(data, dynamics=dynamics)
    guess = _strain(data, structure, weight, guess)
    if with_this(data, structure, guess, weight) > tried[-1].rmse:
        return None
    thresholds = {"thresholds": structure.thresholds}
    structure, weight, more = choose(data, guess, {**fixed, **thresholds})
    if more[-1].rmse > RESONATES * tried[-1].rmse:
        return None
    return dynamics, structure, weight, guess, (*tried, *more)


def _searched(
    s: Series, data: Data, first: int, strain: Callable[[Data], FloatArray], found: Dynamics | None
) -> Dynamics | None:
    """The modes that the samples of `data` from the first on show beyond those that were found.

    Each is found behind a model with those before.
    """
    n = data.volts.size
    known, z = s.known[:n] & (np.arange(n) >= first), s.displacement[:n] - data.zero

    def search(behind: Dynamics | None, narrow: bool) -> ModeSearch:
        return ModeSearch(strain(dataclasses.replace(data, dynamics=behind)), z, known, s.sample_rate, narrow)

    for narrow in (True, False):
        made, more = found, True
        for _ in range(SEARCHES):
            made, more = search(made, narrow).run(made)
            if not more:
                break
        if made is None or not narrow or not search(made, narrow).hums(made):
            break
    return made


def _excerpt(s: Series, samples: int, of: Data) -> Data:
    """The first samples of other data, with more rows of them."""
    every = -(-samples // SEARCH_ROWS)
    z, known = (s.displacement - of.zero)[:samples:every], s.known[:samples:every]
    return dataclasses.replace(of, volts=of.volts[:samples], displacement=z, known=known, every=every)


def _strain(data: Data, structure: Structure, weight: float, guess: FloatArray) -> FloatArray:
    """What a fitted model gives before the stage, um above `Data.zero`."""
    return fit_structure(data, structure, weight, guess[: data.volts.size], certain=False).strain


def _refuse_empty(s: Series, train: int) -> None:
    """Where there is nothing to learn from in the first part, or nothing to predict in the last."""
    for name, values, unit in (("volts", s.volts, "V"), ("displacement", s.displacement, "um")):
        if np.ptp(values[:train]) <= 1e-12 * np.abs(values).max():
            rest = f"{values[0]:g} in the first {train} samples"
            raise SettingError(name, rest, "moving before the held-out part", unit)
    for part, known in (("first", s.known[:train]), ("held-out", s.known[train:])):
        if np.count_nonzero(known) < FEWEST:
            found = f"{np.count_nonzero(known)} samples outside its gaps in the {part} part"
            raise SettingError("record", found, f"one with at least {FEWEST}")


def _data(s: Series, samples: int, rows: int) -> Data:
    """The first samples for the fit; of the others, the range of the voltage and its rate.

    The zero is the first that the record comes near: the sensor's own, the straight line's displacement at 0 V, or its
    least displacement: asymmetry is estimated from travel between 0 and the stroke.
    """
    x, z = s.volts[:samples], s.displacement[:samples]
    stroke = float(np.ptp(z) * np.ptp(s.volts) / np.ptp(x))
    every = -(-x.size // rows)
    zeros = 0.0, float(np.polyfit(x, z, 1)[1]), float(z.min())
    zero = next(a for a in zeros if z.min() - NEAR * stroke <= a <= z.max() + NEAR * stroke)
    return Data(
        volts=x,
        displacement=(z - zero)[::every],
        known=s.known[:samples:every],
        sample_rate=s.sample_rate,
        every=every,
        voltage_range=(float(s.volts.min()), float(s.volts.max())),
        stroke=stroke,
        zero=zero,
        fastest=float(np.abs(central_difference(s.volts, s.sample_rate)).max()) * stroke / float(np.ptp(s.volts)),
        duration=s.volts.size / s.sample_rate,
    )


def _held_out(trace: Trace, moved: FloatArray) -> HeldOut:
    judged = trace.held_out & trace.known
    error, stroke = trace.residual[judged], float(np.ptp(trace.displacement))
    coverage = float(np.mean(np.abs(error) <= trace.half_width[judged]))
    rmse, maximum = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    zero = float(moved[np.abs(moved).argmax()])
    return HeldOut(rmse, maximum, 100 * rmse / stroke, 100 * maximum / stroke, error.size, coverage, zero)


def _half_width(model: ActuatorModel, s: Series, train: int, predicted: FloatArray) -> FloatArray:
    """Half width of the 95 % interval of a trace, um: the zero walks from the end of the first part on.

    It walks anew from each of `Series.breaks` on, where it is estimated. After another gap that is longer than the
    first part it is the zero of another day (`ActuatorModel.another_day`).
    """
    since = np.maximum(np.arange(s.volts.size) - train, 0) / s.sample_rate
    apart = s.time - s.time[train - 1] - since > train / s.sample_rate
    for start in (b for b in s.breaks if b >= train):
        since[start:] -= since[start]
        apart[start:] = False
    zero = model.walk**2 * since
    offset = model.columns["offset"].start
    zero[apart] += model.another_day()[offset, offset]
    return interval.half_width(model, s.volts, s.sample_rate, zero, predicted)


def _documented(fit: Fit, held_out: HeldOut, s: Series, verdict: Verdict) -> ActuatorModel:
    """The model with the metrics and the provenance for its file."""
    from importlib.metadata import version

    metrics = {f"held_out_{name}": float(value) for name, value in dataclasses.asdict(held_out).items()}
    metrics |= {"record_samples": float(s.volts.size), "record_sample_rate_hz": s.sample_rate}
    provenance = {"source": s.source, "made_by": f"truestroke {version('truestroke')}", "verdict": verdict.level}
    provenance |= {f"reason_{number}": reason for number, reason in enumerate(verdict.reasons, 1)}
    return fit.model.replace(metrics=metrics, provenance=provenance)


# ---- The weights of a given structure ------------------------------------------------------------------------------


def fit_structure(data: Data, s: Structure, weight: float, guess: FloatArray, certain: bool = True) -> Fit:
    """The model of structure `s`.

    Parameters
    ----------
    data : Data
        The record.
    s : Structure
        What the model consists of.
    weight : float
        Variance, um^2, with which the precision of the prior is multiplied.
    guess : ndarray, shape (samples,)
        A first prediction before dead time and lag, um above `Data.zero`: velocity and asymmetry follow it in the
        first step, then the model's own.
    certain : bool
        Whether the covariance is wanted.
    """
    prior, m = data.prior(s), s.parameters
    c: FloatArray = np.zeros(0)
    z = guess
    for _ in range(STEPS + 1):
        J, target, velocity = _linearised(data, s, z, c)
        pull = np.vstack([normal.reduced(np.column_stack([J, target])), prior.rows(weight)])
        c = normal.solve(pull, *data.constraints(s, velocity))
        model = data.model(s, c, velocity)
        strain = model.strain(data.volts, data.sample_rate)
        z = strain + data.starts(s, c[m:])
    residual = data.displacement - (data.through(z) + data.drift(s, c[m:], z.size))[:: data.every]
    residual = residual[data.fitted(s.rested)]
    P = _of_model(uncertainty.covariance(J, residual, prior, weight), s) if certain else np.zeros((m, m))
    times = {"delay": data.delay, "time_constant": data.time_constant}
    model = model.replace(covariance=P, noise=float(np.sqrt(np.mean(residual**2))), **times)
    return Fit(model, s, weight, residual, partial(data.drift, s, c[m:]), strain)


def _of_model(P: FloatArray, s: Structure) -> FloatArray:
    """Covariance of the weights, whatever starts and drift are; of a model with branches, with these as they are.

    Plays and branches follow each other closely: each by itself is hardly known, and their sum well.
    """
    m, further = s.parameters, P.shape[0] - len(s.further)
    if not s.further:
        return P[:m, :m]
    shared = P[:m, further:]
    return np.asarray(P[:m, :m] - shared @ np.linalg.solve(P[further:, further:], shared.T))


def _linearised(data: Data, s: Structure, z: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """J and t so that J c = t has the next coefficients, from the last ones and their prediction; velocity, um/s."""
    rows = data.columns(s, z)[data.fitted(s.rested)]
    C, measured = rows[:, :-1], rows[:, -1]
    rate = central_difference(z, data.sample_rate)[:: data.every][data.fitted(s.rested)]
    velocity = float(np.abs(rate).max())  # of the strain: dead time and lag are behind it
    if not c.size:
        return C, measured, velocity
    predicted = data.through(z)[:: data.every][data.fitted(s.rested)]
    J = data.derivative(s, C, predicted, c)
    drift = data.drift(s, c[s.parameters :], z.size)[:: data.every][data.fitted(s.rested)]
    return J, measured - predicted - drift + J @ c, velocity
