"""Lowest part of a device: its OpenCL context, command queue and profile."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import pyopencl as cl

from clplen.compute.drivers import pocl, selection
from clplen.compute.drivers.failures import device_errors, is_out_of_memory
from clplen.compute.drivers.forked import Guard, HoldsOpenCL
from clplen.compute.profile import Profile
from clplen.errors import warn_caller


class Hardware(HoldsOpenCL):
    """Properties of a device, with its context and command queue, both created at first use."""

    def __init__(self, cl_device: cl.Device) -> None:
        self.cl_device = cl_device
        self.name: str = cl_device.name.strip()
        self.platform: str = cl_device.platform.name.strip()
        self.driver: str = f"{self.platform} {cl_device.driver_version.strip()}"
        self.is_cpu = bool(cl_device.type & cl.device_type.CPU)
        self.has_fp64 = "cl_khr_fp64" in cl_device.extensions
        self.memory_bytes = int(cl_device.global_mem_size)
        # one work-item per row (CPU) or per sample (GPU, and llvmpipe)
        self.rows = self.is_cpu and not selection.is_llvmpipe(cl_device)
        self.note = ""
        self._usable = False
        self._context: cl.Context | None = None
        self._queue: cl.CommandQueue | None = None
        self._profile: Profile | None = None
        self._lock = Guard()

    def ensure_usable(self) -> None:
        """Adapt PoCL to this CPU once, warn of truncated loops; ``note`` describes both."""
        with self._lock:
            if not self._usable:
                self.note = pocl.ensure_usable(self.cl_device)
                self._usable = True
                if loops := selection.warning(self.cl_device):
                    self.note = loops
                    warn_caller(loops, RuntimeWarning)

    @property
    def context(self) -> cl.Context:
        """OpenCL context, created at first use."""
        with self._lock:
            if self._context is None:
                self.ensure_usable()
                with device_errors(self.cl_device, "An OpenCL context"):
                    self._context = self._make_context()
            return self._context

    def _make_context(self) -> cl.Context:
        """Create a context; after an out-of-memory error collect garbage and retry.

        Unused devices, held in reference cycles by their plans, free 0.4 GiB each on an NVIDIA GPU.
        """
        try:
            return cl.Context([self.cl_device])
        except cl.Error as error:
            if not is_out_of_memory(error):
                raise
        gc.collect()
        return cl.Context([self.cl_device])

    @property
    def queue(self) -> cl.CommandQueue:
        """In-order command queue, created at first use."""
        with self._lock:
            if self._queue is None:
                with device_errors(self.cl_device, "A command queue"):
                    self._queue = cl.CommandQueue(self.context)
            return self._queue

    def finish(self) -> None:
        """Wait until all enqueued work is done."""
        with device_errors(self.cl_device, "Enqueued work"):
            self.queue.finish()

    @contextmanager
    def profiling(self) -> Iterator[Profile]:
        """Time everything enqueued in this block by the device's clock."""
        properties = cl.command_queue_properties.PROFILING_ENABLE
        with self._lock:
            self.queue.finish()
            plain, before = self.queue, self._profile
            profile = self._profile = Profile()
            self._queue = cl.CommandQueue(self.context, properties=properties)
        try:
            yield profile
        finally:
            with self._lock:
                self.queue.finish()
                self._queue, self._profile = plain, before

    def timed(
        self, what: str, *, nbytes: int, operations: float = 0.0
    ) -> AbstractContextManager[None]:
        """Time work of the host for a profile; do nothing without a profile."""
        if self._profile is None:
            return nullcontext()
        return self._profile.on_host(what, self.queue, nbytes, operations)

    def _note(self, what: str, event: Any, nbytes: int, operations: float = 0.0) -> None:
        if self._profile is not None:
            self._profile.add_event(what, event, nbytes, operations)
