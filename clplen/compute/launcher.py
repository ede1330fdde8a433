"""Kernels of a device: built once, kept, launched, and timed where a profile is kept."""

from __future__ import annotations

import math
import pickle
import sqlite3
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.drivers import limits, pocl
from clplen.compute.drivers.environment import require_room
from clplen.compute.drivers.failures import ADVICE, device_error
from clplen.compute.drivers.program import build_program
from clplen.compute.memory import Memory
from clplen.compute.profile import bytes_of, label
from clplen.errors import DeviceError, KernelBuildError

_GPU_GROUP = 64  # work-items of one row that a GPU runs as a group


def _plain(arg: Any) -> Any:
    """Return an argument of a kernel as pyopencl takes it."""
    if isinstance(arg, cla.Array):
        return arg.data
    return np.int32(arg) if type(arg) is int else arg


class Launcher(Memory):
    """The kernels of a device."""

    def __init__(self, cl_device: cl.Device, beside: Launcher | None = None) -> None:
        super().__init__(cl_device, beside)
        self._programs: dict[tuple[Any, ...], cl.Program] = {}
        self._kernels: dict[tuple[Any, ...], cl.Kernel] = {}
        self._labels: dict[cl.Kernel, str] = {}

    def kernel(self, file: str, name: str, **defines: Any) -> cl.Kernel:
        """Return a kernel, built once for every file and set of definitions."""
        if self.rows:
            defines["ROWS"] = True
        key = (file, name, tuple(sorted(defines.items())))
        with self._lock:
            if key not in self._kernels:
                program = self._program(file, tuple(sorted(defines.items())))
                self._kernels[key] = self._create(program, file, name)
                self._labels[self._kernels[key]] = label(name, key[2])
            return self._kernels[key]

    def _program(self, file: str, defines: tuple[tuple[str, Any], ...]) -> cl.Program:
        key = (file, defines)
        if key not in self._programs:
            # PoCL keeps binaries by the CPU's own name: what was built under another one has to
            # be told from them where machines share a cache.
            self._require_build_room(f"Building the kernel file {file!r}")
            name = pocl.written_name(self.cl_device) if self.note else ""
            if self.platform == pocl.PLATFORM:
                require_room(f"PoCL, which is to compile {file},")
            options = [f"-DCPU_NAME={name}"] if name else []
            self._programs[key] = build_program(self.context, file, dict(defines), options)
        return self._programs[key]

    def _require_build_room(self, what: str) -> None:
        """Refuse a compiler that would end the process; what is kept is given back before."""
        if not self.is_cpu:
            return
        try:
            limits.require_build_room(what, first=not self._programs)
        except DeviceError:
            self.free_spare()
            limits.require_build_room(what, first=not self._programs)

    def _create(self, program: cl.Program, file: str, name: str) -> cl.Kernel:
        """A kernel of a program; some drivers find only now that they cannot build it."""
        try:
            try:
                return cl.Kernel(program, name)
            except (OSError, sqlite3.Error, pickle.UnpicklingError):
                # pyopencl's own database of calls, in the cache folder, is damaged or full
                cl._PYOPENCL_NO_CACHE = True
                return cl.Kernel(program, name)
        except cl.Error as error:
            raise KernelBuildError(
                f"{self.name} ({self.driver}) made no kernel {name!r} of the file {file!r}, which "
                f"it had built ({error}): {ADVICE}."
            ) from error

    def launch(
        self,
        kernel: cl.Kernel,
        size: Sequence[int],
        *args: Any,
        group: Sequence[int] | None = None,
        nbytes: int | None = None,
        operations: float = 0.0,
    ) -> None:
        """Enqueue a kernel over ``size`` work-items, rounded up to the group.

        ``args`` are integers (of 32 bits), NumPy scalars, arrays without offset, or buffers. By
        default a group is one item, or 64 along the first axis where ``rows`` is off. ``nbytes`` to
        be moved (by default every array once) and ``operations`` are for a profile.
        """
        if group is None:
            group = (1 if self.rows else _GPU_GROUP, *(1 for _ in size[1:]))
        total = tuple(-(-int(n) // g) * g for n, g in zip(size, group, strict=True))
        if 0 in total:
            return
        plain = [_plain(arg) for arg in args]
        with self._lock:
            self._require_build_room("Running a kernel")  # PoCL links it now
            try:
                try:
                    done = kernel(self.queue, total, tuple(group), *plain)
                except cl.Error as error:
                    self.make_room(error)
                    done = kernel(self.queue, total, tuple(group), *plain)
            except cl.Error as error:
                step = f"The kernel {kernel.function_name!r}"
                raise device_error(self.cl_device, step, error) from error
            if self._profile is not None:
                moved = bytes_of(args) if nbytes is None else nbytes
                self._note(self._labels.get(kernel, kernel.function_name), done, moved, operations)

    def launch_rows(
        self, kernel: cl.Kernel, shape: Sequence[int], *args: Any, operations: float = 0.0
    ) -> None:
        """Enqueue a kernel written with ``FOR_X`` over (..., ny, nx): see common.cl."""
        *batch, ny, nx = (int(n) for n in shape)
        count = math.prod(batch)
        self.launch(kernel, (1 if self.rows else nx, ny, count), *args, operations=operations)
