"""Tables, verdict, pictures and page of a characterisation."""

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.report import style, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import Theme
from truestroke.signals import judgement
from truestroke.signals.recording import Recording
from truestroke.studies.characterisation.lines import MIN_PASSES, RATE_SCALE, TOLERANCE, Characterisation

CAPTIONS = {
    "weights": (
        "Weights against velocity",
        "Fig. 4 of the paper, on this actuator. Upwards at the right, downwards at the left. Points: mean over the "
        "passes with twice its standard error, hollow where the speed was not followed. Lines: (7).",
    ),
    "loops": (
        "The loops",
        "The last loop at each speed, and what it is beyond the straight line that fits them all best.",
    ),
}
NOTE = (
    "Lines w = a + c_b v b with c_b = "
    f"{RATE_SCALE:g} s/um; ± is the 95 % interval by Student's t, from the scatter about the line. R² is small where "
    "the velocity does not matter."
)
SPEED_NOTE = (
    "Passes count from where the error stays below "
    f"{100 * TOLERANCE:g} % of the stroke, without the first; fewer than {MIN_PASSES} in a direction, and the speed is "
    "left out."
)


def play_table(found: Characterisation) -> tuple[list[str], list[list[str]]]:
    """Columns and rows, as text: a line of the table for each play."""
    k, rows = found.quantile(), []
    for i, r in enumerate(found.thresholds):
        cells = [f"{found.a[i]:.3f}", f"±{k * found.a_deviations[i]:.3f}"]
        cells += [f"{found.b[i]:.3f}", f"±{k * found.b_deviations[i]:.3f}", f"{found.r_squared[i]:.2f}"]
        rows.append([f"w{i}, r = {r:.3f} V", *cells])
    return ["play", "a um/V", "95 %", "b um/V", "95 %", "R²"], rows


def speed_table(found: Characterisation) -> tuple[list[str], list[list[str]]]:
    """Columns and rows, as text: a line of the table for each speed."""
    rows, v = [], found.velocities
    for speed in v[v > 0]:
        up, down = np.flatnonzero(v == speed), np.flatnonzero(v == -speed)
        counts = [str(found.passes[i].sum()) for i in (up, down)]
        errors = [f"{found.errors[i[0]]:.4f}" if i.size else "-" for i in (up, down)]
        rows.append([f"{speed:g} um/s", *counts, *errors, "yes" if found.converged[up[0]] else "no"])
    return ["speed", "passes up", "down", "rms error um, up", "down", "followed"], rows


def judged(found: Characterisation) -> Verdict:
    """Whether the run is to be used: its verdict, and what of it could not be; one that was cut short is no worse."""
    about = found.recording.metadata
    of_run = judgement.judge(Recording(found.recording.channels, {**about, "interrupted": None, "ended": None}))
    reasons = []
    if left_out := [f"{v:g}" for v in found.velocities[~found.converged] if v > 0]:
        reasons.append(f"Not followed, and left out: {', '.join(left_out)} um/s.")
    if about.get("interrupted"):
        reasons.append("The run was interrupted: only what was complete is in the lines.")
    level = "doubtful" if reasons and of_run.level == "good" else of_run.level
    return Verdict(level, (*of_run.reasons, *reasons))


def verdict(found: Characterisation) -> list[str]:
    """What the lines mean, in sentences."""
    speed, branches, sentences = found.velocities[found.converged].max(), found.branches, []
    if branches.rate_dependent.any():
        change = RATE_SCALE * speed * np.abs(branches.b[branches.rate_dependent]).max() / found.a.sum()
        sentences.append(
            f"Speed changes {_names(branches.rate_dependent)}: at {speed:g} um/s the largest change is "
            f"{100 * change:.1f} % of the sensitivity, {found.a.sum():.2f} um/V."
        )
    else:
        sentences.append(_rateless(found, speed))
    if branches.parted.any():
        jump = np.abs(branches.jump[branches.parted]).max()
        sentences.append(
            f"Direction changes {_names(branches.parted)}, by up to {jump:.2f} um/V at rest. (7) knows no such thing: "
            "the lines through both directions lean by it. Asymmetry and creep do that."
        )
    if abs(branches.lag) > branches.quantile * branches.lag_deviation:
        order = "lags behind" if branches.lag < 0 else "is ahead of"
        sentences.append(f"The displacement {order} its voltage by {1e3 * abs(branches.lag):.2f} ms.")
    sentences.append(f"The lines leave {found.misfit:.3f} um rms of the displacement in the passes.")
    return sentences


