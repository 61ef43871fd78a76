"""Make the picture of each example anew, light and dark: `python examples/pictures.py [NUMBER...]`; half a minute."""

from __future__ import annotations

import contextlib
import io
import runpy
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import truestroke
from truestroke.base.files import overwriting
from truestroke.report import style
from truestroke.report.style import Theme

HERE = Path(__file__).parent
FOLDER = HERE.parent / "docs/images/examples"
Names = Mapping[str, Any]  # what the script has named
HEIGHT = 4.2  # in


class Logged(truestroke.AdaptiveController):
    """The controller, which remembers what it is asked and what it is given."""

    def command(self, z_d: float, zdot_d: float) -> float:
        self.desired = [*getattr(self, "desired", []), z_d]
        return super().command(z_d, zdot_d)

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        self.measured = [*getattr(self, "measured", []), z_measured]
        super().adapt(z_measured, ago)


def tracked(time: Any, desired: Any, shown: Any, theme: Theme, words: str) -> Figure:
    """The motion, and its error below."""
    figure, (above, below) = style.panels(HEIGHT, 2, sharex=True)
    above.plot(time, desired, color=theme["desired"], lw=3.0, label="desired")
    above.plot(time, shown, color=theme["true"], lw=1.0, label=words)
    below.plot(time, 1e3 * (np.asarray(shown) - np.asarray(desired)), color=theme["true"], lw=0.8)
    style.zero(below, theme)
    above.set_ylabel("displacement (µm)")
    below.set(ylabel="error (nm)", xlabel="time (s)")
    style.legend_above(above)
    return figure


def of_recording(names: Names, theme: Theme, channel: str = "true") -> Figure:
    """The motion of the script's recording."""
    recording = names["recording"]
    return tracked(recording["time"], recording["desired"], recording[channel], theme, channel)


def by_hand(names: Names, theme: Theme) -> Figure:
    """The first ticks, in which the gain is learned."""
    controller, shown = names["controller"], slice(0, 100)
    desired, measured = np.array(controller.desired)[shown], np.array(controller.measured)[shown]
    return tracked(np.arange(desired.size) / 2000.0, desired, measured, theme, "measured")


def own_actuator(names: Names, theme: Theme) -> Figure:
    """An actuator that has no true displacement."""
    return of_recording(names, theme, "measured")


def model(names: Names, theme: Theme) -> Figure:
    """The record, and what the model makes of its voltage."""
    figure, (axes,) = style.panels(HEIGHT)
    axes.plot(names["volts"], names["z"], color=theme["measured"], lw=3.0, label="record")
    predicted = names["found"].model.predict(names["volts"], 2000.0)
    axes.plot(names["volts"], predicted, color=theme["true"], lw=0.9, label="model")
    axes.set(xlabel="voltage (V)", ylabel="displacement (µm)")
    style.legend_above(axes)
    return figure


def waveform(names: Names, theme: Theme) -> Figure:
    """The motion that is wanted, that is predicted, and the voltage."""
    made, motion = names["made"], names["motion"]
    time = np.arange(made.volts.size) / motion.sample_rate
    figure, (above, below) = style.panels(HEIGHT, 2, sharex=True)
    above.plot(time, motion.position, color=theme["desired"], lw=3.0, label="desired")
    above.plot(time, made.predicted, color=theme["true"], lw=1.0, label="predicted")
    below.plot(time, made.volts, color=theme["text"], lw=1.0)
    above.set_ylabel("displacement (µm)")
    below.set(ylabel="voltage (V)", xlabel="time (s)")
    style.legend_above(above)
    return figure


def thousands(names: Names, theme: Theme) -> Figure:
    """Each run a dot."""
    figure, (axes,) = style.panels(HEIGHT)
    gains, top = (0.6, 1.0, 1.4), 1.15e3 * max(names["errors"])
    for k, errors in enumerate(np.reshape(names["errors"], (3, 20))):
        spread = k + np.linspace(-0.2, 0.2, errors.size)
        axes.plot(spread, 1e3 * errors, "o", ms=5, color=theme.series[k])
    axes.set(
        ylabel="true rmse (nm)",
        xlabel="sensitivity of the stack, relative",
        xticks=range(3),
        ylim=(0, top),
    )
    axes.set_xticklabels([f"{gain:g}" for gain in gains])
    return figure


def beside(names: Names, theme: Theme) -> Figure:
    """A bar for each law."""
    figure, (axes,) = style.panels(3.0)
    words = [row.controller for row in names["rows"]]
    errors = [1e3 * row.summary.true_rmse_um for row in names["rows"]]
    bars = axes.barh(words, errors, color=[theme["before"], theme["true"]])
    axes.bar_label(bars, fmt="%.2g nm", padding=4, color=theme["text"], fontsize=8)
    axes.grid(axis="y", visible=False)
    axes.set(xlabel="true rmse (nm)", xlim=(0, 1.15 * max(errors)))
    axes.invert_yaxis()
    return figure


def sensor(names: Names, theme: Theme) -> Figure:
    """The run, with the half second in which the sensor gives nothing."""
    figure = of_recording(names, theme)
    for axes in figure.axes:
        axes.axvspan(2.0, 2.5, color=theme["grid"], alpha=0.7, lw=0, zorder=0.5)
    place = figure.axes[1].get_xaxis_transform()
    figure.axes[1].text(2.25, 0.9, "no sensor", transform=place, fontsize=8, ha="center", va="top")
    return figure


def step(names: Names, theme: Theme) -> Figure:
    """The step of the loop."""
    figure, (axes,) = style.panels(HEIGHT)
    time = 1e3 * (names["time"] - 0.05)
    axes.plot(time, np.where(time > 0, 10.0, 0.0), color=theme["desired"], lw=3.0, label="desired")
    axes.plot(time, names["z"], color=theme["true"], lw=1.0, label="measured")
    axes.set(xlabel="time after the step (ms)", ylabel="displacement (µm)", xlim=(-10, 80))
    style.legend_above(axes)
    return figure


def plays(names: Names, theme: Theme) -> Figure:
    """What each number of plays does not explain."""
    figure, (axes,) = style.panels(HEIGHT)
    missing = 100 * (1 - names["search"].cv_results_["mean_test_score"])
    count = [len(thresholds) for thresholds in names["grid"]["thresholds"]]
    plot_missing(axes, count, missing, theme)
    return figure


def plot_missing(axes: Axes, count: list[int], missing: Any, theme: Theme) -> None:
    """Per cent of the variance, over the number of plays."""
    axes.semilogy(count, missing, "o-", color=theme["true"])
    axes.set(xlabel="plays", ylabel="variance not explained (%)", xticks=count)
    axes.yaxis.set_major_formatter("{x:g}")


PICTURES: dict[str, Callable[[Names, Theme], Figure]] = {
    **{"01": of_recording, "02": by_hand, "03": of_recording, "04": own_actuator, "05": model, "06": waveform},
    **{"07": thousands, "08": beside, "09": sensor, "10": of_recording, "11": step, "12": plays},
}


def main(*numbers: str) -> None:
    """Run the scripts, and plot."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    truestroke.AdaptiveController = Logged  # type: ignore[misc]
    for number in numbers or PICTURES:
        (script,) = HERE.glob(f"{number}_*.py")
        with contextlib.redirect_stdout(io.StringIO()):
            names = runpy.run_path(str(script))
        for theme in (style.LIGHT, style.DARK):
            with style.use(theme):
                style.save(PICTURES[number](names, theme), FOLDER / f"{script.stem}-{theme.name}.png")


if __name__ == "__main__":
    with overwriting():  # those in the repository
        main(*sys.argv[1:])
