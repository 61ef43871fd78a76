"""Weights from a record of voltage and displacement."""
