"""Computations that are too long for a tick: generators, of which a loop in real time does some steps in each tick.

A step is some operations on arrays, about 20 us of a period of 1000 ticks.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, TypeVar

Result = TypeVar("Result")
Steps = Generator[None, None, Result]
"""What yields after each step but the last one, and returns a result."""


def finished(steps: Steps[Result]) -> Result:
    """The result, all steps at once.

    Examples
    --------
    >>> def added(a, b):
    ...     yield
    ...     return a + b
    >>> finished(added(1, 2))
    3
    """
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result


class Task:
    """Steps that are done in the ticks of a loop.

    Its result comes with the same tick, whether the steps are done one by one or ahead of it, as a copy or a state
    that is written needs them to be.

    Parameters
    ----------
    steps : Steps
        Of the computation.
    each : int
        Steps in a tick.
    """

    def __init__(self, steps: Steps[Any], each: int = 1) -> None:
        self._steps: Steps[Any] | None = steps
        self._each, self._left = each, 0
        self.result: Any = None

    def tick(self) -> bool:
        """The steps of a tick; whether the result is there."""
        if self._steps is None:
            self._left -= 1
            return self._left <= 0
        try:
            for _ in range(self._each):
                next(self._steps)
        except StopIteration as end:
            self.result, self._steps = end.value, None
            return True
        return False

    def finish(self) -> None:
        """Do all steps now; the result is still not there before its tick."""
        if self._steps is None:
            return
        ticks = 1
        while not self.tick():
            ticks += 1
        self._left = ticks

    def __getstate__(self) -> dict[str, Any]:
        self.finish()
        return vars(self)
