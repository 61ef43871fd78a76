"""One file that results stream into: a SQLite database, a transaction a batch, a row a run."""

import hashlib
import json
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from truestroke.base.errors import TruestrokeError
from truestroke.studies.engine.rows import Batch, Row, Study, versions

LAYOUT = 3  # of the tables
TABLES = """
CREATE TABLE IF NOT EXISTS study (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS run (number INTEGER PRIMARY KEY, sampled TEXT NOT NULL, metrics TEXT NOT NULL,
    error TEXT NOT NULL, seal TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS cost (part TEXT PRIMARY KEY, spent REAL NOT NULL, seal TEXT NOT NULL) WITHOUT ROWID;
"""


class StoreError(TruestrokeError, RuntimeError):
    """A file that is not the store of this study, or is damaged."""


def seal(*values: object) -> str:
    """Seal of a row as it was written: a hash of its values.

    >>> seal(7, "x")
    '014d39a27f7b82ad'
    """
    return hashlib.blake2b("\0".join(map(str, values)).encode(), digest_size=8).hexdigest()


class Store:
    """The results of one study.

    A batch is either in it or not, whenever the process is killed; a run that is in it already is not counted again.
    Its format is plain: tables study, run (number, sampled, metrics as JSON, error) and cost. Each row has a seal, and
    the number of rows stands in cost as "rows": a file that was damaged is found when it is opened or read.

    Parameters
    ----------
    path : path
        Of the file; made if it is not there. ":memory:" keeps nothing.
    study : Study
        Whose results it holds.

    Raises
    ------
    StoreError
        The file holds another study, or other versions made it, or it is no store, or damaged.

    Examples
    --------
    >>> import tempfile, tomllib
    >>> from truestroke.studies.study import example, parse, simulate
    >>> study = parse(tomllib.loads(example()))
    >>> with Store(Path(tempfile.mkdtemp()) / "study.sqlite", study) as store:
    ...     store.add(simulate(study, [0, 2]))
    ...     store.missing(range(4))
    [1, 3]
    """

    def __init__(self, path: str | Path, study: Study) -> None:
        self.path = Path(path)
        self._database = sqlite3.connect(self.path, timeout=60.0, isolation_level=None)
        try:
            with self._guarded():
                self._database.execute("PRAGMA journal_mode = WAL")
                self._look()
                self._claim({"study": study.identity(), "versions": versions()})
        except StoreError:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Also twice."""
        self._database.close()

    def add(self, batch: Batch) -> None:
        """Keep a batch, in one transaction; runs that are there already stay as they are."""
        if batch.versions != versions():
            raise StoreError(f"{self.path}: a worker has other versions: {batch.versions} there, {versions()} here")
        made = [(row.number, json.dumps(row.sampled), json.dumps(row.metrics), row.error) for row in batch.rows]
        with self._guarded(), self._database as database:
            database.execute("BEGIN IMMEDIATE")
            sealed = [(*row, seal(*row)) for row in made]
            added = database.executemany("INSERT OR IGNORE INTO run VALUES (?, ?, ?, ?, ?)", sealed).rowcount
            costs = Counter(self._costs())
            costs["rows"] += added
            if added == len(sealed):  # else some of it has been paid for already
                costs["ticks"] += batch.ticks
                costs.update({f"seconds {part}": spent for part, spent in batch.seconds.items()})
            spent = [(part, float(value), seal(part, float(value))) for part, value in costs.items()]
            database.executemany("INSERT OR REPLACE INTO cost VALUES (?, ?, ?)", spent)

    def missing(self, numbers: Sequence[int]) -> list[int]:
        """Those of these that are not there."""
        with self._guarded():
            there = {number for (number,) in self._database.execute("SELECT number FROM run")}
        return [number for number in numbers if number not in there]

    def rows(self, runs: int) -> list[Row]:
        """All of those below `runs` that are there and were simulated, by number."""
        return [row for row in self._rows(runs) if not row.error]

    def failed(self, runs: int) -> list[Row]:
        """Those below `runs` that could not be simulated, each with its error, by number."""
        return [row for row in self._rows(runs) if row.error]

    def _rows(self, runs: int) -> list[Row]:
        ask = "SELECT number, sampled, metrics, error, seal FROM run WHERE number < ? ORDER BY number"
        with self._guarded():
            return [self._row(*found) for found in self._database.execute(ask, [runs])]

    def _row(self, number: int, sampled: str, metrics: str, error: str, sealed: str) -> Row:
        if sealed != seal(number, sampled, metrics, error):
            raise self._damaged(f"run {number} is not as it was written")
        return Row(number, json.loads(sampled), json.loads(metrics), error)

    def cost(self) -> tuple[int, dict[str, float]]:
        """Ticks of controller and plant, and core seconds by part."""
        with self._guarded():
            costs = self._costs()
        ticks = int(costs.get("ticks", 0))
        return ticks, {part.removeprefix("seconds "): value for part, value in costs.items() if part[:8] == "seconds "}

    def _costs(self) -> dict[str, float]:
        found = self._database.execute("SELECT part, spent, seal FROM cost").fetchall()
        for part, spent, sealed in found:
            if sealed != seal(part, spent):
                raise self._damaged(f"the cost of {part!r} is not as it was written")
        return {part: spent for part, spent, _ in found}

    def _look(self) -> None:
        """Make the tables in a new file; of one that is there look whether it is whole."""
        database = self._database
        (layout,) = database.execute("PRAGMA user_version").fetchone()
        if not database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            database.executescript(f"BEGIN IMMEDIATE; {TABLES} PRAGMA user_version = {LAYOUT}; COMMIT")
        elif layout != LAYOUT:
            raise StoreError(
                f"{self.path} is not laid out as a store of this version (layout {layout}, not {LAYOUT}); choose "
                "another --output"
            )
        database.execute("BEGIN")  # one moment of a file that another process may write
        try:
            found = [text for (text,) in database.execute("PRAGMA integrity_check(1)")]
            if found != ["ok"]:
                raise self._damaged(found[0])
            (there,), said = database.execute("SELECT count(*) FROM run").fetchone(), self._costs().get("rows", 0)
            if there != said:
                raise self._damaged(f"it holds {there} runs, not {said:.0f}")
        finally:
            database.execute("ROLLBACK")

    def _damaged(self, what: str) -> StoreError:
        return StoreError(f"{self.path} is damaged: {' '.join(what.split())}; move it away and run the study again")

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """An error of SQLite is a StoreError."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            raise StoreError(f"{self.path}: {error}") from None
        except UnicodeDecodeError:
            raise self._damaged("it holds bytes that are no text") from None

    def _claim(self, about: Mapping[str, Any]) -> None:
        """From the first call on it is for nothing else."""
        for name, value in about.items():
            text = json.dumps(value, sort_keys=True)
            self._database.execute("INSERT OR IGNORE INTO study VALUES (?, ?)", (name, text))
            (kept,) = self._database.execute("SELECT value FROM study WHERE name = ?", (name,)).fetchone()
            if kept != text:
                raise StoreError(f"{self.path} {self._another(name, kept, text)}; choose another --output")

    @staticmethod
    def _another(name: str, kept: str, text: str) -> str:
        """How the study or versions that are there differ from ours."""
        there, here = {}, json.loads(text)
        with suppress(ValueError):
            there = json.loads(kept)
        if not isinstance(there, dict) or not there:
            return f"is damaged: its {name} cannot be read"
        differ = sorted(key for key in there.keys() | here.keys() if there.get(key) != here.get(key))
        return f"holds another study: {name} differs in {', '.join(differ)}"
