"""Registry of benchmarks by name, and their execution.

Each module of this folder with benchmarks has a tuple ``BENCHMARKS``.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

import pyopencl as cl

from clplen.bench.report import Benchmark, Report
from clplen.compute.device import Device
from clplen.compute.drivers.failures import is_out_of_memory
from clplen.compute.memory import free_memory
from clplen.errors import ClplenError, DeviceError

# Modules are imported at the first use of one of their benchmarks.
_MODULES = {
    "stack": "lightfields",
    "transfers": "lightfields",
    "propagation": "waves",
    "fields": "waves",
    "gradients": "waves",
    "depth": "lightfields",
    "camera": "exposures",
    "microscope": "microscope",
    "series": "microscope",
    "demo": "exposures",
    "start": "start",
}
NAMES = tuple(_MODULES)
_MAX_SHARE = 0.8  # largest memory of a benchmark over the free memory
_REFUSED = ("needs", "largest that")  # phrases of a DeviceError about memory


def find_benchmark(name: str) -> Benchmark:
    """Return the benchmark of a name; raise ClplenError for an unknown name."""
    if name not in NAMES:
        raise ClplenError(f"There is no benchmark {name!r}; choose among {', '.join(NAMES)}.")
    module = importlib.import_module(f"clplen.bench.{_MODULES[name]}")
    benchmarks: tuple[Benchmark, ...] = module.BENCHMARKS
    return next(benchmark for benchmark in benchmarks if benchmark.name == name)


def run_benchmark(
    benchmark: Benchmark, device: Device, *, size: str, repeats: int, say: Callable[[str], None]
) -> Report | None:
    """Run one benchmark at one size; report insufficient memory and return None."""
    free = int(_MAX_SHARE * free_memory())
    room = free if device.is_cpu else min(free, device.memory_bytes)
    if benchmark.needs(size) <= room:
        try:
            return benchmark.run(device, size, repeats)
        except (MemoryError, cl.MemoryError):
            pass
        except DeviceError as error:
            if not is_of_memory(error):
                raise
        device.free_spare()
    say(f"{benchmark.name}: the memory does not suffice for {size}; choose a smaller --size.")
    return None


def is_of_memory(error: DeviceError) -> bool:
    """Return True if a device ran out of memory."""
    if is_out_of_memory(error.__cause__):
        return True
    return any(phrase in str(error) for phrase in _REFUSED) and "bytes" in str(error)
