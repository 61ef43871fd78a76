"""The picture of a waveform that a model made."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.identification import PredictedWaveform, Span
from truestroke.report import style
from truestroke.report.style import LIGHT, Theme


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
