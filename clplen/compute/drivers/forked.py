"""A process forked from one that used OpenCL refuses devices, where it would wait for ever.

A fork copies the memory of a driver but not its threads, and locks as they happen to be. Drivers
hang or fail on the first call in the child, and freeing what the parent allocated may hang, too.
So the child keeps the parent's arrays and devices alive without touching them, and every way to a
device raises `DeviceError`.
"""

from __future__ import annotations

import ctypes
import gc
import os
from threading import RLock
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.errors import DeviceError

FORKED = (
    "This process was forked from one that had looked for OpenCL devices, and OpenCL does not "
    'survive a fork: start processes by multiprocessing.get_context("spawn"), or look for devices '
    "in the new process only."
)


class _Process:
    """What happened to OpenCL in this process."""

    used = False  # drivers were loaded and their threads started
    forked = False  # by the parent, before the fork


class HoldsOpenCL:
    """Base of what holds OpenCL objects: in a forked process they are kept, never released."""


class Guard:
    """A reentrant lock on work with a device; it raises `DeviceError` in a forked process."""

    def __init__(self) -> None:
        self._lock = RLock()

    def __enter__(self) -> None:
        require_own_process()
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class ForkedArray(cla.Array):
    """What an array of the parent process is in a forked one: its samples are out of reach."""

    @property
    def queue(self) -> cl.CommandQueue:  # type: ignore[override]
        """Refused with a DeviceError."""
        raise DeviceError(FORKED)

    @property
    def base_data(self) -> cl.Buffer:  # type: ignore[override]
        """Refused with a DeviceError."""
        raise DeviceError(FORKED)


def begin_use() -> None:
    """Note that this process is about to load OpenCL drivers."""
    require_own_process()
    _Process.used = True


def is_in_use() -> bool:
    """Whether this process, or one that it was forked from, has loaded OpenCL drivers."""
    return _Process.used


def require_own_process() -> None:
    """Refuse a process that was forked from one that used OpenCL."""
    if _Process.forked:
        raise DeviceError(FORKED)


def is_forked() -> bool:
    """Whether this process was forked from one that used OpenCL."""
    return _Process.forked


def unreachable(values: np.ndarray[Any, Any]) -> ForkedArray:
    """What stands for samples that a forked process was sent, and could put on no device.

    To refuse them on arrival would leave a `multiprocessing.Pool` waiting for ever.
    """
    array = ForkedArray.__new__(ForkedArray)
    array.__dict__.update(
        shape=values.shape,
        dtype=values.dtype,
        strides=np.empty(values.shape, values.dtype).strides,
        size=values.size,
        nbytes=values.nbytes,
        offset=0,
        events=[],
        _flags=None,
    )
    return array


def _leave_alone() -> None:
    """In a forked process: keep what the parent allocated, for nothing of it may be released."""
    if not _Process.used:
        return
    _Process.forked = True
    kept: list[Any] = []
    for thing in gc.get_objects():
        kind = type(thing)
        if issubclass(kind, cla.Array):
            kept.append((thing.base_data, thing.__dict__.get("events")))
            thing.__class__ = ForkedArray
        elif issubclass(kind, HoldsOpenCL):
            kept.append(dict(thing.__dict__))
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))  # also beyond the interpreter's end


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_alone)
