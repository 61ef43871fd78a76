"""The flags of a tick: each one is a line of `Flags`; all other code reads them there."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple


class Flag(NamedTuple):
    """One flag.

    Attributes
    ----------
    name : str
        Member of `Flags`.
    bit : int
        Its value in `flag_bits` and in the channel `flags` of a recording.
    meaning : str
        When it is set; the line of docs/conventions.md.
    words : str
        What the controller did then: "it ... in 12 ticks".
    by_adapt : bool
        Whether `adapt` sets it, and not `command`.
    """

    name: str
    bit: int
    meaning: str
    words: str
    by_adapt: bool


def _flag(meaning: str, words: str, by_adapt: bool = False) -> Any:
    return dataclasses.field(metadata={"meaning": meaning, "words": words, "by_adapt": by_adapt})


@dataclass(frozen=True, slots=True)
class Flags:
    """What happened in the last tick: a bool for each flag, in the order of their bits 1, 2, 4, ...

    The table of docs/conventions.md says when each is set. To add a flag, add a line here, in C, and there; a test
    compares them.

    Examples
    --------
    >>> Flags.from_bits(36).rejected, Flags.from_bits(36).slewed, Flags.from_bits(36).saturated
    (True, True, False)
    """

    saturated: bool = _flag("the command met a voltage limit", "met a voltage limit")
    projected: bool = _flag(
        "a partial slope was limited to `slope_limits`, so that the inverse is defined",
        "limited a partial slope to its bounds",
    )
    rejected: bool = _flag(
        "the measurement was not finite, beyond `measurement_limit`, a spike, too late, or refused by the law, and was "
        "not used",
        "rejected the measurement",
        by_adapt=True,
    )
    held: bool = _flag("adaptation is on hold", "held the adaptation")
    changed: bool = _flag(
        "the actuator has changed suddenly; the controller learns faster for a while",
        "found that the actuator had changed",
        by_adapt=True,
    )
    slewed: bool = _flag("the command met the slew limit", "met the slew limit")
    oscillating: bool = _flag(
        "the controller excites an oscillation of the stage; adaptation pauses, and the corner of its filter is lower",
        "stopped a self-excited oscillation",
        by_adapt=True,
    )
    restored: bool = _flag(
        "learning made the error larger; earlier weights are restored and held",
        "held earlier weights because learning made the error larger",
        by_adapt=True,
    )

    @classmethod
    def from_bits(cls, bits: int) -> Flags:
        """From the bit mask of a recording."""
        return cls(*(bool(bits & flag.bit) for flag in FLAGS))


FLAGS = tuple(Flag(field.name, 1 << place, **field.metadata) for place, field in enumerate(dataclasses.fields(Flags)))
"""Every flag, in the order of its bits."""

BIT = {flag.name: flag.bit for flag in FLAGS}
"""The bit of a flag, by name."""

BY_ADAPT = sum(flag.bit for flag in FLAGS if flag.by_adapt)
"""The bits that `adapt` sets; `command` sets the others."""

IN_SHORT = "bits: " + ", ".join(f"{flag.bit} {flag.name}" for flag in FLAGS)
"""What the channel `flags` holds, in a line."""
