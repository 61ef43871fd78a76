"""The page of a waveform that was learned: the error of each pass, the last one, the harmonics."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.display import figures
from truestroke.control.repeating.iterative import Learned, Pass
from truestroke.report import spectra, style, units, words
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.page import Page, Section, Table, captioned, closer
from truestroke.report.style import LIGHT, Theme

CAPTIONS = {
    "passes": (
        "Passes",
        "Error of each pass where it counts, measured minus desired; dashed: the noise of a pass, the mean of its "
        "periods, which cannot be learned. A cross is a pass that was undone.",
    ),
    "period": (
        "One repetition",
        "Above: the desired motion. Below: the error of the first and of the best pass; shaded where it does not "
        "count, such as in the turns of a raster.",
    ),
    "harmonics": (
        "Harmonics",
        "Error of each harmonic that is learned, in the first and in the best pass; the dotted lines are the "
        "resonances. Histogram: how often each error of the best pass occurs, where errors count.",
    ),
}
WORDS = {"good": "The motion is as desired.", "doubtful": "Read this before you use it.", "bad": "Do not use it."}


def rows(found: Learned) -> list[list[str]]:
    """Pass, rmse, its share of the peak-to-peak, maximum, noise, remark."""
    span = float(np.ptp(found.learning.desired))
    made = []
    for one in found.passes:
        cells = ["-"] * 4
        if one.measured.size:
            lengths = map(units.length, (one.maximum, one.noise))
            cells = [units.length(one.rmse), f"{figures(100 * one.rmse / span, 2)} %", *lengths]
        remark = "undone" if one.undone else "best" if one is found.best else ""
        made.append([str(one.number), *cells, remark if one.measured.size else "missed"])
    return made


def as_dict(found: Learned) -> dict[str, object]:
    """For JSON: the passes, um, and what was learned of."""
    keys = ("number", "rmse", "maximum", "noise", "expected", "limited", "undone")
    units = {"rmse": "rmse_um", "maximum": "maximum_um", "noise": "noise_um", "expected": "expected_um"}
    rows = [{units.get(key, key): getattr(one, key) for key in keys} for one in found.passes]
    return {
        "passes": rows,
        "best_pass": found.best.number,
        "peak_to_peak_um": float(np.ptp(found.learning.desired)),
        "bandwidth_Hz": found.learning.bandwidth,
        "samples": found.learning.samples,
        "sensor_zero_um": found.zero,
        "spring": found.spring,
    }


def notes(found: Learned) -> list[str]:
    """Sentences on what was taken for granted: a stage that is a spring or late, a sensor's zero, its spikes."""
    return [note for note in (found.spring, _of_dead_time(found), words.zero(found.zero), _of_spikes(found)) if note]


def _of_dead_time(found: Learned) -> str:
    late = found.learning.dead_time
    if not late:
        return ""
    side = "later" if late > 0 else "earlier"
    return (
        f"The records of the first two passes turn {figures(1000 * abs(late), 2)} ms {side} than voltage and dynamics "
        "say: it was learned as a dead time."
    )


def _of_spikes(found: Learned) -> str:
    """Samples that were left out, in a sentence."""
    most = max(one.spikes for one in found.passes)
    if not most > 0:
        return ""
    share = f"{figures(100 * most, 2)} % of the samples of a pass"
    return f"Up to {share} were not as in the other periods, and did not count: look for spikes of the sensor."


