"""Figures and pages; reads recordings only."""
