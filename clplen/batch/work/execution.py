"""Execution of one task: read, compute, write; whole or not at all."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
_MAX_RECORD = 16 << 20  # bytes: 200 for each of 80,000 files of one item
# Errors of the system that trying again does not mend.
_LASTING = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EPERM, errno.EROFS)
logger = logging.getLogger(__name__)

Advance = Callable[[int, int], None]


@arguments_as("file")
def execute_task(task: Task, resources: Resources, *, advance: Advance | None = None) -> Report:
    """Do one item and write its record.

    Another process that works on it is waited for, and what it did is taken over, as is what a
    worker did that was lost before it could say so.
    """
    started, began = time.time(), time.perf_counter()
    seconds: dict[str, float] = {}
    try:
        with item_lock(Path(task.folder), task.name, check=resources.check):
            known = read_record(task)
            if known is not None and is_current(task, known):
                return known  # by a worker whose word did not arrive
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
    """Where the results of an item lie."""
    return Path(task.folder, task.name)


def read_record(task: Task) -> Report | None:
    """Return the record beside the results of an item, if there is a whole one."""
    path = result_folder(task) / RECORD
    try:
        if not path.is_file() or path.stat().st_size > _MAX_RECORD:
            return None
        found = Report.from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if (found.name, found.state) == (task.name, "done") else None


def is_current(task: Task, known: Report) -> bool:
    """Whether what is known of an item is what the task asks for, with its files in place."""
    return (
        known.parameters == task.parameters
        and not find_damage(result_folder(task), known.outputs)
        and is_unchanged(task.base, task.files, known.inputs)
    )


def _results(
    task: Task, resources: Resources, seconds: dict[str, float], advance: Advance
) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, Any]]]:
    """Stamps of inputs and outputs, when everything is written."""
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
        (folder / RECORD).unlink(missing_ok=True)  # from here on old and new results mix
        names = write(folder, products, resources, seconds)
    _remove(folder, set(old.outputs if old else ()) - set(names))
    with _clocked("digest", seconds):
        outputs = {
            name: {"bytes": size_of(folder / name), "sha256": digest(folder / name)}
            for name in names
        }
    return inputs, outputs


def _check_own(folder: Path, names: set[str]) -> None:
    """Refuse to write over what clplen did not write."""
    for path in sorted(folder / name for name in names):
        if os.path.lexists(path) and not is_ours(path):
            raise FileExistsError(
                f"{path} is there already and clplen did not write it: move it, or name another "
                "output for the job."
            )


def _remove(folder: Path, names: set[str]) -> None:
    """Remove what an earlier run made and this one does not; files of others stay."""
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
        raise FormatError(f"There is no file {error.filename} any more.") from error


def _check_unchanged(task: Task, before: dict[str, tuple[int, int]]) -> None:
    after = _stamps(task)
    changed = [name for name, found in before.items() if after[name] != found]
    if changed:
        raise FormatError(
            f"{Path(task.base, changed[0])} was changed while it was read: run the job again when "
            "it is written."
        )


def _write_record(task: Task, report: Report) -> None:
    """Whole, but not waited for: after a loss of power the manifest knows it."""
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
        isinstance(error, OSError) and _errno(error) not in _LASTING
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
    """The number of an error of the system, also of one that was said in other words."""
    while error is not None:
        if isinstance(error, OSError) and error.errno:
            return error.errno
        error = error.__cause__
    return None


def describe_error(error: BaseException) -> str:
    """Return what went wrong; of an error that nobody expects, in one line."""
    if isinstance(error, MemoryError):
        return "This computer has not enough memory for it: lower memory or workers."
    text = reason_of(error)
    if isinstance(error, ClplenError | ValueError | OSError) and text:
        return text
    return f"unexpected {type(error).__name__}" + (f": {' '.join(text.split())}" if text else "")
