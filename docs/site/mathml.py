"""Equations as MathML, which browsers show without scripts or a network, in a font that comes with the site."""

from __future__ import annotations

import base64
import importlib.metadata
import io
import logging
import re
from pathlib import Path

from docutils import nodes
from fontTools import subset
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

FONT = importlib.metadata.distribution("ziamath").locate_file("ziamath/fonts/STIXTwoMath-Regular.ttf")
LETTERS = ((0x20, 0x7E), (0xA0, 0xFF), (0x300, 0x338), (0x391, 0x3F5), (0x1D400, 0x1D467), (0x1D6A4, 0x1D71B))
SIGNS = ((0x2C6, 0x2DD), (0x2010, 0x2063), (0x20D0, 0x20EF), (0x2190, 0x21D4), (0x2200, 0x22EF), (0x2308, 0x230B))
NUMBER = re.compile(r"\\tag\{(\w+)\}")


def mathml(latex: str, display: str) -> str:
    """The formula as a `math` element; the number of its tag is not in it but beside it on the page."""
    latex = re.sub(r"(begin|end)\{aligned\}", r"\1{align*}", NUMBER.sub("", latex))  # the converter knows the latter,
    latex = re.sub(r"\\mathbf (\w)", r"\\mathbf{\1}", latex)  # and bold letters with braces
    return str(convert(latex.strip(), display=display))


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    """A formula within a line."""
    self.body.append(mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def visit_block(self: HTML5Translator, node: nodes.math_block) -> None:
    """A formula on a line of its own, with its number at the right; a narrow page scrolls it."""
    number = NUMBER.search(node.astext())
    anchor = f' id="equation-{number[1]}"' if number else ""
    shown = f'<span class="eqno">({number[1]})</span>' if number else ""
    formula = mathml(node.astext(), "block")
    box = f'<div class="math" tabindex="0" role="group" aria-label="equation"{anchor}>'
    self.body.append(f"{box}{formula}{shown}</div>\n")
    raise nodes.SkipNode


def style_sheet() -> str:
    """The font of the equations, as data: a browser may refuse a font to a page that is a file."""
    logging.getLogger("fontTools").setLevel(logging.WARNING)  # it lists every glyph
    font = subset.load_font(str(FONT), subset.Options())
    chosen = subset.Subsetter(subset.Options(flavor="woff", hinting=False))
    chosen.populate(unicodes=[code for first, last in LETTERS + SIGNS for code in range(first, last + 1)])
    chosen.subset(font)
    font.flavor, packed = "woff", io.BytesIO()
    font.save(packed)
    data = base64.b64encode(packed.getvalue()).decode()
    return (
        "/* A subset of STIX Two Math; SIL Open Font License 1.1, https://openfontlicense.org */\n"
        f'@font-face {{ font-family: "Equations"; src: url("data:font/woff;base64,{data}") format("woff"); }}\n'
        'math { font-family: "Equations", math; }\n'
    )


def write_style_sheet(app: Sphinx) -> None:
    """Beside the other style sheets."""
    file = Path(app.outdir, "_static", "math.css")
    if app.builder.format == "html":
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(style_sheet())


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer, which `html_math_renderer` selects."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.connect("builder-inited", write_style_sheet)
    app.add_css_file("math.css")
    return {"parallel_read_safe": True, "parallel_write_safe": True}
