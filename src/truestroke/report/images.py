"""Pictures of images: one image, trace and retrace laid over one another, and the page of `unwarp`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from truestroke.report import style, words
from truestroke.report.page import Page, Section, Table, captioned
from truestroke.report.style import LIGHT, Theme
from truestroke.signals.scans.images import Image

if TYPE_CHECKING:
    from truestroke.identification.unwarp import Unwarped  # a page of a scan needs no identification

FLATTEST = 0.1  # height over width: a strip that is flatter is shown as high as this
ROUND = 0.8  # in of title and labels around an image
COLOURS = "#ff4d33", "#00b2cc"  # of trace and retrace: together they are white
LAID_OVER = (
    "Trace in red and retrace in cyan, laid over one another: grey where they agree, coloured edges where the same "
    "thing is in two places."
)
CAPTIONS = {
    "before": ("Trace and retrace, before", LAID_OVER),
    "after": ("Trace and retrace, after", LAID_OVER + " The part is the same."),
    "image": ("The image, corrected", "The trace at even places. White is where no line has been."),
}
WORDS = {"good": "Trace and retrace agree.", "doubtful": "Read this before you use it.", "bad": "Do not use it."}


def show(axes: Axes, image: Image, *, limits: tuple[float, float] | None = None) -> None:
    """One image in grey, with its lengths in um."""
    low, high = limits or contrast(image)
    axes.imshow(image.data, origin="lower", extent=image.extent, cmap="gray", vmin=low, vmax=high, interpolation="none")
    _framed(axes)


def lay_over(axes: Axes, trace: Image, retrace: Image, *, part: tuple[slice, slice] | None = None) -> None:
    """Trace in red, retrace in cyan; `part` of rows and columns, by default all."""
    rows, columns = part or (slice(None), slice(None))
    low, high = contrast(trace)
    shown = []
    for image, colour in zip((trace, retrace), COLOURS, strict=True):
        level = np.nan_to_num(np.clip((image.data[rows, columns] - low) / (high - low or 1.0), 0.0, 1.0))
        shown.append(level[:, :, None] * np.array(to_rgb(colour)))
    left, _, bottom, _ = trace.extent
    width, height = trace.pixel
    first, up = (one.indices(size)[0] for one, size in zip((columns, rows), trace.data.shape[::-1], strict=True))
    size = shown[0].shape
    extent = (
        left + first * width,
        left + (first + size[1]) * width,
        bottom + up * height,
        bottom + (up + size[0]) * height,
    )
    axes.imshow(np.clip(sum(shown), 0.0, 1.0), origin="lower", extent=extent, interpolation="none")
    _framed(axes)


def contrast(image: Image) -> tuple[float, float]:
    """Lowest and highest level that is shown: all but the outermost half per cent."""
    known = image.data[np.isfinite(image.data)]
    low, high = np.percentile(known, [0.5, 99.5]) if known.size else (0.0, 1.0)
    return float(low), float(high if high > low else low + 1.0)


def middle(image: Image, pixels: int = 128) -> tuple[slice, slice]:
    """The part in the middle, of so many rows and columns at most."""
    rows, columns = (max((size - pixels) // 2, 0) for size in image.data.shape)
    return slice(rows, rows + pixels), slice(columns, columns + pixels)


def _size(image: Image, part: tuple[slice, slice]) -> tuple[float, float]:
    """Width and height of a part of rows and columns, um."""
    rows, columns = (len(range(*one.indices(size))) for one, size in zip(part, image.data.shape, strict=True))
    return columns * image.pixel[0], rows * image.pixel[1]


def aspect(size: tuple[float, float]) -> float:
    """Height over width of the picture of an image of this width and height, um."""
    return max(size[1] / size[0], FLATTEST)


def height(size: tuple[float, float], width: float, most: float) -> float:
    """Inches, of a figure with such an image so many inches wide, or narrower where it would be higher than `most`."""
    return ROUND + min(width * aspect(size), most)


def alone(size: tuple[float, float], width: float, most: float, beside: float = 0.0) -> tuple[Figure, Axes]:
    """A figure as large as one such image, its labels, and what is `beside` it, in: a phone shows all of it."""
    high = height(size, width, most)
    wide = min(ROUND + (high - ROUND) / aspect(size) + beside, style.WIDTH)
    figure, (panel,) = style.panels(high, width=wide)
    return figure, panel


def label(axes: Axes, across: str = "x", along: str = "y") -> None:
    """Names of the axes of an image."""
    axes.set(xlabel=f"{across} (µm)", ylabel=f"{along} (µm)")


def _framed(axes: Axes) -> None:
    axes.grid(False)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    size = right - left, high - low
    axes.set_aspect(aspect(size) * size[0] / size[1])
    if aspect(size) < 0.5:
        axes.locator_params(axis="y", nbins=3)
    for side in ("top", "right", "bottom", "left"):
        axes.spines[side].set(visible=True, linewidth=0.5)
    axes.tick_params(length=2, pad=2)


# ---- The page of unwarp --------------------------------------------------------------------------------------------


def rows(found: Unwarped) -> list[list[str]]:
    """What was found, in pixels."""
    made = [["moved at most", f"{found.moved:.1f} pixels"]]
    for name, apart in (("before", found.before), ("after", found.after)):
        if apart is not None:
            made.append([f"trace and retrace apart, {name}", f"{apart[0]:.2f} across, {apart[1]:.2f} along"])
    if found.timing:
        made.append(["place by the trigger", f"+-{found.timing:.2f} pixels"])
    if found.hum:
        made.append(["hum taken off", found.hum])
    if found.even_rows:
        made.append(["slow axis", "not corrected: without a model of y (--model-y) its rows are even"])
    return made


def as_dict(found: Unwarped) -> dict[str, object]:
    """For JSON, pixels."""
    names = ("before", "after", "moved", "timing")
    return {f"{name}_pixels": getattr(found, name) for name in names}


def page(found: Unwarped, before: dict[str, Image], command: str | None = None) -> Page:
    """The page of a corrected image; `command` is what repeats it."""
    seen = next(iter(found.images.values()))
    lead = f"{seen.data.shape[1]} x {seen.data.shape[0]} pixels, corrected by the model and the voltage alone."
    return Page(
        title=f"An image of {seen.size[0]:.3g} x {seen.size[1]:.3g} um, unwarped",
        lead=lead,
        verdict=found.verdict,
        remark=WORDS[found.verdict.level],
        sections=[Section(tables=[Table(rows=rows(found), kind="words")]), *captioned(CAPTIONS)],
        plots=lambda theme: plots(found, before, theme),
        command=command,
        footer=words.made_now(),
    )


def plots(found: Unwarped, before: dict[str, Image], theme: Theme = LIGHT) -> dict[str, Figure]:
    """The corrected trace; trace and retrace before and after, where there are two."""
    made = {}
    with style.use(theme):
        if len(found.images) == 2:
            for name, pair in (("before", before), ("after", found.images)):
                part = middle(pair["trace"])
                figure, panel = alone(_size(pair["trace"], part), 5.0, 4.2)
                lay_over(panel, pair["trace"], pair["retrace"], part=part)
                label(panel)
                made[name] = figure
        seen = next(iter(found.images.values()))
        figure, panel = alone(seen.size, 5.0, 4.2)
        show(panel, seen)
        label(panel)
        made["image"] = figure
    return made
