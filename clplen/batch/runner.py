"""A job from its items to its summary: what is left to do, done, and kept in the manifest."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from clplen.batch.items import tasks_of
from clplen.batch.job import Job
from clplen.batch.locks import job_lock
from clplen.batch.manifest import Manifest
from clplen.batch.stamps import is_whole
from clplen.batch.task import Report, Task
from clplen.batch.work import is_current, record_of, sentence
from clplen.errors import FormatError
from clplen.files import check_folder

_DIFFERENCES = 6  # how many a message tells


class Executor(Protocol):
    """What does tasks."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Do tasks, each once, and give their reports as they come."""


class Watcher(Protocol):
    """What is told how a job goes on."""

    def begin(self, *, total: int, skipped: int) -> None:
        """How many items there are, and how many of them are done already."""

    def report(self, report: Report) -> None:
        """One is done or has failed."""


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
    """What there is to do.

    Attributes
    ----------
    todo : list of Task
    current : dict
        Reports of the items that are done, by name.
    found : list of Report
        Those of them that were done and not in the manifest yet.
    """

    todo: list[Task]
    current: dict[str, Report]
    found: list[Report]


def plan_of(tasks: list[Task], known: dict[str, Report]) -> Plan:
    """Which tasks are to be done: those without a record beside whole results that fits them.

    Parameters
    ----------
    tasks : list of Task
    known : dict
        Reports of the manifest.
    """
    plan = Plan([], {}, [])
    for task in tasks:
        record = record_of(task)
        if record is None or not is_current(task, record):
            plan.todo.append(task)
            continue
        plan.current[task.name] = record
        if known.get(task.name) != record:  # by a worker whose word did not arrive
            plan.found.append(record)
    return plan


def run_job(
    job: Job,
    executor: Callable[[Path], contextlib.AbstractContextManager[Executor]],
    *,
    watcher: Watcher,
    force: bool = False,
) -> Summary:
    """Do what is left of a job.

    Parameters
    ----------
    job : Job
    executor : callable
        Output folder -> what does tasks, as a context.
    watcher : Watcher
    force : bool
        Whether a job that differs from the one that ran before may go on in its output.

    Returns
    -------
    Summary

    Raises
    ------
    FormatError
        If the job differs from the one that ran before; if its items cannot be told.
    BlockingIOError
        If another process is at work on the output.
    OSError
        If the output takes no files.
    """
    tasks = tasks_of(job)
    folder = check_folder(job.output_folder)
    with job_lock(folder), Manifest(folder, create=True) as manifest:
        check_same(manifest.job, job, force=force, where=folder)
        manifest.job = job.what()
        plan = plan_of(tasks, manifest.reports())
        manifest.put(*plan.found)
        watcher.begin(total=len(tasks), skipped=len(plan.current))
        book = _Book(job, manifest, plan)
        if plan.todo:
            with executor(folder) as works:
                for report in _with_retries(works, plan.todo, job.retries):
                    book.take(report)
                    watcher.report(report)
        book.close()
        return book.summary


class _Book:
    """Keeps the manifest, also on a disk that is full or gone for a while."""

    def __init__(self, job: Job, manifest: Manifest, plan: Plan) -> None:
        self._job, self._manifest = job, manifest
        self._folder = job.output_folder
        self._all = dict(plan.current)
        self._skipped = frozenset(plan.current)
        self._unsaved: list[Report] = []
        self._vanished = False
        self.summary = Summary(skipped=len(plan.current))

    def take(self, report: Report) -> None:
        """Write a report down, and those that could not be before."""
        self._all[report.name] = report
        if report.state == "done":
            self.summary.done += 1
        else:
            self.summary.failed[report.name] = report.error
        self._unsaved.append(report)
        self._save()

    def close(self) -> None:
        """Try once more what could not be written, and look for what was lost."""
        if self._unsaved or not self._manifest.is_there():
            self._save()
        if self._vanished:
            for name, report in self._all.items():
                if report.state == "done" and is_whole(Path(self._folder, name), report.outputs):
                    self.summary.done -= name not in self._skipped
                    self.summary.skipped -= name in self._skipped
                    self.summary.failed[name] = (
                        "its results vanished after they were written: run the job again."
                    )

    def _save(self) -> None:
        try:
            if not self._manifest.is_there():
                self._vanished = True
                self._manifest.renew(self._job.what(), self._all)
            else:
                self._manifest.put(*self._unsaved)
            self._unsaved.clear()
            self.summary.unsaved = ""
        except OSError as error:
            self.summary.unsaved = sentence(error)


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


def check_same(known: dict[str, Any] | None, job: Job, *, force: bool, where: Path) -> None:
    """Refuse a job that makes something else than the one that ran before, unless forced.

    Raises
    ------
    FormatError
        Naming what differs.
    """
    now = json.loads(json.dumps(job.what()))
    if known is None or force or known == now:
        return
    found = list(_differences(known, now))
    if not found:
        return
    more = len(found) - _DIFFERENCES
    said = "; ".join(found[:_DIFFERENCES]) + (f"; and {more} more" if more > 0 else "")
    raise FormatError(
        f"The job was changed since it ran last in {where}: {said}. Use --force to go on and make "
        "anew what that changes, or give the job another output."
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


def status_of(job: Job, *, verify: bool = False) -> Iterator[tuple[Task, str, str]]:
    """Each item of a job with its state and what there is to say, without doing anything.

    Parameters
    ----------
    job : Job
    verify : bool
        Whether to compare the digests of outputs and inputs.

    Yields
    ------
    tuple
        Task, one of "done", "failed", "changed", "damaged", "missing", and words.
    """
    from clplen.batch.check import state_of

    tasks = tasks_of(job)
    with Manifest(job.output_folder) as manifest:
        known = manifest.reports()
    for task in tasks:
        yield (task, *state_of(task, known.get(task.name), verify=verify))


def counted(states: Iterable[str]) -> str:
    """How many of each, in words."""
    count = Counter(states)
    return ", ".join(f"{count[name]} {name}" for name in sorted(count))
