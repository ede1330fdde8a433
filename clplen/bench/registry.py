"""The benchmarks by name, and how one is run.

The modules of this folder that measure have a tuple ``BENCHMARKS``.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

import pyopencl as cl

from clplen.bench.report import Benchmark, Report
from clplen.compute.device import Device
from clplen.compute.drivers.failures import is_want_of_memory
from clplen.compute.memory import free_memory
from clplen.errors import ClplenError, DeviceError

# Modules are imported when one of their benchmarks is asked for.
_MODULES = {
    "stack": "lightfields",
    "transfers": "lightfields",
    "propagation": "waves",
    "fields": "waves",
    "gradients": "gradients",
    "depth": "lightfields",
    "camera": "exposures",
    "microscope": "microscope",
    "series": "series",
    "demo": "exposures",
    "start": "start",
}
NAMES = tuple(_MODULES)
_SHARE = 0.8  # of the memory that is free
_REFUSED = ("needs", "largest that")  # what a DeviceError says of memory that does not suffice


def find_benchmark(name: str) -> Benchmark:
    """The benchmark of a name.

    Raises
    ------
    ClplenError
        If there is none.
    """
    if name not in NAMES:
        raise ClplenError(f"There is no benchmark {name!r}; there are {', '.join(NAMES)}.")
    module = importlib.import_module(f"clplen.bench.{_MODULES[name]}")
    benchmarks: tuple[Benchmark, ...] = module.BENCHMARKS
    return next(benchmark for benchmark in benchmarks if benchmark.name == name)


def run_benchmark(
    benchmark: Benchmark, device: Device, *, size: str, repeats: int, say: Callable[[str], None]
) -> Report | None:
    """One benchmark at one size, or at the next smaller one that memory allows.

    Parameters
    ----------
    benchmark : Benchmark
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
    name = benchmark.name
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
    if is_want_of_memory(error.__cause__):
        return True
    return any(words in str(error) for words in _REFUSED) and "bytes" in str(error)
