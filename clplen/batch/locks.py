"""Who works on what: locks in the output folder, let go by the system when a process dies."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None  # type: ignore[assignment]

HIDDEN = ".clplen"
_POLL = 0.1  # seconds


@contextmanager
def job_lock(folder: Path) -> Iterator[None]:
    """Hold the output folder for one process that shares out its items.

    Raises
    ------
    BlockingIOError
        If another one holds it.
    """
    with _opened(folder, "job.lock") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.seek(0)
                who = file.read().decode(errors="replace").strip() or "another process"
                raise BlockingIOError(
                    f"{who} is at work on {folder}: wait until it has ended, or give this job "
                    "another output."
                ) from None
        file.truncate(0)
        file.write(f"The process {os.getpid()} on {os.uname().nodename}".encode())
        file.flush()
        yield


class ItemLocks:
    """Locks on the items of a folder, for one process: byte ranges of one file.

    They exclude other processes, on other machines too where the file system knows such locks
    (POSIX record locks), and not the threads of this one.

    Parameters
    ----------
    folder : pathlib.Path
        Of the job's output.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file = _opened(folder, "items.lock")

    @contextmanager
    def hold(self, name: str) -> Iterator[bool]:
        """Hold one item; wait while another process does.

        Yields
        ------
        bool
            Whether it had to wait.
        """
        if fcntl is None:
            yield False
            return
        at = int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")
        waited = False
        while True:
            try:
                fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, at)
                break
            except BlockingIOError:
                waited = True
                time.sleep(_POLL)
        try:
            yield waited
        finally:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, at)

    def close(self) -> None:
        """Let go of everything."""
        self._file.close()


def _opened(folder: Path, name: str) -> IO[bytes]:
    (folder / HIDDEN).mkdir(parents=True, exist_ok=True)
    return (folder / HIDDEN / name).open("a+b")
