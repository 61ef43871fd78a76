"""The guided first volts of an axis: polarity, gain, noise, latency, first resonance, range; each with its bound."""

from truestroke.runtime.commissioning.findings import Findings
from truestroke.runtime.commissioning.procedure import AnswerError, Range, Small, small_steps, whole_range

__all__ = ["AnswerError", "Findings", "Range", "Small", "small_steps", "whole_range"]
