"""Pictures of recordings and models where a notebook shows them."""

import base64
import html
import io
from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

from truestroke.identification import Identified
from truestroke.report import plots, style
from truestroke.report.identified import plots as identified_plots
from truestroke.report.identified.view import View
from truestroke.report.style import DARK, LIGHT, Theme
from truestroke.signals.recording import Recording

SHARPNESS = 110  # dots per inch
LEAST = 10  # ticks


def recording(shown: Recording) -> str:
    """HTML of the tracking of a run; "" of a recording that has none."""
    needed = {"time", "desired", "measured"}
    if not needed <= set(shown.channels) or shown["time"].size < LEAST:
        return ""
    _, actual = plots.displacement(shown)
    if not np.isfinite(actual[plots.settled(shown)]).any():
        return ""
    return picture(lambda theme: plots.tracking(shown, theme), "desired and actual displacement of the run")


def identified(found: Identified) -> str:
    """HTML of the hysteresis of the record and the model."""
    view = View.of(found)
    return picture(
        lambda theme: identified_plots.loop(view, theme), "displacement over voltage, measured and predicted"
    )


def picture(plot: Callable[[Theme], Figure], words: str) -> str:
    """A plot as HTML that follows the reader's choice of light or dark; `words` are for who cannot see it."""
    light, dark = (_encoded(plot(theme)) for theme in (LIGHT, DARK))
    return (
        f'<picture><source media="(prefers-color-scheme: dark)" srcset="{dark}">'
        f'<img alt="{html.escape(words)}" style="max-width: 100%" src="{light}"></picture>'
    )


def _encoded(figure: Figure) -> str:
    file = io.BytesIO()
    with style.placed(figure, SHARPNESS):
        figure.savefig(file, format="png", dpi=SHARPNESS, metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
