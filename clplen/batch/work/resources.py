"""Device, memory and stages shared by the items of a process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from clplen.compute.device import Device
from clplen.compute.memory import free_memory

PIPELINE_DEPTH = 3  # items in progress: one is read, one computed, one written
STAGES = ("read", "compute", "write")


class StoppedError(Exception):
    """Signal that the job was stopped."""


class Resources:
    """Device, memory and stages shared by the items of a process; a stage holds one item."""

    def __init__(self, *, selector: str | None, memory: int | None) -> None:
        self.device = Device.open(selector)
        self.device.ensure_usable()
        self.limit(memory or default_memory(self.device))
        self._gates = {name: threading.Lock() for name in STAGES}
        self._stop = threading.Event()
        self.deconvolver: tuple[Any, Any] | None = None  # key and value, used in "compute" only

    def limit(self, memory: int) -> None:
        """Set the total memory in bytes of items that start from now on."""
        self.memory = memory
        self.budget = MemoryBudget(memory)

    @contextmanager
    def stage(self, name: str, seconds: dict[str, float]) -> Iterator[None]:
        """Enter a stage of `STAGES`, for one item at a time; add its time to ``seconds``."""
        requested = time.perf_counter()
        with self._gates[name]:
            self.check()
            began = time.perf_counter()
            seconds["waiting"] = seconds.get("waiting", 0.0) + began - requested
            try:
                yield
            finally:
                seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - began

    def stop(self) -> None:
        """Prevent all items from entering their next stage."""
        self._stop.set()

    def check(self) -> None:
        """Raise `StoppedError` if the job was stopped."""
        if self._stop.is_set():
            raise StoppedError


class MemoryBudget:
    """Memory that items reserve and release, in order of their requests."""

    def __init__(self, total: int) -> None:
        self._total = self._free = total
        self._changed = threading.Condition()
        self._queue: list[object] = []

    @contextmanager
    def of(self, size: int) -> Iterator[None]:
        """Wait for ``size`` bytes, at most the total, and reserve them."""
        reserved = min(size, self._total)
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
            self._changed.wait_for(lambda: self._queue[0] is ticket and self._free >= reserved)
            self._queue.pop(0)
            self._free -= reserved
            self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._free += reserved
                self._changed.notify_all()


def default_memory(device: Device) -> int:
    """Return half of the free memory of the host or of the memory of the device, in bytes."""
    return max(1, min(free_memory(), device.memory_bytes) // 2)
