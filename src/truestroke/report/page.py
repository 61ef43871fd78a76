"""One class for every page: a self-contained HTML file of a title, a verdict, tables, plots and what repeats it."""

import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import escape

import jinja2
import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from truestroke.base import checks, files
from truestroke.base.typing import FloatArray
from truestroke.base.verdict import Verdict
from truestroke.report import charts, style, units
from truestroke.report.charts import Chart
from truestroke.report.style import Theme

MANY = 6  # columns that a phone never shows side by side
PHONE, LETTER, GAP = 320.0, 10.0, 12.0  # px: a page within its margins, a letter, what is between two columns
IN_SCRIPT = str.maketrans({"<": "\\u003c", "&": "\\u0026"})  # letters of HTML and XML inside JSON
NARROW = 0.85  # of the standard width: a picture that is narrower remains so, and on a phone is as wide as that
IMAGE = re.compile(
    r'<image xlink:href="[^"]*" id="(?P<id>[^"]*)" width="(?P<width>[^"]*)" height="(?P<height>[^"]*)" '
    r'transform="matrix\((?P<matrix>[^)]*)\)"[^>]*/>'
)
Plots = Callable[[Theme], Mapping[str, Figure]]
"""Makes all plots of a page, by name, in one theme."""


@dataclass(frozen=True)
class Number:
    """A cell of a summary: a value with its unit, and its share of the stroke, as text."""

    value: str
    unit: str
    share: str


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table, as text; lengths may say um.

    Attributes
    ----------
    columns : sequence of str
        Heads; empty for a table without.
    rows : sequence of sequences of str or Number
        The first entry of a row is its head. In a row of two, where there are more columns, the second spans the rest.
    kind : str
        "summary": the few numbers that a reader looks for; "numbers": right-aligned; "words": left-aligned.
    text : bool
        Whether the last column is text.
    note : str
        Below it.
    """

    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str | Number]]
    kind: Literal["summary", "numbers", "words"] = "numbers"
    text: bool = False
    note: str = ""

    @property
    def many(self) -> bool:
        """Whether it stands row by row on a phone: it has many columns, or words that are too long side by side."""
        if len(self.columns) >= MANY or self.kind != "numbers":
            return len(self.columns) >= MANY
        lines = [cells for cells in (self.columns, *self.rows) if len(cells) == len(self.columns)]
        widest = (
            max(len(word) for cell in column for word in [*str(cell).split(), ""])
            for column in zip(*lines, strict=True)
        )
        return LETTER * sum(widest) + GAP * (len(self.columns) - 1) > PHONE


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of a page, shown in this order: heading, text, list, tables, code, chart, plot with its caption.

    Attributes
    ----------
    heading, text : str
        Empty for none.
    items : sequence of str
        Of a list.
    tables : sequence of Table
        One below the other.
    code : str
        Commands, as they are typed.
    plot, caption : str
        Name of a plot and its explanation. The section is left out where the page makes no such plot.
    chart : Chart or None
        To zoom into, with the caption. A section without plot is shown where the reader's program runs scripts.
    beside : bool
        Half as wide as the page, beside its neighbour.
    folded : bool
        After all others; only its heading is shown until it is opened.
    """

    heading: str = ""
    text: str = ""
    items: Sequence[str] = ()
    tables: Sequence[Table] = ()
    code: str = ""
    plot: str = ""
    caption: str = ""
    chart: Chart | None = None
    beside: bool = False
    folded: bool = False


def captioned(captions: Mapping[str, tuple[str, str]]) -> list[Section]:
    """A section for each plot, of (heading, caption) by its name."""
    return [Section(heading=heading, plot=name, caption=text) for name, (heading, text) in captions.items()]


def closer(chart: Chart) -> Section:
    """A section to zoom into a chart."""
    return Section(
        heading="Look closer",
        chart=chart,
        caption="Drag across a part to zoom into it, or use the buttons, the keys + - and the arrows, or two fingers; "
        "the panels move together. The address of the page keeps the part, to be sent to a colleague.",
    )


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page; nothing outside its file is needed to read it.

    Attributes
    ----------
    title, lead : str
        The heading, and the result in a sentence.
    sections : sequence of Section
        In their order.
    plots : callable
        plots(theme) makes the plots that sections name.
    verdict : Verdict or None
        Shown above all sections, with its reasons.
    remark : str
        After the level of the verdict: its meaning.
    command : str or None
        What makes the page again.
    footer : str
        Where it comes from, in a line.
    """

    title: str
    lead: str
    sections: Sequence[Section]
    plots: Plots
    verdict: Verdict | None = None
    remark: str = ""
    command: str | None = None
    footer: str = ""

    @property
    def made_by(self) -> str:
        """The command that makes it, without its options; "" where none does."""
        words = (self.command or "").split()
        return words[1] if words[:1] == ["truestroke"] and len(words) > 1 else ""

    def html(self) -> str:
        """The page as HTML; it is also well-formed XML."""
        made = self.plots(style.PAGE)
        shown = [section for section in self.sections if not section.plot or section.plot in made]
        svgs = {s.plot: _svgs(made[s.plot], s.plot, s.caption or s.heading) for s in shown if s.plot}
        left = min(charts.BUDGET, max(charts.LEAST, charts.PAGE - sum(map(len, svgs.values()))))
        each = left // max(1, sum(section.chart is not None for section in shown))
        return _template().render(
            page=self,
            data=lambda chart: Markup(json.dumps(chart.encoded(each)).translate(IN_SCRIPT)),
            sections=shown,
            scripts=_scripts() if any(section.chart for section in shown) else None,
            svgs=svgs,
            **{theme.name: _variables(theme) for theme in (style.LIGHT, style.DARK)},
        )

    def save(self, path: str | Path) -> Path:
        """Write the page to `path`, which is returned."""
        return files.write(checks.path("path", path), self.html(), files.page(self.made_by))

    def save_plots(self, directory: str | Path) -> list[Path]:
        """Write all plots as PNG, light and dark, into `directory`; the paths."""
        return save_plots(self.plots, directory)


def save_plots(plots: Plots, directory: str | Path) -> list[Path]:
    """Write the pictures of `plots` as NAME-light.png and NAME-dark.png into `directory`; the paths."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    return [
        style.save(figure, directory / f"{name}-{theme.name}.png")
        for theme in (style.LIGHT, style.DARK)
        for name, figure in plots(theme).items()
    ]


