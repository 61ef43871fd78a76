"""The page of a model on another record: its errors, the zero of the day, its interval."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from truestroke.base.display import figures, micrometres
from truestroke.identification import ActuatorModel, Score
from truestroke.model.sampled import central_difference
from truestroke.report import style, units
from truestroke.report.identified import plots as model_plots
from truestroke.report.identified.view import View
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme
from truestroke.report.units import length

CAPTIONS = {
    "loop": (
        "Hysteresis loop",
        "Displacement over voltage, measured and predicted with the offset of this record: as it is, and without "
        "the straight line, so that the loops open.",
    ),
    "error": (
        "Error",
        "Measured minus predicted displacement, without the offset. Above: over time, in the 95 % interval of another "
        "day (grey); the dashed start, where the states of the plays are not known, is not judged. Below: a curved "
        "median is an actuator that answers otherwise than that of the model.",
    ),
}
REMARKS = {
    "good": "The model holds for this record.",
    "doubtful": "The model is usable, with these reasons in mind:",
    "bad": "The model does not hold for this record:",
}


def rows(found: Score) -> list[tuple[str, str, str]]:
    """What of the error, its size, and its share of the peak-to-peak displacement."""
    span = float(np.ptp(found.trace.displacement))
    sizes = {
        "rmse": found.rmse_um,
        "maximum": found.maximum_um,
        "rmse, the zero of the model": found.rmse_without_offset_um,
        "start, rmse": found.start_rmse_um,
        "start, maximum": found.start_maximum_um,
    }
    return [(name, micrometres(um), f"{100 * um / span:.2f} %") for name, um in sizes.items() if np.isfinite(um)]


def offset(found: Score) -> str:
    """The zero of this record, and where it comes from."""
    source = "estimated: the median of measured minus predicted" if found.estimated else "given"
    return f"{found.offset_um:+.4g} um above that of the model ({source})"


def voltage(found: Score) -> list[tuple[str, str]]:
    """That noise was taken off the voltage, if it was."""
    noise = found.trace.voltage_noise
    return [("voltage", f"without noise of {noise:.2g} V that the displacement does not follow")] if noise else []


def interval(found: Score) -> str:
    """The 95 % interval, and how much of the record is in it."""
    return f"+-{found.half_width_um:.3g} um (median) holds {100 * found.coverage:.0f} % of the samples"


def score_page(found: Score, model: ActuatorModel, model_file: str | Path = "", command: str | None = None) -> Page:
    """The page of `found = score(model, record)`; `command` is what makes it again."""
    facts = [
        ("zero", offset(found)),
        ("95 % interval of another day", interval(found)),
        *voltage(found),
        *(("beyond the record of the model", words) for words in found.beyond.warnings),
        ("samples judged", f"{np.count_nonzero(found.trace.judged):,}"),
        ("residual of the model's own record", length(model.noise)),
        ("model", f"{model_file}, of {model.provenance.get('source') or 'a record without a name'}"),
    ]
    return Page(
        title=f"{Path(model_file).name or 'A model'} on {Path(found.trace.source).name or 'a record'}",
        lead=f"The model predicts this record to {length(found.rmse_um)} rms, {figures(found.rmse_percent, 2)} % of "
        f"peak-to-peak, {length(found.maximum_um)} at most.",
        verdict=found.verdict,
        remark=REMARKS[found.verdict.level],
        sections=[
            Section(tables=[Table(columns=["measured minus predicted", "", "of p-p"], rows=rows(found))]),
            Section(tables=[Table(rows=facts, kind="words")]),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: plots(found, model, theme),
        command=command,
        footer=f"{found.trace.source} · truestroke {version('truestroke')}",
    )


def plots(found: Score, model: ActuatorModel, theme: Theme = LIGHT) -> dict[str, Figure]:
    """All, by name, in the order of the page."""
    view = _view(found, model)
    return {"loop": model_plots.loop(view, theme, "judged"), "error": _error(view, theme)}


def _view(found: Score, model: ActuatorModel) -> View:
    trace = found.trace
    judged = trace.judged
    at = trace.volts[judged]
    line = np.polyfit(at, trace.displacement[judged], 1 if np.ptp(at) else 0)
    return View(
        **vars(trace),
        model=model,
        error=np.where(trace.known, trace.residual, np.nan),
        line_error=np.where(trace.known, trace.displacement - np.polyval(line, trace.volts), np.nan),
        rate=central_difference(trace.predicted, trace.sample_rate),
        first=int(np.argmax(trace.held_out)),
        tested=judged,
    )


def _error(view: View, theme: Theme) -> Figure:
    """Error over time within its interval; against voltage and rate."""
    error, width = view.error[view.tested], view.half_width[view.tested]
    factor, unit = units.scaled_length(float(np.abs(error).max()))
    volts, volt = model_plots.volt_unit(view)
    speed, per_second = units.scaled_length(float(np.abs(view.rate).max()))
    with style.use(theme):
        figure = Figure(figsize=(style.WIDTH, 4.6), layout=style.Places(w_pad=0.05))
        panels = figure.subplot_mosaic("TT;VR", height_ratios=[1.1, 1])
        time = panels["T"]
        judged, start = slice(view.first, None), slice(0, view.first)
        time.fill_between(
            view.time[judged], -factor * view.half_width[judged], factor * view.half_width[judged],
            color=theme["grid"], lw=0, label="95 % interval",
        )  # fmt: skip
        style.zero(time, theme)
        if view.first and np.isfinite(view.error[start]).any():
            before = style.thin(view.time[start], factor * view.error[start])
            time.plot(*before, color=theme["before"], lw=0.7, ls="--", label="start, not judged")
        time.plot(
            *style.thin(view.time[judged], factor * view.error[judged]), color=theme["true"], lw=0.7, label="error"
        )
        limit = 1.15 * factor * max(float(np.abs(error).max()), float(np.percentile(width, 90)))
        time.set(xlabel="time (s)", ylabel=f"error ({unit})", xlim=(view.time[0], view.time[-1]), ylim=(-limit, limit))
        style.legend_above(time)
        model_plots.spread(panels["V"], volts * view.volts[view.tested], factor * error, theme)
        model_plots.spread(panels["R"], speed * view.rate[view.tested], factor * error, theme)
        panels["R"].sharey(panels["V"])
        panels["V"].set(title="Against voltage", xlabel=f"voltage ({volt})", ylabel=f"error ({unit})")
        panels["R"].set(title="Against rate", xlabel=f"rate ({per_second}/s)")
    return figure
