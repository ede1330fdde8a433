"""Locks in the output folder; the system releases them when a process dies."""

from __future__ import annotations

import hashlib
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

HIDDEN = ".clplen"
_POLL = 0.1  # seconds


@contextmanager
def job_lock(folder: Path) -> Iterator[None]:
    """Hold the output folder for one process that shares out its items."""
    lock = _lock(folder, "job.lock")
    holder = folder / HIDDEN / "job.holder"  # an attempt to lock may empty the lock's own file
    if not _acquire(lock, folder):
        name = holder.read_text(errors="replace") if holder.is_file() else ""
        raise BlockingIOError(
            f"{name or 'another process'} is at work on {folder}: wait until it has ended, or "
            "give this job another output."
        )
    try:
        if holder.is_symlink() or not holder.is_file():  # a link could lead to a file of others
            holder.unlink(missing_ok=True)
        holder.write_text(f"The process {os.getpid()} on {platform.node()}")
        yield
    finally:
        lock.release()


@contextmanager
def item_lock(
    folder: Path, name: str, *, check: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Hold one item of a folder; wait while another process or thread holds it."""
    file = f"items/{hashlib.sha256(os.fsencode(name)).hexdigest()[:4]}.lock"
    while not _acquire(lock := _lock(folder, file), folder):
        check()
        time.sleep(_POLL)
    try:
        yield
    finally:
        lock.release()


def _lock(folder: Path, name: str) -> FileLock:
    """A lock on a file of a folder, both made where they are missing; not acquired."""
    path = folder / HIDDEN / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        raise type(error)(
            f"The output {folder} takes no files ({error.strerror}): make room on its disk, or "
            "give the job another output."
        ) from error
    return FileLock(path, fallback_to_soft=False)


def _acquire(lock: FileLock, folder: Path) -> bool:
    """Whether a lock was free and is held now."""
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return False
    except OSError as error:
        raise OSError(
            f"Files in {folder} cannot be locked ({error.strerror}), so that two processes could "
            "write one output: choose a disk that knows locks."
        ) from error
    return True
