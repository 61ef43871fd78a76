"""The plots of a run, each a function of recordings alone that returns a matplotlib `Figure`.

Every function takes `theme`, one of `truestroke.report.style.THEMES`; `truestroke.report.save` writes the figure.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from truestroke.base.flags import BIT
from truestroke.base.typing import FloatArray
from truestroke.report import spectra, style, units
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.judgement import change_time
from truestroke.signals.metrics import judged
from truestroke.signals.recording import Recording

ZOOM = 0.5  # s


def displacement(recording: Recording) -> tuple[str, FloatArray]:
    """What the actuator did: ("true", um) where it was simulated, else ("measured", um)."""
    name = "true" if "true" in recording.channels else "measured"
    return name, recording[name]


def uncompensated(recording: Recording) -> Recording | None:
    """The same motion with a constant gain in place of the controller, where the recording has kept it.

    It is kept as the channel "uncompensated", um: the true displacement of that second run.
    """
    if "uncompensated" not in recording.channels:
        return None
    channels = {name: recording.channels[name] for name in ("time", "desired")}
    return Recording(channels | {"true": recording.channels["uncompensated"]}, recording.metadata)


def settled(recording: Recording) -> slice:
    """The second half of the run, which the metrics in the table are of."""
    ticks = recording["time"].size
    return slice(ticks // 2, ticks)


def zoom_window(recording: Recording, width: float = ZOOM) -> slice:
    """The ticks of `width` seconds around the largest error that counts in the second half, or all of a short one."""
    time, half = recording["time"], settled(recording)
    _, actual = displacement(recording)
    ticks = min(round(width / _step(time)), half.stop - half.start)
    error = np.where(judged(recording), np.abs(actual - recording["desired"]), 0.0)
    worst = half.start + int(np.nanargmax(error[half]))
    start = min(max(worst - ticks // 2, half.start), half.stop - ticks)
    return slice(start, start + ticks)


def tracking(recording: Recording, theme: Theme = LIGHT) -> Figure:
    """Desired and actual displacement: the whole run, and half a second around the largest error of its second half."""
    time, desired = recording["time"], recording["desired"]
    name, actual = displacement(recording)
    window = zoom_window(recording)
    with style.use(theme):
        figure, (whole, zoom) = style.panels(4.6, 2, height_ratios=[1, 1.35])
        for axes, part, wide in ((whole, slice(None), 1.6), (zoom, window, 3.2)):
            axes.plot(*style.thin(time[part], desired[part]), color=theme["desired"], lw=wide, label="desired")
            axes.plot(*style.thin(time[part], actual[part]), color=theme["true"], lw=1.0, label=name)
            _span(axes, time[part])
        start, stop = time[window][0], time[window][-1]
        whole.axvspan(start, stop, color=theme["alarm"], alpha=0.35, lw=0, zorder=1)
        whole.set(title="The whole run", ylabel="displacement (µm)")
        around = f"{start:.2f} to {stop:.2f} s: around the largest error of the second half (shaded above)"
        zoom.set(title=around, xlabel="time (s)", ylabel="displacement (µm)")
        style.legend_above(whole)
    return figure


def error(recording: Recording, convergence_time: float | None = None, theme: Theme = LIGHT) -> Figure:
    """Measured and true error against time: how it begins (um), and the whole run at the scale of its second half (nm).

    Parameters
    ----------
    recording : Recording
        The run.
    convergence_time : float, optional
        Marked where it is given, s.
    theme : Theme
        Colours.
    """
    time, desired = recording["time"], recording["desired"]
    names = [name for name in ("measured", "true") if name in recording.channels]
    errors = {name: recording[name] - desired for name in names}
    usual = _usual(recording)
    largest = max(float(np.nanmax(np.abs(e[usual]))) for e in errors.values())
    scale, unit = units.scaled_length(largest)
    begin = slice(0, max(2, round(_beginning(time, convergence_time) / _step(time))))
    with style.use(theme):
        figure, (first, whole) = style.panels(4.6, 2, height_ratios=[1, 1.35])
        for axes, part, factor in ((first, begin, 1.0), (whole, slice(None), scale)):
            style.zero(axes, theme)
            for name in names:
                axes.plot(*style.thin(time[part], factor * errors[name][part]), color=theme[name], lw=0.8, label=name)
            _span(axes, time[part])
        limit = 1.15 * scale * largest or 1.0
        first.set(title="How it begins", ylabel="error (µm)")
        title = f"The whole run at the scale of its second half{_off_scale(errors[names[-1]], limit / scale)}"
        whole.set(title=title, ylim=(-limit, limit), ylabel=f"error ({unit})", xlabel="time (s)")
        style.legend_above(first)
        if convergence_time:
            panel = first if convergence_time < first.get_xlim()[1] else whole
            _mark(panel, convergence_time, f"converged at {convergence_time:.2f} s", theme)
        _mark_change(whole, recording, theme)
    return figure


def settled_errors(recording: Recording) -> dict[str, FloatArray]:
    """Errors of the second half by name, "measured" and "true" where they are there, um."""
    half = settled(recording)
    names = [name for name in ("measured", "true") if name in recording.channels]
    return {name: (recording[name] - recording["desired"])[half] for name in names}


def spectrum(recording: Recording, theme: Theme = LIGHT) -> Figure:
    """The error of the second half: its spectral density (nm/sqrt(Hz), by Welch) and its histogram (% of the ticks)."""
    errors = {name: (name, error) for name, error in settled_errors(recording).items()}
    return spectra.spectrum(errors, 1.0 / _step(recording["time"]), theme)


def closer(recording: Recording) -> Chart:
    """Motion, error and voltage of a run, to zoom into."""
    time, desired = recording["time"], recording["desired"]
    moved = [name for name in ("measured", "true") if name in recording.channels]
    errors = {name: recording[name] - desired for name in moved}
    largest = max((float(np.nanmax(np.abs(e[settled(recording)]), initial=0.0)) for e in errors.values()), default=0.0)
    scale, unit = units.scaled_length(largest)
    displacements = [Line("desired", "desired", desired), *(Line(name, name, recording[name]) for name in moved)]
    panels = [
        Panel("displacement (µm)", displacements),
        Panel(f"error ({unit})", [Line(name, name, scale * error) for name, error in errors.items()]),
        Panel("voltage (V)", [Line("voltage", "true", recording["volts"])]),
    ]
    return Chart(panels, float(time[0]), _step(time))


def _usual(recording: Recording) -> NDArray[np.bool_]:
    """The ticks of the second half, without the quarter of a second after a sudden change: they set the scale."""
    ticks = np.zeros(recording["time"].size, bool)
    ticks[settled(recording)] = True
    change = change_time(recording)
    if change is not None:
        after = (recording["time"] >= change) & (recording["time"] < change + 0.25)
        ticks &= ~after if np.any(ticks & ~after) else ticks
    return ticks


def _mark_change(axes: Axes, recording: Recording, theme: Theme) -> None:
    """Where the simulated actuator was made to change suddenly."""
    change = change_time(recording)
    if change is not None:
        _mark(axes, change, f"sudden change at {change:g} s", theme, below=True)


def _step(time: FloatArray) -> float:
    return float(time[-1] - time[0]) / max(1, time.size - 1)


def _span(axes: Axes, time: FloatArray) -> None:
    """The x axis ends where the last tick ends."""
    axes.set_xlim(time[0], time[-1] + _step(time))


def _beginning(time: FloatArray, convergence_time: float | None) -> float:
    """How much of the run counts as its beginning, s."""
    wanted = 2.0 if convergence_time is None else min(max(1.0, 1.6 * convergence_time), 5.0)
    return min(float(time[-1] - time[0]), wanted)


def _off_scale(error: FloatArray, limit: float) -> str:
    largest = float(np.nanmax(np.abs(error)))
    return f" (off scale: up to {largest:.2g} µm)" if largest > limit else ""


def _mark(axes: Axes, at: float, text: str, theme: Theme, below: bool = False) -> None:
    """A vertical line at `at` seconds; its text at the top or bottom, in space added for it."""
    low, high = axes.get_ylim()
    room = 0.16 * (high - low)
    axes.set_ylim(low - room * below, high + room * (not below))
    axes.axvline(at, color=theme["text"], lw=0.9, ls=(0, (4, 3)))
    style.note(axes, text, (at, 0.0 if below else 1.0), theme, ("data", "axes fraction"))


def weights(recording: Recording, theme: Theme = LIGHT) -> Figure:
    """Learned weights against time, each line with its name at the right: weights a and b of the plays, other terms.

    Where there are many plays, some of their partial slopes replace the weights: they have the same meaning and are
    distinguishable.
    """
    time, rows = recording["weights_time"], _learned(recording)
    with style.use(theme):
        figure, axes = style.panels(2.6 * len(rows), len(rows), sharex=True)
        for panel, (label, names, lines) in zip(axes, rows, strict=True):
            for i, (name, line) in enumerate(zip(names, lines.T, strict=True)):
                look: dict[str, Any] = {"color": theme.series[i % style.SERIES], "lw": 1.2}
                look["ls"] = "-" if i < style.SERIES else (0, (5, 2))
                panel.plot(*style.thin(time, line, 400), label=subscript(name), **look)
            panel.set_ylabel(label)
            _span(panel, time)
            if panel is axes[0]:
                _mark_change(panel, recording, theme)
            style.legend_right(panel, lines[-1])
        axes[-1].set_xlabel("time (s)")
    return figure


MANY = 8  # plays that a picture can name


def _learned(recording: Recording) -> list[tuple[str, list[str], FloatArray]]:
    """Rows of the picture of weights: label of the axis, names of the lines, values (times, lines)."""
    values = recording["weights"]
    section = recording.metadata.get("controller")
    names = list(section.get("parameters") or ()) if isinstance(section, dict) else []
    if len(names) != values.shape[1]:  # a controller of a user
        names = [f"{letter}{i}" for i in range(values.shape[1] // 2) for letter in "ab"]
    groups = {
        letter: [i for i, name in enumerate(names) if name[0] == letter and name[1:].isdigit()] for letter in "ab"
    }
    rows = [("weights a (µm/V)", [names[i] for i in groups["a"]], values[:, groups["a"]])]
    if len(groups["a"]) > MANY and "partial_slopes" in recording.channels:
        slopes = recording["partial_slopes"]
        shown = np.unique(np.linspace(0, slopes.shape[1] - 1, MANY).round().astype(int))
        rows = [("partial slopes (µm/V)", [f"s{i}" for i in shown], slopes[:, shown])]
    if np.any(values[:, groups["b"]]):
        rows.append(("rate weights b (µm/V)", [names[i] for i in groups["b"]], values[:, groups["b"]]))
    for term, label in (("creep ", "creep (µm/V)"), ("duhem ", "states of Duhem (µm/V)")):
        places = [i for i, name in enumerate(names) if name.startswith(term)]
        if places:
            rows.append((label, [names[i].removeprefix(term) for i in places], values[:, places]))
    coupled = [i for i, name in enumerate(names) if name.startswith("coupling ")]
    if coupled:
        rows.append(("of other axes (µm/µm)", [names[i] for i in coupled], values[:, coupled]))
    return rows


def subscript(name: str) -> str:
    """A weight's name as in print, such as a₁₂; others as they are."""
    digits = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
    return name[0] + name[1:].translate(digits) if name[1:].isdigit() else name