def page(found: Learned, command: str | None = None) -> Page:
    """The page of a series of passes; `command` is what repeats it."""
    made, best = found.learning, found.best
    columns = ["pass", "rmse", "of p-p", "maximum", "noise", ""]
    span = float(np.ptp(made.desired))
    return Page(
        title=f"A motion of {span:.3g} um, learned in {len(found.passes)} passes",
        lead=f"Rmse {units.length(best.rmse)}, {figures(100 * best.rmse / span, 2)} % of peak-to-peak, from "
        f"{units.length(_first(found).rmse)}; harmonics to {made.bandwidth:.4g} Hz."
        + "".join(f" Note: {note}" for note in notes(found)),
        verdict=found.verdict,
        remark=WORDS[found.verdict.level],
        sections=[
            Section(tables=[Table(columns=columns, rows=rows(found), text=True)]),
            closer(chart(found)),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: plots(found, theme),
        command=command,
        footer=words.made_now(),
    )


def chart(found: Learned) -> Chart:
    """Motion, errors and voltages of the first and the best pass over one repetition, to zoom into."""
    made, shown = found.learning, _first_and_best(found)
    panels = [
        Panel("position (µm)", [Line("desired", "desired", made.desired),
                                *(Line(name, role, one.measured) for one, role, name in shown)]),
        *(_error_panel(*one) for one in shown),
        Panel("voltage (V)", [Line(name, role, one.volts) for one, role, name in shown]),
    ]  # fmt: skip
    factor, unit = units.scaled(made.samples / made.sample_rate, "s")
    return Chart(panels, 0.0, factor / made.sample_rate, f"time ({unit})")


def _error_panel(one: Pass, role: str, name: str) -> Panel:
    scale, unit = units.scaled_length(float(np.abs(one.error).max()) or 1.0)
    return Panel(f"{name}, error ({unit})", [Line(name, role, scale * one.error)])


def _first_and_best(found: Learned) -> list[tuple[Pass, str, str]]:
    """Passes that were measured, each with the role of its colour and its name."""
    return [(_first(found), "before", "first pass"), (found.best, "true", "best pass")]


def _first(found: Learned) -> Pass:
    """The first pass that was measured."""
    return next(one for one in found.passes if one.measured.size)


def plots(found: Learned, theme: Theme = LIGHT) -> dict[str, Figure]:
    """All of them by name, in the order of the page."""
    return {"passes": passes(found, theme), "period": period(found, theme), "harmonics": harmonics(found, theme)}


def passes(found: Learned, theme: Theme = LIGHT) -> Figure:
    """Rmse and maximum of each pass, and its noise."""
    made = [one for one in found.passes if one.measured.size]
    number = [one.number for one in made]
    factor, unit = units.scaled_length(min(one.rmse for one in made) or 1.0)
    with style.use(theme):
        figure, (panel,) = style.panels(3.0)
        panel.plot(number, [factor * one.maximum for one in made], "s-", color=theme.series[2], ms=4, label="maximum")
        panel.plot(number, [factor * one.rmse for one in made], "o-", color=theme["true"], ms=5, label="rmse")
        panel.plot(number, [factor * one.noise for one in made], "--", color=theme["muted"], lw=1.0, label="noise")
        undone = [one for one in made if one.undone]
        if undone:
            x, y = [one.number for one in undone], [factor * one.rmse for one in undone]
            panel.plot(x, y, "x", color=theme["alarm"], ms=9, label="undone")
        style.logarithmic(panel, "y")
        panel.set(xlabel="pass", ylabel=f"error ({unit})", xticks=number)
        style.legend_above(panel)
    return figure


def period(found: Learned, theme: Theme = LIGHT) -> Figure:
    """Desired motion and errors of the first and the best pass, over one repetition."""
    made, first, best = found.learning, _first(found), found.best
    samples = made.samples // made.periods if made.samples % made.periods == 0 else made.samples
    factor, unit = units.scaled(samples / made.sample_rate, "s")
    time = factor * np.arange(samples) / made.sample_rate
    part = slice(0, samples)
    with style.use(theme):
        figure, (motion, start, end) = style.panels(5.0, 3, sharex=True, height_ratios=[1, 1, 1])
        motion.plot(*style.thin(time, made.desired[part]), color=theme["desired"], lw=2.0, label="desired")
        for panel, one, role, label in ((start, first, "before", "first pass"), (end, best, "true", "best pass")):
            if one.measured.size:
                times, length = units.scaled_length(float(np.abs(one.error[part]).max()) or 1.0)
                panel.plot(*style.thin(time, times * one.error[part]), color=theme[role], lw=1.0, label=label)
                panel.set(ylabel=f"error ({length})")
        for panel in (motion, start, end):
            low, high = panel.get_ylim()
            panel.fill_between(time, low, high, where=~made.counts[part], color=theme["grid"], lw=0, zorder=0)
            panel.set_ylim(low, high)
            style.legend_above(panel)
        motion.set(ylabel="position (µm)")
        end.set(xlabel=f"time ({unit})")
    return figure


def harmonics(found: Learned, theme: Theme = LIGHT) -> Figure:
    """Amplitude of the error of each learned harmonic, first and best pass; how often the best one's errors occur."""
    made = found.learning
    f, learned = made.harmonics
    with style.use(theme):
        figure, (panel, sizes) = style.panels(3.0, 1, 2, width_ratios=[1.6, 1])
        for one, role, label in _first_and_best(found):
            amplitude = 2e3 * np.abs(np.fft.rfft(one.error))[learned] / made.samples
            panel.plot(f, np.maximum(amplitude, 1e-6), ".-", color=theme[role], ms=3, lw=0.8, label=label)
        _histogram(sizes, found, theme)
        for mode in made.dynamics.modes if made.dynamics else ():
            if mode.frequency < f[-1]:
                panel.axvline(mode.frequency, color=theme["muted"], lw=0.8, ls=":")
        style.logarithmic(panel, "xy")
        panel.set(xlabel="frequency (Hz)", ylabel="error (nm)")
        style.legend_above(panel)
    return figure


def _histogram(panel: Axes, found: Learned, theme: Theme) -> None:
    error = found.best.error[found.learning.counts]
    factor, unit = units.scaled_length(float(np.abs(error).max(initial=0.0)) or 1.0)
    spectra.histogram(panel, {"best pass": ("true", factor * error)}, theme)
    panel.set(xlabel=f"error ({unit})", ylabel="share of the samples (%)")
