"""On a SLURM cluster: a job array whose tasks write result files, which are gathered as they grow.

Each array leaves a folder: job.sh (what was submitted), job.json (study and batches), id, a log and a result file for
each task. Task i of n plays batches i, i + n, ... and appends a line to its result file for each; a line that was not
finished does not count, and a task that is started again goes on behind the finished ones.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.studies.study.config import Study, parse
from truestroke.studies.study.executors import Work
from truestroke.studies.study.play import Batch, StudyError, play

POLL = 2.0  # s between two looks at the result files
SCRIPT = """#!/bin/sh
#SBATCH --job-name=truestroke-study
#SBATCH --array=0-{last}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output={folder}/task-%a.log
export OMP_NUM_THREADS=1
exec {python} -m truestroke.studies.study.slurm {folder}
"""


def slurm(folder: str | Path, workers: int = 16, poll: float = POLL) -> Work:
    """As a job array of `workers` tasks of one core; partition, account and time limit come from SBATCH_PARTITION, ...

    Parameters
    ----------
    folder : path
        Where arrays leave their folders: seen by all nodes.
    workers : int
        Tasks of an array.
    poll : float
        Time between two looks at the result files, s.
    """
    count = checks.count("workers", workers, 1, 100_000)
    root = Path(folder).resolve()

    def work(study: Study, batches: Sequence[Sequence[int]], /) -> Iterator[Batch]:
        root.mkdir(parents=True, exist_ok=True)
        there: set[int] = set()
        for job in sorted(root.iterdir(), key=lambda path: int(path.name)):  # of a driver that is gone
            for batch in _gathered(job, poll):
                there |= {row.number for row in batch.rows}
                yield batch
        left = [kept for numbers in batches if (kept := [n for n in numbers if n not in there])]
        if left:
            job = _submitted(root, study, left, min(count, len(left)))
            there = set()
            for batch in _gathered(job, poll):
                there |= {row.number for row in batch.rows}
                yield batch
            if short := sum(map(len, left)) - len(there):
                raise StudyError(f"SLURM ended the array {short} runs short; its logs: {job}/task-*.log")

    return work


def _submitted(root: Path, study: Study, batches: Sequence[Sequence[int]], tasks: int) -> Path:
    """The folder of a new array."""
    folder = root / str(1 + max((int(path.name) for path in root.iterdir()), default=0))
    folder.mkdir()
    about = {"study": study.source, "tasks": tasks, "batches": [list(numbers) for numbers in batches]}
    (folder / "job.json").write_text(json.dumps(about))
    names = {"folder": shlex.quote(str(folder)), "python": shlex.quote(sys.executable)}
    (folder / "job.sh").write_text(SCRIPT.format(last=tasks - 1, **names))
    try:
        done = subprocess.run(
            ["sbatch", "--parsable", str(folder / "job.sh")], check=True, text=True, capture_output=True
        )
    except FileNotFoundError:
        raise SettingError("executor", "slurm", "on a machine that has sbatch") from None
    except subprocess.CalledProcessError as error:
        raise StudyError(f"sbatch refused {folder}/job.sh: {error.stderr.strip()}") from None
    (folder / "id").write_text(done.stdout.strip().partition(";")[0])
    return folder


def _gathered(folder: Path, poll: float) -> Iterator[Batch]:
    """Batches from the result files of an array, until it is over."""
    read: dict[Path, int] = {}
    while True:
        alive = _alive(folder)  # before reading: what a task writes last is read after it has ended
        for file in sorted(folder.glob("task-*.jsonl")):
            for line in _lines(file, read):
                yield Batch.from_dict(json.loads(line))
        if not alive:
            return
        time.sleep(poll)


def _lines(file: Path, read: dict[Path, int]) -> list[bytes]:
    """Finished lines that were not read yet."""
    with file.open("rb") as stream:
        stream.seek(read.get(file, 0))
        text = stream.read()
    finished = text[: text.rfind(b"\n") + 1]
    read[file] = read.get(file, 0) + len(finished)
    return finished.splitlines()


def _alive(folder: Path) -> bool:
    """Whether SLURM still knows of tasks that wait or run."""
    if not (folder / "id").exists():  # the driver was killed as it submitted
        return False
    asked = ["squeue", "--noheader", "--jobs", (folder / "id").read_text()]
    done = subprocess.run(asked, text=True, capture_output=True, check=False)
    if done.returncode and "nvalid job id" not in done.stderr:
        raise StudyError(f"squeue failed: {done.stderr.strip()}")
    return bool(done.stdout.strip())


def task(folder: Path, number: int) -> None:
    """What task `number` of the array does."""
    about = json.loads((folder / "job.json").read_text())
    study, file = parse(about["study"]), folder / f"task-{number}.jsonl"
    file.touch()
    read: dict[Path, int] = {}
    finished = _lines(file, read)
    there = {row["number"] for line in finished for row in json.loads(line)["rows"]}
    os.truncate(file, read[file])  # what a kill left of a line
    for numbers in about["batches"][number :: about["tasks"]]:
        if there.isdisjoint(numbers):
            line = json.dumps(play(study, numbers).as_dict()).encode() + b"\n"
            with file.open("ab") as stream:
                stream.write(line)
                stream.flush()
                os.fsync(stream.fileno())


if __name__ == "__main__":
    task(Path(sys.argv[1]), int(os.environ["SLURM_ARRAY_TASK_ID"]))
