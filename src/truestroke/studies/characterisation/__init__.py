"""Sec. 2.4 on any actuator: triangles at several speeds, and for each play a line of its weight against velocity."""

from truestroke.studies.characterisation.lines import Characterisation, NotConverged, fit_lines
from truestroke.studies.characterisation.procedure import characterise, sweep

__all__ = ["Characterisation", "NotConverged", "characterise", "fit_lines", "sweep"]
