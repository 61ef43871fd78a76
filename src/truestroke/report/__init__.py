"""Plots and pages; they read recordings and identified models only.

>>> from truestroke.report import THEMES, tracking, error, weights, loop, voltage, save, run_page
"""

from truestroke.base import lazy

# The sentences of a page are the terminal's, too, which needs no pictures.
__getattr__, __dir__, __all__ = lazy.attach(__name__)
