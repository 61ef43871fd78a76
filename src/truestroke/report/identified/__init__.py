"""The page of an identified model: prediction errors, structure, and what its record could not identify.

>>> from truestroke.report.identified import model_page
"""

from truestroke.report.identified.page import model_page, tested_range

__all__ = ["model_page", "tested_range"]
