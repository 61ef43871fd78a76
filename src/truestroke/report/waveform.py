"""The page and the picture of a waveform that a model made."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.control.actuator import ActuatorModel
from truestroke.identification import PredictedWaveform, Span
from truestroke.report import style, units, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme

CAPTIONS = {
    "waveform": (
        "The waveform",
        "Voltage, desired and predicted displacement, and their difference; shaded where a limit holds the voltage "
        "back. The error of the model itself is not in it.",
    )
}
REMARKS = {
    "good": "As far as the model knows, this voltage makes the motion.",
    "doubtful": "Read this before you output it.",
    "bad": "Do not output it for this motion.",
}


def page(
    made: PredictedWaveform, model: ActuatorModel, rows: Sequence[Sequence[str]], command: str | None = None
) -> Page:
    """The page of a waveform of `model`; `rows` are its errors, `command` is what makes it again."""
    volts, span = made.volts, float(np.ptp(made.desired))
    facts = [
        ("voltage", f"{volts.min():.4g} to {volts.max():.4g} V, begins at {volts[0]:.4g} V"),
        ("duration", f"{made.duration:g} s, {volts.size:,} samples at {made.sample_rate:g} Hz"),
        *(("note", warning) for warning in made.warnings),
        ("model", f"of {model.provenance.get('source') or 'a record without a name'}"),
    ]
    return Page(
        title=f"A voltage for a motion of {span:.3g} µm",
        lead=f"The model predicts the motion to {units.length(made.rmse)} rms, {units.length(made.maximum)} at most.",
        verdict=made.verdict,
        remark=REMARKS[made.verdict.level],
        sections=[
            Section(tables=[Table(columns=["predicted", "", "of p-p"], rows=rows)]),
            Section(tables=[Table(rows=facts, kind="words")]),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: {"waveform": waveform(made, theme)},
        command=command,
        footer=words.made_now(),
    )


def waveform(made: PredictedWaveform, theme: Theme = LIGHT) -> Figure:
    """Voltage, desired and predicted displacement, their difference; shaded where a limit holds the voltage back."""
    error = 1e3 * (made.predicted - made.desired)
    with style.use(theme):
        figure, panels = style.panels(5.6, 3, sharex=True, height_ratios=[1, 1.3, 0.8])
        volts, motion, difference = panels
        volts.plot(*style.thin(made.time, made.volts), color=theme["text"], lw=1.0, label="voltage")
        motion.plot(*style.thin(made.time, made.desired), color=theme["desired"], lw=3.0, label="desired")
        motion.plot(*style.thin(made.time, made.predicted), color=theme["true"], lw=1.0, label="predicted")
        difference.plot(*style.thin(made.time, error), color=theme["true"], lw=1.0, label="predicted minus desired")
        shade(volts, made.out_of_reach, theme["alarm"], "out of reach")
        shade(volts, made.too_fast, theme.series[4], "too fast")
        volts.set(ylabel="voltage (V)")
        motion.set(ylabel="displacement (µm)")
        difference.set(ylabel="error (nm)", xlabel="time (s)")
        for panel in panels:
            style.legend_above(panel)
    return figure


def shade(axes: Axes, spans: tuple[Span, ...], colour: str, words: str) -> None:
    """Shade the spans, with one entry of the legend."""
    for i, span in enumerate(spans):
        axes.axvspan(span.start, span.stop, color=colour, alpha=0.4, lw=0, label=words if i == 0 else None, zorder=0.5)
