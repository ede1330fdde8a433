"""Estimates before a run: items, sizes, and the time from a measured item."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clplen import io
from clplen.batch.jobs.items import absolute_layout, tasks_of
from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Task
from clplen.batch.running.runner import plan_tasks
from clplen.batch.work.execution import describe_error, execute_task
from clplen.batch.work.fingerprints import fingerprint
from clplen.batch.work.products import bytes_in_core, bytes_written
from clplen.batch.work.resources import Resources
from clplen.errors import arguments_as

MAX_INSPECTED = 200  # items whose sizes are read; the sizes of further items are extrapolated


@dataclass(frozen=True)
class ItemEstimate:
    """Item to do: sizes in bytes (0 if unknown), and the reason if it will fail."""

    name: str
    read: int
    written: int
    streamed: bool
    problem: str


@dataclass(frozen=True)
class JobEstimate:
    """Estimate of the work and time of a job.

    Attributes
    ----------
    lines : list of ItemEstimate
        Estimates of the items to do, at most 200.
    todo, skipped : int
        Number of items to do and of finished items.
    read, written : float
        Bytes of all items to do.
    seconds : float
        Time of all items to do with one worker, in seconds; nan without a sample.
    sample : str
        Description of the measured item.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> estimate = clplen.batch.estimate_job(job, sample=False)
    >>> estimate.todo, estimate.skipped, estimate.lines[0].name, estimate.sample
    (1, 0, 'a', 'not measured')
    """

    lines: list[ItemEstimate]
    todo: int
    skipped: int
    read: float
    written: float
    seconds: float
    sample: str


def estimate_job(job: JobSpec, *, sample: bool = True) -> JobEstimate:
    """Estimate the work and time of a job without writing to its output.

    Parameters
    ----------
    job : Job
        Content of a job file.
    sample : bool
        True to process the item of median size in a temporary folder, to measure its time.

    Returns
    -------
    JobEstimate
        Number of items to do and finished, their bytes, and the estimated time.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> estimate = clplen.batch.estimate_job(job, sample=False)
    >>> estimate.todo, estimate.written
    (1, 3072.0)
    """
    plan = plan_tasks(tasks_of(job))
    scratch = Path(tempfile.mkdtemp(prefix="clplen-sample-"))
    try:
        selector = job.device[0] if job.device else None
        resources = Resources(selector=selector, memory=job.memory)
        lines = [_line(task, resources) for task in plan.todo[:MAX_INSPECTED]]
        share = len(plan.todo) / max(len(lines), 1)
        read, written = (share * sum(getattr(x, n) for x in lines) for n in ("read", "written"))
        seconds, description = float("nan"), "not measured"
        sample_item = _middle(plan.todo, lines) if sample else None
        if sample_item is not None:
            task, line = sample_item
            seconds, description = _measure(replace(task, folder=str(scratch)), resources)
            has_sizes = all(item.written for item in lines if not item.problem)
            size = line.read + line.written
            seconds *= (read + written) / size if has_sizes else len(plan.todo)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    skipped = len(plan.current)
    return JobEstimate(lines, len(plan.todo), skipped, read, written, seconds, description)


@arguments_as("file")
def _line(task: Task, resources: Resources) -> ItemEstimate:
    try:
        read = sum(fingerprint(Path(task.base, name))[0] for name in task.files)
        if task.source["kind"] != "file":
            return ItemEstimate(task.name, read, 0, False, "")
        if not {*task.work} - {"deconvolve", "formats"}:
            return ItemEstimate(task.name, read, 0, False, "")
        layout = absolute_layout(task.source["layout"], task.base)
        path = Path(task.base, task.source["path"])
        with io.open_lightfield(path, device=resources.device, **layout) as stored:
            streamed = bytes_in_core(stored, task.work) > resources.memory
            return ItemEstimate(task.name, read, bytes_written(stored, task.work), streamed, "")
    except Exception as error:  # as in `execute_task`: reported for this item only
        return ItemEstimate(task.name, 0, 0, False, describe_error(error))


def _middle(
    tasks: Sequence[Task], lines: Sequence[ItemEstimate]
) -> tuple[Task, ItemEstimate] | None:
    """Return the item of median size among the items without problems."""
    candidates = [pair for pair in zip(tasks, lines, strict=False) if not pair[1].problem]
    if not candidates:
        return None
    order = np.argsort([line.read + line.written for _, line in candidates], kind="stable")
    return candidates[int(order[len(order) // 2])]


def _measure(task: Task, resources: Resources) -> tuple[float, str]:
    report = execute_task(task, resources)
    if report.state != "done":
        return float("nan"), f"{task.name} failed: {report.error}"
    slowest: Any = max(
        (name for name in report.seconds if name not in ("total", "waiting")),
        key=lambda name: report.seconds[name],
    )
    total = report.seconds["total"]
    return total, f"{task.name} ({total:.3g} s, mostly {slowest})"
