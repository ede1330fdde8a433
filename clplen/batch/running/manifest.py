"""The manifest, one SQLite file: the last report of every item, and the state of each."""

from __future__ import annotations

import errno
import json
import os
import sqlite3
import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from clplen import __version__
from clplen.batch.jobs.items import tasks_of
from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Report, Task
from clplen.batch.work.execution import RECORD, read_record, result_folder
from clplen.batch.work.fingerprints import find_damage, is_unchanged
from clplen.errors import FormatError
from clplen.io.store.digest import digest

NAME = "manifest.sqlite"
VERSION = 1  # of the tables
_TABLES = f"""
BEGIN;
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE items (
    name TEXT PRIMARY KEY, state TEXT NOT NULL, started REAL NOT NULL, seconds REAL,
    device TEXT, worker TEXT, error TEXT, report TEXT NOT NULL
);
INSERT INTO meta VALUES ('version', '{VERSION}'), ('software', '"clplen {__version__}"');
COMMIT;
"""


_OWN = {("table", "meta"), ("table", "items")}


class Known(NamedTuple):
    """What the manifest knows of an item: as in its last `Report`."""

    state: str
    started: float
    error: str


class Manifest:
    """States of items; each change is on the disk when its method returns.

    Written by one process at a time, which holds the job; others may read.
    """

    def __init__(self, folder: Path, *, create: bool = False) -> None:
        self._path = folder / NAME
        self._lock = threading.Lock()
        if not self._path.exists() and not create:
            raise FormatError(f"There is no manifest {self._path}: run the job first.")
        self._open(create)

    def _open(self, create: bool) -> None:
        with _said(self._path):
            self._connection = sqlite3.connect(self._path, check_same_thread=False)
            self._connection.text_factory = lambda text: text.decode("utf-8", "replace")
            self._connection.execute("PRAGMA synchronous = FULL")
            held = set(self._connection.execute("SELECT type, name FROM sqlite_master"))
            if not held and not create:  # its maker has not come to the tables
                raise FormatError(f"The manifest {self._path} is empty: run the job first.")
            if not held:
                self._connection.executescript(_TABLES)
            self._inode = self._path.stat().st_ino
            is_own = not held or (held >= _OWN and "trigger" not in {kind for kind, _ in held})
            version = self._get("version") if is_own else None  # views and triggers are programs
        if not isinstance(version, int):
            raise FormatError(f"{self._path} is no manifest of clplen: move it away.")
        if version > VERSION:
            raise FormatError(
                f"{self._path} is of version {version}, and this clplen {__version__} knows up to "
                f"{VERSION}: use a newer clplen, or give the job another output."
            )

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Manifest:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def job(self) -> dict[str, Any] | None:
        """What the job was when it ran last (`Job.contents`)."""
        with self._lock, _said(self._path):
            found = self._get("job")
        return found if isinstance(found, dict) else None

    @job.setter
    def job(self, content: dict[str, Any]) -> None:
        with self._lock, _said(self._path), self._connection:
            self._set("job", content)

    def known(self) -> dict[str, Known]:
        """Return what became of each item last; the column ``report`` has their whole reports.

        A damaged row is left out: the records of the items say the same.
        """
        with self._lock, _said(self._path):
            rows = self._connection.execute("SELECT name, state, started, error FROM items")
            return {
                os.fsdecode(name): Known(*rest)
                for name, *rest in rows
                if all(map(isinstance, (name, *rest), (str | bytes, str, float, str)))
            }

    def put(self, *reports: Report) -> None:
        """Take in what became of items."""
        rows = [
            (
                _storable(one.name),
                one.state,
                one.started,
                one.seconds.get("total"),
                one.device,
                one.worker,
                one.error.encode(errors="backslashreplace").decode(),
                one.to_json(),
            )
            for one in reports
        ]
        with self._lock, _said(self._path), self._connection:
            self._connection.executemany(
                "INSERT OR REPLACE INTO items VALUES (?, ?, ?, ?, ?, ?, ?, ?)", rows
            )

    def is_there(self) -> bool:
        """Whether the file is still the one that was opened."""
        try:
            return self._path.stat().st_ino == self._inode
        except OSError:
            return False

    def renew(self, job: dict[str, Any]) -> None:
        """Begin it anew where it vanished."""
        with self._lock, _said(self._path):
            self._connection.close()
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._open(create=True)
        self.job = job

    def _get(self, key: str) -> Any:
        try:
            row = self._connection.execute(
                "SELECT value FROM meta WHERE key = ?", (key,)
            ).fetchone()
        except sqlite3.OperationalError:  # no such table
            return None
        return None if row is None else json.loads(row[0])

    def _set(self, key: str, value: Any) -> None:
        self._connection.execute(
            "INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, json.dumps(value))
        )


