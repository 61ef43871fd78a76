"""One self-contained HTML page of an identified model, to print and attach."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truestroke.base.display import figures
from truestroke.identification import ActuatorModel, Findings, Identified, Record, examine
from truestroke.identification.fitting.select import Tried
from truestroke.identification.held_out.validation import Evidence
from truestroke.report import words
from truestroke.report.identified import plots
from truestroke.report.identified.view import View
from truestroke.report.page import Number, Page, Section, Table, captioned, closer
from truestroke.report.units import length

CAPTIONS = {
    "loop": (
        "Hysteresis loop",
        "Displacement over voltage in the held-out part of the record, measured and predicted: as "
        "it is, and without the straight line, so that the loops open. Look for places where the thin line leaves "
        "the wide one.",
    ),
    "residual": (
        "Residual",
        "Measured minus predicted displacement, by a model that was fitted to the part that is not shaded. Above: "
        "the state at the start is not known; a slope in the shaded part is creep or drift for which the record is too "
        "short. Below: a curved median over voltage is a term that the model lacks, a slope over rate a lag. The "
        "autocorrelation of the fit's residual would stay in the grey band if the residual were noise alone.",
    ),
    "spectrum": words.CAPTIONS["spectrum"],
    "weights": (
        "Weights",
        "Each with its standard deviation, which allows for residuals that are not white. Neighbouring plays share one "
        "slope between them: their sum is known better than each. Hollow: the record is hardly informative about this "
        "weight, and its bar is that of the prior (grey).",
    ),
}
CHOSEN = (
    "Chosen by blocked cross-validation within the fitted part: each block is predicted from those before it. A start "
    "from rest is preferred, as a controller starts so; of structures that predict about as well, the one with the "
    "most terms is taken: the prior holds the weights about which the record is hardly informative."
)
REMARKS = {
    "good": "Use it where its record tests it.",
    "doubtful": "Usable, with these reasons in mind:",
    "bad": "Do not use it:",
}
WHITE = 0.2  # of the autocorrelation: beyond it the residual is not called white
NOISE = 1.5  # times the noise: a residual below that is called noise
LINE = 0.8  # of the straight line's rmse: no gain worth a model


# ---- In words ------------------------------------------------------------------------------------------------------


def tested_range(model: ActuatorModel) -> str:
    """Voltages, speed and frequency up to which the record of a model tests it."""
    low, high = model.voltage_range
    of = f" and {figures(model.tested_frequency)} Hz" if model.tested_frequency else ""
    return f"{low:.4g} to {high:.4g} V, up to {figures(model.fastest)} um/s{of}"


def percent(value: float) -> str:
    """Two decimals, and more words where they would be none.

    Examples
    --------
    >>> percent(0.357), percent(12.34), percent(0.0001)
    ('0.36 %', '12.3 %', 'below 0.01 %')
    """
    if value < 0.005:
        return "below 0.01 %"
    return f"{value:.2f} %" if value < 10 else f"{figures(value)} %"


def line_rmse(view: View) -> float:
    """Of a straight line through the rest of the record, on the held-out part, um."""
    return float(np.sqrt(np.mean(view.line_error[view.tested] ** 2)))


def verdict(found: Identified, view: View, findings: Findings) -> str:
    """The prediction error of the model on held-out data, in one sentence."""
    h, line = found.held_out, line_rmse(view)
    errors = f"{percent(h.rmse_percent)} of stroke rmse, {percent(h.maximum_percent)} at most"
    what = "The model predicts motion that it has not seen"
    if h.rmse_um <= NOISE * findings.noise_um:
        return f"{what} to {errors}: within the noise of the sensor."
    if h.rmse_um >= LINE * line:
        than = "worse" if h.rmse_um > line else "hardly better"
        return f"{what} {than} than a straight line, to {errors}: do not use it."
    ratio = line / h.rmse_um
    return f"{what} to {errors}: {f'{ratio:.0f}' if ratio >= 3 else f'{ratio:.1f}'} times better than a straight line."


def whiteness(found: Identified) -> str:
    """Whether the fit's residual is noise: white at all lags, and no larger than the sensor's."""
    e, samples = found.evidence, found.residual.size
    lag = f"autocorrelation {e.autocorrelation:.2f} at a lag of {length_of_time(e.autocorrelation_s)}"
    count = f"The {samples:,} samples of the fit's residual count for {found.effective_samples:,.0f} independent ones"
    if abs(e.autocorrelation) <= WHITE and e.over_noise <= NOISE:
        return f"{count}: it is nearly white ({lag}) and no larger than the noise, there is nothing more to model."
    why = "it is not white" if abs(e.autocorrelation) > WHITE else "it is larger than the noise"
    return f"{count}; {why} ({lag}), because of the model or of the clock; the standard deviations allow for it."


def length_of_time(seconds: float) -> str:
    """In ms or s."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def notes(view: View, record: Record) -> list[str]:
    """What of the record was not used, and about which weights it is hardly informative."""
    says, unknown = [], np.count_nonzero(np.isnan(view.error))
    if unknown:
        share = percent(100 * unknown / view.time.size)
        says.append(f"{share} of the samples are in gaps or after them, where the state of the actuator is not known")
    block = round(record.sample_rate / view.model.metrics["record_sample_rate_hz"])
    if block > 1:
        rate = view.model.metrics["record_sample_rate_hz"]
        says.append(f"means over {block} samples were used, at {figures(rate, 4)} Hz: nothing faster is in the model")
    if (plain := view.model.plain) is not None:
        residuals = f"the residual of its fit is {plain.noise:.4g} um rms instead of {view.model.noise:.4g}"
        says.append(f"a controller has no branches, it starts from the model of plays alone: {residuals}")
    from_prior = [name for name, hardly in zip(view.model.names, view.from_prior(), strict=True) if hardly]
    if from_prior:
        names = ", ".join(from_prior)
        says.append(f"the record is hardly informative about {names}: their deviation is that of the prior")
    return says


