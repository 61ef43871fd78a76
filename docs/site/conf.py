"""Settings of Sphinx for `make docs`; the pages come from stage.py, which `make docs` calls first."""

from __future__ import annotations

import sys
from pathlib import Path

import truestroke

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

project = "truestroke"
author = "the truestroke founders"
copyright = f"2026, {author}"
version = release = truestroke.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinx_click",
    "sphinx_design",
    "sphinxcontrib.bibtex",
    "access",
    "docstrings",
    "github",
    "keywords",
    "mathml",
    "sidebar",
]

# The pages are those that GitHub shows: its anchors, its mathematics, its pictures.
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]
myst_dmath_double_inline = True
bibtex_bibfiles = [str(HERE.parent / "references.bib")]
bibtex_reference_style = "author_year"

default_role = "name"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"npt.ArrayLike": "ArrayLike", "FloatArray": "FloatArray"}
autodoc_default_options = {"members": True, "show-inheritance": True}
numpydoc_show_class_members = False  # autodoc has them already
python_use_unqualified_type_names = True
add_module_names = False
maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = "truestroke"
html_static_path = [str(HERE / "static")]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_search_summary = False  # it fetches pages, which a browser refuses to pages of files
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": False}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "github-dark-high-contrast"
suppress_warnings = ["ref.python"]  # a word of a shape, as in (axes,), is the name of several attributes