def _storable(name: str) -> str | bytes:
    """The name of an item as SQLite takes it: its bytes where they are not UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return os.fsencode(name)
    return name


@contextmanager
def _said(path: Path) -> Iterator[None]:
    """Errors of SQLite as ours."""
    try:
        yield
    except (sqlite3.OperationalError, sqlite3.InternalError) as error:
        if "no such" in str(error):  # table or column
            raise _damaged(path, error) from error
        full = "full" in str(error)
        raise OSError(
            errno.ENOSPC if full else errno.EIO,
            f"The manifest cannot be written ({error}): "
            + ("make room on the disk and run again" if full else "see to its folder"),
            str(path),
        ) from error
    except (sqlite3.DatabaseError, ValueError, RecursionError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> FormatError:
    return FormatError(
        f"{path} is damaged or no manifest of clplen ({error}): move it away; what it says is also "
        "in the item.json of every item."
    )


STATES = ("done", "failed", "changed", "damaged", "missing")


def state_of(task: Task, known: Known | None, *, verify: bool = False) -> tuple[str, str]:
    """One of `STATES`, and why."""
    record = read_record(task)
    if record is None:
        if known is not None and known.state == "failed":
            return "failed", known.error
        if known is None or not result_folder(task).exists():
            return "missing", "not done yet" if known is None else "its folder is gone"
        is_there = (result_folder(task) / RECORD).exists()
        return "damaged", f"{RECORD} is {'no record' if is_there else 'missing'}"
    if known is not None and known.state == "failed" and known.started > record.started:
        return "failed", known.error
    if record.parameters != task.parameters:
        return "changed", "the job asks for something else now"
    wrong = find_damage(result_folder(task), record.outputs, thorough=verify)
    if wrong:
        return "damaged", wrong
    if not is_unchanged(task.base, task.files, record.inputs):
        return "changed", "its input was changed, moved or removed"
    if verify:
        for name, then in record.inputs.items():
            if digest(Path(task.base, name)) != then["sha256"]:
                return "changed", (
                    f"{name} is not what was read (its digest differs, its size and time do not): "
                    "touch it and run again"
                )
    return "done", ", ".join(record.outputs)


def status_of(job: JobSpec, *, verify: bool = False) -> Iterator[tuple[str, str, str]]:
    """Say of each item of a job in which state it is, without doing anything.

    Parameters
    ----------
    job : Job
        Content of a job file; it ran at least once.
    verify : bool
        Whether to compare the digests of outputs and inputs.

    Yields
    ------
    tuple
        Name, one of "done", "failed", "changed", "damaged", "missing", and words.

    Raises
    ------
    FormatError
        If the output has no manifest, as of a job that never ran, or a damaged one.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> summary = job.run()
    >>> list(clplen.batch.status_of(job))
    [('a', 'done', 'stack.ome.tif')]
    """
    tasks = tasks_of(job)
    with Manifest(job.output_folder) as manifest:
        known = manifest.known()
    for task in tasks:
        yield (task.name, *state_of(task, known.get(task.name), verify=verify))


def count_states(states: Iterable[str]) -> str:
    """How many of each, in words."""
    count = Counter(states)
    return ", ".join(f"{count[name]} {name}" for name in sorted(count))
