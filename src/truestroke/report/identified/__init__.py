"""The page of an identified model: how well it predicts, what it is made of, what its record could not tell.

>>> from truestroke.report.identified import save_page, save_pictures
"""

from truestroke.report.identified.page import page, save_page, save_pictures

__all__ = ["page", "save_page", "save_pictures"]
