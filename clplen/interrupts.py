"""Clean exit on Ctrl-C within two seconds, with one sentence and status 130.

Python raises KeyboardInterrupt only between two of its own instructions, not while it starts or
ends, or waits for a kernel, a transform or a library. Therefore the command ``clplen``, but no
other program that imports this package, handles Ctrl-C as follows:

- While modules are imported and after the work is done, it exits at once.
- In between, KeyboardInterrupt unwinds open resources. If this takes longer than `GRACE`, a thread
  woken by the signal removes unfinished files and ends the process.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

STATUS = 130  # 128 + SIGINT, as shells count
SENTENCE = "Interrupted; no file was left half-written."
GRACE = 1.2  # seconds for open resources to close
_SIGACTION_BYTES = 256  # upper bound of the C structure's size (152 in glibc)
_ENDING = [
    getattr(signal, name)
    for name in ("SIGHUP", "SIGINT", "SIGTERM", "SIGUSR1", "SIGUSR2")
    if hasattr(signal, name)
]
_NAMES = ("clplen", "clplen.exe", "clplen-script.py", "clplen-script.pyw")

_unfinished: dict[Path, bool] = {}  # True to remove a folder with its content


@contextmanager
def unfinished(path: Path, *, filled: bool = True) -> Iterator[None]:
    """Remove an unfinished file or folder if the process is interrupted in this block."""
    _unfinished[path] = filled
    try:
        yield
    finally:
        _unfinished.pop(path, None)


def is_command() -> bool:
    """Return True if this process is the command, not another program with this package."""
    arguments = getattr(sys, "orig_argv", sys.argv)
    if "-m" in arguments[:-1]:
        return arguments[arguments.index("-m") + 1] == "clplen"
    return bool(sys.argv) and os.path.basename(sys.argv[0]) in _NAMES


def _is_ignored() -> bool:
    """Return True if the shell shields this process from Ctrl-C, as in the background."""
    return signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def leave_at_once() -> None:
    """Exit at once on Ctrl-C from now on, since no file is being written."""
    with suppress(ValueError):  # not the main thread
        if is_command() and not _is_ignored():
            signal.signal(signal.SIGINT, _leave)


def _leave(_: int, __: Any) -> None:
    leave()


def leave() -> NoReturn:
    """End all processes of the command, remove unfinished files and print a sentence."""
    if "multiprocessing" in sys.modules:
        _end_children()
    for path, filled in list(_unfinished.items()):
        _remove(path, filled)
    with suppress(Exception):
        sys.stdout.flush()
    with suppress(OSError):
        os.write(2, f"\n{SENTENCE}\n".encode())
    os._exit(STATUS)


def _end_children() -> None:
    """Kill multiprocessing's children, and last its resource tracker."""
    from multiprocessing import active_children, resource_tracker

    children = active_children()
    for child in children:
        child.kill()
    for child in children:
        child.join(0.2)
    tracker: Any = getattr(resource_tracker, "_resource_tracker", None)
    with suppress(AttributeError, TypeError, OSError):
        os.kill(tracker._pid, signal.SIGKILL)


def _remove(path: Path, filled: bool) -> None:
    import shutil

    with suppress(OSError):
        if not filled:
            path.rmdir()
        elif path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


@contextmanager
def unwinding() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C in this block, and exit if it does not end in time.

    This applies to the command only; other programs are not affected.
    """
    import socket
    import threading

    in_main_thread = threading.current_thread() is threading.main_thread()
    if not is_command() or _is_ignored() or not in_main_thread:
        yield
        return
    woken, waking = socket.socketpair()
    waking.setblocking(False)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.set_wakeup_fd(waking.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(woken,), daemon=True, name="interrupts").start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGINT, _leave)
        waking.close()  # ends the thread


def _watch(woken: socket.socket) -> None:
    """Leave some time after SIGINT came."""
    import time

    with woken:
        while number := woken.recv(1):
            if number[0] == signal.SIGINT:
                time.sleep(GRACE)
                leave()


@contextmanager
def signals_kept() -> Iterator[None]:
    """Keep Python's signal handlers while a library is loaded that installs its own.

    LLVM in PoCL handles termination signals by deleting its output, before Python's handler runs:
    the kernel then "does not build". Threads and linkers started in the block do not receive these
    signals, because PoCL aborts the process when Ctrl-C ends its linker.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    import ctypes

    sigaction = ctypes.CDLL(None).sigaction
    handlers = {number: ctypes.create_string_buffer(_SIGACTION_BYTES) for number in _ENDING}
    for number, handler in handlers.items():
        sigaction(number, None, handler)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            sigaction(number, handler, None)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


leave_at_once()
