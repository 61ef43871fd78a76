"""Spans of time in which a limit is exceeded, each with its largest excess."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truestroke.base.display import figures
from truestroke.base.typing import FloatArray

MERGED = 0.002  # s: spans nearer than this are one


@dataclass(frozen=True)
class Span:
    """A span of time in which a limit is exceeded.

    Attributes
    ----------
    start, stop : float
        s; stop is the end of the last sample.
    worst : float
        How far at the most, in the unit of what is exceeded.
    """

    start: float
    stop: float
    worst: float


@dataclass(frozen=True)
class Beyond:
    """Spans in which a prediction is beyond the record of its model.

    Attributes
    ----------
    voltage : tuple[Span, ...]
        Outside of the range of the record, V.
    velocity : tuple[Span, ...]
        Faster than the record, um/s.
    frequency : tuple[Span, ...]
        Motion above `tested_frequency`, um: sharp turns, steps.
    tested_frequency : float
        Up to which the record tests the response of the stage, Hz; 0 is not known.
    """

    voltage: tuple[Span, ...]
    velocity: tuple[Span, ...]
    frequency: tuple[Span, ...] = ()
    tested_frequency: float = 0.0

    @property
    def warnings(self) -> tuple[str, ...]:
        """In words, where there are any."""
        turns = (
            f"turns or steps with motion above {figures(self.tested_frequency)} Hz, where the record tests no response"
        )
        found = [
            in_words("outside of the voltages of the record", self.voltage, "by at most", "V"),
            in_words("faster than the record", self.velocity, "by at most", "um/s"),
            in_words(turns, self.frequency, "of at most", "um"),
        ]
        return tuple(words for words in found if words)


def spans(excess: FloatArray, sample_rate: float, worst: FloatArray | None = None) -> tuple[Span, ...]:
    """Spans in which `excess` is above 0; those that are nearer than 2 ms are one.

    Parameters
    ----------
    excess : ndarray, shape (samples,)
        How far something is beyond its bound.
    sample_rate : float
        Hz.
    worst : ndarray, shape (samples,), optional
        Whose maximum is `Span.worst`; by default `excess`.

    Examples
    --------
    >>> spans(np.array([-1.0, 2.0, 3.0, -1.0]), sample_rate=2.0)
    (Span(start=0.5, stop=1.5, worst=3.0),)
    """
    at = np.flatnonzero(excess > 0)
    if not at.size:
        return ()
    worst = excess if worst is None else worst
    parts = np.split(at, np.flatnonzero(np.diff(at) > max(1.0, MERGED * sample_rate)) + 1)
    ends = ((part, float(part[0] / sample_rate), float((part[-1] + 1) / sample_rate)) for part in parts)
    return tuple(Span(start, stop, float(worst[part].max())) for part, start, stop in ends)


def in_words(what: str, found: Sequence[Span], how_far: str, unit: str) -> str:
    """What happens, how often, when first, and how far at the most; empty where it does not."""
    if not found:
        return ""
    first, worst = found[0], max(found, key=lambda span: span.worst)
    place = f"{worst.start:.3f} to {worst.stop:.3f} s"
    amount = f"{how_far} {figures(worst.worst)} {unit}"
    if len(found) == 1:
        return f"{what}, once, {place}, {amount}"
    total = sum(span.stop - span.start for span in found)
    return f"{what}, {len(found)} times, first at {first.start:.3f} s, {total:.3g} s in all, {amount} ({place})"
