"""Runs of a job: which items are pending, their execution, the manifest, the summary."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from clplen.batch.jobs.items import tasks_of
from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Report, Task
from clplen.batch.running.manifest import Known, Manifest
from clplen.batch.work.execution import describe_error, is_current, read_record, result_folder
from clplen.batch.work.fingerprints import find_damage
from clplen.batch.work.locks import job_lock
from clplen.errors import FormatError, argument
from clplen.files import check_folder, clear_temporaries
from clplen.io.store.zarr_files import zarr_package

_DIFFERENCES = 6  # how many a message tells
_SAVE = 0.5  # seconds between two writings of the manifest: each waits for the disk


class Executor(Protocol):
    """What does tasks."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Do tasks, each once, and give their reports as they come."""


class Watcher:
    """Object that is told how a job goes on; this one ignores it."""

    def begin(self, *, total: int, skipped: int) -> None:
        """Take the number of items, and of those that are done already."""

    def report(self, report: Report) -> None:
        """Take the report of an item that is done or has failed."""

    def running(self, name: str, done: int, total: int) -> None:
        """Take how far an item has come that is streamed or simulated; from another thread."""


@dataclass
class Summary:
    """What became of a job.

    Attributes
    ----------
    done, skipped : int
        Items done now, and those that were done already.
    failed : dict
        Of each item that failed: one sentence.
    unsaved : str
        Why the manifest could not be written at the end; empty if it was.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> summary = job.run()
    >>> summary.done, summary.failed, summary.is_good
    (1, {}, True)
    """

    done: int = 0
    skipped: int = 0
    failed: dict[str, str] = field(default_factory=dict)
    unsaved: str = ""

    @property
    def is_good(self) -> bool:
        """Whether everything is done and written down."""
        return not self.failed and not self.unsaved


@dataclass(frozen=True)
class Plan:
    """Items to do, items that are done, and records that the manifest does not know."""

    todo: list[Task]
    current: list[Task]
    found: list[Report]


def plan_tasks(tasks: list[Task], known: dict[str, Known] | None = None) -> Plan:
    """Which tasks are to be done: those without a record beside whole results that fits them."""
    plan = Plan([], [], [])
    for task in tasks:
        record = read_record(task)
        if record is None or not is_current(task, record):
            plan.todo.append(task)
            continue
        plan.current.append(task)
        if known is not None and known.get(task.name, ())[:2] != ("done", record.started):
            plan.found.append(record)  # of a worker whose word did not arrive
    return plan


def execute_job(
    job: JobSpec,
    executor: Callable[[Path], contextlib.AbstractContextManager[Executor]],
    *,
    watcher: Watcher,
    force: bool = False,
) -> Summary:
    """Do what is left of a job by ``executor``: output folder -> context that does tasks."""
    _require_packages(job)
    tasks = tasks_of(job)
    folder = check_folder(job.output_folder)
    with job_lock(folder), Manifest(folder, create=True) as manifest:
        some = any(one.state == "done" for one in manifest.known().values())
        check_same(manifest.job if some else None, job, force=force, where=folder)
        manifest.job = job.contents()
        clear_temporaries(folder)
        plan = plan_tasks(tasks, manifest.known())
        manifest.put(*plan.found)
        watcher.begin(total=len(tasks), skipped=len(plan.current))
        ledger = _Ledger(job, manifest, plan)
        try:
            if plan.todo:
                with executor(folder) as works:
                    for report in _with_retries(works, plan.todo, job.retries):
                        ledger.take(report)
                        watcher.report(report)
        finally:
            ledger.close()
        return ledger.summary


def _require_packages(job: JobSpec) -> None:
    """What every item needs is missed before the first."""
    if "ome-zarr" in job.formats or (job.light_field and job.light_field.format == "zarr"):
        zarr_package("take ome-tiff and hdf5")


