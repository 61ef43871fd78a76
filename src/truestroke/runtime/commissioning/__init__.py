"""The guided first volts of an axis: polarity, gain, noise, latency, first resonance, range; each with its bound."""

from truestroke.runtime.commissioning.findings import Findings
from truestroke.runtime.commissioning.loop_back import LoopBack, loop_back
from truestroke.runtime.commissioning.procedure import AnswerError, Range, Small, small_steps, whole_range

__all__ = ["AnswerError", "Findings", "LoopBack", "Range", "Small", "loop_back", "small_steps", "whole_range"]