@dataclass(frozen=True)
class Compared:
    """A structure that cross-validation tried.

    Attributes
    ----------
    words : str
        The structure.
    rmse : float
        The least over the weights of the prior, um.
    differs : str or None
        The one part in which it differs from the chosen one; "" for the chosen one itself; None where more differ.
    """

    words: str
    rmse: float
    differs: str | None


def structures(tried: Sequence[Tried]) -> list[Compared]:
    """What cross-validation compared, best first; the last of `tried` was chosen."""
    least: dict[tuple[str, ...], float] = {}
    for one in tried:
        least[one.parts] = min(one.rmse, least.get(one.parts, np.inf))
    compared = []
    for parts, rmse in sorted(least.items(), key=lambda entry: entry[1]):
        other = [new for new, old in zip(parts, tried[-1].parts, strict=True) if new != old]
        compared.append(Compared(", ".join(parts), rmse, "".join(other) if len(other) < 2 else None))
    return compared


# ---- The page ------------------------------------------------------------------------------------------------------


def model_page(
    found: Identified,
    record: Record,
    *,
    findings: Findings | None = None,
    model_file: str | Path | None = None,
    next_commands: tuple[tuple[str, str], ...] = (),
    command: str | None = None,
) -> Page:
    """The page of an identified model.

    Parameters
    ----------
    found : Identified
        What `identify(record)` returned.
    record : Record
        The record.
    findings : Findings, optional
        What `examine(record)` returned, if that is there already.
    model_file : path, optional
        Where the model was saved.
    next_commands : tuple of (str, str)
        Commands that use the model, each with what it does.
    command : str, optional
        What makes this page again.
    """
    findings, view = findings or examine(record), View.of(found)
    sections = [
        Section(tables=[_errors(found, view, findings)]),
        Section(heading="What the error contains", tables=[_evidence(found)]),
        _warnings([*findings.warnings, *notes(view, record)]),
        closer(plots.closer(view)),
        *captioned(CAPTIONS | {"spectrum": words.spectrum([plots.tested(view)], "in the part that was held out")}),
        *_structure(found),
        Section(heading="Record", tables=[Table(rows=findings.table(), kind="words")], beside=True),
        _model_file(model_file, next_commands),
        Section(heading="All weights", tables=[_weights(view)], folded=True),
    ]
    return Page(
        title=f"Model of {Path(record.source).name}",
        lead=f"The record: {findings.sentence()}. {verdict(found, view, findings)}",
        verdict=found.verdict,
        remark=REMARKS[found.verdict.level],
        sections=[section for section in sections if section],
        plots=lambda theme: plots.plots(found, theme),
        command=command,
        footer=_footer(view, record),
    )


def _errors(found: Identified, view: View, findings: Findings) -> Table:
    """Rmse and maximum of model and straight line, with their per cent."""
    line, h, stroke = view.line_error[view.tested], found.held_out, view.model.stroke
    of_line = {"rmse": line_rmse(view), "maximum": float(np.abs(line).max())}
    of_model = {"rmse": (h.rmse_um, h.rmse_percent), "maximum": (h.maximum_um, h.maximum_percent)}
    rows: list[list[str | Number]] = [
        [name, _number(*of_model[name]), _number(um, 100 * um / stroke)] for name, um in of_line.items()
    ]
    return Table(
        columns=[f"held out: {view.time[view.first]:.4g} to {view.time[-1]:.4g} s", "this model", "a straight line"],
        rows=rows,
        kind="summary",
        note=f"Per cent are of the stroke, {length(stroke)}. {_interval(found)} The held-out part ({h.samples:,} of "
        f"{view.time.size:,} samples) was predicted from voltage alone by the model that the same procedure makes of "
        "the rest; the model in the file is fitted to all. The noise of the sensor between neighbouring samples is "
        f"{length(findings.noise_um)}. {whiteness(found)}",
    )


