"""Device, memory and stages that the items of one process share."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from clplen.compute.device import Device
from clplen.compute.memory import free_memory

PIPELINE_DEPTH = 3  # items under way at a time: one is read, one computed, one written
STAGES = ("read", "compute", "write")


class StoppedError(Exception):
    """The job was told to stop."""


class Resources:
    """Device, memory and locks that the items of one process share, one in each stage."""

    def __init__(self, *, selector: str | None, memory: int | None) -> None:
        self.device = Device.open(selector)
        self.device.ensure_usable()
        self.limit(memory or default_memory(self.device))
        self._gates = {name: threading.Lock() for name in STAGES}
        self._stop = threading.Event()
        self.deconvolver: tuple[Any, Any] | None = None  # with its key; of the stage "compute"

    def limit(self, memory: int) -> None:
        """Set what the items that begin from now on may take together, in bytes."""
        self.memory = memory
        self.budget = MemoryBudget(memory)

    @contextmanager
    def stage(self, name: str, seconds: dict[str, float]) -> Iterator[None]:
        """One of `STAGES`, for one item at a time; its time is added to ``seconds``."""
        asked = time.perf_counter()
        with self._gates[name]:
            self.check()
            began = time.perf_counter()
            seconds["waiting"] = seconds.get("waiting", 0.0) + began - asked
            try:
                yield
            finally:
                seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - began

    def stop(self) -> None:
        """Let no item go on to its next stage."""
        self._stop.set()

    def check(self) -> None:
        """Raise `StoppedError` if the job was told to stop."""
        if self._stop.is_set():
            raise StoppedError


class MemoryBudget:
    """Memory that items take and give back; who comes first is served first."""

    def __init__(self, total: int) -> None:
        self._total = self._free = total
        self._changed = threading.Condition()
        self._queue: list[object] = []

    @contextmanager
    def of(self, wanted: int) -> Iterator[None]:
        """Wait for so many bytes, at most all, and hold them."""
        taken = min(wanted, self._total)
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
            self._changed.wait_for(lambda: self._queue[0] is ticket and self._free >= taken)
            self._queue.pop(0)
            self._free -= taken
            self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._free += taken
                self._changed.notify_all()


def default_memory(device: Device) -> int:
    """Half of the free memory of the host, or of a device with memory of its own."""
    return max(1, min(free_memory(), device.memory_bytes) // 2)
