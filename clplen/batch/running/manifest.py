"""The manifest: an SQLite file with the last report and the state of every item."""

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
from clplen.batch.work.execution import RECORD, has_settings_of, read_record, result_folder
from clplen.batch.work.fingerprints import find_damage, is_unchanged
from clplen.errors import FormatError
from clplen.io.store.digest import digest

NAME = "manifest.sqlite"
VERSION = 1  # format of the tables
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


_REQUIRED_TABLES = {("table", "meta"), ("table", "items")}


class ItemState(NamedTuple):
    """State of an item in the manifest, from its last `Report`."""

    state: str
    started: float
    error: str


class Manifest:
    """States of items; each change is on the disk when its method returns.

    A single process, which holds the lock of the job, may write; others may read.
    """

    def __init__(self, folder: Path, *, create: bool = False) -> None:
        self._path = folder / NAME
        self._lock = threading.Lock()
        if not self._path.exists() and not create:
            raise FormatError(f"The manifest {self._path} does not exist: run the job first.")
        self._open(create)

    def _open(self, create: bool) -> None:
        with _sqlite_errors(self._path):
            self._connection = sqlite3.connect(self._path, check_same_thread=False)
            self._connection.text_factory = lambda text: text.decode("utf-8", "replace")
            self._connection.execute("PRAGMA synchronous = FULL")
            schema = set(self._connection.execute("SELECT type, name FROM sqlite_master"))
            if not schema and not create:  # the job has not written its tables yet
                raise FormatError(f"The manifest {self._path} is empty: run the job first.")
            if not schema:
                self._connection.executescript(_TABLES)
            self._inode = self._path.stat().st_ino
            has_trigger = "trigger" in {kind for kind, _ in schema}  # triggers execute code
            is_manifest = not schema or (schema >= _REQUIRED_TABLES and not has_trigger)
            version = self._get("version") if is_manifest else None
        if not isinstance(version, int):
            raise FormatError(f"{self._path} is not a manifest of clplen: move it away.")
        if version > VERSION:
            raise FormatError(
                f"{self._path} has version {version}, but clplen {__version__} supports versions "
                f"up to {VERSION}: use a newer clplen, or give the job another output."
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
        """Settings of the last run (`Job.contents`)."""
        with self._lock, _sqlite_errors(self._path):
            content = self._get("job")
        return content if isinstance(content, dict) else None

    @job.setter
    def job(self, content: dict[str, Any]) -> None:
        with self._lock, _sqlite_errors(self._path), self._connection:
            self._set("job", content)

    def states(self) -> dict[str, ItemState]:
        """Return the last state of each item; the column ``report`` has the full reports.

        Damaged rows are left out, since the records of the items repeat their content.
        """
        with self._lock, _sqlite_errors(self._path):
            rows = self._connection.execute("SELECT name, state, started, error FROM items")
            return {
                os.fsdecode(name): ItemState(*rest)
                for name, *rest in rows
                if all(map(isinstance, (name, *rest), (str | bytes, str, float, str)))
            }

    def put(self, *reports: Report) -> None:
        """Store the reports of items."""
        rows = [
            (
                _storable(report.name),
                report.state,
                report.started,
                report.seconds.get("total"),
                report.device,
                report.worker,
                report.error.encode(errors="backslashreplace").decode(),
                report.to_json(),
            )
            for report in reports
        ]
        with self._lock, _sqlite_errors(self._path), self._connection:
            self._connection.executemany(
                "INSERT OR REPLACE INTO items VALUES (?, ?, ?, ?, ?, ?, ?, ?)", rows
            )

    def is_there(self) -> bool:
        """Return True if the opened file still exists under its name."""
        try:
            return self._path.stat().st_ino == self._inode
        except OSError:
            return False

    def renew(self, job: dict[str, Any]) -> None:
        """Create the manifest again after its file vanished."""
        with self._lock, _sqlite_errors(self._path):
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
    """Return the name of an item for SQLite, as bytes if it is not UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return os.fsencode(name)
    return name


@contextmanager
def _sqlite_errors(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to errors of clplen."""
    try:
        yield
    except (sqlite3.OperationalError, sqlite3.InternalError) as error:
        if "no such" in str(error):  # table or column
            raise _damaged(path, error) from error
        full = "full" in str(error)
        raise OSError(
            errno.ENOSPC if full else errno.EIO,
            f"The manifest cannot be written ({error}): "
            + ("free space on the disk and run again" if full else "check its folder"),
            str(path),
        ) from error
    except (sqlite3.DatabaseError, ValueError, RecursionError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> FormatError:
    return FormatError(
        f"{path} is damaged or not a manifest of clplen ({error}): move it away; the next run "
        "restores it from the item.json of every item."
    )


STATES = ("done", "failed", "changed", "damaged", "missing")


def state_of(task: Task, last: ItemState | None, *, verify: bool = False) -> tuple[str, str]:
    """Return the state of an item, from `STATES`, and the reason."""
    record = read_record(task)
    if record is None:
        if last is not None and last.state == "failed":
            return "failed", last.error
        if last is None or not result_folder(task).exists():
            return "missing", "not processed yet" if last is None else "its folder was removed"
        exists = (result_folder(task) / RECORD).exists()
        return "damaged", f"{RECORD} is {'invalid' if exists else 'missing'}"
    if last is not None and last.state == "failed" and last.started > record.started:
        return "failed", last.error
    if not has_settings_of(record, task):
        return "changed", "its settings in the job changed"
    damage = find_damage(result_folder(task), record.outputs, thorough=verify)
    if damage:
        return "damaged", damage
    if not is_unchanged(task.base, task.files, record.inputs):
        return "changed", "its input was changed, moved or removed"
    if verify:
        for name, properties in record.inputs.items():
            if digest(Path(task.base, name)) != properties["sha256"]:
                return "changed", (
                    f"the content of {name} changed, but not its size and time: touch it and run "
                    "the job again"
                )
    return "done", ", ".join(record.outputs)


def status_of(job: JobSpec, *, verify: bool = False) -> Iterator[tuple[str, str, str]]:
    """Yield the state of each item of a job without processing it.

    Parameters
    ----------
    job : Job
        Content of a job file that ran at least once.
    verify : bool
        True to compare the digests of outputs and inputs.

    Yields
    ------
    tuple
        Name, state ("done", "failed", "changed", "damaged" or "missing") and reason.

    Raises
    ------
    FormatError
        If the output has no manifest, because the job never ran, or a damaged manifest.

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
        states = manifest.states()
    for task in tasks:
        yield (task.name, *state_of(task, states.get(task.name), verify=verify))


def count_states(states: Iterable[str]) -> str:
    """Return the number of items in each state as text."""
    count = Counter(states)
    return ", ".join(f"{count[name]} {name}" for name in sorted(count))
