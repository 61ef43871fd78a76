"""Executors take a study and batches of run numbers and yield results as they come; `run` puts these into a store."""

import itertools
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from truestroke.base import checks, interrupts, system
from truestroke.base.checks import SettingError
from truestroke.base.errors import TruestrokeError
from truestroke.studies.engine.rows import Batch, Run, Study, StudyError, simulate
from truestroke.studies.engine.store import Store

TICKS = 1_000_000  # of controller and plant in a batch: a quarter of a second or more: cheap to distribute
BATCHES = 10_000  # at most: one driver distributes them
TRIES = 20  # samples of which one at least must be possible
AHEAD = 2  # batches for each worker that are handed out at a time
# Bytes that the C library keeps rather than give back to the system after each array; dask's default is 64 KiB.
TRIM = {"MALLOC_TRIM_THRESHOLD_": str(256 * 2**20), "MALLOC_MMAP_THRESHOLD_": str(32 * 2**20)}

# dask starts a web server without a password beside the scheduler and each worker: they show nothing.
NO_PAGES: dict[str, list[str]] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}

# A terminal's Ctrl-C is for the driver alone.
IGNORE_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"


class Work(Protocol):
    """An executor."""

    def __call__(self, study: Study, batches: Sequence[Sequence[int]], /) -> Iterator[Batch]:
        """Simulate all; in any order, each once, but for some after a worker was lost."""


def cores() -> int:
    """Those that this process may use."""
    return len(system.processors())


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
    dies is simulated again elsewhere. Workers of another cluster want the environment of `TRIM` and the same version of
    truestroke.
    """
    distributed, config = _installed("dask", "distributed", "dask.config", "cryptography")[:2]
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
                preload=[IGNORE_CTRL_C],
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield from _on(client, study, batches)

    return work


def slurm(folder: str | Path, workers: int = 16) -> Work:
    """On a SLURM cluster, by dask: `workers` jobs of one core, which end with the study.

    Partition, account and time limit come from SBATCH_PARTITION and the other variables of sbatch. A job that reaches
    its limit is submitted again, its batch is simulated again. Scheduler and workers talk by certificates of their own.

    Parameters
    ----------
    folder : path
        For certificates and logs of the jobs: seen by all nodes.
    workers : int
        Jobs.

    Raises
    ------
    SettingError
        dask-jobqueue is not installed, or there is no sbatch on this machine.
    StudyError
        sbatch refuses the jobs.
    """
    modules = "distributed", "dask.config", "dask_jobqueue", "cryptography"
    distributed, config, jobqueue, _ = _installed("slurm", *modules)
    count, place = checks.count("workers", workers, 1, 100_000), str(Path(folder).resolve())
    if shutil.which("sbatch") is None:
        raise SettingError("executor", "slurm", "on a machine that has sbatch")

    def work(study: Study, batches: Sequence[Sequence[int]], /) -> Iterator[Batch]:
        Path(place).mkdir(parents=True, exist_ok=True)
        with (
            config.set(NO_PAGES),
            _certificates(distributed, place) as security,
            jobqueue.SLURMCluster(
                cores=1,
                processes=1,
                memory="1GB",
                job_name="truestroke-study",
                job_directives_skip=["--mem", "-t "],  # as the site has them, or SBATCH_MEM_PER_CPU, SBATCH_TIMELIMIT
                job_extra_directives=["--requeue"],
                job_script_prologue=[f"export {name}={value}" for name, value in TRIM.items()],
                log_directory=place,
                security=security,
                scheduler_options={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                silence_logs=50,
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            _accepted(cluster.job_script())
            cluster.adapt(minimum_jobs=count, maximum_jobs=count)  # one that ends is submitted again
            yield from _on(client, study, batches)

    return work


def _installed(executor: str, *modules: str) -> list[Any]:
    try:
        with interrupts.ignored():  # dask_jobqueue takes Ctrl-C when it is imported; it is given back here
            return [import_module(name) for name in modules]
    except ImportError:
        raise SettingError("executor", executor, f'installed: pip install "truestroke[{executor}]"') from None


@contextmanager
def _certificates(distributed: Any, folder: str) -> Iterator[Any]:
    """A `Security` for one cluster, in files that its nodes read and nobody else; removed at the end."""
    made = distributed.Security.temporary().get_tls_config_for_role("worker")
    with tempfile.TemporaryDirectory(prefix="certificates-", dir=folder) as place:
        files = {part: str(Path(place, part)) for part in ("ca_file", "cert", "key")}
        for part, file in files.items():
            Path(file).write_text(made[part])
        each = [(role, part) for role in ("scheduler", "worker", "client") for part in ("cert", "key")]
        roles = {f"tls_{role}_{part}": files[part] for role, part in each}
        yield distributed.Security(require_encryption=True, tls_ca_file=files["ca_file"], **roles)


def _accepted(script: str) -> None:
    """Ask SLURM first: dask would wait endlessly for jobs that were refused."""
    asked = subprocess.run(["sbatch", "--test-only"], input=script, text=True, capture_output=True, check=False)
    if asked.returncode:
        raise StudyError(f"sbatch refuses the jobs of this study: {' '.join(asked.stderr.split())}")


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
    rest, waiting = iter(batches), set[Future[Batch]]()
    try:
        while True:
            room = max(0, AHEAD * workers() - len(waiting))
            waiting |= {pool.submit(simulate, study, tuple(numbers)) for numbers in itertools.islice(rest, room)}
            if not waiting:
                return
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for job in done:
                yield job.result()
    finally:
        for job in waiting:
            job.cancel()


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
    except (ValueError, TruestrokeError):
        return 1
    return len(run.trajectory) * len(run.controllers)


def first(study: Study, numbers: Sequence[int]) -> Run:
    """The first of these runs that can be sampled, of the first `TRIES`; the error of the very first if none can."""
    errors: list[Exception] = []
    for number in numbers[:TRIES]:
        try:
            return study.sample(number)
        except (ValueError, TruestrokeError) as error:
            errors.append(error)
    raise errors[0]
