"""Of what an error is made: its spectral density and its histogram, side by side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.report import style, units
from truestroke.report.style import Theme

SMALL = 0.1  # nm/sqrt(Hz): the largest density that is shown in pm/sqrt(Hz)
EDGES = {"left": 0.107, "right": 0.99, "bottom": 0.153, "top": 0.91, "wspace": 0.219}  # labels of six digits fit
BINS = 81  # of a histogram: one in the middle is around 0


def spectrum(errors: Mapping[str, tuple[str, FloatArray]], rate: float, theme: Theme) -> Figure:
    """Spectral density (nm/sqrt(Hz) or pm/sqrt(Hz), by Welch) and histogram (% of the samples) of errors.

    Parameters
    ----------
    errors : Mapping
        By name, the role of the colour in `style.ROLES`, and values, um; NaN of what is missing.
    rate : float
        Samples per second, Hz.
    theme : Theme
        Colours.
    """
    known = {name: _known(error) for name, (_, error) in errors.items()}
    scale, unit = units.scaled_length(max(float(np.abs(error).max(initial=0.0)) for error in known.values()))
    densities = {name: _density(1e3 * bridged(error), rate) for name, (_, error) in errors.items()}
    seen = np.concatenate([density[density > 0] for _, density in densities.values()])
    small = seen.size > 0 and seen.max() < SMALL
    seen = 1e3 * seen if small else seen
    with style.use(theme):
        figure, (of_frequency, of_size) = style.panels(3.0, 1, 2, edges=EDGES, width_ratios=[1.6, 1])
        for name, (frequency, density) in densities.items():
            shown = 1e3 * density if small else density
            of_frequency.plot(frequency, shown, color=theme[errors[name][0]], lw=0.9, label=name)
        of_frequency.set(
            xlabel="frequency (Hz)", ylabel=f"spectral density of the error ({'pm' if small else 'nm'}/√Hz)"
        )
        if seen.size:
            style.logarithmic(of_frequency, "xy")
            of_frequency.set_ylim(*_decades(seen))
        histogram(of_size, {name: (role, scale * known[name]) for name, (role, _) in errors.items()}, theme)
        of_size.set(xlabel=f"error ({unit})", ylabel="share of the samples (%)")
        style.legend_above(of_frequency)
    return figure


def _known(error: FloatArray) -> FloatArray:
    """Values that are there; no copy where all are."""
    there = np.isfinite(error)
    return error if there.all() else error[there]


def histogram(panel: Axes, errors: Mapping[str, tuple[str, FloatArray]], theme: Theme, bins: int = BINS) -> None:
    """How often each value occurs, % of the samples; `errors` as of `spectrum`, in the unit of the axis."""
    end = max(float(np.abs(error).max(initial=0.0)) for _, error in errors.values()) or 1.0
    edges = np.linspace(-end, end, bins + 1)
    for name, (role, error) in errors.items():
        share = np.histogram(error, edges)[0] / max(1, error.size)
        panel.stairs(100.0 * share, edges, color=theme[role], lw=1.2, label=name)


def bridged(error: FloatArray) -> FloatArray:
    """The error with straight lines where it is missing; the ends that are missing are left out.

    Examples
    --------
    >>> bridged(np.array([np.nan, 1.0, np.nan, np.nan, 4.0]))
    array([1., 2., 3., 4.])
    """
    known = np.flatnonzero(np.isfinite(error))
    if known.size in (0, error.size):
        return error[known]
    return np.interp(np.arange(known[0], known[-1] + 1), known, error[known])


def _density(error: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies, Hz, without 0, and amplitude spectral density, per sqrt(Hz), of means over segments by Welch."""
    if error.size < 4:
        return np.zeros(0), np.zeros(0)
    segment = min(error.size, max(256, error.size // 16))
    hann = np.hanning(segment + 1)[:-1]  # periodic
    starts = range(0, error.size - segment + 1, segment - segment // 2)
    power: FloatArray = np.zeros(segment // 2 + 1)
    # Not scipy.signal, whose import takes as long as all pictures of a page; matplotlib.mlab holds all segments.
    for start in starts:
        part = error[start : start + segment]
        power += np.abs(np.fft.rfft(hann * (part - part.mean()))) ** 2
    power *= 2 / (len(starts) * rate * np.sum(hann**2))
    if segment % 2 == 0:
        power[-1] /= 2
    return np.asarray(np.fft.rfftfreq(segment, 1 / rate)[1:]), np.sqrt(power[1:])


def _decades(values: FloatArray) -> tuple[float, float]:
    """The decades around positive values, six at most."""
    high = float(np.ceil(np.log10(values.max())))
    low = float(np.floor(np.log10(values.min())))
    return 10.0 ** max(min(low, high - 1.0), high - 6.0), 10.0**high
