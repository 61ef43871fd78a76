"""The driver: missing runs go to an executor, their results into the store."""

from collections.abc import Callable, Sequence

from truestroke.studies.engine.executors import Work, threads
from truestroke.studies.engine.rows import Run, Study
from truestroke.studies.engine.store import Store

TICKS = 1_000_000  # of controller and plant in a batch: a quarter of a second or more: cheap to distribute
BATCHES = 10_000  # at most: one driver distributes them
TRIES = 20  # samples of which one at least must be possible


def run(
    study: Study, store: Store, work: Work | None = None, progress: Callable[[int, int], None] | None = None
) -> None:
    """Simulate the runs that the store does not have.

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
        The executor did not do its work; the store keeps what it did. An impossible run is a row with its error.
    """
    missing = store.missing(study.numbers)
    if not missing:
        return
    done, runs = len(study.numbers) - len(missing), len(study.numbers)
    if progress:
        progress(done, runs)
    for batch in (work or threads())(study, batches(study, missing)):
        store.add(batch)
        done += len(batch.rows)
        if progress:
            progress(done, runs)


def batches(study: Study, numbers: Sequence[int]) -> list[Sequence[int]]:
    """Split into batches of about `TICKS`, or more where there would be more than `BATCHES`."""
    size = max(1, TICKS // _ticks(study, numbers), -(-len(numbers) // BATCHES))
    return [numbers[i : i + size] for i in range(0, len(numbers), size)]


def _ticks(study: Study, numbers: Sequence[int]) -> int:
    """Of a run with all its controllers, as the first that can be sampled has them; 1 where none can."""
    try:
        run = first(study, numbers)
    except ValueError:
        return 1
    return len(run.trajectory) * len(run.controllers)


def first(study: Study, numbers: Sequence[int]) -> Run:
    """The first of these runs that can be sampled, of the first `TRIES`; the error of the very first if none can."""
    errors: list[ValueError] = []
    for number in numbers[:TRIES]:
        try:
            return study.sample(number)
        except ValueError as error:
            errors.append(error)
    raise errors[0]
