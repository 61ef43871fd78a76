"""Plots and pages; they read recordings and identified models only.

>>> from truestroke.report import THEMES, tracking, error, weights, loop, voltage, save, run_page
"""

from truestroke.report.page import Page
from truestroke.report.plots import error, loop, tracking, uncompensated, voltage, weights
from truestroke.report.recording import run_page, run_plots
from truestroke.report.style import DARK, LIGHT, THEMES, save

__all__ = [
    "DARK",
    "LIGHT",
    "THEMES",
    "Page",
    "error",
    "loop",
    "run_page",
    "run_plots",
    "save",
    "tracking",
    "uncompensated",
    "voltage",
    "weights",
]
