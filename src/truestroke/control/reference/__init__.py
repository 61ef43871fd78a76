"""The whole controller in NumPy: the algorithm of the C kernel, in files of the same names."""

from truestroke.control.reference.controller import ReferenceController
from truestroke.control.reference.state import HISTORY, law_of

__all__ = ["HISTORY", "ReferenceController", "law_of"]
