"""One look for all pictures: Okabe-Ito colours, a light and a dark theme, thinning of long lines."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.cbook import is_math_text
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT
from matplotlib.text import Annotation, Text
from matplotlib.textpath import text_to_path
from matplotlib.ticker import Locator, NullLocator
from matplotlib.transforms import Bbox, BboxBase

from truestroke.base import files
from truestroke.base.typing import FloatArray

WIDTH = 7.0  # in, two columns of a journal
PHONE = 3.3  # in: letters of 8 points are 12 pixels high on a phone
LEGEND, BAR = 0.25, 0.12  # in: height of a legend of such a picture, width of a scale of colours
SHARE = 0.8  # of the height, of such a scale
ENTRY = 0.35  # in, of an entry of such a legend beside its words
EDGE, GAP = 0.06, 0.08  # in, beside what is outermost in such a picture, and between panels and their labels
LINE = 1.2  # height of a line of text over that of its letters
DPI, VECTOR_DPI = 200, 72  # of images; of SVG and PDF
COLUMNS = 900  # pixel columns of a panel, for thinning
ROLES = ("background", "text", "muted", "grid", "desired", "true", "measured", "before", "alarm", "wrong")
SERIES = 8


@dataclass(frozen=True)
class Theme:
    """Colours by role.

    Attributes
    ----------
    name : str
        "light", "dark" or "page".
    roles : Mapping[str, str]
        Colour of each entry of `ROLES`, "#rrggbb".
    series : tuple[str, ...]
        Colours of numbered lines such as the weights.
    """

    name: str
    roles: Mapping[str, str]
    series: tuple[str, ...]

    def __getitem__(self, role: str) -> str:
        return self.roles[role]

    @property
    def variables(self) -> dict[str, str]:
        """Every colour by the name of its CSS variable."""
        return {**self.roles, **{f"series-{i}": colour for i, colour in enumerate(self.series)}}


def _theme(name: str, roles: str, series: str) -> Theme:
    return Theme(name, dict(zip(ROLES, roles.split(), strict=True)), tuple(series.split()))


# Okabe and Ito (2008), jfly.uni-koeln.de/color. Their yellow is darkened on white and their black and blue are
# lightened on black, for contrast.
LIGHT = _theme(
    "light",
    "#ffffff #1a1a1a #5f6368 #e3e5e8 #b4b8bd #0072b2 #8fc1e3 #d55e00 #cc79a7 #b3261e",
    "#0072b2 #d55e00 #009e73 #cc79a7 #e69f00 #56b4e9 #8a8000 #1a1a1a",
)
DARK = _theme(
    "dark",
    "#14171a #e8eaed #9aa0a6 #2c3136 #6b7178 #56b4e9 #2f6688 #e8804a #cc79a7 #ff7a6e",
    "#56b4e9 #e8804a #1fbf94 #cc79a7 #e69f00 #4a90d9 #f0e442 #e8eaed",
)
# Colours that are replaced by CSS variables, so that a page can follow the reader's choice of light or dark.
PAGE = _theme(
    "page",
    " ".join(f"#0f1e{i:02x}" for i in range(len(ROLES))),
    " ".join(f"#0f2e{i:02x}" for i in range(SERIES)),
)
THEMES = {theme.name: theme for theme in (LIGHT, DARK, PAGE)}


def _parameters(theme: Theme) -> dict[Any, Any]:
    text, muted = theme["text"], theme["muted"]
    return {
        "figure.facecolor": theme["background"],
        "axes.facecolor": theme["background"],
        "text.color": text,
        "axes.labelcolor": text,
        "axes.titlecolor": text,
        "axes.edgecolor": muted,
        "xtick.color": muted,
        "ytick.color": muted,
        "xtick.labelcolor": text,
        "ytick.labelcolor": text,
        "grid.color": theme["grid"],
        "grid.linewidth": 0.6,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 9,
        "axes.titlepad": 5,
        "axes.titley": 1.0,  # otherwise the labels are measured for it, in a tenth of the time of a picture
        "axes.formatter.useoffset": False,  # which would stand in the title
        "axes.labelsize": 9,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "legend.fontsize": 8,
        "legend.frameon": False,
        "legend.labelcolor": text,
        "font.family": "sans-serif",
        "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial", "sans-serif"],
        "axes.unicode_minus": True,
        "lines.solid_joinstyle": "round",
        "savefig.dpi": DPI,
        "svg.fonttype": "none",
        "pdf.fonttype": 42,
    }


@contextmanager
def use(theme: Theme) -> Iterator[None]:
    """Plot and save in `theme`; matplotlib's own settings are restored afterwards."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_parameters(theme))
        yield


