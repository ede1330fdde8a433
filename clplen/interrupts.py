"""Ctrl-C at any moment: one sentence, status 130, within two seconds.

Python raises KeyboardInterrupt between two of its own instructions only: not while it starts or
ends, and not while a kernel, a transform or a library is waited for, however long that takes. So
the command ``clplen``, and nothing else that imports this package,

- leaves at once while its modules are imported and when its work is done,
- in between lets KeyboardInterrupt unwind what is open, and a thread, woken by the signal itself,
  ends the process if that takes longer than `GRACE`, after it removed what is half-written.
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
GRACE = 1.2  # seconds in which everything that is open may end by itself
_SIGACTION_BYTES = 256  # more than the C structure takes anywhere (152 in glibc)
_ENDING = [
    getattr(signal, name)
    for name in ("SIGHUP", "SIGINT", "SIGTERM", "SIGUSR1", "SIGUSR2")
    if hasattr(signal, name)
]
_NAMES = ("clplen", "clplen.exe", "clplen-script.py", "clplen-script.pyw")

_unfinished: dict[Path, bool] = {}  # whether it goes although it holds something


@contextmanager
def unfinished(path: Path, *, filled: bool = True) -> Iterator[None]:
    """Within this block a file or folder is not whole: it goes if the process is interrupted."""
    _unfinished[path] = filled
    try:
        yield
    finally:
        _unfinished.pop(path, None)


def is_command() -> bool:
    """Whether this process is the command, not another program that imports the package."""
    words = getattr(sys, "orig_argv", sys.argv)
    if "-m" in words[:-1]:
        return words[words.index("-m") + 1] == "clplen"
    return bool(sys.argv) and os.path.basename(sys.argv[0]) in _NAMES


def _is_ignored() -> bool:
    """Whether the shell shields this process from Ctrl-C, as it does in the background."""
    return signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def leave_at_once() -> None:
    """From here on Ctrl-C ends the command without a traceback: nothing is being written."""
    with suppress(ValueError):  # not the main thread
        if is_command() and not _is_ignored():
            signal.signal(signal.SIGINT, _leave)


def _leave(_: int, __: Any) -> None:
    leave()


def leave() -> NoReturn:
    """End all processes of the command, remove what is half-written, and say the sentence."""
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
    """Kill what multiprocessing started, last the tracker that would complain of the others."""
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
    """Let Ctrl-C raise KeyboardInterrupt in this block, and leave if that does not end it in time.

    Only the command does so; elsewhere nothing is changed.
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
    """Leave signals to Python although a library is loaded in this block that takes them.

    LLVM, which PoCL brings, handles signals that ask a process to end by deleting what it is
    writing, before Python's handler runs: the kernel "does not build". Threads that are started in
    the block, and the linkers that they start, do not see these signals either; a linker that
    Ctrl-C ends would make PoCL abort the process.
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
