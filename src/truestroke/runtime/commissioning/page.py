"""The page of an axis that was commissioned, with its plots: first steps, step response, ringing, whole range."""

import numpy as np
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.report import style, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import Theme
from truestroke.runtime.commissioning.findings import Findings

CAPTIONS = {
    "steps": (
        "The first steps",
        "Voltage from the safe voltage up and back, in steps that grow until the response is clear, and the "
        "displacement. Both must go the same way.",
    ),
    "answer": (
        "Step response",
        "The first of the steps that ring, at time 0, and a stage with one resonance behind a lag and a delay, fitted "
        "to all of them. Look for points that leave the line.",
    ),
    "ringing": (
        "Ringing",
        "How fast the axis moves at each frequency in the same steps. The peak is the first resonance, where known.",
    ),
    "range": (
        "The whole range",
        "Slowly to the voltage limits and back. The loop is hysteresis; the band is the stroke.",
    ),
}
WORDS = {"good": "The axis responds as configured.", "doubtful": "Read this before you use the axis."}


def page(found: Findings, written: list[str], command: str) -> Page:
    """The page of an axis: the lines `written` into its configuration, and the command that repeats it."""
    lines = [line.split(" = ", 1) for line in written] or [["-", "nothing: the configuration is as it was"]]
    keys = [["written", *line] for line in lines]
    safe, verdict = found.limits.get("safe_voltage", 0.0), found.verdict()
    low, high = found.limits["voltage_limits"]
    return Page(
        title=f"Axis {found.name}, commissioned",
        lead=f"Steps of up to {found.small.gain.step:.3g} V from {safe:g} V, then slowly to {high:g} and {low:g} V.",
        verdict=verdict,
        remark=WORDS[verdict.level],
        sections=[
            Section(tables=[Table(columns=["", "found", ""], rows=[*found.rows(), *keys], text=True)]),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: plots(found, theme),
        command=command,
        footer=words.made_now(),
    )


BEFORE, AFTER = 0.01, 0.1  # s about the step that is shown


def plots(found: Findings, theme: Theme) -> dict[str, Figure]:
    """All of them by name, in the order of the page."""
    return {
        "steps": steps(found, theme),
        "answer": answer(found, theme),
        "ringing": ringing(found, theme),
        "range": whole(found, theme),
    }


def steps(found: Findings, theme: Theme) -> Figure:
    """Voltage and displacement of the steps that grow."""
    record, rate = found.small.steps, found.small.timing.sample_rate
    t = np.arange(record.volts.size) / rate
    with style.use(theme):
        figure, (volts, z) = style.panels(4.2, 2, sharex=True, height_ratios=[1, 2])
        volts.plot(*style.thin(t, 1e3 * record.volts), color=theme["measured"], lw=1.0)
        z.plot(*style.thin(t, record.z - found.small.rest.zero), color=theme["true"], lw=0.8)
        volts.set(ylabel="voltage (mV)")
        z.set(xlabel="time (s)", ylabel="displacement (µm)")
    return figure


def answer(found: Findings, theme: Theme) -> Figure:
    """The first steps that ring, with what the fit says of them."""
    record, rate = found.small.ringing, found.small.timing.sample_rate
    edges = np.flatnonzero(np.diff(record.volts)) + 1
    first = int(edges[0])
    part = slice(max(first - round(BEFORE * rate), 0), first + round(AFTER * rate) + round(found.small.latency))
    t = 1e3 * (np.arange(record.volts.size)[part] - first) / rate
    with style.use(theme):
        figure, (axes,) = style.panels(3.4)
        measured, fit = (z[part] - found.small.rest.zero for z in (record.z, found.small.resonance.fit))
        axes.plot(t, measured, ".", ms=3, color=theme["true"], label="measured")
        axes.plot(t, fit, lw=1.2, color=theme["measured"], label="fit")
        axes.axvline(0.0, color=theme["muted"], lw=0.8, ls=":")
        axes.set(xlabel="time from the step (ms)", ylabel="displacement (µm)")
        axes.legend(loc="lower right")
    return figure


def ringing(found: Findings, theme: Theme) -> Figure:
    """How fast the displacement moves at each frequency, of the record and of the fit."""
    frequency, measured = spectrum(found.small.ringing.z, found.small.timing.sample_rate)
    _, fitted = spectrum(found.small.resonance.fit, found.small.timing.sample_rate)
    known = found.small.resonance.frequency
    with style.use(theme):
        figure, (axes,) = style.panels(3.4)
        axes.loglog(frequency, measured, color=theme["true"], lw=1.2, label="measured")
        axes.loglog(frequency, fitted, color=theme["before"], lw=0.9, ls="--", label="fit")
        axes.set_ylim(0.3 * measured.min(), 4 * measured.max())
        if known is not None:
            axes.axvline(known, color=theme["muted"], lw=0.8, ls=":")
            corner = (known, 2 * measured.max())
            axes.annotate(f"{known:.4g} Hz", corner, (4, 0), textcoords="offset points", fontsize=8)
        axes.set(xlabel="frequency (Hz)", ylabel="velocity (µm/s, rms)")
        axes.legend(loc="lower left")
    return figure


def spectrum(z: FloatArray, sample_rate: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies, Hz, and rms velocity at each, um/s; lost samples are bridged."""
    from scipy.signal import welch

    used = np.isfinite(z)
    k = np.arange(z.size)
    velocity = np.diff(np.interp(k, k[used], z[used])) * sample_rate
    frequency, power = welch(velocity, sample_rate, nperseg=max(z.size // 6, 16), scaling="spectrum")
    return np.asarray(frequency[2:]), np.sqrt(np.maximum(power[2:], 1e-30))


def whole(found: Findings, theme: Theme) -> Figure:
    """Displacement over voltage, to the limits and back."""
    path, late = found.whole.path, max(round(found.small.latency), 0)
    volts, z = path.volts[: path.volts.size - late], path.z[late:]
    with style.use(theme):
        figure, (axes,) = style.panels(3.8)
        every = max(volts.size // 3000, 1)
        axes.plot(volts[::every], z[::every], color=theme["true"], lw=1.0)
        if found.stroke is not None:
            axes.axhspan(0.0, found.stroke, color=theme["grid"], lw=0, zorder=0)
            corner = (volts.min(), found.stroke)
            axes.annotate(f"stroke {found.stroke:g} µm", corner, (0, 3), textcoords="offset points", fontsize=8)
        axes.set(xlabel="voltage (V)", ylabel="displacement (µm)")
    return figure
