"""Who works on what: locks in the output folder, let go by the system when a process dies."""

from __future__ import annotations

import hashlib
import os
import platform
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None  # type: ignore[assignment]

HIDDEN = ".clplen"
_ITEMS = "items.lock"
_POLL = 0.1  # seconds


@contextmanager
def job_lock(folder: Path) -> Iterator[None]:
    """Hold the output folder for one process that shares out its items.

    Raises
    ------
    BlockingIOError
        If another one holds it.
    OSError
        If the disk knows no locks.
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
            except OSError as error:
                raise _no_locks(folder, error) from error
        file.truncate(0)
        file.write(f"The process {os.getpid()} on {platform.node()}".encode())
        file.flush()
        yield


class ItemLocks:
    """Locks on the items of a folder, for one process: byte ranges of one file.

    They exclude other processes, on other machines too where the file system knows such locks
    (POSIX record locks), and the other threads that use this object. Have one for each folder in a
    process: to close a second one would let go of the locks of the first.

    Parameters
    ----------
    folder : pathlib.Path
        Of the job's output.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = [_opened(folder, _ITEMS)]  # the last one is in use
        self._held: set[int] = set()
        self._lock = threading.Lock()

    @contextmanager
    def hold(self, name: str, *, check: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Hold one item; wait while another process or thread does.

        Parameters
        ----------
        name : str
        check : callable
            Called while it waits; what it raises ends the wait.
        """
        at = int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")
        while (file := self._taken(at)) is None:
            check()
            time.sleep(_POLL)
        try:
            yield
        finally:
            with self._lock:
                self._held.remove(at)
                if fcntl is not None:
                    fcntl.lockf(file, fcntl.LOCK_UN, 1, at)

    def _taken(self, at: int) -> IO[bytes] | None:
        """The file that holds a lock from now on; None if someone else has it."""
        with self._lock:
            if at in self._held:
                return None
            file = self._current()
            if fcntl is not None:
                try:
                    fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, at)
                except (BlockingIOError, PermissionError):  # systems differ
                    return None
                except OSError as error:
                    raise _no_locks(self._folder, error) from error
            self._held.add(at)
            return file

    def _current(self) -> IO[bytes]:
        """The file that other processes use: a new one if the folder was removed meanwhile."""
        file = self._files[-1]
        try:
            there = (self._folder / HIDDEN / _ITEMS).stat()
        except FileNotFoundError:
            there = None
        if there is None or not os.path.samestat(there, os.fstat(file.fileno())):
            self._files.append(_opened(self._folder, _ITEMS))
        return self._files[-1]

    def close(self) -> None:
        """Let go of everything."""
        for file in self._files:
            file.close()


def _no_locks(folder: Path, error: OSError) -> OSError:
    return OSError(
        f"Files in {folder} cannot be locked ({error.strerror}), so that two processes could write "
        "one output: choose a disk that knows locks."
    )


def _opened(folder: Path, name: str) -> IO[bytes]:
    try:
        (folder / HIDDEN).mkdir(parents=True, exist_ok=True)
        return (folder / HIDDEN / name).open("a+b")
    except OSError as error:
        raise type(error)(
            f"The output {folder} takes no files ({error.strerror}): make room on its disk, or "
            "give the job another output."
        ) from error
