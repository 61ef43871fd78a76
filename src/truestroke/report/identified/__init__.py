"""The page of an identified model: how well it predicts, what it is made of, what its record could not tell.

>>> from truestroke.report.identified import model_page
"""

from truestroke.report.identified.page import model_page

__all__ = ["model_page"]