class Places(ConstrainedLayoutEngine):
    """Matplotlib's places of the panels, for less: it looks at all labels twice, as they may change with the places.

    Where the labels of a panel's ticks have remained, so have its margins, and what was found is taken again.
    """

    def __init__(self, w_pad: float = 0.06) -> None:
        super().__init__(h_pad=0.07, w_pad=w_pad)

    def execute(self, figure: Figure) -> None:
        """Give the panels of the figure their places."""
        panels = [axes for axes in figure.axes if axes.get_aspect() == "auto" and axes.get_box_aspect() is None]
        for axes in panels:
            vars(axes)["get_tightbbox"] = _remembering(axes)
        try:
            super().execute(figure)
        finally:
            for axes in panels:
                del vars(axes)["get_tightbbox"]


def _remembering(axes: Axes) -> Callable[..., BboxBase | None]:
    """`axes.get_tightbbox`, which looks again only if the labels of its ticks are others than when it last looked."""
    measure, measured, labels, margins = axes.get_tightbbox, axes.figure, None, np.zeros(4)

    def tight(*arguments: Any, **options: Any) -> BboxBase | None:
        nonlocal labels, margins
        now = [a.get_major_formatter().format_ticks(list(a.get_majorticklocs())) for a in (axes.xaxis, axes.yaxis)]
        place = np.asarray(axes.get_position(original=True).transformed(measured.transFigure).extents)
        if now == labels:
            return Bbox.from_extents(place + margins)
        found = measure(*arguments, **options)
        if found is not None:
            labels, margins = now, found.extents - place
        return found

    return tight


@contextmanager
def placed(figure: Figure, dpi: float) -> Iterator[None]:
    """Within it, the panels of the figure stand where its layout has them at so many pixels an inch.

    Otherwise `savefig` would plot all once more to find the places.
    """
    engine = figure.get_layout_engine()
    if engine is None:
        yield
        return
    before, figure.dpi = figure.dpi, dpi
    engine.execute(figure)
    figure.dpi = before
    figure.set_layout_engine("none")
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


def panels(
    height: float,
    rows: int = 1,
    columns: int = 1,
    edges: Mapping[str, float] | None = None,
    width: float = WIDTH,
    **options: Any,
) -> tuple[Figure, list[Axes]]:
    """A figure of this `height` and, by default, the standard width, in inches, and its panels in reading order.

    With `edges`, as `subplots_adjust` has them, the panels stand there: to find their places takes matplotlib as long
    as all the rest.
    """
    figure = Figure(figsize=(width, height), layout=None if edges else Places())
    if edges:
        figure.subplots_adjust(**edges)
    return figure, list(np.ravel(figure.subplots(rows, columns, **options)))


def for_phone(figure: Figure) -> bool:
    """Make a figure as wide as a phone; False for one without panels, or that is narrow enough.

    Columns become rows where there are more of them, and all panels one column where they are of different widths, or
    too narrow for their titles. A label that stood once for a row or a column stands there again, and a title has as
    many lines as it needs.
    """
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    if not panels or figure.get_figwidth() <= PHONE:
        return False
    places = panels[0].get_gridspec()
    assert places is not None
    usual = figure.get_figheight() / places.nrows
    grid = _label_again(figure, panels)
    head = LEGEND * _raise_legend(figure, panels)
    figure.set_layout_engine("none")
    width = _stand(figure, grid, usual, head)
    for axes in panels:
        _break_title(axes, width)
    for _ in range(2):  # how many labels there are depends on the places
        _stand(figure, grid, usual, head)
    _keep_notes(figure, panels)
    return True


