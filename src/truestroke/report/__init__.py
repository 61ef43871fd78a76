"""Figures and pages; they read recordings and identified models only.

>>> from truestroke.report import THEMES, tracking, error, weights, loop, voltage, save, save_page
"""

from truestroke.report.figures import error, loop, tracking, uncompensated, voltage, weights
from truestroke.report.page import page, pictures, save_page, save_pictures
from truestroke.report.style import DARK, LIGHT, THEMES, save

__all__ = [
    "DARK",
    "LIGHT",
    "THEMES",
    "error",
    "loop",
    "page",
    "pictures",
    "save",
    "save_page",
    "save_pictures",
    "tracking",
    "uncompensated",
    "voltage",
    "weights",
]
