"""Make the pictures of adaptation, from-model, learn, scan and identify from the blocks of those pages (minutes)."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truestroke.base.files import overwriting
from truestroke.report import style
from truestroke.report.identified import plots as model_plots
from truestroke.report.page import save_plots
from truestroke.report.style import Theme
from truestroke.signals.recording import Recording

DOCS = Path(__file__).parent
Runs = Mapping[str, Any]  # the names that the page's blocks have made


def runs_of(page: Path) -> Runs:
    """Run the blocks of a page in a folder of their own; everything that those in Python name."""
    names: dict[str, Any] = {}
    blocks = re.findall(r"^```(python|console)\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for language, block in blocks:
            if language == "python":
                with contextlib.redirect_stdout(io.StringIO()):
                    exec(block, names)
            for command in re.findall(r"^\$ truestroke (.*)", block, flags=re.MULTILINE):
                truestroke(command)
    return names


def truestroke(command: str) -> None:
    """Run a command as a page says it; `# exit code 4` behind it is how it ends there."""
    code = int(match[1]) if (match := re.search(r"# exit code (\d+)", command)) else 0
    done = subprocess.run(
        [Path(sys.executable).with_name("truestroke"), *shlex.split(command, comments=True)], check=False
    )
    if done.returncode != code:
        raise SystemExit(f"truestroke {command}: exit code {done.returncode}, must be {code}")


def plot_error(axes: Axes, run: Recording, span: tuple[float, float], scale: float, **line: Any) -> None:
    """True error of a run within `span` s, times `scale`."""
    kept = (run["time"] >= span[0]) & (run["time"] <= span[1])
    axes.plot(run["time"][kept], scale * (run["true"] - run["desired"])[kept], **line)
    axes.set_xlim(*span)


def lines(theme: Theme) -> dict[str, dict[str, Any]]:
    """The line style of each law."""
    return {
        "default": {"color": theme["true"], "lw": 1.1, "label": "default", "zorder": 3},
        "paper": {"color": theme.series[1], "lw": 1.1, "label": "paper"},
    }


def mark(axes: Axes, theme: Theme, time: float, words: str) -> None:
    """A dashed line at `time`, and what it is."""
    axes.axvline(time, color=theme["muted"], lw=0.9, ls=(0, (4, 3)), zorder=1.5)
    place = axes.get_xaxis_transform()
    axes.annotate(
        words, (time, 0.06), xycoords=place, xytext=(-4, 0), textcoords="offset points", fontsize=8, ha="right"
    )


def shade(axes: Axes, theme: Theme, start: float, stop: float, words: str, height: float) -> None:
    """A span of time, and what it is."""
    axes.axvspan(start, stop, color=theme["grid"], alpha=0.7, lw=0, zorder=0.5)
    axes.text(start, height, f" {words}", transform=axes.get_xaxis_transform(), fontsize=8)


# ---- One function a picture ----------------------------------------------------------------------------------------


def cold(runs: Runs, theme: Theme) -> Figure:
    """The first second."""
    figure, (above, paper, ours) = style.panels(5.2, 3, sharex=True, height_ratios=[1.3, 1, 1])
    run = runs["cold"]["default"]
    above.plot(run["time"], run["desired"], color=theme["desired"], lw=3.0, label="desired")
    above.plot(run["time"], run["true"], color=theme["true"], lw=1.0, label="true, default")
    plot_error(paper, runs["cold"]["paper"], (0.0, 1.0), 1.0, **lines(theme)["paper"])
    plot_error(ours, run, (0.0, 1.0), 1e3, **lines(theme)["default"])
    above.set_ylabel("displacement (µm)")
    paper.set_ylabel("error (µm)")
    ours.set(ylabel="error (nm)", xlabel="time (s)")
    for panel in (above, paper, ours):
        style.legend_above(panel)
    return figure


def change(runs: Runs, theme: Theme) -> Figure:
    """Before and after the sudden change; below, its first ticks."""
    figure, (above, below) = style.panels(4.8, 2)
    for name in ("paper", "default"):
        plot_error(above, runs["changed"][name], (2.8, 4.0), 1.0, **lines(theme)[name])
    mark(above, theme, 3.0, "sudden change")
    above.set(ylabel="error (µm)", xlabel="time (s)")
    run = runs["changed"]["default"]
    after = 1e3 * (run["time"] - 3.0)
    near = (after > -5.2) & (after < 30.2)
    error, flags = (run["true"] - run["desired"])[near], run["flags"][near]
    below.plot(after[near], error, **{**lines(theme)["default"], "marker": ".", "ms": 4})
    for bit, words, colour, shape in (
        (4, "rejected", theme["alarm"], "s"),
        (16, "detected as a change", theme["text"], "o"),
    ):
        hit = flags & bit > 0
        below.plot(after[near][hit], error[hit], ls="", marker=shape, ms=7, mfc="none", mew=1.4, c=colour, label=words)
    below.set(ylabel="error (µm)", xlabel="time after the change (ms)", xlim=(-5, 30))
    style.legend_above(above)
    style.legend_above(below)
    return figure


def sensor(runs: Runs, theme: Theme) -> Figure:
    """Three failures of the sensor, the same scale."""
    figure, panels = style.panels(5.0, 3, sharex=True, sharey=True)
    shown = {"no signal": "no signal", "a 5 um spike every 50 ms": "5 µm spike every 50 ms"}
    shown["steps by 0.1 um"] = "off by 0.1 µm (plausible)"
    for panel, (name, words) in zip(panels, shown.items(), strict=True):
        plot_error(panel, runs["failed"][name], (1.5, 3.5), 1e3, **lines(theme)["default"])
        shade(panel, theme, 2.0, 2.5, words, 0.9)
        panel.set_ylabel("error (nm)")
    panels[0].set_ylim(-160, 160)
    panels[-1].set_xlabel("time (s)")
    style.legend_above(panels[0])
    return figure


def stopped(runs: Runs, theme: Theme) -> Figure:
    """The full-stroke wave that follows a pause: paper above, default below."""
    figure, panels = style.panels(4.6, 2, 2, sharex=True, sharey="row")
    for column, pause in enumerate(runs["pauses"]):
        above, below = panels[column], panels[2 + column]
        plot_error(above, runs["stopped"][pause]["paper"], (61.5, 64.0), 1.0, **lines(theme)["paper"])
        plot_error(below, runs["stopped"][pause]["default"], (61.5, 64.0), 1e3, **lines(theme)["default"])
        above.set_title(f"After {pause}")
        below.set_xlabel("time (s)")
        for panel in (above, below):
            shade(panel, theme, 61.5, 62.0, "pause", 0.06)
    panels[0].set_ylabel("error of paper (µm)")
    panels[2].set_ylabel("error of default (nm)")
    panels[2].set_ylim(-30, 30)
    return figure


def limits(runs: Runs, theme: Theme) -> Figure:
    """The sine beyond the voltage limit, and the jump."""
    figure, (far, step, below, error) = style.panels(4.8, 2, 2, height_ratios=[1.2, 1])
    run, jump = runs["reach"]["default"], runs["jumped"]
    for axes, recording, span in ((far, run, (3.0, 3.5)), (step, jump["default"], (1.99, 2.05))):
        axes.plot(recording["time"], recording["desired"], color=theme["desired"], lw=3.0, label="desired")
        axes.plot(recording["time"], recording["true"], color=theme["true"], lw=1.0, label="true")
        axes.set_xlim(*span)
        style.legend_above(axes)
    step.set_ylim(-2, 20)
    for name in ("paper", "default"):
        plot_error(below, runs["reach"][name], (3.0, 3.5), 1.0, **lines(theme)[name])
        plot_error(error, jump[name], (1.99, 2.05), 1.0, **lines(theme)[name])
    error.set_ylim(-4, 4)
    far.set_ylabel("displacement (µm)")
    below.set_ylabel("error (µm)")
    for axes in (below, error):
        axes.set_xlabel("time (s)")
        style.legend_above(axes)
    return figure


def trim(runs: Runs, theme: Theme) -> Figure:
    """A wrong model on hold, with four trims."""
    figure, panels = style.panels(4.6, 2)
    for panel, motion in zip(panels, runs["motions"], strict=True):
        for i, rate in enumerate((0.0, 20.0, 100.0, 400.0)):
            run = runs["trimmed"][motion, "on hold", rate]
            line = {"color": theme.series[(7, 2, 1, 0)[i]], "lw": 1.1, "label": f"trim {rate:g} 1/s"}
            plot_error(panel, run, (2.0, 2.5), 1.0, **line)
        panel.set_ylabel(f"error, {motion} (µm)")
    panels[-1].set_xlabel("time (s)")
    style.legend_above(panels[0])
    return figure


def passes(runs: Runs, theme: Theme) -> Figure:
    """True rmse of each pass, with the sensor's noise."""
    figure, (axes,) = style.panels(3.4)
    for (stage, how), errors in runs["columns"].items():
        colour, both = theme.series[0 if stage == "same" else 1], how != "refined"
        line = {"ls": "-", "lw": 1.4, "ms": 4} if both else {"ls": (0, (3, 2)), "lw": 1.4, "ms": 8, "mfc": "none"}
        words = f"{stage} stage, {'refined and corrected' if both else 'refined'}"
        axes.semilogy(errors[:, 0], marker="o", color=colour, label=words, **line)
    axes.axhline(SENSOR_NOISE, color=theme["muted"], lw=0.9, ls=(0, (1, 2)))
    words, place = "noise of the sensor, a sample", (4, SENSOR_NOISE)
    axes.annotate(words, place, xytext=(0, 4), textcoords="offset points", fontsize=8, ha="right")
    axes.set(xlabel="pass", ylabel="true rmse (nm)", xticks=range(5))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(fontsize=8)
    return figure