def _label_again(figure: Figure, panels: list[Axes]) -> Any:
    """The panels in rows and columns as on a phone, each with the labels that it needs there."""
    places, shown = panels[0].get_gridspec(), [axes for axes in panels if axes.get_visible()]
    grid: Any = np.array(shown, dtype=object)[:, None]
    names = {axes: (axes.get_xlabel(), axes.get_ylabel() or figure.get_supylabel()) for axes in shown}
    if places is not None and len(panels) == places.nrows * places.ncols:
        was: Any = np.array(panels, dtype=object).reshape(places.nrows, places.ncols)
        for row, column in np.ndindex(was.shape):
            x, y = was[row, column].get_xlabel(), was[row, column].get_ylabel()
            names[was[row, column]] = (
                x or was[-1, column].get_xlabel(),
                y or was[row, 0].get_ylabel() or figure.get_supylabel(),
            )
        turned = was.T if places.ncols > places.nrows else was
        if not _too_narrow(turned):
            grid = turned
        elif was[0, 0].get_shared_x_axes().joined(*was[[0, -1], 0]) > was[0, 0].get_shared_x_axes().joined(
            *was[0, [0, -1]]
        ):
            grid = was.reshape(-1, 1, order="F")  # what is above each other has one time
    figure.supylabel("")
    for row, column in np.ndindex(grid.shape):
        axes = grid[row, column]
        lowest = row == len(grid) - 1 or not axes.get_shared_x_axes().joined(axes, grid[row + 1, column])
        first = column == 0 or not axes.get_shared_y_axes().joined(axes, grid[row, 0])
        axes.tick_params(labelbottom=lowest, labelleft=first)
        axes.set_xlabel(names[axes][0] if lowest else "")
        axes.set_ylabel((names[axes][1] or _shared(axes)) if first else "")
        if axes.get_aspect() != "auto":
            axes.locator_params(nbins=4)
    return grid


def _too_narrow(grid: Any) -> bool:
    """Whether panels side by side, which are no images, are too narrow on a phone for one of their titles."""
    columns, panels = grid.shape[1], list(grid.flat)
    if columns == 1 or any(axes.get_aspect() != "auto" for axes in panels):
        return False
    titles = (_width(axes.get_title(loc="left"), axes.title) for axes in panels)
    return max(titles) > SHARE * PHONE / columns or not all(axes.get_visible() for axes in panels)


def _shared(axes: Axes) -> str:
    """What another panel calls the vertical axis that both have."""
    return next((y for one in axes.get_shared_y_axes().get_siblings(axes) if (y := one.get_ylabel())), "")


def _break_title(axes: Axes, width: float) -> None:
    """The title of a panel, which stands at the left, in lines that are so wide at most, in."""
    title, lines = axes.get_title(loc="left"), [""]
    for word in title.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and _width(longer, axes.title) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    for one in axes.get_children():
        if isinstance(one, Text) and one.get_text() == title:
            one.set_text("\n".join(lines))


def _keep_notes(figure: Figure, panels: Sequence[Axes]) -> None:
    """Words beside a place that would go beyond the picture go to its other side."""
    renderer = RendererAgg(1, 1, figure.dpi)  # type: ignore[no-untyped-call]  # measures only
    for text in (one for axes in panels for one in axes.texts):
        if text.get_horizontalalignment() == "left" and text.get_window_extent(renderer).x1 > figure.bbox.x1:
            text.set_horizontalalignment("right")
            if isinstance(text, Annotation):
                text.xyann = (-text.xyann[0], text.xyann[1])


