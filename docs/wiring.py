"""Draw how hardware is wired: `python docs/wiring.py`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from truestroke.report import style
from truestroke.report.style import Theme

IMAGES = Path(__file__).parent / "images"


def canvas(width: float, height: float) -> tuple[Figure, Axes]:
    """An empty figure whose coordinates are tenths of an inch, from the lower left."""
    figure = Figure(figsize=(width / 10, height / 10))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
    axes.set_axis_off()
    return figure, axes


def box(axes: Axes, theme: Theme, place: tuple[float, float, float, float], name: str, words: str) -> None:
    """A box at (left, bottom, width, height) with a name, and words under it."""
    left, bottom, width, height = place
    axes.add_patch(
        FancyBboxPatch(
            (left, bottom), width, height, boxstyle="round,pad=0,rounding_size=1", fc="none", ec=theme["muted"], lw=1.2
        )
    )
    middle = left + width / 2, bottom + height / 2
    axes.annotate(name, middle, xytext=(0, 2), textcoords="offset points", ha="center", fontsize=9, weight="bold")
    axes.annotate(words, middle, xytext=(0, -3), textcoords="offset points", ha="center", va="top", fontsize=7.5)


def wire(
    axes: Axes, colour: str, points: list[tuple[float, float]], words: str, at: tuple[float, float], lw: float = 1.6
) -> None:
    """A wire along `points` with an arrow at its end, and what it carries, written around `at`."""
    *way, last = points
    axes.plot(*zip(*points, strict=True), color=colour, lw=lw, solid_capstyle="butt")
    axes.annotate("", last, way[-1], arrowprops={"arrowstyle": "-|>", "color": colour, "lw": lw, "shrinkA": 0})
    axes.text(*at, words, color=colour, fontsize=7.5, ha="center", va="center")


def pin(axes: Axes, theme: Theme, at: tuple[float, float], name: str) -> None:
    """A terminal of a card, named inside its box, to the left."""
    axes.plot(*at, marker="o", ms=4, color=theme["text"])
    axes.annotate(name, at, xytext=(-7, 0), textcoords="offset points", ha="right", va="center", fontsize=7.5)


def nidaqmx(theme: Theme) -> Figure:
    """Output 0 to the amplifier, amplifier to the stack, sensor to input 0."""
    figure, axes = canvas(70, 27)
    out, back, high = theme["true"], theme.series[2], theme.series[1]
    axes.add_patch(
        FancyBboxPatch((1, 2), 14, 23, boxstyle="round,pad=0,rounding_size=1", fc="none", ec=theme["muted"], lw=1.2)
    )
    axes.text(3, 22.6, "NI card, Dev1", fontsize=9, weight="bold", va="center")
    axes.text(3, 20.6, "in the computer", fontsize=7.5, va="center")
    for y, name in ((17, "AO 0"), (14.5, "AO GND"), (8.5, "AI 0, + input"), (6, "AI 8, its − input")):  # noqa: RUF001
        pin(axes, theme, (15, y), name)
    box(axes, theme, (28, 13, 12, 8), "amplifier", "drives the stack")
    box(axes, theme, (54, 13, 14, 8), "piezo stack", "moves the stage")
    box(axes, theme, (54, 3, 14, 7), "sensor", "of the displacement")
    box(axes, theme, (28, 3, 12, 7), "electronics", "of the sensor")
    wire(axes, out, [(15, 17), (28, 17)], "command, V", (21.5, 18.3))
    axes.plot([15, 28], [14.5, 14.5], color=theme["muted"], lw=1.2)
    wire(axes, high, [(40, 17), (54, 17)], "high voltage", (47, 18.3))
    wire(axes, theme["muted"], [(61, 13), (61, 10)], "µm", (63, 11.5))
    wire(axes, back, [(54, 7), (40, 7)], "", (0, 0))
    wire(axes, back, [(28, 8.5), (15, 8.5)], "displacement, V", (21.5, 9.8))
    axes.plot([15, 28], [6, 6], color=theme["muted"], lw=1.2)
    return figure


def pi(theme: Theme) -> Figure:
    """Computer to controller by network; the controller drives the stack and reads its sensor."""
    figure, axes = canvas(70, 22)
    box(axes, theme, (1, 7, 14, 8), "computer", "truestroke playback")
    box(axes, theme, (27, 2, 17, 18), "PI controller", "amplifier, sensor electronics,\nwave tables, data recorder")
    box(axes, theme, (56, 12, 13, 8), "piezo stack", "moves the stage")
    box(axes, theme, (56, 2, 13, 6), "sensor", "of the displacement")
    wire(axes, theme["true"], [(15, 12.5), (27, 12.5)], "wave, V", (21, 13.8))
    wire(axes, theme.series[2], [(27, 9.5), (15, 9.5)], "record, µm and V", (21, 8.2))
    axes.text(21, 5.4, "network, TCP", color=theme["muted"], fontsize=7.5, ha="center", va="center")
    wire(axes, theme.series[1], [(44, 16), (56, 16)], "high voltage", (50, 17.3))
    wire(axes, theme["muted"], [(62.5, 12), (62.5, 8)], "µm", (64.5, 10))
    wire(axes, theme.series[2], [(56, 5), (44, 5)], "displacement", (50, 6.3))
    return figure


PICTURES: tuple[Callable[[Theme], Figure], ...] = (nidaqmx, pi)


def main(folder: Path = IMAGES) -> None:
    """Draw all of them, light and dark."""
    for draw in PICTURES:
        for theme in (style.LIGHT, style.DARK):
            with style.use(theme):
                target = folder / draw.__name__ / f"wiring-{theme.name}.svg"
                target.parent.mkdir(parents=True, exist_ok=True)
                style.save(draw(theme), target)


if __name__ == "__main__":
    main()
