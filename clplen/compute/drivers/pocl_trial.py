"""Test PoCL under a CPU name in a child process, which a wrong name may crash.

pocl.py starts the program and reads its exit status: 0 if every built-in function that clplen's
kernels call builds, runs and is correct, `UNFIT` if a function fails. A kernel without built-in
functions runs first, and "ready" is printed. A child that dies earlier lacks a linker, memory or
disk space, and says nothing about the name.
"""

from __future__ import annotations

import ctypes
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

from clplen.compute.drivers import builtin_functions

Pointer = ctypes.c_uint64
SEARCHED_BYTES = 1024
SECONDS = 15  # limit of CPU time; a compiler with a wrong name may never end
UNFIT = 3  # exit status that Python itself does not use
READY = b"ready"
HEADROOM = 2**28  # bytes of address space that a test takes
_TRIPLE = re.compile(rb"x86_64-[a-z0-9_-]+\Z")
_NAME = re.compile(rb"[a-z0-9][a-z0-9_.-]{1,30}\Z")
_MAX_NAME_BYTES = 64
_PLAIN = "kernel void builtins(global float *a, const int n) { a[0] = n; }"


def find_name(address: int) -> Pointer | None:
    """Find the pointer to the CPU name in a device object of PoCL on x86-64.

    PoCL 3 stores two strings behind each other: the target of its compiler, such as
    ``x86_64-unknown-linux-gnu``, and the CPU name. Nothing is read beyond the first kilobyte,
    behind which another device's object may begin, or outside of mapped memory.
    """
    readable, writable = _mapped_memory()
    end = next((end for begin, end in writable if begin <= address < end), address)
    for position in range(address, min(address + SEARCHED_BYTES, end) - 15, 8):
        triple = _text(ctypes.c_uint64.from_address(position).value, readable)
        pointer = Pointer.from_address(position + 8)
        if _TRIPLE.match(triple) and _NAME.match(_text(pointer.value, writable)):
            return pointer
    return None


def read_name(pointer: Pointer) -> str:
    """Read the name behind a pointer returned by `find_name`."""
    return ctypes.string_at(pointer.value).decode("ascii")


def write_name(pointer: Pointer, name: str) -> None:
    """Set the pointer to a new string, allocated by the C library as PoCL does."""
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    pointer.value = strdup(name.encode("ascii"))


def _mapped_memory() -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the readable and the writable mappings of this process as (begin, end)."""
    readable, writable = [], []
    for line in Path("/proc/self/maps").read_text(errors="replace").splitlines():
        span, rights = line.split()[:2]
        begin, end = (int(bound, 16) for bound in span.split("-"))
        if rights.startswith("r"):
            readable.append((begin, end))
        if rights.startswith("rw"):
            writable.append((begin, end))
    return readable, writable


def _text(address: int, memory: list[tuple[int, int]]) -> bytes:
    """Read the string at an address; return an empty string if it has no end nearby."""
    end = next((end for begin, end in memory if begin <= address < end), address)
    text, zero, _ = ctypes.string_at(address, min(_MAX_NAME_BYTES, end - address)).partition(b"\0")
    return text if zero else b""


def main(version: str, name: str, source: str) -> None:
    """Give PoCL's device a CPU name and check all built-in functions."""
    import mmap
    import resource

    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    with suppress(ValueError):  # a lower limit of the user ends the process by SIGKILL
        # below the hard limit the signal is SIGXCPU, which no other process sends
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    device = next(p for p in cl.get_platforms() if p.version == version).get_devices()[0]
    mmap.mmap(-1, HEADROOM).close()
    pointer = find_name(device.int_ptr)
    if pointer is None:
        sys.exit("The CPU name of PoCL's device was not found.")
    write_name(pointer, name)
    double = "cl_khr_fp64" in device.extensions
    y = np.empty((len(builtin_functions.expected(double=double)), builtin_functions.COUNT), "f")
    try:
        _run(device, _PLAIN, np.empty(1, "f"))
        print(READY.decode(), flush=True)
        options = ["-DDOUBLE"] if double else []
        _run(device, Path(source).read_text(), y, *builtin_functions.inputs(), options=options)
    except cl.MemoryError:
        raise
    except cl.Error as refusal:
        print(refusal, file=sys.stderr, flush=True)
        sys.exit(UNFIT)
    if wrong := builtin_functions.wrong(y, double=double):
        print(f"Wrong values: {'; '.join(wrong)}.", file=sys.stderr, flush=True)
        sys.exit(UNFIT)


def _run(device: Any, source: str, y: Any, *inputs: Any, options: list[str] | None = None) -> None:
    """Build the kernel ``builtins``, run one work-item and fill `y` with its output."""
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    flags = ["-cl-std=CL1.2", "-cl-mad-enable", "-w", *(options or [])]
    kernel = cl.Kernel(cl.Program(context, source).build(flags), "builtins")
    copy_flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(context, copy_flags, hostbuf=values) for values in (y, *inputs)]
    kernel(queue, (1,), (1,), *buffers, np.int32(builtin_functions.COUNT))
    cl.enqueue_copy(queue, y, buffers[0])


if __name__ == "__main__":
    main(*sys.argv[1:])
