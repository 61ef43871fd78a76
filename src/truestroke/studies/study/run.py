"""The driver: what is missing goes to an executor, what comes back into the store."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from truestroke.studies.study.config import Study
from truestroke.studies.study.draw import first
from truestroke.studies.study.executors import Work, threads
from truestroke.studies.study.store import Store

TICKS = 1_000_000  # of controller and plant in a batch: a quarter of a second or more, so handing it round costs little
BATCHES = 10_000  # at most: one driver hands them round


def run(
    study: Study, store: Store, work: Work | None = None, progress: Callable[[int, int], None] | None = None
) -> None:
    """Play the runs that the store does not have.

    Parameters
    ----------
    study : Study
        What.
    store : Store
        Where to.
    work : Work, optional
        The executor; by default threads.
    progress : callable, optional
        Called as progress(runs in the store, all runs).

    Raises
    ------
    StudyError
        The executor did not do its work; the store keeps what it did. A run that cannot be is a row with its error.
    """
    missing = store.missing(study.runs)
    if not missing:
        return
    done = study.runs - len(missing)
    if progress:
        progress(done, study.runs)
    for batch in (work or threads())(study, batches(study, missing)):
        store.add(batch)
        done += len(batch.rows)
        if progress:
            progress(done, study.runs)


def batches(study: Study, numbers: Sequence[int]) -> list[Sequence[int]]:
    """Split into batches of about `TICKS`, or more where there would be more than `BATCHES`."""
    ticks = _ticks(study, numbers) * len(study.controllers)
    size = max(1, TICKS // ticks, -(-len(numbers) // BATCHES))
    return [numbers[i : i + size] for i in range(0, len(numbers), size)]


def _ticks(study: Study, numbers: Sequence[int]) -> int:
    """Of a run, as the first that can be drawn tells; 1 where none can."""
    try:
        return len(first(study, numbers).trajectory)
    except ValueError:
        return 1
