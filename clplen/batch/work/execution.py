"""Execution of a task: read, compute and write completely, or report an error."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from clplen import __version__
from clplen.batch.jobs.task import Report, Task
from clplen.batch.work.fingerprints import find_damage, fingerprints, is_unchanged
from clplen.batch.work.locks import item_lock
from clplen.batch.work.products import compute, read, write
from clplen.batch.work.resources import Resources, StoppedError
from clplen.errors import ClplenError, FormatError, arguments_as, reason_of
from clplen.files import check_folder, clear_temporaries, replacing
from clplen.io.store.digest import digest, size_of
from clplen.outputs import is_ours

RECORD = "item.json"
_MAX_RECORD = 16 << 20  # bytes: 200 for each of 80,000 files of an item
# System errors that a retry cannot fix.
_PERMANENT_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EPERM, errno.EROFS)
logger = logging.getLogger(__name__)

Advance = Callable[[int, int], None]


@arguments_as("file")
def execute_task(task: Task, resources: Resources, *, advance: Advance | None = None) -> Report:
    """Process an item and write its record.

    The function waits for another process that works on the item. Valid results of that process,
    or of a worker that died before its report, are reused.
    """
    started, began = time.time(), time.perf_counter()
    seconds: dict[str, float] = {}
    try:
        with item_lock(Path(task.folder), task.name, check=resources.check):
            record = read_record(task)
            if record is not None and is_current(task, record):
                return record  # finished by a worker whose report was lost
            inputs, outputs = _results(task, resources, seconds, advance or (lambda *_: None))
            seconds["total"] = time.perf_counter() - began
            report = Report(
                task.name,
                "done",
                task.parameters,
                started,
                inputs,
                outputs,
                seconds,
                repr(resources.device),
                f"clplen {__version__}",
                f"{socket.gethostname()}:{os.getpid()}",
                {"source": task.source, "work": task.work},
            )
            _write_record(task, report)
            return report
    except StoppedError:
        raise
    except Exception as error:
        seconds["total"] = time.perf_counter() - began
        return _failed(task, started, seconds, error)


def result_folder(task: Task) -> Path:
    """Return the folder of the results of an item."""
    return Path(task.folder, task.name)


def read_record(task: Task) -> Report | None:
    """Return the record of a finished item; None if it is missing or invalid."""
    path = result_folder(task) / RECORD
    try:
        if not path.is_file() or path.stat().st_size > _MAX_RECORD:
            return None
        record = Report.from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if (record.name, record.state) == (task.name, "done") else None


def is_current(task: Task, record: Report) -> bool:
    """Return True if a record matches the task, its inputs are unchanged and its outputs intact."""
    return (
        has_settings_of(record, task)
        and not find_damage(result_folder(task), record.outputs)
        and is_unchanged(task.base, task.files, record.inputs)
    )


def has_settings_of(record: Report, task: Task) -> bool:
    """Return True if a record has the settings of the task, or also requires all views."""
    return record.parameters in (task.parameters, _without_allow_missing(task).parameters)


def _without_allow_missing(task: Task) -> Task:
    """Return the task with all views required: its results, if there are any, are the same."""
    if not task.source.get("layout", {}).get("allow_missing"):
        return task
    layout = {k: v for k, v in task.source["layout"].items() if k != "allow_missing"}
    return replace(task, source=task.source | {"layout": layout})


def _results(
    task: Task, resources: Resources, seconds: dict[str, float], advance: Advance
) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, Any]]]:
    """Compute and write the results; return the properties of inputs and outputs."""
    folder = result_folder(task)
    before = _stamps(task)
    check_folder(folder)
    clear_temporaries(folder)
    with read(task, resources, seconds, advance) as light:
        products = compute(task, light, resources, seconds, advance)
        with _clocked("digest", seconds):
            inputs = {
                name: {"bytes": size, "changed": changed, "sha256": digest(Path(task.base, name))}
                for name, (size, changed) in before.items()
            }
        _check_unchanged(task, before)
        old = read_record(task)
        _check_own(folder, {product.name for product in products} - set(old.outputs if old else ()))
        (folder / RECORD).unlink(missing_ok=True)  # old and new results are mixed until the end
        names = write(folder, products, resources, seconds)
    _remove(folder, set(old.outputs if old else ()) - set(names))
    with _clocked("digest", seconds):
        outputs = {
            name: {"bytes": size_of(folder / name), "sha256": digest(folder / name)}
            for name in names
        }
    return inputs, outputs


def _check_own(folder: Path, names: set[str]) -> None:
    """Raise an error if an output would overwrite a file of another program."""
    for path in sorted(folder / name for name in names):
        if os.path.lexists(path) and not is_ours(path):
            raise FileExistsError(
                f"{path} exists and was not written by clplen: move it, or give the job another "
                "output."
            )


def _remove(folder: Path, names: set[str]) -> None:
    """Remove outputs of an earlier run that this run does not write; keep other files."""
    for path in (folder / name for name in names):
        if not is_ours(path):
            continue
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _stamps(task: Task) -> dict[str, tuple[int, int]]:
    try:
        return fingerprints(task.base, task.files)
    except FileNotFoundError as error:
        raise FormatError(
            f"The file {error.filename} was removed: restore it and run the job again."
        ) from error


def _check_unchanged(task: Task, before: dict[str, tuple[int, int]]) -> None:
    after = _stamps(task)
    changed = [name for name, stamp in before.items() if after[name] != stamp]
    if changed:
        raise FormatError(
            f"{Path(task.base, changed[0])} changed while it was read: run the job again when the "
            "file is complete."
        )


def _write_record(task: Task, report: Report) -> None:
    """Write the record atomically, without waiting for the disk; the manifest repeats it."""
    with replacing(result_folder(task) / RECORD) as temporary:
        temporary.write_text(report.to_json(), encoding="utf-8")


@contextmanager
def _clocked(name: str, seconds: dict[str, float]) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - began


def _failed(task: Task, started: float, seconds: dict[str, float], error: Exception) -> Report:
    logger.debug("%s failed", task.name, exc_info=error)
    passing = isinstance(error, MemoryError) or (
        isinstance(error, OSError) and _errno(error) not in _PERMANENT_ERRORS
    )
    return Report(
        task.name,
        "failed",
        task.parameters,
        started,
        seconds=seconds,
        software=f"clplen {__version__}",
        worker=f"{socket.gethostname()}:{os.getpid()}",
        settings={"source": task.source, "work": task.work},
        error=describe_error(error),
        passing=passing,
    )


def _errno(error: BaseException | None) -> int | None:
    """Return the number of a system error, also if it is the cause of another error."""
    while error is not None:
        if isinstance(error, OSError) and error.errno:
            return error.errno
        error = error.__cause__
    return None


def describe_error(error: BaseException) -> str:
    """Return an error as text; unexpected errors as a single line with their class."""
    if isinstance(error, MemoryError):
        return "This computer has too little memory for the item: lower memory or workers."
    text = reason_of(error)
    if isinstance(error, ClplenError | ValueError | OSError) and text:
        return text
    return f"unexpected {type(error).__name__}" + (f": {' '.join(text.split())}" if text else "")
