"""Where batches run: each executor takes a study and batches of run numbers and yields results as they come."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from importlib import import_module
from typing import Any, Protocol

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.studies.study.config import Study
from truestroke.studies.study.play import Batch, play

AHEAD = 2  # batches for each worker that are handed out at a time
# Bytes that the C library keeps rather than give back to the system after each array; dask's default is 64 KiB.
TRIM = {"MALLOC_TRIM_THRESHOLD_": str(256 * 2**20), "MALLOC_MMAP_THRESHOLD_": str(32 * 2**20)}

# dask starts a web server without a password beside the scheduler and each worker: they show nothing.
NO_PAGES: dict[str, list[str]] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}

DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # a terminal's Ctrl-C is for the driver alone


class Work(Protocol):
    """An executor."""

    def __call__(self, study: Study, batches: Sequence[Sequence[int]], /) -> Iterator[Batch]:
        """Play all; in any order, each once, but for some after a worker was lost."""


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


def threads(workers: int | None = None) -> Work:
    """On this machine, in threads without the GIL; by default one for each core."""
    count = cores() if workers is None else checks.count("workers", workers, 1, 1024)

    def work(study: Study, batches: Sequence[Sequence[int]], /) -> Iterator[Batch]:
        with ThreadPoolExecutor(count, "study") as pool:
            yield from _stream(pool, study, batches, lambda: count)

    return work


def dask(workers: int | None = None, scheduler: str | None = None) -> Work:
    """On a dask cluster: that of `scheduler` ("tls://host:8786"), or one of processes on this machine.

    The cluster of this machine listens at 127.0.0.1, and talks to those alone who have the certificate that it makes
    for itself (TLS): whoever reaches a scheduler without one runs programs in its owner's name. A batch whose worker
    dies is played again elsewhere. Workers of another cluster want the environment of `TRIM` and the same version of
    truestroke.
    """
    try:
        distributed, config = import_module("distributed"), import_module("dask.config")
        import_module("cryptography")
    except ImportError:
        raise SettingError("executor", "dask", "installed: pip install 'truestroke[dask]'") from None
    count = cores() if workers is None else checks.count("workers", workers, 1, 1024)

    def work(study: Study, batches: Sequence[Sequence[int]], /) -> Iterator[Batch]:
        if scheduler:
            with distributed.Client(scheduler, set_as_default=False) as client:
                yield from _on(client, study, batches)
            return
        environment = config.get("distributed.nanny.pre-spawn-environ", {}) | TRIM
        with (
            config.set({"distributed.nanny.pre-spawn-environ": environment, **NO_PAGES}),
            distributed.LocalCluster(
                count,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                security=True,  # certificates for this cluster alone
                silence_logs=50,
                preload=[DEAF],
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield from _on(client, study, batches)

    return work


def _on(client: Any, study: Study, batches: Sequence[Sequence[int]]) -> Iterator[Batch]:
    pool = client.get_executor(pure=False)
    try:
        yield from _stream(pool, study, batches, lambda: max(1, sum(client.nthreads().values())))
    finally:
        pool.shutdown(wait=False)  # after Ctrl-C nobody wants what still runs


def _stream(
    pool: Executor, study: Study, batches: Sequence[Sequence[int]], workers: Callable[[], int]
) -> Iterator[Batch]:
    """Results as they come; never more than `AHEAD` batches a worker wait at a time."""
    left, waiting = iter(batches), set[Future[Batch]]()
    try:
        while True:
            room = max(0, AHEAD * workers() - len(waiting))
            waiting |= {pool.submit(play, study, tuple(numbers)) for numbers in itertools.islice(left, room)}
            if not waiting:
                return
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for job in done:
                yield job.result()
    finally:
        for job in waiting:
            job.cancel()