def _rateless(found: Characterisation, speed: float) -> str:
    """That no weight changes with speed, and what the lines lean by that do lean."""
    leans = np.abs(found.b) > found.quantile() * found.b_deviations
    if not leans.any():
        return f"No rate dependence of the weights is seen up to {speed:g} um/s: no b differs from 0 by its interval."
    i, branches = int(np.argmax(np.where(leans, np.abs(found.b), 0.0))), found.branches
    within = f"{branches.b[i]:.3f} ± {branches.quantile * branches.b_deviations[i]:.3f} um/V"
    through = f"{found.b[i]:.3f} ± {found.quantile() * found.b_deviations[i]:.3f}"
    rest = "is the step between them" if branches.parted[i] else "may be a step between them: more speeds would show it"
    return (
        f"Within a direction no weight is seen to change with speed up to {speed:g} um/s: b of w{i} is {within} there. "
        f"That of the line through both directions, {through}, {rest}."
    )


def _names(which: npt.NDArray[np.bool_]) -> str:
    return "all weights" if which.all() else ", ".join(f"w{i}" for i in np.flatnonzero(which))


def page(found: Characterisation, command: str | None = None) -> Page:
    """The page of a characterisation; `command` is what repeats it."""
    result, tables = judged(found), [(*play_table(found), NOTE), (*speed_table(found), SPEED_NOTE)]
    return Page(
        title=f"{'NOT FOLLOWED: weights' if result.is_bad else 'Weights'} against velocity",
        lead=" ".join(verdict(found)),
        verdict=result,
        remark=words.REMARKS[result.level],
        sections=[
            Section(tables=[Table(columns=columns, rows=rows, note=note) for columns, rows, note in tables]),
            *captioned(CAPTIONS),
        ],
        plots=lambda theme: {"weights": weights(found, theme), "loops": loops(found, theme)},
        command=command,
        footer=words.footer(found.recording),
    )


def weights(found: Characterisation, theme: Theme) -> Figure:
    """Fig. 4: weight 0 above, the others below, with their lines."""
    with style.use(theme):
        figure, panels = style.panels(5.4, 2, sharex=True, height_ratios=[1, 2])
        ends = np.array([-1.0, 1.0]) * np.abs(found.velocities).max()
        plot_points(panels, found, theme)
        plot_lines(panels, ends, found.a, found.b, theme)
        name_weights(panels, found.a + RATE_SCALE * ends[1] * found.b)
        panels[0].set(ylabel="weights (µm/V)")
        panels[1].set(ylabel="weights (µm/V)", xlabel="desired velocity (µm/s)")
    return figure


def plot_points(panels: list[Axes], found: Characterisation, theme: Theme) -> None:
    """Means with twice their standard error; hollow where the speed was not followed."""
    errors = 2 * found.deviations / np.sqrt(np.maximum(found.passes, 1))[:, None]
    for i in range(found.thresholds.size):
        for kept, face in ((found.converged, None), (~found.converged, "none")):
            x, y, bar = found.velocities[kept], found.weights[kept, i], np.nan_to_num(errors[kept, i])
            look: dict[str, Any] = {"color": _colour(theme, i), "mfc": face, "fmt": "o", "ms": 3.5}
            look |= {"elinewidth": 0.8, "capsize": 1.5, "label": None if face else f"$w_{{{i}}}$"}
            panels[i > 0].errorbar(x, y, bar, **look)


def plot_lines(panels: list[Axes], ends: FloatArray, a: FloatArray, b: FloatArray, theme: Theme) -> None:
    """The lines (7) between two velocities, um/s."""
    for i in range(a.size):
        panels[i > 0].plot(ends, a[i] + RATE_SCALE * ends * b[i], color=_colour(theme, i), lw=1.0)


def name_weights(panels: list[Axes], ends: FloatArray) -> None:
    """The name of each weight at the right, in the order in which they end, um/V."""
    style.legend_right(panels[0], ends[:1])
    style.legend_right(panels[1], ends[1:])


def loops(found: Characterisation, theme: Theme) -> Figure:
    """The last loop of each speed, and what it is beyond one straight line."""
    volts, measured = found.recording["volts"], found.recording["measured"]
    velocity = found.recording["desired_velocity"]
    line = np.polynomial.Polynomial.fit(volts[there := np.isfinite(measured)], measured[there], 1)
    with style.use(theme):
        figure, (above, below) = style.panels(5.4, 2, sharex=True, height_ratios=[1.2, 1])
        for i, speed in enumerate(found.velocities[found.velocities > 0]):
            last = np.flatnonzero(np.abs(velocity) == speed)[-round(found.cycle(speed)) :]
            for panel, z in ((above, measured[last]), (below, measured[last] - line(volts[last]))):
                panel.plot(volts[last], z, color=_colour(theme, i), lw=0.9, label=f"{speed:g}")
        above.set(title="Speeds (µm/s)", ylabel="displacement (µm)")
        below.set(ylabel="beyond a straight line (µm)", xlabel="voltage (V)")
        style.legend_above(above)
    return figure


def _colour(theme: Theme, i: int) -> str:
    return theme.series[i % len(theme.series)]
