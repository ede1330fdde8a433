"""Runs of a job: plan the pending items, execute them, keep manifest and summary."""

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
from clplen.batch.running.manifest import ItemState, Manifest
from clplen.batch.work.execution import describe_error, is_current, read_record, result_folder
from clplen.batch.work.fingerprints import find_damage
from clplen.batch.work.locks import job_lock
from clplen.errors import FormatError, argument
from clplen.files import check_folder, clear_temporaries
from clplen.io.store.zarr_files import zarr_package

MAX_DIFFERENCES = 6  # listed in an error message
_SAVE = 0.5  # interval of writing the manifest in seconds; each write waits for the disk


class Executor(Protocol):
    """Executor of tasks."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Execute each task and yield the reports in order of completion."""


class Watcher:
    """Callbacks for the progress of a job; the base class ignores them."""

    def begin(self, *, total: int, skipped: int) -> None:
        """Receive the number of all items and of finished items."""

    def report(self, report: Report) -> None:
        """Receive the report of an item that finished or failed."""

    def running(self, name: str, done: int, total: int) -> None:
        """Receive the progress of a streamed or simulated item, from another thread."""


@dataclass
class Summary:
    """Outcome of a job.

    Attributes
    ----------
    done, skipped : int
        Number of items finished in this run and before it.
    failed : dict
        Error message of each failed item.
    unsaved : str
        Reason why the manifest could not be written at the end; empty on success.

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
        """Flag that no item failed and that the manifest was written."""
        return not self.failed and not self.unsaved


@dataclass(frozen=True)
class Plan:
    """Items to do, finished items, and records that are missing in the manifest."""

    todo: list[Task]
    current: list[Task]
    unlisted: list[Report]


def plan_tasks(tasks: list[Task], states: dict[str, ItemState] | None = None) -> Plan:
    """Separate the tasks without valid results from the finished tasks."""
    plan = Plan([], [], [])
    for task in tasks:
        record = read_record(task)
        if record is None or not is_current(task, record):
            plan.todo.append(task)
            continue
        plan.current.append(task)
        if states is not None and states.get(task.name, ())[:2] != ("done", record.started):
            plan.unlisted.append(record)  # finished by a worker whose report was lost
    return plan


def execute_job(
    job: JobSpec,
    executor: Callable[[Path], contextlib.AbstractContextManager[Executor]],
    *,
    watcher: Watcher,
    force: bool = False,
) -> Summary:
    """Process the pending items; ``executor`` maps the output folder to an executor's context."""
    _require_packages(job)
    tasks = tasks_of(job)
    folder = check_folder(job.output_folder)
    with job_lock(folder), Manifest(folder, create=True) as manifest:
        has_results = any(state.state == "done" for state in manifest.states().values())
        check_settings(manifest.job if has_results else None, job, force=force, output=folder)
        manifest.job = job.contents()
        clear_temporaries(folder)
        plan = plan_tasks(tasks, manifest.states())
        manifest.put(*plan.unlisted)
        watcher.begin(total=len(tasks), skipped=len(plan.current))
        ledger = _Ledger(job, manifest, plan)
        try:
            if plan.todo:
                with executor(folder) as running:
                    for report in _with_retries(running, plan.todo, job.retries):
                        ledger.add(report)
                        watcher.report(report)
        finally:
            ledger.close()
        return ledger.summary


def _require_packages(job: JobSpec) -> None:
    """Raise an error before the first item if a package for the formats is missing."""
    if "ome-zarr" in job.formats or (job.light_field and job.light_field.format == "zarr"):
        zarr_package("take ome-tiff and hdf5")


class _Ledger:
    """Buffered writer of the manifest; it survives a disk that is full or absent for a while."""

    def __init__(self, job: JobSpec, manifest: Manifest, plan: Plan) -> None:
        self._job, self._manifest, self._plan = job, manifest, plan
        self._failed: dict[str, Report] = {}
        self._unsaved: list[Report] = []
        self._vanished = False
        self._saved = time.monotonic()
        self.summary = Summary(skipped=len(plan.current))

    def add(self, report: Report) -> None:
        """Store a report, possibly later; after a kill the records still have it."""
        if report.state == "done":
            self.summary.done += 1
        else:
            self.summary.failed[report.name] = report.error
            self._failed[report.name] = report
        self._unsaved.append(report)
        if time.monotonic() >= self._saved + _SAVE:
            self._save()

    def close(self) -> None:
        """Write pending reports, and subtract items whose results vanished."""
        if self._unsaved or not self._manifest.is_there():
            self._save()
        if self._vanished:
            done = [task for task in self._plan.todo if task.name not in self._failed]
            self.summary.skipped -= self._count_vanished(self._plan.current)
            self.summary.done -= self._count_vanished(done)

    def _count_vanished(self, tasks: list[Task]) -> int:
        """Mark items without results as failed, and return their number."""
        lost = [task.name for task in tasks if _has_vanished(task)]
        message = "its results vanished after they were written: run the job again."
        self.summary.failed.update(dict.fromkeys(lost, message))
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
        """Yield the records of results that still exist."""
        for task in (*self._plan.current, *self._plan.todo):
            record = read_record(task)
            if record is not None and task.name not in self._failed:
                yield record


def _has_vanished(task: Task) -> bool:
    record = read_record(task)
    return record is None or bool(find_damage(result_folder(task), record.outputs))


def _with_retries(executor: Executor, tasks: list[Task], retries: int) -> Iterator[Report]:
    """Yield the last report of every task; repeat temporary failures after all other tasks."""
    waiting = {task.name: task for task in tasks}
    for attempt in range(retries + 1):
        again = {}
        for report in executor.run(list(waiting.values())):
            if report.state == "failed" and report.passing and attempt < retries:
                again[report.name] = waiting[report.name]
            else:
                yield report
        if not again:
            return
        waiting = again


def check_settings(
    previous: dict[str, Any] | None, job: JobSpec, *, force: bool, output: Path
) -> None:
    """Raise an error if the settings of a job changed since its last run, unless forced."""
    current = json.loads(json.dumps(job.contents()))
    if previous is None or force or previous == current:
        return
    differences = list(_differences(previous, current))
    if not differences:
        return
    more = len(differences) - MAX_DIFFERENCES
    text = "; ".join(differences[:MAX_DIFFERENCES]) + (f"; and {more} more" if more > 0 else "")
    raise FormatError(
        f"The job has changed since its last run in {output}: {text}. Give the job another "
        f"output, or {argument('force', True)} to recompute the affected items."
    )


def _differences(old: Any, new: Any, key: str = "") -> Iterator[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            inner = f"{key}.{name}" if key else name
            yield from _differences(old.get(name), new.get(name), inner)
    elif isinstance(old, list) and isinstance(new, list) and key in _TABLES:
        for i in range(max(len(old), len(new))):
            before, after = (tables[i] if i < len(tables) else None for tables in (old, new))
            yield from _differences(before, after, f"{key}.{i}")
    elif old != new:
        yield f"{key} was {_short(old)}, is {_short(new)}"


_TABLES = ("inputs", "simulations", "scenes")


def _short(value: Any) -> str:
    if value is None:
        return "missing"
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
