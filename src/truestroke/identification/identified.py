"""From a record to a model: its structure, its weights, and how well it is known."""

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from truestroke.base import checks, display, notebook
from truestroke.base.checks import SettingError
from truestroke.base.threads import one_thread
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.control import interval, tested
from truestroke.control.actuator import ActuatorModel
from truestroke.identification.examination.examine import examine
from truestroke.identification.examination.findings import Findings
from truestroke.identification.fitting import uncertainty, zeros
from truestroke.identification.fitting.procedure import FEWEST, fit_samples
from truestroke.identification.fitting.response import Response
from truestroke.identification.fitting.rest import from_step
from truestroke.identification.fitting.select import Tried
from truestroke.identification.fitting.structure import Fit
from truestroke.identification.held_out import validation
from truestroke.identification.held_out.changed import change
from truestroke.identification.held_out.jump import jump
from truestroke.identification.held_out.steps import blocks
from truestroke.identification.held_out.trace import HeldOut, Trace
from truestroke.identification.held_out.validation import Evidence
from truestroke.identification.records.record import Record, as_record
from truestroke.identification.records.resting import fitted, moving
from truestroke.identification.records.series import Series, series
from truestroke.model.sampled import central_difference
from truestroke.signals.recording import Recording


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


@one_thread
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
        Share of the record at its end that is held out, above 0, at most 0.5; of its motion, where the voltage rests
        for long (`resting.moving`).
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
    train, fs = _first_part(taken.volts, checks.within("held_out", held_out, 0.01, 0.5)), taken.sample_rate
    to_fit = dataclasses.replace(taken, known=taken.known & fitted(taken.volts))
    _refuse_empty(to_fit, train)
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
    with notebook.progress("identify") as shown, _of_this_record(taken):
        part, *_ = fit_samples(to_fit, train, known, fixed, certain=False)
        if shown:
            shown(1, 2)
        final, tried, response = fit_samples(to_fit, taken.volts.size, known, fixed, before=part)
    findings = examine(_examined(record, taken)) if findings is None else findings
    loop = abs(findings.loop_width_percent) / 100 * findings.stroke_um
    part, final = (_of_one_family(fit, loop) if findings.one_family else fit for fit in (part, final))
    of_model = part.model.predict(taken.volts, fs)
    width = _half_width(part.model, taken, train, of_model)
    predicted = of_model + part.drift(taken.volts.size)
    moved = zeros.ahead(taken, predicted, train)
    predicted += moved
    last = np.arange(taken.volts.size) >= train
    trace = Trace(**vars(taken), predicted=predicted, half_width=width, held_out=last)
    test, residual = _held_out(trace, moved), final.residual
    white = uncertainty.autocorrelation(residual), uncertainty.effective_samples(residual)
    fit = taken.time[final.rows], residual
    of_zero = final.drift(taken.volts.size)
    stroke = residual.size / max(findings.strokes, 1)
    of_fit = blocks(residual, final.columns, final.pull, taken.volts[final.rows])
    moves = taken.displacement[final.rows] - residual, central_difference(predicted, fs)[final.rows]
    changed = change(of_fit, *moves) if of_fit else None
    jumped = jump(of_fit, stroke) if of_fit and not changed else None
    evidence = validation.evidence(trace, fit, white[0], findings, of_zero, part.rows, jumped, changed)
    found = response if known is None else None
    branched = part.model.branches is not None, final.model.branches is not None
    verdict = validation.verdict(evidence, test, findings, found, final.model.dynamics, *branched)
    of_response = tested.frequency(of_model, fs, final.model.noise)
    model = _documented(final, test, taken, verdict).replace(tested_frequency=of_response)
    return Identified(model, test, trace, residual, *white, tried, response, evidence, verdict)


OF_ARGUMENTS = {"thresholds", "creep_times", "asymmetry", "delay", "branches"}  # of `identify`, too
OF_MODEL = {"initial_weights", *(f.name for f in dataclasses.fields(ActuatorModel))} - OF_ARGUMENTS


