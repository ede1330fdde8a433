"""Locks in the output folder, released by the system when a process dies."""

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
_POLL = 0.1  # interval of attempts to lock in seconds


@contextmanager
def job_lock(folder: Path) -> Iterator[None]:
    """Lock the output folder for the process that runs the job."""
    lock = _lock(folder, "job.lock")
    holder = (
        folder / HIDDEN / "job.holder"
    )  # separate, since an attempt to lock may empty the lock file
    if not _acquire(lock, folder):
        name = holder.read_text(errors="replace") if holder.is_file() else ""
        raise BlockingIOError(
            f"{name or 'Another process'} is using {folder}: wait until it ends, or give this job "
            "another output."
        )
    try:
        if holder.is_symlink() or not holder.is_file():  # a link may point to a foreign file
            holder.unlink(missing_ok=True)
        holder.write_text(f"The process {os.getpid()} on {platform.node()}")
        yield
    finally:
        lock.release()


@contextmanager
def item_lock(
    folder: Path, name: str, *, check: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Lock an item of a folder; wait while another process or thread holds the lock."""
    file = f"items/{hashlib.sha256(os.fsencode(name)).hexdigest()[:4]}.lock"
    while not _acquire(lock := _lock(folder, file), folder):
        check()
        time.sleep(_POLL)
    try:
        yield
    finally:
        lock.release()


def _lock(folder: Path, name: str) -> FileLock:
    """Return an open lock on a file of a folder; create file and folder if missing."""
    path = folder / HIDDEN / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        raise type(error)(
            f"Cannot write to the output {folder} ({error.strerror}): free space on its disk, or "
            "give the job another output."
        ) from error
    return FileLock(path, fallback_to_soft=False)


def _acquire(lock: FileLock, folder: Path) -> bool:
    """Acquire a lock without waiting; return True on success."""
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return False
    except OSError as error:
        raise OSError(
            f"Files in {folder} cannot be locked ({error.strerror}), which is needed to protect "
            "the output: choose a file system that supports locks."
        ) from error
    return True