def _interval(found: Identified) -> str:
    """The 95 % interval, and how much of the held-out part is in it."""
    width = length(float(np.median(found.trace.half_width[found.trace.held_out])))
    share = f"{100 * found.held_out.coverage:.0f} % of the held-out samples"
    return f"The 95 % interval of the prediction is {width} to either side (median) and holds {share}."


def _evidence(identified: Identified) -> Table:
    """By what the verdict is formed, and where it holds."""
    found = identified.evidence
    of_motion = {"range": found.range_beyond, "speed": found.speed_beyond, "length of strokes": found.strokes_beyond}
    beyond = ", ".join(f"{100 * share:.0f} % in {name}" for name, share in of_motion.items())
    shares = [(name, f"{100 * getattr(found, name):.0f} %") for name in ("voltage", "velocity", "history", "time")]
    least = f"{found.least_autocorrelation:.2f} at {length_of_time(found.least_autocorrelation_s)}"
    most = f"{found.autocorrelation:.2f} at {length_of_time(found.autocorrelation_s)}"
    rows = [
        ("held-out error over the noise of the sensor", figures(found.over_noise)),
        ("held-out error over that of the fitted part", figures(found.over_fitted)),
        ("autocorrelation of the residual, largest and least", f"{most}, {least}"),
        ("of the held-out error follows " + ", ".join(name for name, _ in shares), ", ".join(v for _, v in shares)),
        ("strongest line of the held-out error", f"{100 * found.line:.0f} % at {figures(found.line_hz, 4)} Hz"),
        ("of the held-out error a black-box model predicts", f"{100 * max(found.black_box, 0.0):.0f} %"),
        (
            "jump of the residual of the fit",
            f"{length(abs(found.jump_um))} at {found.jump_s:.4g} s" if found.jump_um else "none",
        ),
        ("change of gain or delay in that residual", _changed(found)),
        ("length of held-out strokes, of that in the record", f"{100 * found.strokes_tested:.0f} %"),
        ("held-out motion beyond the fitted one", beyond),
        ("the record tests the model from", tested_range(identified.model)),
    ]
    return Table(rows=rows, kind="words")


def _changed(found: Evidence) -> str:
    if found.gain_changed:
        return f"gain {100 * found.gain_changed:+.2g} % from {found.changed_s:.4g} s on"
    if found.later_s:
        way = "later" if found.later_s > 0 else "earlier"
        return f"{length_of_time(abs(found.later_s))} {way} from {found.changed_s:.4g} s on"
    return "none"


def _number(um: float, percents: float) -> Number:
    value, unit = length(um).split()
    return Number(value, unit, percent(percents))


def _warnings(texts: list[str]) -> Section | None:
    return Section(heading="Limits of this record", items=texts) if texts else None


def _structure(found: Identified) -> list[Section | None]:
    """The chosen structure and the effect of each part; folded, all structures that were tried."""
    tried = structures(found.tried)
    chosen = next(one for one in tried if one.differs == "")
    parts = [(one.differs, length(one.rmse), _more(one.rmse, chosen.rmse)) for one in tried if one.differs]
    table = Table(
        columns=["with this instead", "rmse", ""],
        rows=[("as chosen", length(chosen.rmse), ""), *parts],
        note=CHOSEN,
    )
    others = [(one.words, length(one.rmse)) for one in tried if one.differs is None]
    return [
        Section(heading="Structure", text=chosen.words, tables=[table] if parts else [], beside=True),
        Section(heading="Other structures that were compared", tables=[Table(rows=others)], folded=True)
        if others
        else None,
    ]


def _more(rmse: float, chosen: float) -> str:
    """By how many per cent more."""
    percents = round(100 * (rmse / chosen - 1)) if chosen > 0 else 0
    return f"{percents:+d} %" if percents else "0 %"


def _model_file(file: str | Path | None, next_commands: tuple[tuple[str, str], ...]) -> Section | None:
    if file is None:
        return None
    return Section(
        heading="Model file and next commands",
        text=f"`{file}` holds weights, covariance and these metrics.",
        code="".join(f"# {shows}\ntruestroke {command}\n" for command, shows in next_commands),
    )


def _weights(view: View) -> Table:
    """Each weight, its deviation, that of the prior, and the unit."""
    m = view.model
    found = zip(m.names, m.weights, m.deviations, view.prior()[1], m.units, strict=True)
    return Table(
        columns=["weight", "value", "s.d.", "prior, s.d.", "unit"],
        rows=[(name, *(f"{value:.4g}" for value in numbers), unit) for name, *numbers, unit in found],
        text=True,
    )


def _footer(view: View, record: Record) -> str:
    """Where the model comes from, in a line."""
    columns = [f"{role} from `{column.heading}` ({column.unit})" for role, column in record.columns.items()]
    made_by = view.model.provenance.get("made_by", "")
    return " · ".join([record.source, *columns, *([made_by] if made_by else [])])
