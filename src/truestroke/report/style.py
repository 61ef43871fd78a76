"""One look for all pictures: Okabe-Ito colours, a light and a dark theme, thinning of long lines."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import Bbox, BboxBase

from truestroke.base import files
from truestroke.base.typing import FloatArray

WIDTH = 7.0  # in, two columns of a journal
PHONE = 3.3  # in: letters of 8 points are 12 pixels high on a phone
BESIDE, ABOVE = 0.55, 0.35  # in: what the labels of images take of the width of such a picture, of the height of a row
LEGEND, BAR = 0.25, 0.5  # in: height of a legend of such a picture, width of a scale of colours
EDGE = 0.03  # of the width of such a picture: what the layout does not see of the labels of images
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

    def __init__(self, w_pad: float = 0.06, rect: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)) -> None:
        super().__init__(h_pad=0.07, w_pad=w_pad, rect=rect)

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
    """Make a figure with images, or with more columns of panels than rows, as wide as a phone; False for another one.

    Columns become rows where there are more of them. A label that stood once for a row or a column stands there again.
    """
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    places = panels[0].get_gridspec() if panels else None
    if places is None or len(panels) != places.nrows * places.ncols:
        return False
    was: Any = np.array(panels, dtype=object).reshape(places.nrows, places.ncols)
    turned = places.ncols > places.nrows
    if not turned and all(axes.get_aspect() == "auto" for axes in panels):
        return False
    across, along = [axes.get_xlabel() for axes in was[-1]], [axes.get_ylabel() for axes in was[:, 0]]
    grid = was.T if turned else was
    width = (PHONE - BESIDE - BAR * (len(figure.axes) > len(panels))) / grid.shape[1]
    heights = [max(_height(axes, width, figure.get_figheight() / places.nrows) for axes in row) for row in grid]
    made = GridSpec(grid.shape[0], grid.shape[1], figure=figure, height_ratios=heights)
    for j, i in np.ndindex(grid.shape):
        axes = grid[j, i]
        axes.set_subplotspec(made[j, i])
        lowest = j == len(grid) - 1 or not axes.get_shared_x_axes().joined(axes, grid[-1, i])
        first = i == 0 or not axes.get_shared_y_axes().joined(axes, grid[j, 0])
        axes.tick_params(labelbottom=lowest, labelleft=first)
        axes.set_xlabel((axes.get_xlabel() or across[j if turned else i]) if lowest else "")
        axes.set_ylabel((axes.get_ylabel() or along[i if turned else j]) if first else "")
        if axes.get_aspect() != "auto":
            axes.locator_params(nbins=4)  # more on a larger image would be wider than the layout has allowed for
    _raise_legend(figure, panels)
    legends = LEGEND * len(figure.legends)
    figure.set_size_inches(PHONE, sum(heights) + legends)
    figure.set_layout_engine(Places(rect=(EDGE, 0.0, 1.0 - EDGE, 1.0 - legends / figure.get_figheight())))
    return True


def _raise_legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """A legend above a panel goes to the top of the figure: a narrow panel is too small for its title and a legend."""
    for axes in panels:
        legend = axes.get_legend()
        if legend and axes.transAxes.inverted().transform(legend.get_bbox_to_anchor().p0)[1] > 0.9:
            entries, colour = axes.get_legend_handles_labels(), legend.get_texts()[0].get_color()
            figure.legend(
                *entries, ncols=len(entries[0]), frameon=False, fontsize=8, labelcolor=colour, handlelength=1.2
            )
            legend.remove()
            break
    for legend in figure.legends:
        legend.set_loc("upper left")
        legend.set_bbox_to_anchor((0.0, 1.0), figure.transFigure)


def _height(axes: Axes, width: float, usual: float) -> float:
    """In, with its labels: of an image that is so wide; of another panel as it was."""
    form = axes.get_aspect()
    return usual if form == "auto" else ABOVE + width * axes.get_data_ratio() * float(form)


def zero(axes: Axes, theme: Theme) -> None:
    """A thin line at 0, behind what is plotted."""
    axes.axhline(0, color=theme["muted"], lw=0.7, zorder=1.5)


def logarithmic(axes: Axes, names: str) -> None:
    """Axes "x", "y" or "xy" with logarithmic scales and plain numbers."""
    for name in names:
        axes.set(**{f"{name}scale": "log"})
        axis = axes.xaxis if name == "x" else axes.yaxis
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")


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
