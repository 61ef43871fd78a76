"""Weights from a record of voltage and displacement (Sec. 2.2 to 2.4)."""

from truestroke.identification.least_squares import FittedWeights, fit

__all__ = ["FittedWeights", "fit"]
