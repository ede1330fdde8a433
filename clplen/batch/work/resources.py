"""What the items of one process share: the device, the memory, and one gate for each stage."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clplen.batch.work.locks import ItemLocks
from clplen.compute.device import Device
from clplen.compute.hostmemory import free_memory

if TYPE_CHECKING:
    from clplen.batch.work.deconvolution import Deconvolver

PIPELINE_DEPTH = 3  # items under way at a time: one is read, one computed, one written
STAGES = ("read", "compute", "write")


class StoppedError(Exception):
    """The job was told to stop."""


class Resources:
    """Where a process works on items, several at a time but one in each stage.

    Parameters
    ----------
    folder : pathlib.Path
        Of the job's output.
    selector : str or None
        As for `Device.open`.
    memory : int or None
        Bytes that all items together may take; None: half of what is free and of the device's.

    Attributes
    ----------
    device : Device
    memory : int
    locks : ItemLocks
    deconvolver : tuple or None
        What the frame before was deconvolved with, and what that depends on; of the stage
        "compute" alone.
    """

    def __init__(self, folder: Path, *, selector: str | None, memory: int | None) -> None:
        self.device = Device.open(selector)
        self.device.ensure_usable()
        self.locks = ItemLocks(folder)
        self.limit(memory or default_memory(self.device))
        self._gates = {name: threading.Lock() for name in STAGES}
        self._stop = threading.Event()
        self.deconvolver: tuple[Any, Deconvolver] | None = None

    def limit(self, memory: int) -> None:
        """Set what the items that begin from now on may take together, in bytes."""
        self.memory = memory
        self.budget = MemoryBudget(memory)

    @contextmanager
    def stage(self, name: str, seconds: dict[str, float]) -> Iterator[None]:
        """One of `STAGES`, for one item at a time; its time is added to ``seconds``.

        Raises
        ------
        StoppedError
            If the job was told to stop.
        """
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

    def close(self) -> None:
        """Let go of the locks."""
        self.locks.close()


class MemoryBudget:
    """Memory that items take and give back; who comes first is served first.

    Parameters
    ----------
    total : int
        Bytes.
    """

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
