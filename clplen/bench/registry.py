"""The benchmarks by name, and how one is run.

A benchmark is a module of this folder with

    SUMMARY   one line
    SIZES     the sizes that are run when none is asked for
    QUICK     one small size, to see that everything works
    needs(size) -> int       bytes on host and device together
    run(device, size, repeats) -> Report
    smaller(size) -> str     a smaller size for a machine whose memory does not suffice, "" if none
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, cast

import pyopencl as cl

from clplen.bench.report import Report
from clplen.compute.memory import free_memory
from clplen.errors import ClplenError, DeviceError

if TYPE_CHECKING:
    from clplen.compute.device import Device

NAMES = (
    "stack",
    "transfers",
    "batch",
    "growth",
    "propagation",
    "fields",
    "automatic",
    "depth",
    "camera",
    "microscope",
    "demo",
    "start",
)
_SHARE = 0.8  # of the memory that is free
_REFUSED = ("needs", "largest that")  # what a DeviceError says of memory that does not suffice


class Benchmark(Protocol):
    """What a module of this folder has."""

    SUMMARY: str
    SIZES: tuple[str, ...]
    QUICK: str

    def needs(self, size: str) -> int:
        """Bytes on host and device together."""

    def run(self, device: Device, size: str, repeats: int) -> Report:
        """Time everything of one size."""

    def smaller(self, size: str) -> str:
        """A smaller size, or nothing."""


def find(name: str) -> Benchmark:
    """The benchmark of a name.

    Raises
    ------
    ClplenError
        If there is none.
    """
    if name not in NAMES:
        raise ClplenError(f"There is no benchmark {name!r}; there are {', '.join(NAMES)}.")
    return cast(Benchmark, importlib.import_module(f"clplen.bench.{name}"))


def run(
    name: str, device: Device, *, size: str, repeats: int, say: Callable[[str], None]
) -> Report | None:
    """One benchmark at one size, or at the next smaller one that memory allows.

    Parameters
    ----------
    name : str
        One of ``NAMES``.
    device : Device
    size : str
        In the benchmark's own words.
    repeats : int
    say : callable
        Takes one sentence when a smaller size is tried.

    Returns
    -------
    Report or None
        None where no size fits.
    """
    benchmark = find(name)
    while True:
        if benchmark.needs(size) <= _room(device):
            try:
                return benchmark.run(device, size, repeats)
            except (MemoryError, cl.MemoryError):
                device.free_spare()
            except DeviceError as error:
                if not is_of_memory(error):
                    raise
                device.free_spare()
        less = benchmark.smaller(size)
        if not less:
            say(f"{name}: the memory does not suffice for {size}, and there is no smaller size.")
            return None
        say(f"{name}: the memory does not suffice for {size}; {less} is measured instead.")
        size = less


def _room(device: Device) -> int:
    """Bytes of the host that may be taken, and on a GPU no more than it has."""
    free = int(_SHARE * free_memory())
    return free if device.is_cpu else min(free, device.memory_bytes)


def is_of_memory(error: DeviceError) -> bool:
    """Whether a device refused something because it is too large."""
    if isinstance(error.__cause__, cl.MemoryError):
        return True
    return any(words in str(error) for words in _REFUSED) and "bytes" in str(error)
