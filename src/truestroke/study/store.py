"""One file that results stream into: a SQLite database, a transaction a batch, a row a run."""

from __future__ import annotations

import json
import sqlite3
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from truestroke.study.config import Study
from truestroke.study.play import Batch, Row, versions

TABLES = """
CREATE TABLE IF NOT EXISTS study (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS run (number INTEGER PRIMARY KEY, told TEXT NOT NULL, figures TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS cost (part TEXT PRIMARY KEY, spent REAL NOT NULL) WITHOUT ROWID;
"""
SPEND = "INSERT INTO cost VALUES (?, ?) ON CONFLICT (part) DO UPDATE SET spent = spent + excluded.spent"


class StoreError(RuntimeError):
    """A file that is not the store of this study."""


class Store:
    """The results of one study.

    A batch is either in it or not, whenever the process is killed; a run that is in it already is not counted again.
    Its format is plain: tables study, run (number, told, figures as JSON) and cost.

    Parameters
    ----------
    path : path
        Of the file; made if it is not there.
    study : Study
        Whose results it holds.

    Raises
    ------
    StoreError
        The file holds another study, or other versions made it, or it is no store.

    Examples
    --------
    >>> import tempfile, tomllib
    >>> from truestroke.study import example, parse, play
    >>> study = parse(tomllib.loads(example()))
    >>> with Store(Path(tempfile.mkdtemp()) / "study.sqlite", study) as store:
    ...     store.add(play(study, [0, 2]))
    ...     store.missing(4)
    [1, 3]
    """

    def __init__(self, path: str | Path, study: Study) -> None:
        self.path = Path(path)
        self._database = sqlite3.connect(self.path, timeout=60.0, isolation_level=None)
        try:
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.executescript(TABLES)
            self._claim({"study": study.identity(), "versions": versions()})
        except (sqlite3.DatabaseError, StoreError) as error:
            self.close()
            raise error if isinstance(error, StoreError) else StoreError(f"{path}: {error}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Also twice."""
        self._database.close()

    def add(self, batch: Batch) -> None:
        """Keep a batch, in one transaction; runs that are there already stay as they are."""
        if batch.versions != versions():
            raise StoreError(f"{self.path}: a worker has other versions: {batch.versions} there, {versions()} here")
        rows = [(row.number, json.dumps(row.told), json.dumps(row.figures)) for row in batch.rows]
        costs = {"ticks": batch.ticks, **{f"seconds {part}": spent for part, spent in batch.seconds.items()}}
        with self._database as database:
            database.execute("BEGIN IMMEDIATE")
            added = database.executemany("INSERT OR IGNORE INTO run VALUES (?, ?, ?)", rows).rowcount
            if added == len(rows):  # else some of it has been paid for already
                database.executemany(SPEND, costs.items())

    def missing(self, runs: int) -> list[int]:
        """Numbers below `runs` that are not there."""
        there = {number for (number,) in self._database.execute("SELECT number FROM run")}
        return [number for number in range(runs) if number not in there]

    def rows(self, runs: int) -> list[Row]:
        """All of those below `runs` that are there, by number."""
        found = self._database.execute("SELECT number, told, figures FROM run WHERE number < ? ORDER BY number", [runs])
        return [Row(number, json.loads(told), json.loads(figures)) for number, told, figures in found]

    def cost(self) -> tuple[int, dict[str, float]]:
        """Ticks of controller and plant, and core seconds by part."""
        costs = Counter(dict(self._database.execute("SELECT part, spent FROM cost")))
        return int(costs.pop("ticks", 0)), {part.removeprefix("seconds "): spent for part, spent in costs.items()}

    def _claim(self, about: Mapping[str, Any]) -> None:
        """From the first call on it is for nothing else."""
        for name, value in about.items():
            text = json.dumps(value, sort_keys=True)
            self._database.execute("INSERT OR IGNORE INTO study VALUES (?, ?)", (name, text))
            (kept,) = self._database.execute("SELECT value FROM study WHERE name = ?", (name,)).fetchone()
            if kept != text:
                there, here = json.loads(kept), json.loads(text)
                differ = sorted(key for key in there.keys() | here.keys() if there.get(key) != here.get(key))
                raise StoreError(
                    f"{self.path} holds another study: {name} differs in {', '.join(differ)}; choose another --output"
                )
