"""Whether a result is good, in a word and the reasons for it: the same on the terminal, on the page and in JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import count, takewhile
from typing import Any, Literal

Level = Literal["good", "doubtful", "bad"]
LEVEL, REASON = "verdict", "reason_{}"  # names in the files of models and waveforms


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a result is to be used.

    Attributes
    ----------
    level : str
        "good"; "doubtful": usable, but read the reasons; "bad": do not use it, the command exits with 4.
    reasons : tuple[str, ...]
        A sentence for each finding, the worst first; empty where it is good.

    Examples
    --------
    >>> Verdict("bad", ("The command was at a voltage limit in 97 % of the ticks.",)).is_bad
    True
    """

    level: Level
    reasons: tuple[str, ...] = ()

    @classmethod
    def of(cls, findings: Iterable[tuple[Level, str]]) -> Verdict:
        """As bad as the worst finding; the reasons of each level in their order.

        >>> Verdict.of([("doubtful", "It was late."), ("bad", "It did not move.")])
        Verdict(level='bad', reasons=('It did not move.', 'It was late.'))
        """
        found = list(findings)
        levels: tuple[Level, ...] = ("bad", "doubtful")
        worst: Level = next((level for level in levels if any(level == one for one, _ in found)), "good")
        return cls(worst, tuple(reason for level in levels for one, reason in found if one == level))

    @classmethod
    def named(cls, entries: Mapping[str, str]) -> Verdict:
        """That of a file, by its entries; good where it says nothing against its contents.

        >>> Verdict.named({"verdict": "bad", "reason_1": "It did not move."})
        Verdict(level='bad', reasons=('It did not move.',))
        """
        level = entries.get(LEVEL)
        if level not in ("bad", "doubtful"):
            return cls("good")
        numbered = takewhile(entries.__contains__, map(REASON.format, count(1)))
        return cls("bad" if level == "bad" else "doubtful", tuple(entries[name] for name in numbered))

    @property
    def entries(self) -> dict[str, str]:
        """For a file, each reason with a name of its own.

        >>> Verdict("bad", ("It did not move.",)).entries
        {'verdict': 'bad', 'reason_1': 'It did not move.'}
        """
        return {LEVEL: self.level, **{REASON.format(k): reason for k, reason in enumerate(self.reasons, 1)}}

    @property
    def is_bad(self) -> bool:
        """Whether the result is not to be used."""
        return self.level == "bad"

    def as_dict(self) -> dict[str, Any]:
        """For JSON: verdict and reasons."""
        return {"verdict": self.level, "reasons": list(self.reasons)}
