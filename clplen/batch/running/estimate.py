"""Estimates before a run: items, sizes, and time from a measured sample."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clplen import io
from clplen.batch.jobs.items import layout_in, tasks_of
from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Task
from clplen.batch.running.runner import plan_tasks
from clplen.batch.work.execution import describe_error, execute_task
from clplen.batch.work.fingerprints import fingerprint
from clplen.batch.work.products import bytes_in_core, bytes_written
from clplen.batch.work.resources import Resources

_OPENED = 200  # items whose sizes are looked at; of more, those of the others are extrapolated


@dataclass(frozen=True)
class ItemEstimate:
    """An item to do: bytes (0 if unknown), and why it will fail (empty if it will not)."""

    name: str
    read: int
    written: int
    streamed: bool
    problem: str


@dataclass(frozen=True)
class JobEstimate:
    """What there is to do.

    Attributes
    ----------
    lines : list of ItemEstimate
        Of the items to do, at most 200.
    todo, skipped : int
        Items to do and items that are done.
    read, written : float
        Bytes of all items to do.
    seconds : float
        Of all items to do, by one worker; nan without a sample.
    sample : str
        What was measured.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> found = clplen.batch.estimate_job(job, sample=False)
    >>> found.todo, found.skipped, found.lines[0].name, found.sample
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
    """Look at what a job will do; nothing is written to its output.

    Parameters
    ----------
    job : Job
        Content of a job file.
    sample : bool
        Whether to do the item of middle size, in a temporary folder, to know how long it takes.

    Returns
    -------
    JobEstimate
        How many items are to do and done, their bytes, and the time that they will take.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> found = clplen.batch.estimate_job(job, sample=False)
    >>> found.todo, found.written
    (1, 3072.0)
    """
    plan = plan_tasks(tasks_of(job))
    scratch = Path(tempfile.mkdtemp(prefix="clplen-sample-"))
    try:
        selector = job.device[0] if job.device else None
        resources = Resources(selector=selector, memory=job.memory)
        lines = [_line(task, resources) for task in plan.todo[:_OPENED]]
        share = len(plan.todo) / max(len(lines), 1)
        read, written = (share * sum(getattr(x, n) for x in lines) for n in ("read", "written"))
        seconds, said = float("nan"), "not measured"
        chosen = _middle(plan.todo, lines) if sample else None
        if chosen is not None:
            task, line = chosen
            seconds, said = _measured(replace(task, folder=str(scratch)), resources)
            known = all(one.written for one in lines if not one.problem)
            size = line.read + line.written
            seconds *= (read + written) / size if known else len(plan.todo)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return JobEstimate(lines, len(plan.todo), len(plan.current), read, written, seconds, said)


def _line(task: Task, resources: Resources) -> ItemEstimate:
    try:
        read = sum(fingerprint(Path(task.base, name))[0] for name in task.files)
        if task.source["kind"] != "file":
            return ItemEstimate(task.name, read, 0, False, "")
        if not {*task.work} - {"deconvolve", "formats"}:
            return ItemEstimate(task.name, read, 0, False, "")
        layout = layout_in(task.source["layout"], task.base)
        path = Path(task.base, task.source["path"])
        with io.open_lightfield(path, device=resources.device, **layout) as stored:
            streamed = bytes_in_core(stored, task.work) > resources.memory
            return ItemEstimate(task.name, read, bytes_written(stored, task.work), streamed, "")
    except Exception as error:  # as in `execute_task`: a bug in one item is said of that one
        return ItemEstimate(task.name, 0, 0, False, describe_error(error))


def _middle(
    tasks: Sequence[Task], lines: Sequence[ItemEstimate]
) -> tuple[Task, ItemEstimate] | None:
    """The item of middle size among those that nothing is wrong with."""
    good = [pair for pair in zip(tasks, lines, strict=False) if not pair[1].problem]
    if not good:
        return None
    order = np.argsort([line.read + line.written for _, line in good], kind="stable")
    return good[int(order[len(order) // 2])]


def _measured(task: Task, resources: Resources) -> tuple[float, str]:
    report = execute_task(task, resources)
    if report.state != "done":
        return float("nan"), f"{task.name} failed: {report.error}"
    slowest: Any = max(
        (name for name in report.seconds if name not in ("total", "waiting")),
        key=lambda name: report.seconds[name],
    )
    total = report.seconds["total"]
    return total, f"{task.name} took {total:.3g} s, most of it to {slowest}"
