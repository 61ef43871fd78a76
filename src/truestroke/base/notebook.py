"""What a cell of a notebook shows while it runs: a bar, and nothing anywhere else."""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

REFRESH = 0.2  # s between two changes of the bar

Progress = Callable[[int, int], None]


def shown_in() -> Any:
    """IPython's module of displays within a notebook; None in a script, a terminal or a test."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython import display

    return display


@contextmanager
def progress(what: str, asked: Progress | None = None) -> Iterator[Progress | None]:
    """What a caller asked for, or in a notebook a bar that goes when the work is done.

    >>> with progress("a run") as report:
    ...     print(report)
    None
    """
    place = None if asked else shown_in()
    if place is None:
        yield asked
        return
    handle = place.display(place.HTML(bar(what)), display_id=True)
    last = [time.monotonic()]

    def report(done: int, everything: int) -> None:
        if time.monotonic() - last[0] >= REFRESH or done >= everything:
            last[0] = time.monotonic()
            handle.update(place.HTML(bar(what, done, everything)))

    try:
        yield report
    finally:
        handle.update(place.HTML(""))


def bar(what: str, done: int | None = None, everything: int = 1) -> str:
    """HTML; without `done` one whose end is not known.

    >>> bar("run", 5, 20)
    '<label>run <progress max="20" value="5"></progress> 25 %</label>'
    """
    if done is None:
        return f"<label>{html.escape(what)} <progress></progress></label>"
    share = f'<progress max="{everything}" value="{done}"></progress> {100 * done // everything} %'
    return f"<label>{html.escape(what)} {share}</label>"