@contextmanager
def _of_this_record(s: Series) -> Iterator[None]:
    """A model that is out of bounds is named as that of this record: nobody has set its members."""
    try:
        yield
    except SettingError as error:
        if error.argument.partition("[")[0] not in OF_MODEL:
            raise
        wrong = str(error).replace(": must be ", ", which is not ")
        right = "that of an actuator: are its units, its clock and its columns right? `examine` says what it finds"
        raise SettingError("record", f"{s.source or 'arrays'}, whose model has {wrong}", right) from None


def _examined(record: Any, s: Series) -> Record:
    """What is examined: the record itself, or one of the arrays that stand for it."""
    if isinstance(record, Record):
        return record
    volts, displacement, rate = record if isinstance(record, tuple | list) else (s.volts, s.displacement, s.sample_rate)
    return Record.from_arrays(volts, displacement, sample_rate=float(rate))


def _first_part(volts: FloatArray, share: float) -> int:
    """How many rows are not held out: motion is shared, and long rests go with the motion before them."""
    moves = np.flatnonzero(moving(volts))
    return int(moves[round((1 - share) * moves.size)])


def _refuse_empty(s: Series, train: int) -> None:
    """Where there is nothing to learn from in the first part, or nothing to predict in the last."""
    for name, values, unit in (("volts", s.volts, "V"), ("displacement", s.displacement, "um")):
        if np.ptp(values[:train]) <= 1e-12 * np.abs(values).max():
            rest = f"{values[0]:g} {unit} in the first {train} rows"
            raise SettingError(
                name, rest, "moving before the held-out part: leave out rows of the rest at the beginning"
            )
    for part, known in (("first", s.known[:train]), ("held-out", s.known[train:])):
        if np.count_nonzero(known) < FEWEST:
            found = f"{np.count_nonzero(known)} samples outside its gaps in the {part} part of {s.source}"
            raise SettingError("record", found, f"one with at least {FEWEST}: record for longer, or at a higher rate")


def _held_out(trace: Trace, moved: FloatArray) -> HeldOut:
    judged = trace.judged
    error, stroke = trace.residual[judged], float(np.ptp(trace.displacement))
    coverage = float(np.mean(np.abs(error) <= trace.half_width[judged]))
    rmse, maximum = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    zero = float(moved[np.abs(moved).argmax()])
    return HeldOut(rmse, maximum, 100 * rmse / stroke, 100 * maximum / stroke, error.size, coverage, zero)


def _of_one_family(fit: Fit, loop: float) -> Fit:
    """The fit to a record that does not show where inner loops are: the interval of its model knows it.

    `loop` is the mean height of the loop in the record, um.
    """
    if fit.model.explored is None:
        return fit
    explored = dataclasses.replace(fit.model.explored, inner=interval.inner(fit.model, loop, fit.inner_loops))
    return dataclasses.replace(fit, model=fit.model.replace(explored=explored))


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
    zero = interval.of_walk(model, since)
    offset = model.columns["offset"].start
    zero[apart] += model.another_day()[offset, offset]
    return interval.half_width(model, s.volts, s.sample_rate, zero, predicted)


def _documented(fit: Fit, held_out: HeldOut, s: Series, verdict: Verdict) -> ActuatorModel:
    """The model with the metrics and the provenance for its file."""
    from importlib.metadata import version

    metrics = {f"held_out_{name}": float(value) for name, value in dataclasses.asdict(held_out).items()}
    metrics |= {"record_samples": float(s.volts.size), "record_sample_rate_hz": s.sample_rate}
    provenance = {"source": s.source, "made_by": f"truestroke {version('truestroke')}", **verdict.entries}
    return fit.model.replace(voltage_noise=s.voltage_noise, metrics=metrics, provenance=provenance)
