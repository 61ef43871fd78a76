"""The picture of a feedback's margins: open loop and sensitivity, for the page of the dynamics."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from truestroke.base.display import figures
from truestroke.control import feedback
from truestroke.control.feedback import GAINS, PEAK, Feedback
from truestroke.model.dynamics import Dynamics
from truestroke.report import style
from truestroke.report.style import LIGHT, Theme

CAPTION = (
    "Margins of the feedback",
    "The open loop from error to measurement, its phase where it matters (dashed: where feedback would amplify), and "
    "the sensitivity: how much of a load or of hum passes to the displacement. The band reaches to the largest for any "
    "gain from 0.7 to 1.3 of what the dynamics say, and any resonance within 5 %. The dotted lines are the modes.",
)
SMALLEST = 0.03  # of |L|: below it the phase does not matter


def margins(bank: Feedback, dynamics: Dynamics, theme: Theme = LIGHT) -> Figure:
    """Open loop in magnitude and phase with its margins, and the sensitivity, over frequency.

    Parameters
    ----------
    bank : Feedback
        Of `truestroke.control.feedback.design(dynamics, latency=..., stroke=...)`, with at least one filter.
    dynamics : Dynamics
        Of the same stage.
    theme : Theme
        `style.LIGHT`, `style.DARK`, or what a page asks for: `plots=lambda theme: {"margins": margins(bank, dynamics,
        theme)}` beside `captioned({"margins": CAPTION})`.
    """
    f = feedback.grid(dynamics, bank.hum, 600)
    f = f[f > 1e-4 * dynamics.sample_rate]
    L = bank.open_loop(dynamics, f)
    nominal, worst = bank.sensitivity(dynamics, f)
    phase = np.degrees(np.unwrap(np.angle(L)))
    matters = np.abs(L) > SMALLEST
    with style.use(theme):
        figure, panels = style.panels(6.4, 3, sharex=True, height_ratios=[1.3, 1.1, 1.1])
        size, angle, sensitivity = panels
        size.plot(f, np.abs(L), color=theme["true"], lw=1.2)
        size.axhline(1.0, color=theme["muted"], lw=0.8)
        angle.plot(f, np.where(matters, phase, np.nan), color=theme["true"], lw=1.2)
        for level in np.arange(-900.0, 541.0, 360.0):
            angle.axhline(level, color=theme["alarm"], lw=0.8, ls="--")
        sensitivity.fill_between(f, nominal, worst, color=theme["measured"], alpha=0.4, lw=0, label="largest")
        sensitivity.plot(f, nominal, color=theme["true"], lw=1.2, label="as measured")
        sensitivity.axhline(PEAK, color=theme["alarm"], lw=0.8, ls="--", label=f"{PEAK:g}, never above")
        style.logarithmic(size, "xy")
        style.logarithmic(sensitivity, "y")
        size.set(ylabel="open loop |L|", ylim=(SMALLEST / 3, 2 * float(np.abs(L).max())))
        seen = phase[matters] if matters.any() else phase
        angle.set(ylabel="its phase (deg)", ylim=(float(seen.min()) - 30, float(seen.max()) + 30))
        sensitivity.set(ylabel="sensitivity |S|", xlabel="frequency (Hz)", ylim=(0.01, 3.0))
        angle.yaxis.set_major_locator(MultipleLocator(180))
        size.set_title(_title(bank))
        style.legend_above(sensitivity)
        for panel in panels:
            for mode in dynamics.modes:
                panel.axvline(mode.frequency, color=theme["muted"], lw=0.8, ls=":")
        sensitivity.set_xlim(f[0], f[-1])
    return figure


def _title(bank: Feedback) -> str:
    low, high = GAINS
    return (
        f"gain margin {bank.gain_margin:.2g}, phase margin {bank.phase_margin:.0f} deg, largest |S| "
        f"{bank.sensitivity_peak:.2f} for gains of {low:g} to {high:g}, bandwidth {figures(bank.bandwidth_hz)} Hz"
    )