def typeset(text: str) -> Markup:
    """A text of the terminal as HTML: um as µm; text in backticks as code, unchanged.

    Examples
    --------
    >>> print(typeset("at most 1 um < 2 um/s: change `um_per_volt = 10 # um`, or um_per_unit"))
    at most 1 µm &lt; 2 µm/s: change <code>um_per_volt = 10 # um</code>, or um_per_unit
    """
    parts = enumerate(re.split("`([^`]*)`", text))  # text, code, text, ...
    return Markup("").join(Markup("<code>{}</code>").format(part) if i % 2 else units.micro(part) for i, part in parts)


def svg(figure: Figure, name: str, description: str) -> str:
    """The figure, plotted in the theme "page", as SVG for inside a page.

    Its colours are CSS variables, its ids begin with `name` so that they are unique on the page, and it says
    `description` to a screen reader.
    """
    file, canvas = io.StringIO(), FigureCanvasSVG(figure)
    parameters: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": name}
    with matplotlib.rc_context(parameters), style.placed(figure, style.VECTOR_DPI):
        canvas.print_svg(file, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style type=.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|"#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(?<=\.\d\d)\d+", "", path[0]), text)
    for variable, colour in style.PAGE.variables.items():
        text = text.replace(colour, f"var(--{variable})")
    box = re.search(r'viewBox="[^"]*"', text)
    share = figure.get_figwidth() / style.WIDTH
    narrow = f'class="narrow" style="max-width: {100 * share:.0f}%"' if share < NARROW else ""
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {box[0] if box else ""} '
        f"{narrow} "
        f'role="img" aria-labelledby="{name}-title"><title id="{name}-title">{escape(units.micro(description))}</title>'
    )
    return re.sub(r"<svg[^>]*>", lambda _: opening, text, count=1)


def _svgs(figure: Figure, name: str, description: str) -> str:
    """The figure as on a page and, where a phone needs another, as there; the style sheet shows one of them.

    The pixels of an image are there once: in the second picture one empty pixel stands in for them, and their place.
    """
    wide = svg(figure, name, description)
    if not style.for_phone(figure):
        return wide
    firsts = list(IMAGE.finditer(wide))
    for shown in (one for axes in figure.axes for one in axes.images) if firsts else ():
        shown.set_extent(shown.get_extent())
        shown.set_data(np.zeros((1, 1, 4)))
    following = iter(firsts)

    def again(image: re.Match[str]) -> str:
        first = next(following)
        (xx, yx, xy, yy, x, y) = (_place(image) @ np.linalg.inv(_place(first)))[:2].T.ravel()
        return f'<use xlink:href="#{first["id"]}" transform="matrix({xx:g} {yx:g} {xy:g} {yy:g} {x:.6f} {y:.6f})"/>'

    return wide + IMAGE.sub(again, svg(figure, f"{name}-phone", description))


def _place(image: re.Match[str]) -> FloatArray:
    """Where an image is: the matrix, of shape (3, 3), that moves the square of 0 to 1 there."""
    moved = np.reshape([float(x) for x in image["matrix"].split()], (3, 2)).T
    return np.vstack([moved * [float(image["width"]), float(image["height"]), 1.0], [0.0, 0.0, 1.0]])


@cache
def _template() -> jinja2.Template:
    """Compiled for the first page of a process: 17 ms."""
    environment = jinja2.Environment(loader=jinja2.PackageLoader("truestroke.report"), autoescape=True)
    environment.filters |= {"typeset": typeset, "micro": units.micro}
    return environment.get_template("page.html.j2")


def _scripts() -> dict[str, Markup]:
    """The script of charts and what it needs: inside the page, so that it is read without a network."""
    folder = resources.files("truestroke.report")
    parts = {"uplot": "uplot/uPlot.iife.min.js", "style": "uplot/uPlot.min.css", "charts": "templates/charts.js"}
    return {name: Markup(folder.joinpath(path).read_text("utf-8")) for name, path in parts.items()}


def _variables(theme: Theme) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in theme.variables.items())