def _stand(figure: Figure, grid: Any, usual: float, head: float) -> float:
    """Places of the panels of such a figure, by its labels alone: matplotlib's layout looks at all that is there.

    `usual` is the height of a row of panels that are no images, with labels, `head` that above all, in. The width of a
    panel is returned, in.
    """
    above, below = ([max(map(side, row)) for row in grid] for side in (_above, _below))
    rows, columns = grid.shape
    gap = GAP + max((under + over for under, over in zip(below, above[1:], strict=False)), default=0.0)
    left = EDGE + max(_beside(axes.yaxis) for axes in grid[:, 0])
    between = GAP + max((_beside(axes.yaxis) for axes in grid[:, 1:].flat), default=0.0)
    bars = [axes for axes in figure.axes if axes.get_subplotspec() is None]
    right = EDGE + max([max(map(_overhang, grid[:, -1])), *(GAP + BAR + _beside(axes.yaxis) for axes in bars)])
    width = (PHONE - left - right - between * (columns - 1)) / columns
    heights = [max(_height(axes, width, usual - under - over) for axes in row)
               for row, under, over in zip(grid, below, above, strict=True)]  # fmt: skip
    bottom, top = EDGE + below[-1], EDGE + above[0] + head
    height = bottom + sum(heights) + gap * (rows - 1) + top
    figure.set_size_inches(PHONE, height)
    places = {"left": left / PHONE, "right": 1 - right / PHONE, "bottom": bottom / height, "top": 1 - top / height}
    apart = {"wspace": between / width, "hspace": gap * rows / sum(heights), "height_ratios": heights}
    made = GridSpec(rows, columns, figure=figure, **places, **apart)
    for j, i in np.ndindex(grid.shape):
        grid[j, i].set_subplotspec(made[j, i])
    middle, half = (places["bottom"] + places["top"]) / 2, SHARE * (places["top"] - places["bottom"]) / 2
    for axes in bars:
        axes.set_box_aspect(None)
        axes.set_position((places["right"] + GAP / PHONE, middle - half, BAR / PHONE, 2 * half))
    return float(width)


