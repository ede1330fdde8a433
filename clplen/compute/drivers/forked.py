"""Refusal of devices in a process forked from one that used OpenCL.

A fork copies a driver's memory but not its threads, and locks in whatever state they are. Drivers
hang or fail at the first call in the child, and freeing the parent's buffers may hang, too. The
child therefore keeps the parent's arrays and devices alive without touching them, and every access
to a device raises `DeviceError`.
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
    "This process was forked from a process that had opened OpenCL devices, and OpenCL does not "
    'survive a fork: start processes by multiprocessing.get_context("spawn"), or open devices '
    "in the new process only."
)


class _Process:
    """State of OpenCL in this process."""

    used = False  # True after drivers were loaded and started their threads
    forked = False  # True if the parent had used OpenCL before the fork


class HoldsOpenCL:
    """Base of classes that hold OpenCL objects; a forked process never releases them."""


class Guard:
    """Reentrant lock on work with a device; it raises `DeviceError` in a forked process."""

    def __init__(self) -> None:
        self._lock = RLock()

    def __enter__(self) -> None:
        require_own_process()
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class ForkedArray(cla.Array):
    """Array of the parent process in a forked process; its samples are unreachable."""

    @property
    def queue(self) -> cl.CommandQueue:  # type: ignore[override]
        """Property that raises a DeviceError."""
        raise DeviceError(FORKED)

    @property
    def base_data(self) -> cl.Buffer:  # type: ignore[override]
        """Property that raises a DeviceError."""
        raise DeviceError(FORKED)


def begin_use() -> None:
    """Record that this process is about to load OpenCL drivers."""
    require_own_process()
    _Process.used = True


def is_in_use() -> bool:
    """Return True if this process or an ancestor of its forks has loaded OpenCL drivers."""
    return _Process.used


def require_own_process() -> None:
    """Raise in a process that was forked from one that used OpenCL."""
    if _Process.forked:
        raise DeviceError(FORKED)


def is_forked() -> bool:
    """Return True if this process was forked from one that used OpenCL."""
    return _Process.forked


def unreachable(values: np.ndarray[Any, Any]) -> ForkedArray:
    """Return a placeholder for samples received by a forked process, which cannot use a device.

    Raising on arrival would leave a `multiprocessing.Pool` waiting for ever.
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


def _disown_objects() -> None:
    """Keep the parent's OpenCL objects alive in a forked process, which must not free them."""
    if not _Process.used:
        return
    _Process.forked = True
    references: list[Any] = []
    for item in gc.get_objects():
        kind = type(item)
        if issubclass(kind, cla.Array):
            references.append((item.base_data, item.__dict__.get("events")))
            item.__class__ = ForkedArray
        elif issubclass(kind, HoldsOpenCL):
            references.append(dict(item.__dict__))
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(references))  # even when the interpreter ends


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown_objects)