class _Ledger:
    """Keeps the manifest, also on a disk that is full or gone for a while."""

    def __init__(self, job: JobSpec, manifest: Manifest, plan: Plan) -> None:
        self._job, self._manifest, self._plan = job, manifest, plan
        self._failed: dict[str, Report] = {}
        self._unsaved: list[Report] = []
        self._vanished = False
        self._saved = time.monotonic()
        self.summary = Summary(skipped=len(plan.current))

    def take(self, report: Report) -> None:
        """Write a report down, now or soon; what a kill loses is in the records."""
        if report.state == "done":
            self.summary.done += 1
        else:
            self.summary.failed[report.name] = report.error
            self._failed[report.name] = report
        self._unsaved.append(report)
        if time.monotonic() >= self._saved + _SAVE:
            self._save()

    def close(self) -> None:
        """Write the rest, and look for what was lost."""
        if self._unsaved or not self._manifest.is_there():
            self._save()
        if self._vanished:
            done = [task for task in self._plan.todo if task.name not in self._failed]
            self.summary.skipped -= self._missing(self._plan.current)
            self.summary.done -= self._missing(done)

    def _missing(self, tasks: list[Task]) -> int:
        """How many have lost their results; they are said to have failed."""
        lost = [task.name for task in tasks if _has_vanished(task)]
        said = "its results vanished after they were written: run the job again."
        self.summary.failed.update(dict.fromkeys(lost, said))
        return len(lost)

    def _save(self) -> None:
        try:
            if not self._manifest.is_there():
                self._vanished = True
                self._manifest.renew(self._job.contents())
                self._unsaved = [*self._failed.values(), *self._records()]
            self._manifest.put(*self._unsaved)
            self._unsaved.clear()
            self.summary.unsaved = ""
        except OSError as error:
            self.summary.unsaved = describe_error(error)
        self._saved = time.monotonic()

    def _records(self) -> Iterator[Report]:
        """What lies beside results that are there still."""
        for task in (*self._plan.current, *self._plan.todo):
            record = read_record(task)
            if record is not None and task.name not in self._failed:
                yield record


def _has_vanished(task: Task) -> bool:
    record = read_record(task)
    return record is None or bool(find_damage(result_folder(task), record.outputs))


def _with_retries(works: Executor, tasks: list[Task], retries: int) -> Iterator[Report]:
    """Every task's last report; those that may pass are tried again after the others."""
    waiting = {task.name: task for task in tasks}
    for attempt in range(retries + 1):
        again = {}
        for report in works.run(list(waiting.values())):
            if report.state == "failed" and report.passing and attempt < retries:
                again[report.name] = waiting[report.name]
            else:
                yield report
        if not again:
            return
        waiting = again


def check_same(known: dict[str, Any] | None, job: JobSpec, *, force: bool, where: Path) -> None:
    """Refuse a job that makes something else than the one that ran before, unless forced."""
    now = json.loads(json.dumps(job.contents()))
    if known is None or force or known == now:
        return
    found = list(_differences(known, now))
    if not found:
        return
    more = len(found) - _DIFFERENCES
    said = "; ".join(found[:_DIFFERENCES]) + (f"; and {more} more" if more > 0 else "")
    raise FormatError(
        f"The job was changed since it ran last in {where}: {said}. Give the job another "
        f"output, or {argument('force', True)} to make anew what that changes."
    )


def _differences(old: Any, new: Any, key: str = "") -> Iterator[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            inner = f"{key}.{name}" if key else name
            yield from _differences(old.get(name), new.get(name), inner)
    elif isinstance(old, list) and isinstance(new, list) and key in _TABLES:
        for i in range(max(len(old), len(new))):
            one, other = (some[i] if i < len(some) else None for some in (old, new))
            yield from _differences(one, other, f"{key}.{i}")
    elif old != new:
        yield f"{key} was {_short(old)}, is {_short(new)}"


_TABLES = ("inputs", "simulations", "scenes")


def _short(value: Any) -> str:
    if value is None:
        return "not there"
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
