"""The benchmarks by name, and how one is run.

The modules of this folder that measure have a tuple ``BENCHMARKS``.
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

# Modules are imported when one of their benchmarks is asked for.
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
_SHARE = 0.8  # of the memory that is free
_REFUSED = ("needs", "largest that")  # what a DeviceError says of memory that does not suffice


def find_benchmark(name: str) -> Benchmark:
    """Return the benchmark of a name; raise ClplenError if there is none."""
    if name not in NAMES:
        raise ClplenError(f"There is no benchmark {name!r}; there are {', '.join(NAMES)}.")
    module = importlib.import_module(f"clplen.bench.{_MODULES[name]}")
    benchmarks: tuple[Benchmark, ...] = module.BENCHMARKS
    return next(benchmark for benchmark in benchmarks if benchmark.name == name)


def run_benchmark(
    benchmark: Benchmark, device: Device, *, size: str, repeats: int, say: Callable[[str], None]
) -> Report | None:
    """Run one benchmark at one size; say so and return None where the memory does not suffice."""
    free = int(_SHARE * free_memory())
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
    say(f"{benchmark.name}: the memory does not suffice for {size}; give a smaller --size.")
    return None


def is_of_memory(error: DeviceError) -> bool:
    """Return whether a device refused something because it is too large."""
    if is_out_of_memory(error.__cause__):
        return True
    return any(words in str(error) for words in _REFUSED) and "bytes" in str(error)
