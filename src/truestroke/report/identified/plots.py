"""The plots of an identified model: its loops, its residual, its weights."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from truestroke.base.typing import FloatArray
from truestroke.identification import Identified
from truestroke.model.layout import TERMS
from truestroke.report import plots as run_plots
from truestroke.report import spectra, style, units
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.identified.view import View, binned
from truestroke.report.style import LIGHT, Theme

MANY = 12  # letters of the labels of a panel of weights: more would meet, and are turned


def volt_unit(view: View) -> tuple[float, str]:
    """Factor and unit of voltages."""
    return units.scaled(max(abs(v) for v in view.model.voltage_range), "V")


def plots(found: Identified, theme: Theme = LIGHT) -> dict[str, Figure]:
    """All, by name, in the order of the page."""
    view = View.of(found)
    left = residual(view, found.autocorrelation, found.residual.size, theme)
    of_what = spectra.spectrum({"residual": ("true", tested(view))}, view.model.metrics["record_sample_rate_hz"], theme)
    return {"loop": loop(view, theme), "residual": left, "spectrum": of_what, "weights": weights(view, theme)}


def tested(view: View) -> FloatArray:
    """The error in the part that was held out, um; NaN in gaps."""
    return view.error[view.first :]


def closer(view: View) -> Chart:
    """Measured and predicted displacement, the residual and the voltage of a record, to zoom into."""
    factor, unit = units.scaled_length(float(np.nanmax(np.abs(view.error[view.tested]), initial=0.0)))
    volts, volt = volt_unit(view)
    shown = [Line("measured", "desired", view.displacement), Line("predicted", "true", view.predicted)]
    panels = [
        Panel("displacement (µm)", shown),
        Panel(f"residual ({unit})", [Line("residual", "true", factor * view.error)]),
        Panel(f"voltage ({volt})", [Line("voltage", "true", volts * view.volts)]),
    ]
    step = float(view.time[-1] - view.time[0]) / max(1, view.time.size - 1)
    return Chart(panels, float(view.time[0]), step)


def loop(view: View, theme: Theme = LIGHT, part: str = "held out") -> Figure:
    """Displacement over voltage in a part of the record: as it is, and the residual of a straight line."""
    rows = view.loops()
    x, z = view.volts[rows], view.displacement[rows]
    line = np.asarray(np.polyval(np.polyfit(view.volts, view.displacement, 1), x), dtype=np.float64)
    gap = np.where(np.isnan(view.error[rows]), np.nan, 0.0)
    volts, unit = volt_unit(view)
    with style.use(theme):
        figure, panels = style.panels(3.5, 1, 2)
        for panel, taken in zip(panels, (np.zeros_like(line), line), strict=True):
            factor, length = units.scaled_length(float(np.ptp(z - taken)))
            panel.plot(volts * x, factor * (z - taken + gap), color=theme["desired"], lw=2.4, label="measured")
            predicted = factor * (view.predicted[rows] - taken + gap)
            panel.plot(volts * x, predicted, color=theme["true"], lw=1.0, label="predicted")
            panel.set(xlabel=f"voltage ({unit})", ylabel=f"displacement ({length})")
        panels[0].set(title=f"{view.time[rows[0]]:.4g} to {view.time[rows[-1]]:.4g} s, {part}")
        panels[1].set(title="Without the straight line", ylabel=f"above the straight line ({length})")
        panels[0].legend(loc="upper left", handlelength=1.4)
    return figure


# ---- Residual ------------------------------------------------------------------------------------------------------


def residual(view: View, correlation: FloatArray, rows: int, theme: Theme = LIGHT) -> Figure:
    """Prediction error against time, voltage and rate; and the autocorrelation of the residual of the fit."""
    error = view.error[view.tested]
    factor, unit = units.scaled_length(float(np.abs(error).max()))
    volts, volt = volt_unit(view)
    speed, length = units.scaled_length(float(np.abs(view.rate).max()))
    with style.use(theme):
        figure = Figure(figsize=(style.WIDTH, 4.6), layout=style.Places(w_pad=0.05))
        panels = figure.subplot_mosaic("TTT;VRC", height_ratios=[1.1, 1])
        _against_time(panels["T"], view, factor, theme)
        spread(panels["V"], volts * view.volts[view.tested], factor * error, theme)
        spread(panels["R"], speed * view.rate[view.tested], factor * error, theme)
        panels["R"].sharey(panels["V"])
        _correlation(panels["C"], correlation, 1.96 / np.sqrt(rows), theme)
        panels["T"].set(xlabel="time (s)", ylabel=f"error ({unit})")
        panels["V"].set(title="Held out: against voltage", xlabel=f"voltage ({volt})", ylabel=f"error ({unit})")
        panels["R"].set(title="Held out: against rate", xlabel=f"rate ({length}/s)")
        _legend(panels["V"], 3)
    return figure


def _against_time(panel: Axes, view: View, factor: float, theme: Theme) -> None:
    """The whole record at the scale of its held-out part."""
    panel.axvspan(view.time[view.first], view.time[-1], color=theme["grid"], alpha=0.6, lw=0, zorder=0.5)
    style.zero(panel, theme)
    for part, colour, label in (
        (slice(0, view.first), theme["before"], "fitted part"),
        (slice(view.first, None), theme["true"], "held out (shaded)"),
    ):
        panel.plot(*style.thin(view.time[part], factor * view.error[part]), color=colour, lw=0.7, label=label)
    held_out, fitted = (factor * np.abs(view.error[part]) for part in (slice(view.first, None), slice(view.first)))
    limit = 1.1 * max(float(np.nanmax(held_out)), float(np.nanpercentile(fitted, 95))) or 1.0
    most = float(np.nanmax(fitted))
    title = f"The record (off scale: up to {units.length(most / factor)})" if most > limit else "The record"
    panel.set(title=title, xlim=(view.time[0], view.time[-1]), ylim=(-limit, limit))
    style.legend_above(panel)


def spread(panel: Axes, x: FloatArray, y: FloatArray, theme: Theme) -> None:
    """Median, 90 % and all of y in bins of x; every sample where there are few."""
    style.zero(panel, theme)
    centres, (least, low, middle, high, most) = binned(x, y)
    if centres.size < 4 or x.size < 1000:
        panel.plot(x, y, ".", color=theme["true"], ms=2.5, label="samples")
        return
    panel.fill_between(centres, least, most, color=theme["measured"], alpha=0.3, lw=0, label="all")
    panel.fill_between(centres, low, high, color=theme["measured"], alpha=0.8, lw=0, label="90 %")
    panel.plot(centres, middle, color=theme["true"], lw=1.4, label="median")


def _correlation(panel: Axes, c: FloatArray, band: float, theme: Theme) -> None:
    panel.axhspan(-band, band, color=theme["grid"], lw=0, label="95 % of white noise")
    style.zero(panel, theme)
    panel.plot(c, color=theme["true"], lw=1.0)
    bottom = min(-0.2, 1.1 * float(c.min()))
    panel.set(title="Fit: autocorrelation", xlabel="lag (samples)", xlim=(0, c.size - 1), ylim=(bottom, 1.05))
    _legend(panel, 1)


def _legend(panel: Axes, entries: int) -> None:
    """Above the lines, in space added for it."""
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.16 * (high - low))
    panel.legend(loc="upper right", ncols=entries, handlelength=1.2, fontsize=7, columnspacing=1.0, borderaxespad=0.0)


# ---- Weights -------------------------------------------------------------------------------------------------------


def weights(view: View, theme: Theme = LIGHT) -> Figure:
    """Each weight +- its standard deviation, by kind; faint the prior, where the record is hardly informative."""
    groups = _groups(view)
    above = 2 if len(view.model.thresholds) > 1 else 1
    with style.use(theme):
        figure = Figure(figsize=(style.WIDTH, 4.6), layout=style.Places(w_pad=0.05))
        grid = figure.add_gridspec(2, 1)
        for k, row in enumerate((groups[:above], groups[above:])):
            widths = [
                max(1.6 + (0.7 if group.labels else 0.4) * len(group.members), 0.5 + 0.3 * len(group.heading))
                for group in row
            ]
            parts = grid[k].subgridspec(1, len(row), width_ratios=widths)
            for j, group in enumerate(row):
                _bars(figure.add_subplot(parts[j]), view, group, theme)
        entries = {label: h for axes in figure.axes for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(list(entries.values()), list(entries), loc="outside upper right", ncols=3, handlelength=1.4)
    return figure


@dataclass(frozen=True)
class _Group:
    """Weights of one kind: heading, their places in the model, labels (None: at their thresholds), what is below."""

    heading: str
    members: list[int]
    labels: list[str] | None = None
    below: str = ""
    factor: float = 1.0


def _groups(view: View) -> list[_Group]:
    m, n = view.model, len(view.model.thresholds)

    def scaled(
        heading: str, members: list[int], labels: list[str] | None, unit: str = "m/V", si: float = 1e-6, below: str = ""
    ) -> _Group:
        largest = float((np.abs(m.weights) + m.deviations)[members].max())
        factor, unit = units.scaled(si * largest, unit)
        return _Group(f"{heading} ({unit})", members, labels, below, factor * si)

    groups = [scaled("a₀", [0], ["0"], below=f"threshold ({volt_unit(view)[1]})")]
    if n > 1:
        last = run_plots.subscript(f"a{n - 1}")
        groups.append(scaled(f"plays a₁ to {last}" if n > 2 else "play a₁", m.a[1:].tolist(), None))
    if m.rate_dependent:
        groups.append(scaled("rate b", m.b.tolist(), None))
    for name, term in TERMS.items():
        members = list(range(m.parameters))[m.columns[name]]
        if term.unit == "um/V" and members:
            groups.append(scaled("creep", members, [f"{tau:g}" for tau in m.creep_times], below="time constant (s)"))
        elif members:
            labels = [""] if term.most == 1 else [str(i + 1) for i in range(len(members))]
            groups.append(scaled(name, members, labels, term.unit.lstrip("u"), 1e-6 if term.unit == "um" else 1.0))
    return groups


def _bars(panel: Axes, view: View, group: _Group, theme: Theme) -> None:
    k, factor = group.members, group.factor
    w, deviation, from_prior = factor * view.model.weights[k], factor * view.model.deviations[k], view.from_prior()[k]
    mean, before = (factor * values[k] for values in view.prior())
    if group.labels is None:
        volts, unit = volt_unit(view)
        x = volts * np.array([view.model.thresholds[int(view.model.names[i][1:])] for i in k])
        panel.set_xlabel(f"threshold ({unit})")
    else:
        x = np.arange(len(k), dtype=np.float64)
        letters = sum(map(len, group.labels))
        panel.set_xticks(x, group.labels, fontsize=7 if letters > 8 else 8)
        if letters > MANY:
            panel.tick_params("x", labelrotation=45)
            for tick in panel.get_xticklabels():
                tick.set(ha="right", rotation_mode="anchor")
        panel.set_xlim(-0.6, len(k) - 0.4)
        panel.set_xlabel(group.below)
    style.zero(panel, theme)
    if from_prior.any():
        low, high = (mean - before)[from_prior], (mean + before)[from_prior]
        panel.vlines(x[from_prior], low, high, color=theme["desired"], alpha=0.55, lw=5.0, label="prior ± 1 s.d.")
    bar: dict[str, Any] = {"fmt": "o", "ms": 4, "color": theme["true"], "capsize": 2.5, "lw": 1.2}
    for kind, fill, label in ((~from_prior, theme["true"], "weight ± 1 s.d."), (from_prior, "none", "hardly informed")):
        if kind.any():
            panel.errorbar(x[kind], w[kind], deviation[kind], mfc=fill, label=label, **bar)
    panel.yaxis.set_major_locator(MaxNLocator(5))
    panel.set(title=group.heading)