def _raise_legend(figure: Figure, panels: Sequence[Axes]) -> int:
    """A legend above a panel goes to the top of the figure: a narrow panel is too small for its title and a legend.

    How many lines there are at the top of the figure; a legend has as many as it needs.
    """
    found = [(legend, [one for one in legend.legend_handles if one is not None]) for legend in figure.legends]
    for axes in panels:
        legend = axes.get_legend()
        if legend and axes.transAxes.inverted().transform(legend.get_bbox_to_anchor().p0)[1] > 0.9:
            found.append((legend, axes.get_legend_handles_labels()[0]))
            break
    lines = 0
    for legend, handles in found:
        if not handles:
            continue
        words, letters = [text.get_text() for text in legend.get_texts()], legend.get_texts()[0]
        widest = ENTRY + max(_width(one, letters) for one in words)
        columns = max(1, min(len(words), int((PHONE - 2 * EDGE) / widest)))
        place: dict[str, Any] = {
            "loc": "upper left",
            "bbox_to_anchor": (0.0, 1.0),
            "bbox_transform": figure.transFigure,
        }
        look: dict[str, Any] = {"frameon": False, "fontsize": 8, "labelcolor": letters.get_color(), "handlelength": 1.2}
        legend.remove()
        figure.legend(handles, words, ncols=columns, **place, **look)
        lines += -(-len(words) // columns)
    return lines


def _height(axes: Axes, width: float, usual: float) -> float:
    """In, without its labels: of an image that is so wide; of another panel as it was, or as its label needs."""
    form = axes.get_aspect()
    return max(usual, _length(axes.yaxis.label)) if form == "auto" else width * axes.get_data_ratio() * float(form)


def _above(axes: Axes) -> float:
    """In, above a panel, of its title, which stands at the left."""
    lines = axes.get_title(loc="left").count("\n") + 1 if axes.get_title(loc="left") else 0
    return (lines * _line(axes.title) + 5.0) / 72


def _below(axes: Axes) -> float:
    """In, below a panel, of its labels."""
    names = axes.get_xlabel() and _line(axes.xaxis.label) + axes.xaxis.labelpad
    numbers = _line(axes.xaxis.get_major_ticks(1)[0].label1) if _labels(axes.xaxis) else 0.0
    return (_outside(axes.xaxis) + numbers + (names or 0.0)) / 72


def _beside(axis: Axis) -> float:
    """In, beside a panel, of the labels of its vertical axis."""
    name = axis.label.get_text() and _line(axis.label) + axis.labelpad
    return _outside(axis) / 72 + max((wide for _, wide in _labels(axis)), default=0.0) + (name or 0.0) / 72


def _outside(axis: Axis) -> float:
    """Points of a tick, and between it and its label."""
    tick = axis.get_major_ticks(1)[0]
    pad: Any = tick.get_pad()  # type: ignore[func-returns-value]  # it does
    return float(tick.get_tick_padding() + pad)


def _overhang(axes: Axes) -> float:
    """In, by which the last label of the horizontal axis is beyond the panel."""
    place = axes.get_position(original=True).width * PHONE
    return max([0.0, *(wide / 2 - (1 - at) * place for at, wide in _labels(axes.xaxis))])


def _labels(axis: Axis) -> list[tuple[float, float]]:
    """Of each label of a tick that is shown: its place, from 0 to 1 along the panel, and how wide it is, in."""
    shown = axis.get_tick_params()
    if not shown.get("labelleft", shown.get("labelbottom", True)) and not shown.get("labelright", False):
        return []
    places = np.asarray(axis.get_majorticklocs())
    texts, letters = axis.get_major_formatter().format_ticks(list(places)), axis.get_major_ticks(1)[0].label1
    low, high = axis.get_transform().transform(np.sort(axis.get_view_interval()))
    at = (axis.get_transform().transform(places) - low) / (high - low)
    inside = (at > -1e-9) & (at < 1 + 1e-9)
    return [(float(where), _width(text, letters)) for where, text, kept in zip(at, texts, inside, strict=True) if kept]


def _line(letters: Text) -> float:
    """Points, of a text of such letters, a line at least."""
    return LINE * float(letters.get_fontsize()) * (letters.get_text().count("\n") + 1)


def _length(text: Text) -> float:
    """In, of a text."""
    return _width(text.get_text(), text)


def _width(words: str, letters: Text) -> float:
    """In, of words in such letters."""
    font = letters.get_fontproperties()
    return max(_width_of_line(one, font) for one in words.splitlines() or [""]) / 72


@lru_cache(maxsize=2000)  # the labels of ticks are asked for again and again while the panels find their places
def _width_of_line(line: str, font: FontProperties) -> float:
    """Points."""
    return float(text_to_path.get_text_width_height_descent(line, font, is_math_text(line))[0])


def zero(axes: Axes, theme: Theme) -> None:
    """A thin line at 0, behind what is plotted."""
    axes.axhline(0, color=theme["muted"], lw=0.7, zorder=1.5)


def logarithmic(axes: Axes, names: str) -> None:
    """Axes "x", "y" or "xy" with logarithmic scales and plain numbers; also of the panels that share them."""
    for name in names:
        axes.set(**{f"{name}scale": "log"})
        axis = axes.xaxis if name == "x" else axes.yaxis
        axis.set_major_formatter("{x:g}")
        shared: Any = axes.get_shared_x_axes() if name == "x" else axes.get_shared_y_axes()
        places = axis.get_minor_locator()
        axis.set_minor_locator(NullLocator())
        for panel in shared.get_siblings(axes):
            if not any(isinstance(one, _MinorTicks) and one.name == name for one in panel.artists):
                panel.add_artist(_MinorTicks(name, places))


class _MinorTicks(Artist):
    """Those of a logarithmic axis, "x" or "y", as one line of markers: each tick of matplotlib is five artists."""

    def __init__(self, name: str, places: Locator) -> None:
        super().__init__()
        self.name, self._places = name, places
        given: Any = matplotlib.rcParams
        names = {"markersize": "minor.size", "markeredgewidth": "minor.width", "color": "color"}
        self._look: dict[str, Any] = {word: given[f"{name}tick.{key}"] for word, key in names.items()}
        self._look["marker"] = TICKDOWN if name == "x" else TICKLEFT
        self.set_in_layout(False)

    def draw(self, renderer: RendererBase) -> None:
        """At the places of the limits as they are."""
        panel, along = self.axes, self.name == "x"
        assert isinstance(panel, Axes)
        low, high = sorted(panel.get_xlim() if along else panel.get_ylim())
        places = np.asarray(self._places.tick_values(low, high))
        places = places[(places >= low) & (places <= high)]
        beside = np.zeros(places.size)
        line = Line2D(
            *((places, beside) if along else (beside, places)),
            transform=panel.get_xaxis_transform("tick1") if along else panel.get_yaxis_transform("tick1"),
            linestyle="none",
            **self._look,
        )
        line.set_figure(panel.figure)
        line.draw(renderer)


def note(axes: Axes, text: str, place: tuple[float, float], theme: Theme, coords: Any = "data", **look: Any) -> None:
    """A small text beside a place, towards the middle of the panel, below the place if that is in the upper half."""
    right = place[0] > np.mean(axes.get_xlim())
    upper = place[1] > (np.mean(axes.get_ylim()) if coords == "data" else 0.5)
    axes.annotate(
        text,
        place,
        xycoords=coords,
        xytext=(-6 if right else 6, -3 if upper else 3),
        textcoords="offset points",
        ha="right" if right else "left",
        va="top" if upper else "bottom",
        fontsize=8,
        bbox={"facecolor": theme["background"], "edgecolor": "none", "pad": 1.0, "alpha": 0.8},
        **look,
    )


def legend_above(axes: Axes) -> None:
    """A legend in one row above the panel, at the right, where no line is."""
    columns = len(axes.get_legend_handles_labels()[0])
    legend = axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=columns, borderaxespad=0.2, handlelength=1.6
    )
    for line in legend.get_lines():
        line.set_linewidth(max(line.get_linewidth(), 1.5))