def online(runs: Runs, theme: Theme) -> Figure:
    """True error of each period of a run, with a correction and without, and the batches of it."""
    figure, (axes,) = style.panels(3.4)
    both = (("alone", "controller alone", theme.series[1]), ("recording", "with the correction", theme["true"]))
    for name, words, colour in both:
        recording = runs[name]
        counts, time, true, desired = (
            recording[channel].reshape(-1, 200) for channel in ("flat", "time", "true", "desired")
        )
        periods = counts.any(axis=1)  # the ramp to the motion has none that counts
        error = np.where(counts > 0, true - desired, np.nan)[periods]
        middle = time[periods].mean(axis=1)
        axes.semilogy(middle, 1000 * np.nanstd(error, axis=1), color=colour, lw=1.2, label=words)
    for i, batch in enumerate(runs["controller"].batches):
        words = "" if i else "a batch ends"
        axes.axvline(batch.tick / 10_000.0, color=theme["muted"], lw=0.7, ls=(0, (1, 2)), label=words)
    axes.set(xlabel="time (s)", ylabel="true rmse of a period (nm)", yticks=(2, 5, 10, 20, 40))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.legend(fontsize=8)
    return figure


SENSOR_NOISE = 13.4  # nm a sample, of the simulated stage
PICTURES: dict[str, tuple[Callable[[Runs, Theme], Figure], ...]] = {
    "adaptation": (cold, change, sensor, stopped, limits, trim),
    "from-model": (passes,),
    "learn": (online,),
}


