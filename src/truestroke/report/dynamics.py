"""The page of measured dynamics: modes, what may be trusted, what motion the stage can follow, the Bode plot."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.display import figures, quantity
from truestroke.base.typing import FloatArray
from truestroke.control.feedback import Feedback, design
from truestroke.identification.dynamics import Bode
from truestroke.report import feedback, spectra, style, words
from truestroke.report.charts import Chart, Line, Panel
from truestroke.report.page import Page, Section, Table, captioned, closer
from truestroke.report.style import Theme

BoolArray = npt.NDArray[np.bool_]

CAPTIONS = {
    "bode": (
        "Bode plot",
        "From command to measurement: points are the multisine in bins of frequency, without the decay of what was "
        "before; the line is the model. Below them the coherence, and how far model and measurement differ; the band "
        "is what noise and distortion explain. The dotted lines are the modes; to the right of the shaded part the "
        "model is not to be trusted.",
    ),
    "errors": (
        "Histogram of the error",
        "How far the measurement is from the model, relative to the model, in each bin of frequency up to which the "
        "model is to be trusted: the real part is an error of the gain, the imaginary part one of the phase, 1 % for "
        "0.57 deg. A model that is right leaves noise, in a heap about 0.",
    ),
}
FEWER = 25  # bins of a histogram: a measurement has some hundred frequencies
WORDS = {
    "good": "The model describes the stage.",
    "doubtful": "Read this before you use the model.",
    "bad": "Do not use the model.",
}

ASSUMED = (
    " The sensor is assumed to have no lag or delay: none was stated, and a measurement shows those of both as one."
)


def rows(found: Bode, voltage_limits: tuple[float, float], slew: float) -> list[list[str]]:
    """Quantity, value with its standard deviation, remark; limits in V and V/s."""
    d = found.dynamics
    made = []
    for i, mode in enumerate(d.modes):
        damping = f"damping {_with(mode.damping, d.uncertainty.get(f'damping[{i}]'))}"
        share = f", share {mode.share:.3f}" if len(d.modes) > 1 else ""
        made.append(
            [f"mode {i + 1}", _with(mode.frequency, d.uncertainty.get(f"frequency[{i}]"), "Hz"), damping + share]
        )
    lag = _with(d.amplifier_bandwidth, d.uncertainty.get("amplifier_bandwidth"), "Hz")
    late = _with(1e6 * d.dead_time, 1e6 * d.uncertainty.get("dead_time", 0.0), "us")
    half = d.modes[0].frequency / 2
    most, reason = largest_sine(found, half, voltage_limits, slew)
    return [
        *made,
        ["amplifier", lag if d.amplifier_bandwidth else "no lag seen", "corner of a first-order lag"],
        ["dead time", late, f"{d.dead_time * d.sample_rate:z.2f} ticks"],
        _sensor(found),
        [
            "gain",
            f"{found.gain:.3g} um/V",
            f"of small motion; hysteresis: {np.degrees(found.loss):.1f} deg late at f0 / 10",
        ],
        ["trusted to", f"{d.trusted_to:.4g} Hz", "coherence above 0.9, model within 5 %"],
        ["motion", f"{most:.3g} um p-p", f"the largest sine at half the resonance, {half:.4g} Hz: {reason}"],
        _fed_back(bank_of(found, voltage_limits)),
    ]


def bank_of(found: Bode, voltage_limits: tuple[float, float]) -> Feedback:
    """The feedback that a controller with these dynamics would use in the loop that measured them; limits in V."""
    low, high = voltage_limits
    stroke = abs(found.gain) * (high - low)
    noise = min(found.record.noise, stroke) if np.isfinite(found.record.noise) else None
    return design(found.dynamics, latency=min(found.record.latency, 20), stroke=stroke, noise=noise)


def _sensor(found: Bode) -> list[str]:
    """The row of the sensor: what was stated of it, or what becomes of what was not."""
    d = found.dynamics
    lag = f"{figures(d.sensor_bandwidth)} Hz" if d.sensor_bandwidth else ""
    late = f"{figures(1e6 * d.sensor_delay)} us" if d.sensor_delay else ""
    if not lag and not late:
        return ["sensor", "assumed ideal", "lag and delay of it count as the stage's: see its data sheet"]
    other = "as stated" if lag and late else f"as stated; its {'delay' if lag else 'lag'} counts as the stage's"
    return ["sensor", ", ".join(filter(None, (lag, late))), other]


def _fed_back(bank: Feedback) -> list[str]:
    """The row of the feedback."""
    bandwidth = f"{figures(bank.bandwidth_hz)} Hz" if bank.filters else "none"
    return ["feedback", bandwidth, bank.summary if bank.filters else " ".join(bank.reasons)]


def largest_sine(found: Bode, frequency: float, voltage_limits: tuple[float, float], slew: float) -> tuple[float, str]:
    """Peak to peak, um, of the largest sine at a frequency, Hz, and what limits it.

    With the gain of small motion, which is smaller than that of large motion; limits in V and V/s.
    """
    low, high = voltage_limits
    swing, fast = (high - low) / 2, slew / (2 * np.pi * frequency)
    reason = f"slew of {slew:g} V/s" if fast < swing else f"voltage_limits of {low:g} and {high:g} V"
    response = float(np.abs(found.dynamics.continuous(frequency)))
    return 2 * found.gain * response * min(swing, fast), reason


def as_dict(found: Bode) -> dict[str, object]:
    """For JSON: the dynamics, and what was measured with units in the names."""
    return {
        "dynamics": found.dynamics.to_dict(),
        "gain_um_per_V": found.gain,
        "loss_rad": found.loss,
        "noise_um": found.record.noise,
        "bias_V": found.record.bias,
        "amplitude_V": float(np.abs(found.record.excitation.volts).max()),
    }


def page(found: Bode, voltage_limits: tuple[float, float], slew: float, command: str | None = None) -> Page:
    """The page of a measurement; limits in V and V/s; `command` is what repeats it."""
    d, wave, bank = found.dynamics, found.record.excitation, bank_of(found, voltage_limits)
    band = f"{figures(wave.frequency[0])} to {figures(wave.frequency[-1], 4)} Hz"
    peak = quantity(float(f"{np.abs(wave.volts).max():.3g}"), "V")
    columns = ["", "found", ""]
    return Page(
        title=f"Dynamics of a stage that rings at {d.modes[0].frequency:.4g} Hz",
        lead=f"A multisine of {peak} about {found.record.bias:.3g} V, {wave.volts.size / d.sample_rate:.2g} s: {band}.",
        verdict=found.verdict,
        remark=WORDS[found.verdict.level] + ASSUMED * (not (d.sensor_delay or d.sensor_bandwidth)),
        sections=[
            Section(tables=[Table(columns=columns, rows=rows(found, voltage_limits, slew), text=True)]),
            closer(chart(found)),
            *captioned(CAPTIONS | ({"margins": feedback.CAPTION} if bank.filters else {})),
        ],
        plots=lambda theme: plots(found, theme, bank),
        command=command,
        footer=words.made_now(),
    )


def chart(found: Bode) -> Chart:
    """Magnitude, phase, and difference of model and measurement, to zoom into; nothing where little is coherent."""
    seen = found.coherence > 0.5
    model, measured = _phases(found)
    panels = [
        Panel("magnitude (static = 1)", _points(np.abs(found.measured), np.abs(found.model), seen), logarithmic=True),
        Panel("phase (deg)", _points(measured, model, seen)),
        Panel("difference (%)", [Line("difference", "true", np.where(seen, 100 * found.residual, np.nan), points=True),
                                 Line("explained by noise", "muted", 200 * found.scatter)], logarithmic=True),
    ]  # fmt: skip
    return Chart(panels, label="frequency (Hz)", places=found.frequency)


def _points(measured: FloatArray, model: FloatArray, seen: BoolArray) -> list[Line]:
    return [Line("measured", "true", np.where(seen, measured, np.nan), points=True), Line("model", "before", model)]


def _phases(found: Bode) -> tuple[FloatArray, FloatArray]:
    """Of the model without jumps, and of the measurement beside it, deg."""
    model = np.degrees(np.unwrap(np.angle(found.model)))
    return model, model + np.degrees(np.angle(found.measured / found.model))


def plots(found: Bode, theme: Theme, bank: Feedback) -> dict[str, Figure]:
    """All of them by name, in the order of the page."""
    made = {"bode": bode(found, theme), "errors": errors(found, theme)}
    return made | ({"margins": feedback.margins(bank, found.dynamics, theme)} if bank.filters else {})


def bode(found: Bode, theme: Theme) -> Figure:
    """Magnitude, phase, coherence, and difference of model and measurement."""
    f, seen = found.frequency, found.coherence > 0.5
    with style.use(theme):
        figure, panels = style.panels(7.4, 4, sharex=True, height_ratios=[3, 2.2, 1.2, 1.6])
        magnitude, phase, coherence, residual = panels
        _both(magnitude, f, np.abs(found.measured), np.abs(found.model), seen, theme)
        unwrapped, beside = _phases(found)
        _both(phase, f, beside, unwrapped, seen, theme)
        coherence.plot(f, found.coherence, color=theme["true"], lw=1.2)
        coherence.set(ylabel="coherence", ylim=(0, 1.05))
        residual.fill_between(f, 1e-3, 200 * found.scatter, color=theme["grid"], lw=0, label="explained by noise")
        residual.plot(f[seen], 100 * found.residual[seen], ".", ms=3, color=theme["true"], label="difference")
        style.logarithmic(magnitude, "y")
        style.logarithmic(residual, "xy")
        lowest = 0.5 * float(np.abs(found.measured[seen]).min())
        magnitude.set(ylabel="magnitude (static = 1)", ylim=(max(lowest, 1e-3), 2 * float(np.abs(found.model).max())))
        phase.set(ylabel="phase (deg)", ylim=(float(unwrapped[seen].min()) - 30, 30))
        residual.set(ylabel="difference (%)", xlabel="frequency (Hz)", ylim=(0.05, 100))
        magnitude.legend(loc="lower left")
        residual.legend(loc="upper left", ncols=2)
        for panel in panels:
            panel.axvspan(f[0], found.dynamics.trusted_to, color=theme["grid"], alpha=0.35, lw=0, zorder=0)
            for mode in found.dynamics.modes:
                panel.axvline(mode.frequency, color=theme["muted"], lw=0.8, ls=":")
        residual.set_xlim(f[0], f[-1])
    return figure


def errors(found: Bode, theme: Theme) -> Figure:
    """Histogram of measurement over model less 1, up to where the model is to be trusted."""
    trusted = (found.coherence > 0.5) & (found.frequency <= found.dynamics.trusted_to)
    relative = 100 * (found.measured / found.model - 1)[trusted]
    parts = {"gain, real part": ("true", relative.real), "phase, imaginary part": ("before", relative.imag)}
    with style.use(theme):
        figure, (panel,) = style.panels(2.6)
        spectra.histogram(panel, parts, theme, FEWER)
        style.zero(panel, theme)
        panel.set(xlabel="measurement less model (%)", ylabel="share of the bins (%)")
        style.legend_above(panel)
    return figure


def _both(panel: Axes, f: FloatArray, measured: FloatArray, model: FloatArray, seen: BoolArray, theme: Theme) -> None:
    panel.plot(f[seen], measured[seen], ".", ms=3.5, color=theme["true"], label="measured")
    panel.plot(f, model, color=theme["before"], lw=1.2, label="model")


def _with(value: float, deviation: float | None, unit: str = "") -> str:
    """A value and its standard deviation, with the digits that it has.

    >>> _with(700.0123, 0.034, "Hz"), _with(0.0199, 0.0004), _with(5.0, None, "Hz")
    ('700.01 ± 0.03 Hz', '0.0199 ± 0.0004', '5 Hz')
    """
    if not deviation:
        return f"{value:.4g} {unit}".rstrip()
    digits = max(0, -int(np.floor(np.log10(deviation))))
    return f"{value:z.{digits}f} ± {deviation:.{digits}f} {unit}".rstrip()