def loop(before: Recording, after: Recording, theme: Theme = LIGHT, seconds: float = 2.0) -> Figure:
    """Displacement over desired displacement, without compensation and with it, over the last seconds of the runs."""
    with style.use(theme):
        figure, axes = style.panels(3.4, 1, 2, sharex=True, sharey=True)
        titles = ("Before: uncompensated", "After: compensated")
        for panel, recording, title, role in zip(axes, (before, after), titles, ("before", "true"), strict=True):
            time, desired = recording["time"], recording["desired"]
            name, actual = displacement(recording)
            part = time > time[-1] - seconds
            panel.axline((0, 0), slope=1, color=theme["desired"], lw=3.0, label="where it should be")
            panel.plot(desired[part], actual[part], color=theme[role], lw=0.9, label=f"{name} displacement")
            worst = f"largest error\n{units.length(float(np.nanmax(np.abs(actual - desired)[part])))}"
            panel.text(0.97, 0.05, worst, transform=panel.transAxes, ha="right", fontsize=9)
            panel.set(title=title, xlabel="desired displacement (µm)")
            panel.legend(loc="upper left", handlelength=1.4)
        low, high = zip(axes[0].get_xlim(), axes[0].get_ylim(), strict=True)
        limits = min(low), max(high)
        ticks = MaxNLocator(6).tick_values(*limits)[1:-1]
        axes[0].set(ylabel="displacement (µm)", xlim=limits, ylim=limits, xticks=ticks, yticks=ticks)
    return figure


def voltage(recording: Recording, limits: tuple[float, float] | None = None, theme: Theme = LIGHT) -> Figure:
    """Voltage against time with its limits (V, where given); ticks that met a limit are marked."""
    time, volts = recording["time"], recording["volts"]
    with style.use(theme):
        figure, (panel,) = style.panels(2.3)
        panel.plot(*style.thin(time, volts), color=theme["true"], lw=0.8, label="voltage at the D/A")
        for limit, label in zip(limits or (), ("limits", None), strict=False):
            panel.axhline(limit, color=theme["before"], lw=1.0, ls=(0, (4, 3)), label=label)
        flags = recording["flags"] if "flags" in recording.channels else np.zeros(time.size, np.uint8)
        saturated = (flags & BIT["saturated"]).astype(bool)
        if saturated.any():
            panel.plot(time[saturated], volts[saturated], ".", color=theme["before"], ms=4, label="limit met")
        _span(panel, time)
        panel.set(xlabel="time (s)", ylabel="voltage (V)")
        style.legend_above(panel)
    return figure