def identified(folder: Path = DOCS / "images" / "identify") -> None:
    """The pictures of the report on the record of identify.md."""
    with tempfile.TemporaryDirectory() as there, contextlib.chdir(there):
        model = runs_of(DOCS / "identify.md")["model_of_sweep"]
        save_plots(lambda theme: model_plots.plots(model, theme), folder)


LARGER = {"2000.0": "20000.0", "width = 6.0 ": "width = 12.0 ", "lines = 16": "lines = 128", "8.0, 8.0": "10.0, 10.0"}
COMMANDS = {"learn": ("learn", {"passes": "passes"}), "scan": ("scan", {"grating": "grating", "texture": "texture"})}


def commanded(page: str) -> None:
    """The pictures that a command of the page writes with --plots; of the scan on hardware, with more pixels, too."""
    command, names = COMMANDS[page]
    with tempfile.TemporaryDirectory() as there, contextlib.chdir(there):
        plotted(command, names, DOCS / "images" / page)
        if page == "scan":
            blocks = re.findall(r"^```python\n(.*?)^```", (DOCS / "scan.md").read_text(), re.MULTILINE | re.DOTALL)
            block = next(one for one in blocks if '"scan.toml"' in one)
            for old, new in LARGER.items():
                block = block.replace(old, new)
            exec(block, {})
            plotted("scan --config scan.toml", {"image": "hardware"}, DOCS / "images" / page)


def plotted(command: str, names: Mapping[str, str], folder: Path) -> None:
    """Some of the pictures of a command, under these names."""
    truestroke(f"{command} --plots plots")
    for made, name in names.items():
        for theme in ("light", "dark"):
            shutil.copy(f"plots/{made}-{theme}.png", folder / f"{name}-{theme}.png")


def main(*pages: str) -> None:
    """Make those of some pages, or of all, light and dark."""
    for page in pages or ("identify", "scan", *PICTURES):
        if page == "identify":
            identified()
        if page in COMMANDS:
            commanded(page)
        if page not in PICTURES:
            continue
        runs, folder = runs_of(DOCS / f"{page}.md"), DOCS / "images" / page
        folder.mkdir(parents=True, exist_ok=True)
        for plot in PICTURES[page]:
            for theme in (style.LIGHT, style.DARK):
                with style.use(theme):
                    style.save(plot(runs, theme), folder / f"{plot.__name__}-{theme.name}.png")


if __name__ == "__main__":
    with overwriting():  # those in the repository
        main(*sys.argv[1:])
