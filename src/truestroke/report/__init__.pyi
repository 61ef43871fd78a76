# What `truestroke.report` offers: `__init__.py` reads this file, and so do type checkers.

from truestroke.report.page import Page as Page
from truestroke.report.plots import error as error
from truestroke.report.plots import loop as loop
from truestroke.report.plots import tracking as tracking
from truestroke.report.plots import uncompensated as uncompensated
from truestroke.report.plots import voltage as voltage
from truestroke.report.plots import weights as weights
from truestroke.report.recording import run_page as run_page
from truestroke.report.recording import run_plots as run_plots
from truestroke.report.style import DARK as DARK
from truestroke.report.style import LIGHT as LIGHT
from truestroke.report.style import THEMES as THEMES
from truestroke.report.style import save as save
