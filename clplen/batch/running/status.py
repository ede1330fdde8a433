"""What state an item is in, from its record and its files."""

from __future__ import annotations

from pathlib import Path

from clplen.batch.jobs.task import Task
from clplen.batch.running.manifest import Known
from clplen.batch.work.execution import RECORD, folder_of, record_of
from clplen.batch.work.fingerprints import is_unchanged, is_whole
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
    record = record_of(task)
    if record is None:
        if known is None or not folder_of(task).exists():
            return "missing", "not done yet" if known is None else "its folder is gone"
        if known.state == "failed":
            return "failed", known.error
        is_there = (folder_of(task) / RECORD).exists()
        return "damaged", f"{RECORD} is {'no record' if is_there else 'missing'}"
    if known is not None and known.state == "failed" and known.started > record.started:
        return "failed", known.error
    if record.parameters != task.parameters:
        return "changed", "the job asks for something else now"
    wrong = is_whole(folder_of(task), record.outputs, thorough=verify)
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
