"""Kernels of a device: built once, cached, launched, and timed for a profile."""

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

_GPU_GROUP = 64  # work-items of a row in a work-group on a GPU


def _plain(arg: Any) -> Any:
    """Convert an argument of a kernel to the type that pyopencl expects."""
    if isinstance(arg, cla.Array):
        return arg.data
    return np.int32(arg) if type(arg) is int else arg


class Launcher(Memory):
    """Device with a cache of compiled kernels."""

    def __init__(self, cl_device: cl.Device, sibling: Launcher | None = None) -> None:
        super().__init__(cl_device, sibling)
        self._programs: dict[tuple[Any, ...], cl.Program] = {}
        self._kernels: dict[tuple[Any, ...], cl.Kernel] = {}
        self._labels: dict[cl.Kernel, str] = {}

    def kernel(self, file: str, name: str, **defines: Any) -> cl.Kernel:
        """Return a kernel, built once for each file and set of definitions."""
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
            # PoCL files binaries under the CPU's original name; the definition keeps binaries
            # built under another name apart where machines share a cache.
            self._require_build_room(f"Building the kernel file {file!r}")
            name = pocl.written_name(self.cl_device) if self.note else ""
            if self.platform == pocl.PLATFORM:
                require_room(f"Compiling {file} with PoCL")
            options = [f"-DCPU_NAME={name}"] if name else []
            self._programs[key] = build_program(self.context, file, dict(defines), options)
        return self._programs[key]

    def _require_build_room(self, what: str) -> None:
        """Raise if compiling would end the process; free spare memory before the second check."""
        if not self.is_cpu:
            return
        try:
            limits.require_build_room(what, first=not self._programs)
        except DeviceError:
            self.free_spare()
            limits.require_build_room(what, first=not self._programs)

    def _create(self, program: cl.Program, file: str, name: str) -> cl.Kernel:
        """Create a kernel of a program; some drivers fail only at this step."""
        try:
            try:
                return cl.Kernel(program, name)
            except (OSError, sqlite3.Error, pickle.UnpicklingError):
                # pyopencl's database of calls in the cache folder is damaged or full
                cl._PYOPENCL_NO_CACHE = True
                return cl.Kernel(program, name)
        except cl.Error as error:
            raise KernelBuildError(
                f"{self.name} ({self.driver}) built the file {file!r} but cannot create its kernel "
                f"{name!r} ({error}): {ADVICE}."
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

        ``args`` are 32-bit integers, NumPy scalars, arrays without offset, or buffers. The default
        group is one item, or 64 items along the first axis if ``rows`` is off. A profile records
        ``nbytes`` (bytes moved; by default each array once) and ``operations``.
        """
        if group is None:
            group = (1 if self.rows else _GPU_GROUP, *(1 for _ in size[1:]))
        total = tuple(-(-int(n) // g) * g for n, g in zip(size, group, strict=True))
        if 0 in total:
            return
        plain = [_plain(arg) for arg in args]
        with self._lock:
            self._require_build_room("Running a kernel")  # PoCL links the kernel at launch
            try:
                try:
                    event = kernel(self.queue, total, tuple(group), *plain)
                except cl.Error as error:
                    self.make_room(error)
                    event = kernel(self.queue, total, tuple(group), *plain)
            except cl.Error as error:
                step = f"The kernel {kernel.function_name!r}"
                raise device_error(self.cl_device, step, error) from error
            if self._profile is not None:
                moved = bytes_of(args) if nbytes is None else nbytes
                name = self._labels.get(kernel, kernel.function_name)
                self._note(name, event, moved, operations)

    def launch_rows(
        self, kernel: cl.Kernel, shape: Sequence[int], *args: Any, operations: float = 0.0
    ) -> None:
        """Enqueue a kernel written with ``FOR_X`` over (..., ny, nx); see common.cl."""
        *batch, ny, nx = (int(n) for n in shape)
        count = math.prod(batch)
        self.launch(kernel, (1 if self.rows else nx, ny, count), *args, operations=operations)
