"""The set-up of the paper's figures: one controller, two plants, fixed seeds, windows of time, one picture."""

import dataclasses
from collections.abc import Sequence
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.control.controller import AdaptiveController
from truestroke.control.settings import ControllerSettings
from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant
from truestroke.report import style
from truestroke.runtime.loop import run
from truestroke.signals import metrics
from truestroke.signals.recording import Channel, Recording
from truestroke.signals.trajectories import random_wave, sine
from truestroke.studies.paper.reproduction import Row
from truestroke.studies.tracking import STROKE, VOLTAGE_LIMITS

SEEDS = range(5)  # the paper's five waves; the first of them is plotted
SETTINGS = ControllerSettings.paper(sample_rate=2000.0, stroke=STROKE, voltage_limits=VOLTAGE_LIMITS)
CHANGE = MatchedSettings(change=Change(time=2.5), weight_spread=0.3)  # Sec. 4.2: all weights redrawn within 30 %


# ---- Runs; each is made once ---------------------------------------------------------------------------------------


@cache
def sine_run(frequency: float, settings: PlantSettings = PlantSettings()) -> Recording:  # noqa: B008 (it is frozen)
    """Table 1 and Fig. 10: a sine of `frequency` Hz and 22.8 um on the realistic plant, 20 s."""
    return run(sine(frequency=frequency), AdaptiveController.from_settings(SETTINGS), RealisticPlant(settings))


@cache
def random_run(seed: int, settings: PlantSettings = PlantSettings()) -> Recording:  # noqa: B008
    """Table 2 and Figs. 11 to 13: the 20 Hz wave of 28.6 um on the realistic plant, 20 s."""
    controller = AdaptiveController.from_settings(SETTINGS)
    return run(random_wave(seed=seed), controller, RealisticPlant(settings, seed=seed))


@cache
def simulated_run(seed: int, settings: MatchedSettings = MatchedSettings()) -> Recording:  # noqa: B008
    """Figs. 6 to 8: the wave within 300 um/s of Sec. 4.3 on the matched plant, 20 s."""
    wave = random_wave(seed=seed, velocity_limit=300.0)
    controller = AdaptiveController.from_settings(SETTINGS)
    return run(wave, controller, MatchedPlant(wave.velocity, settings, seed=seed))


# ---- Windows of time -----------------------------------------------------------------------------------------------


def between(recording: Recording, start: float, stop: float) -> Recording:
    """The part of a recording from `start` to `stop`, s."""

    def kept(channel: Channel) -> Channel:
        time = recording[channel.time]
        return dataclasses.replace(channel, data=channel.data[(time > start - 1e-9) & (time < stop - 1e-9)])

    channels = {name: kept(channel) for name, channel in recording.channels.items()}
    return Recording(channels, recording.metadata)


def rmse(recording: Recording, start: float, stop: float, channel: str = "measured") -> float:
    """Of the measured or the true displacement from `start` to `stop` s, um."""
    part = between(recording, start, stop)
    return metrics.rmse(part["desired"], part[channel])


def maximum(recording: Recording, start: float, stop: float, channel: str = "measured") -> float:
    """Largest error of the measured or the true displacement from `start` to `stop` s, um."""
    part = between(recording, start, stop)
    return metrics.maximum_error(part["desired"], part[channel])


def settling_time(recording: Recording, slopes: int, tolerance: float = 0.05) -> float:
    """Time after which the first `slopes` partial sums of a stay within `tolerance` of what they end with, s."""
    sums = np.cumsum(recording["weights"][:, 0::2], axis=1)[:, :slopes]
    out = np.flatnonzero((np.abs(sums / sums[-1] - 1) > tolerance).any(axis=1))
    return float(recording["weights_time"][out[-1] + 1]) if out.size else 0.0


def settling(runs: Sequence[Recording], slopes: int) -> float:
    """Mean of `settling_time` over the runs, s."""
    return float(np.mean([settling_time(run, slopes) for run in runs]))


def window(
    runs: Sequence[Recording],
    start: float,
    stop: float,
    metric: str = "rmse",
    *,
    channel: str = "measured",
    paper: float | None = None,
    digits: int = 3,
) -> Row:
    """The row of rmse or maximum of a channel from `start` to `stop` s, mean over the runs, beside the paper's, um."""
    of = {"rmse": rmse, "maximum": maximum}[metric]
    ours = float(np.mean([of(run, start, stop, channel) for run in runs]))
    name = f"{'true ' if channel == 'true' else ''}{metric}, {start:g} to {stop:g} s"
    return Row(name, paper, ours, "um", digits)


# ---- The picture of a run ------------------------------------------------------------------------------------------


def picture(recording: Recording, start: float, stop: float, theme: style.Theme) -> Figure:
    """Desired and true displacement, and below the measured and the true error, from `start` to `stop` s."""
    part = between(recording, start, stop)
    time, desired = part["time"], part["desired"]
    errors = {name: part[name] - desired for name in ("measured", "true")}
    unit, factor = ("nm", 1e3) if np.ptp(errors["measured"]) < 4 else ("µm", 1.0)
    with style.use(theme):
        figure, (above, below) = style.panels(4.4, 2, sharex=True, height_ratios=[1.3, 1])
        above.plot(*style.thin(time, desired), color=theme["desired"], lw=3.0, label="desired")
        above.plot(*style.thin(time, part["true"]), color=theme["true"], lw=1.0, label="true")
        for name, error in errors.items():
            below.plot(*style.thin(time, factor * error), color=theme[name], lw=0.9, label=name)
        style.zero(below, theme)
        above.set_ylabel("displacement (µm)")
        below.set(ylabel=f"error ({unit})", xlabel="time (s)", xlim=(start, stop))
        style.legend_above(above)
        style.legend_above(below)
    return figure


def adapted(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """The weights a and b of (21) that a run ends with, shape (8,) each, um/V."""
    weights: FloatArray = recording["weights"][-1]
    return weights[0::2], weights[1::2]