def legend_right(axes: Axes, ends: npt.ArrayLike) -> None:
    """Names of the lines at the right of the panel, in their colours, in the order of their `ends`, highest first."""
    lines, names = axes.get_legend_handles_labels()
    order = np.argsort(-np.asarray(ends), kind="stable")
    axes.legend(
        [lines[i] for i in order],
        [names[i] for i in order],
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        labelcolor="linecolor",
        handlelength=1.2,
    )


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure for publication; the ending says how: .png, .svg or .pdf.

    Text stays text in SVG and PDF. The same figure gives the same bytes.
    """
    path = Path(path)
    maker = "truestroke"  # by which `files.PICTURE` knows it
    about = {".svg": {"Date": None, "Creator": maker}, ".pdf": {"CreationDate": None, "Creator": maker}}
    with (
        files.writing(path, files.PICTURE) as draft,
        placed(figure, DPI if path.suffix.lower() == ".png" else VECTOR_DPI),
        matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": maker, "pdf.fonttype": 42}),
    ):
        figure.savefig(draft, dpi=DPI, metadata=about.get(path.suffix.lower(), {"Software": maker}))
    return path


def thin(time: npt.ArrayLike, values: npt.ArrayLike, columns: int = COLUMNS) -> tuple[FloatArray, FloatArray]:
    """Thin a long line to its lowest and highest sample in each pixel column, so that every peak survives.

    Parameters
    ----------
    time, values : array_like, shape (samples,)
        The line, evenly sampled; NaN in `values` is a gap.
    columns : int
        Pixel columns that the line fills.

    Returns
    -------
    time, values : ndarray, shape (at most 2 columns + 2,)
        Samples of the line in their order, with the first and the last; a short line keeps all of them.

    Examples
    --------
    >>> values = np.zeros(10_000)
    >>> values[1234] = 5.0
    >>> t, thinned = thin(np.arange(10_000), values, columns=100)
    >>> t.size <= 202, float(thinned.max()), float(t[thinned.argmax()])
    (True, 5.0, 1234.0)
    """
    time, values = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if values.size <= 2 * columns + 2:
        return time, values
    starts = np.linspace(0, values.size, columns + 1).astype(int)
    width = int(np.diff(starts).max())
    index = np.minimum(starts[:-1, None] + np.arange(width), starts[1:, None] - 1)
    block = values[index]
    lowest = np.where(np.isnan(block), np.inf, block).argmin(axis=1)
    highest = np.where(np.isnan(block), -np.inf, block).argmax(axis=1)
    rows = np.arange(columns)
    kept = np.unique(np.concatenate([[0], index[rows, lowest], index[rows, highest], [values.size - 1]]))
    return time[kept], values[kept]
