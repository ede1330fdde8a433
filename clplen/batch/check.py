"""What state an item is in, from its record and its files."""

from __future__ import annotations

from pathlib import Path

from clplen.batch.stamps import is_unchanged, is_whole
from clplen.batch.task import Report, Task
from clplen.batch.work import RECORD, folder_of, record_of
from clplen.io.digest import digest

STATES = ("done", "failed", "changed", "damaged", "missing")


def state_of(task: Task, report: Report | None, *, verify: bool = False) -> tuple[str, str]:
    """One of `STATES`, and why.

    Parameters
    ----------
    task : Task
    report : Report or None
        Of the manifest.
    verify : bool
        Whether digests are compared, of outputs and of inputs.
    """
    record = record_of(task)
    if record is None:
        if report is None:
            return "missing", "not done yet"
        if report.state == "failed":
            return "failed", report.error
        return "damaged", f"{RECORD} is missing"
    if report is not None and report.state == "failed" and report.started > record.started:
        return "failed", report.error
    report = record
    if report.parameters != task.parameters:
        return "changed", "the job asks for something else now"
    wrong = is_whole(folder_of(task), report.outputs, thorough=verify)
    if wrong:
        return "damaged", wrong
    if not is_unchanged(task.base, task.files, report.inputs):
        return "changed", "its input was changed, moved or removed"
    if verify:
        for name, known in report.inputs.items():
            if digest(Path(task.base, name)) != known["sha256"]:
                return "changed", f"{name} is not what was read (its digest differs)"
    return "done", ", ".join(report.outputs)
