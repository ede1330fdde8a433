"""The state of items, from the manifest, their records and their files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from clplen.batch.jobs.items import tasks_of
from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Task
from clplen.batch.running.manifest import Known, Manifest
from clplen.batch.work.execution import RECORD, read_record, result_folder
from clplen.batch.work.fingerprints import find_damage, is_unchanged
from clplen.io.digest import digest

STATES = ("done", "failed", "changed", "damaged", "missing")


def state_of(task: Task, known: Known | None, *, verify: bool = False) -> tuple[str, str]:
    """One of `STATES`, and why.

    Parameters
    ----------
    task : Task
    known : Known or None
        By the manifest.
    verify : bool
        Whether digests are compared, of outputs and of inputs.
    """
    record = read_record(task)
    if record is None:
        if known is None or not result_folder(task).exists():
            return "missing", "not done yet" if known is None else "its folder is gone"
        if known.state == "failed":
            return "failed", known.error
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


def status_of(job: JobSpec, *, verify: bool = False) -> Iterator[tuple[Task, str, str]]:
    """Each item of a job with its state and what there is to say, without doing anything.

    Parameters
    ----------
    job : JobSpec
    verify : bool
        Whether to compare the digests of outputs and inputs.

    Yields
    ------
    tuple
        Task, one of "done", "failed", "changed", "damaged", "missing", and words.
    """
    tasks = tasks_of(job)
    with Manifest(job.output_folder) as manifest:
        known = manifest.known()
    for task in tasks:
        yield (task, *state_of(task, known.get(task.name), verify=verify))


def count_states(states: Iterable[str]) -> str:
    """How many of each, in words."""
    count = Counter(states)
    return ", ".join(f"{count[name]} {name}" for name in sorted(count))
