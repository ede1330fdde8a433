"""Kernel runs, copies and host work on a device, with their times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import pyopencl as cl

NANOSECOND = 1e-9


@dataclass(frozen=True)
class Run:
    """Run of a kernel, a copy, or a piece of work on the host."""

    name: str  # kernel with its definitions, or work on the host
    seconds: float
    nbytes: int  # minimum number of bytes moved: each array once
    operations: float  # additions and multiplications; 0 if not counted


class Profile:
    """Runs in the order in which they were enqueued; made by `Device.profiling`."""

    def __init__(self) -> None:
        self._runs: list[Run | tuple[str, cl.Event, int, float]] = []

    def add_event(self, name: str, event: cl.Event, nbytes: int, operations: float = 0.0) -> None:
        """Add an enqueued event; its times are read after its end."""
        self._runs.append((name, event, nbytes, operations))

    @contextmanager
    def on_host(
        self, name: str, queue: cl.CommandQueue, nbytes: int, operations: float = 0.0
    ) -> Iterator[None]:
        """Time work in this block by the host's clock."""
        queue.finish()
        start = perf_counter()
        yield
        queue.finish()
        self._runs.append(Run(name, perf_counter() - start, nbytes, operations))

    @property
    def runs(self) -> tuple[Run, ...]:
        """Runs of the profile; waits for pending events."""
        return tuple(run if isinstance(run, Run) else _timed(*run) for run in self._runs)


def _timed(name: str, event: cl.Event, nbytes: int, operations: float) -> Run:
    event.wait()
    times = event.profile
    return Run(name, (times.end - times.start) * NANOSECOND, nbytes, operations)


def label(name: str, defines: Sequence[tuple[str, Any]]) -> str:
    """Return a kernel's name followed by its definitions."""
    definitions = (
        key if value is True else f"{key}={value}" for key, value in defines if key != "ROWS"
    )
    return " ".join((name, *definitions))


def bytes_of(arrays: Sequence[Any]) -> int:
    """Return the bytes of the arrays among a kernel's arguments, each buffer once."""
    sizes: dict[Any, int] = {}
    for array in arrays:
        if isinstance(array, cl.Buffer):
            sizes[array] = max(sizes.get(array, 0), array.size)
        elif hasattr(array, "nbytes") and hasattr(array, "base_data"):
            sizes[array.base_data] = max(sizes.get(array.base_data, 0), array.nbytes)
    return sum(sizes.values())
